"""A direct drive gives a force: its torque columns are written, read and compared in N, those of a screw in Nm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from twin.errors import InputError
from twin.machine import load_machine
from twin.recordings.trace import Trace, read_trace, write_trace
from twin.simulation.gap import gap_unit

LAB_AXIS = ROOT / "examples" / "lab_axis" / "axis.toml"


def trace_of(forces: frozenset[str]) -> Trace:
    time = np.arange(5) * 1e-3
    signals = {("X", "setpoint"): time, ("X", "torque"): 3.0 * time, ("X", "torque_friction"): time}
    return Trace(time, signals, {"X": "linear"}, forces)


def test_a_direct_drive_is_written_and_read_in_newtons(tmp_path: Path) -> None:
    machine = load_machine(LAB_AXIS)
    assert machine.forces == frozenset(machine.axis_names)
    assert load_machine().forces == frozenset()
    file = tmp_path / "direct.csv"
    write_trace(trace_of(frozenset("X")).decimated(2).select(["X"]), file)
    assert "X.torque [N]" in file.read_text()
    assert "X.torque_friction [N]" in file.read_text()
    again = read_trace(file)
    assert again.forces == {"X"}
    np.testing.assert_array_equal(again.get("X", "torque"), [0.0, 6e-3, 12e-3])


def test_a_screw_stays_in_newton_metres(tmp_path: Path) -> None:
    file = tmp_path / "screw.csv"
    write_trace(trace_of(frozenset()), file)
    assert "X.torque [Nm]" in file.read_text()
    assert read_trace(file).forces == frozenset()


def test_a_rotary_axis_has_no_force(tmp_path: Path) -> None:
    file = tmp_path / "rotary.csv"
    file.write_text("time [s],A.setpoint [deg],A.torque [N]\n0,0,0\n0.001,0,0\n")
    with pytest.raises(InputError, match=r"\[N\] is not a unit of a torque; use \[Nm\]"):
        read_trace(file, axes={"A": "rotary"})


def test_gaps_and_limits_have_the_unit_of_the_motor() -> None:
    direct, screw = load_machine(LAB_AXIS).axes[0], load_machine().axis("X")
    assert gap_unit(direct, "torque") == ("N", 1.0)
    assert gap_unit(screw, "torque") == ("Nm", 1.0)
    assert replace(direct, effort="torque").effort_unit == "N"
    assert replace(screw, effort="torque").effort_unit == "Nm"
