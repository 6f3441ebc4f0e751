"""The programmed path against the path that the interpolator commands: the same tip and tool axis, move by move."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from twin.geometry.kinematics import kinematics_of
from twin.geometry.tool_path import ToolPath, axes_of_trace, contour_error
from twin.machine.machine import Machine
from twin.program import interpolate, read_program
from twin.surface.levels import axis_path, programmed_path
from twin.surface.steps import steps_between

REACH = 0.04
HEAD = "G17 G71 G90 G94 G64\nCYCLE832(0.01,3)\n"
TURN = "G0 X0 Y0 Z0 A0 C0\nG1 A=-40 F1000\nM30\n"
FACED = "TRAORI\nORIWKS\nG0 X40 Y0 Z250 A3=0.3 B3=-0.3 C3=0.9\n"
MOVES = {
    "A alone": TURN,
    "A and C with X": "G0 X0 Y0 Z0 A0 C0\nG1 X50 A=-20 C60 F1000\nM30\n",
    "arc with a turning axis": FACED + "G2 X0 Y40 I-40 J0 A3=0.5 B3=0 C3=0.8 F1000\nM30\n",
    "line on the great circle": FACED + "G1 X0 Y40 A3=0.5 B3=0 C3=0.8 F1000\nM30\n",
    "line with A and C linear": "TRAORI\nORIMKS\nG0 X40 Y0 Z250 A=-20 C0\nG1 X0 Y40 A=-20 C70 F1000\nM30\n",
}


def paths(text: str, machine: Machine, folder: Path) -> tuple[ToolPath, ToolPath]:
    """Programmed and commanded path of a program."""
    (folder / "moves.mpf").write_text(HEAD + text, encoding="utf-8")
    program = read_program(folder / "moves.mpf", machine)
    setpoints = interpolate(program, machine)
    return programmed_path(program), axis_path(kinematics_of(machine), axes_of_trace(setpoints, "setpoint", machine), setpoints.time, REACH)


@pytest.mark.parametrize("moves", MOVES)
def test_programmed_and_commanded_tool_axes_agree(mikron: Machine, tmp_path: Path, moves: str) -> None:
    """One move without corners: the tip within the tolerance, the axis within the error of the great circle's parts (1e-4 rad)."""
    programmed, commanded = paths(MOVES[moves], mikron, tmp_path)
    # as it cuts: between two poses the axis turns on the great circle
    steps = steps_between(programmed.tip, programmed.axis, REACH)
    tip, axis = np.vstack([steps.tip, programmed.tip[-1]]), np.vstack([steps.axis, programmed.axis[-1]])
    found = contour_error(commanded, ToolPath(np.arange(len(tip)), tip, axis), None)
    assert found.error.max() < 10e-6
    assert found.orientation.max() < 2e-4
    np.testing.assert_allclose(programmed.axis[[0, -1]], commanded.axis[[0, -1]], atol=1e-9)


def test_a_turn_of_the_tool_axis_gives_tip_and_axis_at_each_part(mikron: Machine, tmp_path: Path) -> None:
    """A from 0 to -40 degrees in 400 parts: the axis is (0, sin A, cos A) at each of them, and the feed is that of A."""
    path, _ = paths(TURN, mikron, tmp_path)
    angle = np.radians(-np.linspace(0.0, 40.0, len(path)))
    np.testing.assert_allclose(path.axis, np.column_stack([0.0 * angle, np.sin(angle), np.cos(angle)]), atol=1e-12)
    assert path.time[-1] == pytest.approx(40.0 / (1000.0 / 60.0))
    arm = np.linalg.norm(np.diff(path.tip, axis=0), axis=1)[0] / math.radians(40.0 / (len(path) - 1))
    assert path.feed[len(path) // 2] == pytest.approx(arm * math.radians(1000.0 / 60.0), rel=1e-5)
