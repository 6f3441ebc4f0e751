"""The visible parts of any robot or machine in a URDF: its tree as a MuJoCo model, its meshes read.

Links become bodies, revolute and continuous joints become hinges, prismatic ones slides; other joints are rigid. Masses and collision
shapes are not read, because a replay does not need them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from graphlib import TopologicalSorter
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from twin.geometry.mesh_file import check_corners, load_mesh
from twin.geometry.shape import Shape
from twin.machine.model_limits import compiled_spec, quiet_engine
from twin.machine.urdf_file import mesh_of_urdf, read_urdf

_GREY = (160, 164, 170, 255)
MOVING = {"revolute": mujoco.mjtJoint.mjJNT_HINGE, "continuous": mujoco.mjtJoint.mjJNT_HINGE, "prismatic": mujoco.mjtJoint.mjJNT_SLIDE}
_MASS = 1.0
"""Mass of every body; MuJoCo needs one to compile, and nothing here is simulated."""


@dataclass(frozen=True)
class Visuals:
    """The tree of a URDF as a model with dummy masses, the shapes on its bodies, and the joints that follow others.

    `mimics`: joint -> (other joint, factor, offset).
    """

    name: str
    model: mujoco.MjModel
    shapes: tuple[Shape, ...]
    mimics: dict[str, tuple[str, float, float]]


def read_visuals(path: Path) -> Visuals:
    """Read a URDF file. Raises InputError if it cannot be read or lacks a mesh."""
    robot = read_urdf(path)
    quiet_engine()
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    add_tree(spec, robot, _massless_body)
    model = compiled_spec(spec, str(path))
    shapes = [shape for name, link in robot.link_map.items() for shape in _shapes(link, model.body(name).id, robot, path)]
    mimics = {
        j.name: (j.mimic.joint, 1.0 if j.mimic.multiplier is None else float(j.mimic.multiplier), float(j.mimic.offset or 0.0))
        for j in robot.joint_map.values()
        if j.mimic
    }
    return Visuals(robot.robot.name or path.stem, model, tuple(shapes), mimics)


def add_tree(spec: mujoco.MjSpec, robot: Any, add_body: Callable[[Any, Any, np.ndarray], Any]) -> dict[str, Any]:
    """Add the links and joints of a robot to a spec; returns the bodies by link. `add_body(parent, link, parent_from_link)` makes one body."""
    above = {joint.child: joint for joint in robot.joint_map.values()}
    bodies: dict[str, Any] = {}
    for name in TopologicalSorter({link: [above[link].parent] if link in above else [] for link in robot.link_map}).static_order():
        if (joint := above.get(name)) is None:
            bodies[name] = spec.worldbody if name == "world" else add_body(spec.worldbody, robot.link_map[name], np.eye(4))
            continue
        bodies[name] = add_body(bodies[joint.parent], robot.link_map[name], np.eye(4) if joint.origin is None else joint.origin)
        if joint.type in MOVING:
            _add_joint(bodies[name], joint)
    return bodies


def _massless_body(parent: Any, link: Any, parent_from_link: np.ndarray) -> Any:
    """A body with the mass that MuJoCo requires."""
    position, orientation = parent_from_link[:3, 3], quaternion_of(parent_from_link[:3, :3])
    return parent.add_body(name=link.name, pos=position, quat=orientation, mass=_MASS, inertia=[_MASS] * 3, explicitinertial=True)


def _add_joint(body: Any, joint: Any) -> None:
    axis = np.asarray(joint.axis if joint.axis is not None else [1.0, 0.0, 0.0], float)
    added = body.add_joint(name=joint.name, type=MOVING[joint.type], axis=axis / np.linalg.norm(axis))
    low, high = (None, None) if joint.limit is None or joint.type == "continuous" else (joint.limit.lower, joint.limit.upper)
    if low is not None and high is not None and low < high:
        added.range = [low, high]
        added.limited = mujoco.mjtLimited.mjLIMITED_TRUE


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
        shapes.append(Shape(body, name, kind, place[:3, 3].copy(), quaternion_of(place[:3, :3]), colour, size, vertices, faces))
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
    """Colour of a material: its own, or that of the file's material of the same name."""
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


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Quaternion (w, x, y, z) of a rotation matrix (3, 3)."""
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation, float).ravel())
    return quaternion
