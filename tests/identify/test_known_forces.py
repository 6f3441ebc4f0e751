"""A known outside load is part of the balance of torques; it turns lumps into kilograms; an injected command is told from a load."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import PERIOD, SHORT_QUICK, campaign
from twin.identify.from_recording import machine_from_recording
from twin.identify.identify import known_load_findings
from twin.identify.recording import prepare_recording
from twin.identify.regressions import regress_blocks
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace, write_trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

ROOT = Path(__file__).resolve().parents[2]


def pushed(machine: Machine, force_n: float, period_s: float = 0.13) -> MeasuredRun:
    """Strokes of X under a force that comes and goes, recorded beside the force."""
    time = np.arange(len(SHORT_QUICK)) * PERIOD
    load = np.where((time % period_s) < 0.5 * period_s, force_n, 0.0)
    outside = np.zeros((len(time), 1, 2))
    outside[:, 0, 0] = load
    trace = simulate(machine, Setpoints(SHORT_QUICK[:, None], PERIOD, external_force=outside), sample_period=PERIOD, noise_seed=0).trace
    kept = {
        k: v
        for k, v in trace.signals.items()
        if k[1] in ("setpoint", "position", "motor_position", "velocity_setpoint", "current", "voltage")
    }
    return MeasuredRun("pushed", Trace(trace.time, {**kept, ("X", "disturbance_force"): load[: len(trace.time)]}, trace.kinds), "off", 0.0)


def test_identification_accounts_for_a_known_load(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"]).with_feedforward("off")
    run = pushed(machine, 600.0)
    axis = machine.axis("X")

    def inertia_and_friction(one: MeasuredRun) -> np.ndarray:
        found = regress_blocks(machine, prepare_recording(machine, campaign([one])).axis_runs).balance["X"].fit.values[:2]
        return found / [axis.commissioned_inertia, axis.coulomb_friction * axis.ratio]

    with_load = inertia_and_friction(run)
    assert with_load == pytest.approx([1.0, 1.0], abs=0.05)
    signals = {k: v for k, v in run.trace.signals.items() if k[1] != "disturbance_force"}
    without = inertia_and_friction(replace(run, trace=replace(run.trace, signals=signals)))
    assert np.abs(without - 1.0).max() > 2.0 * np.abs(with_load - 1.0).max()


def test_a_load_without_reaction_of_the_drive_is_reported_as_part_of_its_command(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"]).with_feedforward("off")
    run = pushed(machine, 600.0)
    axis = machine.axis("X")
    held = run.trace.get("X", "disturbance_force") * axis.ratio / axis.motor.torque_constant_nm_per_a
    signals = {**run.trace.signals, ("X", "current"): run.trace.get("X", "current") + held}
    injected = replace(run, trace=replace(run.trace, signals=signals))
    said = [
        known_load_findings(machine, regress_blocks(machine, prepare_recording(machine, campaign([r])).axis_runs)) for r in (run, injected)
    ]
    assert said[0] == []
    assert [f.axis for f in said[1]] == ["X"]
    assert "injected_command" in said[1][0].text


def test_a_known_load_turns_lumps_into_kilograms(tmp_path: Path) -> None:
    run = pushed(load_machine(ROOT / "examples" / "lab_axis" / "axis.toml"), 20.0)
    write_trace(run.trace, tmp_path / "recorded" / "pushed.parquet")
    (tmp_path / "recorded" / "campaign.toml").write_text('[[run]]\nfile = "pushed.parquet"\nfeedforward = "off"\n', encoding="utf-8")
    machine_from_recording(tmp_path / "recorded", tmp_path / "machine.toml", identified=False)
    axis = load_machine(tmp_path / "machine.toml").axis("X")
    assert axis.motor.torque_constant_nm_per_a == pytest.approx(18.0, rel=0.05)
    assert (axis.moving_mass_kg or 0.0) + axis.reflected_inertia == pytest.approx(12.0, rel=0.05)  # both encoders: motor and load
    assert axis.coulomb_friction == pytest.approx(6.0, rel=0.1)
    assert axis.loops.position_gain_per_s == pytest.approx(25.0, rel=1e-3)
