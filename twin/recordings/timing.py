"""Times of one recorded signal: its interval, its gaps, printed times that are rounded, a clock that jitters.

A stretch is what lies between two gaps. Its samples are taken as evenly spaced, first + k * interval, where the times say so up to
their rounding; where the clock really jitters, the times themselves are used.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import itertools

import numpy as np

from twin.errors import InputError
from twin.recordings.signals import BLOCK, NO_MEASUREMENT, Column
from twin.recordings.trace import RELATIVE_PERIOD_TOLERANCE

LONGER = 1.5
"""A step longer than this many intervals is a gap."""
LONGER_MIXED = 3.5
"""The same where the map asks for a period: intervals may change."""
SHORTEST_S, LONGEST_S = 1e-6, 60.0
"""Intervals that a recording of an axis can have [s]."""
MANY_GAPS = 0.02
"""More gaps than this fraction of the samples: the interval itself changes."""
MEDIAN_OF = 1 << 18
WINDOW = 50
"""Samples over which an interval is looked at where single steps are rounded or jitter."""


@dataclass(frozen=True)
class Stretch:
    """Samples first .. first + count of a signal: begin and interval [s]; `spread` [s] is how far times are off the even grid, `even` whether that is rounding only."""

    first: int
    count: int
    begin: float
    interval: float
    spread: float
    even: bool

    @property
    def end(self) -> float:
        return self.begin + self.interval * (self.count - 1)


@dataclass(frozen=True)
class Timing:
    """Stretches of a signal in order, its interval [s], what was noticed."""

    stretches: tuple[Stretch, ...]
    interval: float
    notes: tuple[str, ...]


def timing_of(time: Column, where: str, period_s: float | None = None) -> Timing:
    """Stretches between gaps. Raises InputError where time stands still, goes back, or the interval changes for good.

    `period_s`: the map asks for this period; then the interval may change, and only steps above LONGER_MIXED times it are gaps.
    """
    n = len(time)
    if n < 2:
        raise InputError(f"{where}: only {n} sample{'s' * (n != 1)}; a trace needs at least two")
    for start in range(0, n, BLOCK):
        fine = np.abs(np.asarray(time[start : start + BLOCK], float)) < NO_MEASUREMENT
        if not fine.all():
            row = start + int(np.argmin(fine))
            raise InputError(f"{where}: the time holds {str(time[row : row + 1][0]).replace('nan', 'NaN')} at row {row + 1}; repair it")
    head = np.asarray(time[0 : min(n, MEDIAN_OF)], float)
    quantum = _quantum(head)
    interval, rounded = _usual_step(head, quantum)
    if interval > LONGEST_S or 0.0 < interval < SHORTEST_S:
        raise InputError(f"{where}: its samples lie {interval:.3g} s apart: no control records like that; correct the unit of the time")
    notes: list[str] = []
    gaps: list[int] = []
    repeated = 0
    limit = (LONGER * interval if period_s is None else LONGER_MIXED * max(interval, period_s)) + (quantum if rounded else 0.0)
    for row, steps in _steps(time):
        if steps.min() < 0.0:
            i = int(np.argmin(steps))
            raise InputError(
                f"{where}: time goes back at row {row + i + 2} ({time[row + i : row + i + 1][0]:.6g} s); "
                "cut the file there, or keep one part with from_s and to_s"
            )
        repeated += int(np.count_nonzero(steps == 0.0))
        gaps += [row + int(i) for i in np.flatnonzero(steps > limit)]
        if len(gaps) > max(MANY_GAPS * n, 20):
            raise _changing(time, gaps[0], interval, where)
    bounds = [0, *(g + 1 for g in gaps), n]
    stretches = []
    for first, last in itertools.pairwise(bounds):
        if last - first >= 2:
            stretches.append(_stretch(time, first, last - first, quantum))
    if not stretches:
        raise InputError(f"{where}: no two samples are near each other in time; check the time column and its unit")
    longest = max(stretches, key=lambda s: s.count)
    if repeated and not all(one.even for one in stretches):
        raise InputError(f"{where}: time stands still at {repeated} rows and no even interval explains it; repair the time column")
    if period_s is None:
        for one in stretches:
            if one.count > 20 and abs(one.interval - longest.interval) > 0.1 * longest.interval:
                raise _changing(time, max(one.first, longest.first) - 1, min(one, longest, key=lambda s: s.first).interval, where)
            if not one.even and (change := _change(time, one, quantum)) is not None:
                raise _changing(time, *change, where)
    if longest.even and rounded:
        notes.append(f"times printed to {quantum * 1e3:.3g} ms; samples are {longest.interval * 1e3:.6g} ms apart")
    elif repeated:
        notes.append(f"time stands still at {repeated} row{'s' * (repeated > 1)}; taken as {longest.interval * 1e3:.6g} ms apart")
    elif not longest.even:
        notes.append(
            f"the clock is off by {0.5 * longest.spread * 1e3:.3g} ms about {longest.interval * 1e3:.4g} ms; brought on an even grid"
        )
    return Timing(tuple(stretches), longest.interval, tuple(notes))


def _steps(time: Column) -> Iterator[tuple[int, np.ndarray]]:
    """(row, steps from it on), in blocks that overlap by one sample."""
    for start in range(0, len(time) - 1, BLOCK):
        yield start, np.diff(np.asarray(time[start : start + BLOCK + 1], float))


def _quantum(times: np.ndarray) -> float:
    """The decimal place (s) on which all times lie: 1e-3 where they are printed to a millisecond; 0 where none is seen above 1e-9."""
    for exponent in range(10):
        scaled = times * 10.0**exponent
        if np.all(np.abs(scaled - np.rint(scaled)) < 1e-3):
            return 10.0**-exponent
    return 0.0


def _usual_step(times: np.ndarray, quantum: float) -> tuple[float, bool]:
    """Interval between samples, and whether printing to the quantum hides it: 1.25 ms printed to 1 ms reads 1, 1, 2, 1 ms."""
    median = float(np.median(np.diff(times)))
    rows = len(times) // WINDOW
    if rows == 0 or quantum == 0.0:
        return median, False
    windows = times[: rows * WINDOW].reshape(rows, WINDOW)
    k = np.arange(WINDOW) - 0.5 * (WINDOW - 1)
    slopes = windows @ k / (k @ k)
    off = windows - slopes[:, None] * k
    spreads = 0.5 * np.ptp(off, axis=1)
    interval = float(np.median(slopes))
    spread = float(np.median(spreads))
    rounded = spread > RELATIVE_PERIOD_TOLERANCE * interval and spread < 0.6 * quantum
    return (interval, True) if rounded and interval > 0.0 else (median, False)


def _stretch(time: Column, first: int, count: int, quantum: float) -> Stretch:
    """Even grid through the samples by least squares; `spread` is half the range of what is left over."""
    start, scale, total, moment = float(time[first : first + 1][0]), 0.5 * (count - 1), 0.0, 0.0
    for at in range(0, count, BLOCK):
        part = np.asarray(time[first + at : first + min(at + BLOCK, count)], float) - start
        total += float(part.sum())
        moment += float(part @ (at + np.arange(len(part)) - scale))
    interval = moment * 12.0 / (count * (float(count) ** 2 - 1.0))
    begin = start + total / count - interval * scale
    spread = _spread(time, first, count, begin, interval)
    # printed times are off by half a digit
    rounded = quantum > 0.0 and spread <= 0.6 * quantum and quantum <= 20.0 * interval
    if spread <= RELATIVE_PERIOD_TOLERANCE * interval or rounded:
        return Stretch(first, count, begin, interval, spread, True)
    # times that count themselves: from the first to the last of them
    interval = (float(time[first + count - 1 : first + count][0]) - start) / (count - 1)
    return Stretch(first, count, start, interval, 2.0 * _spread(time, first, count, start, interval), False)


def _spread(time: Column, first: int, count: int, begin: float, interval: float) -> float:
    """Half the range by which times are off the even grid."""
    low, high = np.inf, -np.inf
    for at in range(0, count, BLOCK):
        part = np.asarray(time[first + at : first + min(at + BLOCK, count)], float)
        off = part - (begin + interval * (at + np.arange(len(part))))
        low, high = min(low, float(off.min())), max(high, float(off.max()))
    return 0.5 * (high - low)


def _change(time: Column, one: Stretch, quantum: float) -> tuple[int, float] | None:
    """The row where the interval changes for good and the interval before; None where the clock only jitters or drifts."""
    usual: float | None = None
    for at in range(0, one.count - WINDOW, WINDOW):
        ends = [float(time[row : row + 1][0]) for row in (one.first + at, one.first + at + WINDOW)]
        here = (ends[1] - ends[0]) / WINDOW
        usual = here if usual is None else usual
        if abs(here - usual) > 0.1 * usual + 2.0 * quantum / WINDOW:
            return one.first + at, usual
    return None


def _changing(time: Column, row: int, interval: float, where: str) -> InputError:
    """The error of an interval that is not one."""
    here = np.asarray(time[row : row + WINDOW], float)
    after = float(np.median(np.diff(here)[1:])) if len(here) > 2 else interval
    problem = (
        f"the interval changes from {interval * 1e3:.4g} ms to {after * 1e3:.4g} ms at {here[0]:.6g} s"
        if abs(after - interval) > 0.05 * interval
        else f"the interval is not constant: {interval * 1e3:.4g} ms, but {np.diff(here[:2])[0] * 1e3:.4g} ms at {here[0]:.6g} s and often after"
    )
    return InputError(f"{where}: {problem}; split the recording there (from_s, to_s), or say period_ms in the map to bring all on one")
