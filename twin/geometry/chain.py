"""The kinematic chain of a machine from its model: the joints that carry the tool and the part, and the axis letters of programs.

The order of the joints between workpiece and tool decides whether a rotary axis turns the part (table) or the tool (head); names do
not matter. The axis letters of programs are the first letters of the axis names, or those in [program.axes] of the machine file:
`B = "TILT"`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine

if TYPE_CHECKING:
    import mujoco

LINEAR_LETTERS, ROTARY_LETTERS = "XYZ", "ABC"


class Joint(NamedTuple):
    """One joint of the chain at rest: name ('' of a missing axis), direction (3,), anchor (3,), rotary or not, on the table side or not."""

    name: str
    axis: np.ndarray
    anchor: np.ndarray
    turns: bool
    on_table: bool


def frames_at_rest(machine: Machine, sites_needed: bool = True) -> Mapping[str, Any]:
    """The fields of `Kinematics` except its travel, from the model with all axes at zero. A machine of slides alone may lack the sites.

    Raises:
    InputError: the joints between workpiece and tool are not up to three slides followed by up to two hinges on either side.
    """
    import mujoco  # imported here, because command-line help needs no engine

    from twin.simulation.plant_spec import frames_of_model

    model_path = machine.model_path
    model = frames_of_model(machine)
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    sites = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, name) for name in ("tool", "workpiece")}
    joints = _joints(model, data, sites, machine, sites_needed)
    slides, turns = [j for j in joints if not j.turns], [j for j in joints if j.turns]
    if len(slides) > 3 or len(turns) > 2:
        raise InputError(
            f"{model_path}: not a machine of up to three slides and two rotary axes between part and tool: "
            f"found {', '.join(j.name for j in joints)}; lock joints that programs do not move"
        )
    letters = _letters(joints, machine)
    columns, names, own = np.eye(3), [""] * 5, list(LINEAR_LETTERS)
    for joint, i in zip(slides, _places_in_xyz(slides, letters)):
        columns[:, i] = -joint.axis if joint.on_table else joint.axis
        names[i], own[i] = joint.name, letters[joint.name]
    # the turning axis is nearest to the part; a single rotary axis is the turning axis
    missing = [Joint("", np.array(axis), np.zeros(3), True, True) for axis in ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])]
    turn, tilt = [*turns, *missing[len(turns) :]]
    names[3:] = tilt.name, turn.name
    free = [letter for letter in "ACB" if letter not in {letters[j.name] for j in turns}]  # a missing rotary axis gets an unused letter
    return {
        "slides": columns,
        "tilt": tilt,
        "turn": turn,
        "names": tuple(names),
        "letters": (*own, *(letters[j.name] if j.name else free.pop(0) for j in (tilt, turn))),
        **_tool_and_part(model, data, sites, machine),
    }


def _joints(model: mujoco.MjModel, data: mujoco.MjData, sites: Mapping[str, int], machine: Machine, sites_needed: bool) -> list[Joint]:
    """Joints of axes, in order from the part to the tool."""
    where = machine.model_path
    if min(sites.values()) < 0:
        if sites_needed or any(axis.kind == "rotary" for axis in machine.axes):
            missing = next(name for name, number in sites.items() if number < 0)
            raise InputError(f"{where}: no site '{missing}'; the five-axis transformation needs the sites tool and workpiece")
        found = [_joint(model, data, j, False) for j in range(model.njnt)]
        return [j for j in found if j.name in machine.axis_names]
    part, tool = (_chain(model, data, sites[name], machine, on_table=name == "workpiece") for name in ("workpiece", "tool"))
    for side in (part, tool):
        kinds = [joint.turns for joint in side]  # from the part or the tool towards the bed
        if kinds != sorted(kinds, reverse=True):
            raise InputError(
                f"{where}: a slide is carried by a rotary axis ({', '.join(j.name for j in side)} from the "
                f"{'part' if side is part else 'tool'} on), which the transformation does not cover; hang the rotary axes on the slides"
            )
    return [*part, *reversed(tool)]


def _tool_and_part(model: mujoco.MjModel, data: mujoco.MjData, sites: Mapping[str, int], machine: Machine) -> dict[str, Any]:
    """Tool tip, tool axis and length, and the part frame, at rest. Without the sites: a tool along z, all at the origin."""
    tip, tool_axis, part_origin, part_axes, carrier_to_tip = np.zeros(3), np.array([0.0, 0.0, 1.0]), np.zeros(3), np.eye(3), 0.0
    if min(sites.values()) >= 0:
        tool, part = sites["tool"], sites["workpiece"]
        tip, tool_axis = data.site_xpos[tool].copy(), data.site_xmat[tool].reshape(3, 3)[:, 2].copy()
        part_origin, part_axes = data.site_xpos[part].copy(), data.site_xmat[part].reshape(3, 3).copy()
        # if the file omits the tool length, the origin of the tool's body is the spindle nose
        carrier_to_tip = float((data.xpos[model.site_bodyid[tool]] - tip) @ tool_axis)
    return {
        "tool_tip": tip,
        "tool_axis": tool_axis,
        "tool_length": machine.geometry.get("tool_length_m", carrier_to_tip),
        "part_origin": part_origin,
        "part_axes": part_axes,
    }


def _chain(model: mujoco.MjModel, data: mujoco.MjData, site: int, machine: Machine, *, on_table: bool) -> list[Joint]:
    """Joints of axes between a site and the bed, from the site outwards."""
    numbers, body = [], model.site_bodyid[site]
    while body:
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        numbers += list(range(first + count - 1, first - 1, -1))
        body = model.body_parentid[body]
    found = [_joint(model, data, j, on_table) for j in numbers]
    own = [j for j in found if j.name in machine.document["axis"]]
    return own or found  # programs do not move a spindle or a door


def _joint(model: mujoco.MjModel, data: mujoco.MjData, j: int, on_table: bool) -> Joint:
    import mujoco

    name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint {j}"
    return Joint(name, data.xaxis[j].copy(), data.xanchor[j].copy(), model.jnt_type[j] == mujoco.mjtJoint.mjJNT_HINGE, on_table)


def _letters(joints: list[Joint], machine: Machine) -> dict[str, str]:
    """Letter of each axis in programs: from [program.axes], else the first letter of the name, else by direction."""
    program = machine.document.get("program", {})
    given = program.get("axes", {}) if isinstance(program, Mapping) else {}
    where = f"{machine.where}: [program.axes]"
    if not isinstance(given, Mapping):
        raise InputError(f'{where}: write a table of letters and axes, e.g. B = "TILT"')
    by_name = {j.name: j for j in joints}
    letters: dict[str, str] = {}
    for letter, name in given.items():
        if len(letter) != 1 or letter.upper() not in "XYZABCUVW" or name not in by_name:
            raise InputError(
                f"{where}: {letter} = '{name}': give one of the letters X Y Z U V W A B C and one of the axes {', '.join(by_name)}"
            )
        letters[name] = letter.upper()
    for kind, own in ((False, "XYZUVW"), (True, ROTARY_LETTERS)):
        rest = [j for j in joints if j.turns == kind and j.name not in letters]
        for joint in rest:
            first = joint.name[0].upper()
            if first in own and first not in letters.values() and sum(j.name[0].upper() == first for j in rest) == 1:
                letters[joint.name] = first
        for joint in rest:
            if joint.name not in letters:  # by its direction
                order = np.argsort(-np.abs(joint.axis))
                free = [own[i] for i in order if own[i] not in letters.values()]
                letters[joint.name] = free[0]
    return letters


def _places_in_xyz(slides: list[Joint], letters: dict[str, str]) -> list[int]:
    """Index 0, 1, 2 (X, Y, Z) of each slide: by its letter, or by its direction if its letter is another one."""
    places = {j.name: LINEAR_LETTERS.index(letters[j.name]) for j in slides if letters[j.name] in LINEAR_LETTERS}
    for joint in slides:
        if joint.name not in places:
            places[joint.name] = next(int(i) for i in np.argsort(-np.abs(joint.axis)) if int(i) not in places.values())
    return [places[joint.name] for joint in slides]
