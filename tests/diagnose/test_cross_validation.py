"""Cross-validation: the closed-form shift compared with a fit without the run."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of
from twin.diagnose.cross_validation import folds_of, held_out_loss, leave_out
from twin.diagnose.settings import T
from twin.diagnose.tolerance import Nuisance
from twin.diagnose.tuning import tuning_from

RUNS, SAMPLES, EFFECTS, NUISANCES = 3, 40, 2, 3
PRIOR = np.diag([1e-6] * EFFECTS + [T.prior_weight] * NUISANCES)


def linear(runs_with_effect: range = range(RUNS)):
    """A linear fit with noise around known coefficients, (state, fit, X, y, best); the second effect acts only in the runs `runs_with_effect`."""
    rng = np.random.default_rng(4)
    x = rng.normal(size=(RUNS * SAMPLES, EFFECTS + NUISANCES)).astype(np.float32).astype(float)  # as columns are held
    runs = np.arange(RUNS * SAMPLES) // SAMPLES
    x[~np.isin(runs, runs_with_effect), 1] = 0.0
    y = x @ np.array([1.0, -2.0, 0.3, 0.0, -0.3]) + rng.normal(size=len(x))
    best = np.linalg.solve(x.T @ x + PRIOR, x.T @ y)
    channels = [SimpleNamespace(run=k, rows=slice(k * SAMPLES, (k + 1) * SAMPLES)) for k in range(RUNS)]
    fit = SimpleNamespace(
        columns=columns_of(x[:, :EFFECTS]),
        about=tuning_from([Nuisance("X", name) for name in "abc"], columns_of(x[:, EFFECTS:]), 0.01),
        coefficients=best[EFFECTS:],
        free=[None] * EFFECTS,
        residual=lambda group: y - x @ best,
    )
    group = SimpleNamespace(channels=channels, credit=np.ones(len(x)))
    return SimpleNamespace(group=group, fit=fit), fit, x, y, best


def test_each_run_is_predicted_by_a_fit_to_the_others():
    found, fit, x, y, best = linear()
    loss = 0.0
    for k in range(RUNS):
        out = np.arange(len(y)) // SAMPLES == k
        weight = np.where(out, T.doubt, 1.0)
        without = np.linalg.solve(x.T @ (weight[:, None] * x) + PRIOR, x.T @ (weight * y))
        loss += 0.5 * np.sum((y[out] - x[out] @ without) ** 2)
        effects, tuning = leave_out(found, [k])
        np.testing.assert_allclose(np.concatenate([effects, tuning]), without - best, atol=1e-9)
    assert held_out_loss(found, fit, folds_of(RUNS)) == pytest.approx(loss, rel=1e-9)
    assert loss > 1.02 * 0.5 * np.sum(fit.residual(None) ** 2)  # larger than the loss in sample


def test_a_run_that_alone_determines_a_parameter_cannot_be_held_out():
    """The other runs leave the parameter undetermined. The fit to all runs is used instead, with the higher evidence threshold of a single run."""
    found, fit, *_ = linear(runs_with_effect=range(1))
    effects, tuning = leave_out(found, [0])
    assert not effects.any()
    assert not tuning.any()
    others = held_out_loss(found, fit, [[1], [2]])  # the first run has the fit to all runs there, too
    assert held_out_loss(found, fit, [[0], [1], [2]]) == pytest.approx(others + T.evidence_in_sample - T.evidence, rel=1e-9)


def test_folds():
    assert folds_of(1) == [[0]]
    assert folds_of(2) == [[0], [1]]
    assert folds_of(7) == [[0, 3, 6], [1, 4], [2, 5]]
