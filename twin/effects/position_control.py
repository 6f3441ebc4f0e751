"""Effects of the position controller: gain, feedforward, delay and filter of the set point off nominal."""

import math

from twin.effects.change import Change
from twin.effects.effect import Parameter, Picture, effect, factor_of
from twin.errors import InputError
from twin.machine.machine import Axis
from twin.simulation.loop_terms import SETPOINT, X_SETPOINT, arrays, term


@effect(
    block="position controller",
    parameters=(factor_of("position_gain_per_s", 0.3, 1.6, (0.85, 1.15)),),
    rivals="At constant speed, a wrong velocity feedforward looks the same. The two differ while the axis accelerates.",
    picture=Picture("Feedforward off: the lag at constant speed is v / Kv.", feedforward="off", sizes={"factor": 0.87}),
)
def position_gain(change: Change, axis: Axis, factor: float) -> None:
    """Position gain Kv off nominal.

    Kv = factor x nominal. Acts on any following error: proportional to speed with feedforward off, to
    acceleration with it on. Source: machine data POSCTRL_GAIN (MD32200).
    """
    change.scale(axis, position_gain_per_s=factor)


@effect(
    block="position controller",
    parameters=(factor_of("velocity_feedforward", 0.0, 1.5, (0.95, 1.05)),),
    rivals="With feedforward on, a loop delay looks the same. With feedforward off, only the delay acts.",
    picture=Picture("An error proportional to speed, only with feedforward on.", sizes={"factor": 0.96}),
)
def velocity_feedforward(change: Change, axis: Axis, factor: float) -> None:
    """Velocity feedforward weight off nominal.

    a_v = factor x nominal: a following error of (1 - a_v) v / Kv at constant speed. Source: VELO_FFW_WEIGHT (MD32610).
    """
    change.scale(axis, velocity_feedforward=factor)


@effect(
    block="position controller",
    parameters=(Parameter("delay_s", "time", -0.002, 0.01, (-0.75e-3, 0.75e-3), neutral=0.0, starts=2),),
    rivals="With feedforward on, a wrong velocity feedforward looks the same. With feedforward off, only the delay acts.",
    picture=Picture("An error of v times the delay, with feedforward on and off.", sizes={"delay_s": 0.5e-3}),
    sets=("position_delay_s",),
)
def loop_delay(change: Change, axis: Axis, delay_s: float) -> None:
    """Set point delay of the position loop off nominal.

    d_pos = nominal + delay_s: an additional following error of v x delay_s, with feedforward on and off. Source: paper, section 2;
    Sinumerik equivalent time of the speed loop (MD32810).
    """
    delay = axis.loops.position_delay_s + delay_s
    if delay < 0.0:
        raise InputError(
            f"loop_delay on axis {axis.name}: delay_s = {delay_s:g} s exceeds the nominal delay of {axis.loops.position_delay_s:g} s "
            f"of the set point; give at least {-axis.loops.position_delay_s:g}"
        )
    change.set(axis, position_delay_s=delay)


@effect(
    block="position controller",
    parameters=(Parameter("time_constant_s", "time", 0.0, 0.02, (1e-3, 4e-3), neutral=0.0, logarithmic=True, lag_cycle="position_cycle"),),
    separating_move="accelerations",
    rivals="At constant speed, a loop delay of the same length looks the same. A filter also smooths fast changes.",
    picture=Picture(
        "An error of v times the time constant even with feedforward on, because the feedforward is not filtered.",
        sizes={"time_constant_s": 3e-3},
    ),
    sets=("position_delay_s",),
)
def set_point_filter(change: Change, axis: Axis, time_constant_s: float) -> None:
    """First-order lag on the position set point, not on the feedforward.

    y += (s - y)(1 - exp(-Tp / T)) at every position cycle, s the delayed set point. Source: jerk filter of the control
    (MD32402), set on one axis only.
    """
    change.add_term(lagged, SETPOINT, axis, [-math.expm1(-change.machine.position_cycle / time_constant_s), X_SETPOINT])


@term
def lagged(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """y += p[0] (x - y) of signal number p[1]; y starts at its first value."""
    p, s, x = arrays(parameters, state, signals)
    signal = int(p[1])
    if s[1] == 0.0:
        s[0] = x[axis, signal]
        s[1] = 1.0
    s[0] += p[0] * (x[axis, signal] - s[0])
    x[axis, signal] = s[0]
