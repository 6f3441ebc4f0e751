"""Effects that the corrected machine still holds after the search for laws, and groups of axes that another axis pushes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of, no_tuning
from twin.diagnose import procedure
from twin.diagnose.fit import no_effect
from twin.diagnose.law.laws import Laws
from twin.diagnose.procedure import _as_probable_as_complete, effects_beside_laws
from twin.diagnose.setup import Setup
from twin.diagnose.verdict import Named
from twin.effects import EFFECTS, Setting, settings_of, with_effects


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


@pytest.mark.parametrize(
    ("after", "doubtful", "filtered", "probability"),
    [(33.9, {"X"}, 0.0, 0.235), (33.9, {"Y"}, 0.0, 0.98), (1.0, {"X"}, 0.0, 0.98), (1.0, {"Y"}, 0.6, 0.4)],
)
def test_an_effect_is_as_probable_as_its_axis_and_its_block_are_closed(mikron, after, doubtful, filtered, probability):
    """An integral time in place of a dead band of the position controller closed a quarter of the squared gap."""
    _, found = spring(mikron, 3e8)
    closed, left = {"X": 1.0 - (after**2 - 1.0) / (38.82**2 - 1.0)}, {found.key: filtered}
    correction = SimpleNamespace(closed=closed, doubtful=doubtful, laws=None, axes_with_law=set(), stand_ins=left, states=[])
    ((_, _, p),), _ = _as_probable_as_complete(correction, [Named(found, None, 0.98)])
    assert p == pytest.approx(probability, abs=0.01)


@pytest.mark.parametrize(
    ("effect", "transmission", "controller", "probability"),
    [
        ("transmission_compliance", 3.0, 1.0, 0.5),
        ("transmission_compliance", 1.0, 3.0, 0.98),
        ("coulomb_friction", 3.0, 1.0, 0.98),
        ("coulomb_friction", 1.0, 1.0, 0.5),
    ],
)
def test_an_effect_whose_own_block_shows_what_no_law_describes_is_as_probable_as_not(effect, transmission, controller, probability):
    """A soft stage of a lost motion resembles a backlash. Friction has no channel of its own: what remains is its block only if no other shows it."""
    noise = np.random.default_rng(0).normal(size=(2, 2000))
    group = group_of(list(noise * np.array([[transmission], [controller]])))
    names = ("motor_minus_scale", "controller")
    group = replace(group, channels=[replace(c, name=name, run=0) for c, name in zip(group.channels, names)])
    size = {"stiffness": 3e8, "factor": 1.5}
    parameters = {p.name: size[p.name] for p in EFFECTS[effect].parameters if p.name in size}
    found = Setting(EFFECTS[effect], "X", parameters)
    state = found_of(group, fit=replace(no_effect(group, no_tuning(group.size)), settings=(found,)))
    correction = SimpleNamespace(closed={"X": 0.99}, doubtful={"X"}, laws=None, axes_with_law=set(), stand_ins={}, states=[state])
    ((_, _, p),), _ = _as_probable_as_complete(correction, [Named(found, state, 0.98)])
    assert p == probability
    correction.axes_with_law = {"X"}
    ((_, _, p),), _ = _as_probable_as_complete(correction, [Named(found, state, 0.98)])
    assert p == 0.98


def test_the_spring_of_a_law_is_a_part_of_it(mikron):
    corrected, found = spring(mikron, 3e8)
    assert effects_beside_laws(Laws((), (), corrected, {found.key: 0.0}), [(found, None, 0.98)]) == []


@pytest.mark.parametrize(("quick", "machines"), [(False, [[], ["transmission_compliance"]]), (True, [[]])])
def test_a_group_is_searched_again_with_the_axis_that_pushes_it_corrected(monkeypatch, mikron, quick, machines):
    """The acceleration of X contains the swinging of its drive train, which the search of X found."""
    groups = {("X",): group_of([np.zeros(50)]), ("Z",): group_of([np.zeros(50)], "Z")}
    pushing = Setting(EFFECTS["cross_axis_coupling"], "Z", {"mass": 100.0}, "X")
    searches: dict[str, list[list[str]]] = {"X": [], "Z": []}

    def search(group, setup):
        searches[group.axes[0]].append([s.effect.name for s in settings_of(group.views[0].machine)])
        state = found_of(group)
        return state if group.axes == ("X",) else replace(state, fit=replace(state.fit, settings=(pushing,)))

    views = {axes[0]: replace(group, views=[replace(group.views[0], machine=mikron)]) for axes, group in groups.items()}
    monkeypatch.setattr(procedure, "axis_groups", lambda *_: list(groups))
    monkeypatch.setattr(procedure, "observe", lambda _, axes, *further: views[axes[0]])
    monkeypatch.setattr(procedure, "search", search)
    monkeypatch.setattr(procedure, "corrected_by", lambda state: lambda machine: spring(machine, 3e9)[0])
    monkeypatch.setattr(procedure, "final_state", lambda state, quick: state)
    setup = Setup(mikron, [[0]], map, lambda _: None, quick, threads=1)
    procedure._searched(setup, SimpleNamespace(runs=()))
    assert searches == {"X": [[]], "Z": machines}


@pytest.mark.parametrize(("divided", "clearance", "probability"), [({"X"}, 2e-6, 0.5), ({"X"}, 2e-5, 0.9), (set(), 2e-6, 0.9)])
def test_a_play_that_friction_of_the_load_may_be_is_one_of_two(mikron, monkeypatch, divided, clearance, probability):
    """X winds a spring of 3e8 N/m by several um under its friction. Where the file assumes its side, a smaller play is no finding."""
    wound = 2.0 * mikron.axis("X").coulomb_friction / 3e8
    assert 2e-6 < wound < 2e-5
    effects = [
        {"name": "transmission_compliance", "axis": "X", "stiffness": 3e8},
        {"name": "backlash", "axis": "X", "clearance": clearance},
    ]
    named = [Named(setting, None, 0.9) for setting in settings_of(with_effects(mikron, effects))]
    monkeypatch.setattr(procedure, "divided_masses", lambda _: divided)
    found = {one.setting.effect.name: one.probability for one in procedure.play_or_friction(mikron, named)}
    assert found == {"transmission_compliance": 0.9, "backlash": probability}
