"""The search for the numbers of a position law on recorded runs, and what was found: see `position_control`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import functools
import math
from typing import Any

import numpy as np
from scipy.ndimage import generate_binary_structure, minimum_filter
from scipy.optimize import least_squares

from twin.control.block import Block
from twin.control.position_controller import feedforward_at
from twin.estimate.held_out_gain import held_out, pieces_of
from twin.estimate.regression import Fit, regress, solved
from twin.identify.position_law import MOST_DELAY_CYCLES, ROUNDING, PositionLaw, level, numbers_of_file
from twin.recordings.roughness import robust_deviation

STEPS_A_CYCLE = 4
"""Steps of the grid of delays per position cycle."""

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

SAME = 1e-6
"""Laws whose sums of squares differ by less than this share are one law: a delay of the set point by a cycle and more feedforward."""

OF_ROUNDING = 1.5
"""A law that leaves less than this multiple of what the rounding of its record makes lacks nothing: a lag would only smooth it."""

TRIMS = 8
"""Rounds in which a law leaves out its outliers, such as the cycles of a friction pulse."""

OF_COLUMNS_S = 1.2e-8
"""Standard deviation of a time [s] due to rounded columns and the set-point splines."""


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


def search(law: PositionLaw) -> tuple[np.ndarray, float, list[np.ndarray]]:
    """Grid and damped search: best values of NAMES, their residual RMS, and other solutions with a similar residual."""
    tp, keep = law.runs[0].cycle, some_rows(law)
    grid = np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE
    if sum(map(len, keep)) < 8:
        return np.full(4, np.nan), math.inf, []
    left, kv, a_v = _of_delays(law, grid, keep)
    starts = [np.array([kv[i, j], a_v[i, j], grid[i], grid[j]]) for i, j in _minima(left)[:STARTS]]
    starts.append(numbers_of_file(law.axis))
    ends: list[tuple[float, np.ndarray]] = []
    for start in starts:
        spread = robust_deviation(law.rest(start, keep)) or 1e-12
        if (found := descended(law, start, keep, loss="soft_l1", f_scale=3.0 * spread, max_nfev=40)) is None:
            continue
        x, left_over = found
        squares = np.sort(left_over**2)
        if x[0] > 0.0 and np.all(x[2:] > -tp) and np.all(x[2:] < (MOST_DELAY_CYCLES + 1) * tp):
            ends.append((float(np.sqrt(np.mean(squares[: max(int(TRIMMED * len(squares)), 1)]))), x))
    least, best = min(ends, key=lambda end: end[0], default=(math.inf, starts[0]))
    return best, least, [x for left, x in ends if left < RIVAL_RATIO * least]


def polished(law: PositionLaw, x: np.ndarray) -> tuple[Fit, np.ndarray]:
    """Regression at the solution, with intervals by strokes and without outliers."""
    fit: Fit | None = None
    usable = [law.usable(r) for r in law.runs]
    for _ in range(4):
        parts = []
        for k, (run, use, v) in enumerate(zip(law.runs, usable, law.asked)):
            columns, e = law.slopes(k, x), v - law.wanted(k, x)
            if use.any():
                centred, size = columns - columns[use].mean(axis=0), np.abs(columns[use]).max(axis=0)
                columns = centred * (np.abs(centred[use]).max(axis=0) > ROUNDING * size)
                e = e - float(np.median(e[use]))
            spread = max(robust_deviation(e[use]) if use.any() else 0.0, 1e-9)
            use = use & (np.abs(e) < OUT_OF_LINE * spread)
            parts.append((columns[use], e[use], run.clusters(k)[use]))
        fit = regress(*map(np.concatenate, zip(*parts)))
        step = fit.values[: len(x)]
        if not np.all(np.isfinite(step)) or abs(step[0]) > 0.1 * abs(x[0]) or np.max(np.abs(step[2:])) > 0.5 * law.runs[0].cycle:
            break  # keep the result of the search: these steps may only make small corrections
        x = x + step
        if np.all(np.abs(step) < 1e-9):
            break
    assert fit is not None
    if law.recorded:
        x = np.array([*x[:3], delay_of_feedforward(law.at(x)), *x[4:]])
    return fit, x


@functools.lru_cache(maxsize=4)
def in_whole_cycles(law: PositionLaw) -> tuple[np.ndarray, float]:
    """Values of NAMES (4,) with delays of whole cycles, which smooth no rounding, and what they leave (RMS without outliers)."""
    keep, grid = law.usable_rows(), np.arange(MOST_DELAY_CYCLES + 1) * law.runs[0].cycle
    left, kv, a_v = _of_delays(law, grid, keep)
    best = min(np.argwhere(left <= (1.0 + SAME) * left.min()).tolist(), key=sum, default=(0, 0))

    laws = (np.array([kv[i, j], a_v[i, j], grid[i], grid[j]]) for i, j in {(0, 0), tuple(best)})  # pulses may favour a delay
    return min((_trimmed(law, x, [0, 1]) for x in laws), key=lambda end: end[1])


def at_full_feedforward(law: PositionLaw, x: np.ndarray) -> tuple[np.ndarray, float]:
    """The law at a feedforward of weight 1, and what it leaves (RMS without outliers): a delay of the set point by d and a weight that is Kv d larger
    are one law at constant speed, and nearly one at all."""
    delay = x[2] + (1.0 - x[1]) / x[0]
    if not 0.0 <= delay <= MOST_DELAY_CYCLES * law.runs[0].cycle:
        return x, math.inf
    return _trimmed(law, np.array([x[0], 1.0, delay, *x[3:]]), [0, 2, 3])


def descended(law: PositionLaw, start: np.ndarray, keep: Sequence[np.ndarray], **how: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """The nearest optimum and what it leaves (row,), by `least_squares` with the options `how`. None without one."""

    scale = np.array([1.0, 0.1, *[0.25 * law.runs[0].cycle] * (len(start) - 2)])
    try:
        end = least_squares(lambda x: law.rest(x, keep), start, lambda x: -law.columns(x, keep), x_scale=scale, **how)
    except (ValueError, np.linalg.LinAlgError):
        return None
    return end.x, end.fun


def some_rows(law: PositionLaw) -> list[np.ndarray]:
    """(row,) Usable cycles of each run, of long ones only some."""
    keep = law.usable_rows()
    every = max(1, sum(len(k) for k in keep) // GRID_ROWS)
    return [k[::every] for k in keep]


def _trimmed(law: PositionLaw, x: np.ndarray, free: Sequence[int]) -> tuple[np.ndarray, float]:
    """The law with some of its numbers free, and what it leaves (RMS) without outliers."""
    rest, keep = np.zeros(0), law.usable_rows()
    for _ in range(TRIMS):
        rest = law.rest(x, keep)
        use = np.abs(rest) < OUT_OF_LINE * max(robust_deviation(rest), 1e-9)
        rest = rest[use]
        x[free] += solved(law.columns(x, keep)[use][:, free], rest)
    return x, float(np.sqrt(np.mean(rest**2))) if len(rest) else math.inf


def _of_delays(law: PositionLaw, delays: np.ndarray, keep: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum of squares that the law leaves, gain and weight (delay, delay of the feedforward)."""
    y = law.asked_on(keep)
    feeds = delays if any(law.on) and not law.recorded else delays[:1]
    errors = np.array([np.concatenate([level(law.error(r, d, k)) for r, k in zip(law.runs, keep)]) for d in delays])
    fed = np.array([np.concatenate([level(o * law.fed(r, d, k)) for r, o, k in zip(law.runs, law.on, keep)]) for d in feeds])
    return _left(errors, fed, y)


def delay_of_feedforward(law: PositionLaw) -> float:
    """Delay [s] between set points and recorded feedforward; the machine file's if it cannot be determined."""
    tp = law.runs[0].cycle
    known = [(r, r.velocity_feedforward, law.usable(r)) for r in law.runs if r.velocity_feedforward is not None]

    def left(delay: float) -> float:
        squares = 0.0
        for run, f, use in known:
            e = (f - feedforward_at(lambda late, run=run: law.read(run, run.start - late), delay, run.position_cycle))[use]  # type: ignore[misc]
            squares += float(np.sum(np.minimum(np.abs(e), 0.1 * np.abs(f[use]).max(initial=0.0)) ** 2))
        return squares

    best = min((np.arange(MOST_DELAY_CYCLES * STEPS_A_CYCLE + 1) * tp / STEPS_A_CYCLE).tolist(), key=left)
    power = sum(float(np.sum(f[use] ** 2)) for _, f, use in known)
    return best if left(best) < 0.01 * power else law.axis.loops.feedforward_delay_s


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


def rms(fit: Fit) -> float:
    """RMS of what a law leaves."""
    return float(np.sqrt(np.mean(fit.residual**2)))
