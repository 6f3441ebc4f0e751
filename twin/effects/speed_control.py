"""Effects of the speed controller: gain, integral time, torque feedforward, current filter and current limit off nominal."""

import math

from twin.effects.change import Change, held_force
from twin.effects.effect import Parameter, Picture, effect, factor_of
from twin.effects.position_control import lagged
from twin.machine.machine import Axis, Machine
from twin.simulation.loop_terms import CURRENT, X_CURRENT_SETPOINT


@effect(
    block="speed controller",
    parameters=(factor_of("torque_feedforward", -1.0, 3.0, (0.5, 1.5)),),
    separating_move="accelerations",
    rivals="A wrong inertia also changes the torque in proportion to acceleration, but with feedforward off, too.",
    picture=Picture("Errors when the acceleration changes, until the speed controller compensates.", sizes={"factor": 0.6}),
)
def torque_feedforward(change: Change, axis: Axis, factor: float) -> None:
    """Torque feedforward weight off nominal.

    a_t = factor x nominal: the speed controller has to supply the missing (1 - a_t) J_ff a. Source: paper, section 2.
    """
    change.scale(axis, torque_feedforward=factor)


@effect(
    block="speed controller",
    parameters=(factor_of("speed_gain_nm_s_per_rad", 0.2, 2.5, (0.6, 1.4)),),
    separating_move="chirp",
    rivals="A current filter or a wrong integral time also changes the disturbance response; a chirp distinguishes them by frequency.",
    picture=Picture("Larger errors at reversals and jerks; no error at constant speed.", "reversal", sizes={"factor": 0.65}),
)
def speed_gain(change: Change, axis: Axis, factor: float) -> None:
    """Speed controller gain off nominal.

    Kp = factor x nominal; Kp / Tn follows. Source: drive datum MD1407.
    """
    change.scale(axis, speed_gain_nm_s_per_rad=factor)


@effect(
    block="speed controller",
    axes="integral",
    parameters=(factor_of("speed_integral_time_s", 0.3, 10.0, (0.5, 2.2)),),
    separating_move="chirp",
    rivals="A wrong speed gain acts at once, the integral time only some milliseconds after a disturbance.",
    picture=Picture("The friction step at a reversal is compensated more slowly.", "reversal", sizes={"factor": 2.0}),
)
def speed_integral_time(change: Change, axis: Axis, factor: float) -> None:
    """Integral time of the speed controller off nominal.

    Tn = factor x nominal. Source: drive datum MD1409.
    """
    change.scale(axis, speed_integral_time_s=factor)


@effect(
    block="speed controller",
    parameters=(
        Parameter(
            "time_constant_s", "time", 0.0, 0.005, (0.5e-3, 1.5e-3), neutral=0.0, logarithmic=True, lag_cycle="current_cycle",
            normal_size=lambda m, a: m.current_cycle,  # a drive computes and holds its voltage for about that long
        ),
    ),
    separating_move="chirp",
    rivals="A loop delay is constant over frequency; the filter reduces the phase mainly above 100 Hz.",
    picture=Picture("The speed loop loses phase margin and rings at a reversal.", "reversal", sizes={"time_constant_s": 1.5e-3}),
)  # fmt: skip
def current_filter(change: Change, axis: Axis, time_constant_s: float) -> None:
    """First-order lag on the current set point.

    y += (i* - y)(1 - exp(-Ti / T)) at every current cycle: phase lag in the speed loop. Source: current set point filters
    of the drive (611D has four).
    """
    change.add_term(lagged, CURRENT, axis, [-math.expm1(-change.machine.current_cycle / time_constant_s), X_CURRENT_SETPOINT])


def _usual_limit(machine: Machine, axis: Axis) -> tuple[float, float]:
    # the holding current is not available for acceleration
    holding = abs(held_force(machine, axis)) * axis.ratio / axis.motor.torque_constant_nm_per_a
    return (holding + 0.1 * axis.motor.peak_current_a, 0.5 * axis.motor.peak_current_a)


@effect(
    block="speed controller",
    parameters=(
        Parameter(
            "limit_a", "current", 1e-6, 1e9, _usual_limit, neutral=math.inf, logarithmic=True,
            scan="largest current", any_size=True,
        ),
    ),
    separating_move="accelerations",
    rivals="No other effect clips the current at one level in both directions.",
    picture=Picture("The current is clipped; the axis lags and catches up.", sizes={"limit_a": 9.5}),
)  # fmt: skip
def current_limit(change: Change, axis: Axis, limit_a: float) -> None:
    """Current limit below the data sheet.

    i* = clip(i*, +-limit_a): the axis does not reach its acceleration and the following error grows. Source: drive power
    module derating.
    """
    change.set(axis, peak_current_a=min(limit_a, axis.motor.peak_current_a))
