"""Effects in the control: gains, feedforward, delays and filters that are not what the machine file says."""

from __future__ import annotations

import math

from twin.effects.change import Change, held_force
from twin.effects.effect import Parameter, effect
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import CURRENT, SETPOINT, X_CURRENT_SETPOINT, X_SETPOINT, arrays, term


def _factor(low: float, high: float, usual: tuple[float, float]) -> Parameter:
    return Parameter("factor", "number", low, high, usual, neutral=1.0, logarithmic=True)


@effect(block="position controller", parameters=(_factor(0.3, 1.6, (0.85, 1.15)),))
def position_gain(change: Change, axis: Axis, factor: float) -> None:
    """Position gain Kv off what the machine file says.

    Kv = factor x nominal. Shows wherever there is a following error: in proportion to speed with feedforward off, to
    acceleration with it on. Source: machine data POSCTRL_GAIN (MD32200).
    """
    change.scale(axis, position_gain_per_s=factor)


@effect(block="position controller", parameters=(_factor(0.5, 1.5, (0.95, 1.05)),))
def velocity_feedforward(change: Change, axis: Axis, factor: float) -> None:
    """Velocity feedforward weight off nominal.

    a_v = factor x nominal: a following error of (1 - a_v) v / Kv at constant speed. Source: VELO_FFW_WEIGHT (MD32610).
    """
    change.scale(axis, velocity_feedforward=factor)


@effect(block="speed controller", parameters=(_factor(-1.0, 3.0, (0.5, 1.5)),))
def torque_feedforward(change: Change, axis: Axis, factor: float) -> None:
    """Torque feedforward weight off nominal.

    a_t = factor x nominal: the speed controller has to make the missing (1 - a_t) J_ff a. Source: paper, section 2.
    """
    change.scale(axis, torque_feedforward=factor)


@effect(
    block="position controller",
    parameters=(Parameter("delay_s", "time", -0.002, 0.01, (-0.75e-3, 0.75e-3), neutral=0.0),),
)
def loop_delay(change: Change, axis: Axis, delay_s: float) -> None:
    """Set point reaches the position loop later (or earlier).

    d_pos = nominal + delay_s: v x delay_s of extra following error, with feedforward on and off. Source: paper, section 2;
    Sinumerik equivalent time of the speed loop (MD32810).
    """
    delay = axis.loops.position_delay_s + delay_s
    if delay < 0.0:
        raise InputError(
            f"loop_delay on axis {axis.name}: delay_s = {delay_s:g} s takes away more than the {axis.loops.position_delay_s:g} s that the "
            f"set point has; give at least {-axis.loops.position_delay_s:g}"
        )
    change.set(axis, position_delay_s=delay)


@effect(block="speed controller", parameters=(_factor(0.2, 2.5, (0.6, 1.4)),))
def speed_gain(change: Change, axis: Axis, factor: float) -> None:
    """Speed controller gain off nominal.

    Kp = factor x nominal; Kp / Tn follows. Source: drive datum MD1407.
    """
    change.scale(axis, speed_gain_nm_s_per_rad=factor)


@effect(block="speed controller", axes="integral", parameters=(_factor(0.3, 10.0, (0.5, 2.2)),))
def speed_integral_time(change: Change, axis: Axis, factor: float) -> None:
    """Integral time of the speed controller off nominal.

    Tn = factor x nominal. Source: drive datum MD1409.
    """
    change.scale(axis, speed_integral_time_s=factor)


@effect(
    block="position controller",
    parameters=(Parameter("time_constant_s", "time", 0.0, 0.02, (1e-3, 4e-3), neutral=0.0, logarithmic=True),),
)
def set_point_filter(change: Change, axis: Axis, time_constant_s: float) -> None:
    """First-order lag on the position set point, not on the feedforward.

    y += (s - y)(1 - exp(-Tp / T)) at every position cycle, s the delayed set point. Source: jerk filter of the control
    (MD32402) set on one axis alone.
    """
    change.add_term(lagged_setpoint, SETPOINT, axis, [-math.expm1(-change.machine.position_cycle / time_constant_s)])


@effect(
    block="speed controller",
    parameters=(Parameter("time_constant_s", "time", 0.0, 0.005, (0.5e-3, 1.5e-3), neutral=0.0, logarithmic=True),),
)
def current_filter(change: Change, axis: Axis, time_constant_s: float) -> None:
    """First-order lag on the current set point.

    y += (i* - y)(1 - exp(-Ti / T)) at every current cycle: phase loss in the speed loop. Source: current set point filters
    of the drive (611D has four).
    """
    change.add_term(lagged_current, CURRENT, axis, [-math.expm1(-change.machine.current_cycle / time_constant_s)])


def _reached_when_accelerating(machine: Machine, axis: Axis) -> tuple[float, float]:
    # what holds the axis against gravity is not there to accelerate
    holding = abs(held_force(machine, axis)) * axis.ratio / axis.motor.torque_constant_nm_per_a
    return (holding + 0.1 * axis.motor.peak_current_a, 0.5 * axis.motor.peak_current_a)


@effect(
    block="speed controller",
    parameters=(Parameter("limit_a", "current", 0.1, 1000.0, _reached_when_accelerating, neutral=math.inf, logarithmic=True),),
)
def current_limit(change: Change, axis: Axis, limit_a: float) -> None:
    """Current set point clipped lower than the data sheet says.

    i* = clip(i*, +-limit_a): acceleration is not reached, the following error grows while it lasts. Source: drive power
    module derating.
    """
    change.set(axis, peak_current_a=min(limit_a, axis.motor.peak_current_a))


@term
def lagged_setpoint(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """y += p[0] (s - y); y starts on the first set point."""
    p, s, x = arrays(parameters, state, signals)
    if s[1] == 0.0:
        s[0] = x[axis, X_SETPOINT]
        s[1] = 1.0
    s[0] += p[0] * (x[axis, X_SETPOINT] - s[0])
    x[axis, X_SETPOINT] = s[0]


@term
def lagged_current(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """y += p[0] (i* - y); y starts on the first current set point."""
    p, s, x = arrays(parameters, state, signals)
    if s[1] == 0.0:
        s[0] = x[axis, X_CURRENT_SETPOINT]
        s[1] = 1.0
    s[0] += p[0] * (x[axis, X_CURRENT_SETPOINT] - s[0])
    x[axis, X_CURRENT_SETPOINT] = s[0]
