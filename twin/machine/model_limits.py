"""Limits on a model file before MuJoCo reads it: elements, depth, and the size of what one attribute can generate.

MuJoCo allocates what the file asks for (`<replicate count>`, `<hfield nrow>`, `<texture width>`, `<size memory>`), and a model that
attaches itself ends the process. This module counts first. Files that the model names can still be damaged, so a model that
names files or generates parts is first compiled in a process of its own with limits on memory and time (`compiles`).
"""

from __future__ import annotations

import functools
import math
from pathlib import Path
import threading
from typing import TYPE_CHECKING
import warnings

from twin.errors import InputError
from twin.limits import refuse_above
from twin.system import tried

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    import mujoco

MOST_ELEMENTS = 20_000
"""Elements of a model, copies by <replicate> included."""
MOST_JOINTS = 300
"""MuJoCo's matrices grow with the square of the number of joints."""
DEEPEST = 150
"""Depth of nested elements."""
MOST_VALUES = 20_000_000
"""Values that one element may generate: heights of a field, pixels of a texture, cells of a table."""
TRIAL_BYTES = 6_000_000_000
TRIAL_SECONDS = 30
TRIAL = """
import sys
import mujoco
try:
    mujoco.MjSpec.from_file(sys.argv[1]).compile()
except MemoryError:
    sys.exit(3)
except Exception:
    sys.exit(0)  # the calling process reports the error
"""


@functools.cache
def quiet_engine() -> None:
    """Keep MuJoCo's warnings off standard error and out of MUJOCO_LOG.TXT.

    They remain in `MjData.warning`, which `refuse_singular` and the limits of a run check.
    """
    import mujoco

    config = mujoco.MjLogConfig()
    config.logto_console = config.logto_file = False
    mujoco.MjLogConfig.set(config)


_COMPILING = threading.Lock()
"""The filter of warnings belongs to the process: threads that compile at the same time would restore each other's."""


def compiled_spec(spec: mujoco.MjSpec, where: str) -> mujoco.MjModel:
    """Compile a spec. Raises InputError in one line. Warnings about masses are ignored here; `refuse_singular` names the joint."""
    import mujoco

    try:
        with _COMPILING, warnings.catch_warnings(action="ignore"):
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{where}: MuJoCo cannot compile the model: {' '.join(str(error).split())}; correct the file") from None


def refuse_singular(model: mujoco.MjModel, data: mujoco.MjData, where: str) -> None:
    """Refuse a state whose inertia matrix MuJoCo could not factor, and name the joint. Call it after `mj_forward`."""
    import mujoco

    warning = data.warning[mujoco.mjtWarning.mjWARN_INERTIA]
    if warning.number:
        joint = model.joint(int(model.dof_jntid[warning.lastinfo]))
        raise InputError(
            f"{where}: joint '{joint.name}' of body '{model.body(model.jnt_bodyid[joint.id]).name}' moves no inertia of its own "
            "(two joints of one axis, or a mass far too small beside others); correct it"
        )


_GENERATING = ("replicate", "composite", "flexcomp", "attach")
_TABLES = {
    "hfield": ("nrow", "ncol"),
    "texture": ("width", "height"),
    "composite": ("count",),
    "flexcomp": ("count",),
    "numeric": ("size",),
    "camera": ("resolution",),
    "sensor": ("dim", "nsample"),
    "user": ("dim",),
}
"""Attributes whose product is the number of values that an element generates."""


def check_size(root: Element, path: Path) -> None:
    """Refuse a model (includes expanded) that is too large; the message gives the size and the limit."""
    check_depth(root, path)
    elements, joints, waiting = 0.0, 0.0, [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        _check_values(element, path)
        if element.tag == "replicate":
            copies *= max(_number(element.get("count", "1"), f"{path}: <replicate>: count"), 1.0)
        if element.tag in ("composite", "flexcomp"):
            copies *= math.prod(max(v, 1.0) for v in numbers_of(element.get("count", "1"), f"{path}: <{element.tag}>: count"))
            elements += copies
        elements += copies
        joints += copies * (element.tag in ("joint", "freejoint"))
        waiting += [(child, copies) for child in element]
    refuse_above(elements, MOST_ELEMENTS, "elements with all copies", str(path), "remove parts that do not belong to the machine")
    refuse_above(joints, MOST_JOINTS, "joints", str(path), "remove joints that are not axes")


def check_depth(root: Element, path: Path) -> None:
    """Refuse elements that are nested too deeply for the readers."""
    level, depth = [root], 0
    while level:
        if depth > DEEPEST:
            raise InputError(f"{path}: elements nested more than {DEEPEST} deep; no machine needs that: correct it")
        level, depth = [child for element in level for child in element], depth + 1


def compiles(path: Path, root: Element) -> None:
    """Refuse a model that crashes MuJoCo, fills the memory or never finishes. A model without files or generated parts is not tried."""
    plain = all(e.tag not in _GENERATING and not any(k.startswith("file") for k in e.attrib) for e in root.iter())
    if plain:
        return
    trial = tried(TRIAL, str(path.resolve()), most_bytes=TRIAL_BYTES, seconds=TRIAL_SECONDS, cwd=path.resolve().parent)
    code = trial.returncode if trial is not None else -1
    if code == 3:
        raise InputError(
            f"{path}: the engine needs more than {TRIAL_BYTES / 1e9:.0f} GB for this model; make its meshes and pictures smaller"
        )
    if code != 0:
        raise InputError(
            f"{path}: the engine crashes on this model or needs more than {TRIAL_SECONDS} s for it; keep only plain bodies, joints and meshes"
        )


def _check_values(element: Element, path: Path) -> None:
    """Refuse one element that generates too many values, and attributes that are not finite numbers."""
    sizes = [numbers_of(element.get(key, "1"), f"{path}: <{element.tag}>: {key}") for key in _TABLES.get(str(element.tag), ())]
    total = math.prod(max(v, 1.0) for values in sizes for v in values)
    refuse_above(total, MOST_VALUES, "values", f"{path}: <{element.tag}>", "make it smaller")
    if element.tag == "size":
        for key, text in element.items():
            if key == "memory":
                number, unit = text.strip()[:-1], text.strip()[-1:].upper()
                scale = {"K": 2.0**10, "M": 2.0**20, "G": 2.0**30, "T": 2.0**40, "P": 2.0**50, "E": 2.0**60}.get(unit)
                value = _number(number, f"{path}: <size>: memory") * scale if scale else _number(text, f"{path}: <size>: memory")
                refuse_above(value, 1e9, "bytes of memory", f"{path}: <size>", "leave it out: the engine finds its own")
            else:
                value = _number(text, f"{path}: <size>: {key}")
                refuse_above(value, 1e6 if not key.startswith("nuser") else 1e3, key, f"{path}: <size>", "leave it out")
    if element.get("builtin") is not None and element.tag == "mesh":
        corners = math.prod(max(v, 1.0) for v in numbers_of(element.get("params", "1"), f"{path}: <mesh>: params"))
        refuse_above(corners, 1e5, "corners", f"{path}: <mesh builtin>", "make it coarser")
    for key, text in [item for item in element.items() if item[0] not in _NAMES]:
        if text.strip().lower().lstrip("+-") in ("nan", "inf", "infinity"):
            raise InputError(f"{path}: <{element.tag}>: {key} = '{text}' is not a finite number; correct it")
        if any(word.lower().lstrip("+-") == "nan" for word in text.split()):
            raise InputError(f"{path}: <{element.tag}>: {key} = '{text[:60]}' contains NaN; correct it")


_NAMES = ("name", "class", "childclass", "model", "file", "data", "joint", "body", "site", "material", "mesh", "prefix", "text")
"""Attributes that contain text."""


def numbers_of(text: str, where: str) -> list[float]:
    """The numbers of an attribute. Raises InputError for other words and for numbers that are not finite."""
    return [_number(word, where) for word in text.split()]


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where} = '{text[:60]}' is not a number; correct it") from None
    if not math.isfinite(value):
        raise InputError(f"{where} = '{text[:60]}' is not a finite number; correct it")
    return value
