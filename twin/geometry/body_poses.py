"""Poses of all bodies of a tree of slides and hinges, for many joint samples at once, without a simulation.

As in MuJoCo, a body starts at its offset in the parent, and its joints move it one after the other:

slide   x += R a (q - q0)                       a, p: axis and anchor of the joint in the body's frame
hinge   R <- R Rot(a, q - q0),  x <- x + (R_before - R_after) p

Positions are (sample, 3). A constant part of a pose has a single sample, which numpy and scipy broadcast. Ball and free joints stay in their reference pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Pose:
    """parent_from_child: x_parent = rotation x_child + position; position (sample or 1, 3) [m], and as many rotations or one."""

    position: np.ndarray
    rotation: Rotation

    def __matmul__(self, other: Pose) -> Pose:
        """a_from_c = a_from_b @ b_from_c."""
        return Pose(self.rotation.apply(other.position) + self.position, self.rotation * other.rotation)

    def inverse(self) -> Pose:
        """child_from_parent."""
        back = self.rotation.inv()
        return Pose(-back.apply(self.position), back)

    def at(self, samples: np.ndarray) -> Pose:
        """The poses at some samples (indices); a constant part stays single."""
        position, rotation = self.position, self.rotation
        return Pose(position if len(position) == 1 else position[samples], rotation if len(rotation) == 1 else rotation[samples])


IDENTITY = Pose(np.zeros((1, 3)), Rotation.identity(1))


def local_poses(model: mujoco.MjModel, joints: Mapping[str, np.ndarray]) -> list[Pose]:
    """parent_from_body of every body in the order of the model, for joint positions (sample,) by joint name [m, rad].

    Other joints stay in their reference pose (q0).
    """
    poses = [IDENTITY]
    for body in range(1, model.nbody):
        pose = Pose(model.body_pos[body][None], rotation_of(model.body_quat[body][None]))
        for joint in range(model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]):
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
            if name in joints:
                pose = _moved(pose, model, joint, np.asarray(joints[name], float))
        poses.append(pose)
    return poses


def body_poses(model: mujoco.MjModel, joints: Mapping[str, np.ndarray]) -> list[Pose]:
    """world_from_body of every body, in the order of the model."""
    poses: list[Pose] = []
    for body, local in enumerate(local_poses(model, joints)):
        poses.append(local if body == 0 else poses[model.body_parentid[body]] @ local)
    return poses


def site_pose(model: mujoco.MjModel, bodies: list[Pose], site: int) -> Pose:
    """world_from_site, given the poses of all bodies."""
    return bodies[model.site_bodyid[site]] @ Pose(model.site_pos[site][None], rotation_of(model.site_quat[site][None]))


def rotation_of(quaternion: np.ndarray) -> Rotation:
    """The rotations of unit quaternions (sample, 4) of the engine, whose first number is w."""
    return Rotation.from_quat(quaternion[..., [1, 2, 3, 0]])


def _moved(pose: Pose, model: mujoco.MjModel, joint: int, values: np.ndarray) -> Pose:
    """The body's pose after one of its joints."""
    kind = model.jnt_type[joint]
    axis, anchor = model.jnt_axis[joint][None], model.jnt_pos[joint][None]
    move = (values - model.qpos0[model.jnt_qposadr[joint]])[:, None]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        return Pose(pose.position + pose.rotation.apply(axis) * move, pose.rotation)
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        turned = pose.rotation * Rotation.from_rotvec(move * axis)
        shift = pose.rotation.apply(anchor) - turned.apply(anchor) if np.any(anchor) else 0.0
        return Pose(pose.position + shift, turned)
    return pose
