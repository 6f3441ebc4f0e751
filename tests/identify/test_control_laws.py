"""The position controller and the place of its loop, on signals that are made here from the law."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.builders.identify_campaigns import SHORT_LADDER, recorded
from tests.builders.one_axis import swing
from twin.identify.axis_run import AxisRun, axis_run
from twin.identify.check_recording import setpoint_shift
from twin.identify.drive_balance import simulated_torque_weight
from twin.identify.drive_position_loop import _fitted, drive_position_loop
from twin.identify.position_control import fit_position_control, plain_law
from twin.identify.position_law_search import Found
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

TP, KV = 2e-3, 33.3333


def made(machine: Machine, delay_cycles: float = 1.5, td: float = 5.25e-3, in_drive: bool = True, noise: float = 0.0) -> AxisRun:
    """An axis that follows u with a lag of 1.3 ms, sampled at its position cycle; its NC computes v* with half-cycle delays."""
    h, every = 1e-4, 20
    t = np.arange(0.0, 4.0, h)
    # a slow and a fast sway: speeds up to 0.3 m/s
    s = 0.04 * np.sin(2 * np.pi * 0.5 * t) + 0.01 * (1 - np.cos(2 * np.pi * 2.3 * t))
    cycle = s[::every]
    v_ff = np.diff(cycle, prepend=cycle[0]) / TP
    whole = int(delay_cycles)
    part = delay_cycles - whole
    late = (1 - part) * np.roll(cycle, whole) + part * np.roll(cycle, whole + 1)
    late[: whole + 1] = cycle[0]
    x, v = np.zeros(len(t)), 0.0
    x[0] = s[0]
    sent = np.zeros(len(t))
    for k in range(len(t) - 1):
        n = k // every
        sent[k] = KV * (late[n] - x[n * every]) + v_ff[n]
        back = max(k - round(td / h), 0)
        u = sent[back] - KV * (x[k] - x[back]) if in_drive else sent[k]
        v += (u - v) * h / 1.3e-3
        x[k + 1] = x[k] + h * v
    rng = np.random.default_rng(3)
    position = x[::every] + noise * rng.standard_normal(len(cycle))
    command = KV * (late - position) + v_ff
    signals = {
        ("X", "setpoint"): cycle,
        ("X", "position"): position,
        ("X", "velocity_setpoint"): command,
        ("X", "velocity_feedforward"): v_ff,
    }
    run = MeasuredRun("made", Trace(t[::every], signals, {"X": "linear"}), "velocity", 0.0)
    seen = axis_run(machine, machine.axis("X"), run)
    assert seen is not None
    return seen


@pytest.mark.parametrize("start", [1.0, 35.0, 400.0])
@pytest.mark.parametrize("recorded", [True, False])
def test_a_half_cycle_delay_is_found_from_any_start(mikron: Machine, start: float, recorded: bool) -> None:
    axis = mikron.with_values({"axis.X.loops.position_gain_per_s": start, "axis.X.loops.position_delay_s": 0.0}).axis("X")
    run = made(mikron)
    found = fit_position_control(axis, [run if recorded else replace(run, velocity_feedforward=None)])
    assert not isinstance(found, str)
    assert found.values["position_gain_per_s"] == pytest.approx(KV, rel=1e-3)
    assert found.values["position_delay_s"] == pytest.approx(1.5 * TP, abs=2e-5)
    assert found.values["velocity_feedforward"] == pytest.approx(1.0, abs=1e-3)
    assert found.interpolation == "linear"
    assert found.residual_rms < 2e-5


@pytest.mark.parametrize("block", [
    {"backlash_value": {"width_m": 2e-5, "cycles": 3}},
    {"position_correction": {"slope_ppm": 50.0, "origin_m": 0.0, "sine_m": 4e-6, "cosine_m": 0.0, "wavelength_m": 0.01}},
    {"set_point_average": {"length_s": 0.011}},
    {"set_point_lag": {"time_constant_s": 0.004}},
])  # fmt: skip
def test_the_gain_beside_tables_and_filters_of_the_control(mikron: Machine, block: dict[str, dict[str, float]]) -> None:
    """The position controller answers the set point behind what the machine file lists."""
    machine = mikron.with_axes(["X"]).with_values({"axis.X.block": block})
    path = swing(0.02, 1.5, 1.6) + swing(0.007, 3.1, 1.6)
    trace = simulate(machine, Setpoints(path[:, None], 1e-3), sample_period=TP).trace
    run = axis_run(machine, machine.axis("X"), MeasuredRun("made", trace, "velocity", 0.0))
    assert run is not None
    found = fit_position_control(machine.axis("X"), [run])
    assert not isinstance(found, str)
    loops = machine.axis("X").loops
    assert found.values["position_gain_per_s"] == pytest.approx(loops.position_gain_per_s, rel=1e-4)
    assert found.values["position_delay_s"] == pytest.approx(loops.position_delay_s, abs=1e-6)


def test_a_single_speed_gives_the_reason_why_no_gain_is_identified(mikron: Machine) -> None:
    run = made(mikron)
    still = replace(run, speed_setpoint=None)
    assert fit_position_control(mikron.axis("X"), [still]) == "no speed set point is recorded"


def test_a_speed_that_no_position_controller_gave_has_no_gain(mikron: Machine) -> None:
    """A speed without its sign in place of the speed set point, and a feedforward that the run is said to lack."""
    run = made(mikron)
    no_speed = replace(run, velocity_feedforward=None, speed_setpoint=np.abs(run.speed))
    assert "follows no position controller" in str(fit_position_control(mikron.axis("X"), [no_speed]))
    without = replace(run, velocity_feedforward=None, feedforward="off")
    assert "follows no position controller" in str(fit_position_control(mikron.axis("X"), [without]))


@pytest.mark.parametrize("td", [3.0e-3, 5.25e-3, 8.0e-3])
@pytest.mark.parametrize("noise", [0.0, 2e-7])
def test_a_loop_closed_in_the_drive_is_recognised(mikron: Machine, td: float, noise: float) -> None:
    found = drive_position_loop(mikron.axis("X"), [made(mikron, td=td, noise=noise)], KV)
    assert found is not None
    assert found.closed_in_drive
    assert found.delay_s == pytest.approx(td, abs=0.3e-3)


def test_the_reported_delay_of_the_drive_is_that_of_all_pieces(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[np.ndarray] = []

    def kept(*args: Any, **options: Any) -> np.ndarray:
        fitted.append(_fitted(*args, **options))
        return fitted[-1]

    monkeypatch.setattr("twin.identify.drive_position_loop._fitted", kept)
    found = drive_position_loop(mikron.axis("X"), [made(mikron, noise=5e-6)], KV)
    assert found is not None
    assert (found.delay_s, found.lag_s) == tuple(fitted[0])
    assert any(abs(x[0] - fitted[0][0]) > 1e-7 for x in fitted[1:])


def test_a_late_speed_set_point_is_seen_on_an_axis_that_is_controlled_on_its_motor_encoder(mikron: Machine) -> None:
    axis = mikron.with_values(
        {"axis.X.encoder": "motor", "axis.X.loops.position_gain_per_s": KV, "axis.X.loops.position_delay_s": 1.5 * TP}
    ).axis("X")
    run = made(mikron, in_drive=False)
    assert run.speed_setpoint is not None
    late = replace(run, position=None, motor_at_axis=run.position, speed_setpoint=np.roll(run.speed_setpoint, 2))
    assert setpoint_shift(axis, late) == pytest.approx(2.0 * TP)


@pytest.mark.parametrize(
    ("weight", "mode", "simulated"), [(0.7, None, 0.7), (0.7, "velocity+torque", 0.7), (0.0, "velocity+torque", 1.0), (0.0, None, 0.0)]
)
def test_the_torque_feedforward_of_a_run_has_the_weight_with_which_it_is_simulated(
    mikron: Machine, weight: float, mode: str | None, simulated: float
) -> None:
    machine = mikron.with_values({"axis.X.loops.torque_feedforward": weight})
    run = replace(made(mikron), feedforward=mode)
    assert simulated_torque_weight(machine.axis("X"), run) == simulated
    assert machine.with_feedforward(mode).axis("X").loops.torque_feedforward == simulated


def test_a_loop_closed_in_the_nc_is_not_taken_for_one_in_the_drive(mikron: Machine) -> None:
    found = drive_position_loop(mikron.axis("X"), [made(mikron, in_drive=False)], KV)
    assert found is not None
    assert not found.closed_in_drive


def test_of_laws_that_fit_alike_the_one_with_full_feedforward_is_taken(mikron: Machine) -> None:
    """A set point that is late by a cycle is the same law as less feedforward. A gain that changes later must not look like a change of both."""
    machine = mikron.with_axes(["X"])
    run = recorded(machine, "strokes", SHORT_LADDER, "velocity", 1)
    other = machine.with_values({"axis.X.loops.velocity_feedforward": 0.8, "axis.X.loops.position_delay_s": 0.0})
    found = plain_law(other.axes[0], [axis_run(with_commissioned_inertia(other), other.axes[0], run)], "linear")
    assert isinstance(found, Found)
    assert found.x == pytest.approx([50.0, 1.0, 2e-3, 0.0], rel=1e-6, abs=1e-8)
