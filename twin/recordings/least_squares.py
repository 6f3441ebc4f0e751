"""Linear regression with honest intervals: samples a millisecond apart are not independent.

    y = X b + e,   b = (Z'X)^-1 Z'y,   cov b = (Z'X)^-1 [sum_g (Z_g' e_g)(Z_g' e_g)'] (X'Z)^-1  G / (G - k)

Z is X itself, or instruments: columns that go with X but not with e, where a loop feeds e back into X.

The sum runs over clusters g (one stroke of an axis: what lies between two stops or reversals). Whatever the correlation within a
stroke, from filters, the control or an effect that the law does not hold, it is in the sum; strokes are taken as independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

CONFIDENCE = 0.95

RELATED = 1.1
"""Strokes of one run share what the law lacks (cogging, pre-sliding, a drive train's mode): intervals are this much wider than
independent strokes would make them. Found on drawn campaigns of their own (docs/identify.md)."""


@dataclass(frozen=True)
class Fit:
    """Result of a regression on k columns: values (k,), covariance (k, k), residual (row,), condition number of the scaled columns.

    `clusters` counts the strokes; `seen` says which columns the data excite at all (the others are 0 with infinite variance; what they
    are a combination of has infinite variance, too: in one direction Coulomb friction and weight are one number).
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
        """Half width of the interval in standard deviations: Student's t, as the variance comes from few strokes."""
        return float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, max(self.clusters - len(self.values), 2)))


EXCITED = 1e-9
"""A column whose part outside the others is below this fraction of its length carries no information."""

ENTANGLED = 1e-3
"""A column that takes at least this part in such a combination is known only together with it."""


def regress(columns: np.ndarray, y: np.ndarray, clusters: np.ndarray, instruments: np.ndarray | None = None) -> Fit:
    """Regression of y (row,) on columns (row, k); `clusters` (row,) names the stroke of each row, `instruments` (row, k) or none."""
    k = columns.shape[1]
    length = np.linalg.norm(columns, axis=0)
    seen = length > 0.0
    if not seen.any() or len(y) <= seen.sum():
        return Fit(np.zeros(k), np.diag(np.full(k, np.inf)), y.copy(), np.inf, 0, np.zeros(k, bool))
    scaled = columns[:, seen] / length[seen]
    # drop what is a combination of the columns before it
    names = np.flatnonzero(seen)
    seen[names[np.abs(np.diag(np.linalg.qr(scaled, mode="r"))) < EXCITED]] = False
    scaled = columns[:, seen] / length[seen]
    one_number = np.zeros(k, bool)
    for j in names[~seen[names]]:
        share = np.linalg.lstsq(scaled, columns[:, j] / length[j])[0]
        one_number[np.flatnonzero(seen)[np.abs(share) > ENTANGLED]] = True
    values, covariance = np.zeros(k), np.full((k, k), 0.0)
    z = scaled
    if instruments is not None:
        z = instruments[:, seen]
        norm = np.linalg.norm(z, axis=0)
        z = np.where(norm > 0.0, z / np.where(norm > 0.0, norm, 1.0), scaled)
    bread = np.linalg.inv(z.T @ scaled)
    found = bread @ (z.T @ y)
    residual = y - scaled @ found
    group = _enough(np.unique(clusters, return_inverse=True)[1], int(seen.sum()))
    count = int(group.max()) + 1
    scores = np.zeros((count, int(seen.sum())))
    np.add.at(scores, group, z * residual[:, None])
    meat = RELATED**2 * scores.T @ scores * count / max(count - int(seen.sum()), 1)
    index = np.ix_(np.flatnonzero(seen), np.flatnonzero(seen))
    covariance[index] = (bread @ meat @ bread.T) / np.outer(length[seen], length[seen])
    unknown = ~seen | one_number
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    values[seen] = found / length[seen]
    return Fit(values, covariance, residual, float(np.linalg.cond(scaled)), count, seen)


def _enough(stroke: np.ndarray, columns: int) -> np.ndarray:
    """Clusters (row,) for so many columns: the strokes, or equal pieces of them where the strokes are too few.

    The scores of all clusters add up to nothing. Of no more clusters than columns some direction has none at all, as if it were exact.
    """
    sizes = np.bincount(stroke)
    pieces = -(-(columns + 2) // len(sizes))
    place = np.zeros(len(stroke), int)
    for s, size in enumerate(sizes):
        place[stroke == s] = np.arange(size) * pieces // size
    return np.unique(stroke * pieces + place, return_inverse=True)[1]


def whiteness(residual: np.ndarray, lags: int = 40) -> tuple[np.ndarray, float]:
    """Autocorrelation (lags + 1,) of a residual and the share of lags outside the 95 % band of white noise (0.05 is white)."""
    e = residual - residual.mean()
    n = len(e)
    if n <= lags + 1 or not np.any(e):
        return np.zeros(lags + 1), 0.0
    correlation = np.array([np.dot(e[: n - k], e[k:]) for k in range(lags + 1)]) / np.dot(e, e)
    return correlation, float(np.mean(np.abs(correlation[1:]) > 1.96 / np.sqrt(n)))
