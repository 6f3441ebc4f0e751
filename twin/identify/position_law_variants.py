"""What may stand between a position controller and its record: another time, a lag of the set points or of the record, cycles between two samples.

Each of the first three is a time, a fifth number beside those of the law.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import functools

import numpy as np
from scipy.interpolate import CubicSpline

from twin.control.set_point_filters import SET_POINT_LAG
from twin.control.speed_set_point_filters import RECORD_LAG, lag_of, lagged
from twin.estimate.regression import solved
from twin.identify.axis_run import AxisRun
from twin.identify.position_law import ALL_ROWS, LEAST_LAG_CYCLES, ROUNDING, SHARP, SLOPE, PositionLaw
from twin.identify.position_law_search import RIVAL_RATIO, Found, descended, found_law, polished, rms, some_rows

MOST_FEEDBACK_CYCLES = 3
"""The position is recorded at most this many cycles before or after its use."""

LAGS_CYCLES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Times of a lag from which it is searched, in position cycles."""

MOST_CYCLES_A_SAMPLE = 16
"""Most cycles of the controller between two samples."""

BARE_STEPS = 8
"""Steps of Gauss and Newton to a law without delays."""

STEP_CYCLES = 1e-3
"""Step of a derivative by a time, in position cycles."""


class FifthNumber(PositionLaw):
    """A position law with a fifth number, a time [s], and the law of each time."""

    def __init__(self, law: PositionLaw, of_time: Callable[[float], PositionLaw]) -> None:
        super().__init__(law.axis, law.runs, law.way)
        self.of_time = functools.lru_cache(maxsize=4)(of_time)

    def at(self, x: np.ndarray) -> PositionLaw:
        """The law of NAMES at the time of x."""
        return self.of_time(x[4])

    def slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Derivatives (row, 5) of the law of run `k`."""
        here, step = self.at(x), STEP_CYCLES * self.runs[k].cycle
        there = self.of_time(x[4] + step)
        return np.column_stack([here.slopes(k, x, rows), (there.wanted(k, x, rows) - here.wanted(k, x, rows)) / step])

    def ends(self, starts: Sequence[np.ndarray], possible: Callable[[float], bool]) -> list[tuple[float, np.ndarray]]:
        """What is left [axis units a second] where the descents from some starts end with a possible time, and the numbers (5,) there."""
        rows = some_rows(self)
        ends = (descended(self, start, rows, method="lm", max_nfev=100) for start in starts)
        return [(float(np.std(end[1])), end[0]) for end in ends if end is not None and end[0][0] > 0.0 and possible(end[0][4])]


def _on_changed_runs(law: PositionLaw, changed: Callable[[AxisRun, float], AxisRun]) -> FifthNumber:
    """The law with a time that changes its runs."""
    return FifthNumber(law, lambda time: PositionLaw(law.axis, [changed(run, time) for run in law.runs], law.way))


def at_another_time(plain: Found) -> Found | None:
    """The law whose position is recorded before or after its use, by a time that is its fifth number. A spline of the record shows none below SHARP cycles."""
    x, tp = plain.x, plain.law.runs[0].cycle
    begun = {
        _on_changed_runs(law, _position_at): [
            np.array([x[0], weight, x[2] - (x[1] - weight) / x[0] - later, x[3], later])
            for weight in dict.fromkeys((float(x[1]), 0.0))  # at a steady speed the delay of the set point takes up both
            for later in (-tp, 0.0, tp)
        ]
        for law in dict.fromkeys((plain.law, *(law for law in plain.ends if law.way == SLOPE)))
    }
    best = _searched(begun, (-2.0 * tp, -tp, tp, 2.0 * tp), lambda later: SHARP * tp < abs(later) <= MOST_FEEDBACK_CYCLES * tp)
    return best and replace(best, words=f"one whose position is recorded {{:.3g}} ms {'late' if best.x[4] > 0.0 else 'early'}")


def behind_set_point_lag(plain: Found) -> Found | None:
    """The law behind a lag of the set points, whose time is its fifth number."""
    best = _behind({_on_changed_runs(plain.law, _behind_lag): plain.x})
    return best and replace(best, words="one behind a lag of its set points of {:.3g} ms", lag=SET_POINT_LAG)


def behind_record_lag(plain: Found) -> Found | None:
    """The law whose output is recorded behind a lag, whose time is its fifth number."""
    begun = {law: x for law, x in plain.ends.items() if np.all(np.isfinite(x))}
    best = _behind({FifthNumber(law, functools.partial(PositionLaw, law.axis, law.runs, law.way)): x for law, x in begun.items()})
    if best is None:
        return None
    bare = _without_delays(best)
    best = bare if bare.left <= RIVAL_RATIO * best.left else best  # at a steady speed feedforward takes up a delay
    if not any(best.law.on):
        best.x[[1, 3]] = plain.x[[1, 3]]
    listed = lag_of(best.law.axis.blocks)
    words = "one whose speed set point is recorded behind a lag of {:.3g} ms"
    return replace(best, words=words, lag=listed.block if listed else RECORD_LAG)


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


def _behind(begun: dict[FifthNumber, np.ndarray]) -> Found | None:
    """The law with a lag that leaves the least, from the numbers (4,) of each without it; at a steady speed a delay takes up a lag."""
    if not begun:
        return None
    tp = next(iter(begun)).runs[0].cycle
    starts = {
        law: [np.array([*x[:2], *np.maximum(x[2:4] - lag, 0.0), lag]) for lag in np.array(LAGS_CYCLES) * tp] for law, x in begun.items()
    }
    return _searched(starts, (-tp, tp, 2.0 * tp), lambda lag: lag > LEAST_LAG_CYCLES * tp)


def _searched(begun: dict[FifthNumber, list[np.ndarray]], valley: Sequence[float], possible: Callable[[float], bool]) -> Found | None:
    """The best of some laws from several starts, and from delays moved by `valley` [s]; others that leave nearly as little stand beside it."""
    found, others = [], []
    for law, starts in begun.items():
        ends = law.ends(starts, possible)
        if not ends:
            continue
        x = min(ends, key=lambda end: end[0])[1]
        ends += law.ends([x + np.array([0.0, x[0] * late, late, 0.0, 0.0]) for late in valley], possible)  # feedforward takes up a delay
        fit, x = polished(law, min(ends, key=lambda end: end[0])[1])
        others += ends
        if np.all(np.isfinite(x)) and np.all(np.isfinite(fit.deviations[[0, 4]])):
            found.append(found_law(law, fit, x, [], rms(fit)))
    if not found:
        return None
    least = RIVAL_RATIO * min(left for left, _ in others) + ROUNDING
    return replace(min(found, key=lambda one: one.left), others=[x for left, x in others if left < least])


def _without_delays(found: Found) -> Found:
    """A law behind a lag without delays, which leaves about as much if a lag and less feedforward stand for them."""
    law, keep, free = found.law, found.law.usable_rows(), [0, 1, 4] if any(found.law.on) else [0, 4]
    x = np.array([*found.x[:2], 0.0, 0.0, found.x[4]])
    for _ in range(BARE_STEPS):
        x[free] += solved(law.columns(x, keep)[:, free], law.rest(x, keep))
        x[4] = np.clip(x[4], 0.5 * found.x[4], 2.0 * found.x[4])
    return replace(found, x=x, others=[*found.others, found.x], left=float(np.std(law.rest(x, keep))))


def _position_at(run: AxisRun, later: float) -> AxisRun:
    """A run whose position is that of its record `later` [s] afterwards."""

    def moved(position: np.ndarray | None) -> np.ndarray | None:
        return None if position is None else CubicSpline(run.start, position)(np.clip(run.start + later, run.start[0], run.start[-1]))

    return replace(run, position=moved(run.position), motor_at_axis=moved(run.motor_at_axis))


def _behind_lag(run: AxisRun, lag: float) -> AxisRun:
    """A run with its set points behind a lag [s]."""
    behind = lagged(run.setpoint_at(run.start), run.cycle, max(lag, LEAST_LAG_CYCLES * run.cycle), run.cycle)
    return replace(run, setpoint=CubicSpline(run.start, behind))
