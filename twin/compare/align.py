"""Align two traces on their set points: recordings start at different times, and feeds differ."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from twin.errors import InputError
from twin.recordings.trace import Trace

SAME_SETPOINT = 2e-6
"""Set points that differ by less count as equal [m, rad]; covers rounding and interpolation of recordings."""

SAME_LENGTH = 1e-3
"""Largest relative difference in length of equal paths."""

MOVES = 1e-7
"""A set point that changes by less per sample is at rest [m, rad]."""

BETTER = 0.2
"""A run is shifted in time if that leaves at most this share of the difference of the set points."""

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
    for shift in _shifts(a.time, first, b.time, second):
        inside, apart = _apart(a.time, first, b.time, second, shift)
        if len(apart) > 1 and np.abs(apart).max() <= SAME_SETPOINT:
            return _at(a, a.time[inside], a.time[inside]), _at(b, a.time[inside] - shift, a.time[inside]), TIME
    length_a, length_b = _path_length(first), _path_length(second)
    if length_a[-1] <= 0.0 or abs(length_b[-1] / length_a[-1] - 1.0) > SAME_LENGTH:
        raise InputError(
            f"the set points cover {length_a[-1]:.4g} and {length_b[-1]:.4g} m (or rad): not the same motion; compare runs of the same program"
        )
    moving = np.concatenate([[True], np.diff(length_a) > 0.0])
    moving_b = np.concatenate([[True], np.diff(length_b) > 0.0])
    at = np.interp(length_a[moving] * (length_b[-1] / length_a[-1]), length_b[moving_b], b.time[moving_b])
    if np.abs(_read(b.time, second, at) - first[moving]).max() > 1e3 * SAME_SETPOINT:
        raise InputError("the set points follow different paths of the same length; compare runs of the same program")
    return _at(a, a.time[moving], a.time[moving]), _at(b, at, a.time[moving]), PATH


def on_clock_of(first: Trace, second: Trace) -> tuple[Trace, float]:
    """The second run, shifted onto the set points of the first, and the shift [s]; shift 0 if none matches or no set points are shared.

    Differences in m and rad have equal weight.
    """
    axes = [axis for axis in first.axes if first.has(axis, "setpoint") and second.has(axis, "setpoint")]
    if not axes or not all(any(trace.moves(axis) for axis in axes) for trace in (first, second)):
        return second, 0.0
    of_both = first.time, first.matrix("setpoint", axes), second.time, second.matrix("setpoint", axes)
    shift = min(_shifts(*of_both), key=lambda shift: _rms_apart(*of_both, shift))
    if shift == 0.0 or _rms_apart(*of_both, shift) > BETTER * _rms_apart(*of_both, 0.0):
        return second, 0.0
    return replace(second, time=second.time + shift), shift


def _shifts(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray) -> Iterator[float]:
    """Time shifts [s] of the second onto the first to try: none, that between the first motions, and the best near the better of both."""
    coarse = (0.0, _start_of_motion(time_a, a) - _start_of_motion(time_b, b))
    yield from coarse
    reach = 2.0 * max(float(time_a[1] - time_a[0]), float(time_b[1] - time_b[0]))

    def cost(shift: float) -> float:
        return _rms_apart(time_a, a, time_b, b, shift)

    best = min(coarse, key=cost)
    yield float(minimize_scalar(cost, bounds=(best - reach, best + reach), method="bounded", options={"xatol": 1e-9}).x)


def _apart(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray, shift: float) -> tuple[np.ndarray, np.ndarray]:
    """Samples of the first that the shifted second covers (sample,), and the difference of the set points there (sample, axis)."""
    at = time_a - shift
    inside = (at >= time_b[0] - 1e-9) & (at <= time_b[-1] + 1e-9)
    return inside, _read(time_b, b, at[inside]) - a[inside]


def _rms_apart(time_a: np.ndarray, a: np.ndarray, time_b: np.ndarray, b: np.ndarray, shift: float) -> float:
    """RMS of that difference; infinite where less than half of the shorter run is covered."""
    _, apart = _apart(time_a, a, time_b, b, shift)
    return float(np.sqrt(np.mean(apart**2))) if len(apart) >= 0.5 * min(len(a), len(b)) else np.inf


def _read(time: np.ndarray, setpoints: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Set points (sample, axis) at other times."""
    return np.column_stack([np.interp(at, time, column) for column in setpoints.T])


def _start_of_motion(time: np.ndarray, setpoints: np.ndarray) -> float:
    """Time [s] of the last sample before the set points (sample, axis) first move; the first time if they never move."""
    moving = np.flatnonzero(np.abs(np.diff(setpoints, axis=0)).max(axis=1) > MOVES)
    return float(time[moving[0] if moving.size else 0])


def _path_length(setpoints: np.ndarray) -> np.ndarray:
    """Path length covered up to each sample (sample,), m and rad added [m, rad]."""
    steps = np.linalg.norm(np.diff(setpoints, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(np.where(steps > MOVES, steps, 0.0))])


def _at(trace: Trace, at: np.ndarray, time: np.ndarray) -> Trace:
    """The trace interpolated at its own times `at`, with the new time base `time`."""
    return replace(trace, time=time, signals={key: np.interp(at, trace.time, values) for key, values in trace.signals.items()})
