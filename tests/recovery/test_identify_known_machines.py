"""Known machines are found again: recorded, drawn with a richer plant and 30 % off, re-simulated, planned."""

from __future__ import annotations

from dataclasses import replace
import importlib.util
from pathlib import Path
import sys
from types import ModuleType

import numpy as np
import pytest

from tests.conftest import ROOT, SHARED
from tests.identify_campaigns import campaign, usual_runs
from twin.identify import identify_campaign, plan_campaign, write_identified, write_plan
from twin.identify.judge import LIMITS, Judged
from twin.machine import Machine, load_machine


@pytest.fixture(scope="module")
def study() -> ModuleType:
    """scripts/measure_identification.py: the same campaigns and judgement as the long study."""
    spec = importlib.util.spec_from_file_location("measure_identification", ROOT / "scripts" / "measure_identification.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def check(judged: list[Judged]) -> None:
    """Medians within the limits, and at least 90 % of the intervals hold (of 55; 98 % of the study's 1650)."""
    for group, limit in LIMITS.items():
        errors = [abs(j.error) for j in judged if j.group == group]
        # one campaign of five axes: twice the limit of the study's medians for the weights, of which few are well excited
        assert np.median(errors) < (2.0 if group == "torque feedforward" else 1.0) * limit, group
    assert np.mean([j.holds for j in judged]) >= 0.9, [f"{j.axis}.{j.name}" for j in judged if not j.holds]


def test_a_recorded_machine(study: ModuleType, mikron: Machine) -> None:
    folder = SHARED / "campaigns" / "healthy"
    if not folder.is_dir():
        pytest.skip("no recorded campaign: ../shared/campaigns/healthy is not beside this repository")
    result = identify_campaign(mikron, study.read_campaign(folder, mikron), refine=False, gaps=False)
    assert not result.findings
    assert all(result.tolerance_holds.values())
    check(study.judge(result, study.truth_machine(mikron, folder / "truth.toml"), products=("X", "Y", "C")))
    assert result.seconds["regression"] < 60.0


def test_a_machine_thirty_percent_off_with_a_richer_plant(study: ModuleType, tmp_path: Path) -> None:
    judged, _, findings = study.drawn(5001, tmp_path, refine=False)
    assert not findings
    check(judged)


def test_refinement_closes_the_gap_and_keeps_what_is_known(mikron: Machine, tmp_path: Path) -> None:
    """X 4 % off in friction, 3 % in inertia: the re-simulated machine is within noise of the measured one."""
    machine = replace(mikron.with_axes(["X"]), parameter_tolerance=0.05)
    axis = machine.axis("X")
    true = machine.with_axis(
        "X", coulomb_friction_nm=1.04 * axis.coulomb_friction_nm, rotor_inertia_kg_m2=1.03 * axis.rotor_inertia_kg_m2
    )
    runs = [r for seed in (0, 10) for r in usual_runs(true, seed)]
    runs = [replace(r, name=f"{r.name}_{i}") for i, r in enumerate(runs)]
    result = identify_campaign(machine, campaign(runs), torque_constant_tolerance=0.0)
    for stage in ("regression", "refined"):
        for signal, gap in result.gaps[stage]["X"].items():
            assert gap["rms"] < 1.25 * gap["noise"], (stage, signal)
    assert result.gaps["before"]["X"]["current"]["rms"] > 1.5 * result.gaps["refined"]["X"]["current"]["rms"]
    coulomb = result.parameter("X", "coulomb_friction")
    assert coulomb.refined is not None
    assert coulomb.refined.value == pytest.approx(1.04 * axis.coulomb_friction_nm, rel=0.005)
    # the file that is written says so, and loads
    write_identified(result, tmp_path / "x.toml")
    again = load_machine(tmp_path / "x.toml")
    assert again.axis("X").coulomb_friction_nm == pytest.approx(coulomb.refined.value if result.chosen == "refined" else coulomb.value.value, rel=1e-6)
    text = (tmp_path / "x.toml").read_text()
    assert "[identified]" in text
    assert "identified  95 %" in text


def test_a_contradicted_tolerance_keeps_the_torque_constants(mikron: Machine) -> None:
    """Everything 20 % off in a file that promises 1 %: nothing is split, the product is the value."""
    machine = mikron.with_axes(["X"])
    axis = machine.axis("X")
    true = machine.with_axis("X", coulomb_friction_nm=1.2 * axis.coulomb_friction_nm, viscous_friction_nm_s_per_rad=0.8 * axis.viscous_friction_nm_s_per_rad)
    result = identify_campaign(machine, campaign(usual_runs(true)), refine=False, gaps=False)
    assert result.tolerance_holds == {"X": False}
    coulomb = result.parameter("X", "coulomb_friction")
    assert coulomb.value.value == pytest.approx(1.2 * axis.coulomb_friction_nm, rel=0.01)
    assert coulomb.value.holds(1.2 * axis.coulomb_friction_nm)


def test_a_planned_campaign_keeps_travel_and_says_what_it_will_tell(mikron: Machine, tmp_path: Path) -> None:
    machine = mikron.with_axes(["X", "Z"])
    plan = plan_campaign(machine, precision=0.01)
    known = {(p.axis, p.name): p.half for p in plan.predicted}
    assert known["X", "inertia"] < 0.01
    assert known["Z", "gravity_torque"] < 0.01
    files = write_plan(plan, machine, tmp_path)
    program = next(f for f in files if f.suffix == ".mpf").read_text()
    assert "M30" in program
    assert "G1 X=" in program
    from twin.setpoints import limit_warnings

    for run in plan.runs:
        assert not limit_warnings(run.setpoints, machine)
