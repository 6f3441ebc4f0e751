"""Linear regression with cluster-robust intervals, because samples a millisecond apart are not independent.

y = X b + e,   b = (Z'X)^-1 Z'y,   cov b = (Z'X)^-1 [sum_g (Z_g' e_g)(Z_g' e_g)'] (X'Z)^-1  G / (G - k)

Z is X, or instruments: columns correlated with X but not with e, for a loop that feeds e back into X.

The sum runs over clusters g. A cluster is one stroke of an axis, between two stops or reversals. The sum includes any correlation
within a stroke, from filters, the control or unmodelled effects. Strokes count as independent.

The rounding of y is another error: equal values are rounded equally in all strokes (`with_rounding`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
import math

import numpy as np
from scipy.special import stdtrit  # scipy.stats takes longer to load than a fit

CONFIDENCE = 0.95

NORMAL_95 = 1.96
"""Half width of a 95 % interval in standard deviations of a normal distribution."""

SYMMETRIC = 0.2
"""Largest distance of a value from the middle of its interval, as a fraction of the half width, for an interval that counts as symmetric."""


@dataclass(frozen=True)
class Range:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    @classmethod
    def around(cls, value: float, half: float) -> Range:
        """A symmetric interval."""
        return cls(value, value - half, value + half)

    def times(self, factor: float) -> Range:
        """The same in another unit, or turned round."""
        return Range(factor * self.value, *sorted((factor * self.low, factor * self.high)))

    def plus(self, shift: float) -> Range:
        """The same shifted."""
        return Range(self.value + shift, self.low + shift, self.high + shift)

    def covering(self, other: Range) -> Range:
        """The same value with an interval that covers another one, too."""
        return Range(self.value, min(self.low, other.low), max(self.high, other.high))

    @property
    def half(self) -> float:
        """Half width."""
        return 0.5 * (self.high - self.low)

    @property
    def known(self) -> bool:
        """True if the interval excludes zero."""
        return self.low > 0.0 or self.high < 0.0

    @property
    def number(self) -> str:
        """The value with as many digits as its interval justifies, at least two and at most six."""
        standing = abs(self.value) / max(self.half, 1e-5 * abs(self.value), 1e-300)
        return f"{self.value:.{max(math.ceil(math.log10(max(standing, 1.0))) + 1, 2)}g}"

    @property
    def interval(self) -> str:
        """The interval in words: "+- half width", or "low to high" if it is not symmetric, like that of a logarithm."""
        if abs(self.high + self.low - 2.0 * self.value) < SYMMETRIC * (self.high - self.low):
            return f"+- {self.half:.2g}"
        if not 0.0 < self.high - self.low < math.inf:
            return f"{self.low:.3g} to {self.high:.3g}"
        largest, width = (math.floor(math.log10(size)) for size in (max(abs(self.low), abs(self.high)), self.high - self.low))
        digits = max(2 + largest - width, 3)  # two of the width
        return f"{self.low:.{digits}g} to {self.high:.{digits}g}"


RELATED = 1.1
"""Factor on the interval widths, because strokes of one run share unmodelled effects (cogging, pre-sliding, drive-train modes).
Calibrated on campaigns drawn for this purpose (docs/identify_theory.md)."""


@dataclass(frozen=True)
class Fit:
    """Result of a regression on k columns: values (k,), covariance (k, k), residual (row,), condition number of the scaled columns.

    `clusters` is the number of strokes. `seen` marks the columns that the data excite. The others have value 0 and infinite variance, and
    so have columns that cannot be separated from them: in one direction Coulomb friction and weight are one number.
    """

    values: np.ndarray
    covariance: np.ndarray
    residual: np.ndarray
    condition: float
    clusters: int
    seen: np.ndarray

    @property
    def deviations(self) -> np.ndarray:
        """Standard deviations (k,)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def quantile(self) -> float:
        """Half width of the interval in standard deviations: Student's t, because few strokes give the variance."""
        return quantile(self.clusters - len(self.values))


def quantile(freedom: float) -> float:
    """Half width of a 95 % interval in standard deviations that have so many degrees of freedom, at least 2."""
    return float(stdtrit(max(freedom, 2.0), 0.5 + CONFIDENCE / 2.0))


EXCITED = 1e-9
"""A column whose part orthogonal to the others is below this fraction of its norm carries no information."""

INSEPARABLE = 1e-3
"""A column with at least this share in such a combination cannot be separated from it."""


def regress(columns: np.ndarray, y: np.ndarray, clusters: np.ndarray, instruments: np.ndarray | None = None) -> Fit:
    """Regression of y (row,) on columns (row, k). `clusters` (row,): stroke of each row. `instruments` (row, k), optional."""
    k = columns.shape[1]
    length = np.linalg.norm(columns, axis=0)
    seen = length > 0.0
    if not seen.any() or len(y) <= seen.sum():
        return Fit(np.zeros(k), np.diag(np.full(k, np.inf)), y.copy(), np.inf, 0, np.zeros(k, bool))
    scaled = columns[:, seen] / length[seen]
    # drop columns that are combinations of earlier ones
    names = np.flatnonzero(seen)
    seen[names[np.abs(np.diag(np.linalg.qr(scaled, mode="r"))) < EXCITED]] = False
    scaled = columns[:, seen] / length[seen]
    one_number = np.zeros(k, bool)
    for j in names[~seen[names]]:
        share = np.linalg.lstsq(scaled, columns[:, j] / length[j])[0]
        one_number[np.flatnonzero(seen)[np.abs(share) > INSEPARABLE]] = True
    values, covariance = np.zeros(k), np.full((k, k), 0.0)
    if instruments is None:  # by QR: columns that are barely apart are singular in their products
        z, (q, r) = scaled, np.linalg.qr(scaled)
        inverse = np.linalg.inv(r)
        bread, found = inverse @ inverse.T, inverse @ (q.T @ y)
    else:
        z = instruments[:, seen]
        norm = np.linalg.norm(z, axis=0)
        z = np.where(norm > 0.0, z / np.where(norm > 0.0, norm, 1.0), scaled)
        bread = np.linalg.inv(z.T @ scaled)
        found = bread @ (z.T @ y)
    residual = y - scaled @ found
    group = _enough_clusters(np.unique(clusters, return_inverse=True)[1], int(seen.sum()))
    index = np.ix_(np.flatnonzero(seen), np.flatnonzero(seen))
    covariance[index] = sandwich(bread, z * residual[:, None], group) / np.outer(length[seen], length[seen])
    unknown = ~seen | one_number
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    values[seen] = found / length[seen]
    return Fit(values, covariance, residual, float(np.linalg.cond(scaled)), int(group.max()) + 1, seen)


def sandwich(bread: np.ndarray, scores: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Covariance (k, k) by the number (row,) of the cluster from 0, with the inverse information `bread` (k, k) and the score of each row (row, k)."""
    sums = sums_by(group, scores)
    count, k = sums.shape
    return np.asarray(RELATED**2 * bread @ (sums.T @ sums) @ bread.T * count / max(count - k, 1))


def sums_by(group: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Sums (group, k) of the rows of values (row, k) by the number (row,) of their group."""
    count, k = int(group.max()) + 1, values.shape[1]
    return np.array([np.bincount(group, column, count) for column in values.T]).reshape(k, count).T


def with_rounding(fit: Fit, columns: np.ndarray, step: float, noise: float) -> Fit:
    """The fit of y on these columns (row, k), y rounded to a step (0: not) with this noise before it, with the covariance of what rounding shifts.

    The mean of rounded values is a saw-tooth of the true one, of standard deviation step / sqrt(12). The noise damps its first harmonic by
    exp(-2 (pi noise / step)^2), the others more (Widrow and Kollar, Quantization Noise, 2008). Rows of one level of the fit, or of its opposite, have one
    such error with the sign of the level.
    """
    if step == 0.0:
        return fit
    y, length = columns @ fit.values, np.linalg.norm(columns, axis=0)
    length[~fit.seen] = np.inf
    _, level = np.unique(np.abs(np.rint(y / step)), return_inverse=True)
    shifts = sums_by(level, np.sign(y)[:, None] * np.linalg.pinv(columns / length).T / length)
    shifts *= step / math.sqrt(12.0) * math.exp(-2.0 * (math.pi * noise / step) ** 2)
    return replace(fit, covariance=fit.covariance + shifts.T @ shifts)


def solved(columns: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Least-squares coefficients (k,) of columns (row, k), scaled so that their units do not matter; 0 for a column of zeros."""
    norm = np.linalg.norm(columns, axis=0)
    scale = np.where(norm > 1e-300, norm, np.inf)
    return np.linalg.lstsq(columns / scale, y, rcond=None)[0] / scale


def _enough_clusters(stroke: np.ndarray, columns: int) -> np.ndarray:
    """Clusters (row,): the strokes, or equal pieces of them if there are too few strokes for the number of columns.

    The scores of all clusters sum to zero. With no more clusters than columns, some direction would have zero variance.
    """
    sizes = np.bincount(stroke)
    pieces = -(-(columns + 2) // len(sizes))
    if pieces == 1:
        return stroke
    order = np.argsort(stroke, kind="stable")
    place = np.empty(len(stroke), int)
    place[order] = np.arange(len(stroke)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return np.unique(stroke * pieces + place * pieces // sizes[stroke], return_inverse=True)[1]
