"""Timing of one recorded signal: interval, gaps, rounding of printed times, clock jitter, and parts whose time starts again.

A stretch lies between two gaps. Its samples count as evenly spaced, first + k * interval, if the recorded times agree up to their
rounding. If the clock really jitters, the recorded times are used.
"""

from dataclasses import dataclass, replace
import itertools
import math

import numpy as np

from twin.errors import InputError
from twin.recordings.roughness import decimal_place
from twin.recordings.signals import IMPOSSIBLE_VALUE, Column, Recording, Signal
from twin.recordings.trace import RELATIVE_PERIOD_TOLERANCE

LONGER = 1.5
"""A step longer than this many intervals is a gap."""
LONGER_MIXED = 3.5
"""The same if the map gives a period, because intervals may then change, and for a logger that asks at uneven times."""
CATCH_UP = 4
"""Rows within which a logger that was late with one is in time again."""
UNEVEN = 0.5
"""Least share of the steps near the usual one; below it, a long step is no lost row."""
SHORTEST_S, LONGEST_S = 1e-6, 60.0
"""Shortest and longest interval of a recording [s]."""
MANY_GAPS = 0.02
"""Above this share of gaps among the samples the interval itself counts as changing, unless the gaps are lost rows."""
MEDIAN_OF = 1 << 18
PAUSE_S = 1.0
"""Gap [s] inserted between two parts, which splits the run. The file does not give the real pause."""
RUNS_ON = 3.0
"""After a true restart the next step forwards is at most this many intervals; after a damaged row it leads back to where the time was."""
COARSE = 20.0
"""A clock is coarse if more rows than this share one of its times: only their even number shows that they are evenly spaced."""
FEW = 10.0
"""A longer gap [intervals] is a pause, which no interpolation bridges."""
SHORT_PIECE_S = 1.0
"""A piece shorter than this [s] that begins in motion shows little: a simulation begins at rest."""
WINDOW, LONG_WINDOW = 50, 200
"""An interval is averaged over this many samples when single steps are rounded or jitter; a rounded one is even over more."""


@dataclass(frozen=True)
class Stretch:
    """Samples first to first + count - 1 of a signal: begin and interval [s]. `spread` [s]: deviation from the even grid; `even`: it is only rounding."""

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
    """Stretches of a signal in order, its interval [s], notes."""

    stretches: tuple[Stretch, ...]
    interval: float
    notes: tuple[str, ...]


def timing_of(time: Column, where: str, period_s: float | None = None) -> Timing:
    """Stretches between gaps. Raises InputError if the time stands still or goes back, or if the interval changes permanently.

    `period_s`: period that the map gives; the interval may then change, and only steps above LONGER_MIXED intervals are gaps.
    """
    n = len(time)
    if n < 2:
        raise InputError(f"{where}: only {n} sample{'s' * (n != 1)}; a trace needs at least two")
    time = np.asarray(time[0:n], float)
    if not (fine := np.abs(time) < IMPOSSIBLE_VALUE).all():
        row = int(np.argmin(fine))
        raise InputError(f"{where}: the time holds {str(time[row]).replace('nan', 'NaN')} at row {row + 1}; repair it")
    quantum = decimal_place(time[:MEDIAN_OF])
    interval, rounded = _usual_step(time[:MEDIAN_OF], quantum)
    if interval > LONGEST_S or 0.0 < interval < SHORTEST_S:
        raise InputError(f"{where}: its samples are {interval:.3g} s apart, which no control records; correct the unit of the time")
    notes: list[str] = []
    steps = np.diff(time)
    if steps[row := int(np.argmin(steps))] < 0.0:
        remedy = "cut the file there, or keep one part with from_s and to_s"
        raise InputError(f"{where}: time goes back at row {row + 2} ({time[row]:.6g} s); {remedy}")
    repeated = int(np.count_nonzero(steps == 0.0))
    even = bool(np.mean(np.abs(steps - interval) <= max(0.1 * interval, quantum)) >= UNEVEN)
    limit = (LONGER * interval if even and period_s is None else LONGER_MIXED * max(interval, period_s or 0.0)) + (
        quantum if rounded else 0.0
    )
    gaps = np.flatnonzero(steps > limit)
    gaps = gaps[~_caught_up(time, gaps, interval)]
    # a pause between two parts is no change of the interval
    many = len(gaps) - np.count_nonzero(steps > max(limit, 0.999 * PAUSE_S, 9.99 * interval)) > max(MANY_GAPS * n, 20)
    if many and not _are_lost_rows(steps, gaps, interval, limit):
        raise _interval_error(time, int(gaps[0]), interval, where)
    bounds = itertools.pairwise([0, *(int(g) + 1 for g in gaps), n])
    stretches = [_stretch(time, first, last - first, quantum) for first, last in bounds if last - first >= 2]
    if not stretches:
        raise InputError(f"{where}: no two samples are near each other in time; check the time column and its unit")
    longest = max(stretches, key=lambda s: s.count)
    if repeated and not all(one.even for one in stretches):
        still = f"time stands still at {repeated} of {n} rows and no even interval explains it"
        raise InputError(f"{where}: {still}; give --interval-ms, or another column of times")
    if period_s is None:
        for one in stretches:
            if one.count > 20 and abs(one.interval - longest.interval) > 0.1 * longest.interval + _scatter(steps, one.count):
                raise _interval_error(time, max(one.first, longest.first) - 1, min(one, longest, key=lambda s: s.first).interval, where)
            if not one.even and (change := _permanent_change(time, one, quantum)) is not None:
                raise _interval_error(time, *change, where)
    if longest.even and rounded:
        notes.append(f"times printed to {quantum * 1e3:.3g} ms; samples are {longest.interval * 1e3:.6g} ms apart")
    elif repeated:
        notes.append(f"time stands still at {repeated} row{'s' * (repeated > 1)}; taken as {longest.interval * 1e3:.6g} ms apart")
    elif not longest.even:
        off = f"{0.5 * longest.spread * 1e3:.3g} ms from {longest.interval * 1e3:.4g} ms"
        notes.append(f"the clock deviates by {off}; resampled to an even grid")
    return Timing(tuple(stretches), longest.interval, tuple(notes))


def is_riddled(timing: Timing) -> bool:
    """Whether a few samples are lost so often that most of the others lie in short pieces between them."""
    apart = [after.begin - before.end for before, after in itertools.pairwise(timing.stretches)]
    counts = [one.count for one in timing.stretches]
    short = sum(count for count in counts if count * timing.interval < SHORT_PIECE_S)
    return bool(apart) and max(apart) <= FEW * timing.interval and short > 0.5 * sum(counts)


def _are_lost_rows(steps: np.ndarray, gaps: np.ndarray, interval: float, limit: float) -> bool:
    """Whether many gaps are rows that a logger lost: whole intervals, between steps that stay the usual ones."""
    off = steps[gaps] - interval * np.round(steps[gaps] / interval)
    usual = np.median(steps[: len(steps) // WINDOW * WINDOW].reshape(-1, WINDOW), axis=1)
    return bool(np.abs(off).max() <= 0.1 * interval and (usual <= limit).all())


def _caught_up(time: np.ndarray, gaps: np.ndarray, interval: float) -> np.ndarray:
    """Whether the rows after each long step (gap,) are soon as many as intervals have passed: one row came late, and none is lost."""
    late = np.zeros(len(gaps), bool)
    for rows in range(2, CATCH_UP + 1):
        after = np.minimum(gaps + rows, len(time) - 1)
        late |= (after == gaps + rows) & (time[after] - time[gaps] < (rows + 0.5) * interval)
    return late


def without_repeats(recording: Recording) -> Recording:
    """The recording without rows that equal the row before with its time, as of a logger that asks too early, where no even interval explains them."""
    changed: dict[str, Signal] = {}
    for own in {id(s.time): s.time for s in recording.signals.values() if len(s.time) > 2}.values():
        time = np.asarray(own[0 : len(own)], float)
        twice = np.diff(time) == 0.0
        if 0 < np.count_nonzero(twice) <= MANY_GAPS * len(time) and not _stretch(time, 0, len(time), decimal_place(time[:MEDIAN_OF])).even:
            values = {n: np.asarray(s.values[0 : len(time)], float) for n, s in recording.signals.items() if s.time is own}
            kept = np.r_[True, ~(twice & np.all([np.diff(v) == 0.0 for v in values.values()], axis=0))]
            time = time[kept]
            changed |= {n: replace(recording.signals[n], time=time, values=v[kept]) for n, v in values.items() if not kept.all()}
    note = ("rows that equal the row before with its time are left out",) if changed else ()
    return replace(recording, signals={**recording.signals, **changed}, notes=(*recording.notes, *note))


def _usual_step(times: np.ndarray, quantum: float) -> tuple[float, bool]:
    """Interval, and whether rounding to the quantum hides it: 1.25 ms printed to 1 ms reads 1, 1, 2, 1 ms, and 3.4 ms of a clock that jitters 3, 4, 3, 5 ms."""
    steps = np.diff(times)
    median = float(np.median(steps))
    if coarse := _interval_of_a_coarse_clock(times, quantum):
        return coarse, True
    if len(times) < WINDOW or quantum == 0.0:
        return median, False
    interval, spread = _even_windows(times, WINDOW)
    rounded = spread > RELATIVE_PERIOD_TOLERANCE * interval and spread < 0.6 * quantum
    if rounded and len(times) >= LONG_WINDOW:  # lost rows are not evenly spaced, as the longer steps of a rounded interval are
        rounded = _even_windows(times, LONG_WINDOW)[1] < 0.6 * quantum
    if quantum <= (LONGER - 1.0) * median:  # one digit more or less is no lost row
        rounded |= bool(np.mean(np.abs(np.abs(steps - median) / quantum - 1.0) < 0.1) > MANY_GAPS)
    return (interval, True) if rounded and interval > 0.0 else (median, False)


def _even_windows(times: np.ndarray, length: int) -> tuple[float, float]:
    """Medians of the interval, and of half the range by which times miss even ones, over windows of this length."""
    windows = times[: len(times) // length * length].reshape(-1, length)
    k = np.arange(length) - 0.5 * (length - 1)
    slopes = windows @ k / (k @ k)
    return float(np.median(slopes)), float(np.median(0.5 * np.ptp(windows - slopes[:, None] * k, axis=1)))


def _interval_of_a_coarse_clock(times: np.ndarray, quantum: float) -> float:
    """Interval [s] of rows whose clock shows many of them the same time, if each of its steps has as many rows, up to one; else 0."""
    steps = np.diff(times)
    starts = np.flatnonzero(steps > 0.0) + 1
    rows = np.diff(starts)[steps[starts[1:] - 1] < 1.5 * quantum]
    return quantum / float(rows.mean()) if len(rows) > 2 and rows.min() > COARSE and np.ptp(rows) <= 1 else 0.0


def _stretch(time: np.ndarray, first: int, count: int, quantum: float) -> Stretch:
    """Even grid through the samples by least squares, with its spread."""
    start, scale = float(time[first]), 0.5 * (count - 1)
    own = time[first : first + count] - start
    coarse = _interval_of_a_coarse_clock(own, quantum)
    interval = coarse or float(own @ (np.arange(count) - scale)) * 12.0 / (count * (float(count) ** 2 - 1.0))
    begin = start + float(own.sum()) / count - interval * scale
    spread = 0.5 * float(np.ptp(own - interval * np.arange(count)))  # half the range of the deviations from the even grid
    # rounding of printed times is half a digit
    rounded = quantum > 0.0 and spread <= 0.6 * quantum and (quantum <= COARSE * interval or coarse > 0.0)
    if spread <= RELATIVE_PERIOD_TOLERANCE * interval or rounded:
        return Stretch(first, count, begin, interval, spread, True)
    # jittering times: interval from the first and the last of them
    interval = float(own[-1]) / (count - 1)
    return Stretch(first, count, start, interval, float(np.ptp(own - interval * np.arange(count))), False)


def _permanent_change(time: np.ndarray, one: Stretch, quantum: float) -> tuple[int, float] | None:
    """Row of a permanent change of the interval, and the interval before it; None if the clock only jitters or drifts."""
    own = time[one.first : one.first + one.count]
    here = np.diff(own[::WINDOW]) / WINDOW
    changed = np.abs(here - here[:1]) > 0.1 * here[:1] + 2.0 * quantum / WINDOW + _scatter(np.diff(own), WINDOW)
    return (one.first + int(np.argmax(changed)) * WINDOW, float(here[0])) if changed.any() else None


def _scatter(steps: np.ndarray, count: int) -> float:
    """How far the means of `count` steps that scatter like these may be apart: three standard deviations [s]."""
    return 3.0 * float(np.std(steps)) * math.sqrt(2.0 / count)


def _interval_error(time: np.ndarray, row: int, interval: float, where: str) -> InputError:
    """The error for an interval that is not constant."""
    here = time[row : row + WINDOW]
    after = float(np.median(np.diff(here)[1:])) if len(here) > 2 else interval
    problem = f"the interval changes from {interval * 1e3:.4g} ms to {after * 1e3:.4g} ms at {here[0]:.6g} s"
    if abs(after - interval) <= 0.05 * interval:
        other = float(here[1] - here[0])
        problem = f"the interval is not constant: {interval * 1e3:.4g} ms, but {other * 1e3:.4g} ms at {here[0]:.6g} s and often after"
    return InputError(f"{where}: {problem}; split the recording there (from_s, to_s), or give period_ms in the map to resample it")


def at_even_times(timing: Timing, time: Column, values: Column) -> Timing:
    """The timing of samples whose clock jitters, not their moments: the motion (sample,) is smoother at an even interval than at the times of the clock."""
    if max(timing.stretches, key=lambda one: one.count).even:
        return timing
    as_recorded = as_even = 0.0
    moments = []
    for one in timing.stretches:
        own, x = (np.asarray(column[one.first : one.first + one.count], float) for column in (time, values))
        k = np.arange(one.count) - 0.5 * (one.count - 1)
        moments.append((float(own.mean()), float(k @ (own - own[0])), float(k @ k)))
        as_recorded, as_even = as_recorded + _roughness_at(own, x), as_even + _roughness_at(k, x)
    if not as_even < as_recorded:
        return timing
    means, slopes, weights = zip(*moments)
    interval = sum(slopes) / sum(weights)
    even = [
        replace(one, begin=mean - 0.5 * interval * (one.count - 1), interval=interval, even=True)
        for one, mean in zip(timing.stretches, means)
    ]
    note = f"the clock jitters, the samples are {interval * 1e3:.6g} ms apart: the motion is smoother at an even interval"
    return Timing(tuple(even), interval, (*timing.notes[:-1], note))


def _roughness_at(at: np.ndarray, values: np.ndarray) -> float:
    """Sum of the squares by which values (sample,) miss the line through their neighbours at these times."""
    share = (at[1:-1] - at[:-2]) / np.maximum(at[2:] - at[:-2], 1e-300)
    return float(np.sum((values[1:-1] - values[:-2] - share * (values[2:] - values[:-2])) ** 2))


class Restarts:
    """Makes the times of consecutive blocks increase across restarts. `count`: number of restarts so far.

    The time starts again where it goes back and then runs on in steps of the interval. A part has two rows or more. At the end of a block, where the next
    step is not known, a return to zero or to the first time of the file decides.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first = self._interval = self._last = np.nan
        self._shift = 0.0

    def __call__(self, time: np.ndarray) -> np.ndarray:
        """Corrected times (sample,) [s] of the next block."""
        if np.isnan(self._first) and len(time) > 1:
            forwards = np.diff(time[: 1 << 12])
            forwards = forwards[forwards > 0.0]
            self._first, self._interval = float(time[0]), float(np.median(forwards)) if len(forwards) else np.nan
        if not np.isfinite(self._interval):
            return time
        before = np.concatenate([[self._last if np.isfinite(self._last) else time[0]], time[:-1]])
        after = np.concatenate([np.diff(time), [np.nan]])
        at_start = np.minimum(np.abs(time - self._first), np.abs(time)) <= 1.001 * self._interval
        runs_on = np.where(np.isnan(after), at_start, (after > 0.0) & (after <= RUNS_ON * self._interval))
        out = time + self._shift
        for row in np.flatnonzero((time < before) & runs_on):
            self._shift += float(before[row] - time[row]) + max(PAUSE_S, 10.0 * self._interval)
            out[row:] = time[row:] + self._shift
            self.count += 1
        self._last = float(time[-1])
        return out
