"""The position loop closed in the drive (dynamic servo control) and straight lines between set points: law and closed forms."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.small_machine import write_small_machine
from tests.conftest import swings
from tests.reference.test_cascade_reference import check
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine, write_machine
from twin.simulation.run import commissioned_inertia, simulate
from twin.simulation.setpoints import Setpoints, command_of

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


def test_without_feedforward_the_gain_counts_once(mikron: Machine) -> None:
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


def test_a_loop_in_the_nc_has_no_set_point_of_its_own_in_the_drive(mikron: Machine) -> None:
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
