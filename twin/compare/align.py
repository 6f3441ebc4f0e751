"""Align two traces on their set points: recordings start at different times, and feeds differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from twin.errors import InputError
from twin.recordings.trace import Trace

SAME_SETPOINT = 2e-6
"""Set points that differ by less count as equal [m, rad]; covers rounding and interpolation of recordings."""

SAME_LENGTH = 1e-3
"""Largest relative difference in length of equal paths."""

MOVES = 1e-7
"""A set point that changes by less per sample is at rest [m, rad]."""

TIME, PATH = "time since the first motion", "path length of the set points"


def aligned(a: Trace, b: Trace) -> tuple[Trace, Trace, str]:
    """Both traces on rows of the first, and the method of alignment (TIME or PATH).

    If the set points agree after a time shift, the second trace is shifted. If they follow the same path at another feed, rows are
    matched by path length. Raises InputError if the paths differ.
    """
    axes = [axis for axis in a.axes if axis in b.axes and a.has(axis, "setpoint") and b.has(axis, "setpoint")]
    if not axes:
        raise InputError("no axis has set points in both; compare traces with set points of the same axis")
    first, second = a.matrix("setpoint", axes), b.matrix("setpoint", axes)
    shift = start_of_motion(b.time, second) - start_of_motion(a.time, first)
    for candidate in _shifts(a.time, first, b.time, second, shift):
        inside = (a.time + candidate >= b.time[0] - 1e-9) & (a.time + candidate <= b.time[-1] + 1e-9)
        if inside.sum() < 2:
            continue
        at = a.time[inside] + candidate
        difference = np.column_stack([np.interp(at, b.time, column) for column in second.T]) - first[inside]
        if np.abs(difference).max() <= SAME_SETPOINT:
            return _rows(a, inside), _at(b, b.time, at, a.time[inside]), TIME
    length_a, length_b = _path_length(first), _path_length(second)
    if length_a[-1] <= 0.0 or abs(length_b[-1] / length_a[-1] - 1.0) > SAME_LENGTH:
        raise InputError(
            f"the set points cover {length_a[-1]:.4g} and {length_b[-1]:.4g} m (or rad): not the same motion; compare runs of the same program"
        )
    moving = np.concatenate([[True], np.diff(length_a) > 0.0])
    moving_b = np.concatenate([[True], np.diff(length_b) > 0.0])
    at = np.interp(length_a[moving] * (length_b[-1] / length_a[-1]), length_b[moving_b], b.time[moving_b])
    apart = np.column_stack([np.interp(at, b.time, column) for column in second.T]) - first[moving]
    if np.abs(apart).max() > 1e3 * SAME_SETPOINT:
        raise InputError("the set points follow different paths of the same length; compare runs of the same program")
    return _rows(a, moving), _at(b, b.time, at, a.time[moving]), PATH


def start_of_motion(time: np.ndarray, setpoints: np.ndarray) -> float:
    """Time [s] of the last sample before the set points (sample, axis) first move; the first time if they never move."""
    moving = np.flatnonzero(np.abs(np.diff(setpoints, axis=0)).max(axis=1) > MOVES)
    return float(time[moving[0] if moving.size else 0])


def _shifts(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray, near: float) -> list[float]:
    """Time shifts [s] to try: none, that between the first motions, and the best within one sample of it."""
    period = float(time_a[1] - time_a[0])
    fine = near + np.linspace(-1.0, 1.0, 41) * max(period, float(time_b[1] - time_b[0]))
    fastest = int(np.argmax(np.ptp(a, axis=0)))
    cost = [np.abs(np.interp(time_a + s, time_b, b[:, fastest]) - a[:, fastest]).sum() for s in fine]
    return [0.0, near, float(fine[int(np.argmin(cost))])]


def _path_length(setpoints: np.ndarray) -> np.ndarray:
    """Path length covered up to each sample (sample,), m and rad added [m, rad]."""
    steps = np.linalg.norm(np.diff(setpoints, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.where(steps > MOVES, steps, 0.0))])


def _rows(trace: Trace, keep: np.ndarray) -> Trace:
    return replace(trace, time=trace.time[keep], signals={key: values[keep] for key, values in trace.signals.items()})


def _at(trace: Trace, own_time: np.ndarray, at: np.ndarray, time: np.ndarray) -> Trace:
    """The trace interpolated at its own times `at`, with the new time base `time`."""
    return replace(trace, time=time, signals={key: np.interp(at, own_time, values) for key, values in trace.signals.items()})
