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
from twin.readers.signals import BLOCK, Column
from twin.trace import RELATIVE_PERIOD_TOLERANCE

LONGER = 1.5
"""A step longer than this many intervals is a gap."""
MANY_GAPS = 0.02
"""More gaps than this fraction of the samples: the interval itself changes."""
MEDIAN_OF = 1 << 18


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

    `period_s`: the map asks for this period; then every step up to LONGER times that is no gap, whatever the interval does.
    """
    n = len(time)
    if n < 2:
        raise InputError(f"{where}: only {n} sample{'s' * (n != 1)}; a trace needs at least two")
    head = np.asarray(time[0 : min(n, MEDIAN_OF)], float)
    if not np.all(np.isfinite(head)):
        raise InputError(f"{where}: the time holds NaN at row {int(np.argmin(np.isfinite(head))) + 1}; repair it")
    quantum = _quantum(head)
    interval = _usual_step(head)
    notes: list[str] = []
    gaps: list[int] = []
    repeated = 0
    limit = LONGER * max(interval, period_s or 0.0) + 2.0 * quantum * (quantum > 0.1 * interval)
    for row, steps in _steps(time):
        if not np.all(np.isfinite(steps)):
            raise InputError(f"{where}: the time holds NaN at row {row + int(np.argmin(np.isfinite(steps))) + 2}; repair it")
        if steps.min() < 0.0:
            i = int(np.argmin(steps))
            raise InputError(
                f"{where}: time goes back at row {row + i + 2} ({time[row + i : row + i + 1][0]:.6g} s); "
                "cut the file there, or keep one part with from_s and to_s"
            )
        repeated += int(np.count_nonzero(steps == 0.0))
        gaps += [row + int(i) for i in np.flatnonzero(steps > limit)]
        if len(gaps) > max(MANY_GAPS * n, 20):
            raise _changing(time, gaps, interval, where)
    bounds = [0, *(g + 1 for g in gaps), n]
    stretches = []
    for first, last in itertools.pairwise(bounds):
        if last - first >= 2:
            stretches.append(_stretch(time, first, last - first, quantum))
    if not stretches:
        raise InputError(f"{where}: no two samples are near each other in time; check the time column and its unit")
    longest = max(stretches, key=lambda s: s.count)
    for one in stretches:
        if one.count > 20 and abs(one.interval - longest.interval) > 0.1 * longest.interval and period_s is None:
            other, late = (one, longest) if one.first < longest.first else (longest, one)
            raise InputError(
                f"{where}: the interval changes from {other.interval * 1e3:.4g} ms to {late.interval * 1e3:.4g} ms at {late.begin:.6g} s; "
                "split the recording there (from_s, to_s), or say period_ms in the map to bring all on one"
            )
    if repeated and not longest.even:
        raise InputError(f"{where}: time stands still at {repeated} rows and no even interval explains it; repair the time column")
    if longest.even and longest.spread > RELATIVE_PERIOD_TOLERANCE * longest.interval:
        notes.append(f"times printed to {quantum * 1e3:.3g} ms; samples are {longest.interval * 1e3:.6g} ms apart")
    elif not longest.even:
        notes.append(
            f"the clock jitters by up to {longest.spread * 1e3:.3g} ms about {longest.interval * 1e3:.4g} ms; brought on an even grid"
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


def _usual_step(times: np.ndarray) -> float:
    """Median step; of times so coarse that many are equal or two values alternate, their mean within the usual ones."""
    steps = np.diff(times)
    median = float(np.median(steps))
    if median <= 0.0 or np.count_nonzero(np.abs(steps - median) < 0.02 * median) < 0.9 * len(steps):
        usual = steps[steps <= 3.0 * max(median, float(np.mean(steps)))]
        return float(np.mean(usual))
    return median


def _stretch(time: Column, first: int, count: int, quantum: float) -> Stretch:
    """Even grid through the samples: interval from the ends, then the middle of what is left over."""
    begin, end = float(time[first : first + 1][0]), float(time[first + count - 1 : first + count][0])
    interval = (end - begin) / (count - 1)
    low, high = 0.0, 0.0
    for start in range(0, count, BLOCK):
        part = np.asarray(time[first + start : first + min(start + BLOCK, count)], float)
        off = part - (begin + interval * (start + np.arange(len(part))))
        low, high = min(low, float(off.min())), max(high, float(off.max()))
    spread = 0.5 * (high - low)
    fine = spread <= RELATIVE_PERIOD_TOLERANCE * interval
    # printed times are off by half a digit at most, and so is each end
    rounded = quantum > 0.0 and spread <= 1.01 * quantum and quantum <= 20.0 * interval
    return Stretch(first, count, begin + 0.5 * (high + low), interval, spread, fine or rounded)


def _changing(time: Column, gaps: list[int], interval: float, where: str) -> InputError:
    at = gaps[0]
    here = np.asarray(time[at : at + 2], float)
    return InputError(
        f"{where}: the interval is not constant: {interval * 1e3:.4g} ms, then {(here[1] - here[0]) * 1e3:.4g} ms at {here[0]:.6g} s and often after; "
        "split the recording there (from_s, to_s), or say period_ms in the map to bring all on one"
    )
