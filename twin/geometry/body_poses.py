"""Poses of all bodies of a tree of slides and hinges, for many joint samples at once, without a simulation.

As in MuJoCo, a body starts at its offset in the parent, and its joints move it one after the other:

slide   x += R a (q - q0)                       a, p: axis and anchor of the joint in the body's frame
hinge   R <- R Rot(a, q - q0),  x <- x + (R_before - R_after) p

Rotations are unit quaternions (w, x, y, z). Arrays are (sample, 3) and (sample, 4). A constant pose has a single sample, which numpy
broadcasts. Ball and free joints stay in their reference pose.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Pose:
    """parent_from_child: x_parent = rotate(quaternion, x_child) + position; (sample or 1, 3) [m] and (sample or 1, 4)."""

    position: np.ndarray
    quaternion: np.ndarray

    def __matmul__(self, other: Pose) -> Pose:
        """a_from_c = a_from_b @ b_from_c."""
        return Pose(self.apply(other.position), multiply(self.quaternion, other.quaternion))

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Points of the child (sample or 1, 3) in the parent."""
        return rotate(self.quaternion, points) + self.position

    def inverse(self) -> Pose:
        """child_from_parent."""
        back = self.quaternion * [1.0, -1.0, -1.0, -1.0]
        return Pose(-rotate(back, self.position), back)

    def at(self, samples: np.ndarray) -> Pose:
        """The poses at some samples (indices); a constant pose stays single."""
        return Pose(*(part if len(part) == 1 else part[samples] for part in (self.position, self.quaternion)))


IDENTITY = Pose(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]))


def local_poses(model: mujoco.MjModel, joints: Mapping[str, np.ndarray]) -> list[Pose]:
    """parent_from_body of every body in the order of the model, for joint positions (sample,) by joint name [m, rad].

    Other joints stay in their reference pose (q0).
    """
    poses = [IDENTITY]
    for body in range(1, model.nbody):
        pose = Pose(model.body_pos[body][None], model.body_quat[body][None])
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
    return bodies[model.site_bodyid[site]] @ Pose(model.site_pos[site][None], model.site_quat[site][None])


def rotate(quaternion: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (sample or 1, 3) rotated by unit quaternions (sample or 1, 4)."""
    if len(quaternion) == 1 and np.all(quaternion[0, 1:] == 0.0):
        return points
    return np.asarray(_rotation(quaternion).apply(np.array(points, float)))  # a copy: scipy takes no read-only array


def multiply(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Product of unit quaternions (sample or 1, 4): first b, then a."""
    return (_rotation(a) * _rotation(b)).as_quat()[:, [3, 0, 1, 2]]


def _rotation(quaternion: np.ndarray) -> Rotation:
    return Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])


def _moved(pose: Pose, model: mujoco.MjModel, joint: int, values: np.ndarray) -> Pose:
    """The body's pose after one of its joints."""
    kind = model.jnt_type[joint]
    axis, anchor = model.jnt_axis[joint][None], model.jnt_pos[joint][None]
    move = (values - model.qpos0[model.jnt_qposadr[joint]])[:, None]
    if kind == mujoco.mjtJoint.mjJNT_SLIDE:
        return Pose(pose.position + rotate(pose.quaternion, axis) * move, pose.quaternion)
    if kind == mujoco.mjtJoint.mjJNT_HINGE:
        turned = multiply(pose.quaternion, np.hstack([np.cos(0.5 * move), np.sin(0.5 * move) * axis]))
        shift = rotate(pose.quaternion, anchor) - rotate(turned, anchor) if np.any(anchor) else 0.0
        return Pose(pose.position + shift, turned)
    return pose
