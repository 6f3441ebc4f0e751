"""Bring two traces onto common rows by their set points: recordings start at different times, and feeds differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.errors import InputError
from twin.recordings.trace import Trace

SAME_SETPOINT = 2e-6
"""Set points that differ by less are the same: rounding and interpolation of recordings [m, rad]."""

SAME_LENGTH = 1e-3
"""Relative difference of two path lengths up to which the paths can be the same."""

MOVES = 1e-7
"""A set point that changes by less from sample to sample stands still [m, rad]."""

TIME, PATH = "time since the first motion", "way along the set points"


def aligned(a: Trace, b: Trace) -> tuple[Trace, Trace, str]:
    """Both traces on the rows of the first, and how they were aligned (TIME or PATH).

    Where the set points agree after a shift in time, that shift is taken; where the path is the same and the feed is not, rows are
    matched by the length of path that the set points have covered. Raises InputError where the set points follow different paths.
    """
    axes = [axis for axis in a.axes if axis in b.axes and a.has(axis, "setpoint") and b.has(axis, "setpoint")]
    if not axes:
        raise InputError("the two have no axis with set points in common; they cannot be aligned")
    first, second = a.matrix("setpoint", axes), b.matrix("setpoint", axes)
    shift = _start(b.time, second) - _start(a.time, first)
    for candidate in _shifts(a.time, first, b.time, second, shift):
        inside = (a.time + candidate >= b.time[0] - 1e-9) & (a.time + candidate <= b.time[-1] + 1e-9)
        if inside.sum() < 2:
            continue
        at = a.time[inside] + candidate
        difference = np.column_stack([np.interp(at, b.time, column) for column in second.T]) - first[inside]
        if np.abs(difference).max() <= SAME_SETPOINT:
            return _rows(a, inside), _at(b, b.time, at, a.time[inside]), TIME
    way_a, way_b = _way(first), _way(second)
    if way_a[-1] <= 0.0 or abs(way_b[-1] / way_a[-1] - 1.0) > SAME_LENGTH:
        raise InputError(
            f"set points of {way_a[-1]:.4g} and {way_b[-1]:.4g} m (or rad) of path are not the same motion; compare runs of the same program"
        )
    moving = np.concatenate([[True], np.diff(way_a) > 0.0])
    moving_b = np.concatenate([[True], np.diff(way_b) > 0.0])
    at = np.interp(way_a[moving] * (way_b[-1] / way_a[-1]), way_b[moving_b], b.time[moving_b])
    apart = np.column_stack([np.interp(at, b.time, column) for column in second.T]) - first[moving]
    if np.abs(apart).max() > 1e3 * SAME_SETPOINT:
        raise InputError("the set points follow different paths of the same length; compare runs of the same program")
    return _rows(a, moving), _at(b, b.time, at, a.time[moving]), PATH


def _start(time: np.ndarray, setpoints: np.ndarray) -> float:
    """Time [s] of the last sample at rest before the first motion."""
    moving = np.flatnonzero(np.abs(np.diff(setpoints, axis=0)).max(axis=1) > MOVES)
    return float(time[moving[0] if moving.size else 0])


def _shifts(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray, near: float) -> list[float]:
    """Shifts in time [s] to try: none, that of the first motion, and that with the smallest difference within a sample of it."""
    period = float(time_a[1] - time_a[0])
    fine = near + np.linspace(-1.0, 1.0, 41) * max(period, float(time_b[1] - time_b[0]))
    fastest = int(np.argmax(np.ptp(a, axis=0)))
    cost = [np.abs(np.interp(time_a + s, time_b, b[:, fastest]) - a[:, fastest]).sum() for s in fine]
    return [0.0, near, float(fine[int(np.argmin(cost))])]


def _way(setpoints: np.ndarray) -> np.ndarray:
    """Length of path covered up to each sample (sample,), lengths and angles taken alike [m, rad]."""
    steps = np.linalg.norm(np.diff(setpoints, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.where(steps > MOVES, steps, 0.0))])


def _rows(trace: Trace, keep: np.ndarray) -> Trace:
    return replace(trace, time=trace.time[keep], signals={key: values[keep] for key, values in trace.signals.items()})


def _at(trace: Trace, own_time: np.ndarray, at: np.ndarray, time: np.ndarray) -> Trace:
    """The trace read at its own times `at`, on the time base `time`."""
    return replace(trace, time=time, signals={key: np.interp(at, own_time, values) for key, values in trace.signals.items()})
