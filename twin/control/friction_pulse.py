"""Friction compensation: a pulse on the speed set point when an axis reverses (SINUMERIK MD32500, conventional).

    every Tp:   v = (s(k) - s(k-1)) / Tp,   a = |v(k) - v(k-1)| / Tp      s: set point of the feedforward, u: speed set point
                p = p exp(-Tp / T)
                if v != 0 and sign(u) = sign(v) and sign(v) != d:   d = sign(v);  p = A(a) d
                w* = u + p                                    d = 0 at the start of a run
    A(a) = A a / a1 below a1,  A from a1 to a2,  a straight line from A to A_low between a2 and a3,  A_low above a3

A number of the characteristic that is 0 is off; with all off the pulse has its full amplitude A. A new pulse replaces the old one. A start in
the direction of the last motion makes none. Measured in a recording of an 840D sl: A = 7 to 15 mm/min, T = 15 to 20 ms, five of five pulses
at their exact cycle, characteristic off. Source of A(a): SINUMERIK Extended Functions K3 (MD32510 to MD32570).
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled_functions import compiled
from twin.control.block import Block, Cycles, Values, listed_number, register
from twin.control.number import OnControl, alike, not_negative, positive
from twin.simulation.loop_terms import SPEED, X_FED_STEP, X_SPEED_SETPOINT, arrays, term

STILL = 1e-11
"""Smallest step of the set point that counts as motion [m, rad]: above the rounding of a spline, below 1 um/s in any cycle."""


@compiled(inline=True)
def amplitude_at(p, acceleration):  # type: ignore[no-untyped-def]
    """A(a); p[2:6]: A_low, a1, a2, a3, the accelerations as changes of the step of the set point in a cycle."""
    if acceleration < p[3]:
        return p[0] * acceleration / p[3]
    if p[5] <= 0.0 or acceleration <= p[4]:
        return p[0]
    return p[0] + (p[2] - p[0]) * min((acceleration - p[4]) / (p[5] - p[4]), 1.0) if p[5] > p[4] else p[2]


@compiled(inline=True)
def next_pulse(p, pulse, direction, step, before, output):  # type: ignore[no-untyped-def]
    """(pulse, direction) of this position cycle, from the last two steps of the set point and the speed set point without the pulse."""
    pulse *= p[1]
    if abs(step) > STILL and step * output > 0.0 and step * direction <= 0.0:
        direction = math.copysign(1.0, step)
        pulse = amplitude_at(p, abs(step - before)) * direction
    return pulse, direction


@term
def pulse_at_reversal(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """w* += pulse; parameters: `_constants`; state: pulse, direction, last step."""
    p, s, x = arrays(parameters, state, signals)
    s[0], s[1] = next_pulse(p, s[0], s[1], x[axis, X_FED_STEP], s[2], x[axis, X_SPEED_SETPOINT])
    s[2] = x[axis, X_FED_STEP]
    x[axis, X_SPEED_SETPOINT] += s[0]


def since_reversal(setpoint: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direction d and cycles since its pulse began (cycle,), from recorded set points and speed set points without the pulse; d = 0 before the first."""
    step = np.diff(setpoint, prepend=setpoint[:1])
    towards = np.sign(step) * ((np.abs(step) > STILL) & (step * output > 0.0))
    at = np.arange(len(step))
    direction = towards[np.maximum.accumulate(np.where(towards != 0.0, at, 0))]
    began = np.maximum.accumulate(np.where(np.diff(direction, prepend=0.0) != 0.0, at, 0))
    return direction, (at - began).astype(float)


def _constants(values: Values, cycles: Cycles, _gain: float) -> list[float]:
    """A, decay in a cycle, A_low, a1, a2, a3 as changes of a step."""
    cycle = cycles.position_cycle
    characteristic = [values.get(name, 0.0) * cycle**2 for name in ("acceleration_1", "acceleration_2", "acceleration_3")]
    return [values["amplitude"], math.exp(-cycle / values["decay_time"]), values.get("amplitude_low", 0.0), *characteristic]


_SPEED = ("mm/min", "rev/min"), (1e-3 / 60.0, 2.0 * math.pi / 60.0)
_ACCELERATION = ("m/s2", "rev/s2"), (1.0, 2.0 * math.pi)
_OPTIONAL = not_negative(required=False)


def _on_sinumerik(name: str, units: tuple[str, str], si: tuple[float, float], grade: str = "A") -> dict[str, OnControl]:
    return {"sinumerik": OnControl(name, units, si, grade)}


FRICTION_PULSE = register(
    Block(
        "friction_pulse",
        (
            listed_number("amplitude", "amplitude_m_per_min", "amplitude_rev_per_min", positive(), _on_sinumerik("MD32520 FRICT_COMP_CONST_MAX", *_SPEED)),
            listed_number("decay_time", "decay_time_s", "decay_time_s", positive(), _on_sinumerik("MD32540 FRICT_COMP_TIME", *alike("s"), "C")),
            listed_number("amplitude_low", "amplitude_low_m_per_min", "amplitude_low_rev_per_min", _OPTIONAL, _on_sinumerik("MD32530 FRICT_COMP_CONST_MIN", *_SPEED)),
            *(
                listed_number(
                    f"acceleration_{i}", f"acceleration_{i}_m_per_s2", f"acceleration_{i}_rev_per_s2", _OPTIONAL,
                    _on_sinumerik(f"MD325{40 + 10 * i} FRICT_COMP_ACCEL{i}", *_ACCELERATION),
                )
                for i in (1, 2, 3)
            ),
        ),
        SPEED,
        pulse_at_reversal,
        _constants,
        strengths=(("amplitude", "amplitude_low"),),
        replaces=("velocity_feedforward",),
    )
)  # fmt: skip
