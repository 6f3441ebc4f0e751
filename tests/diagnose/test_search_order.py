"""Order of a search: effects first, then slip before break-away, which would otherwise absorb missing effects."""

from dataclasses import replace

import numpy as np

from tests.builders.diagnosis_state import found_of, group_of
from twin.diagnose import search
from twin.diagnose.setup import Setup
from twin.diagnose.state import GroupState


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
    search._search_rounds(found, Setup(mikron, mikron, [[0]], map, lambda _: None, quick))
    return done


def test_slip_is_sized_when_no_effect_is_accepted(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], ["stribeck"]], 0) == ["round", "backlash", "round", "stribeck", "round", "slip"]


def test_effects_are_searched_again_after_slip_changes(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], [], ["stribeck"]], 1) == [
        "round", "backlash", "round", "slip", "round", "stribeck", "round", "slip",
    ]  # fmt: skip


def test_a_quick_look_sizes_no_slip(monkeypatch, mikron):
    assert searched(monkeypatch, mikron, [["backlash"], []], 1, quick=True)[-1] == "round"
