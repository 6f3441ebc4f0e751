"""The reference model of a speed controller: its integrator sees the set point through a lag, so an accelerating axis keeps that lag."""

import numpy as np
import pytest

from tests.conftest import swings
from tests.reference.test_cascade_reference import check
from twin.effects import with_effects
from twin.machine.loops import loops_of
from twin.machine.machine import Machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

LAG_S = 1.5e-3


def modelled(machine: Machine, lag_s: float = LAG_S) -> Machine:
    return machine.with_values({f"axis.{name}.loops.speed_reference_time_s": lag_s for name in machine.axis_names})


@pytest.mark.parametrize("dsc_delay_s", [0.0, 5.25e-3])
def test_same_law(mikron: Machine, dsc_delay_s: float) -> None:
    machine = modelled(mikron).with_values({f"axis.{name}.loops.dsc_delay_s": dsc_delay_s for name in mikron.axis_names})
    check(machine, swings(machine, 0.3), ("velocity_setpoint",))


@pytest.mark.parametrize("lag_s", [0.0, LAG_S])
def test_an_accelerating_axis_keeps_the_lag(mikron: Machine, lag_s: float) -> None:
    """At acceleration a the speed lags its set point by a Tr, and not at all without a reference model."""
    t, a = np.arange(700) * 1e-3, 0.5
    one = modelled(mikron.with_axes(["X"]), lag_s).with_values({"axis.X.loops.torque_feedforward": 0.0})
    trace = simulate(one, Setpoints((0.5 * a * t**2)[:, None], 1e-3), sample_period=one.position_cycle).trace
    # the command is held over a position cycle, and the mean speed of that cycle is the one that it has in its middle
    last = slice(-60, -1)
    lag = np.mean((trace.get("X", "velocity_setpoint") - trace.get("X", "velocity"))[last]) / a
    assert lag == pytest.approx(lag_s + 0.5 * one.position_cycle, abs=1.5 * one.speed_cycle)


def test_closed_position_loop_response(mikron: Machine) -> None:
    """The closed position loop of `loops_of` answers like the simulated axis, amplitude and phase at 20 Hz."""
    quiet = with_effects(mikron.with_axes(["X"]), [{"name": "coulomb_friction", "axis": "X", "factor": 0.0}])
    machine = modelled(quiet, 4e-3).with_feedforward("off").with_axis("X", position_delay_s=0.0)
    f, period = 20.0, 1e-3
    t = np.arange(1600) * period
    position = 0.3e-3 * np.sin(2 * np.pi * f * t) * np.minimum(t / 0.3, 1.0)
    trace = simulate(machine, Setpoints(position[:, None], period)).trace
    last = slice(-round(10 / f / period) - 1, -1)
    turn = np.exp(-2j * np.pi * f * trace.time[last])
    measured = np.sum(trace.get("X", "position")[last] * turn) / np.sum(position[last] * turn)
    expected = loops_of(machine, machine.axis("X"))[2].closed_response(np.array([f]))[0]
    without = loops_of(quiet.with_feedforward("off"), quiet.axis("X"))[2].closed_response(np.array([f]))[0]
    assert abs(measured / expected - 1.0) < 0.03
    assert abs(without / expected - 1.0) > 0.1
