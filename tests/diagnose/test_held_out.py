"""Gaps on held-out runs, including folds whose machine cannot be simulated."""

from dataclasses import dataclass
import math
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of
from twin.diagnose import corrected, judgement, validation
from twin.diagnose.tolerance import nuisances_of
from twin.diagnose.tuning import tuning_from
from twin.effects import with_effects
from twin.errors import InputError, SimulationError
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import SignalGap
from twin.simulation.gap_level import levels

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
        return [SimpleNamespace(trace=f"{job.machine} on {job.run.name}") for job in jobs]

    monkeypatch.setattr(corrected, "fitted_without", lambda machine, found, fold: f"without {fold}" if fold else "fitted to all")
    monkeypatch.setattr(corrected, "predict_each", predict_each)
    monkeypatch.setattr(corrected, "aligned", lambda runs, *_: runs)
    return unstable


def after(folds=FOLDS):
    setup = SimpleNamespace(machine="nominal", folds=folds, quick=False, threads=1)
    held_out = corrected.held_out_predictions(setup, RUNS, [None] * len(RUNS), [])
    assert held_out.predictions["before"]["second"].trace == "nominal on second"
    return [held_out.traces[run.name].removesuffix(f" on {run.name}") for run in RUNS], held_out.names


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
    """At rest, the axis stuck or hunted at 9 x noise; that is no evidence."""
    level = {"before": 1.1, "after": after}
    monkeypatch.setattr(
        corrected, "gap_of", lambda machine, run, which: {"X": {"position": SignalGap(9.0, 9.0, 1.0, 1.0, "um", level[which])}}
    )
    held_out = corrected.HeldOut("nominal", RUNS, {which: {run.name: which for run in RUNS} for which in level}, [])
    of = [levels(held_out.gaps[which]) for which in level]
    assert judgement.is_worse(["X"], *of) is worse
    assert not judgement.is_worse(["Y"], *of)


def test_the_judgement_does_not_depend_on_the_number_of_axes():
    """A group of axes that all change alike is judged as one of them."""
    for now in (1.2, 1.39, 1.41, 3.0):
        alone = judgement.is_worse(["0"], {"0": 1.1}, {"0": now})
        for count in (2, 5, 40):
            axes = [str(i) for i in range(count)]
            assert judgement.is_worse(axes, dict.fromkeys(axes, 1.1), dict.fromkeys(axes, now)) is alone


def test_axes_that_a_correction_makes_worse_keep_the_machine_file(mikron):
    group = group_of([np.full(50, 3.0), np.full(50, -2.0)])
    nuisances = nuisances_of(mikron, ("X",))
    found = found_of(group, tuning_from(nuisances, columns_of(np.eye(group.size)[:, : len(nuisances)]), 0.01))
    nominal = with_effects(mikron, []).document
    stays = corrected.uncorrected(found)
    assert stays.unknown
    for machine_of in (lambda f: corrected.corrected_machine(mikron, [f]), lambda f: corrected.fitted_without(mikron, [f], [0])):
        assert machine_of(found).document != nominal
        assert machine_of(stays).document == nominal


@dataclass(frozen=True)
class _Law:
    axis: str = "X"
    probability: float = 0.98
    only_fold: int | None = None


@dataclass(frozen=True)
class _Laws:
    laws: tuple[_Law, ...]
    corrected: str
    instead: frozenset[str] = frozenset()

    @property
    def states(self):
        return self.corrected


def with_proposed_laws(monkeypatch, levels, laws, instead=frozenset()):
    """`with_laws` for axis X: levels of its signals over noise without a law ("nominal") and with each of `laws`, which are there `instead` of effects
    on these axes; and the laws it asked for.
    """

    def gaps(machine, run, predicted):
        return {"X": {signal: SignalGap(level, level, 1.0, 1.0, "um", level) for signal, level in levels[predicted].items()}}

    asked = []

    def proposed(*_):
        for law in laws:
            asked.append(law)
            yield _Laws((_Law(),), law, instead)

    predictions = {which: {when: {run.name: which for run in RUNS} for when in ("before", "after")} for which in levels}
    monkeypatch.setattr(corrected, "gap_of", gaps)
    monkeypatch.setattr(validation, "find_unlisted_laws", proposed)
    monkeypatch.setattr(corrected.HeldOut, "traces", {})
    monkeypatch.setattr(
        validation, "held_out_predictions", lambda setup, runs, motions, law, *_: corrected.HeldOut("m", RUNS, predictions[law], [])
    )
    setup = SimpleNamespace(quick=False, machine="m", folds=FOLDS, threads=1, progress=None)
    before = {"X": math.sqrt(sum(level**2 for level in levels["nominal"].values()) / len(levels["nominal"]))}
    without = validation.Validated([], corrected.HeldOut("m", RUNS, predictions["nominal"], []), before, before, "nominal")
    return validation.with_laws(setup, RUNS, [], without).corrected, asked


@pytest.mark.parametrize(
    ("law", "signals", "kept"),
    [
        ("good law", {"position": 1.1, "current": 1.2}, "good law"),
        ("law that opens another gap", {"position": 1.1, "current": 4.4}, "nominal"),
    ],
)
def test_a_law_that_makes_one_signal_worse_is_refused(monkeypatch, law, signals, kept):
    levels = {"nominal": {"position": 30.0, "current": 1.0}, law: signals}
    assert with_proposed_laws(monkeypatch, levels, [law]) == (kept, [law])


@pytest.mark.parametrize(("left", "kept"), [(1.1, "filter"), (1.9, "nominal")])
def test_a_filter_in_place_of_effects_leaves_what_they_left(monkeypatch, left, kept):
    """The effects explained the axis, so the filter closes no gap; it must not open one beyond chance."""
    levels = {"nominal": {"position": 1.0, "current": 1.0}, "filter": {"position": left, "current": 1.0}}
    assert with_proposed_laws(monkeypatch, levels, ["filter"], frozenset({"X"})) == (kept, ["filter"])


@pytest.mark.parametrize(("left", "asked"), [(1.9, ["law"]), (4.0, ["law", "other weights"])])
def test_laws_are_searched_again_with_other_weights_only_if_a_considerable_gap_remains(monkeypatch, left, asked):
    levels = {"nominal": {"position": 6.0, "current": 2.0}, "law": {"position": left, "current": 2.0}}
    levels["other weights"] = levels["nominal"]
    assert with_proposed_laws(monkeypatch, levels, ["law", "other weights"]) == ("law", asked)


def test_a_law_is_judged_by_relative_changes_of_its_axes_only():
    """One random stiction that grows from 2.2 to 2.6 x noise does not outweigh a current explained down to noise; other axes do not count."""
    without = {("Z", "motor_position"): 2.2, ("Z", "current"): 2.0, ("Z", "position"): 0.9, ("A", "position"): 40.0}
    with_law = {("Z", "motor_position"): 2.6, ("Z", "current"): 0.7, ("Z", "position"): 0.8, ("A", "position"): 50.0}
    assert judgement.remaining_share(without, with_law, {"Z"}) == pytest.approx(2.6 / (2.2 * 2.0))
    assert judgement.remaining_share(without, without, {"Z"}) == 1.0
    assert judgement.remaining_share({("Z", "position"): 0.5}, {("Z", "position"): 0.6}, {"Z"}) == 1.0
    # a fifth of a large gap, and of a small one
    for level in (100.0, 10.0):
        of = {("Z", "position"): level}
        assert judgement.remaining_share(of, {("Z", "position"): 0.8 * level}, {"Z"}) == pytest.approx(0.64)
    assert judgement.loudest(without) == {"Z": 2.2, "A": 40.0}
