"""LinuxCNC's `pid` beside P and FF1: the law in plain words, its part of the margins, its lines in an ini file."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.one_axis import swing
from twin.cli.parser import main
from twin.machine.loops import loops_of
from twin.machine.machine import Machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

FULL = {
    "integral_gain_per_s2": 40.0, "derivative_gain": 0.02, "position_feedforward_per_s": 0.01, "acceleration_feedforward_s": 2e-4,
    "jerk_feedforward_s2": 1e-5, "dead_band_m": 2e-6, "largest_error_m": 2e-3, "largest_integral_m_s": 1e-4, "largest_output_m_per_s": 0.1,
}  # fmt: skip


@pytest.fixture(scope="module")
def machine(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"]).with_feedforward("off").with_values({"axis.X.loops.position_delay_s": 0.0})


def stated(numbers: dict[str, float], gain: float, s: np.ndarray, x: np.ndarray, cycle: float) -> np.ndarray:
    """The output of `pid` for commands s and feedbacks x, one a cycle."""
    get = lambda name: numbers.get(name, 0.0)  # noqa: E731
    out, integral, before, slope, curvature, side = [], 0.0, None, 0.0, 0.0, 0
    for k, e in enumerate(s - x):
        e = np.sign(e) * max(abs(e) - get("dead_band_m"), 0.0)
        e = float(np.clip(e, -get("largest_error_m"), get("largest_error_m"))) if get("largest_error_m") else e
        if side * e <= 0:
            integral += e * cycle
            limit = get("largest_integral_m_s") or np.inf
            integral = float(np.clip(integral, -limit, limit))
        new_slope = (s[k] - s[max(k - 1, 0)]) / cycle
        new_curvature = (new_slope - slope) / cycle
        u = gain * e + get("integral_gain_per_s2") * integral + get("derivative_gain") * (e - (e if before is None else before)) / cycle
        u += get("position_feedforward_per_s") * s[k] + get("acceleration_feedforward_s") * new_curvature
        u += get("jerk_feedforward_s2") * (new_curvature - curvature) / cycle
        before, slope, curvature = e, new_slope, new_curvature
        limit = get("largest_output_m_per_s") or np.inf
        side = int(np.sign(u)) if abs(u) > limit else 0
        out.append(float(np.clip(u, -limit, limit)))
    return np.array(out)


@pytest.mark.parametrize("own", [(), *((name,) for name in FULL if name != "largest_integral_m_s"), tuple(FULL)], ids=str)
def test_the_output_is_that_of_pid(machine: Machine, own: tuple[str, ...]) -> None:
    numbers = {name: FULL[name] for name in own}
    path, cycle = swing(0.01, 2.0, 1.2), machine.position_cycle
    trace = simulate(
        machine.with_values({"axis.X.block": {"pid": numbers}}) if numbers else machine, Setpoints(path[:, None], 1e-3), sample_period=cycle
    ).trace
    x, found = trace.get("X", "position"), trace.get("X", "velocity_setpoint")
    expected = stated(numbers, machine.axis("X").loops.position_gain_per_s, path[:: round(cycle / 1e-3)][: len(x)], x, cycle)
    assert found == pytest.approx(expected, abs=2e-6 * max(1.0, np.abs(expected).max()))
    if "largest_output_m_per_s" in numbers:
        assert np.count_nonzero(np.abs(found) > 0.0999) > 3


def test_the_margins_know_integral_and_derivative(machine: Machine) -> None:
    axis, cycle, f = machine.axis("X"), machine.position_cycle, np.array([0.5, 3.0, 20.0, 60.0])
    plain = loops_of(machine, axis)[-1].open_response(f)
    late = np.exp(-2j * np.pi * f * cycle)
    for i, d in ((0.0, 0.1), (200.0, 0.0), (200.0, 0.1)):
        own = machine.with_values({"axis.X.block": {"pid": {"integral_gain_per_s2": i, "derivative_gain": d}}})
        gain = axis.loops.position_gain_per_s
        controller = gain + i * cycle / (1.0 - late) + d * (1.0 - late) / cycle
        assert loops_of(own, own.axis("X"))[-1].open_response(f) == pytest.approx(plain * controller / gain, rel=1e-9)


def test_an_ini_file_is_shown_as_the_block(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "joints.ini").write_text(
        "[JOINT_0]\nP = 50\nI = 40\nFF1 = 1\nFF2 = 0.0002\nDEADBAND = 0.002\nBACKLASH = 0.01\n", encoding="utf-8"
    )
    assert main(["machine", "show", "--control-file", str(tmp_path / "joints.ini")]) == 0
    shown = capsys.readouterr().out
    for line in (
        "[axis.X.block.pid]",
        "integral_gain_per_s2 = 40.0",
        "acceleration_feedforward_s = 0.0002",
        "dead_band_m = 2e-06",
        "width_m = 1e-05",
    ):
        assert line in shown
