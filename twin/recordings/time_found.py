"""Time of a recording whose file does not state it: a column that increases evenly, an interval that the speeds show, or none.

v = k dx/dt: if the time is in another unit, or only counts rows, k shows it. Of the pairs of time and speed units that explain k the usual one is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.recordings.relations import even_step
from twin.recordings.signals import Column, Recording, Signal
from twin.recordings.units_found import FASTEST_S, SLOWEST_S, interval_of_rows, surprise_of
from twin.units import RECORDED_UNITS

OTHER_UNIT = 0.5
"""Surprise of a unit of time that the file's numbers do not suggest."""


@dataclass(frozen=True)
class TimeFound:
    """Time of the map: `column` and `unit`, or `interval_s`; neither: unknown. `text` says why, `question` what to confirm."""

    column: str = ""
    unit: str = ""
    interval_s: float | None = None
    text: str = ""
    question: str = ""

    @property
    def known(self) -> bool:
        """False if the interval must be given."""
        return bool(self.column) or self.interval_s is not None


UNKNOWN = TimeFound(
    text="no time: neither a column nor a line of the file gives it",
    question="how far apart are the samples? give it with --interval-ms",
)


@dataclass(frozen=True)
class _Scaled:
    """A column times a factor, without reading it."""

    column: Column
    factor: float

    def __len__(self) -> int:
        return len(self.column)

    def __getitem__(self, rows: slice, /) -> np.ndarray:
        return np.asarray(self.column[rows], float) * self.factor


def time_of(recordings: Sequence[Recording]) -> TimeFound | None:
    """What the map must say about the time; None if the files state it."""
    for recording in recordings:
        if recording.source.known and not recording.source.assumed:
            continue
        if recording.source.known:
            source = recording.source
            return TimeFound(source.column, source.unit, None, source.text, source.text if source.unit != "s" else "")
        for signal in recording.signals.values():
            if (step := even_step(signal.head)) is not None and not _counts_rows(signal.head):
                unit = "ms" if step >= SLOWEST_S else "s"
                text = f"'{signal.name}' increases by {step:.4g} a row: taken as the time in {unit}"
                return TimeFound(signal.name, unit, None, text, text)
        return UNKNOWN
    return None


def row_counters(recording: Recording) -> list[str]:
    """Columns that only count rows."""
    return [s.name for s in recording.signals.values() if _counts_rows(s.head)]


def with_time(recordings: Sequence[Recording], time: TimeFound | None) -> list[Recording]:
    """The recordings with the times that were found, where the file does not state them."""
    out = []
    for recording in recordings:
        source, signals = recording.source, dict(recording.signals)
        if time is not None and time.known and (not source.known or (source.assumed and time.column == source.column)):
            # by the unit of the column that the reader took, by another column, or by the interval of the rows
            factor = RECORDED_UNITS[time.unit][1] if time.column else time.interval_s or 0.0
            factor /= RECORDED_UNITS[source.unit][1] if source.known else 1.0
            column = None if source.known or not time.column else signals.pop(time.column, None)
            if source.known or not time.column or column is not None:
                signals = {n: _timed(s, s.time if column is None else column.values, factor) for n, s in signals.items()}
        out.append(replace(recording, signals=signals))
    return out


def by_speed(time: TimeFound, position: str, factor: float, interval: float) -> TimeFound:
    """The time by a speed that is `factor` times the slope of a position in the unit `position`. `interval` [s] of the samples as read so far."""
    if not time.known:
        found = interval_of_rows(position, factor)
        if found is None:
            return time
        text = f"no time in the file: {found[0] * 1e3:g} ms a row, if positions are in {position} and the speed in {found[1]}"
        return TimeFound(interval_s=found[0], text=text, question=f"{text}; if not, give --interval-ms")
    if not time.column:
        return time
    ranked = []
    for unit in ("s", "ms", "us"):
        ratio = RECORDED_UNITS[unit][1] / RECORDED_UNITS[time.unit][1]
        unusual = 4.0 * (not FASTEST_S <= interval * ratio <= SLOWEST_S)
        ranked.append((surprise_of(position, factor * ratio) + unusual + OTHER_UNIT * (unit != time.unit), unit, interval * ratio))
    (best, unit, seconds), (second, *_) = sorted(ranked)[:2]
    text = f"'{time.column}' is taken in {unit} ({seconds * 1e3:.4g} ms a row), as the recorded speed shows"
    return TimeFound(time.column, unit, None, text, "" if second - best >= 1.0 else f"{text}; if not, give --interval-ms")


def _timed(signal: Signal, time: Column | None, factor: float) -> Signal:
    return replace(signal, time=None if time is None or len(time) != len(signal.values) else _Scaled(time, factor))


def _counts_rows(values: np.ndarray) -> bool:
    """True for 0, 1, 2, ... from any number on."""
    return len(values) > 2 and bool(np.all(np.isfinite(values)) and np.all(np.diff(values) == 1.0))
