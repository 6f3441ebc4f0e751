"""Cached responses of a search: simulated once, returned with the current row weights."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from tests.builders.diagnosis_state import group_of
from twin.diagnose import state
from twin.diagnose.observe import Group, Variation
from twin.diagnose.state import GroupState
from twin.effects import EFFECTS, Setting
from twin.errors import SimulationError

ROWS = 30


START = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.3})
UNSTABLE = Setting(EFFECTS["coulomb_friction"], "X", {"factor": 9.0})


def test_a_response_is_simulated_once_and_follows_the_weights(monkeypatch):
    rng = np.random.default_rng(0)
    column, doubt = rng.normal(size=ROWS), rng.uniform(0.2, 1.0, ROWS)
    found = GroupState(SimpleNamespace(weights=np.ones(ROWS)), None, None, None, 1.0)
    simulated = []

    def simulated_responses(group, several):
        simulated.extend(several)
        return [SimulationError("unstable") if setting is UNSTABLE else column * group.weights for (setting,) in several]

    monkeypatch.setattr(state, "simulated_responses", simulated_responses)
    for weights in (None, doubt, 2.0 * doubt):
        found = found if weights is None else replace(found, group=SimpleNamespace(weights=weights))
        one, refused, again = found.cached_responses([START, UNSTABLE, START])
        np.testing.assert_allclose(one.values, column * found.group.weights, rtol=1e-6)
        assert again is one
        assert isinstance(refused, SimulationError)
    assert simulated == [[START], [UNSTABLE]]


def test_a_group_remembers_named_responses(monkeypatch):
    """Named variations are simulated once, also in a group with other weights; those without a name each time."""
    group = group_of([np.full(20, 3.0), np.full(20, -2.0)])
    simulated = []

    def answers(self, variations):
        simulated.extend(v.axes for v in variations)
        return [np.full(self.size, float(len(v.axes))) for v in variations]

    monkeypatch.setattr(Group, "_simulated", answers)
    one, two = Variation(lambda m: m, axes=("X",)), Variation(lambda m: m, axes=("X", "Y"))
    first = group.responses([one, two], keys=["one", None])
    doubted = group.with_model_error(np.full(group.size, 2.0), np.full(group.size, 1.0))
    second = doubted.responses([one, two], keys=["one", None])
    assert simulated == [("X",), ("X", "Y"), ("X", "Y")]
    np.testing.assert_allclose(first[0], group.weights)
    np.testing.assert_allclose(second[0], doubted.weights)
    np.testing.assert_allclose(second[1], 2.0 * doubted.weights)
