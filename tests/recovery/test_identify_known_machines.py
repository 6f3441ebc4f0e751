"""Identification of known machines: recorded, drawn 30 % off on a richer plant, fitted in closed loop, planned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
import tomllib
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from devtools.identification_score import LIMITS, Judged
from tests.builders.identify_campaigns import QUICK, campaign, recorded, usual_runs, with_signal
from tests.builders.script import carried_out, script
from tests.conftest import SHARED
from twin.cli import main
from twin.exam.programme import programme
from twin.identify.identify import identify
from twin.identify.plan import Plan, _acceleration_runs, _check_runs, _predict, plan_campaign, write_plan
from twin.identify.write import machine_comments, write_identified
from twin.machine.machine import Machine, load_machine
from twin.program import interpolate, read_program
from twin.recordings.campaign import read_campaign
from twin.recordings.trace import read_trace, write_trace
from twin.simulation.setpoint_limits import limit_warnings


@pytest.fixture(scope="module")
def study() -> ModuleType:
    """devtools/measure_identification.py: the same campaigns and judgement as the long study."""
    return script("devtools/measure_identification.py", "measure_identification")


def check(judged: list[Judged]) -> None:
    """Medians within the limits, and at least 90 % of the intervals hold (of 55; 98 % of the study's 1650)."""
    for group, limit in LIMITS.items():
        errors = [abs(j.error) for j in judged if j.group == group]
        # one campaign of five axes: twice the limit of the study's medians for the weights, of which few are well excited
        assert np.median(errors) < (2.0 if group == "torque feedforward" else 1.0) * limit, group
    assert np.mean([j.holds for j in judged]) >= 0.9, [f"{j.axis}.{j.name}" for j in judged if not j.holds]


FEW = ("constant_velocity", "acceleration_ff_off", "acceleration", "tilt_hold", "circle_xy")
"""Runs that determine all parameters; the last one is left out of the fit."""


def test_a_recorded_machine(study: ModuleType, mikron: Machine) -> None:
    folder = SHARED / "campaigns" / "healthy"
    if not folder.is_dir():
        pytest.skip("no recorded campaign: ../shared/campaigns/healthy is not beside this repository")
    whole = study.read_campaign(folder, mikron)
    few = replace(whole, runs=tuple(run for run in whole.runs if run.name in FEW))
    assert len(few.runs) == len(FEW)
    result = identify(few, mikron, refine=False, gaps=False)
    assert not result.findings
    assert all(result.tolerance_holds.values())
    check(study.judge(result, study.truth_machine(mikron, folder / "truth.toml"), products=("X", "Y", "C")))


@pytest.mark.slow
def test_a_machine_thirty_percent_off_with_a_richer_plant(study: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.exam.draw.programme", lambda machine, seed: [r for r in programme(machine, seed) if r.name in FEW])
    judged, _, findings = study.drawn(5001, tmp_path)
    assert not findings
    assert len(judged) == 55
    check(judged)


def test_the_regression_closes_the_gap_and_writes_what_it_found(mikron: Machine, tmp_path: Path) -> None:
    """X 4 % off in friction, 3 % in inertia: the identified machine is within noise of the measured one, and nothing is left to fit in closed loop."""
    machine = mikron.with_axes(["X"]).with_values({"parameter_tolerance": 0.05})
    axis = machine.axis("X")
    true = machine.with_axis("X", coulomb_friction_nm=1.04 * axis.coulomb_friction_nm, rotor_inertia_kg_m2=1.03 * axis.rotor_inertia_kg_m2)
    runs = [*usual_runs(true), recorded(true, "check", QUICK, "velocity+torque", 7)]
    result = identify(campaign(runs), machine, torque_constant_tolerance=0.0)
    assert "refined" not in result.gaps
    for signal, gap in result.gaps["regression"]["X"].items():
        assert gap["rms"] < 1.25 * gap["noise"], signal
    assert result.gaps["before"]["X"]["current"]["rms"] > 1.5 * result.gaps["regression"]["X"]["current"]["rms"]
    coulomb = result.parameter("X", "coulomb_friction")
    assert coulomb.value.value == pytest.approx(1.04 * axis.coulomb_friction_nm, rel=0.005)
    # the file that is written says so, and loads
    write_identified(result, tmp_path / "x.toml")
    again = load_machine(tmp_path / "x.toml")
    assert again.axis("X").coulomb_friction_nm == pytest.approx(coulomb.value.value, rel=1e-4)  # the product at the split torque constant
    for path, comment in machine_comments(result).items():
        assert comment.startswith(("identified", "bounded")), path
    text = (tmp_path / "x.toml").read_text()
    assert "[identified]" in text
    assert "identified  95 %" in text


def test_a_position_controller_without_its_output_is_fitted_in_closed_loop(mikron: Machine) -> None:
    """No speed set point is recorded: gain, delay and feedforward follow from the position, and only these are fitted."""
    machine = mikron.with_axes(["X"])
    true = machine.with_axis("X", position_gain_per_s=44.0, position_delay_s=2.4e-3, velocity_feedforward=0.96)
    runs = [with_signal(run, "X", "velocity_setpoint", None) for run in usual_runs(true)]
    result = identify(campaign(runs), machine, torque_constant_tolerance=0.0)
    assert result.chosen == "refined"
    loops = result.machine.axis("X").loops
    assert loops.position_gain_per_s == pytest.approx(44.0, rel=0.01)
    assert loops.position_delay_s == pytest.approx(2.4e-3, abs=5e-5)
    assert loops.velocity_feedforward == pytest.approx(0.96, abs=0.005)
    for name, value in (("position_gain_per_s", 44.0), ("velocity_feedforward", 0.96)):
        found = result.parameter("X", name).refined
        assert found is not None
        assert found.low < value < found.high
    assert result.parameter("X", "inertia").refined is None


def test_the_command_writes_machine_file_report_and_json(mikron: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs = usual_runs(mikron.with_axes(["X"]))
    lines = ['machine = "mikron_ucp710"']
    for run in runs:
        write_trace(run.trace, tmp_path / f"{run.name}.parquet")
        lines.append(f'[[run]]\nfile = "{run.name}.parquet"\nfeedforward = "{run.feedforward}"')
    (tmp_path / "campaign.toml").write_text("\n".join(lines), encoding="utf-8")
    out, told = tmp_path / "out" / "machine.toml", tmp_path / "result.json"
    assert main(["identify", str(tmp_path), "--out", str(out), "--json", str(told), "--no-refine"]) == 0
    printed = capsys.readouterr()
    assert "Coulomb friction" in printed.out
    assert "axes Y, Z, A and C: no run contains this axis" in printed.err
    result = {(p["axis"], p["name"]): p for p in json.loads(told.read_text(encoding="utf-8"))["parameters"]}
    coulomb = result["X", "coulomb_friction"]["product_at_file_torque_constant"]
    assert coulomb["low"] < mikron.axis("X").coulomb_friction_nm < coulomb["high"]
    assert load_machine(out).axis("X").coulomb_friction_nm == pytest.approx(result["X", "coulomb_friction"]["value"], rel=1e-4)
    assert (out.parent / "machine.html").stat().st_size > 10_000
    assert (out.parent / "machine_friction.png").is_file()


@pytest.mark.slow
def test_the_example_plans_records_and_identifies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    carried_out("examples/identify.py", "--axes", "X", "--out", tmp_path)
    row = next(line.split() for line in capsys.readouterr().out.splitlines() if "coulomb_friction" in line)
    before, identified, true = (float(v) for v in row[2:5])
    assert identified == pytest.approx(true, rel=0.005)
    assert abs(before / true - 1.0) > 0.02
    assert load_machine(tmp_path / "machine.toml").axis("X").coulomb_friction_nm == pytest.approx(identified, rel=1e-5)


def test_a_contradicted_tolerance_keeps_the_torque_constants(mikron: Machine) -> None:
    """With everything 20 % off in a file with a tolerance of 1 %, products are not split."""
    machine = mikron.with_axes(["X"])
    axis = machine.axis("X")
    true = machine.with_axis(
        "X", coulomb_friction_nm=1.2 * axis.coulomb_friction_nm, viscous_friction_nm_s_per_rad=0.8 * axis.viscous_friction_nm_s_per_rad
    )
    result = identify(campaign(usual_runs(true)), machine, refine=False, gaps=False)
    assert result.tolerance_holds == {"X": False}
    coulomb = result.parameter("X", "coulomb_friction")
    assert coulomb.value.value == pytest.approx(1.2 * axis.coulomb_friction_nm, rel=0.01)
    assert abs(coulomb.value.value - 1.2 * axis.coulomb_friction_nm) <= coulomb.value.half


@pytest.fixture(scope="module")
def predict_once() -> Callable[..., Any]:
    """The simulations behind a prediction, made once, because they do not depend on the wanted precision."""
    kept: list[Any] = []

    def predict(*arguments: Any) -> Any:
        if not kept:
            kept.append(_predict(*arguments))
        return kept[0]

    return predict


def test_a_planned_campaign_keeps_limits_and_reaches_its_predicted_intervals(
    mikron: Machine, predict_once: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Z alone: planned, recorded by the twin with other noise, identified; intervals are as predicted and contain the truth."""
    monkeypatch.setattr("twin.identify.plan._predict", predict_once)
    machine = mikron.with_axes(["Z"])
    plan = plan_campaign(machine, precision=0.02)
    for run in plan.runs:
        assert not limit_warnings(run.setpoints, machine)
    known = {(p.axis, p.name): p for p in plan.predicted}
    assert {"inertia", "coulomb_friction", "viscous_friction", "gravity_torque", "position_delay_s"} <= {name for _, name in known}
    assert max(p.half for p in plan.predicted) < 0.02
    runs = [recorded(machine, r.name, r.setpoints.position[:, 0], r.feedforward, 900 + i) for i, r in enumerate(plan.runs)]
    result = identify(campaign(runs), machine, refine=False, gaps=False)
    assert result.held_out == ("plan_check",)
    assert plan.runs[0].repeats == 1  # what was predicted is one round
    for (axis, name), promised in known.items():
        achieved = result.parameter(axis, name).estimate.half / abs(promised.value)
        assert 0.4 < achieved / promised.half < 2.5, name
    found = [(result.parameter(axis, name).estimate, p.value) for (axis, name), p in known.items()]
    held = [estimate.low <= value <= estimate.high for estimate, value in found]
    assert np.mean(held) >= 0.8


def test_more_precision_takes_more_rounds(mikron: Machine, predict_once: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twin.identify.plan._predict", predict_once)
    machine = mikron.with_axes(["Z"])
    coarse, fine = (plan_campaign(machine, precision=p, longest_s=3600.0) for p in (0.02, 0.002))
    assert fine.runs[0].repeats > coarse.runs[0].repeats
    assert all(f.half <= c.half for f, c in zip(fine.predicted, coarse.predicted))
    assert all(p.half >= p.law for p in fine.predicted)


def test_a_plan_is_written_as_part_programs_and_a_campaign_to_fill(mikron: Machine, tmp_path: Path) -> None:
    machine = mikron.with_axes(["X", "C"])
    plan = Plan((*_acceleration_runs(machine), *_check_runs(machine)), ())
    write_plan(plan, machine, tmp_path)
    for run in plan.runs:
        program = read_program(tmp_path / f"{run.name}.mpf", mikron)
        ends = {name: target for block, _ in run.blocks for name, target in block.items()}
        trace = interpolate(program, mikron)
        for name, target in ends.items():
            assert trace.get(name, "setpoint")[-1] == pytest.approx(target, abs=1e-6)
    waiting = tomllib.loads((tmp_path / "recordings" / "campaign.toml").read_text(encoding="utf-8"))
    assert [r["feedforward"] for r in waiting["run"]] == [r.feedforward for r in plan.runs]
    for run in plan.runs:  # a control that follows perfectly
        trace = read_trace(tmp_path / f"{run.name}.parquet")
        write_trace(trace, tmp_path / "recordings" / f"{run.name}.parquet")
    assert len(read_campaign(tmp_path / "recordings", machine).runs) == len(plan.runs)
