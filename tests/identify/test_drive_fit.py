"""The fit of a drive in closed loop, on a machine whose numbers are known."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.other_structures import write_slides
from twin.geometry.scurve import moves_in_turn
from twin.identify.drive_fit import fit_drives
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
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


@pytest.mark.parametrize(("lag_s", "fed"), [(0.0, 0.0), (4e-3, 0.0), (1e-3, 0.8)])
def test_how_the_drive_controls_and_a_steady_load_are_found(machine: Machine, lag_s: float, fed: float) -> None:
    drive = {"axis.Z.loops.speed_reference_time_s": lag_s, "axis.Z.loops.drive_torque_feedforward": fed}
    there = machine.with_values({**drive, "axis.Z.constant_torque_nm": 0.06})
    run = recording(there)
    rows = {"Z": [np.ones(len(run.trace.time), bool)]}
    start = machine.with_values({"axis.Z.loops.speed_gain_nm_s_per_rad": 0.07, "axis.Z.coulomb_friction_nm": 0.03})
    found = fit_drives(start, [run], rows).machine.axis("Z")
    assert found.constant_torque_nm == pytest.approx(0.06, abs=2e-3)
    assert found.loops.speed_gain_nm_s_per_rad == pytest.approx(0.05, rel=0.05)
    assert found.loops.speed_reference_time_s == pytest.approx(lag_s, rel=0.1)
    assert found.loops.drive_torque_feedforward == pytest.approx(fed, rel=0.05)
    assert found.coulomb_friction_nm == pytest.approx(0.05, rel=0.03)
