"""Two runs on one clock: the second is shifted in time until its set points lie on those of the first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from twin.recordings.trace import Trace

MOVES = 1e-7
"""A set point that changes by less from sample to sample stands still [m, rad]."""
BETTER = 0.2
"""The shift counts where it leaves at most this share of the difference of the set points."""


def on_clock_of(first: Trace, second: Trace) -> tuple[Trace, float]:
    """The second run with its times shifted onto the first one's set points, and by how much [s]; unshifted where that does not help.

    Lengths and angles are taken alike [m, rad]; runs without common set points stay as they are.
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

    near = _start(first, asked) - _start(second, other)
    reach = 2.0 * max(first.period, second.period)
    coarse = min((0.0, near), key=apart)
    shift = float(minimize_scalar(apart, bounds=(coarse - reach, coarse + reach), method="bounded", options={"xatol": 1e-9}).x)
    shift = shift if apart(shift) < apart(coarse) else coarse
    if shift == 0.0 or apart(shift) > BETTER * apart(0.0):
        return second, 0.0
    return replace(second, time=second.time + shift), shift


def _moves(trace: Trace, axes: list[str]) -> bool:
    return any(trace.moves(axis) for axis in axes)


def _start(trace: Trace, setpoints: np.ndarray) -> float:
    """Time [s] of the last sample before the first motion."""
    return float(trace.time[np.flatnonzero(np.abs(np.diff(setpoints, axis=0)).max(axis=1) > MOVES)[0]])
