"""Time of a recording whose file does not state it: a column that increases evenly, an interval that the speeds show, or none.

v = k dx/dt: if the time is in another unit, or only counts rows, k shows it. Of the pairs of time and speed units that explain k the usual one is taken.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.recordings.names import meaning_of
from twin.recordings.relations import even_step
from twin.recordings.signals import BLOCK, Column, Recording, Signal, TimeSource
from twin.recordings.time_column import NO_TIME, numbers_rows
from twin.recordings.units_found import FASTEST_S, SLOWEST_S, interval_of_rows, surprise_of
from twin.units import RECORDED_UNITS, dimension_recorded

OTHER_UNIT = 0.5
"""Surprise of a unit of time that the file's numbers do not suggest."""


UNKNOWN = TimeSource("rows", text=NO_TIME.partition(";")[0], question="how far apart are the samples? give it with --interval-ms")


def time_of(recordings: Sequence[Recording]) -> TimeSource | None:
    """What the map must say about the time; None if the files state it."""
    for recording in recordings:
        if recording.source.known and not recording.source.assumed:
            continue
        if (source := recording.source).known:
            return replace(source, question=source.text if source.unit != "s" else "")
        for signal in recording.signals.values():
            other = signal.stated_unit or (signal.unit and dimension_recorded(signal.unit) != "time") or meaning_of(signal.name) is not None
            if not other and (step := even_step(signal.head)) is not None and not numbers_rows(signal.head):
                unit = "ms" if step >= SLOWEST_S else "s"
                text = f"'{signal.name}' increases by {step:.4g} a row: taken as the time in {unit}"
                return TimeSource("column", signal.name, unit, text=text, question=text)
        return UNKNOWN
    return None


def with_time(recordings: Sequence[Recording], time: TimeSource | None) -> list[Recording]:
    """The recordings with the times that were found, where the file does not state them: those of the first block, which the proposal reads."""
    out = []
    for recording in recordings:
        source, signals = recording.source, dict(recording.signals)
        if time is not None and time.known and (not source.known or (source.assumed and time.column == source.column)):
            # by the unit of the column that the reader took, by another column, or by the interval of the rows
            factor = time.factor / (source.factor if source.known else 1.0)
            column = None if source.known or not time.column else signals.pop(time.column, None)
            if source.known or not time.column or column is not None:
                signals = {n: _timed(s, s.time if column is None else column.values, factor) for n, s in signals.items()}
        out.append(replace(recording, signals=signals))
    return out


def by_speed(time: TimeSource, position: str, factor: float, interval: float) -> TimeSource:
    """The time by a speed that is `factor` times the slope of a position in the unit `position`. `interval` [s] of the samples as read so far."""
    if not time.known:
        found = interval_of_rows(position, factor)
        if found is None:
            return time
        text = f"no time in the file: {found[0] * 1e3:g} ms a row, if positions are in {position} and the speed in {found[1]}"
        return TimeSource("interval", text=text, interval=found[0], question=f"{text}; if not, give --interval-ms")
    if not time.column:
        return time
    ranked = []
    for unit in ("s", "ms", "us"):
        ratio = RECORDED_UNITS[unit][1] / RECORDED_UNITS[time.unit][1]
        unusual = 4.0 * (not FASTEST_S <= interval * ratio <= SLOWEST_S)
        ranked.append((surprise_of(position, factor * ratio) + unusual + OTHER_UNIT * (unit != time.unit), unit, interval * ratio))
    (best, unit, seconds), (second, *_) = sorted(ranked)[:2]
    text = f"'{time.column}' is taken in {unit} ({seconds * 1e3:.4g} ms a row), as the recorded speed shows"
    return replace(time, unit=unit, text=text, question="" if second - best >= 1.0 else f"{text}; if not, give --interval-ms")


def _timed(signal: Signal, time: Column | None, factor: float) -> Signal:
    fits = time is not None and len(time) == len(signal.values)
    return replace(signal, time=np.asarray(time[0:BLOCK], float) * factor if time is not None and fits else None)
