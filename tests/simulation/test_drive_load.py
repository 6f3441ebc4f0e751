"""Drive load accumulated in the loop, compared with a record of every tick and with energies in closed form."""

import numpy as np
import pytest

from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine
from twin.simulation.run import Run, simulate
from twin.simulation.setpoints import Setpoints

TICK = 125e-6


def moved(machine: Machine, sample_period: float | None = None, count_load: bool = True) -> Run:
    """X moves 40 mm and back; the other axes stand still."""
    time, x = moves_in_turn(0.0, [0.04, -0.04], 0.2, 2.0, 50.0, 0.06, 1e-3)
    position = np.zeros((len(time), len(machine.axes)))
    position[:, 0] = x
    return simulate(machine, Setpoints(position, 1e-3), sample_period=sample_period, count_load=count_load)


def means_over_ticks(current: np.ndarray, rate: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean and mean square (tick,) between samples of every tick by quadrature of an exponential with `rate` per tick."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    gone = np.expm1(-rate * (nodes + 1.0) / 2.0) / np.expm1(-rate)
    between = current[:-1, None] + np.diff(current)[:, None] * gone
    return between @ weights / 2.0, between**2 @ weights / 2.0


def test_load_equals_that_of_a_record_of_every_tick(mikron: Machine) -> None:
    run = moved(mikron, sample_period=TICK)
    rows = moved(mikron)
    for axis in mikron.axes:
        load, current = run.load[axis.name], run.trace.get(axis.name, "current")
        mean, square = means_over_ticks(current, axis.motor.resistance_ohm / axis.motor.inductance_h * TICK)
        cycles = len(mean) // 16
        smooth = mean[: 16 * cycles].reshape(cycles, 16).mean(axis=1)
        assert load.effort_max == np.abs(current).max()
        assert load.effort_rms == pytest.approx(np.sqrt(square[: 16 * cycles].mean()), rel=1e-9)
        assert load.smooth_max == pytest.approx(np.abs(smooth).max(), rel=1e-9)
        assert load.smooth_rms == pytest.approx(np.sqrt(np.mean(smooth**2)), rel=1e-9)
        assert load.ripple_rms == pytest.approx(np.sqrt(max(square[: 16 * cycles].mean() - np.mean(smooth**2), 0.0)), rel=1e-4, abs=1e-6)
        assert load.speed_max == np.abs(run.trace.get(axis.name, "velocity")).max()
        # the load does not depend on the sample period
        assert rows.load[axis.name].effort_rms == load.effort_rms
        assert rows.load[axis.name].work == load.work


def test_energies_balance(mikron: Machine) -> None:
    """From rest to rest, the work of the motor equals the friction loss, and the electrical energy equals work plus heat."""
    run = moved(mikron, sample_period=TICK)
    x, load, duration = mikron.axis("X"), run.load["X"], run.trace.time[-1]
    speed = run.trace.get("X", "velocity") / x.ratio
    friction = x.coulomb_friction_nm * np.abs(speed) + x.viscous_friction_nm_s_per_rad * speed**2
    assert load.work == pytest.approx(friction.sum() * TICK, rel=2e-3)
    assert load.braking > 0.2 * load.work
    heat = x.motor.resistance_ohm * load.effort_rms**2 * duration
    # the back-EMF uses the speed at the start of each tick, half a tick of acceleration early: 0.3 J here
    assert x.motor.phases * (load.electrical - heat) == pytest.approx(load.work, rel=4e-3)


def test_largest_torque_by_speed(mikron: Machine) -> None:
    run = moved(mikron, sample_period=TICK)
    x, load = mikron.axis("X"), run.load["X"]
    current = run.trace.get("X", "current")
    mean, _ = means_over_ticks(current, x.motor.resistance_ohm / x.motor.inductance_h * TICK)
    velocity = run.trace.get("X", "velocity")[:-1] / x.ratio
    torque, speed = np.where(mean * velocity >= 0.0, np.abs(x.motor.torque_constant_nm_per_a * mean), 0.0), np.abs(velocity)
    lower = np.concatenate([[0.0], load.speed[:-1]])
    for low, high, largest in zip(lower, load.speed, load.torque):
        inside = torque[(speed >= low) & (speed < high)]
        assert largest == pytest.approx(inside.max(initial=0.0), rel=1e-9)


def test_counting_does_not_change_the_trace(mikron: Machine) -> None:
    plain, counted = moved(mikron, count_load=False), moved(mikron)
    assert not plain.load
    for axis in mikron.axis_names:
        for signal in ("position", "current", "torque"):
            np.testing.assert_array_equal(plain.trace.get(axis, signal), counted.trace.get(axis, signal))
