"""Fits judged on runs that they did not see, and inside the tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy.linalg

from twin.diagnose.fit import Fit
from twin.diagnose.observe import Group
from twin.diagnose.state import Found, is_cut
from twin.diagnose.tolerance import NORMAL, UNIFORM
from twin.diagnose.tuning import Tuning, beside
from twin.effects import Setting

FOLDS = 3
"""Parts into which the runs are divided; each is predicted by a fit of the others."""

DESCENTS = 200
"""Sweeps of the bounded least squares over a dozen parameters: more change nothing."""


def retuned_within(found: Found, tolerance: float) -> Fit:
    """Re-tuning alone with every parameter inside +-tolerance."""
    return replace(found.retuned, tuning=bounded(found.retuned.about, found.group.residual, found.retuned.tuning, tolerance))


def bounded(tuning: Tuning, residual: np.ndarray, start: np.ndarray, tolerance: float) -> np.ndarray:
    """Tuning (nuisance,) that fits a residual best inside +-tolerance: bounded least squares by coordinate descent."""
    if not tuning.nuisances:
        return start
    return _inside(tuning, residual, start, np.full(len(start), tolerance / tuning.spread), tuning.prior_weight)


def _inside(tuning: Tuning, residual: np.ndarray, start: np.ndarray, bound: np.ndarray, weight: float) -> np.ndarray:
    """The same inside +-bound (nuisance,) spreads."""
    slope = tuning.jacobian.T @ residual
    normal = tuning.normal + (weight - tuning.prior_weight) * np.eye(len(start))
    theta = np.clip(start, -bound, bound)
    for _ in range(DESCENTS):
        for i in range(len(theta)):
            step = (slope[i] - normal[i] @ theta) / normal[i, i]
            theta[i] = min(max(theta[i] + step, -bound[i]), bound[i])
    return theta


def left_within(found: Found, fit: Fit, tolerance: float, normal: bool = True) -> np.ndarray:
    """What a fit leaves (row,), weighted, when the nuisances cost nothing inside the tolerance and cannot leave it.

    `normal` False: normal imperfections are as free as they were found.
    """
    tuning = fit.about
    residual = found.group.residual - fit.response
    if not tuning.nuisances:
        return residual
    bound = np.full(len(tuning.nuisances), tolerance / tuning.spread)
    if not normal:
        bound[[n.quantity in NORMAL for n in tuning.nuisances]] = np.inf
    return residual - tuning.jacobian @ _inside(tuning, residual, fit.tuning, bound, 1.0)


def loss_within(found: Found, fit: Fit, tolerance: float, normal: bool = True) -> float:
    """Half the squares of that, counted as evidence."""
    return 0.5 * float(found.group.credit @ left_within(found, fit, tolerance, normal) ** 2)


def beyond_tolerance(found: Found) -> float:
    """Half the squares above noise that a fit leaves when no parameter of the machine leaves the tolerance far behind."""
    tolerance = found.fit.about.spread / float(UNIFORM)
    return loss_within(found, found.fit, found.thresholds.widest * tolerance, normal=False) - 0.5 * float(
        found.group.credit @ found.group.expected
    )


def evidence_needed(found: Found, setting: Setting, folds: int) -> float:
    """Evidence that an effect must bring: the more was measured, the more of it a small fault of the model can imitate.

    Most where the block of the effect was not cut: then all that is imperfect in the loop shows in the same channels.
    """
    t = found.thresholds
    least = t.evidence if folds > 1 else t.evidence_in_sample
    return least + (t.imperfect if is_cut(found.group, setting) else t.imperfect_uncut) * found.group.expected_loss


def held_out_loss(found: Found, fit: Fit, folds: Sequence[Sequence[int]]) -> float:
    """Half the squares on runs left out, each fold predicted by the fit without it.

    With X = [columns, jacobian], N = X'X + prior, r the residual at the optimum: leaving out rows f moves the optimum by
    -(N - X_f'X_f)^-1 X_f' r_f, so that the residual left out is r_f + X_f (N - X_f'X_f)^-1 X_f' r_f.
    """
    group, t = found.group, found.thresholds
    x, normal, r = _linear(group, fit)
    loss = 0.0
    for fold in folds:
        rows = _rows_of(group, fold)
        if not rows.size:
            continue
        xf, rf = x[rows], r[rows]
        information = xf.T @ xf
        if len(folds) > 1:
            if _knows_alone(information, normal, fit, t.known_alone):
                loss += t.evidence_in_sample - t.evidence
            else:
                rf = rf + xf @ np.linalg.lstsq(normal - information, xf.T @ rf, rcond=None)[0]
        loss += 0.5 * float(group.credit[rows] @ np.minimum(rf**2, t.outlier * np.maximum(1.0, rf**2) ** 0.5))
    return loss


def leave_out(found: Found, fold: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Shift of free parameters and tuning when the runs of a fold are left out."""
    fit, group = found.fit, found.group
    x, normal, r = _linear(group, fit)
    rows = _rows_of(group, fold)
    information = x[rows].T @ x[rows]
    shift = np.zeros(len(normal))
    if not _knows_alone(information, normal, fit, group.thresholds.known_alone):
        shift = -np.linalg.lstsq(normal - information, x[rows].T @ r[rows], rcond=None)[0]
    return shift[: fit.columns.shape[1]], shift[fit.columns.shape[1] :]


def _linear(group: Group, fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A fit about its optimum: X = [columns, jacobian], N = X'X + prior, and the residual r."""
    x = beside(fit.columns, fit.about.jacobian)
    prior = np.diag([1e-6] * fit.columns.shape[1] + [fit.about.prior_weight] * len(fit.tuning))
    return x, x.T @ x + prior, fit.left(group)


def _rows_of(group: Group, fold: Sequence[int]) -> np.ndarray:
    return np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in group.channels if c.run in fold] or [np.zeros(0, int)])


def _knows_alone(information: np.ndarray, normal: np.ndarray, fit: Fit, alone: float) -> bool:
    """Is some direction of the effects' parameters known from these runs alone? A fit without them would leave it to chance.

    Information about the parameters p beside the tuning q: S = N_pp - N_pq N_qq^-1 N_qp, of all runs against that of the others.
    """
    p = fit.columns.shape[1]
    if not p:
        return False
    of_all, of_others = (_information(n, p) for n in (normal, normal - information))
    return float(scipy.linalg.eigh(of_others, of_all, eigvals_only=True)[0]) < 1.0 - alone


def _information(normal: np.ndarray, p: int) -> np.ndarray:
    """Information about the first p parameters with the others free; never quite none, so that no direction divides by zero."""
    information = normal[:p, :p] - normal[:p, p:] @ np.linalg.lstsq(normal[p:, p:], normal[p:, :p], rcond=None)[0]
    return information + 1e-7 * np.diag(np.diag(normal)[:p]) + 1e-9 * np.eye(p)
