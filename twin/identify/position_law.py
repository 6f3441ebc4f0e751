"""The law of a position controller on recorded runs, its searches, and laws with more in them: see `position_control`."""

from collections.abc import Sequence
import functools
import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import generate_binary_structure, minimum_filter
from scipy.optimize import least_squares
from scipy.signal import lfilter

from twin.control.command_law import ROUNDED
from twin.control.position_controller import feedforward_at, position_law
from twin.estimate.held_out_gain import held_out, is_better, pieces_of
from twin.estimate.regression import Fit, regress
from twin.identify.axis_run import AxisRun
from twin.machine.axis import Axis
from twin.recordings.roughness import robust_deviation

MOST_DELAY_CYCLES = 12
STEPS_A_CYCLE = 4
"""Largest delay of the grid in position cycles, and grid steps per cycle."""

MOST_FEEDBACK_CYCLES = 3
"""The position is recorded at most this many cycles before or after its use."""

LAGS_CYCLES = (0.5, 1.0, 2.0, 4.0, 8.0)
"""Times of a lag of the set points from which it is searched, in position cycles."""

LEAST_LAG_CYCLES = 0.05
"""A shorter lag is none."""

LAG_STEP = 1e-3
"""Relative step of a derivative by the lag."""

FILTER_STEPS = 4
"""Steps of the search for a law behind a filter: only its delays are not linear."""

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

ALL_ROWS = slice(None)


def loop_position(run: AxisRun, axis: Axis) -> np.ndarray | None:
    """Position feedback (cycle,) in axis units: the scale, or the motor encoder if the machine file uses it."""
    if axis.encoder == "motor" and run.motor_at_axis is not None:
        return run.motor_at_axis
    return run.position


class PositionLaw:
    """The law on all runs for one interpolation (`way`; SLOPE is cubic), with a free constant in each run, behind a lag of the set points [s]."""

    def __init__(self, axis: Axis, runs: Sequence[AxisRun], way: str, lag: float = 0.0) -> None:
        self.axis, self.runs, self.way, self.lag = axis, runs, way, lag
        self.on = [0.0 if r.feedforward == "off" else 1.0 for r in runs]
        self.recorded = all(r.velocity_feedforward is not None for r in runs if r.feedforward != "off") and any(
            r.velocity_feedforward is not None and np.ptp(r.velocity_feedforward) > 0.0 for r in runs
        )

    def read(self, run: AxisRun, times: np.ndarray) -> np.ndarray:
        """Interpolated set point of a run at any times."""
        if self.way != "linear":
            return np.asarray(self.paths[id(run)](np.clip(times, 0.0, run.end))) if self.lag else run.setpoint_at(times)
        return np.interp(times, run.start, self.paths[id(run)](run.start) if self.lag else run.setpoint_at(run.start))

    @functools.cached_property
    def paths(self) -> dict[int, CubicSpline]:
        """Set points behind the lag over time by the identity of the run."""
        out = {}
        for run in self.runs:
            given = run.setpoint_at(run.start)
            kept = math.exp(-run.cycle / self.lag)
            out[id(run)] = CubicSpline(run.start, given[0] + lfilter([1.0 - kept], [1.0, -kept], given - given[0]))
        return out

    def error(self, run: AxisRun, x: Sequence[float] | np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Control error (row,) of one run for the delay x[2] of the set point, and a position x[4] after the recorded one."""
        position = loop_position(run, self.axis)
        assert position is not None
        return self.read(run, run.start[rows] - x[2]) - (self.position(run, x[4], rows) if len(x) > 4 else position[rows])

    @functools.cached_property
    def splines(self) -> dict[int, CubicSpline]:
        """Position over time by the identity of the run."""
        return {id(run): CubicSpline(run.start, loop_position(run, self.axis)) for run in self.runs}

    def position(self, run: AxisRun, later: float, rows: np.ndarray | slice = ALL_ROWS, derivative: int = 0) -> np.ndarray:
        """Recorded position (row,) at later times, or its speed."""
        return np.asarray(self.splines[id(run)](np.clip(run.start[rows] + later, run.start[0], run.start[-1]), derivative))

    def fed(self, run: AxisRun, delay: float, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Feedforward (row,) at weight 1: recorded, or the slope of the set points over a cycle, or at a moment."""
        if self.recorded:
            return (run.velocity_feedforward if run.velocity_feedforward is not None else np.zeros(len(run.start)))[rows]
        step = SHARP * run.cycle if self.way == SLOPE else run.cycle  # about the same moment
        return feedforward_at(lambda late: self.read(run, run.start[rows] - late), delay + 0.5 * (run.cycle - step), step)

    def residual(self, x: np.ndarray, rows: Sequence[np.ndarray | slice] | None = None) -> list[np.ndarray]:
        """v* minus the law (row,) of each run [axis units a second]; `rows` of each run, default all."""
        out = []
        for run, on, kept in zip(self.runs, self.on, rows or [ALL_ROWS] * len(self.runs)):
            assert run.speed_setpoint is not None
            wanted = position_law(x[0], x[1] * on, self.error(run, x, kept), self.fed(run, x[3], kept))
            out.append(run.speed_setpoint[kept] * self.axis.ratio - wanted)
        return out

    def usable(self, run: AxisRun) -> np.ndarray:
        """(cycle,) True without a limit and late enough in the run that the delayed set point is recorded."""
        early = np.arange(len(run.start)) < min(MOST_DELAY_CYCLES, len(run.start) // 4)
        return ~run.limited & ~early

    def some_rows(self) -> list[np.ndarray]:
        """(row,) Usable cycles of each run, of long ones only some."""
        keep = [np.flatnonzero(self.usable(r)) for r in self.runs]
        every = max(1, sum(len(k) for k in keep) // GRID_ROWS)
        return [k[::every] for k in keep]

    def search(self) -> tuple[np.ndarray, float, list[np.ndarray]]:
        """Grid and damped search: best values of NAMES, their residual RMS, and other solutions with a similar residual."""
        tp, keep = self.runs[0].cycle, self.some_rows()
        grid = np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE
        y = np.concatenate([_level(r.speed_setpoint[k] * self.axis.ratio) for r, k in zip(self.runs, keep)])  # type: ignore[index]
        if len(y) < 8:
            return np.full(4, np.nan), math.inf, []
        feeds = grid if any(self.on) and not self.recorded else grid[:1]
        errors = np.array([np.concatenate([_level(self.error(r, (0.0, 0.0, d), k)) for r, k in zip(self.runs, keep)]) for d in grid])
        fed = np.array([np.concatenate([_level(o * self.fed(r, d, k)) for r, o, k in zip(self.runs, self.on, keep)]) for d in feeds])
        left, kv, a_v = _left(errors, fed, y)
        starts = []
        for i, j in _minima(left)[:STARTS]:
            starts.append(np.array([kv[i, j], a_v[i, j], grid[i], feeds[j]]))
        loops = self.axis.loops
        starts.append(
            np.array([loops.position_gain_per_s, loops.velocity_feedforward or 1.0, loops.position_delay_s, loops.feedforward_delay_s])
        )
        best, least = starts[0], math.inf
        ends: list[tuple[float, np.ndarray]] = []
        for start in starts:
            spread = robust_deviation(self.rest(start, keep))
            if (found := self.descended(start, keep, spread)) is None:
                continue
            x, left_over = found
            squares = np.sort(left_over**2)
            rms = float(np.sqrt(np.mean(squares[: max(int(TRIMMED * len(squares)), 1)])))
            if x[0] > 0.0 and np.all(x[2:] > -tp) and np.all(x[2:] < (MOST_DELAY_CYCLES + 1) * tp):
                ends.append((rms, x))
                if rms < least:
                    best, least = x, rms
        return best, least, [x for rms, x in ends if rms < RIVAL_RATIO * least]

    def rest(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """What the law leaves (row,) on some rows of each run, without the free constant of the run."""
        return np.concatenate([_level(e) for e in self.residual(x, keep)])

    def columns(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> np.ndarray:
        """Derivatives of the law (row, number) on some rows of each run, without the free constant of the run."""
        return np.vstack([_level(self._slopes(r, o, x, k)) for r, o, k in zip(self.runs, self.on, keep)])

    def descended(self, start: np.ndarray, keep: Sequence[np.ndarray], spread: float) -> tuple[np.ndarray, np.ndarray] | None:
        """The nearest optimum and what it leaves (row,); residuals beyond three times `spread` count linearly. None without one."""

        def rest(x: np.ndarray) -> np.ndarray:
            return self.rest(x, keep)

        def slopes(x: np.ndarray) -> np.ndarray:
            return -self.columns(x, keep)[:, : len(x)]

        scale = np.array([1.0, 0.1, *[0.25 * self.runs[0].cycle] * (len(start) - 2)])
        try:
            end = least_squares(rest, start, slopes, x_scale=scale, loss="soft_l1", f_scale=3.0 * (spread or 1e-12), max_nfev=40)
        except (ValueError, np.linalg.LinAlgError):
            return None
        return end.x, end.fun

    def polished(self, x: np.ndarray) -> tuple[Fit, np.ndarray]:
        """Regression at the solution, with intervals by strokes and without outliers."""
        fit: Fit | None = None
        usable = [self.usable(r) for r in self.runs]
        for _ in range(4):
            rows, y, clusters = [], [], []
            for k, (run, on, use) in enumerate(zip(self.runs, self.on, usable)):
                columns = self._slopes(run, on, x)
                e = self.residual(x)[k]
                if use.any():
                    centred, size = columns - columns[use].mean(axis=0), np.abs(columns[use]).max(axis=0)
                    columns = centred * (np.abs(centred[use]).max(axis=0) > ROUNDING * size)
                    e = e - float(np.median(e[use]))
                spread = max(robust_deviation(e[use]) if use.any() else 0.0, 1e-9)
                use = use & (np.abs(e) < OUT_OF_LINE * spread)
                rows.append(columns[use])
                y.append(e[use])
                clusters.append((run.strokes + 100_000 * k)[use])
            fit = regress(np.vstack(rows), np.concatenate(y), np.concatenate(clusters))
            step = fit.values[: len(x)]
            if not np.all(np.isfinite(step)) or abs(step[0]) > 0.1 * abs(x[0]) or np.max(np.abs(step[2:])) > 0.5 * self.runs[0].cycle:
                break  # keep the result of the search: these steps may only make small corrections
            x = x + step
            if np.all(np.abs(step) < 1e-9):
                break
        assert fit is not None
        if self.recorded:
            x = np.array([*x[:3], self._delay_of_feedforward(), *x[4:]])
        return fit, x

    def with_feedback_of_another_time(self, x: np.ndarray) -> tuple[Fit, np.ndarray, list[np.ndarray]] | None:
        """The law with the time of the position after that of the record as a fifth number, and its rivals, if it leaves less of the pieces of the motion."""
        tp, keep = self.runs[0].cycle, self.some_rows()
        spread = robust_deviation(self.rest(x, keep))
        ends: list[tuple[float, np.ndarray]] = []

        def search(start: np.ndarray) -> None:
            found = self.descended(start, keep, spread)
            if found is not None and found[0][0] > 0.0 and abs(found[0][4]) <= MOST_FEEDBACK_CYCLES * tp:
                ends.append((float(np.std(found[1])), found[0]))

        for weight in dict.fromkeys((float(x[1]), 0.0)):  # at a steady speed the delay of the set point takes up both
            for later in (-tp, 0.0, tp):
                search(np.array([x[0], weight, x[2] - (x[1] - weight) / x[0] - later, x[3], later]))
        if not ends:
            return None
        found = min(ends, key=lambda end: end[0])[1]
        for late in (-2.0 * tp, -tp, tp, 2.0 * tp):  # feedforward takes up a delay
            search(found + np.array([0.0, found[0] * late, late, 0.0, 0.0]))
        least, found = min(ends, key=lambda end: end[0])
        fit, found = self.polished(found)
        if not np.all(np.isfinite(found)) or not _leaves_less(self.rest(found, keep), self.rest(x, keep), keep):
            return None
        return fit, found, [x for rms, x in ends if rms < RIVAL_RATIO * least + ROUNDING]

    def with_set_point_lag(self, x: np.ndarray) -> tuple[Fit, np.ndarray, list[np.ndarray]] | None:
        """The law behind a lag of the set points as a fifth number, and its rivals, if it leaves less of the pieces of the motion."""
        tp, keep = self.runs[0].cycle, self.some_rows()
        if not self._shows_curvature(x, keep):
            return None

        @functools.lru_cache(maxsize=2)  # the search asks for what is left and for slopes at the same lag
        def behind(lag: float) -> PositionLaw:
            return PositionLaw(self.axis, self.runs, self.way, max(lag, LEAST_LAG_CYCLES * tp))

        def rest(z: np.ndarray) -> np.ndarray:
            return behind(float(z[4])).rest(z[:4], keep)

        def slopes(z: np.ndarray) -> np.ndarray:
            return -behind(float(z[4])).columns(z[:4], keep)

        scale, ends = np.array([1.0, 0.1, *[0.25 * tp] * 3]), list[tuple[float, np.ndarray]]()

        def search(start: np.ndarray) -> None:
            try:
                end = least_squares(rest, start, slopes, method="lm", x_scale=scale, max_nfev=100)
            except (ValueError, np.linalg.LinAlgError):
                return
            if end.x[0] > 0.0 and end.x[4] > LEAST_LAG_CYCLES * tp:
                ends.append((float(np.std(end.fun)), end.x))

        for lag in np.array(LAGS_CYCLES) * tp:
            search(np.array([*x[:2], *np.maximum(x[2:4] - lag, 0.0), lag]))
        if not ends:
            return None
        found = min(ends, key=lambda end: end[0])[1]
        for late in (-tp, tp, 2.0 * tp):  # feedforward takes up a delay, and so does the lag
            search(found + np.array([0.0, found[0] * late, late, 0.0, 0.0]))
        least, found = min(ends, key=lambda end: end[0])
        if not _leaves_less(rest(found), self.rest(x, keep), keep):
            return None
        fit, there = behind(float(found[4])).polished(found[:4])
        if not np.all(np.isfinite(there)) or not np.all(np.isfinite(fit.deviations[[0, 4]])):
            return None
        found, last = np.append(there, found[4]), np.append(there, found[4] + fit.values[4])
        if abs(fit.values[4]) < LAG_STEP * found[4]:
            found = last
        return fit, found, [last, *(at for rms, at in ends if rms < RIVAL_RATIO * least + ROUNDING)]

    def _shows_curvature(self, x: np.ndarray, keep: Sequence[np.ndarray]) -> bool:
        """Whether the curvature of the set points tells more of most pieces of the motion than the numbers of the law do.

        A lag T acts as a delay T, which the delay of the law takes up, and as T^2 times the curvature. Without it there is no lag to search.
        """
        cycles, bent = np.arange(-1, 2) * self.runs[0].cycle, []
        for run, on, k in zip(self.runs, self.on, keep):
            errors = [self.error(run, (0.0, 0.0, x[2] + late), k) for late in cycles]
            feeds = [on * self.fed(run, x[3] + late, k) for late in cycles]
            bent.append(_level(x[0] * np.diff(errors, 2, axis=0)[0] + x[1] * np.diff(feeds, 2, axis=0)[0]))
        columns, rest, pieces = self.columns(x, keep), self.rest(x, keep), _pieces(keep)
        richer = np.column_stack([columns, np.concatenate(bent)])
        return bool(np.mean(held_out(richer, rest, pieces) < held_out(columns, rest, pieces)) > 0.5)

    def behind_a_filter(self, x: np.ndarray) -> tuple[Fit, np.ndarray, float] | None:
        """The law if its output is recorded behind a filter: fit, NAMES, and the time T of the filter [s]; None without one.

        r (w + T dw/dt + a d2w/dt2) = law: T and a are linear in the steps of the record before and after a cycle. A lag of an output that
        the control holds for its cycle is exactly one of these steps.
        """
        tp = self.runs[0].cycle
        fit: Fit | None = None
        for _ in range(FILTER_STEPS):
            columns, y, clusters = [], [], []
            for k, (run, rest) in enumerate(zip(self.runs, self.residual(x))):
                w = np.asarray(run.speed_setpoint) * self.axis.ratio
                use = self.usable(run)
                use[[0, -1]] = False
                steps = -np.column_stack([np.append(np.diff(w), 0.0), np.diff(w, prepend=w[0])])
                columns.append(_level(np.hstack([self._slopes(run, self.on[k], x), steps])[use]))
                y.append(_level(rest[use]))
                clusters.append((run.strokes + 100_000 * k)[use])
            fit = regress(np.vstack(columns), np.concatenate(y), np.concatenate(clusters))
            x = x + fit.values[:4]
            if not np.all(np.isfinite(x)) or x[0] <= 0.0 or np.max(np.abs(fit.values[2:4])) > MOST_DELAY_CYCLES * tp:
                return None
        assert fit is not None
        time = float(fit.values[4:].sum()) * tp
        return (fit, x, time) if time > LEAST_LAG_CYCLES * tp else None

    def as_pid(self, x: np.ndarray) -> Fit | None:
        """The law of a PID without delays, v* = P e + F1 f + I int e dt + F2 df/dt, if it predicts the pieces of the motion better than NAMES at x."""
        columns, given, clusters, pieces = self._terms()
        rest = np.concatenate([_level(left[self.usable(run)]) for run, left in zip(self.runs, self.residual(x))])
        rounding = ROUNDED * float(np.std(given))
        if not is_better(held_out(columns, given, pieces), held_out(np.zeros((len(rest), 1)), rest, pieces), rounding):
            return None
        return regress(columns, given, clusters)

    def without_delays(self) -> Fit:
        """The law v* = Kv e + a_v f, with the gain alone if no run shows a feedforward."""
        columns, given, clusters, _ = self._terms()
        return regress(columns[:, : 2 if any(self.on) else 1], given, clusters)

    def _terms(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Columns (row, 4) of a PID without delays, v* (row,), and the numbers of stroke and piece (row,) of the usable cycles."""
        columns, y, clusters = [], [], []
        for k, (run, on) in enumerate(zip(self.runs, self.on)):
            use, error, fed = self.usable(run), self.error(run, np.zeros(3)), on * self.fed(run, 0.0)
            curvature = (fed - on * self.fed(run, run.cycle)) / run.cycle
            columns.append(_level(np.column_stack([error, fed, np.cumsum(error) * run.cycle, curvature])[use]))
            y.append(_level(run.speed_setpoint[use] * self.axis.ratio))  # type: ignore[index]
            clusters.append((run.strokes + 100_000 * k)[use])
        return np.vstack(columns), np.concatenate(y), np.concatenate(clusters), _pieces(y)

    def _slopes(self, run: AxisRun, on: float, x: np.ndarray, rows: np.ndarray | slice = ALL_ROWS) -> np.ndarray:
        """Columns (row, 4 or 5): derivatives of the law with respect to x."""
        h, late = 1e-3 * run.cycle, run.start[rows] - x[2]
        if self.way != "linear":
            path = self.paths[id(run)] if self.lag else run.setpoint
            moved = path(np.clip(late, 0.0, run.end), 1) * (late > 0.0)
        else:
            moved = (self.read(run, late + h) - self.read(run, late - h)) / (2.0 * h)
        fed = on * self.fed(run, x[3], rows) if on else np.zeros(len(late))
        change = (
            on * (self.fed(run, x[3] - h, rows) - self.fed(run, x[3] + h, rows)) / (2.0 * h)
            if on and not self.recorded
            else np.zeros(len(late))
        )
        more = [-x[0] * self.position(run, x[4], rows, derivative=1)] if len(x) > 4 else []
        if self.lag:
            longer = PositionLaw(self.axis, [run], self.way, self.lag * (1.0 + LAG_STEP))
            longer.recorded = self.recorded
            changed = x[0] * (longer.error(run, x, rows) - self.error(run, x, rows)) + x[1] * on * (
                longer.fed(run, x[3], rows) - self.fed(run, x[3], rows)
            )
            more.append(changed / (LAG_STEP * self.lag))
        return np.column_stack([self.error(run, x, rows), fed, -x[0] * moved, -x[1] * change, *more])

    def _delay_of_feedforward(self) -> float:
        """Delay [s] between set points and recorded feedforward; the machine file's if it cannot be determined."""
        tp = self.runs[0].cycle
        known = [(r, r.velocity_feedforward, self.usable(r)) for r in self.runs if r.velocity_feedforward is not None]

        def left(delay: float) -> float:
            squares = 0.0
            for run, f, use in known:
                e = (f - feedforward_at(lambda late, run=run: self.read(run, run.start - late), delay, tp))[use]  # type: ignore[misc]
                squares += float(np.sum(np.minimum(np.abs(e), 0.1 * np.abs(f[use]).max(initial=0.0)) ** 2))
            return squares

        best = min((np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE).tolist(), key=left)
        power = sum(float(np.sum(f[use] ** 2)) for _, f, use in known)
        return best if left(best) < 0.01 * power else self.axis.loops.feedforward_delay_s


def _level(values: np.ndarray) -> np.ndarray:
    """(row, ...) values of one run without their mean, which its free constant takes."""
    return values - values.mean(axis=0) if len(values) else values


def _pieces(of_runs: Sequence[np.ndarray]) -> np.ndarray:
    """Number of the piece (row,) of the motion, from an array with the rows of each run."""
    return np.concatenate([pieces_of(len(rows), k) for k, rows in enumerate(of_runs)])


def _leaves_less(rest: np.ndarray, of_simpler: np.ndarray, keep: Sequence[np.ndarray]) -> bool:
    """Whether a law leaves less of the pieces of the motion than a simpler one, from what both leave (row,) on these rows of each run."""
    pieces = _pieces(keep)
    none = np.zeros((len(pieces), 1))
    return is_better(held_out(none, rest, pieces), held_out(none, of_simpler, pieces), 0.0)


def linearised(run: AxisRun, axis: Axis, x: np.ndarray, on: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns (cycle, 4) of corrections to NAMES at x, and the residual of v* (cycle,) [axis units a second], of one run."""
    one = PositionLaw(axis, [run], "cubic")
    one.on, one.recorded = [on], False
    return one._slopes(run, on, x), one.residual(x)[0]


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
