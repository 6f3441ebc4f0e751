"""Answers that a search simulates once, and weighs as the group weighs when they are asked for again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from twin.diagnose.state import Found
from twin.diagnose.tolerance import Nuisance
from twin.diagnose.tuning import tuning_from

ROWS = 30


def test_an_answer_is_simulated_once_and_follows_weights_and_tuning():
    rng = np.random.default_rng(0)
    column, doubt = rng.normal(size=ROWS), rng.uniform(0.2, 1.0, ROWS)
    tunings = [tuning_from([Nuisance("X", "coulomb_friction")], rng.normal(size=(ROWS, 1)), 0.01) for _ in range(2)]
    found = Found(SimpleNamespace(weights=np.ones(ROWS)), None, tunings[0], None, None, 1.0)
    simulated = []

    def simulate():
        simulated.append(column)
        return column

    for tuning, weights in ((tunings[0], None), (tunings[1], None), (tunings[1], doubt), (tunings[0], doubt)):
        found = replace(found, tuning=tuning, group=found.group if weights is None else SimpleNamespace(weights=weights))
        remembered, projected = found.remembered("a start", simulate)
        np.testing.assert_allclose(remembered, column * found.group.weights, rtol=1e-6)
        np.testing.assert_allclose(projected, tuning.project(remembered), rtol=1e-6)
    assert len(simulated) == 1
