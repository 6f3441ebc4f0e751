"""One more nuisance beside a tuning: what is foreseen for it is what the tuning that has it gives."""

import numpy as np
import pytest

from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import trial_of, tuning_from

ROWS, SPREAD = 400, 0.03


@pytest.fixture
def drawn():
    rng = np.random.default_rng(3)
    nuisances = [Nuisance("X", "inertia"), Nuisance("X", "viscous")]
    columns = rng.normal(0.0, 5.0, (ROWS, 3))
    columns[:, 2] += columns[:, 0]  # not told apart by itself
    return (
        tuning_from(nuisances, np.asfortranarray(columns[:, :2]), SPREAD),
        columns[:, 2],
        columns @ [0.3, -0.2, 0.7] + rng.normal(size=ROWS),
    )


def test_a_trial_foresees_loss_and_size(drawn):
    tuning, column, residual = drawn
    trial, with_it = trial_of(tuning, column, residual), tuning.with_column(Nuisance("X", "elasticity"), column)
    assert trial.gain == pytest.approx(tuning.loss(residual) - with_it.loss(residual), rel=1e-9)
    assert trial.size == pytest.approx(with_it.solve(residual)[-1] * UNIFORM, rel=1e-9)
    assert trial.gain > 10.0


def test_what_the_tuning_explains_gains_nothing(drawn):
    tuning, _, residual = drawn
    trial = trial_of(tuning, tuning.jacobian @ np.array([1.0, 2.0]), residual)
    assert trial.gain < 0.05 * trial_of(tuning, residual, residual).gain
