"""Cross-validation of a fit, and its loss with the nuisances bounded by the tolerance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
from scipy.optimize import lsq_linear

from twin.diagnose.columns import Columns
from twin.diagnose.fit import Fit
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState, is_isolated
from twin.diagnose.tuning import FREE, Tuning, scales_of, solved
from twin.effects import Setting

FOLDS = 3
"""Number of cross-validation folds."""

SINGULAR = 1e-13
"""Smallest eigenvalue of scaled normal equations, over the largest, that counts as information."""


def folds_of(runs: int) -> list[list[int]]:
    """Runs that are held out together. A single run cannot be held out."""
    count = min(FOLDS, runs)
    return [[i for i in range(runs) if i % count == k] for k in range(count)]


def retuned_within(state: GroupState) -> Fit:
    """Re-tuning alone with all parameters within the tolerance."""
    retuned = state.retuned
    if not retuned.about.nuisances:
        return retuned
    return replace(retuned, coefficients=bounded(retuned.about, state.group.residual, state.group.machine.parameter_tolerance))


def bounded(tuning: Tuning, residual: np.ndarray, tolerance: float | np.ndarray) -> np.ndarray:
    """Coefficients (column,) within +-tolerance that fit a residual best; `tolerance` of all nuisances, or of each (nuisance,)."""
    return _inside(tuning, residual, _bounds(tuning, tolerance), tuning.prior_weight)


def _bounds(tuning: Tuning, tolerance: float | np.ndarray) -> np.ndarray:
    """Bound of each column in spreads: the tolerance for nuisances, infinite for further columns."""
    bound = np.full(len(tuning.jacobian), np.inf)
    bound[: len(tuning.nuisances)] = tolerance / tuning.spread if tuning.spread else 0.0
    return bound


def _inside(tuning: Tuning, residual: np.ndarray, bound: np.ndarray, weight: float) -> np.ndarray:
    """Bounded least squares with bounds +-bound (column,) in spreads and prior weight `weight` of the nuisances.

    The normal equations N x = s are those of R x = R^-T s with N = R'R, columns scaled to equal size.
    """
    own = np.arange(len(bound)) < len(tuning.nuisances)
    normal = tuning.normal + np.diag(np.where(own, weight - tuning.prior_weight, 0.0))
    scale = scales_of(normal)
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    root = np.sqrt(np.maximum(values, SINGULAR * values[-1]))
    target = vectors.T @ (scale * tuning.jacobian.onto(residual)) / root
    reach = np.maximum(bound, 1e-12) / scale
    return np.asarray(scale * lsq_linear(root[:, None] * vectors.T, target, (-reach, reach), method="bvls", max_iter=10 * len(bound)).x)


def residual_within(state: GroupState, fit: Fit, tolerance: float, normal: bool = True) -> np.ndarray:
    """Residual of a fit (row,), weighted, with flat priors for the nuisances inside the tolerance and hard bounds at its edge.

    With `normal` False normal imperfections are not bounded.
    """
    tuning = fit.about
    residual = state.group.residual - fit.response
    if not len(fit.coefficients):
        return residual
    bound = _bounds(tuning, tolerance)
    if not normal:
        bound[: len(tuning.nuisances)][tuning.are_imperfections] = np.inf
    return residual - tuning.jacobian.times(_inside(tuning, residual, bound, 1.0))


def loss_within(state: GroupState, fit: Fit, tolerance: float) -> float:
    """Half the squares of the residual of a fit within the tolerance, weighted as evidence."""
    return 0.5 * float(state.group.credit @ residual_within(state, fit, tolerance) ** 2)


def evidence_needed(state: GroupState, setting: Setting, folds: int) -> float:
    """Evidence that an effect needs. It grows with the length of the record, because a small model error can imitate more of it.

    It is largest if the block of the effect is not isolated: then all model errors of the loop are visible in the same channels.
    """
    least = T.evidence if folds > 1 else T.evidence_in_sample
    return least + (T.imperfect if is_isolated(state.group, setting) else T.imperfect_uncut) * state.group.expected_loss


def held_out_loss(state: GroupState, fit: Fit, folds: Sequence[Sequence[int]]) -> float:
    """Robust loss on held-out runs, each fold predicted by the fit without it.

    A fold that alone determines a parameter is predicted by the fit to all runs and costs `evidence_in_sample - evidence`.
    """
    group = state.group
    linear = linear_in(group, fit)
    folds = folds if len(folds) > 1 else ()
    known = [linear.knows_alone(fold) for fold in folds]
    moved = [fold for fold, alone in zip(folds, known) if not alone]
    left = linear.held_out(moved, 1.0 - T.doubt)
    robust = np.minimum(left**2, T.outlier * np.maximum(1.0, left**2) ** 0.5)
    return 0.5 * float(group.credit @ robust) + sum(known) * (T.evidence_in_sample - T.evidence)


def leave_out(state: GroupState, fold: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Shift of free parameters and tuning if the runs of a fold are held out."""
    fit, group = state.fit, state.group
    linear = linear_in(group, fit)
    shift = np.zeros(len(linear.normal)) if linear.knows_alone(fold) else linear.shift(fold, 1.0 - T.doubt)
    return shift[: linear.own], shift[linear.own :]


@dataclass(frozen=True)
class Linear:
    """A linearised fit by parts of the record (runs, or pieces of them): X = [columns, jacobian], r the residual at the optimum.

    Without the rows f of some parts the optimum moves by -(N - X_f'X_f)^-1 X_f' r_f, with N = X'X + prior.
    """

    rows: Sequence[Sequence[slice]]  # of each part
    columns: Columns  # X
    own: int  # number of leading columns that belong to the fit
    products: np.ndarray  # X'X of each part (part, column, column)
    slopes: np.ndarray  # X'r (part, column)
    normal: np.ndarray  # N
    left: np.ndarray  # r (row,)

    def held_out(self, folds: Sequence[Sequence[int]], share: float) -> np.ndarray:
        """Residual (row,) with the rows of each fold of parts predicted by the fit without them."""
        left = self.left.copy()
        for fold in folds:
            shift = self.shift(fold, share)
            for part in self.measured(fold):
                for rows in self.rows[part]:
                    left[rows] -= self.columns.part(rows) @ shift
        return left

    def measured(self, fold: Sequence[int]) -> list[int]:
        """Parts of a fold that contain measurements."""
        return [part for part in fold if part < len(self.rows)]

    def shift(self, fold: Sequence[int], share: float) -> np.ndarray:
        """Shift of the optimum without these parts. Only `share` of their information is removed, so that a direction known from them alone stays."""
        information = share * self.products[self.measured(fold)].sum(axis=0)
        return -solved(self.normal - information, share * self.slopes[self.measured(fold)].sum(axis=0))

    def knows_alone(self, fold: Sequence[int]) -> bool:
        """Is a direction of the fit's own parameters p determined by these parts alone?

        Information about p with the other columns q eliminated: S = N_pp - N_pq N_qq^-1 N_qp, of all runs compared with that of the others.
        """
        if not self.own:
            return False
        information = self.products[self.measured(fold)].sum(axis=0)
        of_all, of_others = (_information(n, self.own) for n in (self.normal, self.normal - information))
        return float(scipy.linalg.eigh(of_others, of_all, eigvals_only=True)[0]) < T.doubt


def linear_in(group: Group, fit: Fit, rows: Sequence[Sequence[slice]] | None = None) -> Linear:
    """The linearised fit by parts with these rows; by runs without them."""
    if rows is None:
        rows = [[c.rows for c in group.channels if c.run == run] for run in range(1 + max((c.run for c in group.channels), default=-1))]
    columns, own = fit.columns.beside(fit.about.jacobian), len(fit.columns)
    n = len(columns)
    products, slopes, residual = np.zeros((len(rows), n, n)), np.zeros((len(rows), n)), fit.residual(group)
    products[:, own:, own:] = fit.about.products(rows)
    for i, slices in enumerate(rows):
        for part in slices:
            x = columns.part(part)
            products[i, :, :own] += x.T @ x[:, :own]
            slopes[i] += x.T @ residual[part]
        products[i, :own, own:] = products[i, own:, :own].T
    normal = products.sum(axis=0) + np.diag(np.concatenate([np.full(own, FREE), fit.about.prior]))
    return Linear(rows, columns, own, products, slopes, normal, residual)


def _information(normal: np.ndarray, p: int) -> np.ndarray:
    """Information about the first p parameters with the others free; regularised, so that no direction divides by zero."""
    information = normal[:p, :p] - normal[:p, p:] @ solved(normal[p:, p:], normal[p:, :p])
    return information + 1e-7 * np.diag(np.diag(normal)[:p]) + 1e-9 * np.eye(p)
