"""Everyday machines: how they are drawn, what each effect contributes, and the marks that their diagnosis gets."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
import math
from pathlib import Path
import subprocess
import tomllib

import numpy as np
import pytest

from devtools.truth_file import truth_toml
from twin.effects import EFFECTS as TWIN_EFFECTS
from twin.exam import budget
from twin.exam import draw as drawing
from twin.exam.budget import SIGNALS, SUBSTEPS, budget_of, groups_of, noise_of
from twin.exam.candidate import write_answer
from twin.exam.draw import BACKGROUND, SHIPPED_MACHINE, Case, draw_case, peaks_of, runs_of, truth_of
from twin.exam.mark import mark, mark_answer, mark_budget
from twin.exam.plant.effects import LIBRARY, DrawContext, draw_effect
from twin.exam.plant.parameters import AXES, Richness, settings_of, unit_factors
from twin.exam.plant.plant import run
from twin.exam.programme import TestRun
from twin.exam.questions import STRATA, questions_of
from twin.exam.report import sections_of
from twin.exam.score import score
from twin.exam.session import draw, sit
from twin.machine.machine import default_machine_path, load_machine
from twin.recordings.campaign import read_campaign

MACHINE = tomllib.loads(SHIPPED_MACHINE.read_text())
SCALE = {"constant_force": "force", "cyclic_error": "amplitude", "lead_error": "fraction", "thermal_drift": "rate"}


@pytest.fixture
def drawn_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the stability run of drawn machines, which these tests do not need."""
    monkeypatch.setattr(drawing, "behaves", lambda case, machine: True)


# --- drawing -----------------------------------------------------------------------------------------


@pytest.mark.usefixtures("drawn_only")
def test_an_everyday_machine_has_background_effects_on_every_axis_and_up_to_three_main_effects() -> None:
    main, zeros = Counter[int](), Counter[str]()
    for seed in range(16):
        case = draw_case(seed, "everyday", MACHINE)
        there = [(e["name"], e["axis"]) for e in case.effects]
        assert len(set(there)) == len(there)
        assert set(BACKGROUND) <= set(there)
        first = [i for i, what in enumerate(there) if what in BACKGROUND and i >= len(there) - len(BACKGROUND)]
        beside = len(there) - len(BACKGROUND)  # one of usual size may stand in the place of its own kind
        assert 0 <= beside <= 3
        assert first
        main[beside] += 1
        zeros[case.encoder_zero] += 1
    assert len(BACKGROUND) == 6 * 5 + 3 + 3 + 1
    assert {n for n, a in BACKGROUND if a == "C"} - {n for n, a in BACKGROUND if a == "A"} == {"encoder_eccentricity"}
    assert len(main) >= 3
    assert set(zeros) == {"each run", "kept"}


@pytest.mark.usefixtures("drawn_only")
def test_a_background_is_3_to_15_percent_of_usual_sizes() -> None:
    usual = {"constant_force": (0.2, 0.5), "cyclic_error": (2e-6, 7e-6), "lead_error": (25e-6, 80e-6), "thermal_drift": (0.1e-6, 0.4e-6)}
    sizes = []
    for seed in range(8):
        case = draw_case(seed, "everyday", MACHINE, spread=0.0)
        coulomb = settings_of(MACHINE, case.factors).coulomb[0]
        for e in case.effects[-len(BACKGROUND) :]:
            if e["axis"] == "X" and e["name"] in SCALE:
                low, high = usual[e["name"]]
                size = abs(e[SCALE[e["name"]]]) / (coulomb if e["name"] == "constant_force" else 1.0)
                sizes.append((size / low, size / high))
    small = [s for s in sizes if s[0] < 0.6]  # what is larger is an effect beside it, of usual size
    assert len(small) >= len(sizes) - 4
    assert min(s[0] for s in small) > 0.03
    assert max(s[1] for s in small) < 0.15
    assert max(s[0] for s in small) > 0.15  # not all are smallest


@pytest.mark.usefixtures("drawn_only")
def test_older_kinds_of_cases_keep_their_numbers() -> None:
    """Seeds give the same numbers as before everyday and wide machines existed."""
    case = draw_case(5, "single", MACHINE, effect="speed_integral_time", axis="Y")
    assert (case.encoder_zero, case.wide) == ("each run", False)
    assert case.effects[0]["factor"] == pytest.approx(SPEED_INTEGRAL_TIME_OF_SEED_5, rel=1e-12)
    ripple = draw_case(5, "single", MACHINE, effect="torque_ripple", axis="Y").effects[0]
    assert (ripple["periods_per_rev"], ripple["phase_rad"]) == pytest.approx(RIPPLE_OF_SEED_5, rel=1e-12)


SPEED_INTEGRAL_TIME_OF_SEED_5 = 0.6035653791274661
RIPPLE_OF_SEED_5 = (7.0, 3.9694635630095334)


def context(axis: str, seed: int, wide: bool) -> DrawContext:
    s = settings_of(MACHINE, unit_factors())
    return DrawContext(np.random.default_rng(seed), AXES.index(axis), 1.0, s, *PEAKS, wide)


PEAKS = peaks_of(MACHINE, unit_factors(), runs_of(MACHINE, 0, "short"))


def test_wide_ranges_are_three_times_as_wide_and_stay_positive() -> None:
    d = context("X", 1, True)
    values = np.log([d.within(0.03, 0.12) for _ in range(2000)])
    assert math.exp(values.min()) == pytest.approx(0.03**2 / 0.12, rel=0.01)
    assert math.exp(values.max()) == pytest.approx(0.12**2 / 0.03, rel=0.01)
    assert {d.whole(4, 12) for _ in range(1000)} == {float(n) for n in range(1, 37)}


@pytest.mark.parametrize("name", LIBRARY)
def test_wide_effects_can_be_simulated_by_the_twin_and_leave_the_usual_range(name: str) -> None:
    axis = LIBRARY[name].axes[0]
    usual, wide = ([draw_effect(name, axis, context(axis, seed, w)) for seed in range(60)] for w in (False, True))
    left = False
    for parameter in TWIN_EFFECTS[name].parameters:
        values = [e[parameter.name] for e in wide if parameter.name in e]
        assert all(parameter.low <= v <= parameter.high for v in values), parameter.name
        before = [e[parameter.name] for e in usual if parameter.name in e]
        if values and not parameter.periodic:
            left |= max(values) > max(before) or min(values) < min(before)
    assert left


def test_a_tenth_of_every_kind_is_wide() -> None:
    questions = questions_of(3, 1000)
    wide = Counter(q.stratum.name for q in questions if q.wide)
    for stratum in STRATA:
        assert wide[stratum.name] == pytest.approx(100 * stratum.share, abs=1)
    assert sum(s.share for s in STRATA) == pytest.approx(1.0)
    assert all(type(q.wide) is bool for q in questions)  # it is written to the sealed truth
    assert [q.number for q in questions_of(4, 1000) if q.wide] != [q.number for q in questions if q.wide]
    assert {questions_of(seed, 1)[0].wide for seed in range(40)} == {True, False}  # also in small examinations


# --- the plant ---------------------------------------------------------------------------------------


def moves(seconds: float = 0.6) -> TestRun:
    """All axes move and reverse, each at its own frequency, from starts away from zero."""
    t = np.arange(round(seconds * 1e3)) * 1e-3
    wave = [
        start + size * np.sin(2 * math.pi * hz * t) ** 2
        for start, size, hz in zip((0.013, 0.05, -0.02, -0.6, 0.2), (0.02, 0.018, 0.016, 0.12, 0.3), (1.7, 2.1, 2.6, 1.3, 1.9))
    ]
    return TestRun("moves", "test", "velocity+torque", np.column_stack(wave))


def machine_with(*effects: dict, zero: str = "each run") -> Case:
    return Case(1, "everyday", 1.0, effects, unit_factors(), Richness.off(), encoder_zero=zero)


CYCLIC = {"name": "cyclic_error", "axis": "X", "amplitude": 3e-6, "phase_rad": 0.7}
LEAD = {"name": "lead_error", "axis": "Y", "fraction": 4e-5}


@pytest.mark.parametrize("zero", drawing.ZEROS)
def test_with_a_kept_encoder_zero_the_error_depends_on_the_absolute_position(zero: str) -> None:
    trace = run(drawing.settings_for(machine_with(CYCLIC, LEAD, zero=zero), MACHINE), moves(0.3).set_points, noise=False)
    q, ratio = trace.load, 0.010 / (2 * math.pi)
    kept = zero == "kept"

    def cyclic(at: np.ndarray) -> np.ndarray:
        return np.asarray(3e-6 * np.sin(at / ratio + 0.7))

    shown = q[:, 0] - cyclic(q[:, 0]) + (0.0 if kept else cyclic(q[0, 0]))
    assert np.allclose(trace.motor_position[:, 0], shown, rtol=0, atol=6e-9)
    assert np.allclose(trace.motor_position[:, 1], q[:, 1] - 4e-5 * (q[:, 1] - (0.0 if kept else q[0, 1])), rtol=0, atol=6e-9)


# --- the budget --------------------------------------------------------------------------------------

FORCES = tuple({"name": "constant_force", "axis": a, "force": f} for a, f in (("X", 60.0), ("Y", 40.0), ("A", 3.0), ("C", 2.0)))
DRIFT = {"name": "thermal_drift", "axis": "Z", "rate": 2e-7}


def test_axes_that_push_each_other_are_one_group() -> None:
    assert groups_of(machine_with()) == [("X",), ("Y",), ("Z",), ("A", "C")]
    joined = machine_with({"name": "cross_axis_coupling", "axis": "Z", "from_axis": "X", "mass": 10.0})
    assert groups_of(joined) == [("X", "Z"), ("Y",), ("A", "C")]


def test_noise_is_the_spread_of_several_recordings() -> None:
    """The current noise from two recordings agrees with the standard deviation over six others."""
    case, test = machine_with(), moves(0.3)
    recordings = [drawing.simulate(replace(case, noise_seed=seed), MACHINE, test, 0.0, SUBSTEPS) for seed in range(6)]
    spread = np.sqrt(np.mean(np.var([r.current for r in recordings], axis=0, ddof=1), axis=0))
    assert noise_of(replace(case, noise_seed=7), MACHINE, test, 0.0)[SIGNALS.index("current")] == pytest.approx(spread, rel=0.15)


def test_the_budget_of_an_effect_is_the_change_when_it_is_removed() -> None:
    """Effects removed together on different axes get the same budget as alone; a drift agrees with its formula."""
    case = machine_with(CYCLIC, *FORCES, DRIFT)
    rows = {(r["effect"], r["axis"]): r for r in budget_of(case, MACHINE, [moves(), moves()])}
    assert len(rows) == 6
    t = np.concatenate([np.arange(600) * 1e-3 + start for start in (0.0, 5.6)])
    assert rows["thermal_drift", "Z"]["true_position_rms"] == pytest.approx(2e-7 * np.sqrt(np.mean(t**2)), rel=0.02)
    noise = 1e-8 / math.sqrt(12.0)  # of a motor encoder, at least
    assert rows["thermal_drift", "Z"]["times_noise"] < rows["thermal_drift", "Z"]["true_position_rms"] / noise / math.sqrt(15.0) * 1.1
    assert rows["cyclic_error", "X"]["true_position_rms"] < 3e-6
    sizes = [r["times_noise"] for r in budget_of(case, MACHINE, [moves(0.3)])]
    assert sizes == sorted(sizes, reverse=True)
    alone = budget_of(replace(case, effects=FORCES[:1]), MACHINE, [moves(), moves()])[0]
    assert rows["constant_force", "X"]["times_noise"] == pytest.approx(alone["times_noise"], rel=0.05)
    sealed = tomllib.loads(truth_toml(truth_of(replace(case, budget=tuple(rows.values())))))
    assert sealed["budget"][0].keys() == {"effect", "axis", "times_noise", "true_position_rms"}
    assert sealed["case"]["encoder_zero"] == "each run"
    assert sealed["case"]["wide"] is False


def test_the_noise_of_a_contribution_is_that_of_all_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run in which an axis rests has almost no noise; it must not outweigh the others."""
    case = machine_with(*FORCES[:1])
    shape = len(SIGNALS), len(AXES)

    def size(*levels: float) -> float:
        noise = iter(levels)
        monkeypatch.setattr(budget, "noise_of", lambda *_: np.full(shape, next(noise)))
        return float(budget_of(case, MACHINE, [moves(), moves()])[0]["times_noise"])

    assert size(1e-9, 7e-9) == size(5e-9, 5e-9)


# --- marks -------------------------------------------------------------------------------------------

TRUE = {
    ("thermal_drift", "X"): 200.0, ("backlash", "X"): 80.0, ("cyclic_error", "A"): 30.0, ("constant_force", "Y"): 10.0,
    ("lead_error", "Z"): 4.0, ("stribeck", "C"): 0.5,
}  # fmt: skip
TRUTH = {
    "effect": [{"name": n, "axis": a} for n, a in TRUE],
    "outside": [],
    "budget": [{"effect": n, "axis": a, "times_noise": size, "true_position_rms": 0.0} for (n, a), size in TRUE.items()],
}


def said(sizes: dict, candidates: dict | None = None) -> dict:
    effects = [
        {"effect": n, "axis": a, "block": TWIN_EFFECTS[n].block, "probability": 0.9, "parameters": {}, "times_noise": s}
        for (n, a), s in sizes.items()
    ]
    tried = [{"effect": n, "axis": a, "probability": p} for (n, a), p in (candidates or {}).items()]
    rows = [{**e, "kind": "effect"} for e in effects] + [{"effect": "inertia", "axis": "X", "kind": "re-tuned", "times_noise": 99.0}]
    return {
        "verdict": "effect", "effects": effects, "candidates": tried, "ambiguous_with": [], "where": [], "gap": {}, "budget": {"rows": rows},
    }  # fmt: skip


def test_a_right_budget_gets_full_marks() -> None:
    visible = {what: size for what, size in TRUE.items() if size >= 3.0}
    m = mark_budget(TRUTH, said(visible))
    assert (m["recall"], m["precision"], m["largest"], m["order"]) == ([5, 5], [5, 5], True, pytest.approx(1.0))
    whole = mark_answer(TRUTH, said(visible))
    assert whole["exact"]
    assert whole["first"]
    assert mark_answer(TRUTH, said(TRUE))["exact"]  # what hides below three times noise may be named
    assert not mark_answer(TRUTH, said({**visible, ("inertia", "X"): 9.0}))["exact"]
    assert not mark_answer(TRUTH, said(dict(list(visible.items())[:4])))["exact"]


def test_what_is_missed_false_or_out_of_order_is_marked() -> None:
    m = mark_budget(TRUTH, said({("backlash", "X"): 80.0, ("cyclic_error", "A"): 100.0, ("inertia", "Z"): 5.0}))
    assert (m["recall"], m["precision"], m["largest"]) == ([2, 5], [2, 3], False)
    assert m["order"] < 0.5
    by_name = {(c["effect"], c["axis"]): c["said"] for c in m["contributions"]}
    assert by_name["cyclic_error", "A"] == 100.0
    assert by_name["thermal_drift", "X"] is None
    silent = mark_budget(TRUTH, {"effects": []})
    assert (silent["recall"], silent["precision"], silent["largest"], silent["order"]) == ([0, 5], [0, 0], False, 0.0)


def test_every_detectable_candidate_is_scored_by_its_probability() -> None:
    tried = {("thermal_drift", "X"): 0.2, ("inertia", "Y"): 0.3, ("stribeck", "C"): 0.6}
    m = mark_budget(TRUTH, said({("thermal_drift", "X"): 200.0}, tried))
    # named and present: 0.9; tried and absent: 0.3; below the visible size: not scored; three other visible ones: 0
    assert sorted(m["candidates"]) == [[0.0, True]] * 4 + [[0.3, False], [0.9, True]]


@pytest.mark.usefixtures("drawn_only")
def test_an_everyday_machine_is_drawn_recorded_answered_and_marked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Drawn with its budget, recorded, answered by this test, marked; with background effects on X only and one run."""
    monkeypatch.setattr(drawing, "BACKGROUND", tuple(b for b in BACKGROUND if b[1] == "X"))
    monkeypatch.setattr(drawing, "MOST_MAIN", 0)
    monkeypatch.setitem(drawing.RUN_SETS, "short", ("acceleration",))
    monkeypatch.setitem(drawing.RUN_SETS, "exam", ("exam_five_axis",))
    (question,) = questions_of(3, 1, short=True, only="everyday")
    machine_file = str(default_machine_path())
    case = draw(question, machine_file, "off")
    assert isinstance(case, Case)
    budget = {(row["effect"], row["axis"]): row["times_noise"] for row in case.budget}
    assert set(budget) == {(e["name"], "X") for e in case.effects}
    largest = next(iter(budget))

    def candidate(command: list[str], **_: object) -> subprocess.CompletedProcess:
        campaign, machine, answer = map(Path, command[3:6])
        assert [run.name for run in read_campaign(campaign, load_machine(machine)).runs] == ["acceleration"]
        write_answer(answer, load_machine(machine), said({largest: 1.1 * budget[largest], ("inertia", "X"): 5.0}))
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr("twin.exam.session.subprocess.run", candidate)
    sit(question, case, str(tmp_path), machine_file, True)
    m = mark(question, case, str(tmp_path), machine_file)
    assert m["budget"]["precision"] == [1, 2]
    assert m["budget"]["contributions"][0]["said"] == pytest.approx(1.1 * m["budget"]["contributions"][0]["true"])
    assert m["gap"]["after"] == pytest.approx(m["gap"]["before"])  # the answer's machine is the nominal one
    assert 0.5 < m["gap"]["before"] / m["gap"]["floor"] < 20.0


def marked(answer: dict) -> dict:
    return {
        "case": "1", "stratum": "everyday", "true": [list(what) for what in TRUE], "outside": [],
        "gap": {"before": 9.0, "after": 1.2, "floor": 1.0, "size": 9.0}, **mark_answer(TRUTH, answer),
    }  # fmt: skip


def test_scores_of_everyday_machines_stand_by_themselves() -> None:
    some = {("thermal_drift", "X"): 220.0, ("backlash", "X"): 80.0, ("inertia", "X"): 9.0}
    marks = [marked(said(some)), marked(said({what: 1.1 * size for what, size in TRUE.items()}))]
    s = score(marks)
    values = {t["what"]: t for t in s["targets"]}
    assert values["everyday: named effects that are there"]["value"] == pytest.approx(8 / 9)
    assert values["everyday: effects of at least 3 x noise that are named"]["value"] == pytest.approx(7 / 10)
    assert values["everyday: largest contribution named"]["right"] == 2
    assert values["everyday: relative error of a contribution, median"]["value"] == pytest.approx(0.1)
    assert values["everyday: gap after over floor, median"]["met"]
    assert values["everyday: Brier score of the candidates"]["value"] > 0.05
    assert "value" not in values["gap after over floor, median"]
    assert "value" not in values["Brier score"]
    document = {"score": s, "marks": marks, "not_drawn": {}, "not_answered": 0, "seed": 1, "richness": "off", "seal": "0"}
    section = next(s for s in sections_of(document) if s.title == "Everyday machines")
    assert len(section.figures) == 2
