"""The whole twin in steady states with closed forms: lag at constant speed, holding currents, limits."""

import numpy as np
import pytest

from twin.geometry.scurve import jerk_limited_move
from twin.machine.machine import Machine
from twin.simulation.run import Run, simulate
from twin.simulation.setpoints import Setpoints

SPEED = np.array([0.1, 0.1, 0.05, 0.3, 0.5])  # m/s and rad/s


def constant_speed(machine: Machine, seconds: float = 1.4) -> Run:
    """All axes accelerate for 0.3 s and then keep their speed."""
    t = np.arange(round(seconds / 1e-3)) * 1e-3
    way = np.where(t < 0.3, t**2 / 0.6, t - 0.15)
    start = np.array([-0.1, -0.1, -0.05, -0.6, 0.0])
    return simulate(machine, Setpoints(start + way[:, None] * SPEED, 1e-3))


def lag(run: Run, axis: str) -> float:
    steady = run.trace.time > 1.0
    return float((run.trace.get(axis, "setpoint") - run.trace.get(axis, "position"))[steady].mean())


@pytest.mark.parametrize("delay", [0.002, 0.00137])
def test_lag_without_feedforward(mikron: Machine, delay: float) -> None:
    """v (1 / Kv + d_pos): the speed loop's integrator carries friction; A's changing gravity leaves a little."""
    machine = mikron.with_feedforward("off")
    for name in mikron.axis_names:
        machine = machine.with_axis(name, position_delay_s=delay)
    run = constant_speed(machine)
    for axis, v in zip(mikron.axes, SPEED):
        tolerance = 2e-4 if axis.name in "AC" else 1e-6
        assert lag(run, axis.name) == pytest.approx(v * (1 / axis.loops.position_gain_per_s + delay), rel=tolerance), axis.name


def test_lag_with_velocity_feedforward(mikron: Machine) -> None:
    """v d_pos, plus a tenth of v / Kv at a weight of 0.9."""
    full = constant_speed(mikron.with_feedforward("velocity"))
    part = mikron
    for name in mikron.axis_names:
        part = part.with_axis(name, velocity_feedforward=0.9)
    weaker = constant_speed(part)
    for axis, v in zip(mikron.axes, SPEED):
        tolerance = 2e-3 if axis.name in "AC" else 1e-5
        assert lag(full, axis.name) == pytest.approx(v * 0.002, rel=tolerance), axis.name
        assert lag(weaker, axis.name) == pytest.approx(v * (0.002 + 0.1 / 50), rel=tolerance), axis.name


def test_holding_currents(mikron: Machine) -> None:
    """At rest the motors carry gravity: i = m g r / Kt on Z; the unbalanced table by its angle on A; nothing on X and Y."""
    angle = -0.6
    run = simulate(mikron, Setpoints(np.tile([0.05, -0.05, 0.02, angle, 0.0], (300, 1)), 1e-3))
    z, a = mikron.axis("Z"), mikron.axis("A")
    np.testing.assert_allclose(run.trace.get("Z", "current"), 350 * 9.81 * z.ratio / 1.4, rtol=1e-9)
    torque = 9.81 * (4.65 * np.cos(angle) + 14.35 * np.sin(angle))
    np.testing.assert_allclose(run.trace.get("A", "current"), torque * a.ratio / 0.88, rtol=1e-9)
    for name, start in (("X", 0.05), ("Y", -0.05), ("A", angle)):
        np.testing.assert_allclose(run.trace.get(name, "position"), start, rtol=0, atol=1e-10)


def test_current_limit_is_kept_and_left_without_windup(mikron: Machine) -> None:
    """A step of 5 mm saturates the current; the current keeps its limit, and the axis settles without a large overshoot."""
    machine = mikron.with_axes(["X"]).with_feedforward("off").with_axis("X", peak_current_a=20.0)
    position = np.where(np.arange(1500) < 100, 0.0, 0.005)[:, None]
    run = simulate(machine, Setpoints(position, 1e-3), sample_period=machine.base_tick)
    wanted = run.trace.get("X", "current_setpoint")
    assert np.abs(wanted).max() == 20.0
    assert run.current_limited_s["X"] == pytest.approx(np.sum(np.abs(wanted) == 20.0) * machine.speed_cycle, rel=1e-9)
    assert run.current_limited_s["X"] > 0.002
    assert np.abs(run.trace.get("X", "position")[-800:] - 0.005).max() < 5e-6
    assert run.trace.get("X", "position").max() < 0.005 * 1.25


def test_voltage_limit_bounds_the_speed(mikron: Machine) -> None:
    """With a bus of 30 V the final speed is where back EMF and the friction current need the whole voltage."""
    machine = mikron.with_axes(["X"]).with_axis("X", bus_limit_v=30.0)
    axis, m = machine.axes[0], machine.axes[0].motor
    t = np.arange(1300) * 1e-3
    run = simulate(machine, Setpoints(jerk_limited_move(0.3, 0.25, 2.5, 5.0, t - 0.1)[:, None] - 0.15, 1e-3))
    assert run.voltage_limited_s["X"] > 0.1
    ohms = m.resistance_ohm / m.torque_constant_nm_per_a
    speed = (30.0 - ohms * axis.coulomb_friction_nm) / (m.back_emf_v_s_per_rad + ohms * axis.viscous_friction_nm_s_per_rad)
    np.testing.assert_allclose(run.trace.get("X", "velocity")[-100:], speed * axis.ratio, rtol=1e-6)


def test_torque_feedforward_reduces_the_error_during_acceleration(mikron: Machine) -> None:
    """Torque feedforward reduces the deviation from the delayed set point in a jerk-limited move."""
    machine = mikron.with_axes(["X"]).with_axis("X", coulomb_friction_nm=0.0)
    t = np.arange(1400) * 1e-3
    points = Setpoints(jerk_limited_move(0.2, 0.25, 2.5, 5.0, t - 0.1)[:, None] - 0.1, 1e-3)
    deviations = []
    for word in ("velocity", "velocity+torque"):
        trace = simulate(machine.with_feedforward(word), points).trace
        deviations.append(np.abs(points.at(trace.time - 0.002)[:, 0] - trace.get("X", "position")).max())
    assert deviations[1] < 0.5 * deviations[0]
