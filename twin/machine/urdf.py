"""A URDF as a model of MuJoCo, which reads its links, joints, masses and colours; tree, numbers and meshes are read and checked here.

`spec_of_urdf` makes the model of a machine, with the drive data (limits of speed and effort, damping, friction) beside it for the machine
file. `shown_urdf` makes that of any robot for a picture: its links have dummy masses, because nothing is simulated. `checked_tree` is the way to
any URDF; `check_urdf` also refuses what cannot be a machine of axes.
"""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
import math
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import SubElement, tostring

import mujoco
import numpy as np

from twin.documents import named_file
from twin.errors import InputError, nearest
from twin.geometry.mesh_file import check_corners, load_mesh
from twin.machine.model_file import positive_mass, read_xml
from twin.machine.model_limits import check_size, compiled_spec, numbers_of, quiet_engine

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    import trimesh

MOST_FACES = 2000
"""Most faces of a mesh in the MJCF; a finer mesh is stored as its convex hull."""
MOVING = ("revolute", "continuous", "prismatic")
JOINTS = (*MOVING, "fixed", "floating", "planar")
GREY = np.array([160, 164, 170, 255]) / 255.0
_UNSET = np.array([0.5, 0.5, 0.5, 1.0])
_LEAST_RADIUS = 3e-5
"""Radius of gyration [m] of a link whose URDF states a mass and no inertia."""
LARGEST_NUMBER = 1e9
"""Largest length, angle, mass or limit, SI."""

_VECTORS = {
    ("origin", "xyz"): 3, ("origin", "rpy"): 3, ("axis", "xyz"): 3, ("box", "size"): 3, ("mesh", "scale"): 3, ("color", "rgba"): 4,
    ("mass", "value"): 1, ("cylinder", "radius"): 1, ("cylinder", "length"): 1, ("sphere", "radius"): 1,
    **{("inertia", key): 1 for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")},
    **{("limit", key): 1 for key in ("lower", "upper", "effort", "velocity")},
    **{("dynamics", key): 1 for key in ("damping", "friction")},
    **{("mimic", key): 1 for key in ("multiplier", "offset")},
}  # fmt: skip
"""How many numbers an attribute of an element has."""
_NEEDED = {("cylinder", "radius"), ("cylinder", "length"), ("sphere", "radius"), ("box", "size"), ("mass", "value")}


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
    fixed_to = {_end(joint, "child"): _end(joint, "parent") for joint in root.findall("joint") if joint.get("type") not in MOVING}
    moved: dict[str, float] = {}
    for link in root.findall("link"):
        name, mass = link.get("name", ""), link.find("inertial/mass")
        while name in fixed_to:
            name = fixed_to[name]
        moved[name] = moved.get(name, 0.0) + (0.0 if mass is None else float(mass.get("value", 0.0)))
    for joint in root.findall("joint"):
        child = _end(joint, "child")
        if joint.get("type") in MOVING and moved[child] <= 0.0:
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


def check_urdf(path: Path) -> Element:
    """Refuse a URDF that is unsafe or not a tree of slides and hinges. Returns its root."""
    root = checked_tree(path)
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind in ("floating", "planar"):
            raise InputError(f"{path}: joint '{name}' is {kind}, but an axis is prismatic, revolute or continuous; fix or split it")
        if joint.find("mimic") is not None:
            raise InputError(f"{path}: joint '{name}' follows another one (mimic), but each axis has its own drive; remove it")
    for element in root.findall("link"):
        if (mass := element.find("inertial/mass")) is not None:
            positive_mass(mass.get("value", ""), f"{path}: link " + repr(element.get("name")) + ": mass")
    for mesh in root.iter("mesh"):
        mesh_of_urdf(mesh.get("filename", ""), path, f"{path}")
    return root


def checked_tree(path: Path) -> Element:
    """The root of a URDF, checked: links have names and form a tree, vectors are complete and finite."""
    root = read_xml(path)
    if root.tag != "robot":
        raise InputError(f"{path}: <{str(root.tag)[:40]}> is not a URDF; its root must be <robot>")
    check_size(root, path)
    _check_numbers(root, path)
    links, joints = (_names(root, tag, path) for tag in ("link", "joint"))
    if not links:
        raise InputError(f"{path}: not a URDF: no <link>; give a robot description")
    parents: dict[str, str] = {}
    for joint in root.findall("joint"):
        name, kind = joint.get("name", ""), joint.get("type", "")
        if kind not in JOINTS:
            raise InputError(f"{path}: joint '{name}': type = '{kind}'; {nearest(kind, JOINTS)}")
        parent, child = _end(joint, "parent"), _end(joint, "child")
        for link in (parent, child):
            if link not in links:
                raise InputError(f"{path}: joint '{name}' names link '{link}', which does not exist; correct it")
        if child in parents:
            raise InputError(
                f"{path}: link '{child}' hangs on two joints, which closes a loop, but a machine is a tree of axes; remove one"
            )
        if (mimic := joint.find("mimic")) is not None and mimic.get("joint", "") not in joints:
            raise InputError(f"{path}: joint '{name}' follows joint '{mimic.get('joint', '')}', which does not exist; correct it")
        parents[child] = parent
    try:
        TopologicalSorter({child: [parent] for child, parent in parents.items()}).prepare()
    except CycleError as error:
        raise InputError(f"{path}: link '{error.args[1][0]}' hangs on itself: its joints form a circle; give one link no parent") from None
    return root


def mesh_of_urdf(name: str, path: Path, where: str) -> Path:
    """The file of a mesh: beside the URDF, or for `package://a/b/c` inside the package `a`.

    A package is a folder with that name beside or above the URDF; elsewhere it must contain a `package.xml`. Paths that leave it are refused.
    """
    if not name.startswith("package://"):
        return named_file(name.removeprefix("file://"), path.parent, where)
    package, _, rest = name.removeprefix("package://").partition("/")
    if package in ("", ".", "..") or not rest:
        raise InputError(f"{where}: '{name}' names no package; write package://PACKAGE/meshes/FILE")
    here = path.resolve().parent
    homes = [here / package, here]
    for above in (here, *here.parents):
        if above.name == package or (above / "package.xml").is_file():
            homes.append(above)
        if (above / package / "package.xml").is_file():
            homes.append(above / package)
    for home in homes:
        try:
            return named_file(rest, home, where)
        except InputError as error:
            if "leaves the folder" in str(error):
                raise
    raise InputError(f"{where}: no mesh '{name}' beside the file; copy it there or correct the name")


def _names(root: Element, tag: str, path: Path) -> set[str]:
    names: set[str] = set()
    for number, element in enumerate(root.findall(tag), start=1):
        name = element.get("name", "")
        if not name:
            raise InputError(f"{path}: {tag} {number} has no name; give it one")
        if name in names:
            raise InputError(f"{path}: two of <{tag}> are named '{name}'; rename one")
        names.add(name)
    return names


def _check_numbers(root: Element, path: Path) -> None:
    """Check that every vector is complete, every number is finite and no axis is zero."""
    for element in root.iter():
        for key in {key for tag, key in _VECTORS if tag == element.tag}:
            count, text = _VECTORS[element.tag, key], element.get(key)
            where = f"{path}: <{element.tag}>: {key}"
            if text is None:
                if (element.tag, key) in _NEEDED:
                    raise InputError(f"{where} is missing; add it")
                continue
            values = numbers_of(text, where)
            if len(values) != count:
                raise InputError(f"{where} = '{text[:60]}' has {len(values)} numbers; give {count}")
            if not all(abs(v) <= LARGEST_NUMBER for v in values):
                raise InputError(f"{where} = '{text[:60]}': impossible; give finite numbers up to {LARGEST_NUMBER:g}")
            if element.tag == "axis" and not any(values):
                raise InputError(f"{where} = '{text[:60]}' points nowhere; give a direction other than zero")
