"""A URDF from an unknown source: read safely; tree, vectors and names checked; meshes located in packages.

`checked_tree` is the way to any URDF. `check_urdf` also refuses what cannot be a machine of axes.
"""

from __future__ import annotations

from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING

from twin.documents import named_file
from twin.errors import InputError, nearest
from twin.machine.model_file import positive_mass, read_xml
from twin.machine.model_limits import check_size, numbers_of

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

JOINTS = ("prismatic", "revolute", "continuous", "fixed", "floating", "planar")
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
        parent, child = (e.get("link", "") if (e := joint.find(tag)) is not None else "" for tag in ("parent", "child"))
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
