"""Machines of other structures: transformation compared with MuJoCo's poses, inverse with forward, letters of programs."""

from dataclasses import replace
import importlib
from pathlib import Path
import re
import sys

import mujoco
import numpy as np
import pytest

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.machine.machine import Machine
from twin.program import interpolate, read_program
from twin.program.axis_path import axis_jet, frames_of
from twin.program.orientation import choose_angles

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "kinematics"
sys.path.insert(0, str(EXAMPLE))
example = importlib.import_module("run")
sys.path.remove(str(EXAMPLE))
FIVE = ["table_table", "head_table", "head_head"]


def random_axes(kinematics: Kinematics, count: int, seed: int = 3) -> np.ndarray:
    """Axes (count, 5) within travel; a missing axis is constant."""
    low, high = np.clip(kinematics.travel, -3.0, 3.0).T
    return np.random.default_rng(seed).uniform(low, high, (count, 5))


@pytest.fixture(params=list(example.STRUCTURES))
def machine(request, mikron: Machine) -> Machine:
    return example.machine_of(request.param, mikron)


def test_forward_kinematics_are_those_of_the_model(machine: Machine) -> None:
    kinematics, model = kinematics_of(machine), mujoco.MjModel.from_xml_path(str(machine.model_path))
    axes = random_axes(kinematics, 100)
    tips, directions = kinematics.forward(axes)
    data = mujoco.MjData(model)
    for q, tip, direction in zip(axes, tips, directions):
        for name, value in zip(kinematics.names, q):
            if name:
                data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        part, tool = data.site("workpiece"), data.site("tool")
        turned = part.xmat.reshape(3, 3).T
        assert np.abs(turned @ (tool.xpos - part.xpos) - tip).max() < 1e-12
        assert np.abs(turned @ tool.xmat.reshape(3, 3)[:, 2] - direction).max() < 1e-12


@pytest.mark.parametrize("name", FIVE)
def test_the_inverse_leads_back_to_the_pose(name: str, mikron: Machine) -> None:
    kinematics = kinematics_of(example.machine_of(name, mikron))
    for q in random_axes(kinematics, 200):
        tip, direction = kinematics.forward(q)
        angles = choose_angles(kinematics, direction, q[3:]).angles
        back = np.column_stack([kinematics.linear_axes(tip, angles), angles])
        assert np.abs(back - q).max() < 1e-9  # from the pose itself the nearer solution is correct
        pairs, reachable = kinematics.angles(direction)
        assert reachable.all()
        for pair in pairs[:, 0]:
            other = np.concatenate([kinematics.linear_axes(tip, pair[None])[0], pair])
            again = kinematics.forward(other)
            assert np.abs(again[0] - tip).max() < 1e-9
            assert np.abs(again[1] - direction).max() < 1e-9


def test_compiled_and_plain_inverse_agree(machine: Machine) -> None:
    kinematics = kinematics_of(machine)
    frames = frames_of(kinematics, True)
    work, out = np.empty((5, 4, 4)), np.empty((4, 5))
    for q in random_axes(kinematics, 20):
        tip = kinematics.forward(q)[0][0]
        jet = np.zeros((4, 5))
        jet[0] = [*tip, *q[3:]]
        axis_jet(frames, jet, work, out)
        assert np.abs(out[0] - q).max() < 1e-12


@pytest.mark.parametrize("name", FIVE)
def test_derivatives_of_the_compiled_inverse(name: str, mikron: Machine) -> None:
    kinematics = kinematics_of(example.machine_of(name, mikron))
    frames, rng = frames_of(kinematics, True), np.random.default_rng(5)
    work, at, plus, minus = np.empty((5, 4, 4)), np.empty((4, 5)), np.empty((4, 5)), np.empty((4, 5))
    jet, step = rng.uniform(-0.5, 0.5, (4, 5)), 1e-4

    def moved(h: float) -> np.ndarray:
        out = np.zeros((4, 5))
        out[0] = jet[0] + h * jet[1] + h**2 / 2 * jet[2] + h**3 / 6 * jet[3]
        out[1] = jet[1] + h * jet[2] + h**2 / 2 * jet[3]
        out[2] = jet[2] + h * jet[3]
        out[3] = jet[3]
        return out

    axis_jet(frames, jet, work, at)
    axis_jet(frames, moved(step), work, plus)
    axis_jet(frames, moved(-step), work, minus)
    for order in (1, 2, 3):
        assert np.abs((plus[order - 1] - minus[order - 1]) / (2 * step) - at[order]).max() < 1e-5


def test_letters_of_programs(tmp_path: Path, mikron: Machine) -> None:
    path = tmp_path / "part.mpf"
    path.write_text("G1 X1 B=10 C20 F100\nB0\n")
    target = read_program(path, example.machine_of("table_table", mikron)).moves.target
    assert np.degrees(target[:, 3:]) == pytest.approx(np.array([[10, 20], [0, 20]]))
    path.write_text("G1 X1 A10 F100\n")
    with pytest.raises(InputError, match="axis A moves, and this machine has X Y Z B C"):
        read_program(path, example.machine_of("table_table", mikron))
    iso = tmp_path / "part.nc"
    iso.write_text("G21 G1 X1. B10. C20. F100\nX2.\nG65 P9 B3.\nM30\nO9\nG1 X#2\nM99\n")
    target = read_program(iso, example.machine_of("table_table", mikron)).moves.target
    assert np.degrees(target[0, 3:]) == pytest.approx([10, 20])
    assert target[-1, 0] == pytest.approx(3e-3)  # B of a macro is a value, not an axis
    path.write_text("TRAORI\nG1 Z300 A3=0 B3=0 C3=1 F100\nX20 A=30 C=40\n")
    target = read_program(path, example.machine_of("head_head", mikron)).moves.target
    assert np.degrees(target[-1, 3:]) == pytest.approx([30, 40])


def test_a_three_axis_mill_runs_what_leaves_its_tool_upright(tmp_path: Path, mikron: Machine) -> None:
    machine = example.machine_of("three_axis", mikron)
    path = tmp_path / "part.apt"
    path.write_text("FEDRAT/MMPM,100\nGOTO/1,2,203,0,0,1\nGOTO/2,2,203,0,0,1\n")
    assert len(read_program(path, machine)) == 2
    path.write_text("FEDRAT/MMPM,100\nGOTO/1,2,203,0,0,1\nGOTO/2,2,203,0.1,0,1\n")
    with pytest.raises(InputError, match="cannot be had with the rotary axes of this machine"):
        read_program(path, machine)
    path = tmp_path / "part.mpf"
    path.write_text("G1 X1 A5 F100\n")
    with pytest.raises(InputError, match="this machine has no axis A"):
        read_program(path, machine)


def test_a_three_axis_mill_without_sites_runs_programs_and_has_no_tool_to_turn(tmp_path: Path, mikron: Machine) -> None:
    """X Y Z are the positions of the slides; functions that need a tool or a part frame name the missing site."""
    given = example.machine_of("three_axis", mikron)
    text = given.model_path.read_text()
    bare = re.sub(r"<site [^>]*/>", "", text)
    assert bare != text
    (tmp_path / "bare.xml").write_text(bare)
    machine = replace(given, model_path=tmp_path / "bare.xml")
    path = tmp_path / "part.mpf"
    path.write_text("G17 G54 G90\nG0 X10 Y5 Z-4\nG1 X20 F1000\nG3 X10 Y15 CR=10\n")
    trace = interpolate(read_program(path, machine), machine)
    assert [trace.get(axis, "setpoint")[-1] for axis in machine.axis_names] == pytest.approx([10e-3, 15e-3, -4e-3], abs=1e-9)
    with pytest.raises(InputError, match="no site 'tool'"):
        kinematics_of(machine)


def test_a_slide_on_a_rotary_axis_is_refused(tmp_path: Path, mikron: Machine) -> None:
    machine = example.machine_of("head_head", mikron)
    text = machine.model_path.read_text().replace('<site name="tool"', '<joint name="W" type="slide" axis="0 0 1"/><site name="tool"')
    text = text.replace('name="Z" type="slide"', 'name="Q" type="slide"').replace('name="W"', 'name="Z"')
    (tmp_path / "quill.xml").write_text(text)
    with pytest.raises(InputError, match="a slide is carried by a rotary axis"):
        kinematics_of(replace(machine, model_path=tmp_path / "quill.xml"))
    wrong = replace(machine, document={**machine.document, "program": {"axes": {"B": "TILT"}}})
    with pytest.raises(InputError, match="give one of the letters"):
        kinematics_of(wrong)
