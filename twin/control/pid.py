"""What LinuxCNC's `pid` has beside P and FF1: integral, derivative, further feedforward, dead band and limits.

    every Tp:   e' = e without the dead band, within the largest error            e = s - x
                E += e' Tp, unless the output stands at its limit in this direction; within the largest integral
                u = P e' + I E + D (e' - e'(k-1)) / Tp + FF0 s + FF1 s' + FF2 s'' + FF3 s'''      differences over a cycle
                w* = u, within the largest output

P and FF1 are `position_gain_per_s` and `velocity_feedforward` of the axis; a limit of 0 is none. LinuxCNC sends each set point at once: give no
delays. It makes its feedforward of the commands alone, whatever speed of a profile is recorded beside it. Source: LinuxCNC, `pid.c` (grade A).
"""

import math

import numpy as np

from twin.control.block import Block, Cycles, Values, listed_number, register
from twin.control.number import Key, OnControl, Parameter, Units, alike, lengths, not_negative
from twin.simulation.loop_terms import SPEED, X_FOLLOWING_ERROR, X_SETPOINT, X_SPEED_SETPOINT, arrays, term

I_GAIN, D_GAIN, FF0, FF2, FF3, DEAD, MOST_ERROR, MOST_INTEGRAL, MOST_OUTPUT, P_GAIN, CYCLE = range(11)
RUNNING, INTEGRAL, LAST_ERROR, LAST, SLOPE, CURVATURE, AT_LIMIT = range(7)


@term
def pid_beside_p(parameters, state, signals, axis):  # type: ignore[no-untyped-def]
    """w* of the P controller becomes that of `pid`; parameters and state: the names above."""
    p, s, x = arrays(parameters, state, signals)
    e, setpoint = x[axis, X_FOLLOWING_ERROR], x[axis, X_SETPOINT]
    kept = math.copysign(max(abs(e) - p[DEAD], 0.0), e)
    if p[MOST_ERROR] > 0.0:
        kept = min(max(kept, -p[MOST_ERROR]), p[MOST_ERROR])
    if s[RUNNING] == 0.0:
        s[RUNNING], s[LAST_ERROR], s[LAST] = 1.0, kept, setpoint
    if kept * s[AT_LIMIT] <= 0.0:
        s[INTEGRAL] += kept * p[CYCLE]
        if p[MOST_INTEGRAL] > 0.0:
            s[INTEGRAL] = min(max(s[INTEGRAL], -p[MOST_INTEGRAL]), p[MOST_INTEGRAL])
    slope = (setpoint - s[LAST]) / p[CYCLE]
    curvature = (slope - s[SLOPE]) / p[CYCLE]
    jerk = (curvature - s[CURVATURE]) / p[CYCLE]
    u = x[axis, X_SPEED_SETPOINT] + p[P_GAIN] * (kept - e)
    u += p[I_GAIN] * s[INTEGRAL] + p[D_GAIN] * (kept - s[LAST_ERROR]) / p[CYCLE]
    u += p[FF0] * setpoint + p[FF2] * curvature + p[FF3] * jerk
    s[LAST_ERROR], s[LAST], s[SLOPE], s[CURVATURE], s[AT_LIMIT] = kept, setpoint, slope, curvature, 0.0
    if p[MOST_OUTPUT] > 0.0 and abs(u) > p[MOST_OUTPUT]:
        s[AT_LIMIT] = math.copysign(1.0, u)
        u = s[AT_LIMIT] * p[MOST_OUTPUT]
    x[axis, X_SPEED_SETPOINT] = u


TERMS = ("integral", "feedforward_2", "derivative", "feedforward_3", "feedforward_0")
"""Numbers to which u is proportional, beside P and FF1."""


def recorded_terms(error: np.ndarray, setpoint: np.ndarray, slopes: np.ndarray, cycle: float) -> np.ndarray:
    """Columns (cycle, term) of TERMS over recorded signals: e', s, and s' of this cycle and the two before it (3, cycle)."""
    curvature, before = -np.diff(slopes, axis=0) / cycle
    derivative = np.diff(error, prepend=error[:1]) / cycle
    return np.column_stack([np.cumsum(error) * cycle, curvature, derivative, (curvature - before) / cycle, setpoint])


def _constants(values: Values, cycles: Cycles, gain: float) -> list[float]:
    return [*(values.get(n.name, 0.0) for n in NUMBERS), gain, cycles.position_cycle]


def _linear(values: Values, cycles: Cycles, _gain: float) -> tuple[np.ndarray, np.ndarray]:
    """I Tp / (1 - z^-1) + D (1 - z^-1) / Tp, inside the dead band's ends and the limits."""
    i, d, cycle = values.get("integral", 0.0), values.get("derivative", 0.0), cycles.position_cycle
    if i == 0.0:
        return np.array([d / cycle, -d / cycle]), np.array([1.0, 0.0])
    return np.array([i * cycle + d / cycle, -2.0 * d / cycle, d / cycle]), np.array([1.0, -1.0, 0.0])


def _number(name: str, key: str, rotary: str, datum: str, units: Units, bounds: Key | None = None) -> Parameter:
    return listed_number(name, key, rotary, bounds or not_negative(required=False), {"linuxcnc": OnControl(datum, *units)})


_ANY = Key(-1e6, 1e6, required=False)
NUMBERS = (
    _number("integral", "integral_gain_per_s2", "integral_gain_per_s2", "I", alike("1/s2")),
    _number("derivative", "derivative_gain", "derivative_gain", "D", alike("1")),
    _number("feedforward_0", "position_feedforward_per_s", "position_feedforward_per_s", "FF0", alike("1/s"), _ANY),
    _number("feedforward_2", "acceleration_feedforward_s", "acceleration_feedforward_s", "FF2", alike("s"), _ANY),
    _number("feedforward_3", "jerk_feedforward_s2", "jerk_feedforward_s2", "FF3", alike("s2"), _ANY),
    _number("dead_band", "dead_band_m", "dead_band_deg", "DEADBAND", lengths()),
    _number("largest_error", "largest_error_m", "largest_error_deg", "MAX_ERROR", lengths()),
    _number("largest_integral", "largest_integral_m_s", "largest_integral_deg_s", "MAX_ERROR_I", lengths(" s")),
    _number("largest_output", "largest_output_m_per_s", "largest_output_deg_per_s", "MAX_OUTPUT", lengths("/s")),
)

STRENGTHS = tuple((name,) for name in ("integral", "derivative", "feedforward_0", "feedforward_2", "feedforward_3", "dead_band"))
PID = register(
    Block("pid", NUMBERS, SPEED, pid_beside_p, _constants, linear=_linear, strengths=STRENGTHS, replaces=("velocity_feedforward",))
)
