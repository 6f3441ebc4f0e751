"""A URDF as a model of MuJoCo, which reads its links, joints, masses and colours; meshes are read and checked here.

`spec_of_urdf` makes the model of a machine, with the drive data (limits of speed and effort, damping, friction) beside it for the machine
file. `shown_urdf` makes that of any robot for a picture: its links have dummy masses, because nothing is simulated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import SubElement, tostring

import mujoco
import numpy as np

from twin.errors import InputError
from twin.geometry.mesh_file import check_corners, load_mesh
from twin.machine.model_limits import compiled_spec, quiet_engine
from twin.machine.urdf_file import check_urdf, checked_tree, mesh_of_urdf

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    import trimesh

MOST_FACES = 2000
"""Most faces of a mesh in the MJCF; a finer mesh is stored as its convex hull."""
MOVING = ("revolute", "continuous", "prismatic")
GREY = np.array([160, 164, 170, 255]) / 255.0
_UNSET = np.array([0.5, 0.5, 0.5, 1.0])
_LEAST_RADIUS = 3e-5
"""Radius of gyration [m] of a link whose URDF states a mass and no inertia."""


@dataclass(frozen=True)
class JointLimits:
    """Drive data of a joint in a URDF, SI at the axis (None: not given)."""

    speed: float | None = None
    effort: float | None = None
    damping: float | None = None
    friction: float | None = None


def spec_of_urdf(path: Path) -> tuple[mujoco.MjSpec, dict[str, JointLimits]]:
    """The MJCF of a URDF, with its meshes inside, and the limits of its joints. Raises InputError in one line."""
    root = check_urdf(path)
    _check_moving_masses(root, path)
    limits = {joint.get("name", ""): _limits(joint) for joint in root.findall("joint") if joint.get("type") in MOVING}
    return _spec(root, path, MOST_FACES), limits


def shown_urdf(path: Path) -> tuple[mujoco.MjModel, dict[str, tuple[str, float, float]]]:
    """The model of any URDF for a picture, and the joints that follow another one: joint -> (other, factor, offset)."""
    root = checked_tree(path)
    mimics = {
        joint.get("name", ""): (m.get("joint", ""), float(m.get("multiplier", 1.0)), float(m.get("offset", 0.0)))
        for joint in root.findall("joint")
        if (m := joint.find("mimic")) is not None
    }
    for joint in root.findall("joint"):
        if joint.get("type") not in MOVING:
            joint.set("type", "fixed")
    for link in root.findall("link"):
        for inertial in link.findall("inertial"):
            link.remove(inertial)
    spec = _spec(root, path, None)
    for body in spec.bodies[1:]:
        body.mass, body.inertia, body.explicitinertial = 1.0, [1.0, 1.0, 1.0], True
    return compiled_spec(spec, str(path)), mimics


def _spec(root: Element, path: Path, most_faces: int | None) -> mujoco.MjSpec:
    """The model of a checked tree: its visible shapes without mass, no contacts, no limits of effort."""
    quiet_engine()
    meshes: dict[str, trimesh.Trimesh] = {}
    names: set[str] = set()
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for inertial in link.findall("inertial"):
            _with_inertia(inertial)
        for i, visual in enumerate(link.findall("visual")):
            own = visual.get("name", "")
            visual.set("name", own if own and own not in names else f"{link.get('name')}_{i}")
            names.add(visual.get("name", ""))
            if (mesh := visual.find("geometry/mesh")) is not None:
                name = f"mesh{len(meshes)}"
                meshes[name] = _mesh(mesh, str(link.get("name")), path, most_faces)
                mesh.attrib.clear()
                mesh.set("filename", f"{name}.obj")
    for other in [e for e in root if e.tag not in ("link", "joint", "material")]:
        root.remove(other)
    SubElement(SubElement(root, "mujoco"), "compiler", discardvisual="false", fusestatic="false")
    try:
        spec = mujoco.MjSpec.from_string(tostring(root, encoding="unicode"))
    except ValueError as error:
        raise InputError(f"{path}: MuJoCo cannot read the URDF: {' '.join(str(error).split())}; correct it") from None
    spec.modelname = root.get("name") or path.stem
    for mesh in spec.meshes:
        read = meshes[mesh.name]
        mesh.file, mesh.content_type = "", ""
        mesh.uservert, mesh.userface = np.asarray(read.vertices, float).ravel(), np.asarray(read.faces, np.int32).ravel()
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a flat one has no volume
    for geom in spec.geoms:
        geom.mass = 0.0
        if np.allclose(geom.rgba, _UNSET):
            geom.rgba = GREY
    for joint in spec.joints:
        joint.damping, joint.frictionloss, joint.actfrcrange = np.zeros(3), 0.0, [0.0, 0.0]  # of the machine file
    for equality in list(spec.equalities):
        spec.delete(equality)
    return spec


def _with_inertia(inertial: Element) -> None:
    """Give a mass without inertia the least one."""
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is not None and (inertia is None or not any(float(inertia.get(key, 0.0)) for key in ("ixx", "iyy", "izz"))):
        least = f"{float(mass.get('value', 0.0)) * _LEAST_RADIUS**2:g}"
        element = SubElement(inertial, "inertia") if inertia is None else inertia
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
            element.set(key, least if key[1] == key[2] else "0")


def _mesh(element: Element, link: str, path: Path, most_faces: int | None) -> trimesh.Trimesh:
    """The mesh of a visual, scaled; above `most_faces` its convex hull."""
    import trimesh

    where = f"{path}: link '{link}'"
    read = load_mesh(mesh_of_urdf(element.get("filename", ""), path, where), process=False)
    with np.errstate(over="ignore", invalid="ignore"):
        corners = np.asarray(read.vertices, float) * [float(word) for word in element.get("scale", "1 1 1").split()]
    check_corners(corners, where)
    # an STL repeats each corner in every triangle
    mesh = trimesh.Trimesh(corners, read.faces, process=most_faces is not None)
    return mesh if most_faces is None or len(mesh.faces) <= most_faces else mesh.convex_hull


def _check_moving_masses(root: Element, path: Path) -> None:
    """Refuse a moving joint whose link, with all that is fixed to it, has no mass."""
    own = {
        str(link.get("name")): float(m.get("value", 0.0)) for link in root.findall("link") if (m := link.find("inertial/mass")) is not None
    }

    def fixed_to(link: str) -> Iterator[str]:
        yield link
        for joint in root.findall("joint"):
            if joint.get("type") not in MOVING and _end(joint, "parent") == link:
                yield from fixed_to(_end(joint, "child"))

    for joint in root.findall("joint"):
        child = _end(joint, "child")
        if joint.get("type") in MOVING and sum(own.get(link, 0.0) for link in fixed_to(child)) <= 0.0:
            raise InputError(f"{path}: link '{child}' moves with joint '{joint.get('name')}' and has no <inertial>; give mass and inertia")


def _end(joint: Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _limits(joint: Element) -> JointLimits:
    def positive(tag: str, key: str) -> float | None:
        element = joint.find(tag)
        value = float(element.get(key, 0.0)) if element is not None else 0.0
        return value if math.isfinite(value) and value > 0.0 else None

    return JointLimits(
        positive("limit", "velocity"), positive("limit", "effort"), positive("dynamics", "damping"), positive("dynamics", "friction")
    )
