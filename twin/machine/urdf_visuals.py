"""What is seen of any robot or machine described by a URDF: its tree brought to the engine's form, its meshes read.

Links become bodies, revolute and continuous joints hinges, prismatic ones slides, the others are rigid. Only what is seen is
read: masses and collision shapes are not needed to replay a motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from twin.geometry.mesh_file import check_corners, load_mesh
from twin.geometry.shape import Shape
from twin.machine.model_limits import compiled_spec, quiet_engine
from twin.machine.urdf_file import mesh_of_urdf, read_urdf

_GREY = (160, 164, 170, 255)
_KINDS = {"revolute": mujoco.mjtJoint.mjJNT_HINGE, "continuous": mujoco.mjtJoint.mjJNT_HINGE, "prismatic": mujoco.mjtJoint.mjJNT_SLIDE}
_MASS = 1.0
"""Every body needs a mass to compile; nothing here is simulated."""


@dataclass(frozen=True)
class Visuals:
    """The tree of a URDF as a model without masses of its own, the shapes on its bodies, and joints that follow others.

    `mimics`: joint -> (other, factor, offset).
    """

    name: str
    model: mujoco.MjModel
    shapes: tuple[Shape, ...]
    mimics: dict[str, tuple[str, float, float]]


def read_visuals(path: Path) -> Visuals:
    """Read a URDF file; one that cannot be read or lacks a mesh is an InputError."""
    robot = read_urdf(path)
    quiet_engine()
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    children = {joint.child for joint in robot.joint_map.values()}
    roots = [name for name in robot.link_map if name not in children]
    bodies: dict[str, Any] = {}
    for root in roots:
        bodies[root] = spec.worldbody if root == "world" else _add_body(spec.worldbody, root, np.eye(4))
    # parents before children, whatever the order of the file
    waiting = list(robot.joint_map.values())
    while waiting:
        ready = [joint for joint in waiting if joint.parent in bodies]
        for joint in ready:
            body = _add_body(bodies[joint.parent], joint.child, joint.origin if joint.origin is not None else np.eye(4))
            _add_joint(body, joint)
            bodies[joint.child] = body
        waiting = [joint for joint in waiting if joint not in ready]
    model = compiled_spec(spec, str(path))
    shapes = [shape for name, link in robot.link_map.items() for shape in _shapes(link, model.body(name).id, robot, path)]
    mimics = {
        j.name: (j.mimic.joint, 1.0 if j.mimic.multiplier is None else float(j.mimic.multiplier), float(j.mimic.offset or 0.0))
        for j in robot.joint_map.values()
        if j.mimic
    }
    return Visuals(robot.robot.name or path.stem, model, tuple(shapes), mimics)


def _add_body(parent: Any, name: str, parent_from_child: np.ndarray) -> Any:
    return parent.add_body(
        name=name,
        pos=parent_from_child[:3, 3],
        quat=_quaternion(parent_from_child[:3, :3]),
        mass=_MASS,
        inertia=[_MASS] * 3,
        explicitinertial=True,
    )


def _add_joint(body: Any, joint: Any) -> None:
    if joint.type not in _KINDS:
        return
    axis = np.asarray(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], float)
    added = body.add_joint(name=joint.name, type=_KINDS[joint.type], axis=axis / np.linalg.norm(axis))
    if joint.limit is not None and joint.limit.lower is not None and joint.limit.upper is not None and joint.type != "continuous":
        added.range = [joint.limit.lower, joint.limit.upper]
        added.limited = True


def _shapes(link: Any, body: int, robot: Any, path: Path) -> list[Shape]:
    shapes = []
    for i, visual in enumerate(link.visuals):
        place = visual.origin if visual.origin is not None else np.eye(4)
        name = visual.name or f"{link.name}_{i}"
        geometry, size, vertices, faces = visual.geometry, np.zeros(3), None, None
        if geometry.box is not None:
            kind, size = "box", np.asarray(geometry.box.size, float) / 2.0
        elif geometry.cylinder is not None:
            kind, size = "cylinder", np.array([geometry.cylinder.radius, geometry.cylinder.length / 2.0, 0.0])
        elif geometry.sphere is not None:
            kind, size = "ellipsoid", np.full(3, float(geometry.sphere.radius))
        elif geometry.mesh is not None:
            kind, (vertices, faces) = "mesh", _mesh(geometry.mesh, link.name, path)
        else:
            continue
        colour = _colour(visual.material, robot)
        shapes.append(Shape(body, name, kind, place[:3, 3].copy(), _quaternion(place[:3, :3]), colour, size, vertices, faces))
    return shapes


def _mesh(mesh: Any, link: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    file = mesh_of_urdf(str(mesh.filename or ""), path, f"{path}: link '{link}'")
    read = load_mesh(file, process=False)
    scale = 1.0 if mesh.scale is None else np.asarray(mesh.scale, float)
    with np.errstate(over="ignore", invalid="ignore"):
        corners = np.asarray(read.vertices, float) * scale
    check_corners(corners, f"{path}: link '{link}'")
    return corners, np.asarray(read.faces, np.int64)


def _colour(material: Any, robot: Any) -> tuple[int, int, int, int]:
    """Colour of a material, given there or by name at the top of the file."""
    if material is None:
        return _GREY
    colour = material.color
    if colour is None:
        named = {m.name: m for m in robot.robot.materials}
        colour = named[material.name].color if material.name in named else None
    if colour is None:
        return _GREY
    red, green, blue, alpha = np.rint(255 * np.clip(np.asarray(colour.rgba, float), 0.0, 1.0)).astype(int).tolist()
    return red, green, blue, alpha


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, float).ravel())
    return quaternion
