"""Friction compensation: a pulse on the speed set point when an axis reverses (SINUMERIK MD32500, conventional, characteristic off).

    every Tp:   v = (s(k) - s(k-1)) / Tp                     s: set point of the position controller, u: its speed set point
                p = p exp(-Tp / T)
                if v != 0 and sign(u) = sign(v) and sign(v) != d:   d = sign(v);  p = A d
                w* = u + p                                    d = 0 at the start of a run

A new pulse replaces the old one. A start in the direction of the last motion makes none. Measured in a recording of an 840D sl:
A = 7 to 15 mm/min, T = 15 to 20 ms, five of five pulses at their exact cycle.
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled_functions import compiled
from twin.control.block import Block, Cycles, Number, Values, register
from twin.control.number import positive
from twin.simulation.loop_terms import SPEED, X_SETPOINT, X_SPEED_SETPOINT, arrays, term

STILL = 1e-11
"""Smallest step of the set point that counts as motion [m, rad]: above the rounding of a spline, below 1 um/s in any cycle."""


@compiled(inline=True)
def next_pulse(pulse, direction, step, output, amplitude, decay):  # type: ignore[no-untyped-def]
    """(pulse, direction) of this position cycle, from the step of the set point and the speed set point without the pulse."""
    pulse *= decay
    if abs(step) > STILL and step * output > 0.0 and step * direction <= 0.0:
        direction = math.copysign(1.0, step)
        pulse = amplitude * direction
    return pulse, direction


@term
def pulse_at_reversal(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """w* += pulse; parameters: amplitude, decay in a cycle; state: set point, pulse, direction, 1 after the first cycle."""
    p, s, x = arrays(parameters, state, signals)
    if s[3] == 0.0:
        s[0] = x[axis, X_SETPOINT]
        s[3] = 1.0
    step = x[axis, X_SETPOINT] - s[0]
    s[0] = x[axis, X_SETPOINT]
    s[1], s[2] = next_pulse(s[1], s[2], step, x[axis, X_SPEED_SETPOINT], p[0], p[1])
    x[axis, X_SPEED_SETPOINT] += s[1]


@compiled(allocates=True)
def _pulses(setpoint, output, amplitude, decay):  # type: ignore[no-untyped-def]
    out = np.zeros(len(setpoint))
    pulse, direction = 0.0, 0.0
    for k in range(1, len(setpoint)):
        pulse, direction = next_pulse(pulse, direction, setpoint[k] - setpoint[k - 1], output[k], amplitude, decay)
        out[k] = pulse
    return out


def pulses(values: Values, setpoint: np.ndarray, output: np.ndarray, cycle: float) -> np.ndarray:
    """The pulses (sample,) [m/s, rad/s] from the recorded set point and the speed set point without them, one sample a position cycle."""
    return _pulses(setpoint, output, values["amplitude"], math.exp(-cycle / values["decay_time"]))


def _constants(values: Values, cycles: Cycles) -> list[float]:
    return [values["amplitude"], math.exp(-cycles.position_cycle / values["decay_time"])]


FRICTION_PULSE = register(
    Block(
        "friction_pulse",
        "a pulse on the speed set point at each reversal",
        (
            Number(
                "amplitude", "amplitude_m_per_min", "amplitude_rev_per_min", positive(),
                {"sinumerik": ("MD32520 FRICT_COMP_CONST_MAX", "mm/min, rev/min", 1e-3)},
            ),
            Number("decay_time", "decay_time_s", "decay_time_s", positive(), {"sinumerik": ("MD32540 FRICT_COMP_TIME", "s", 1.0)}),
        ),
        SPEED,
        pulse_at_reversal,
        _constants,
        recorded=pulses,
        replaces=("velocity_feedforward",),
    )
)  # fmt: skip
