"""Probabilities of candidates and effects, verdict sentences, and targets of the examination."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import no_tuning
from twin.diagnose import verdict
from twin.diagnose.channel import Channel
from twin.diagnose.fit import Sizes, no_effect
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.state import Candidate, GroupState
from twin.diagnose.verdict import probabilities_of
from twin.diagnose.wording import sentence_case, verdict_sentence
from twin.effects import EFFECTS, Setting
from twin.exam.score import is_failed, share_of


def candidate(effect: str, evidence: float, needed: float, plausible: bool = True) -> Candidate:
    sizes = Sizes((Setting(EFFECTS[effect], "X", {}),), (), np.zeros((0, 0)), T.prior_weight, np.zeros((0, 0)))
    return Candidate(sizes, evidence, needed, plausible, 0.5, evidence)


def holding(*candidates: Candidate) -> SimpleNamespace:
    group = SimpleNamespace(confidence=lambda axis: T.confidence)
    return SimpleNamespace(keys={c.key for c in candidates}, group=group)


@pytest.mark.parametrize(("moving", "most"), [([True], 0.9), ([True, False], 0.9), ([True, True], 0.98)])
def test_what_no_second_run_can_confirm_is_less_probable(moving, most):
    views = [SimpleNamespace(moves=lambda axis, m=m: m) for m in moving]
    group = Group(("X",), views, [], [], [], 0)
    assert group.confidence("X") == most
    best = candidate("backlash", 200.0, 20.0)
    state = SimpleNamespace(keys={best.key}, group=group)
    assert probabilities_of([best], state) == pytest.approx([most])


def test_an_accepted_effect_is_probable():
    best, rival = candidate("backlash", 200.0, 20.0), candidate("presliding", 150.0, 30.0)
    p = probabilities_of([best, rival], holding(best))
    assert p[0] == pytest.approx(T.confidence)
    assert p[1] < 1e-6


def test_an_effect_without_the_needed_evidence_is_improbable():
    """An evidence of 100 is sufficient for a short campaign. If 130 are needed, a model error could imitate it."""
    p = probabilities_of([candidate("position_gain", 100.0, 130.0)], holding())
    assert p[0] < 1e-3
    p = probabilities_of([candidate("position_gain", 130.0, 130.0)], holding(candidate("position_gain", 130.0, 130.0)))
    assert p[0] == pytest.approx(0.5 * T.confidence)


def test_candidates_of_a_round_with_a_refused_best_have_probability_zero():
    best, rival = candidate("backlash", 200.0, 20.0), candidate("presliding", 199.0, 20.0)
    assert probabilities_of([best, rival], holding()) == [0.0, 0.0]


def test_an_implausible_size_is_improbable():
    implausible, best = candidate("backlash", 300.0, 20.0, plausible=False), candidate("presliding", 200.0, 20.0)
    p = probabilities_of([implausible, best], holding(best))
    assert p == [0.0, pytest.approx(T.confidence)]
    assert probabilities_of([implausible], holding()) == [0.0]


def test_the_residual_of_a_removed_effect_makes_the_verdict_unknown(monkeypatch: pytest.MonkeyPatch):
    """An effect whose final size is implausible is removed. The verdict must then not be 'none'."""
    before, after = (GroupState(None, None, None, SimpleNamespace(settings=s), 1.0) for s in (("an effect",), ()))
    monkeypatch.setattr(verdict, "without_implausible", lambda found, *_: found)
    monkeypatch.setattr(verdict, "with_final_sizes", lambda *_: after)
    monkeypatch.setattr(verdict, "is_unknown", lambda found: not found.fit.settings)
    monkeypatch.setattr(verdict, "with_zeros_out", lambda found: found)
    assert verdict.final_state(before).unknown
    monkeypatch.setattr(verdict, "with_final_sizes", lambda found, *_: found)
    assert not verdict.final_state(before).unknown


@pytest.mark.parametrize(("of_a", "of_c", "unknown"), [(1.3, 0.5, True), (1.0, 0.5, False), (1.0, 1.3, True), (1.0, 1.0, False)])
def test_each_axis_of_a_group_is_judged_by_itself(monkeypatch: pytest.MonkeyPatch, of_a: float, of_c: float, unknown: bool):
    """Coupled axes are searched together, but an axis below its noise does not compensate another one."""
    monkeypatch.setattr(Channel, "settled", lambda self, *_: np.ones(len(self.residual), bool))
    noise = np.random.default_rng(2).normal(size=(2, 3000))
    channels = [Channel(0, axis, "velocity", size * rows, np.ones(3000), 1.0) for axis, size, rows in zip("AC", (of_a, of_c), noise)]
    group = Group(("A", "C"), [None], channels, [{}], [{}], 0)
    tuning = no_tuning(group.size)
    fit = no_effect(group, tuning)
    assert verdict.is_unknown(GroupState(group, group, tuning, fit, 1.0)) is unknown


def effect(name: str, axis: str, source: str | None = None, mass: float = 1.0) -> dict:
    of = {"effect": name, "axis": axis, "parameters": {"mass_kg": {"value": mass, "low": mass, "high": mass, "unit": "kg"}}}
    return {**of, "from_axis": source} if source else of


def test_two_couplings_of_one_axis_have_different_names():
    document = {
        "verdict": "effect",
        "effects": [effect("cross_axis_coupling", "X", "Y", 1.0), effect("cross_axis_coupling", "X", "Z", 2.0), effect("backlash", "A")],
    }
    assert verdict_sentence(document) == (
        "The gap comes from cross axis coupling on axis X from Y, cross axis coupling on axis X from Z and backlash on axis A."
    )
    assert "from Y (1.00 kg), cross axis coupling on axis X from Z (2.00 kg) and" in verdict_sentence(document, numbers=True)
    assert sentence_case("cross axis coupling on axis X from Y") == "Cross axis coupling on axis X from Y"


@pytest.mark.parametrize(
    ("right", "of", "goal", "failed"),
    [(18, 19, 0.98, False), (11, 15, 0.80, False), (5, 15, 0.80, True), (15, 15, 0.80, False), (45, 45, (0.88, 0.99), False)],
)
def test_a_target_fails_only_beyond_chance(right: int, of: int, goal, failed: bool):
    least, most = goal if isinstance(goal, tuple) else (goal, 1.0)
    met = least <= right / of <= most
    assert is_failed({"met": met, "target": goal, **share_of(right, of)}) is failed


def test_a_value_beyond_its_target_fails():
    assert is_failed({"met": False, "target": -1.3, "value": 1.31, "of": 20})
    assert not is_failed({"met": None, "target": -1.3})
    assert share_of(0, 0) is None
