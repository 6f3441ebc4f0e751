"""The machine file of an identification: which stage gives which value, the noise of sensors, and its comments."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign, usual_runs
from tests.builders.other_structures import write_slides
from twin.identify.held_out import Choice, Table, _assembled, choose_stages, divide_runs
from twin.identify.identify import identify
from twin.identify.result import Outcome, agreeing_axes
from twin.identify.write import machine_comments
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.recorded_noise import measurement_values
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


@pytest.mark.parametrize("stage_of", [{"X": "control", "Y": "regression"}, {"X": "regression", "Y": "control"}, {"X": "control"}])
def test_what_belongs_to_no_axis_comes_from_the_first_stage(mikron: Machine, stage_of: dict[str, str]) -> None:
    before = mikron.with_axes(["X", "Y"])
    stages = {name: before.with_values({"measurement.current_noise_a": noise}) for name, noise in (("regression", 0.07), ("control", 0.05))}
    assert _assembled(before, stages, stage_of).document["measurement"]["current_noise_a"] == 0.07


def test_the_noise_of_an_axis_that_is_commanded_a_torque_and_records_its_current_too(tmp_path: Path) -> None:
    machine = load_machine(write_slides(tmp_path))
    axis = next(a for a in machine.axes if a.effort == "torque")
    rest = np.tile([float(np.clip(0.0, *a.travel)) for a in machine.axes], (2000, 1))
    trace = simulate(machine, Setpoints(rest, 1e-3), sample_period=1e-3, noise_seed=1).trace
    signals = {**trace.signals, (axis.name, "current"): np.random.default_rng(0).standard_normal(len(trace.time))}
    run = MeasuredRun("made", Trace(trace.time, signals, trace.kinds), "off", 0.0)
    assert measurement_values(machine, [run]).keys() == measurement_values(machine, [replace(run, trace=trace)]).keys()


def test_a_value_at_its_bound_that_was_not_taken_has_no_comment(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    result = identify(campaign(usual_runs(machine, short=True)), machine, refine=False, gaps=False)
    at_bound = replace(result, machine=machine, parameters=tuple(replace(p, at_bound=True) for p in result.parameters))
    assert machine_comments(at_bound)
    assert not machine_comments(replace(at_bound, stage_of={}))


def _judged(before: Machine, found: Machine, agreeing: set[str]) -> Choice:
    """The choice between a file and one stage of it whose gap is twice as large."""
    tables: dict[str, Table | str] = {
        name: {"X": {"position": {"rms": rms, "noise": 1e-7}}} for name, rms in (("before", 1e-6), ("regression", 2e-6))
    }
    division = divide_runs(before, list(usual_runs(before, short=True)))
    return choose_stages(before, {"regression": found}, tables, division, agreeing)


def test_a_file_that_agrees_with_the_recording_is_no_failure(mikron: Machine) -> None:
    before = mikron.with_axes(["X"])
    found = before.with_values({"axis.X.loops.position_gain_per_s": 50.1})
    contradicted = _judged(before, found, set())
    assert contradicted.refused
    assert "2 times as large" in contradicted.refused
    agreed = _judged(before, found, {"X"})
    assert not agreed.refused
    assert not agreed.findings
    assert agreed.machine.axis("X").number("position_gain_per_s") == 50.0
    assert [note.axis for note in agreed.notes] == ["X"]


def test_what_became_of_a_value_that_is_not_written(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"])
    result = replace(identify(campaign(usual_runs(machine, short=True)), machine, refine=False, gaps=False), stage_of={})
    assert {result.outcome(p) for p in result.parameters} == {Outcome.AGREES}
    gain = result.parameter("X", "position_gain_per_s")
    off = replace(gain, estimate=gain.estimate.times(1.1), value=gain.value.times(1.1))
    wrong = replace(result, parameters=(off, *(p for p in result.parameters if p is not gain)))
    assert wrong.outcome(off) is Outcome.REFUSED
    assert agreeing_axes(wrong.parameters) == set()
    assert replace(wrong, stage_of=None).outcome(off) is Outcome.WRITTEN
