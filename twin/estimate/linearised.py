"""A problem near a point: residual and columns of each block, what they determine, and the step to the least squares.

r(x + d) = r + J d,    r and J in units of a level of each signal
damped step:   min |r + J d|^2 + m |D d|^2  within the bounds,  D = lengths of the columns
covariance:    (J'WJ)^-1 [sum over clusters g of (J_g' W r_g)(J_g' W r_g)'] (J'WJ)^-1 RELATED^2 G / (G - k)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from twin.estimate.problem import Block, Problem, Residuals, Values, batches_of
from twin.estimate.regression import sandwich

UNSEEN = 1e-9
"""A column shorter than this share of the longest has no effect on the residual."""

OUTLIER = 3.0
"""Huber's limit in robust standard deviations."""

Level = Callable[[str, str], float]
"""(part, signal) -> the unit of its residual."""


@dataclass(frozen=True)
class Linearised:
    """One block at a point: residual (row,), columns (row, k) and clusters (row,)."""

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

    def solved(self, robust: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Change (k,) to the least squares and its covariance (k, k), by clusters; `robust`: with Huber's weights.

        Numbers without an effect have change 0 and infinite variance.
        """
        weight = np.ones(len(self.residual))
        if robust:
            spread = max(float(np.median(np.abs(self.residual))) * 1.48, 1e-9)
            weight = np.minimum(1.0, OUTLIER * spread / np.maximum(np.abs(self.residual), 1e-12))
        k, seen = self.columns.shape[1], self.seen
        change, covariance = np.zeros(k), np.diag(np.where(seen, 0.0, np.inf))
        if seen.any():
            length = np.linalg.norm(self.columns[:, seen], axis=0)
            x = self.columns[:, seen] / length
            bread = np.linalg.pinv((x * weight[:, None]).T @ x, rcond=1e-12, hermitian=True)
            found = -bread @ (x.T @ (weight * self.residual))
            own = sandwich(bread, x * (weight * (self.residual + x @ found))[:, None], self.clusters)
            change[seen], covariance[np.ix_(seen, seen)] = found / length, own / np.outer(length, length)
        return change, covariance

    def averaged(self, moved: np.ndarray, deviations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Change (k,) and standard deviations (k,) together with an earlier estimate from the same data, now `moved` (k,) away.

        `deviations` (k,) are those of the earlier estimate (infinite: none). Because both use the same data, their informations are averaged,
        not added. The residual has Huber's weights.
        """
        found, covariance = self.solved(robust=True)
        seen, change, spread = self.seen, np.zeros(len(found)), deviations.copy()
        if seen.any():
            information = 0.5 * np.linalg.pinv(covariance[np.ix_(seen, seen)], hermitian=True)
            known = 0.5 * deviations[seen] ** -2.0
            joined = np.linalg.pinv(information + np.diag(known), hermitian=True)
            change[seen] = joined @ (information @ found[seen] - known * moved[seen])
            spread[seen] = np.sqrt(np.diag(joined))
        return change, spread


def linearised(problem: Problem, blocks: Sequence[Block], x: Values, base: Residuals, level: Level) -> list[Linearised | None]:
    """Each block at x, whose residuals are `base`: all columns by one batch of evaluations. None for a block without residuals.

    A number whose evaluation has no residuals counts as one without an effect.
    """
    batches = batches_of([f for b in blocks for f in b.free])
    steps = {f.name: f.step_at(x[f.name]) for batch in batches for f in batch}
    found = problem.residuals([{**x, **{f.name: x[f.name] + steps[f.name] for f in batch}} for batch in batches])
    there = {f.name: other for batch, other in zip(batches, found) for f in batch}
    out: list[Linearised | None] = []
    for block in blocks:
        parts = [p for p in block.parts if p in base]
        if not parts:
            out.append(None)
            continue
        columns = []
        for f in block.free:
            other = there[f.name]
            columns.append(stacked_difference(base, other if other is not None else base, parts, f.parts, level) / steps[f.name])
        names = [np.concatenate([*problem.clusters(p).values()]) for p in parts]
        offsets = np.cumsum([0, *(int(c.max(initial=0)) + 1 for c in names)])
        clusters = np.concatenate([c + o for c, o in zip(names, offsets)])
        residual = np.concatenate([v / level(p, s) for p in parts for s, v in base[p].items()])
        out.append(Linearised(residual, np.column_stack(columns), clusters))
    return out


def stacked_difference(base: Residuals, other: Residuals, parts: Sequence[str], moved: Sequence[str], level: Level) -> np.ndarray:
    """(row,) other minus base of the parts, in units of the level; 0 for parts that are not `moved`."""
    return np.concatenate([(other[p][s] - v) / level(p, s) if p in moved else np.zeros(len(v)) for p in parts for s, v in base[p].items()])
