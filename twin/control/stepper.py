"""A stepper motor without position controller: the field turns with the set point and pulls the rotor like a magnetic spring.

    every Tp:   e = m round(s / m) - x                       m: microstep; 0: the field turns without steps
                w* = w*_P + Kv (p / (2 pi) sin(2 pi e / p) - (s - x))          p: four full steps, after which the torque repeats

On an axis with P controllers and a torque as command (structure P/P) this is the torque of the motor,

    T = Kp (w* - w) = T_h sin(2 pi e / p) + D (a_v s' - w),       T_h = Kp Kv p / (2 pi) at the axis,    D = Kp

so the two gains of the axis stand for holding torque and damping: Kp = D, Kv = 2 pi T_h / (p D). Beyond a quarter of p the rotor falls behind and
comes to rest whole periods away: it has lost steps. Within a small part of p the block adds nothing to the P controllers, and the margins are
theirs. A real field pulls without a sampling time: give the axis position and speed cycles as short as its step pulses, and no delays.
Source: Kenjo and Sugawara, Stepping Motors and Their Microprocessor Controls (static torque characteristic, grade B).
"""

import math

from twin.control.block import Block, listed_number, register
from twin.control.number import not_negative, positive
from twin.simulation.loop_terms import SPEED, X_FOLLOWING_ERROR, X_SETPOINT, X_SPEED_SETPOINT, arrays, term

WAVE, MICROSTEP, GAIN = range(3)


@term
def field_pulls_rotor(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """w* of the P controller becomes that of the field; parameters: 2 pi / p, m, Kv."""
    p, _, x = arrays(parameters, state, signals)
    lag = x[axis, X_FOLLOWING_ERROR]
    behind = lag
    if p[MICROSTEP] > 0.0:
        setpoint = x[axis, X_SETPOINT]
        behind += p[MICROSTEP] * math.floor(setpoint / p[MICROSTEP] + 0.5) - setpoint
    x[axis, X_SPEED_SETPOINT] += p[GAIN] * (math.sin(p[WAVE] * behind) / p[WAVE] - lag)


STEPPER = register(
    Block(
        "stepper",
        (
            listed_number("torque_period", "torque_period_m", "torque_period_deg", positive()),
            listed_number("microstep", "microstep_m", "microstep_deg", not_negative(required=False)),
        ),
        SPEED,
        field_pulls_rotor,
        lambda values, _cycles, gain: [2.0 * math.pi / values["torque_period"], values.get("microstep", 0.0), gain],
    )
)
