"""What may stand between a position controller and its record: a lag, another time, a filter, cycles between two samples.

Each of them takes a law and what it found, and gives a richer law only where that predicts the motion better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import functools
import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from twin.control.speed_set_point_filters import lagged
from twin.estimate.held_out_gain import held_out, is_better
from twin.estimate.regression import Fit, regress, solved
from twin.identify.axis_run import AxisRun
from twin.identify.position_law import ALL_ROWS, RIVAL_RATIO, ROUNDING, PositionLaw, level, pieces

MOST_FEEDBACK_CYCLES = 3
"""The position is recorded at most this many cycles before or after its use."""

LAGS_CYCLES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Times of a lag from which it is searched, in position cycles."""

LEAST_LAG_CYCLES = 0.05
"""A shorter lag is none."""

MOST_CYCLES_A_SAMPLE = 16
"""Most cycles of the controller between two samples."""

STEP_CYCLES = 1e-3
"""Step of a derivative by a time, in position cycles."""


class FifthNumber(PositionLaw):
    """A position law with a fifth number, a time [s], and the law `at` it."""

    def __init__(self, law: PositionLaw, at: Callable[[float], PositionLaw]) -> None:
        super().__init__(law.axis, law.runs, law.way)
        self.at = functools.lru_cache(maxsize=4)(at)

    def wanted(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The law (row,) of run `k` [axis units a second]."""
        return self.at(x[4]).wanted(k, x[:4], rows)

    def slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Derivatives (row, 5) of the law of run `k`."""
        here, step = self.at(x[4]), STEP_CYCLES * self.runs[k].cycle
        there = self.at(x[4] + step)
        return np.column_stack([here.slopes(k, x[:4], rows), (there.wanted(k, x[:4], rows) - here.wanted(k, x[:4], rows)) / step])

    def delay_of_feedforward(self, x: np.ndarray) -> float:
        """Delay [s] between the changed set points and the recorded feedforward."""
        return self.at(x[4]).delay_of_feedforward(x[:4])


class BehindLag(PositionLaw):
    """A position law whose output is recorded behind a lag [s]: block `speed_record_lag` or `speed_set_point_lag`."""

    def __init__(self, law: PositionLaw, lag: float) -> None:
        super().__init__(law.axis, law.runs, law.way)
        self.lag = lag

    def wanted(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The law (row,) of run `k` [axis units a second]."""
        return self.as_recorded(k, super().wanted(k, x))[rows]

    def slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Derivatives (row, number) of the law of run `k` with respect to x."""
        return self.as_recorded(k, super().slopes(k, x))[rows]

    def as_recorded(self, k: int, values: np.ndarray) -> np.ndarray:
        """Terms of the law (cycle, ...) of run `k` as they appear in the recorded v*."""
        run = self.runs[k]
        return lagged(values, run.cycle, max(self.lag, LEAST_LAG_CYCLES * run.cycle), run.speed_cycle)


def _on_changed_runs(law: PositionLaw, changed: Callable[[AxisRun, float], AxisRun]) -> FifthNumber:
    """The law with a time that changes its runs."""
    return FifthNumber(law, lambda time: PositionLaw(law.axis, [changed(run, time) for run in law.runs], law.way))


@dataclass(frozen=True)
class Variant:
    """A law with a fifth number: on the runs that this one changes, its fit, its numbers (5,), and other numbers that fit as well."""

    law: PositionLaw
    fit: Fit
    x: np.ndarray
    rivals: list[np.ndarray]


def with_feedback_of_another_time(law: PositionLaw, x: np.ndarray) -> Variant | None:
    """The law with the time of the position after that of the record as a fifth number."""
    tp, found = law.runs[0].cycle, _on_changed_runs(law, _position_at)
    starts = [
        np.array([x[0], weight, x[2] - (x[1] - weight) / x[0] - later, x[3], later])
        for weight in dict.fromkeys((float(x[1]), 0.0))  # at a steady speed the delay of the set point takes up both
        for later in (-tp, 0.0, tp)
    ]
    return _found(found, law, x, starts, (-2.0 * tp, -tp, tp, 2.0 * tp), lambda later: abs(later) <= MOST_FEEDBACK_CYCLES * tp)


def with_set_point_lag(law: PositionLaw, x: np.ndarray) -> Variant | None:
    """The law behind a lag of the set points, whose time is the fifth number."""
    return _with_lag(_on_changed_runs(law, _behind_lag), law, x) if _shows_curvature(law, x) else None


def with_record_lag(law: PositionLaw, x: np.ndarray) -> Variant | None:
    """The law whose output is recorded behind a lag, whose time is the fifth number."""
    return _with_lag(FifthNumber(law, lambda lag: BehindLag(law, lag)), law, x)


def without_delays(law: PositionLaw, lag: float) -> tuple[np.ndarray, float]:
    """The numbers (5,) of the law without delays behind the best record lag from half to twice `lag` [s], and the RMS of what it leaves."""

    keep, none, used = law.usable_rows(), np.zeros(4), 2 if any(law.on) else 1
    given = law.rest(none, keep)
    clusters = np.concatenate([run.clusters(k)[rows] for k, (run, rows) in enumerate(zip(law.runs, keep))])

    def fit(lag: float) -> Fit:
        return regress(BehindLag(law, lag).columns(none, keep)[:, :used], given, clusters)

    best = minimize_scalar(
        lambda lag: np.std(fit(lag).residual), bounds=(0.5 * lag, 2.0 * lag), method="bounded", options={"xatol": 1e-9}
    ).x
    found = fit(best)
    gain, weight = np.append(found.values, 0.0)[:2]
    return np.array([gain, weight, 0.0, 0.0, best]), float(np.std(found.residual))


def cycles_a_sample(law: PositionLaw, x: np.ndarray) -> int:
    """How many times the controller computes from one sample to the next, where one number alone explains the record; else 1.

    Its feedforward is the last step of the set points over a cycle of its own. Without a delay its moment shows how long this step is.
    `x`: the numbers of the law with any delays.
    """
    if law.recorded or not any(law.on):
        return 1
    keep = [np.arange(len(run.start)) for run in law.runs]
    ends = np.cumsum([len(k) for k in keep])[:-1]

    def of(values: np.ndarray) -> np.ndarray:
        """(row, ...) values without what rounding adds at high frequencies, where no limit was near."""
        return np.concatenate(
            [np.apply_along_axis(run.filtered, 0, part)[law.usable(run)] for run, part in zip(law.runs, np.split(values, ends))]
        )

    def left_by(count: int) -> float:
        runs = [replace(run, position_cycle=run.cycle / count) for run in law.runs]
        one, prompt = PositionLaw(law.axis, runs, "cubic"), np.array([*x[:2], 0.0, 0.0])
        rest, columns = of(one.rest(prompt, keep)), of(one.columns(prompt, keep)[:, :2])
        return float(np.std(rest - columns @ solved(columns, rest)))

    each = [left_by(count) for count in range(1, MOST_CYCLES_A_SAMPLE + 1)]
    least, rival = sorted(each)[:2]
    explains = least < RIVAL_RATIO * float(np.std(of(law.rest(x, keep))))
    return each.index(least) + 1 if explains and rival > RIVAL_RATIO * least else 1


def _with_lag(richer: FifthNumber, law: PositionLaw, x: np.ndarray) -> Variant | None:
    """The law with a lag, if it leaves less; at a steady speed a delay takes up a lag."""
    tp = law.runs[0].cycle
    starts = [np.array([*x[:2], *np.maximum(x[2:4] - lag, 0.0), lag]) for lag in np.array(LAGS_CYCLES) * tp]
    return _found(richer, law, x, starts, (-tp, tp, 2.0 * tp), lambda lag: lag > LEAST_LAG_CYCLES * tp)


def _found(
    richer: FifthNumber,
    law: PositionLaw,
    x: np.ndarray,
    starts: Sequence[np.ndarray],
    valley: Sequence[float],
    possible: Callable[[float], bool],
) -> Variant | None:
    """The best law from several starts, and from delays moved by `valley` [s], if it leaves less of the pieces of the motion than `law`."""
    keep = law.some_rows()
    ends: list[tuple[float, np.ndarray]] = []

    def search(start: np.ndarray) -> None:
        end = richer.descended(start, keep, method="lm", max_nfev=100)
        if end is not None and end[0][0] > 0.0 and possible(end[0][4]):
            ends.append((float(np.std(end[1])), end[0]))

    for start in starts:
        search(start)
    if not ends:
        return None
    best = min(ends, key=lambda end: end[0])[1]
    for late in valley:  # feedforward takes up a delay
        search(best + np.array([0.0, best[0] * late, late, 0.0, 0.0]))
    least, best = min(ends, key=lambda end: end[0])
    fit, best = richer.polished(best)
    if not np.all(np.isfinite(best)) or not np.all(np.isfinite(fit.deviations[[0, 4]])):
        return None
    if not _leaves_less(richer.rest(best, keep), law.rest(x, keep), keep):
        return None
    return Variant(richer.at(best[4]), fit, best, [end for rms, end in ends if rms < RIVAL_RATIO * least + ROUNDING])


def _position_at(run: AxisRun, later: float) -> AxisRun:
    """A run whose position is that of its record `later` [s] afterwards."""

    def moved(position: np.ndarray | None) -> np.ndarray | None:
        return None if position is None else CubicSpline(run.start, position)(np.clip(run.start + later, run.start[0], run.start[-1]))

    return replace(run, position=moved(run.position), motor_at_axis=moved(run.motor_at_axis))


def _behind_lag(run: AxisRun, lag: float) -> AxisRun:
    """A run with its set points behind a lag [s]."""
    given, kept = run.setpoint_at(run.start), math.exp(-run.cycle / max(lag, LEAST_LAG_CYCLES * run.cycle))
    return replace(run, setpoint=CubicSpline(run.start, given[0] + lfilter([1.0 - kept], [1.0, -kept], given - given[0])))


def _shows_curvature(law: PositionLaw, x: np.ndarray) -> bool:
    """Whether the curvature of the set points predicts most pieces of the motion better than the numbers of the law alone.

    A lag T acts as a delay T, which the delay of the law takes up, and as T^2 times the curvature. Without it there is no lag to search.
    """
    cycles, bent, keep = np.arange(-1, 2) * law.runs[0].cycle, [], law.some_rows()
    for run, on, k in zip(law.runs, law.on, keep):
        errors = [law.error(run, x[2] + late, k) for late in cycles]
        feeds = [on * law.fed(run, x[3] + late, k) for late in cycles]
        bent.append(level(x[0] * np.diff(errors, 2, axis=0)[0] + x[1] * np.diff(feeds, 2, axis=0)[0]))
    columns, rest, of_piece = law.columns(x, keep), law.rest(x, keep), pieces(keep)
    richer = np.column_stack([columns, np.concatenate(bent)])
    return bool(np.mean(held_out(richer, rest, of_piece) < held_out(columns, rest, of_piece)) > 0.5)


def _leaves_less(rest: np.ndarray, of_simpler: np.ndarray, keep: Sequence[np.ndarray]) -> bool:
    """Whether a law leaves less of the pieces of the motion than a simpler one, from what both leave (row,) on these rows of each run."""
    of_piece = pieces(keep)
    none = np.zeros((len(of_piece), 1))
    return is_better(held_out(none, rest, of_piece), held_out(none, of_simpler, of_piece), 0.0)
