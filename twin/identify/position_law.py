"""The law of a position controller on recorded runs, the search for its numbers, and what was found: see `position_control`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
import functools
import math
from typing import Any

import numpy as np
from scipy.ndimage import generate_binary_structure, minimum_filter
from scipy.optimize import least_squares

from twin.control.block import Block
from twin.control.position_controller import PARAMETERS, feedforward_at, position_law
from twin.control.speed_set_point_filters import lagged
from twin.estimate.held_out_gain import held_out, pieces_of
from twin.estimate.regression import Fit, regress, solved
from twin.identify.axis_run import AxisRun
from twin.machine.axis import Axis
from twin.recordings.roughness import robust_deviation, step_of

NAMES = tuple(p.name for p in PARAMETERS)
"""Gain, weight of the speed feedforward, delays of set point and feedforward."""

MOST_DELAY_CYCLES = 12
STEPS_A_CYCLE = 4
"""Largest delay of the grid in position cycles, and grid steps per cycle."""

STARTS = 3
"""Number of local minima of the grid that are refined."""

GRID_ROWS = 4000
"""Number of cycles from twice which on the search uses only every second, third, ... one; the final regression uses all."""

RIVAL_RATIO = 2.0
"""Laws with a residual RMS below this multiple of the best one are not excluded; the intervals cover them."""

OUT_OF_LINE = 8.0
"""Cycles with a residual beyond this many robust standard deviations are outliers: a lost sample, a step of a counter."""

TRIMMED = 0.97
"""Share of the cycles with the smallest residuals that compares the starts, so that outliers do not matter."""

ROUNDING = 1e-9
"""A column that varies by less than this share of its size is constant: the free constant of its run takes it."""

SLOPE, SHARP = "slope", 1e-2
"""A control may feed forward the speed that its interpolator has, not the last step of its set points; such a step lasts this share of a cycle."""

SAME = 1e-6
"""Laws whose sums of squares differ by less than this share are one law: a delay of the set point by a cycle and more feedforward."""

OF_ROUNDING = 1.5
"""A law that leaves less than this multiple of what the rounding of its record makes lacks nothing: a lag would only smooth it."""

TRIMS = 8
"""Rounds in which a law leaves out its outliers, such as the cycles of a friction pulse."""

LEAST_LAG_CYCLES = 0.05
"""A shorter lag is none."""

OF_COLUMNS_S = 1.2e-8
"""Standard deviation of a time [s] due to rounded columns and the set-point splines."""

ALL_ROWS = slice(None)


def loop_position(run: AxisRun, axis: Axis) -> np.ndarray | None:
    """Position feedback (cycle,) in axis units: the scale, or the motor encoder if the machine file uses it."""
    if axis.encoder == "motor" and run.motor_at_axis is not None:
        return run.motor_at_axis
    return run.position


def numbers_of_file(axis: Axis) -> np.ndarray:
    """(4,) The values of NAMES in the machine file; a weight of 0 becomes 1."""
    gain, weight, *delays = (axis.number(name) for name in NAMES)
    return np.array([gain, weight or 1.0, *delays])


class PositionLaw:
    """The law on all runs for one interpolation (`way`; SLOPE is cubic), with a free constant in each run.

    `lag` [s]: the output is recorded behind one, block `speed_record_lag` or `speed_set_point_lag`.
    """

    def __init__(self, axis: Axis, runs: Sequence[AxisRun], way: str, lag: float | None = None) -> None:
        self.axis, self.runs, self.way, self.lag = axis, runs, way, lag
        self.on = [0.0 if r.feedforward == "off" else 1.0 for r in runs]
        self.recorded = all(r.velocity_feedforward is not None for r in runs if r.feedforward != "off") and any(
            r.velocity_feedforward is not None and np.ptp(r.velocity_feedforward) > 0.0 for r in runs
        )

    @functools.cached_property
    def asked(self) -> list[np.ndarray]:
        """(cycle,) The recorded speed set point of each run [axis units a second]."""
        return [r.speed_setpoint * self.axis.ratio for r in self.runs if r.speed_setpoint is not None]

    @property
    def given(self) -> np.ndarray:
        """(row,) Those of all runs."""
        return np.concatenate(self.asked)

    def of_rounding(self, x: np.ndarray) -> float:
        """RMS of the speed set point [axis units a second] that the law makes of rounded set points. The position is rounded for the control, too."""
        made = []
        for run in self.runs:
            differences = 0.0 if run.feedforward == "off" or run.velocity_feedforward is not None else math.sqrt(2.0) / run.position_cycle
            made.append((x[0] + differences * x[1]) * step_of(run.setpoint_at(run.start)) / math.sqrt(12.0))
        return float(max(made))

    @functools.cached_property
    def step(self) -> float:
        """Step [axis units a second] to which the speed set points are rounded; of unrounded ones their last digits."""
        return max(*map(step_of, self.asked), 2.0 * ROUNDING * float(np.std(self.given)))

    def read(self, run: AxisRun, times: np.ndarray) -> np.ndarray:
        """Interpolated set point of a run at any times."""
        return run.setpoint_at(times) if self.way != "linear" else np.interp(times, run.start, run.setpoint_at(run.start))

    def rate(self, run: AxisRun, times: np.ndarray) -> np.ndarray:
        """Slope of the interpolated set point [axis units a second]; none before the run and after it."""
        if self.way == "linear":
            h = 1e-3 * run.cycle
            return (self.read(run, times + h) - self.read(run, times - h)) / (2.0 * h)
        return np.asarray(run.setpoint(np.clip(times, 0.0, run.end), 1) * ((times > 0.0) & (times < run.end)))

    def error(self, run: AxisRun, delay: float, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Control error (row,) of one run for a delay of the set point."""
        position = loop_position(run, self.axis)
        assert position is not None
        then = run.start[rows] - delay
        return self.read(run, then) + np.interp(then, run.start, run.added) - position[rows]

    def fed(
        self, run: AxisRun, delay: float, rows: np.ndarray | slice = ALL_ROWS, of: Callable[[AxisRun, np.ndarray], np.ndarray] | None = None
    ) -> np.ndarray:
        """Feedforward (row,) at weight 1: recorded, or the slope of the set points (of another course with `of`) over a cycle, or at a moment."""
        if self.recorded:
            return (run.velocity_feedforward if run.velocity_feedforward is not None else np.zeros(len(run.start)))[rows]
        cycle = run.position_cycle
        step = SHARP * cycle if self.way == SLOPE else cycle  # about the same moment
        read = of or self.read
        return feedforward_at(lambda late: read(run, run.start[rows] - late), delay + 0.5 * (cycle - step), step)

    def output(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The law (row,) of run `k` [axis units a second]."""
        run = self.runs[k]
        return position_law(x[0], x[1] * self.on[k], self.error(run, x[2], rows), self.fed(run, x[3], rows))

    def wanted(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """The output (row,) of run `k` as it is recorded [axis units a second]."""
        law = self.at(x)
        return law.as_recorded(k, functools.partial(law.output, k, x), rows)

    def as_recorded(self, k: int, terms: Callable[[np.ndarray | slice], np.ndarray], rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Terms of the output (row, ...) of run `k` as they appear in the record; a lag holds those of earlier cycles."""
        if self.lag is None:
            return terms(rows)
        run = self.runs[k]
        return lagged(terms(ALL_ROWS), run.cycle, max(self.lag, LEAST_LAG_CYCLES * run.cycle), run.speed_cycle)[rows]

    def at(self, _x: np.ndarray) -> "PositionLaw":
        """The law of NAMES with what `x` has beyond them."""
        return self

    def usable(self, run: AxisRun) -> np.ndarray:
        """(cycle,) True without a limit and late enough in the run that the delayed set point is recorded."""
        early = np.arange(len(run.start)) < min(MOST_DELAY_CYCLES, len(run.start) // 4)
        return ~run.limited & ~early

    def usable_rows(self) -> list[np.ndarray]:
        """(row,) Usable cycles of each run."""
        return [np.flatnonzero(self.usable(run)) for run in self.runs]

    def some_rows(self) -> list[np.ndarray]:
        """(row,) Usable cycles of each run, of long ones only some."""
        keep = self.usable_rows()
        every = max(1, sum(len(k) for k in keep) // GRID_ROWS)
        return [k[::every] for k in keep]

    def search(self) -> tuple[np.ndarray, float, list[np.ndarray]]:
        """Grid and damped search: best values of NAMES, their residual RMS, and other solutions with a similar residual."""
        tp, keep = self.runs[0].cycle, self.some_rows()
        grid = np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE
        if sum(map(len, keep)) < 8:
            return np.full(4, np.nan), math.inf, []
        left, kv, a_v = self._of_delays(grid, keep)
        starts = [np.array([kv[i, j], a_v[i, j], grid[i], grid[j]]) for i, j in _minima(left)[:STARTS]]
        starts.append(numbers_of_file(self.axis))
        ends: list[tuple[float, np.ndarray]] = []
        for start in starts:
            spread = robust_deviation(self.rest(start, keep)) or 1e-12
            if (found := self.descended(start, keep, loss="soft_l1", f_scale=3.0 * spread, max_nfev=40)) is None:
                continue
            x, left_over = found
            squares = np.sort(left_over**2)
            if x[0] > 0.0 and np.all(x[2:] > -tp) and np.all(x[2:] < (MOST_DELAY_CYCLES + 1) * tp):
                ends.append((float(np.sqrt(np.mean(squares[: max(int(TRIMMED * len(squares)), 1)]))), x))
        least, best = min(ends, key=lambda end: end[0], default=(math.inf, starts[0]))
        return best, least, [x for left, x in ends if left < RIVAL_RATIO * least]

    def asked_on(self, keep: Sequence[np.ndarray]) -> np.ndarray:
        """The recorded speed set points (row,) on some rows of each run, without the free constant of the run."""
        return np.concatenate([level(v[k]) for v, k in zip(self.asked, keep)])

    def clusters(self, keep: Sequence[np.ndarray]) -> np.ndarray:
        """Strokes (row,) on some rows of each run."""
        return np.concatenate([run.clusters(k)[rows] for k, (run, rows) in enumerate(zip(self.runs, keep))])

    def rest(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """What the law leaves (row,) on some rows of each run, without the free constant of the run."""
        return np.concatenate([level(v[rows] - self.wanted(k, x, rows)) for k, (v, rows) in enumerate(zip(self.asked, keep))])

    def columns(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """Derivatives of the law (row, number) on some rows of each run, without the free constant of the run."""
        return np.vstack([level(self.slopes(i, x, k)) for i, k in enumerate(keep)])

    def descended(self, start: np.ndarray, keep: Sequence[np.ndarray], **how: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """The nearest optimum and what it leaves (row,), by `least_squares` with the options `how`. None without one."""

        scale = np.array([1.0, 0.1, *[0.25 * self.runs[0].cycle] * (len(start) - 2)])
        try:
            end = least_squares(lambda x: self.rest(x, keep), start, lambda x: -self.columns(x, keep), x_scale=scale, **how)
        except (ValueError, np.linalg.LinAlgError):
            return None
        return end.x, end.fun

    def polished(self, x: np.ndarray) -> tuple[Fit, np.ndarray]:
        """Regression at the solution, with intervals by strokes and without outliers."""
        fit: Fit | None = None
        usable = [self.usable(r) for r in self.runs]
        for _ in range(4):
            parts = []
            for k, (run, use, v) in enumerate(zip(self.runs, usable, self.asked)):
                columns, e = self.slopes(k, x), v - self.wanted(k, x)
                if use.any():
                    centred, size = columns - columns[use].mean(axis=0), np.abs(columns[use]).max(axis=0)
                    columns = centred * (np.abs(centred[use]).max(axis=0) > ROUNDING * size)
                    e = e - float(np.median(e[use]))
                spread = max(robust_deviation(e[use]) if use.any() else 0.0, 1e-9)
                use = use & (np.abs(e) < OUT_OF_LINE * spread)
                parts.append((columns[use], e[use], run.clusters(k)[use]))
            fit = regress(*map(np.concatenate, zip(*parts)))
            step = fit.values[: len(x)]
            if not np.all(np.isfinite(step)) or abs(step[0]) > 0.1 * abs(x[0]) or np.max(np.abs(step[2:])) > 0.5 * self.runs[0].cycle:
                break  # keep the result of the search: these steps may only make small corrections
            x = x + step
            if np.all(np.abs(step) < 1e-9):
                break
        assert fit is not None
        if self.recorded:
            x = np.array([*x[:3], self.at(x).delay_of_feedforward(), *x[4:]])
        return fit, x

    @functools.cached_property
    def in_whole_cycles(self) -> tuple[np.ndarray, float]:
        """Values of NAMES (4,) with delays of whole cycles, which smooth no rounding, and what they leave (RMS without outliers)."""
        keep, grid = self.usable_rows(), np.arange(MOST_DELAY_CYCLES + 1) * self.runs[0].cycle
        left, kv, a_v = self._of_delays(grid, keep)
        best = min(np.argwhere(left <= (1.0 + SAME) * left.min()).tolist(), key=sum, default=(0, 0))

        laws = (np.array([kv[i, j], a_v[i, j], grid[i], grid[j]]) for i, j in {(0, 0), tuple(best)})  # pulses may favour a delay
        return min((self._trimmed(x, [0, 1]) for x in laws), key=lambda law: law[1])

    def at_full_feedforward(self, x: np.ndarray) -> tuple[np.ndarray, float]:
        """The law at a feedforward of weight 1, and what it leaves (RMS without outliers): a delay of the set point by d and a weight that is Kv d larger
        are one law at constant speed, and nearly one at all."""
        delay = x[2] + (1.0 - x[1]) / x[0]
        if not 0.0 <= delay <= MOST_DELAY_CYCLES * self.runs[0].cycle:
            return x, math.inf
        return self._trimmed(np.array([x[0], 1.0, delay, *x[3:]]), [0, 2, 3])

    def _trimmed(self, x: np.ndarray, free: Sequence[int]) -> tuple[np.ndarray, float]:
        """The law with some of its numbers free, and what it leaves (RMS) without outliers."""
        rest, keep = np.zeros(0), self.usable_rows()
        for _ in range(TRIMS):
            rest = self.rest(x, keep)
            use = np.abs(rest) < OUT_OF_LINE * max(robust_deviation(rest), 1e-9)
            rest = rest[use]
            x[free] += solved(self.columns(x, keep)[use][:, free], rest)
        return x, float(np.sqrt(np.mean(rest**2))) if len(rest) else math.inf

    def _of_delays(self, delays: np.ndarray, keep: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Sum of squares that the law leaves, gain and weight (delay, delay of the feedforward)."""
        y = self.asked_on(keep)
        feeds = delays if any(self.on) and not self.recorded else delays[:1]
        errors = np.array([np.concatenate([level(self.error(r, d, k)) for r, k in zip(self.runs, keep)]) for d in delays])
        fed = np.array([np.concatenate([level(o * self.fed(r, d, k)) for r, o, k in zip(self.runs, self.on, keep)]) for d in feeds])
        return _left(errors, fed, y)

    def slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Derivatives (row, number) of the law of run `k` as it is recorded with respect to x."""
        return self.as_recorded(k, functools.partial(self._slopes, k, x), rows)

    def _slopes(self, k: int, x: np.ndarray, rows: np.ndarray | slice) -> np.ndarray:
        """Derivatives (row, number) of the output of run `k`."""
        run, on = self.runs[k], self.on[k]
        fed, change = np.zeros((2, len(run.start[rows])))
        if on:
            fed = on * self.fed(run, x[3], rows)
            change = change if self.recorded else on * self.fed(run, x[3], rows, self.rate)
        return np.column_stack([self.error(run, x[2], rows), fed, -x[0] * self.rate(run, run.start[rows] - x[2]), -x[1] * change])

    def delay_of_feedforward(self) -> float:
        """Delay [s] between set points and recorded feedforward; the machine file's if it cannot be determined."""
        tp = self.runs[0].cycle
        known = [(r, r.velocity_feedforward, self.usable(r)) for r in self.runs if r.velocity_feedforward is not None]

        def left(delay: float) -> float:
            squares = 0.0
            for run, f, use in known:
                e = (f - feedforward_at(lambda late, run=run: self.read(run, run.start - late), delay, run.position_cycle))[use]  # type: ignore[misc]
                squares += float(np.sum(np.minimum(np.abs(e), 0.1 * np.abs(f[use]).max(initial=0.0)) ** 2))
            return squares

        best = min((np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE).tolist(), key=left)
        power = sum(float(np.sum(f[use] ** 2)) for _, f, use in known)
        return best if left(best) < 0.01 * power else self.axis.loops.feedforward_delay_s


def level(values: np.ndarray) -> np.ndarray:
    """(row, ...) values of one run without their mean, which its free constant takes."""
    return values - values.mean(axis=0) if len(values) else values


def pieces(of_runs: Sequence[np.ndarray]) -> np.ndarray:
    """Number of the piece (row,) of the motion, from an array with the rows of each run."""
    return np.concatenate([pieces_of(len(rows), k) for k, rows in enumerate(of_runs)])


def _left(errors: np.ndarray, fed: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Residual sum of squares (delay, feedforward delay) with the best gain and weight, and these two."""
    ee, ff, ef = np.sum(errors**2, axis=1)[:, None], np.sum(fed**2, axis=1)[None, :], errors @ fed.T
    ey, fy = (errors @ y)[:, None], (fed @ y)[None, :]
    determinant = ee * ff - ef**2
    alone = determinant <= 1e-9 * ee * np.maximum(ff, 1e-300)
    safe = np.where(alone, 1.0, determinant)
    kv = np.where(alone, ey / np.maximum(ee, 1e-300), (ff * ey - ef * fy) / safe)
    a_v = np.where(alone, 0.0, (ee * fy - ef * ey) / safe)
    left = float(y @ y) - kv * ey - a_v * fy
    return np.where(kv > 0.0, left, np.inf), kv, a_v


def _minima(left: np.ndarray) -> list[tuple[int, int]]:
    """Indices of the local minima of a grid, lowest first."""
    here = np.isfinite(left) & (left <= minimum_filter(left, footprint=generate_binary_structure(2, 1), mode="constant", cval=np.inf))
    places = [(int(i), int(j)) for i, j in zip(*np.nonzero(here))]
    return sorted(places, key=lambda p: float(left[p]))


@dataclass(frozen=True)
class Found:
    """A law with its fit and its numbers x: those of NAMES, and perhaps a time.

    `others`: numbers of laws that fit as well, whose distance widens the intervals. `left`: RMS of what it leaves, `rounding`: what the rounding of
    the record makes of it [axis units a second]. `left_out` (piece,): mean squares of the pieces of the motion, each predicted by the rest of the record.
    `words`: what it has beside NAMES; its time stands for {}. `lag`: the block that has this time, `blocks`: numbers of others, as `keyed`.
    `ends`: of the law of NAMES alone, the numbers with which the search of each interpolation ended.
    """

    law: PositionLaw
    fit: Fit
    x: np.ndarray
    others: list[np.ndarray]
    left: float
    rounding: float
    left_out: np.ndarray
    words: str = ""
    lag: Block | None = None
    blocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    delayed: bool = True
    ends: Mapping[PositionLaw, np.ndarray] = field(default_factory=dict)

    @property
    def apart(self) -> np.ndarray:
        """How far the numbers (n,) of laws that fit as well are from those of this one."""
        return np.abs(np.array([*self.others, self.x]) - self.x).max(axis=0)

    @property
    def half_of_time(self) -> float:
        """Half interval [s] of its time; 0 without one."""
        return float(self.fit.quantile * math.hypot(self.fit.deviations[4], self.apart[4], OF_COLUMNS_S)) if len(self.x) > 4 else 0.0

    @functools.cached_property
    def leaves_only_rounding(self) -> bool:
        """Whether nothing that it leaves is larger than the rounding of the recorded speed set point, so that no short event is in it."""
        return float(np.abs(self.fit.residual).max()) <= OF_ROUNDING * 0.5 * self.law.step


def found_law(law: PositionLaw, fit: Fit, x: np.ndarray, others: list[np.ndarray], left: float) -> Found:
    """A law with its numbers x, which leave `left`."""
    keep = law.usable_rows()
    left_out = held_out(law.columns(x, keep), law.rest(x, keep), pieces(keep))
    rounding = OF_ROUNDING * math.hypot(law.of_rounding(x), law.step / math.sqrt(12.0))
    return Found(law, fit, x, others, left, rounding, left_out)


def rms(fit: Fit) -> float:
    """RMS of what a law leaves."""
    return float(np.sqrt(np.mean(fit.residual**2)))
