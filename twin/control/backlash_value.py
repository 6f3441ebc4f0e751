"""Backlash value: the controller uses x - (b/2) d, d the direction of the set point (SINUMERIK MD32450, LinuxCNC BACKLASH).

    every Tp:   if s(k) - s(k-1) != 0:  d = its sign
                c += clip((b/2) d - c, +- b / n)              worked off in n equal steps (MD32450 / MD36500)
                s += c

A shift of the actual position and the opposite one of the set point are the same to a proportional position controller; the speed
feedforward does not see it. Right where the loop closes on the motor encoder; with a scale in the loop it displaces the table.
Source: SINUMERIK Extended Functions K3 (MD32450, MD36500).
"""

import math

from twin.control.block import Block, Cycles, Values, listed_number, register
from twin.control.friction_pulse import STILL
from twin.control.number import Key, OnControl, lengths, positive
from twin.simulation.loop_terms import SETPOINT, X_SETPOINT, arrays, term


@term
def shifted_by_direction(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """s += c; parameters: b/2, step; state: shift, its target, last set point, 1 after the first cycle."""
    p, s, x = arrays(parameters, state, signals)
    if s[3] == 0.0:
        s[2] = x[axis, X_SETPOINT]
        s[3] = 1.0
    step = x[axis, X_SETPOINT] - s[2]
    s[2] = x[axis, X_SETPOINT]
    if step > STILL:
        s[1] = p[0]
    elif step < -STILL:
        s[1] = -p[0]
    s[0] += min(max(s[1] - s[0], -p[1]), p[1])
    x[axis, X_SETPOINT] += s[0]


def _constants(values: Values, cycles: Cycles, _gain: float) -> list[float]:
    return [0.5 * values["width"], abs(values["width"]) / max(round(values["cycles"]), 1)]


BACKLASH_VALUE = register(
    Block(
        "backlash_value",
        (
            listed_number(
                "width", "width_m", "width_deg", Key(-10.0, 10.0),
                {
                    "sinumerik": OnControl("MD32450 BACKLASH", *lengths()),
                    "heidenhain": OnControl("MP710", *lengths()),
                    "linuxcnc": OnControl("BACKLASH", *lengths()),
                    "isg": OnControl("getriebe[0].lose", ("0.1 um", "0.0001 deg"), (1e-7, math.radians(1e-4))),
                },
            ),
            listed_number("cycles", "cycles", "cycles", positive()),
        ),
        SETPOINT,
        shifted_by_direction,
        _constants,
        strengths=(("width",),),
    )
)  # fmt: skip
