"""Axes for which a law is sought, and start values of the search."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of
from twin.diagnose import validation
from twin.diagnose.law.laws import MOST_EFFECTS
from twin.diagnose.law.proposals import start_of
from twin.effects import EFFECTS, Setting
from twin.simulation.gap import SignalGap


def asked_of(axes, unknown, levels, loudest, mikron, monkeypatch, before=None, effects=()):
    """Axes for which a law is sought, in a group of which only X was recorded, with `effects` on X; without `before`, they explain nothing."""
    group = replace(group_of([np.full(50, 3.0)], "X"), axes=axes)
    asked = []
    monkeypatch.setattr(validation, "laws_of", lambda found, axes, *rest: asked.append(axes))
    state = found_of(group)
    fit = replace(state.fit, settings=tuple(Setting(EFFECTS[name], "X", {}) for name in effects))
    found = [replace(state, unknown=unknown, fit=fit)]
    monkeypatch.setattr(validation, "signal_levels", lambda _: {(axis, "position"): level for axis, level in loudest.items()})
    held_out = SimpleNamespace(gaps={"after": {}})
    validated = validation.Validated(found, held_out, before or levels, levels, mikron)
    list(validation.find_unlisted_laws(SimpleNamespace(machine=mikron, folds=[[0]], progress=print, mapper=map), validated))
    return asked


def test_no_law_is_sought_for_an_axis_with_set_points_only(mikron, monkeypatch):
    levels = {"X": 9.0, "Y": 9.0}
    assert asked_of(("X", "Y"), True, levels, levels, mikron, monkeypatch) == [["X"], ["X"]]


def test_one_loud_signal_starts_the_search_for_a_law(mikron, monkeypatch):
    assert asked_of(("X",), False, {"X": 1.2}, {"X": 1.6}, mikron, monkeypatch) == [["X"], ["X"]]
    assert asked_of(("X",), False, {"X": 1.2}, {"X": 1.4}, mikron, monkeypatch) == []


def test_one_loud_signal_is_ignored_if_effects_explain_most(mikron, monkeypatch):
    assert asked_of(("X",), False, {"X": 1.2}, {"X": 1.6}, mikron, monkeypatch, before={"X": 15.0}) == [["X"], ["X"]]
    assert asked_of(("X",), False, {"X": 1.2}, {"X": 1.6}, mikron, monkeypatch, before={"X": 70.0}) == []


@pytest.mark.parametrize(
    ("effects", "asked"),
    [(["backlash", "transmission_compliance"], [["X"], ["X"]]), (["backlash", "coulomb_friction"], []), (["backlash"], [])],
)
def test_a_law_is_sought_instead_of_several_effects_in_one_block(effects, asked, mikron, monkeypatch):
    """A backlash and a spring imitate a hardening spring down to 1.2 x noise, with one signal at 2.5 x noise."""
    assert asked_of(("X",), False, {"X": 1.2}, {"X": 2.5}, mikron, monkeypatch, before={"X": 70.0}, effects=effects) == asked
    assert asked_of(("X",), False, {"X": 1.1}, {"X": 1.3}, mikron, monkeypatch, before={"X": 70.0}, effects=effects) == []


@pytest.mark.parametrize(
    ("effects", "asked"),
    [
        (["torque_constant", "coulomb_friction", "current_filter"], [["X"]]),
        (["torque_constant", "coulomb_friction"], []),  # a law would be the larger claim
        (["torque_constant", "coulomb_friction", "backlash", "lead_error"], []),  # a channel isolates the last two
    ],
)
def test_a_filter_is_tried_in_place_of_three_effects_in_the_loop(effects, asked, mikron, monkeypatch):
    assert asked_of(("X",), False, {"X": 1.0}, {"X": 1.0}, mikron, monkeypatch, before={"X": 70.0}, effects=effects) == asked


def test_many_effects_that_leave_only_noise_are_a_result():
    group = group_of([np.full(50, 3.0)], "X")
    effects = [Setting(EFFECTS[name], "X", {}) for name in list(EFFECTS)[: MOST_EFFECTS + 1]]
    many, few = (SimpleNamespace(group=group, fit=SimpleNamespace(settings=some)) for some in (effects, effects[:3]))
    assert validation.many_effects_explain(many, {"X": 90.0}, {"X": 1.1})
    assert not validation.many_effects_explain(many, {"X": 90.0}, {"X": 1.6})
    assert not validation.many_effects_explain(few, {"X": 90.0}, {"X": 1.1})
    assert not validation.many_effects_explain(many, {"X": 1.0}, {"X": 1.0})


def test_the_length_of_a_play_is_its_height(mikron):
    law = {"name": "law", "axis": "X", "block": "measurement", "output": "displacement", "variables": ["slack"], "formula": "line"}
    law |= {"height": -8e-6, "reach": 1.0, "length": 2e-6}
    proposal = SimpleNamespace(table=lambda axis: law, relation=SimpleNamespace(variable="slack"))
    assert start_of(proposal, "X", mikron).parameters["length"] == 8e-6


@pytest.mark.parametrize(("after", "doubtful"), [(1.1, set()), (1.5, {"X"}), (9.0, {"X"})])
def test_an_axis_at_noise_is_not_doubtful_beside_an_unknown_one(mikron, after, doubtful):
    """A small effect may stand on an axis whose gap is hardly above noise, in a group with another axis that nothing explains."""
    state = replace(found_of(group_of([np.full(50, 3.0)], "X")), unknown=True)
    held_out = SimpleNamespace(gaps={"after": {"run": {"X": {"position": SignalGap(after, after, 1.0, 1.0, "um", after)}}}})
    assert validation.Validated([state], held_out, {"X": 1.6}, {"X": after}, mikron).doubtful == doubtful
