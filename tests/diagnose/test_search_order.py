"""Order of a search: effects first, then slip before break-away, which would otherwise absorb missing effects. Near noise, normal imperfections
are fitted again before an effect is accepted; where no channel isolates a block, effects of an axis are accepted one at a time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of
from twin.diagnose import search
from twin.diagnose.fit import no_effect
from twin.diagnose.setup import Setup
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import Nuisance
from twin.diagnose.tuning import tuning_from
from twin.effects import EFFECTS, Setting


def searched(monkeypatch, mikron, winners: list[list[str]], slips: int, quick: bool = False) -> list[str]:
    """Steps of a search in order. Its rounds accept these winners, and its slip changes this many times."""
    done: list[str] = []
    rounds, changes = iter(winners), iter([True] * slips)

    def one_round(found: GroupState, *_: object) -> tuple[GroupState, list[str]]:
        done.append("round")
        return found, next(rounds, [])

    def with_slip(found: GroupState, *_: object) -> GroupState:
        done.append("slip")
        return replace(found) if next(changes, False) else found

    def with_effects(found: GroupState, winners: list[str], *_: object) -> GroupState:
        done.extend(winners)
        return replace(found)

    monkeypatch.setattr(search, "_round", one_round)
    monkeypatch.setattr(search, "with_refitted_slip", with_slip)
    monkeypatch.setattr(search, "_with_accepted", with_effects)
    monkeypatch.setattr(search, "_without_redundant_effects", lambda found, *_: found)
    found = found_of(group_of([np.full(50, 3.0)]))
    search._search_rounds(found, Setup(mikron, [[0]], map, lambda _: None, quick))
    return done


def test_slip_is_sized_when_no_effect_is_accepted(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], ["stribeck"]], 0) == ["round", "backlash", "round", "stribeck", "round", "slip"]


def test_effects_are_searched_again_after_slip_changes(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], [], ["stribeck"]], 1) == [
        "round", "backlash", "round", "slip", "round", "stribeck", "round", "slip",
    ]  # fmt: skip


def test_a_quick_look_sizes_no_slip(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], []], 1, quick=True)[-1] == "round"


@pytest.mark.parametrize(("gain", "accepted"), [(100.0, []), (1.0, ["inertia"])])
def test_an_effect_near_noise_must_explain_more_than_refitted_imperfections(monkeypatch, mikron, gain, accepted):
    """A drive train that is slightly off looks like mass. Here the imperfections explain the residual better by `gain` once they are fitted again."""
    rows = np.full(50, 0.9)
    group = group_of([rows])
    tuning = tuning_from([Nuisance("X", "elasticity")], columns_of(np.zeros((50, 1))), 0.01)
    start = found_of(group, tuning)
    better = replace(start, fit=replace(no_effect(group, tuning), loss=start.fit.loss - gain))
    rounds, done = iter([["inertia"]]), []
    monkeypatch.setattr(search, "_imperfections_need_refit", lambda state: False)
    monkeypatch.setattr(search, "_refit_imperfections", lambda state: better)
    monkeypatch.setattr(search, "_round", lambda state, *_: (state, next(rounds, [])))
    monkeypatch.setattr(search, "with_refitted_slip", lambda state: state)
    monkeypatch.setattr(search, "_with_accepted", lambda state, winners: done.extend(winners) or state)
    monkeypatch.setattr(search, "_without_redundant_effects", lambda state, _: state)
    found = search._search_rounds(start, Setup(mikron, [[0]], map, lambda _: None, False))
    assert done == accepted
    assert (found is start) is bool(accepted)


def test_effects_that_the_signals_do_not_isolate_are_accepted_one_at_a_time():
    """A position gain beside a drive train that is not known yet looks like a position gain and a speed gain."""
    group = group_of([np.zeros(50)], "XY")  # speeds only: no channel isolates a controller

    def found(name: str, axis: str, evidence: float) -> SimpleNamespace:
        return SimpleNamespace(candidate=SimpleNamespace(setting=Setting(EFFECTS[name], axis, {}), evidence=evidence))

    weak, strong, other = found("speed_gain", "X", 122.0), found("position_gain", "X", 2245.0), found("speed_gain", "Y", 100.0)
    assert search._one_at_a_time_where_not_isolated(group, [weak, strong, other]) == [strong, other]
    friction, mass = found("coulomb_friction", "X", 50.0), found("inertia", "X", 90.0)
    assert search._one_at_a_time_where_not_isolated(group, [friction, mass]) == [friction, mass]
