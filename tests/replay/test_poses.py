"""Poses of any tree of slides and hinges are the engine's own, to rounding."""

import mujoco
import numpy as np
import pytest

from twin.geometry.body_poses import IDENTITY, Pose, body_poses, local_poses, rotation_of, site_pose
from twin.machine.machine import load_machine

ROUNDING = 1e-12


def random_tree(seed: int, bodies: int = 9) -> mujoco.MjModel:
    """A tree with up to three joints a body, skew axes, anchors off the origin, reference positions, branches."""
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    parents = [spec.worldbody]
    for b in range(bodies):
        quaternion = rng.standard_normal(4)
        parent = parents[rng.integers(len(parents))]
        body = parent.add_body(
            name=f"b{b}", pos=rng.standard_normal(3), quat=quaternion / np.linalg.norm(quaternion), mass=1.0, inertia=[1.0] * 3
        )
        body.explicitinertial = True
        for j in range(rng.integers(0, 4)):
            kind = mujoco.mjtJoint.mjJNT_SLIDE if rng.random() < 0.5 else mujoco.mjtJoint.mjJNT_HINGE
            axis = rng.standard_normal(3)
            body.add_joint(
                name=f"b{b}j{j}", type=kind, axis=axis / np.linalg.norm(axis), pos=rng.standard_normal(3), ref=rng.standard_normal()
            )
        body.add_site(name=f"s{b}", pos=rng.standard_normal(3))
        parents.append(body)
    return spec.compile()


def greatest_difference(model: mujoco.MjModel, joints: dict[str, np.ndarray], sample: int) -> float:
    data = mujoco.MjData(model)
    for name, values in joints.items():
        data.joint(name).qpos[0] = values[sample]
    mujoco.mj_kinematics(model, data)
    poses = body_poses(model, joints)
    worst = 0.0
    for body, pose in enumerate(poses):
        at = pose.at(np.array([sample]))
        worst = max(worst, np.abs(at.position[0] - data.xpos[body]).max())
        worst = max(worst, np.abs(at.rotation.as_matrix()[0] - data.xmat[body].reshape(3, 3)).max())
    for site in range(model.nsite):
        at = site_pose(model, poses, site).at(np.array([sample]))
        worst = max(worst, np.abs(at.position[0] - data.site_xpos[site]).max())
    return worst


@pytest.mark.parametrize("seed", range(8))
def test_random_tree_as_the_engine(seed: int) -> None:
    model = random_tree(seed)
    rng = np.random.default_rng(100 + seed)
    joints = {model.joint(j).name: rng.uniform(-3.0, 3.0, 20) for j in range(model.njnt)}
    assert max(greatest_difference(model, joints, sample) for sample in range(20)) < ROUNDING


def test_the_machine_as_the_engine_at_random_poses() -> None:
    model = mujoco.MjModel.from_xml_path(str(load_machine().model_path))
    rng = np.random.default_rng(1)
    joints = {axis: rng.uniform(-1.0, 1.0, 200) for axis in "XYZAC"}
    assert max(greatest_difference(model, joints, sample) for sample in range(0, 200, 7)) < ROUNDING


def test_a_joint_without_values_keeps_its_reference_pose() -> None:
    model = random_tree(3)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    for body, pose in enumerate(body_poses(model, {})):
        assert np.allclose(pose.position[0], data.xpos[body], atol=ROUNDING)


def test_a_quarter_turn_of_a_and_c_turns_right_handed() -> None:
    model = mujoco.MjModel.from_xml_path(str(load_machine().model_path))
    quarter = np.array([np.pi / 2])
    cradle = body_poses(model, {"A": quarter})[model.body("cradle").id]
    assert np.allclose(cradle.rotation.apply(np.array([[0.0, 1.0, 0.0]])), [[0.0, 0.0, 1.0]], atol=ROUNDING)
    table = body_poses(model, {"C": quarter})[model.body("table").id]
    assert np.allclose(table.rotation.apply(np.array([[1.0, 0.0, 0.0]])), [[0.0, 1.0, 0.0]], atol=ROUNDING)


def test_pose_and_its_inverse_are_the_identity() -> None:
    rng = np.random.default_rng(5)
    pose = Pose(rng.standard_normal((50, 3)), rotation_of(rng.standard_normal((50, 4))))
    both = pose.inverse() @ pose
    assert np.allclose(both.position, IDENTITY.position, atol=ROUNDING)
    assert np.allclose(both.rotation.as_matrix(), np.eye(3), atol=ROUNDING)


def test_bodies_at_rest_keep_one_sample() -> None:
    model = mujoco.MjModel.from_xml_path(str(load_machine().model_path))
    local = local_poses(model, {"X": np.linspace(0.0, 0.1, 30)})
    lengths = {model.body(b).name: (len(pose.position), len(pose.rotation)) for b, pose in enumerate(local)}
    assert lengths["x_slide"] == (30, 1)
    assert lengths["cradle"] == (1, 1)
