"""Recordings of a server that sends a value only when it changes (OPC UA, historians): each value holds until the next one.

Such a signal has no two equal values in a row, and others have samples where it has none. Lost samples are missing in all signals at once.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from twin.recordings.channels import MOST_ROWS
from twin.recordings.signals import Recording, Signal
from twin.recordings.timing import LONGER

MOST_SAMPLES = 1 << 22
"""A larger recording is not looked at: its times would fill the memory."""
LIKE, SELDOM = 3.0, 0.1
"""A value changes over a rest by no more than this multiple of the changes beside it, with few exceptions; over lost samples it moves on."""
OFF_GRID = 0.05
"""Largest distance of a time from the even grid of a server that samples all values, in intervals."""


def with_values_held(recording: Recording) -> Recording:
    """The recording with a sample of each signal at each interval of the server, where it sent only changes."""
    own = {name: s for name, s in recording.signals.items() if len(s.time) and len(s.values) > 1}
    several = len({id(s.time) for s in own.values()}) > 1 and sum(len(s.values) for s in own.values()) < MOST_SAMPLES
    if not several or not recording.source.known or recording.restarts:
        return recording
    times = {name: np.asarray(s.time[0 : len(s.values)], float) for name, s in own.items()}
    at = np.unique(np.concatenate([*times.values()]))
    interval = float(np.median(np.diff(at)))
    rows = np.rint((at - at[0]) / interval)
    on_grid = np.all(np.abs(at - at[0] - rows * interval) < OFF_GRID * interval)
    if rows[-1] >= MOST_ROWS or not on_grid or not _sends_changes(own, times, at):
        return recording
    grid = at[0] + interval * np.arange(int(rows[-1]) + 1)
    held = {name: _held(s, times[name], grid, OFF_GRID * interval) for name, s in own.items()}
    note = f"values are sent when they change: each holds until the next one, every {interval * 1e3:.4g} ms"
    return replace(recording, signals={**recording.signals, **held}, notes=(*recording.notes, note))


def _sends_changes(own: Mapping[str, Signal], times: Mapping[str, np.ndarray], at: np.ndarray) -> bool:
    """Whether the signals with gaps never repeat a value and hardly change over a gap, and others have samples within these gaps."""
    alone = False
    for name, time in times.items():
        step = float(np.median(np.diff(time)))
        gaps = np.flatnonzero(np.diff(time) > LONGER * step)
        changes = np.abs(np.diff(np.asarray(own[name].values[0 : len(time)], float)))
        beside = np.maximum(changes[np.maximum(gaps - 1, 0)], changes[np.minimum(gaps + 1, len(changes) - 1)])
        if len(gaps) and (np.any(changes == 0.0) or np.mean(changes[gaps] > LIKE * beside) > SELDOM):
            return False
        # not within a step of its own, since the last sample before lost ones may be that of a faster signal
        within = np.searchsorted(at, time[gaps + 1] - step) - np.searchsorted(at, time[gaps] + step, "right")
        alone |= bool(np.any(within > 0))
    return alone


def _held(signal: Signal, time: np.ndarray, grid: np.ndarray, tolerance: float) -> Signal:
    """A signal at the times of a grid from its first sample on, with the last value sent."""
    grid = grid[grid >= time[0] - tolerance]
    values = np.asarray(signal.values[0 : len(time)], float)
    return replace(signal, values=values[np.searchsorted(time, grid + tolerance, "right") - 1], time=grid)
