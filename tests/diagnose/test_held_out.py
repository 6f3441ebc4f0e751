"""Gaps on held-out runs, including folds whose machine cannot be simulated."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import found_of, group_of
from twin.diagnose import corrected, validation
from twin.diagnose.settings import DEFAULT
from twin.diagnose.tolerance import nuisances_of
from twin.diagnose.tuning import tuning_from
from twin.effects import with_effects
from twin.errors import InputError, SimulationError
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import SignalGap

RUNS = [MeasuredRun(name, Trace(np.arange(3.0), {}), None, 0.0) for name in ("first", "second", "third")]
FOLDS = [[0], [1], [2]]


@pytest.fixture
def machines(monkeypatch, request):
    """Machines are strings; `unstable` holds those that cannot be simulated because they diverge or a spring is too stiff for the step."""
    error = getattr(request, "param", SimulationError)
    unstable = set()

    def predict_each(jobs, threads=None):
        if any(job.machine in unstable for job in jobs):
            raise error("no machine runs like that")
        return [f"{job.machine} on {job.run.name}" for job in jobs]

    monkeypatch.setattr(corrected, "fitted_without", lambda machine, found, fold: f"without {fold}" if fold else "fitted to all")
    monkeypatch.setattr(corrected, "predict_each", predict_each)
    return unstable


def after(folds=FOLDS):
    held_out = corrected.held_out_gaps(RUNS, [None] * len(RUNS), "nominal", [], folds, engine=True, threads=1)
    assert held_out.predictions["before"]["second"] == "nominal on second"
    return [held_out.predictions["after"][run.name].removesuffix(f" on {run.name}") for run in RUNS], held_out.runs


def test_each_run_is_predicted_by_the_others(machines):
    assert after() == (["without [0]", "without [1]", "without [2]"], ["first", "second", "third"])
    assert after([[0, 1, 2]]) == (["fitted to all"] * 3, [])


@pytest.mark.parametrize("machines", [SimulationError, InputError], indirect=True)
def test_an_unstable_machine_is_replaced_by_the_one_fitted_to_all(machines):
    machines.add("without [1]")
    assert after() == (["without [0]", "fitted to all", "without [2]"], ["first", "third"])


def test_a_diverging_corrected_machine_raises(machines):
    machines.update({"without [1]", "fitted to all"})
    with pytest.raises(SimulationError):
        after()


@pytest.mark.parametrize(("after", "worse"), [(0.5, False), (1.2, False), (1.6, True), (40.0, True)])
def test_a_correction_that_increases_the_gap_is_detected(monkeypatch, after, worse):
    level = {"before": 1.1, "after": after}
    monkeypatch.setattr(
        corrected, "gap_of", lambda machine, run, which: {"X": {"position": SignalGap(level[which], level[which], 1.0, "um", level[which])}}
    )
    held_out = corrected.HeldOut({which: {run.name: which for run in RUNS} for which in level}, [])
    levels = [held_out.levels("nominal", RUNS, which) for which in level]
    assert corrected.is_worse("X", *levels) is worse
    assert not corrected.is_worse("Y", *levels)


def test_axes_that_a_correction_makes_worse_keep_the_machine_file(mikron):
    group = group_of([np.full(50, 3.0), np.full(50, -2.0)])
    nuisances = nuisances_of(mikron, ("X",), group.thresholds)
    found = found_of(group, tuning_from(nuisances, np.eye(group.size)[:, : len(nuisances)], 0.01))
    nominal = with_effects(mikron, []).document
    stays = corrected.uncorrected(found)
    assert stays.unknown
    for machine_of in (lambda f: corrected.corrected_machine(mikron, [f]), lambda f: corrected.fitted_without(mikron, [f], [0])):
        assert machine_of(found).document != nominal
        assert machine_of(stays).document == nominal


LEVELS = {
    "nominal": {"position": 30.0, "current": 1.0},
    "good law": {"position": 1.1, "current": 1.2},
    "law that opens another gap": {"position": 1.1, "current": 4.4},
}


@pytest.mark.parametrize(("law", "accepted"), [("good law", True), ("law that opens another gap", False)])
def test_a_law_that_makes_one_signal_worse_is_refused(monkeypatch, law, accepted):
    def gaps(machine, run, predicted):
        return {"X": {signal: SignalGap(level, level, 1.0, "um", level) for signal, level in LEVELS[predicted].items()}}

    monkeypatch.setattr(corrected, "gap_of", gaps)
    proposal = SimpleNamespace(laws=[SimpleNamespace(axis="X")], corrected="machine with the law")
    monkeypatch.setattr(validation, "find_unlisted_laws", lambda *_: [proposal])
    predictions = {which: {"after": {run.name: which for run in RUNS}} for which in LEVELS}
    monkeypatch.setattr(validation, "predictions_with_laws", lambda *_, **__: corrected.HeldOut(predictions[law], []))
    records = SimpleNamespace(runs=RUNS, motions=[], aligned=lambda *_: RUNS)
    setup = SimpleNamespace(quick=False, machine="m", nominal="m", thresholds=DEFAULT, folds=FOLDS, threads=1, progress=None)
    without = validation.Validated(tuple(RUNS), [], corrected.HeldOut(predictions["nominal"], []), {}, {}, "machine without")
    found = validation.with_laws(setup, records, without)
    assert (found.laws is proposal) is accepted
    assert found.corrected == ("machine with the law" if accepted else "machine without")


def test_a_law_is_judged_by_relative_changes_of_its_axes_only():
    """One random stiction that grows from 2.2 to 2.6 x noise does not outweigh a current explained down to noise; other axes do not count."""
    without = {("Z", "motor_position"): 2.2, ("Z", "current"): 2.0, ("Z", "position"): 0.9, ("A", "position"): 40.0}
    with_law = {("Z", "motor_position"): 2.6, ("Z", "current"): 0.7, ("Z", "position"): 0.8, ("A", "position"): 50.0}
    assert corrected.remaining_share(without, with_law, {"Z"}) == pytest.approx(2.6 / (2.2 * 2.0))
    assert corrected.remaining_share(without, without, {"Z"}) == 1.0
    assert corrected.remaining_share({("Z", "position"): 0.5}, {("Z", "position"): 0.6}, {"Z"}) == 1.0
    # a fifth of a large gap, and of a small one
    for level in (100.0, 10.0):
        of = {("Z", "position"): level}
        assert corrected.remaining_share(of, {("Z", "position"): 0.8 * level}, {"Z"}) == pytest.approx(0.64)
    assert corrected.loudest(without) == {"Z": 2.2, "A": 40.0}
