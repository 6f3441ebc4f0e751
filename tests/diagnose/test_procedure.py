"""Effects that the corrected machine still holds after the search for laws."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from twin.diagnose.law.laws import Laws
from twin.diagnose.procedure import _as_probable_as_complete, effects_beside_laws
from twin.effects import settings_of, with_effects


def spring(mikron, stiffness):
    """A machine whose X axis has this spring, and the setting of the spring."""
    machine = with_effects(mikron, [{"name": "transmission_compliance", "axis": "X", "stiffness": stiffness}])
    return machine, settings_of(machine)[-1]


@pytest.mark.parametrize(("stiffness", "named"), [(3.1e8, [3.1e8]), (4.4e9, [])])
def test_a_spring_that_a_law_leaves_normal_is_no_longer_an_effect(mikron, stiffness, named):
    _, found = spring(mikron, 3e8)
    corrected, _ = spring(mikron, stiffness)
    kept = effects_beside_laws(Laws((), (), corrected), [(found, None, 0.98)])
    assert [setting.parameters["stiffness"] for setting, _, _ in kept] == named


def test_an_effect_that_a_law_replaced_is_no_longer_named(mikron):
    _, found = spring(mikron, 3e8)
    assert effects_beside_laws(Laws((), (), with_effects(mikron, [])), [(found, None, 0.98)]) == []


def test_an_effect_beside_a_law_is_as_probable_as_what_its_removal_costs_there(mikron):
    corrected, found = spring(mikron, 3e8)
    ((_, _, p),) = effects_beside_laws(Laws((), (), corrected, {found.key: 0.5}), [(found, None, 0.98)])
    assert p == pytest.approx(0.49)


@pytest.mark.parametrize(("after", "doubtful", "probability"), [(33.9, {"X"}, 0.235), (33.9, {"Y"}, 0.98), (1.0, {"X"}, 0.98)])
def test_an_effect_beside_something_unknown_is_as_probable_as_the_gap_of_its_axis_is_closed(mikron, after, doubtful, probability):
    """An integral time in place of a dead band of the position controller closed a quarter of the squared gap."""
    _, found = spring(mikron, 3e8)
    correction = SimpleNamespace(closed=lambda _: {"X": 1.0 - (after**2 - 1.0) / (38.82**2 - 1.0)}, doubtful=lambda _: doubtful, laws=None)
    ((_, _, p),), _ = _as_probable_as_complete(correction, [(found, None, 0.98)], mikron)
    assert p == pytest.approx(probability, abs=0.01)


def test_the_spring_of_a_law_is_a_part_of_it(mikron):
    corrected, found = spring(mikron, 3e8)
    assert effects_beside_laws(Laws((), (), corrected, {found.key: 0.0}), [(found, None, 0.98)]) == []
