"""One more nuisance next to a tuning: its predicted gain equals that of the extended tuning."""

from dataclasses import replace
import itertools

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of
from twin.diagnose.corrected import limited_deviations
from twin.diagnose.cross_validation import bounded
from twin.diagnose.settings import T
from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import trial_of, tuning_from

ROWS, SPREAD = 400, 0.03


@pytest.fixture
def drawn():
    rng = np.random.default_rng(3)
    nuisances = [Nuisance("X", "inertia"), Nuisance("X", "viscous")]
    columns = rng.normal(0.0, 5.0, (ROWS, 3))
    columns[:, 2] += columns[:, 0]  # partly collinear
    columns = columns.astype(np.float32).astype(float)  # as columns are held
    return (
        tuning_from(nuisances, columns_of(columns[:, :2]), SPREAD),
        columns[:, 2],
        columns @ [0.3, -0.2, 0.7] + rng.normal(size=ROWS),
    )


def test_a_trial_predicts_loss_and_size(drawn):
    tuning, column, residual = drawn
    trial, with_it = trial_of(tuning, column, residual), tuning.with_column(Nuisance("X", "elasticity"), column)
    assert trial.gain == pytest.approx(tuning.loss(residual) - with_it.loss(residual), rel=1e-9)
    assert trial.size == pytest.approx(with_it.solve(residual)[-1] * UNIFORM, rel=1e-9)
    assert trial.gain > 10.0


def test_a_collinear_nuisance_gains_nothing(drawn):
    tuning, _, residual = drawn
    trial = trial_of(tuning, tuning.jacobian.times(np.array([1.0, 2.0])), residual)
    assert trial.gain < 0.05 * trial_of(tuning, residual, residual).gain


@pytest.mark.parametrize(("step", "kept"), [(-0.2, -0.2), (-0.8, -T.spring_step), (0.6, T.spring_step)])
def test_a_spring_stays_near_the_size_that_was_simulated(step, kept):
    """The slope of a spring holds near its size; the other parameters then explain what they can."""
    size = 0.01
    columns = np.random.default_rng(4).normal(0.0, 5.0, (ROWS, 2))
    columns[:, 1] += 3.0 * columns[:, 0]
    tuning = tuning_from([Nuisance("X", "slip"), Nuisance("X", "viscous_friction")], columns_of(columns), SPREAD)
    tuning = replace(tuning, base=np.array([size, 0.0]))
    found = found_of(group_of([tuning.jacobian.times(np.array([step * size / SPREAD, 0.0]))]), tuning)
    slip, friction = limited_deviations(found)
    assert slip == pytest.approx(size * (1.0 + kept), rel=0.02)
    assert bool(abs(friction) > 1e-4) is (kept != step)


def test_a_held_column_acts_like_a_missing_one(drawn):
    tuning, column, residual = drawn
    rng = np.random.default_rng(4)
    # columns of very different scale, as those of effects
    further = np.asfortranarray(np.column_stack([1e4 * column, rng.normal(size=ROWS), 1e-3 * residual]))
    every = tuning.with_free(columns_of(further))
    for held in ([0], [2], [0, 1]):
        kept = [k for k in range(3) if k not in held]
        others = tuning.with_free(columns_of(further[:, kept]))
        about = every.holding(held)
        assert about.jacobian is every.jacobian
        assert about.loss(residual) == pytest.approx(others.loss(residual), rel=1e-9)
        theta = about.solve(residual)
        np.testing.assert_allclose(theta[2:][held] * np.abs(further[:, held]).max(axis=0), 0.0, atol=1e-6)
        np.testing.assert_allclose(np.delete(theta, [2 + k for k in held]), others.solve(residual), rtol=1e-6, atol=1e-9)
    assert every.loss(residual) < 0.1 * every.holding([0, 2]).loss(residual)


def test_products_belong_to_the_runs_they_are_asked_for(drawn):
    """The same tuning, asked for another division into runs, as after a run was left out."""
    tuning, column, _ = drawn
    for of in (tuning, tuning.with_free(columns_of(column[:, None]))):
        for edges in ((0, 100, ROWS), (0, 250, ROWS), (0, 130, 260, ROWS)):
            runs = [[slice(a, b)] for a, b in itertools.pairwise(edges)]
            dense = of.jacobian.part(slice(0, ROWS))
            expected = [dense[a:b].T @ dense[a:b] for a, b in itertools.pairwise(edges)]
            np.testing.assert_allclose(of.products(runs), expected, rtol=1e-9, atol=1e-9)


def test_bounded_tuning_is_the_optimum_within_its_bounds(drawn):
    """No coefficient inside its bounds, and none at a bound towards the inside, reduces the loss further; further columns are free."""
    plain, column, residual = drawn
    tuning = plain.with_free(columns_of(np.column_stack([1e4 * column, 1e-3 * residual[::-1]])))
    for tolerance in (1e-4, 0.01, 0.05, 10.0):
        found = bounded(tuning, 30.0 * residual, tolerance)
        bound = np.array([tolerance / SPREAD] * 2 + [np.inf] * 2)
        slope = (tuning.jacobian.onto(30.0 * residual) - tuning.normal @ found) / np.sqrt(np.diag(tuning.normal))
        assert np.all(np.abs(found) <= bound * (1.0 + 1e-9))
        inside = np.abs(found) < bound * (1.0 - 1e-9)
        np.testing.assert_allclose(slope[inside], 0.0, atol=1e-6 * np.linalg.norm(30.0 * residual))
        assert np.all(slope[~inside] * found[~inside] >= 0.0)
        assert inside.all() == (tolerance == 10.0)


def test_a_prior_weight_that_is_moved_is_moved_in_every_tuning(monkeypatch):
    monkeypatch.setattr(T, "prior_weight", 2.0 * T.prior_weight)
    tuning = tuning_from([Nuisance("X", "viscous_friction")], columns_of(np.zeros((ROWS, 1))), SPREAD)
    assert tuning.prior.tolist() == tuning.normal[0].tolist() == [T.prior_weight]
