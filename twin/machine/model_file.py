"""Model files from unknown sources: read safely, and refused in one line if they are not a tree of slides and hinges.

An MJCF or URDF is XML that names further files. It is parsed without entities and external references (defusedxml), and every
file that it names must exist inside the folder of the model. Features that a machine of axes cannot have (free and ball joints,
closed loops, moving bodies without mass) are refused before MuJoCo reads the file.
"""

from __future__ import annotations

from collections.abc import Iterator
import hashlib
import math
import os
from pathlib import Path
import re
import shutil
import time
from typing import TYPE_CHECKING

from twin.documents import named_file
from twin.errors import InputError, no_file
from twin.files import beside
from twin.machine.model_limits import check_depth, check_size

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

LARGEST_BYTES = 50_000_000
"""Largest MJCF or URDF [bytes], without the meshes that it names."""

MOST_ATTACHED = 4
"""Most levels of models that attach models."""

_ASSET_FOLDERS = {"mesh": "meshdir", "skin": "meshdir", "hfield": "texturedir", "texture": "texturedir"}
_LOOPS = ("connect", "weld")


def read_xml(path: Path) -> Element:
    """Root element of an XML file. Document types, entities and external references are refused."""
    from defusedxml import DefusedXmlException
    from defusedxml.ElementTree import ParseError, parse

    if not path.is_file():
        raise no_file(path, "give an MJCF or a URDF")
    _check_encoding(path)
    if path.stat().st_size > LARGEST_BYTES:
        raise InputError(f"{path}: {path.stat().st_size / 1e6:.0f} MB is too large for a machine; move meshes into files of their own")
    try:
        root: Element = parse(str(path), forbid_dtd=True).getroot()
    except DefusedXmlException as error:
        what = type(error).__name__.replace("Forbidden", "").replace("DTD", "a document type").replace("Entities", "entities")
        raise InputError(f"{path}: holds {what}, which can read other files or fill the memory; remove the <!DOCTYPE ...>") from None
    except (ParseError, OSError, UnicodeError, ValueError, LookupError, RecursionError) as error:
        raise InputError(f"{path}: not readable XML ({error}); correct it") from None
    check_depth(root, path)
    return root


def _check_encoding(path: Path) -> None:
    """Refuse an encoding that another parser might read differently: MuJoCo reads every file as UTF-8."""
    with path.open("rb") as file:
        head = file.read(200)
    said = re.match(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)[\"']", head.removeprefix(b"\xef\xbb\xbf"))
    if (
        b"\0" in head
        or head[:2] in (b"\xff\xfe", b"\xfe\xff")
        or (said and said[1].lower() not in (b"utf-8", b"utf8", b"us-ascii", b"ascii"))
    ):
        raise InputError(f"{path}: not written in UTF-8; save it as UTF-8 and declare that in its first line, or omit the encoding")


def check_mjcf(path: Path) -> Element:
    """Refuse an MJCF that is unsafe or not a tree of slides and hinges. Returns its root with all includes expanded."""
    root = check_safe(path)
    for tag in ("model", "attach"):
        if root.find(f".//{tag}") is not None:
            raise InputError(f"{path}: <{tag}> attaches another model; write the parts of a machine into one file")
    # others of the same name are of a sensor or an equality
    joints = [joint.get("name") for world in root.findall("worldbody") for joint in world.iter("joint")]
    if twice := next((name for name in joints if name and joints.count(name) > 1), None):
        raise InputError(f"{path}: two joints are named '{twice}'; rename one")
    for body in root.iter("body"):
        name = body.get("name", "without name")
        kinds = [joint.get("type", "") for joint in body.findall("joint")]
        if body.find("freejoint") is not None or "free" in kinds:
            raise InputError(f"{path}: body '{name}' is free, but a machine stands on its bed; remove the free joint")
        if "ball" in kinds:
            raise InputError(f"{path}: body '{name}' turns on a ball joint, but an axis is a slide or a hinge; use three hinges or none")
        for element in (*body.findall("inertial"), *body.findall("geom")):
            for key in ("mass", "diaginertia"):
                for value in element.get(key, "").split():
                    positive_mass(value, f"{path}: body '{name}': {key}", zero=element.tag == "geom")
    for equality in root.iter("equality"):
        for loop in (child for tag in _LOOPS for child in equality.findall(tag)):
            raise InputError(
                f"{path}: <{loop.tag}> closes a loop of bodies, but a machine is a tree of axes; remove it, or model one side of the loop"
            )
        if len(equality):
            raise InputError(f"{path}: <{equality[0].tag}> couples joints, but each axis has its own drive; remove it")
    if root.find("tendon") is not None and len(root.find("tendon") or ()):
        raise InputError(f"{path}: tendons cannot be axes; drive the joints themselves")
    return root


def check_safe(path: Path, seen: tuple[Path, ...] = ()) -> Element:
    """Refuse an MJCF that reads other folders or is too large. Returns its root with all includes expanded.

    `seen`: the models that attach this one.
    """
    root = read_xml(path)
    if root.tag != "mujoco":
        raise InputError(
            f"{path}: <{str(root.tag)[:40]}> is not an MJCF; convert a URDF with: twin machine new {path.name} --out machine.toml"
        )
    _include(root, path, [path.resolve()])
    for file in _named_files(root, path):
        named_file(str(file), path.parent, str(path))
    for child in root.iter("model"):
        if (name := child.get("file")) is not None:
            attached = named_file(name, path.parent, str(path))
            if attached.resolve() in (path.resolve(), *seen):
                raise InputError(f"{path}: <model file='{name}'> attaches the model to itself; remove the circle")
            if len(seen) >= MOST_ATTACHED:
                raise InputError(f"{path}: models attach each other more than {MOST_ATTACHED} deep; put them into one")
            check_safe(attached, (*seen, path.resolve()))
    check_size(root, path)
    return root


def files_of(path: Path) -> list[Path]:
    """The files that an MJCF names, relative to its folder, checked."""
    root = read_xml(path)
    _include(root, path, [path.resolve()], keep=True)
    included = [Path(e.get("file", "")) for e in root.iter("include")]
    return list(dict.fromkeys([*included, *_named_files(root, path)]))


SETTLED_NS = 2_000_000_000
"""A file that has not changed for so long before it was read has another stamp once it changes, however coarse the clock of its disk is [ns]."""


def state_of_model(path: Path) -> bytes:
    """Digest of an MJCF and the files that it names: equal while none of them changes. Meshes count by size and time of change."""
    names, stamps, state = _known_states.get(path, ((), (), b""))
    if not state or stamps != _stamps(names):
        asked = time.time_ns()
        try:
            named = files_of(path)
        except InputError:  # reported where the model is checked
            named = []
        names = tuple(str(path.parent / file) for file in (Path(path.name), *named))
        stamps, digest = _stamps(names), hashlib.sha256()
        for name, stamp in zip(names, stamps):
            is_text = name.lower().endswith(".xml") and os.path.isfile(name)
            digest.update((Path(name).read_bytes() if is_text else f"{name} {stamp and stamp[:2]}".encode()) + b"\0")
        state = digest.digest()
        settled = all(stamp is None or max(stamp[1:3]) < asked - SETTLED_NS for stamp in stamps)
        _known_states[path] = names, stamps, state if settled else b""
    return state


_known_states: dict[Path, tuple[tuple[str, ...], tuple[tuple[int, ...] | None, ...], bytes]] = {}
"""Model -> its files, their stamps, and their digest, empty if one changed just before. Every simulation asks for it several times."""


def _stamps(names: tuple[str, ...]) -> tuple[tuple[int, ...] | None, ...]:
    """Size, times of change and identity of each file, None for a missing one."""

    def stamp(name: str) -> tuple[int, ...] | None:
        try:
            about = os.stat(name)
        except OSError:
            return None
        return about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino

    return tuple(map(stamp, names))


def copy_model(path: Path, folder: Path) -> None:
    """Copy an MJCF and the files that it names to the same relative places below `folder`."""
    for file in (Path(path.name), *files_of(path)):
        target = folder / file
        if target.resolve() != (path.parent / file).resolve():
            with beside(target) as partial:
                shutil.copyfile(path.parent / file, partial)


def _include(element: Element, path: Path, seen: list[Path], keep: bool = False) -> None:
    """Replace each include by the children of its file. `seen`: files included so far."""
    for child in list(element):
        if child.tag == "include":
            file = named_file(child.get("file", ""), path.parent, str(path))
            if file.resolve() in seen:
                raise InputError(f"{path}: '{file.name}' includes itself or is included twice; include it once")
            seen.append(file.resolve())
            included = read_xml(file)
            _include(included, path, seen, keep)
            at = list(element).index(child)
            if not keep:
                element.remove(child)
            for i, grandchild in enumerate(included):
                element.insert(at + i + keep, grandchild)
        else:
            _include(child, path, seen, keep)


def _named_files(root: Element, path: Path) -> Iterator[Path]:
    """Meshes, textures and height fields that an MJCF names, relative to its folder."""
    folders: dict[str, str] = {}
    for compiler in root.iter("compiler"):
        common = compiler.get("assetdir")
        for kind in ("meshdir", "texturedir"):
            if value := compiler.get(kind, common):
                folders[kind] = value
        if compiler.get("strippath", "false") == "true":
            raise InputError(f"{path}: strippath hides the folders of files; write their full paths and remove it")
    for flexible in root.iter("flexcomp"):
        if name := flexible.get("file"):
            yield Path(folders.get("meshdir", "")) / name
    for asset in root.iter("asset"):
        for child in asset:
            for key in ("file", "fileright", "fileleft", "fileup", "filedown", "filefront", "fileback"):
                if name := child.get(key):
                    yield Path(folders.get(_ASSET_FOLDERS.get(child.tag, ""), "")) / name
    for plugin in root.iter("plugin"):
        raise InputError(f"{path}: plugin '{plugin.get('plugin', '')}' runs foreign code; remove it")


def positive_mass(text: str, where: str, zero: bool = False) -> None:
    """Refuse an impossible mass or moment of inertia. `zero`: allow 0, for a shape without mass."""
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where} = '{text}' is not a number; correct it") from None
    if not math.isfinite(value) or value < 0.0 or (value == 0.0 and not zero):
        raise InputError(f"{where} = {value:g} is impossible; give {'a number of at least' if zero else 'a number above'} 0")
