"""Put two runs on one clock: shift the second in time until its set points match those of the first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from twin.compare.align import start_of_motion
from twin.recordings.trace import Trace

BETTER = 0.2
"""A shift is used if it leaves at most this share of the difference of the set points."""


def on_clock_of(first: Trace, second: Trace) -> tuple[Trace, float]:
    """The second run, shifted onto the set points of the first, and the shift [s]; shift 0 if none matches or no set points are shared.

    Differences in m and rad have equal weight.
    """
    axes = [axis for axis in first.axes if first.has(axis, "setpoint") and second.has(axis, "setpoint")]
    if not axes or not all(_moves(trace, axes) for trace in (first, second)):
        return second, 0.0
    asked, other = first.matrix("setpoint", axes), second.matrix("setpoint", axes)

    def apart(shift: float) -> float:
        at = first.time - shift
        inside = (at >= second.time[0]) & (at <= second.time[-1])
        if inside.sum() < 0.5 * min(len(first.time), len(second.time)):
            return np.inf
        read = np.column_stack([np.interp(at[inside], second.time, column) for column in other.T])
        return float(np.sqrt(np.mean((read - asked[inside]) ** 2)))

    near = start_of_motion(first.time, asked) - start_of_motion(second.time, other)
    reach = 2.0 * max(first.period, second.period)
    coarse = min((0.0, near), key=apart)
    shift = float(minimize_scalar(apart, bounds=(coarse - reach, coarse + reach), method="bounded", options={"xatol": 1e-9}).x)
    shift = shift if apart(shift) < apart(coarse) else coarse
    if shift == 0.0 or apart(shift) > BETTER * apart(0.0):
        return second, 0.0
    return replace(second, time=second.time + shift), shift


def _moves(trace: Trace, axes: list[str]) -> bool:
    return any(trace.moves(axis) for axis in axes)
