"""A problem: free numbers, and a function from their values to residuals.

    residuals = f(values),  part -> signal -> (row,)                           parts are independent records of one system

Each free number moves one part. Parts are solved side by side. One evaluation moves one number of each part, so that the evaluations of a
difference quotient depend on the part with the most numbers only.

Near a point: residual and columns of each part, what they determine, and the step to the least squares.

r(x + d) = r + J d,    r and J in units of the RMS of each signal
damped step:   min |r + J d|^2 + m |D d|^2  within the bounds,  D = lengths of the columns
covariance:    (J'J)^-1 [sum over clusters g of (J_g' r_g)(J_g' r_g)'] (J'J)^-1 RELATED^2 G / (G - k)
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
import itertools
import math
from typing import Protocol

import numpy as np
from scipy.optimize import lsq_linear

from twin.estimate.held_out_gain import rms_of
from twin.estimate.regression import quantile, sandwich, sums_by

Values = Mapping[Hashable, float]
"""Name of a free number -> its value in the units of the search."""

Residuals = Mapping[str, Mapping[str, np.ndarray]]
"""Part -> signal -> residual (row,)."""


@dataclass(frozen=True)
class Free:
    """A free number in the units of the search: a change of 1 is large there.

    `step`: of the difference quotient; `part`: the part that it moves; `low`, `high`: bounds.
    """

    name: Hashable
    start: float
    step: float
    part: str
    low: float = -math.inf
    high: float = math.inf

    def step_at(self, value: float) -> float:
        """The step away from a bound."""
        return self.step if value + self.step <= self.high else -self.step


class Problem(Protocol):
    """What an estimate needs to know. Shapes of the residuals do not depend on the values."""

    @property
    def free(self) -> Sequence[Free]:
        """The free numbers."""
        ...

    def residuals(self, many: Sequence[Values]) -> Sequence[Residuals | None]:
        """Residuals for several sets of values, evaluated together; None where there are none, as for an unstable system."""
        ...

    def clusters(self, part: str) -> Mapping[str, np.ndarray]:
        """Signal -> cluster (row,) of each row; rows of one cluster are not independent."""
        ...


def by_part(free: Sequence[Free]) -> dict[str, list[Free]]:
    """Part -> its free numbers."""
    return {part: [one for one in free if one.part == part] for part in dict.fromkeys(one.part for one in free)}


UNSEEN = 1e-9
"""A column shorter than this share of the longest has no effect on the residual."""


@dataclass(frozen=True)
class Linearised:
    """One part at a point: residual (row,), columns (row, k) and clusters (row,), numbered from 0."""

    residual: np.ndarray
    columns: np.ndarray
    clusters: np.ndarray

    @property
    def seen(self) -> np.ndarray:
        """(k,) True for numbers that the residual depends on."""
        length = np.linalg.norm(self.columns, axis=0)
        return np.asarray(length > UNSEEN * max(float(length.max(initial=0.0)), 1e-300))

    def step(self, damping: float, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Damped step (k,) within low and high (k,); numbers without an effect stay."""
        seen, out = self.seen, np.zeros(self.columns.shape[1])
        if seen.any():
            length = np.linalg.norm(self.columns[:, seen], axis=0)
            q, r = np.linalg.qr(self.columns[:, seen] / length)
            rows = np.vstack([r, np.sqrt(damping) * np.eye(len(length))])
            target = np.concatenate([-(q.T @ self.residual), np.zeros(len(length))])
            out[seen] = lsq_linear(rows, target, (low[seen] * length, high[seen] * length), method="bvls").x / length
        return out

    def solved(self) -> tuple[np.ndarray, np.ndarray]:
        """Change (k,) to the least squares and its covariance (k, k), by clusters. Numbers without an effect have change 0 and infinite variance."""
        k, seen = self.columns.shape[1], self.seen
        change, covariance = np.zeros(k), np.diag(np.where(seen, 0.0, np.inf))
        if seen.any():
            length = np.linalg.norm(self.columns[:, seen], axis=0)
            x = self.columns[:, seen] / length
            bread = np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
            found = -bread @ (x.T @ self.residual)
            own = sandwich(bread, x * (self.residual + x @ found)[:, None], self.clusters)
            change[seen], covariance[np.ix_(seen, seen)] = found / length, own / np.outer(length, length)
        return change, covariance

    def deviations(self) -> np.ndarray:
        """Standard deviations (k,); infinite for numbers without an effect."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.solved()[1]), 0.0)))

    def half_widths(self) -> np.ndarray:
        """Half widths (k,) of the 95 % intervals.

        Few clusters may determine a number: of a long record only the short moves. Student's t has the degrees of freedom of
        n = (sum w_g)^2 / sum w_g^2 clusters, w_g = squares of the column in cluster g, less what the other columns explain
        (Carter, Schnepel and Steigerwald 2017).
        """
        out, seen = self.deviations(), self.seen
        x = self.columns[:, seen] / np.linalg.norm(self.columns[:, seen], axis=0)
        alone = x @ np.linalg.pinv(x.T @ x, rcond=1e-12, hermitian=True)
        weights = sums_by(self.clusters, alone**2).T
        effective = weights.sum(axis=1) ** 2 / np.maximum((weights**2).sum(axis=1), 1e-300)
        out[seen] *= [quantile(n - 1.0) for n in effective]
        return out


def linearised(problem: Problem, x: Values, base: Residuals) -> dict[str, Linearised]:
    """Each part at x, whose residuals are `base`, each signal in units of its RMS: all columns by one batch of evaluations.

    A number whose evaluation has no residuals counts as one without an effect.
    """
    groups = by_part(problem.free)
    batches = [[f for f in batch if f is not None] for batch in itertools.zip_longest(*groups.values())]
    steps = {f.name: f.step_at(x[f.name]) for f in problem.free}
    found = problem.residuals([{**x, **{f.name: x[f.name] + steps[f.name] for f in batch}} for batch in batches])
    there = {f.name: other if other is not None else base for batch, other in zip(batches, found) for f in batch}

    def stacked(residuals: Residuals, part: str) -> np.ndarray:
        return np.concatenate([v / rms_of(base[part][s]) for s, v in residuals[part].items()])

    out = {}
    for part in (p for p in groups if p in base):
        residual = stacked(base, part)
        columns = [(stacked(there[f.name], part) - residual) / steps[f.name] for f in groups[part]]
        clusters = np.unique(np.concatenate([*problem.clusters(part).values()]), return_inverse=True)[1]
        out[part] = Linearised(residual, np.column_stack(columns), clusters)
    return out
