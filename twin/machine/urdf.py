"""A URDF as the MJCF of a machine: links become bodies with their masses, moving joints become slides and hinges.

`JointLimits` passes the drive data of a URDF (limits of travel, speed and effort, damping, friction) on to the machine file. Shapes
are kept for pictures; meshes are stored inside the MJCF, so that one file holds the machine.
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
from twin.machine.urdf_visuals import MOVING, add_tree, quaternion_of, read_visuals

MOST_FACES = 2000
"""Most faces of a mesh in the MJCF; a finer mesh is stored as its convex hull."""

_GEOMS = {
    "box": mujoco.mjtGeom.mjGEOM_BOX,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "mesh": mujoco.mjtGeom.mjGEOM_MESH,
}


@dataclass(frozen=True)
class JointLimits:
    """Drive data of a joint in a URDF, SI at the axis (None: not given)."""

    speed: float | None = None
    effort: float | None = None
    damping: float | None = None
    friction: float | None = None


def spec_of_urdf(path: Path) -> tuple[mujoco.MjSpec, dict[str, JointLimits]]:
    """The MJCF of a URDF and the limits of its joints. Raises InputError in one line."""
    check_urdf(path)
    robot = read_urdf(path)
    joints = robot.joint_map
    _check_moving_masses(joints, robot.link_map, path)
    quiet_engine()
    spec = mujoco.MjSpec()
    spec.modelname = robot.robot.name or path.stem
    spec.compiler.degree = False
    bodies = add_tree(spec, robot, _add_body)
    _add_shapes(spec, bodies, path)
    limits = {joint.name: _limits(joint) for joint in joints.values() if joint.type in MOVING}
    return spec, limits


def _check_moving_masses(joints: Mapping[str, Any], links: Mapping[str, Any], path: Path) -> None:
    """Refuse a moving joint whose link, with all that is fixed to it, has no mass."""
    fixed: dict[str, list[str]] = {}
    for joint in joints.values():
        if joint.type not in MOVING:
            fixed.setdefault(joint.parent, []).append(joint.child)

    def mass(link: str) -> float:
        inertial = links[link].inertial
        own = float(inertial.mass or 0.0) if inertial is not None else 0.0
        return own + sum(mass(child) for child in fixed.get(link, ()))

    for joint in joints.values():
        if joint.type in MOVING and mass(joint.child) <= 0.0:
            raise InputError(f"{path}: link '{joint.child}' moves with joint '{joint.name}' and has no <inertial>; give mass and inertia")


def _add_body(parent: Any, link: Any, parent_from_link: np.ndarray) -> Any:
    body = parent.add_body(name=link.name, pos=parent_from_link[:3, 3], quat=quaternion_of(parent_from_link[:3, :3]))
    if link.inertial is not None and link.inertial.mass:
        at = np.eye(4) if link.inertial.origin is None else link.inertial.origin
        inertia = np.zeros((3, 3)) if link.inertial.inertia is None else np.asarray(link.inertial.inertia, float)
        principal, axes = np.linalg.eigh(inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        body.mass = float(link.inertial.mass)
        body.ipos = at[:3, 3]
        body.iquat = quaternion_of(at[:3, :3] @ axes)
        body.inertia = np.maximum(principal, 1e-9 * body.mass)
        body.explicitinertial = True
    return body


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
    """Add the visible shapes, without mass."""
    import trimesh

    visuals = read_visuals(path)
    for i, shape in enumerate(visuals.shapes):
        body = bodies[visuals.model.body(shape.body).name]
        more: dict[str, Any] = {}
        if shape.kind == "mesh":
            if shape.vertices is None or shape.faces is None:
                continue
            name = f"{body.name}_{i}"
            merged = trimesh.Trimesh(shape.vertices, shape.faces)  # an STL repeats each corner in every triangle
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
