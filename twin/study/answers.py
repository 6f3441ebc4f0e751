"""What a table of variants answers: main effects and interactions, sensitivity indices, the Pareto front, a surrogate.

Main effects and interactions are coefficients of a quadratic in factors scaled to -1 .. 1, with 95 % intervals from the
residuals: y = b0 + sum b_i x_i + sum b_ij x_i x_j. Sobol indices need the sobol design (Saltelli sampling, SALib). The
surrogate is that quadratic or a thin-plate spline, whichever predicts left-out variants better; its error is that of the variants left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import itertools

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.stats import t as student

FOLDS = 5
NO_EFFECT = 1e-9
"""A response that changes by less than this (relative) over all variants does not depend on any factor."""


@dataclass(frozen=True)
class Effect:
    """Half the change of a response from the low to the high end of a factor (or of two together), with its 95 % interval."""

    factors: tuple[str, ...]
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Surrogate:
    """A function fitted to the table: `error` is the RMS over left-out variants, in the response's unit."""

    kind: str
    error: float
    spread: float
    predict: Callable[[np.ndarray], np.ndarray]


def scaled(table: np.ndarray) -> np.ndarray:
    """Factors (variant, factor) scaled to -1 .. 1; a constant one is 0."""
    low, high = table.min(axis=0), table.max(axis=0)
    return np.where(high > low, (2.0 * table - low - high) / np.where(high > low, high - low, 1.0), 0.0)


def terms_of(count: int, rows: int, levels: np.ndarray) -> list[tuple[int, ...]]:
    """Terms of the quadratic that the rows can carry: the constant, factors, pairs, squares of factors with three levels."""
    varying = [i for i in range(count) if levels[i] > 1]
    terms: list[tuple[int, ...]] = [(), *((i,) for i in varying)]
    pairs = list(itertools.combinations(varying, 2))
    squares = [(i, i) for i in varying if levels[i] > 2]
    for more in (pairs, squares):
        if len(terms) + len(more) < rows:
            terms += more
    return terms


def _columns(x: np.ndarray, terms: list[tuple[int, ...]]) -> np.ndarray:
    return np.column_stack([np.prod(x[:, list(term)], axis=1) if term else np.ones(len(x)) for term in terms])


def effects_of(names: list[str], table: np.ndarray, y: np.ndarray) -> list[Effect]:
    """Main effects and interactions of one response, largest first."""
    x = scaled(table)
    levels = np.array([len(np.unique(column)) for column in table.T])
    terms = terms_of(len(names), len(y), levels)
    design = _columns(x, terms)
    solution, _, rank, _ = np.linalg.lstsq(design, y, rcond=None)
    free = len(y) - rank
    variance = float(np.sum((y - design @ solution) ** 2)) / free if free > 0 else np.nan
    deviation = np.sqrt(np.maximum(np.diag(np.linalg.pinv(design.T @ design)) * variance, 0.0))
    width = student.ppf(0.975, free) * deviation if free > 0 else np.full(len(terms), np.nan)
    found = [
        Effect(tuple(names[i] for i in term), float(b), float(b - w), float(b + w))
        for term, b, w in zip(terms, solution, width)
        if term and not (len(term) == 2 and term[0] == term[1])
    ]
    return sorted(found, key=lambda e: -abs(e.value))


def sobol_of(problem: dict, y: np.ndarray) -> dict[str, list[float]]:  # type: ignore[type-arg]
    """First-order and total Sobol indices with 95 % intervals, in the order of the factors."""
    from SALib.analyze import sobol

    found = sobol.analyze(problem, y, calc_second_order=False, seed=1, print_to_console=False)
    return {key: np.asarray(found[key], float).tolist() for key in ("S1", "S1_conf", "ST", "ST_conf")}


def pareto_front(values: np.ndarray) -> np.ndarray:
    """True for the rows (variant, response) that no other row beats in everything; all are to be small."""
    front = np.ones(len(values), bool)
    for i, row in enumerate(values):
        front[i] = not np.any(np.all(values <= row, axis=1) & np.any(values < row, axis=1))
    return front


def surrogate_of(table: np.ndarray, y: np.ndarray) -> Surrogate | None:
    """The better of quadratic and thin-plate spline by variants left out; None with too few of them."""
    if len(y) < 6:
        return None
    low, high = table.min(axis=0), table.max(axis=0)

    def unit(points: np.ndarray) -> np.ndarray:
        return np.where(high > low, (2.0 * points - low - high) / np.where(high > low, high - low, 1.0), 0.0)

    levels = np.array([len(np.unique(column)) for column in table.T])

    def quadratic(rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        terms = terms_of(table.shape[1], len(rows), levels)
        solution = np.linalg.lstsq(_columns(unit(table[rows]), terms), y[rows], rcond=None)[0]
        return lambda points: _columns(unit(points), terms) @ solution

    def spline(rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        inner = RBFInterpolator(unit(table[rows]), y[rows], kernel="thin_plate_spline", degree=1)
        return lambda points: inner(unit(points))

    fold = np.random.default_rng(0).permutation(len(y)) % FOLDS
    best: Surrogate | None = None
    for kind, make in (("quadratic", quadratic), ("thin-plate spline", spline)):
        try:
            left_out = np.concatenate([make(np.flatnonzero(fold != k))(table[fold == k]) - y[fold == k] for k in range(FOLDS)])
            error = float(np.sqrt(np.mean(left_out**2)))
            if best is None or error < best.error:
                best = Surrogate(kind, error, float(np.std(y)), make(np.arange(len(y))))
        except (np.linalg.LinAlgError, ValueError):  # too few or coinciding points for this kind
            continue
    return best


@dataclass(frozen=True)
class Swing:
    """How far a response moves along one factor with the others at their median, and where it is least and largest."""

    factor: str
    swing: float
    least_at: float
    largest_at: float


def swings_of(names: list[str], table: np.ndarray, surrogate: Surrogate) -> list[Swing]:
    """Swing of each factor on the surrogate, largest first: it also sees an optimum inside, which a main effect does not."""
    out = []
    for i, name in enumerate(names):
        points = np.tile(np.median(table, axis=0), (201, 1))
        points[:, i] = np.linspace(table[:, i].min(), table[:, i].max(), 201)
        y = surrogate.predict(points)
        out.append(Swing(name, float(np.ptp(y)), float(points[np.argmin(y), i]), float(points[np.argmax(y), i])))
    return sorted(out, key=lambda s: -s.swing)


def depends(y: np.ndarray) -> bool:
    """Does a response change over the variants at all?"""
    return bool(np.ptp(y) > NO_EFFECT * max(float(np.abs(y).max()), 1e-12))
