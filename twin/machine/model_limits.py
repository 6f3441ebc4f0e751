"""How large a model file may be before the engine sees it: elements, depth, and what a single attribute makes of nothing.

The engine takes memory by what a file says (`<replicate count>`, `<hfield nrow>`, `<texture width>`, `<size memory>`) and follows a
model that attaches itself until the process ends. Here all of it is counted first. What a file names can still be damaged: a model that
names files or generates parts is compiled once in a process of its own, with limits on memory and time (`compiles`).
"""

from __future__ import annotations

import functools
import math
import os
from pathlib import Path
import subprocess
import sys
from typing import TYPE_CHECKING
import warnings

from twin.errors import InputError
from twin.limits import refuse_above

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

    import mujoco

MOST_ELEMENTS = 20_000
"""Elements of a model with all that its <replicate> make."""
MOST_JOINTS = 300
"""The engine's matrices grow with the square of the joints, a step with more."""
DEEPEST = 150
"""Bodies inside bodies."""
MOST_VALUES = 20_000_000
"""Heights of a field, pixels of a picture, cells of a table: what one element may make."""
TRIAL_BYTES = 6_000_000_000
TRIAL_SECONDS = 30
TRIAL = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[2]),) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[3]),) * 2)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except ImportError:
    pass  # no such limits on this system
import mujoco
try:
    mujoco.MjSpec.from_file(sys.argv[1]).compile()
except MemoryError:
    sys.exit(3)
except Exception:
    sys.exit(0)  # said by the process that asked, with its place
"""


@functools.cache
def quiet_engine() -> None:
    """Keep the engine's own warnings off standard error and out of MUJOCO_LOG.TXT in the current folder.

    They stay in `MjData.warning`, where `refuse_singular` and the bounds of a run look.
    """
    import mujoco

    config = mujoco.MjLogConfig()
    config.logto_console = config.logto_file = False
    mujoco.MjLogConfig.set(config)


def compiled_spec(spec: mujoco.MjSpec, where: str) -> mujoco.MjModel:
    """Compile a spec; errors in one line that says where. What the engine warns of (masses) is none: `refuse_singular` names the joint where it counts."""
    import mujoco

    try:
        with warnings.catch_warnings(action="ignore"):
            return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise InputError(f"{where}: MuJoCo cannot compile the model: {' '.join(str(error).split())}; correct the file") from None


def refuse_singular(model: mujoco.MjModel, data: mujoco.MjData, where: str) -> None:
    """Refuse a state whose inertia matrix the engine could not factor, naming the joint; call it behind `mj_forward`."""
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
"""Attributes whose product is the number of values that an element makes."""


def check_size(root: Element, path: Path) -> None:
    """Refuse a model, with all its includes in place, that is too large for the engine, with the estimate and the limit."""
    check_depth(root, path)
    elements, joints, waiting = 0.0, 0.0, [(root, 1.0)]
    while waiting:
        element, copies = waiting.pop()
        _check_values(element, path)
        if element.tag == "replicate":
            copies *= max(_number(element.get("count", "1"), f"{path}: <replicate>: count"), 1.0)
        if element.tag in ("composite", "flexcomp"):
            copies *= math.prod(max(v, 1.0) for v in _numbers(element.get("count", "1"), f"{path}: <{element.tag}>: count"))
            elements += copies
        elements += copies
        joints += copies * (element.tag in ("joint", "freejoint"))
        waiting += [(child, copies) for child in element]
    refuse_above(elements, MOST_ELEMENTS, "elements with all copies", str(path), "leave out what is no part of the machine")
    refuse_above(joints, MOST_JOINTS, "joints", str(path), "leave out what is no axis")


def check_depth(root: Element, path: Path) -> None:
    """Refuse elements inside each other that no reader behind this one follows."""
    level, depth = [root], 0
    while level:
        if depth > DEEPEST:
            raise InputError(f"{path}: elements inside each other more than {DEEPEST} deep; a machine is no such chain: correct it")
        level, depth = [child for element in level for child in element], depth + 1


def compiles(path: Path, root: Element) -> None:
    """Refuse a model on which the engine crashes, fills the memory or takes for ever; a model that is plain needs no trial."""
    plain = all(e.tag not in _GENERATING and not any(k.startswith("file") for k in e.attrib) for e in root.iter())
    if plain:
        return
    command = [sys.executable, "-c", TRIAL, str(path.resolve()), str(TRIAL_BYTES), str(TRIAL_SECONDS)]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    try:
        code = subprocess.run(
            command, capture_output=True, check=False, timeout=4 * TRIAL_SECONDS, env={**os.environ, **threads}, cwd=path.resolve().parent
        ).returncode
    except subprocess.TimeoutExpired:
        code = -1
    if code == 3:
        raise InputError(
            f"{path}: the engine needs more than {TRIAL_BYTES / 1e9:.0f} GB for this model; make its meshes and pictures smaller"
        )
    if code != 0:
        raise InputError(
            f"{path}: the engine crashes on this model or needs more than {TRIAL_SECONDS} s for it; remove what is no plain body, joint or mesh"
        )


def _check_values(element: Element, path: Path) -> None:
    """Refuse what one element makes by a number alone, and numbers that are none."""
    sizes = [_numbers(element.get(key, "1"), f"{path}: <{element.tag}>: {key}") for key in _TABLES.get(str(element.tag), ())]
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
        corners = math.prod(max(v, 1.0) for v in _numbers(element.get("params", "1"), f"{path}: <mesh>: params"))
        refuse_above(corners, 1e5, "corners", f"{path}: <mesh builtin>", "make it coarser")
    for key, text in element.items():
        if key not in _NAMES and text.strip().lower().lstrip("+-") in ("nan", "inf", "infinity"):
            raise InputError(f"{path}: <{element.tag}>: {key} = '{text}' is no finite number; correct it")
        if key not in _NAMES and any(word.lower().lstrip("+-") == "nan" for word in text.split()):
            raise InputError(f"{path}: <{element.tag}>: {key} = '{text[:60]}' holds a number that is none (NaN); correct it")


_NAMES = ("name", "class", "childclass", "model", "file", "data", "joint", "body", "site", "material", "mesh", "prefix", "text")
"""Attributes that hold words."""


def _numbers(text: str, where: str) -> list[float]:
    return [_number(word, where) for word in text.split()]


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{where} = '{text[:60]}' is no number; correct it") from None
    if not math.isfinite(value):
        raise InputError(f"{where} = '{text[:60]}' is no finite number; correct it")
    return value
