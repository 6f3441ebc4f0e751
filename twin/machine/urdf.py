"""A URDF as the MJCF of a machine: links become bodies with their masses, moving joints slides and hinges, the rest is rigid.

What a URDF knows of a drive (limits of travel, speed and effort, damping, friction) is no matter of the model: `JointLimits`
hands it to the machine file. Shapes are kept for pictures, meshes inside the MJCF, so that one file holds the machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from twin.errors import InputError
from twin.machine.model_limits import quiet_engine
from twin.machine.urdf_file import check_urdf, read_urdf

MOST_FACES = 2000
"""A finer mesh stands in the MJCF as its convex hull."""

_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}
_MOVING = ("prismatic", "revolute", "continuous")


@dataclass(frozen=True)
class JointLimits:
    """What a model says of the drive of a joint, SI at the axis (None: nothing)."""

    speed: float | None = None
    effort: float | None = None
    damping: float | None = None
    friction: float | None = None


def spec_of_urdf(path: Path) -> tuple[mujoco.MjSpec, dict[str, JointLimits]]:
    """The MJCF of a URDF and the limits of its joints; every fault is an InputError in one line."""
    check_urdf(path)
    robot = read_urdf(path)
    joints, links = robot.joint_map, robot.link_map
    _check_moving_masses(joints, links, path)
    quiet_engine()
    spec = mujoco.MjSpec()
    spec.modelname = robot.robot.name or path.stem
    spec.compiler.degree = False
    bodies: dict[str, Any] = {}
    children = {joint.child for joint in joints.values()}
    for name, link in links.items():
        if name not in children:
            bodies[name] = spec.worldbody if name == "world" else _add_body(spec.worldbody, link, np.eye(4))
    waiting = list(joints.values())
    while waiting:
        for joint in [j for j in waiting if j.parent in bodies]:
            bodies[joint.child] = _add_body(bodies[joint.parent], links[joint.child], joint.origin)
            _add_joint(bodies[joint.child], joint)
            waiting.remove(joint)
    _add_shapes(spec, bodies, path)
    limits = {joint.name: _limits(joint) for joint in joints.values() if joint.type in _MOVING}
    return spec, limits


def _check_moving_masses(joints: Mapping[str, Any], links: Mapping[str, Any], path: Path) -> None:
    """A link behind a moving joint needs a mass, its own or that of what is fixed to it."""
    fixed: dict[str, list[str]] = {}
    for joint in joints.values():
        if joint.type not in _MOVING:
            fixed.setdefault(joint.parent, []).append(joint.child)

    def mass(link: str) -> float:
        inertial = links[link].inertial
        own = float(inertial.mass or 0.0) if inertial is not None else 0.0
        return own + sum(mass(child) for child in fixed.get(link, ()))

    for joint in joints.values():
        if joint.type in _MOVING and mass(joint.child) <= 0.0:
            raise InputError(f"{path}: link '{joint.child}' moves with joint '{joint.name}' and has no <inertial>; give mass and inertia")


def _add_body(parent: Any, link: Any, origin: np.ndarray | None) -> Any:
    place = np.eye(4) if origin is None else origin
    body = parent.add_body(name=link.name, pos=place[:3, 3], quat=_quaternion(place[:3, :3]))
    if link.inertial is not None and link.inertial.mass:
        at = np.eye(4) if link.inertial.origin is None else link.inertial.origin
        inertia = np.zeros((3, 3)) if link.inertial.inertia is None else np.asarray(link.inertial.inertia, float)
        principal, axes = np.linalg.eigh(inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        body.mass = float(link.inertial.mass)
        body.ipos = at[:3, 3]
        body.iquat = _quaternion(at[:3, :3] @ axes)
        body.inertia = np.maximum(principal, 1e-9 * body.mass)
        body.explicitinertial = True
    return body


def _add_joint(body: Any, joint: Any) -> None:
    if joint.type not in _MOVING:
        return
    axis = np.asarray(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], float)
    slide = joint.type == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slide else mujoco.mjtJoint.mjJNT_HINGE
    added = body.add_joint(name=joint.name, type=kind, axis=axis / np.linalg.norm(axis))
    limit = joint.limit
    if (
        joint.type != "continuous"
        and limit is not None
        and limit.lower is not None
        and limit.upper is not None
        and limit.lower < limit.upper
    ):
        added.range = [limit.lower, limit.upper]
        added.limited = mujoco.mjtLimited.mjLIMITED_TRUE


def _limits(joint: Any) -> JointLimits:
    limit, dynamics = joint.limit, joint.dynamics

    def positive(value: Any) -> float | None:
        return float(value) if value is not None and math.isfinite(float(value)) and float(value) > 0.0 else None

    return JointLimits(
        speed=positive(limit.velocity) if limit is not None else None,
        effort=positive(limit.effort) if limit is not None else None,
        damping=positive(dynamics.damping) if dynamics is not None else None,
        friction=positive(dynamics.friction) if dynamics is not None else None,
    )


def _add_shapes(spec: mujoco.MjSpec, bodies: Mapping[str, Any], path: Path) -> None:
    """The visible shapes, without mass."""
    import trimesh

    from twin.machine.urdf_visuals import read_visuals

    visuals = read_visuals(path)
    for i, shape in enumerate(visuals.shapes):
        body = bodies[visuals.model.body(shape.body).name]
        more: dict[str, Any] = {}
        if shape.kind == "mesh":
            if shape.vertices is None or shape.faces is None:
                continue
            name = f"{body.name}_{i}"
            merged = trimesh.Trimesh(shape.vertices, shape.faces)  # an STL has each corner once a triangle
            mesh = spec.add_mesh(name=name, uservert=np.asarray(merged.vertices, float).ravel())
            if len(merged.faces) <= MOST_FACES:
                mesh.userface = np.asarray(merged.faces, np.int32).ravel()
            more["meshname"] = name
        else:
            more["size"] = shape.size
        body.add_geom(
            type=_GEOMS[shape.kind],
            pos=shape.position,
            quat=shape.quaternion,
            rgba=np.asarray(shape.colour, float) / 255.0,
            mass=0.0,
            contype=0,
            conaffinity=0,
            group=2,
            **more,
        )


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, float).ravel())
    return quaternion
