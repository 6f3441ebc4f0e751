"""The five-axis transformation compared with MuJoCo's poses, and its laws with random axes."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from twin.geometry.kinematics import kinematics_of
from twin.machine.machine import Machine
from twin.program.axis_path import axis_jet, frames_of
from twin.program.orientation import OUTSIDE_TRAVEL, UNREACHABLE, choose_angles, unreachable_text
from twin.replay.scene import scene_of
from twin.simulation.plant_spec import compile_model

SCALE = np.array([0.3, 0.25, 0.2, 0.5, 4.0])

SKEW = """
<mujoco><compiler angle="radian"/><worldbody>
  <body pos="0.01 0.02 0.03" euler="0.02 -0.01 0.03"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="Y" type="slide" axis="0.01 1 0"/>
    <body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="X" type="slide" axis="1 0.005 0.002"/>
      <body pos="0 0 0.5"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="Z" type="slide" axis="0.003 0 1"/>
        <site name="tool" pos="0.001 0.002 -0.1"/></body></body></body>
  <body pos="0 0.002 -0.001" euler="0.01 0 0.02"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="A" type="hinge" axis="1 0.01 0" pos="0 0.003 0.004"/>
    <body pos="0 0.07 -0.03"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="C" type="hinge" axis="0.02 0.01 1" pos="0.001 0.002 0"/>
      <site name="workpiece" pos="0.01 0.02 0.05" euler="0 0 0.3"/></body></body>
</worldbody></mujoco>
"""


def site_poses(model: mujoco.MjModel, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tool tip and tool axis in the part frame from MuJoCo's sites."""
    data = mujoco.MjData(model)
    for name, value in zip("XYZAC", axes):
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    part, tool = data.site("workpiece"), data.site("tool")
    turned = part.xmat.reshape(3, 3).T
    return turned @ (tool.xpos - part.xpos), turned @ tool.xmat.reshape(3, 3)[:, 2]


@pytest.fixture(params=["mikron", "skew"])
def machine(request, mikron: Machine, tmp_path) -> Machine:
    """The Mikron, and a machine with skew and offset axes."""
    if request.param == "mikron":
        return mikron
    path = tmp_path / "skew.xml"
    path.write_text(SKEW)
    return replace(mikron, model_path=path, document={**mikron.document, "geometry": {}})  # the lengths of its MJCF


def test_forward_kinematics_are_those_of_the_model(machine: Machine) -> None:
    kinematics, model = kinematics_of(machine), mujoco.MjModel.from_xml_path(str(machine.model_path))
    axes = np.random.default_rng(1).uniform(-1, 1, (200, 5)) * SCALE
    tips, directions = kinematics.forward(axes)
    for q, tip, direction in zip(axes, tips, directions):
        have = site_poses(model, q)
        assert np.abs(have[0] - tip).max() < 1e-12
        assert np.abs(have[1] - direction).max() < 1e-12


def test_lengths_of_the_machine_file_move_the_frames(mikron: Machine) -> None:
    """Simulation, transformation and pictures agree if the lengths of the file differ from the MJCF."""
    lengths: dict[str, object] = {
        "tool_length_m": 0.2,
        "a_axis_to_c_axis_y_m": 0.03,
        "a_axis_to_c_axis_z_m": -0.01,
        "table_top_above_a_axis_m": 0.08,
    }
    lengths["spindle_nose_at_home_m"] = [0.0, 0.01, 0.6]
    changed = mikron.with_values({f"geometry.{key}": value for key, value in lengths.items()})
    q = np.array([0.1, -0.05, 0.08, 0.4, 1.1])
    tip, direction = kinematics_of(changed).forward(q)
    for model in (compile_model(changed), scene_of(changed).model):
        have = site_poses(model, q)
        assert np.abs(have[0] - tip).max() < 1e-12
        assert np.abs(have[1] - direction).max() < 1e-12
    assert kinematics_of(changed).tool_length == 0.2
    assert np.linalg.norm(tip - kinematics_of(mikron).forward(q)[0]) > 0.01


def test_inverse_undoes_forward(machine: Machine) -> None:
    kinematics = kinematics_of(machine)
    axes = np.random.default_rng(2).uniform(-1, 1, (200, 5)) * SCALE
    for q in axes[np.abs(axes[:, 3]) > 0.05]:
        tip, direction = kinematics.forward(q)
        angles = choose_angles(kinematics, direction, q[3:] + 0.001).angles
        assert np.abs(np.column_stack([kinematics.linear_axes(tip, angles), angles]) - q).max() < 1e-9


def test_both_solutions_give_the_tool_axis(machine: Machine) -> None:
    kinematics = kinematics_of(machine)
    axes = np.random.default_rng(3).uniform(-1, 1, (100, 5)) * SCALE
    direction = kinematics.forward(axes)[1]
    pairs, reachable = kinematics.angles(direction)
    assert reachable.all()
    for pair in pairs:
        again = kinematics.forward(np.column_stack([axes[:, :3], pair]))[1]
        assert np.abs(again - direction).max() < 1e-9


def test_signs_by_a_quarter_turn(mikron: Machine) -> None:
    """At A = -90 deg the part's -y axis points to the tool; at C = 90 deg its x axis points to the back."""
    kinematics = kinematics_of(mikron)
    up = kinematics.forward(np.array([0, 0, 0, -np.pi / 2, 0.0]))[1][0]
    assert np.allclose(up, [0, -1, 0], atol=1e-12)  # in the part frame the tool comes from -y
    tips = kinematics.forward(np.array([[0, 0, 0, 0, np.pi / 2], [0, 0.1, 0, 0, np.pi / 2]]))[0]
    assert np.allclose(tips[1] - tips[0], [0.1, 0, 0], atol=1e-12)


def test_tool_length_moves_the_tip_along_the_tool(mikron: Machine) -> None:
    kinematics = kinematics_of(mikron)
    assert kinematics.tool_length == pytest.approx(0.12, abs=1e-12)
    q = np.array([0.1, 0.05, -0.02, -0.4, 1.0])
    tip, direction = kinematics.forward(q)
    longer = kinematics.with_tool_length(0.15).forward(q)[0]
    assert np.allclose(longer, tip - 0.03 * direction, atol=1e-12)


def test_c_takes_the_shortest_way_and_counts_full_turns(mikron: Machine) -> None:
    kinematics = kinematics_of(mikron)
    turn = np.linspace(0.0, 6 * np.pi, 300)
    axes = np.column_stack([np.zeros((300, 3)), np.full(300, -0.5), turn])
    chosen = choose_angles(kinematics, kinematics.forward(axes)[1], np.array([-0.5, 0.0]))
    assert np.abs(chosen.angles - axes[:, 3:]).max() < 1e-9


def test_c_keeps_its_angle_along_the_turning_axis(mikron: Machine) -> None:
    chosen = choose_angles(kinematics_of(mikron), np.array([[0.0, 0.0, 1.0]]), np.array([-0.3, 1.234]))
    assert np.allclose(chosen.angles, [[0.0, 1.234]], atol=1e-9)


def test_a_turning_axis_with_stops_rewinds(mikron: Machine) -> None:
    kinematics = kinematics_of(mikron)
    stopped = replace(kinematics, travel=np.vstack([kinematics.travel[:4], [-np.pi, np.pi]]))
    turn = np.linspace(0.0, 1.5 * np.pi, 100)
    direction = kinematics.forward(np.column_stack([np.zeros((100, 3)), np.full(100, -0.8), turn]))[1]
    chosen = choose_angles(stopped, direction, np.array([-0.8, 0.0]))
    assert chosen.rewound.sum() == 1
    assert np.abs(chosen.angles[:, 1]).max() <= np.pi + 1e-9


def test_unreachable_orientations_are_reported(mikron: Machine) -> None:
    kinematics = kinematics_of(mikron)
    below = choose_angles(kinematics, np.array([[0.0, 0.3, -0.9]]), np.zeros(2))
    assert below.status[0] == OUTSIDE_TRAVEL
    assert "travel" in unreachable_text(kinematics, np.array([0.0, 0.3, -0.9]), OUTSIDE_TRAVEL)
    assert UNREACHABLE not in choose_angles(kinematics, np.eye(3), np.zeros(2)).status


def test_jets_are_the_derivatives_of_the_axes(machine: Machine) -> None:
    """The compiled chain rule compared with finite differences of the transformation along a random cubic."""
    kinematics = kinematics_of(machine)
    frames = frames_of(kinematics, True)
    rng = np.random.default_rng(4)
    c = rng.normal(size=(4, 5)) * np.array([0.05, 0.05, 0.05, 0.3, 0.6])

    def axes(u: np.ndarray) -> np.ndarray:
        w = sum(c[k] * u[:, None] ** k for k in range(4))
        return np.column_stack([kinematics.linear_axes(w[:, :3], w[:, 3:]), w[:, 3:]])

    out = np.empty((4, 5))
    axis_jet(frames, np.array([c[0], c[1], 2 * c[2], 6 * c[3]]), np.empty((5, 4, 4)), out)
    h = 1e-3
    f = axes(np.arange(-3, 4) * h)
    assert np.abs(out[0] - f[3]).max() < 1e-14
    assert np.abs(out[1] - (f[0] * -1 + 9 * f[1] - 45 * f[2] + 45 * f[4] - 9 * f[5] + f[6]) / (60 * h)).max() < 1e-8
    assert np.abs(out[2] - (2 * f[0] - 27 * f[1] + 270 * f[2] - 490 * f[3] + 270 * f[4] - 27 * f[5] + 2 * f[6]) / (180 * h**2)).max() < 1e-7
    assert np.abs(out[3] - (f[0] - 8 * f[1] + 13 * f[2] - 13 * f[4] + 8 * f[5] - f[6]) / (8 * h**3)).max() < 1e-4
