"""Analysis of a table of variants: main effects and interactions, sensitivity indices, the Pareto front, a surrogate.

Main effects and interactions are coefficients of a quadratic in factors scaled to -1 .. 1, with 95 % intervals from the
residuals: y = b0 + sum b_i x_i + sum b_ij x_i x_j. Catalogue entries have no order, so each but the first gets an indicator column. Sobol indices need the
sobol design (Saltelli sampling, SALib). The surrogate is that quadratic or a thin-plate spline, whichever predicts left-out variants
better; its error is that on the left-out variants.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
import itertools
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.interpolate import RBFInterpolator
from scipy.stats import t as student

FOLDS = 5
"""Folds of the cross-validation."""
LEAST_ROWS = 6
"""Least number of variants for a surrogate."""
GLOBAL_SPLINE = 600
"""Most variants for a global spline; above, each point uses its nearest NEIGHBOURS."""
NEIGHBOURS = 60
NO_EFFECT = 1e-9
"""Below this relative change over all variants a response depends on no factor."""
ROUNDING = 1e-9
"""Largest value, in the response's own unit (um, A, W, s), that counts as zero."""
FITS = 0.5
"""Largest accepted error of a surrogate over the spread of the response (R2 of 0.75)."""
SURE = 1e-3
"""Significance level for the influence of a factor if no two variants differ in it alone."""


@dataclass(frozen=True)
class Columns:
    """(factor, entry) of each column: the factor's values if entry is None, otherwise 1 where that entry is chosen. `first` has no column."""

    of: tuple[tuple[int, float | None], ...]
    first: dict[int, float]

    @property
    def factors(self) -> list[int]:
        """The factor of each column."""
        return [factor for factor, _ in self.of]

    def spread(self, table: np.ndarray) -> np.ndarray:
        """Columns (row, column) of factors (row, factor)."""
        return np.column_stack([table[:, i] if entry is None else (table[:, i] == entry).astype(float) for i, entry in self.of])


def columns_of(table: np.ndarray, listed: Collection[int] = ()) -> Columns:
    """Columns for factors (row, factor); the `listed` factors hold numbers of entries."""
    of: list[tuple[int, float | None]] = []
    first = {}
    for i in range(table.shape[1]):
        if i not in listed:
            of.append((i, None))
            continue
        first[i], *others = np.unique(table[:, i]).tolist()
        of += [(i, entry) for entry in others] or [(i, None)]
    return Columns(tuple(of), first)


@dataclass(frozen=True)
class Effect:
    """Half the change of a response from the low to the high end of a factor (or of two together), with its 95 % interval (NaN: no residuals)."""

    factors: tuple[str, ...]
    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Surrogate:
    """A function of factors (point, factor) fitted to the table; `error` is the RMS over left-out variants, in the response's unit."""

    kind: str
    error: float
    spread: float
    predict: Callable[[np.ndarray], np.ndarray]

    @property
    def fits(self) -> bool:
        """Does it predict left-out variants well enough?"""
        return self.error <= FITS * self.spread


@dataclass(frozen=True)
class Swing:
    """Range of a response along one factor with the others at their median, and the positions of its least and largest value."""

    factor: str
    swing: float
    least_at: float
    largest_at: float


@dataclass(frozen=True)
class _Fit:
    """A quadratic in scaled factors: terms as indices of factors, coefficients, their standard deviations and degrees of freedom."""

    terms: list[tuple[int, ...]]
    value: np.ndarray
    deviation: np.ndarray
    free: int


def _unit(low: np.ndarray, high: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (point, factor) scaled to -1 .. 1; a constant factor is 0."""
    return np.where(high > low, (2.0 * points - low - high) / np.where(high > low, high - low, 1.0), 0.0)


def _terms(table: np.ndarray, factors: Sequence[int]) -> list[tuple[int, ...]]:
    """Terms of the quadratic, as far as the rows suffice: constant, columns, pairs of different factors, squares of columns with three levels."""
    levels = [len(np.unique(column)) for column in table.T]
    varying = [i for i, count in enumerate(levels) if count > 1]
    terms: list[tuple[int, ...]] = [(), *((i,) for i in varying)]
    pairs: list[tuple[int, ...]] = [(i, j) for i, j in itertools.combinations(varying, 2) if factors[i] != factors[j]]
    for more in (pairs, [(i, i) for i in varying if levels[i] > 2]):
        if len(terms) + len(more) < len(table):
            terms += more
    return terms


def _columns(x: np.ndarray, terms: list[tuple[int, ...]]) -> np.ndarray:
    return np.column_stack([np.prod(x[:, list(term)], axis=1) if term else np.ones(len(x)) for term in terms])


def _fit(table: np.ndarray, y: np.ndarray, factors: Sequence[int]) -> _Fit:
    """Fit the quadratic of y in columns (row, column) that belong to these factors."""
    terms = _terms(table, factors)
    columns = _columns(_unit(table.min(axis=0), table.max(axis=0), table), terms)
    value, _, rank, _ = np.linalg.lstsq(columns, y, rcond=None)
    free = len(y) - int(rank)
    variance = float(np.sum((y - columns @ value) ** 2)) / free if free > 0 else np.nan
    return _Fit(terms, value, np.sqrt(np.maximum(np.diag(np.linalg.pinv(columns.T @ columns)) * variance, 0.0)), free)


def effects_of(
    names: Sequence[str], table: np.ndarray, y: np.ndarray, listed: Mapping[int, Sequence[str]] = MappingProxyType({})
) -> list[Effect]:
    """Main effects and interactions of one response (variant,), largest first.

    `listed` are the entry names of catalogue factors; their effects are relative to the first entry. Effects larger than the change over
    all variants are dropped: they come from factors that the design did not vary independently.
    """
    columns = columns_of(table, listed)
    said = [
        names[i] if entry is None else f"{names[i]}: {listed[i][round(entry)]} instead of {listed[i][round(columns.first[i])]}"
        for i, entry in columns.of
    ]
    fit, reached = _fit(columns.spread(table), y, columns.factors), float(np.ptp(y)) * (1.0 + ROUNDING)
    width = student.ppf(0.975, fit.free) * fit.deviation if fit.free > 0 else np.full(len(fit.terms), np.nan)
    found = [
        Effect(tuple(said[i] for i in term), float(b), float(b - w), float(b + w))
        for term, b, w in zip(fit.terms, fit.value, width)
        if len(set(term)) == len(term) > 0 and 2.0 * abs(b) <= reached
    ]
    return sorted(found, key=lambda e: -abs(e.value))


def depends(y: np.ndarray) -> bool:
    """Does a response change over the variants at all?"""
    largest = float(np.abs(y).max())
    return bool(largest > ROUNDING and np.ptp(y) > NO_EFFECT * largest)


def without_effect(names: Sequence[str], responses: Sequence[tuple[np.ndarray, np.ndarray]], listed: Collection[int] = ()) -> list[str]:
    """Factors that change none of the responses, each response given as factors (variant, factor) and values (variant,).

    If variants differ in one factor alone, their responses decide; otherwise a term of the quadratic with that factor must be
    significant. A factor with a single value in all variants is not judged. `listed` are the catalogue factors.
    """
    felt = {i for i in range(len(names)) if not any(np.ptp(table[:, i]) > 0 for table, _ in responses)}
    for table, y in responses:
        if not depends(y):
            continue
        least = NO_EFFECT * float(np.abs(y).max())
        columns = columns_of(table, listed)
        fit: _Fit | None = None
        for i in range(len(names)):
            if i in felt:
                continue
            _, group = np.unique(np.delete(table, i, axis=1), axis=0, return_inverse=True)
            count = np.bincount(group.ravel())
            if count.max() > 1:
                low, high = np.full(len(count), np.inf), np.full(len(count), -np.inf)
                np.minimum.at(low, group.ravel(), y)
                np.maximum.at(high, group.ravel(), y)
                if np.any(high - low > least):
                    felt.add(i)
                continue
            fit = fit or _fit(columns.spread(table), y, columns.factors)
            if fit.free > 0:
                bound = student.ppf(1.0 - SURE / (2.0 * len(fit.terms) * len(responses)), fit.free)
                own = {k for k, factor in enumerate(columns.factors) if factor == i}
                if any(own & {*t} and abs(b) > max(least, bound * d) for t, b, d in zip(fit.terms, fit.value, fit.deviation)):
                    felt.add(i)
            else:
                felt.add(i)  # cannot be judged
    return [name for i, name in enumerate(names) if i not in felt]


def sobol_of(problem: Mapping[str, Any], y: np.ndarray) -> dict[str, list[float]]:
    """First-order and total Sobol indices with 95 % intervals, in the order of the factors."""
    from SALib.analyze import sobol

    found = sobol.analyze(dict(problem), y, calc_second_order=False, seed=1, print_to_console=False)
    return {key: np.asarray(found[key], float).tolist() for key in ("S1", "S1_conf", "ST", "ST_conf")}


def pareto_front(values: np.ndarray) -> np.ndarray:
    """True for the rows (variant, response) on the Pareto front; all responses are minimised."""
    left = np.lexsort(values.T[::-1])
    front = np.zeros(len(values), bool)
    while len(left):
        first = values[left[0]]
        front[left[0]] = True
        # drop dominated rows; equal rows stay
        rest = values[left[1:]]
        left = left[1:][np.any(rest < first, axis=1) | np.all(rest == first, axis=1)]
    return front


def surrogate_of(factors: np.ndarray, y: np.ndarray, listed: Collection[int] = ()) -> Surrogate | None:
    """The better of quadratic and thin-plate spline by cross-validation over variants (variant, factor); None for too few variants.

    `listed` are the catalogue factors.
    """
    if len(y) < LEAST_ROWS:
        return None
    columns = columns_of(factors, listed)
    table = columns.spread(factors)
    low, high = table.min(axis=0), table.max(axis=0)

    def quadratic(rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        terms = _terms(table[rows], columns.factors)
        solution = np.linalg.lstsq(_columns(_unit(low, high, table[rows]), terms), y[rows], rcond=None)[0]
        return lambda points: _columns(_unit(low, high, points), terms) @ solution

    def spline(rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        few = len(rows) <= GLOBAL_SPLINE
        inner = RBFInterpolator(
            _unit(low, high, table[rows]), y[rows], kernel="thin_plate_spline", degree=1, neighbors=None if few else NEIGHBOURS
        )
        return lambda points: inner(_unit(low, high, points))

    def of_factors(inner: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], np.ndarray]:
        return lambda points: inner(columns.spread(points))

    fold = np.random.default_rng(0).permutation(len(y)) % FOLDS
    best: Surrogate | None = None
    for kind, make in (("quadratic", quadratic), ("thin-plate spline", spline)):
        try:
            left_out = np.concatenate([make(np.flatnonzero(fold != k))(table[fold == k]) - y[fold == k] for k in range(FOLDS)])
            error = float(np.sqrt(np.mean(left_out**2)))
            if np.isfinite(error) and (best is None or error < best.error):
                best = Surrogate(kind, error, float(np.std(y)), of_factors(make(np.arange(len(y)))))
        except (np.linalg.LinAlgError, ValueError):  # too few or coinciding points for this kind
            continue
    return best


def middle_of(table: np.ndarray, listed: Collection[int] = ()) -> np.ndarray:
    """The median of each factor (factor,); for `listed` (catalogue) factors one of their values."""
    low = np.quantile(table, 0.5, axis=0, method="lower")
    return np.where(np.isin(np.arange(table.shape[1]), list(listed)), low, np.median(table, axis=0))


def swings_of(names: Sequence[str], table: np.ndarray, y: np.ndarray, surrogate: Surrogate, listed: Collection[int] = ()) -> list[Swing]:
    """Swing of each factor on a surrogate of y that fits, largest first; unlike a main effect it includes an optimum inside the range."""
    out: list[Swing] = []
    if not surrogate.fits:
        return out
    reached = (float(y.min()), float(y.max()))
    for i, name in enumerate(names):
        values = np.unique(table[:, i]) if i in listed else np.linspace(table[:, i].min(), table[:, i].max(), 201)
        points = np.tile(middle_of(table, listed), (len(values), 1))
        points[:, i] = values
        # keep the prediction within the simulated range
        along = np.clip(surrogate.predict(points), *reached)
        out.append(Swing(name, float(np.ptp(along)), float(points[np.argmin(along), i]), float(points[np.argmax(along), i])))
    return sorted(out, key=lambda s: -s.swing)
