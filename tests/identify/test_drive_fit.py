"""The fit of a drive in closed loop, on a machine whose numbers are known."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign
from tests.builders.other_structures import write_slides
from twin.geometry.scurve import moves_in_turn
from twin.identify.drive_fit import fit_drives
from twin.identify.drive_residuals import position_is_informative
from twin.identify.parameters import with_drives
from twin.identify.recording import prepare_recording
from twin.identify.regressions import regress_blocks
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import home_inertia_at_motor, with_commissioned_inertia
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

RECORDED = ("setpoint", "position", "motor_position", "velocity_setpoint", "current")


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return load_machine(write_slides(tmp_path)).with_axes(["Z"])


def recording(machine: Machine) -> MeasuredRun:
    """Strokes of Z with measuring noise."""
    position = moves_in_turn(0.0, [0.02, -0.02], 0.1, 1.5, 60.0, 0.03, 1e-3)[1]
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    kept = {k: v for k, v in trace.signals.items() if k[1] in RECORDED}
    return MeasuredRun("made", Trace(trace.time, kept, trace.kinds), "velocity", 0.0)


def swings(machine: Machine) -> MeasuredRun:
    """Swings of B with measuring noise, beside the torque of its drive."""
    position = moves_in_turn(0.0, [0.5, -0.5], 2.0, 5.0, 100.0, 0.03, 1e-3)[1]
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    kept = {k: v for k, v in trace.signals.items() if k[1] in ("setpoint", "position", "motor_position", "torque")}
    return MeasuredRun("made", Trace(trace.time, kept, trace.kinds), "off", 0.0)


@pytest.mark.parametrize(("lag_s", "fed"), [(0.0, 0.0), (4e-3, 0.0), (1e-3, 0.8)])
def test_how_the_drive_controls_and_a_steady_load_are_found(machine: Machine, lag_s: float, fed: float) -> None:
    drive = {"axis.Z.loops.speed_reference_time_s": lag_s, "axis.Z.loops.drive_torque_feedforward": fed}
    there = machine.with_values({**drive, "axis.Z.constant_torque_nm": 0.06})
    run = recording(there)
    rows = {"Z": [np.ones(len(run.trace.time), bool)]}
    start = machine.with_values({"axis.Z.loops.speed_gain_nm_s_per_rad": 0.07, "axis.Z.coulomb_friction_nm": 0.03})
    found = fit_drives(start, [run], rows)[0].axis("Z")
    assert found.constant_torque_nm == pytest.approx(0.06, abs=2e-3)
    assert found.loops.speed_gain_nm_s_per_rad == pytest.approx(0.05, rel=0.05)
    assert found.loops.speed_reference_time_s == pytest.approx(lag_s, rel=0.1)
    assert found.loops.drive_torque_feedforward == pytest.approx(fed, rel=0.05)
    assert found.coulomb_friction_nm == pytest.approx(0.05, rel=0.03)


def test_assumed_gains_do_not_bias_the_identified_inertia(machine: Machine) -> None:
    """Without a recorded speed set point an axis moves as gains make it that nobody measured: the regression alone decides, which needs none."""
    run = recording(machine)
    signals = {k: v for k, v in run.trace.signals.items() if k[1] != "velocity_setpoint"}
    run = MeasuredRun("made", Trace(run.trace.time, signals, run.trace.kinds), "velocity", 0.0)
    tried = {"axis.Z.loops.speed_gain_nm_s_per_rad": 0.02, "axis.Z.loops.position_gain_per_s": 60.0, "axis.Z.loops.position_delay_s": 0.0}
    rotor = "axis.Z.rotor_and_screw_inertia_kg_m2"
    start = machine.with_values({**tried, rotor: 2.0 * machine.axis("Z").rotor_inertia_kg_m2})
    assert not position_is_informative(start, "Z", [run])
    assert not fit_drives(start, [run], {"Z": [np.ones(len(run.trace.time), bool)]})[1]


def test_a_tried_gain_of_two_p_controllers_does_not_bias_the_friction(tmp_path: Path) -> None:
    """Friction would make up for what the tried numbers lack: a PD drive with a filter had no viscous friction left, outside of its own interval."""
    path = write_slides(tmp_path)
    machine = load_machine(path).with_axes(["X"])
    position = moves_in_turn(0.0, [0.02, -0.02], 0.1, 1.5, 60.0, 0.03, 1e-3)[1]
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    kept = {k: v for k, v in trace.signals.items() if k[1] in ("setpoint", "motor_position", "voltage")}
    run, rows = MeasuredRun("made", Trace(trace.time, kept, trace.kinds), "velocity", 0.0), {"X": [np.ones(len(trace.time), bool)]}
    assert fit_drives(machine, [run], rows)[1]["X"]
    path.write_text(path.read_text().replace("position_gain_per_s = 160.0", "position_gain_per_s = 160.0  # tried"), encoding="utf-8")
    assert not fit_drives(load_machine(path).with_axes(["X"]), [run], rows)[1]


def test_the_inertia_in_the_table_is_the_whole_one(tmp_path: Path) -> None:
    machine = load_machine(write_slides(tmp_path)).with_axes(["B"])
    run = swings(machine)
    start = machine.with_values({"axis.B.rotor_and_gear_inertia_kg_m2": 2e-4})
    _, fits = fit_drives(start, [run], {"B": [np.ones(len(run.trace.time), bool)]})
    inertia = next(p for p in with_drives([], start, fits) if p.name == "inertia")
    assert inertia.value.value == pytest.approx(home_inertia_at_motor(machine)[0], rel=0.03)
    assert inertia.before == pytest.approx(home_inertia_at_motor(start)[0])


def test_without_gravity_in_the_file_the_balance_has_no_gravity_columns(tmp_path: Path) -> None:
    """The cosine of an angle that swings is nearly its acceleration: without need of it the inertia is known better."""
    machine = load_machine(write_slides(tmp_path)).with_axes(["B"])
    run = swings(machine)
    found = {}
    for gravity in (9.81, 0.0):
        there = with_commissioned_inertia(machine.with_values({"gravity_m_per_s2": gravity}))
        found[gravity] = regress_blocks(there, prepare_recording(there, campaign([run])).axis_runs).balance["B"]
    assert {"gravity_cos", "gravity_sin"} <= set(found[9.81].names)
    assert not {"gravity_cos", "gravity_sin"} & set(found[0.0].names)
    assert found[0.0].fit.deviations[0] < found[9.81].fit.deviations[0]
