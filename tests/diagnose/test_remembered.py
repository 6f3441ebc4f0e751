"""Answers that a search simulates once, and weighs as the group weighs when they are asked for again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from twin.diagnose.state import Found

ROWS = 30


def test_an_answer_is_simulated_once_and_follows_the_weights():
    rng = np.random.default_rng(0)
    column, doubt = rng.normal(size=ROWS), rng.uniform(0.2, 1.0, ROWS)
    found = Found(SimpleNamespace(weights=np.ones(ROWS)), None, None, None, None, 1.0)
    simulated = []

    def simulate():
        simulated.append(column)
        return column

    for weights in (None, doubt, 2.0 * doubt):
        found = found if weights is None else replace(found, group=SimpleNamespace(weights=weights))
        np.testing.assert_allclose(found.remembered("a start", simulate), column * found.group.weights, rtol=1e-6)
    assert len(simulated) == 1
