"""The position loop closed in the drive (dynamic servo control) and straight lines between set points: law and closed forms."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.one_axis import swing
from tests.builders.small_machine import write_small_machine
from tests.conftest import swings
from tests.reference.test_cascade_reference import check
from twin.effects import with_effects
from twin.exam.plant.parameters import settings_of, unit_factors
from twin.exam.plant.plant import run
from twin.geometry.scurve import moves_in_turn
from twin.machine.loops import loops_of, margins_of
from twin.machine.machine import Machine, load_machine, write_machine
from twin.simulation.errors_of_run import error_without_delay
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import command_of
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import ARCSEC

SPEED = 0.1  # m/s


def with_dsc(machine: Machine, delay_s: float, interpolation: str = "cubic") -> Machine:
    """The machine whose drives close the position loops, with the same delay on every axis."""
    delays = {f"axis.{name}.loops.dsc_delay_s": delay_s for name in machine.axis_names}
    return machine.with_values({**delays, "control.setpoint_interpolation": interpolation})


def constant_speed(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Set point and position of X [m] (sample,) at the end of a long steady move."""
    t = np.arange(900) * 1e-3
    x = SPEED * np.where(t < 0.2, t**2 / 0.4, t - 0.1)
    trace = simulate(machine.with_axes(["X"]), Setpoints(x[:, None] - 0.05, 1e-3)).trace
    return x[-50:] - 0.05, trace.get("X", "position")[-50:]


@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
@pytest.mark.parametrize("delay_s", [1e-3, 5.25e-3, 5.3e-3])
def test_same_law(mikron: Machine, delay_s: float, interpolation: str) -> None:
    check(with_dsc(mikron, delay_s, interpolation), swings(mikron, 0.3), ("drive_velocity_setpoint",))


@pytest.mark.parametrize("interpolation", ["cubic", "linear"])
def test_same_law_with_other_cycles_and_delays(tmp_path: Path, interpolation: str) -> None:
    machine = with_dsc(load_machine(write_small_machine(tmp_path)), 1.7e-3, interpolation)
    check(machine, swings(machine, 0.5), ("drive_velocity_setpoint",))


@pytest.mark.parametrize("delay_s", [0.0, 5.25e-3])
def test_following_distance_is_the_sum_of_the_delays(mikron: Machine, delay_s: float) -> None:
    """At constant speed v with full velocity feedforward: s - x = v (d_pos + Td), and w*_NC = v (1 + Kv Td)."""
    setpoint, position = constant_speed(with_dsc(mikron, delay_s))
    np.testing.assert_allclose(setpoint - position, SPEED * (2e-3 + delay_s), rtol=1e-6)


def test_without_feedforward_the_gain_adds_one_lag(mikron: Machine) -> None:
    """s - x = v (d_pos + Td + 1 / Kv)."""
    setpoint, position = constant_speed(with_dsc(mikron, 5e-3).with_feedforward("off"))
    np.testing.assert_allclose(setpoint - position, SPEED * (2e-3 + 5e-3 + 1.0 / 50.0), rtol=1e-6)


def test_the_command_of_the_nc_is_larger_than_the_speed(mikron: Machine) -> None:
    machine = with_dsc(mikron, 5.25e-3).with_axes(["X"])
    t = np.arange(900) * 1e-3
    x = SPEED * np.where(t < 0.2, t**2 / 0.4, t - 0.1)
    trace = simulate(machine, Setpoints(x[:, None] - 0.05, 1e-3)).trace
    np.testing.assert_allclose(trace.get("X", "velocity_setpoint")[-50:], SPEED * (1.0 + 50.0 * 5.25e-3), rtol=1e-6)
    np.testing.assert_allclose(trace.get("X", "drive_velocity_setpoint")[-50:], SPEED, rtol=1e-6)


def test_with_the_loop_in_the_nc_the_drive_has_no_separate_set_point(mikron: Machine) -> None:
    trace = simulate(mikron.with_axes(["X"]), Setpoints(np.zeros((50, 1)), 1e-3)).trace
    assert not trace.has("X", "drive_velocity_setpoint")


def test_a_delay_of_one_and_a_half_cycles_is_the_mean_of_two_samples(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"]).with_values(
        {"control.setpoint_interpolation": "linear", "axis.X.loops.position_delay_s": 3e-3, "axis.X.loops.feedforward_delay_s": 5e-4}
    )
    _, x = moves_in_turn(0.0, [0.02], 0.3, 2.0, 40.0, 0.05, 2e-3)
    command = command_of(machine, commissioned_inertia(machine), Setpoints(x[:, None], 2e-3), 0, len(x))
    expected = 0.5 * (x[1:-1] + x[:-2])
    np.testing.assert_allclose(command.setpoint[2:, 0], expected, atol=1e-15)
    s = 0.75 * x[1:] + 0.25 * x[:-1]
    np.testing.assert_allclose(command.velocity_feedforward[2:, 0], np.diff(s) / 2e-3, atol=1e-12)
    cubic = machine.with_values({"control.setpoint_interpolation": "cubic"})
    other = command_of(cubic, commissioned_inertia(machine), Setpoints(x[:, None], 2e-3), 0, len(x))
    assert np.abs(other.setpoint - command.setpoint).max() > 0.1e-6


def test_written_and_read(mikron: Machine, tmp_path: Path) -> None:
    write_machine(with_dsc(mikron, 5.25e-3, "linear"), tmp_path / "m.toml")
    again = load_machine(tmp_path / "m.toml")
    assert again.axis("A").loops.dsc_delay_s == 5.25e-3
    assert again.setpoint_interpolation == "linear"


def fine_measuring(machine: Machine) -> Machine:
    """The machine with negligible rounding of its measuring systems."""
    steps = {k: 1e-13 for k in machine.document["measurement"] if k.endswith(("resolution_m", "resolution_rad", "resolution_deg"))}
    return machine.with_values({f"measurement.{key}": value for key, value in steps.items()})


@pytest.mark.parametrize(("delay_s", "interpolation"), [(0.0, "linear"), (5.25e-3, "cubic"), (5.3e-3, "linear")])
def test_twin_and_second_plant_agree(mikron: Machine, delay_s: float, interpolation: str) -> None:
    machine = fine_measuring(with_dsc(mikron, delay_s, interpolation)).with_values({"axis.X.loops.position_delay_s": 3e-3})
    points = swings(machine, 0.5)
    trace = simulate(machine, points).trace
    other = run(settings_of(dict(machine.document), unit_factors()), points.position, noise=False)
    there = simulate(mikron, points).trace.matrix("position")
    position = trace.matrix("position")
    assert np.abs(there - position)[:, 0].max() > 1e-6  # it does something
    for a, axis in enumerate(machine.axes):
        rms = np.sqrt(np.mean((position - other.position)[:, a] ** 2))
        assert rms < (0.05e-6 if axis.kind == "linear" else 0.1 * ARCSEC), axis.name
        speed = np.abs(trace.get(axis.name, "velocity_setpoint") - other.velocity_setpoint[:, a])
        assert np.sqrt(np.mean(speed**2)) < 1e-3 * np.abs(other.velocity_setpoint[:, a]).max(), axis.name


def test_closed_loop_response_of_the_drive(mikron: Machine) -> None:
    """Response of the simulated axis to a sinusoidal set point: x / s = e^(-j w Td) H Kv P / (1 + L), H: command held over Tp."""
    f, period, delay, m = 12.0, 1e-3, 5.25e-3, 16
    machine = with_effects(mikron.with_axes(["X"]), [{"name": "coulomb_friction", "axis": "X", "factor": 0.0}])
    machine = machine.with_values({"axis.X.loops.position_delay_s": 0.0, "axis.X.loops.dsc_delay_s": delay}).with_feedforward("off")
    position = swing(2e-4, f, 2.0)
    trace = simulate(machine, Setpoints(position[:, None], period)).trace
    last = slice(-round(12 / f / period) - 1, -1)
    turn = np.exp(-2j * np.pi * f * trace.time[last])
    measured = np.sum(trace.get("X", "position")[last] * turn) / np.sum(position[last] * turn)
    # the drive's loop without an NC that holds: the position cycle as short as the speed cycle
    alone = machine.with_values({"axis.X.loops.dsc_delay_s": 0.0, "control.position_cycle_us": 125})
    at = np.array([f])
    plant = loops_of(alone, alone.axis("X"))[2].open_response(at)[0]
    loop = loops_of(machine, machine.axis("X"))[2]
    z = np.exp(2j * np.pi * f * machine.speed_cycle)
    held = sum(z**-i for i in range(m)) / m
    expected = np.exp(-2j * np.pi * f * delay) * held * plant / (1.0 + loop.open_response(at)[0])
    assert abs(plant / loop.open_response(at)[0] - 1.0) > 0.02  # what the NC holds counts
    assert abs(measured / expected - 1.0) < 0.01


def test_the_delay_does_not_reduce_the_stability_margins(mikron: Machine) -> None:
    """Td causes no phase lag in the drive's loop: it is stable at a gain at which a loop with that dead time is unstable."""
    fast = with_dsc(mikron, 8e-3).with_values({"axis.X.loops.position_gain_per_s": 160.0})
    margins = margins_of(loops_of(fast, fast.axis("X"))[2])
    assert margins.stable
    dead_time = np.degrees(2.0 * np.pi * margins.crossover * 8e-3)
    assert margins.phase - dead_time < 0.0
    points = Setpoints(np.concatenate([np.zeros(50), np.full(400, 1e-4)])[:, None], 1e-3)
    settled = simulate(fast.with_axes(["X"]), points).trace.get("X", "position")[-50:]
    assert np.ptp(settled) < 1e-6


def test_errors_without_delay_subtract_the_delay_of_the_drive(mikron: Machine) -> None:
    """At constant speed the following error of a loop closed in the drive is zero without both delays."""
    machine = with_dsc(mikron, 5.25e-3).with_axes(["X"])
    t = np.arange(900) * 1e-3
    x = SPEED * np.where(t < 0.2, t**2 / 0.4, t - 0.1) - 0.05
    trace = simulate(machine, Setpoints(x[:, None], 1e-3)).trace
    left = error_without_delay(trace, machine.axis("X"))[-400:]
    assert np.abs(left).max() < 1e-3 * SPEED * machine.axis("X").loops.set_point_delay_s
