"""The tables of a machine file: checks, and changes by path.

A path uses the key names of a screw or gear axis with a servo motor: `axis.X.motor.torque_constant_nm_per_a`. `in_file` translates
it to the keys and units of the file, which differ for actuators, direct drives and SINUMERIK machine data. Tables are never
changed in place: a changed document shares all unchanged tables.
"""

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from twin.control.actuator import EFFORTS, SPEED_GAIN, gain_factor
from twin.control.number import si_from_key
from twin.documents import value_at
from twin.errors import InputError, nearest
from twin.machine import keys, sinumerik
from twin.machine.axis import Axis, word_in
from twin.machine.parameters import typed_from_file
from twin.tables import is_number

TABLES = ("name", "structure", "model", "axis_order", "driven_axes", "control", "geometry", "axis", "body", "measurement", "effect", "frame", "tool", "identified", "variables", "program")  # fmt: skip
"""Keys and tables of a machine file besides `keys.TOP`."""

LONGEST_CYCLE, MOST_TICKS = 1.0, 1_000_000
"""Longest cycle of a control [s], and most ticks of the shortest cycle in another one (matrices are multiplied that often)."""


def check_document(document: Mapping[str, Any], where: str) -> None:
    """Check every table except those of the axes. Raises InputError that names the table, the key and the remedy."""
    keys.check_table(document, keys.TOP, where, TABLES)
    if not isinstance(document.get("name", ""), str):
        raise InputError(f"{where}: name = {document['name']!r} is not text; write it in quotes")
    for table, known in (("control", keys.CONTROL), ("geometry", keys.GEOMETRY), ("measurement", keys.MEASUREMENT)):
        if table not in document and table != "geometry":
            raise InputError(f"{where}: table [{table}] is missing; add it")
        also = ("setpoint_interpolation",) if table == "control" else ()
        keys.check_table(document.get(table, {}), known, f"{where}: [{table}]", also)
    word_in(document["control"], "setpoint_interpolation", keys.INTERPOLATIONS, f"{where}: [control]")
    axes = document.get("axis")
    if not isinstance(axes, dict) or not axes:
        raise InputError(f"{where}: no [axis.NAME] table; describe at least one axis")
    order = document.get("axis_order", list(axes))
    if not isinstance(order, list) or sorted(map(str, order)) != sorted(axes):
        raise InputError(f"{where}: axis_order = {order} does not list the axes {', '.join(axes)}; name each of them once")
    driven = document.get("driven_axes", order)
    if not isinstance(driven, list) or not driven or not set(map(str, driven)) <= set(axes):
        raise InputError(f"{where}: driven_axes = {driven}; name axes of this machine: {', '.join(axes)}")
    if not isinstance(document.get("effect", []), list):
        raise InputError(f"{where}: 'effect' must be a list of tables; write [[effect]]")
    for table, known, example in (
        ("tool", keys.TOOL, "[tool.T1] and below it length_m"),
        ("body", keys.BODY, "[body.NAME] and below it mass_kg"),
    ):
        entries = document.get(table, {})
        if not isinstance(entries, dict) or not all(isinstance(entry, dict) for entry in entries.values()):
            raise InputError(f"{where}: '{table}' must hold one table for each {table}; write {example}")
        for name, entry in entries.items():
            keys.check_table(entry, known, f"{where}: [{table}.{name}]")
    for name, body in document.get("body", {}).items():
        i = np.array(body["inertia_kg_m2"], float)
        if np.any(i > i.sum() - i + 1e-12):
            raise InputError(
                f"{where}: [body.{name}]: inertia_kg_m2 = {body['inertia_kg_m2']}: a principal inertia cannot exceed the sum of the other two; correct it"
            )
    _check_for_programs(document, where)


def _check_for_programs(document: Mapping[str, Any], where: str) -> None:
    """Check what programs read from the machine file: [variables], and [program] with the calls that move no axis."""
    variables = document.get("variables", {})
    if not isinstance(variables, dict) or not all(isinstance(v, int | float | str) for v in variables.values()):
        raise InputError(f'{where}: each variable in [variables] must be a number or a text; write "$MC_EXAMPLE" = 1.0')
    program = document.get("program", {})
    keys.check_table(program, {}, f"{where}: [program]", ("calls_without_motion", "axes", "feed_mm_min"))
    feed = program.get("feed_mm_min", 1.0)
    if not is_number(feed) or not feed > 0:
        raise InputError(f"{where}: [program]: feed_mm_min must be a number above 0; write the feed before the first F")
    calls = program.get("calls_without_motion", [])
    if not isinstance(calls, list) or not all(isinstance(name, str) for name in calls):
        raise InputError(f'{where}: [program]: calls_without_motion must be a list of names; write ["TOOLCHECK"]')


def check_cycles(document: Mapping[str, Any], axes: tuple[Axis, ...], where: str) -> None:
    """A current loop needs a cycle, and every cycle must be a whole multiple of the shortest one."""
    control = document["control"]
    for axis in axes:
        if axis.actuator.cycle and axis.actuator.cycle not in control:
            raise InputError(f"{where}: [control]: '{axis.actuator.cycle}' is missing; add it, axis {axis.name} has a current loop")
    cycles = {name: cycle for name, cycle in cycles_of(document).items() if name != "interpolation_cycle"}
    shortest = min(cycles.values())
    for name, cycle in cycles.items():
        if not LONGEST_CYCLE / MOST_TICKS <= cycle <= LONGEST_CYCLE:
            raise InputError(
                f"{where}: [control]: {name}_us = {cycle * 1e6:g}: no control has such a cycle; "
                f"give {LONGEST_CYCLE / MOST_TICKS * 1e6:g} to {LONGEST_CYCLE * 1e6:g}"
            )
        if abs(cycle / shortest - round(cycle / shortest)) > 1e-6:
            raise InputError(
                f"{where}: [control]: {name}_us is not a whole multiple of the shortest cycle ({shortest * 1e6:g} us); change it"
            )


LONGEST_TICK = 125e-6
"""Longest tick [s] of a machine without current loops; sticking friction needs a short tick."""


def cycles_of(document: Mapping[str, Any]) -> dict[str, float]:
    """Cycles of the control [s], with defaults for omitted ones: current_cycle, speed_cycle, position_cycle, interpolation_cycle."""
    control = {k: v * si_from_key(k) for k, v in document["control"].items() if k in keys.CONTROL}
    speed, position = control["speed_cycle_us"], control["position_cycle_us"]
    current = control.get("current_cycle_us", speed / max(math.ceil(speed / LONGEST_TICK - 1e-9), 1))
    return {
        "current_cycle": current,
        "speed_cycle": speed,
        "position_cycle": position,
        "interpolation_cycle": control.get("interpolation_cycle_us", position),
    }


def changed(document: Mapping[str, Any], values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The document with other values by path. Raises InputError for a path through a table that does not exist."""
    out = dict(document)
    for asked, value in values.items():
        if asked.startswith("axis.") and asked.count(".") > 1:
            out = _without_contradicting_data(out, asked)
        path, number = in_file(out, asked, value)
        *tables, key = path.split(".")
        table: Any = out
        for i, name in enumerate(tables):
            # tables of the file and tables below an axis may be added; their keys are checked with the whole document
            new: dict[str, Any] | None = {} if (i == 0 and name in TABLES) or (i > 1 and tables[0] == "axis") else None
            if not isinstance(inner := table.get(name, new), dict):
                raise InputError(f"machine {where}: no '{'.'.join(tables[: i + 1])}'; {nearest(name, table)}")
            table[name] = table = dict(inner)
        table[key] = number
    return out


def in_file(document: Mapping[str, Any], path: str, value: Any) -> tuple[str, Any]:
    """Path and value of a number in the keys and units of this file: `axis.X.coulomb_friction_nm` of a direct drive is `coulomb_friction_n`."""
    parts = path.split(".")
    table = document.get("axis", {}).get(parts[1]) if parts[0] == "axis" and len(parts) > 2 else None
    if not isinstance(table, Mapping):
        return path, value
    key = keys.key_in_file(table, ".".join(parts[2:]))
    datum = sinumerik.datum_in_file(table, key, value)
    if datum is not None:
        return f"axis.{parts[1]}.{datum[0]}", datum[1]
    drive = keys.drive_of(table)
    if key == SPEED_GAIN.key(drive) and "actuator" in table and value_at(table, key) is None:
        effort = EFFORTS[table["actuator"]["command"]]
        constants = [value_at(table, p.key(drive)) for p in reversed(effort.constant)]
        leads = [typed_from_file(lead, table[lead]) for lead in ("screw_lead_m_per_rev", "gear_ratio") if lead in table]
        for gain in effort.gains:  # as the file gives it
            if gain.key(drive) and value_at(table, gain.key(drive)) is not None:
                factor = gain_factor(gain, next(c for c in (*constants, 1.0) if c is not None), leads[0] if leads else 1.0)
                return f"axis.{parts[1]}.{gain.key(drive)}", value / factor
    return f"axis.{parts[1]}.{key}", value


def _without_contradicting_data(document: dict[str, Any], path: str) -> dict[str, Any]:
    """The document, with the machine data of an axis replaced by plain keys if they would contradict the new plain value."""
    _, axis, key = path.split(".", 2)
    table = document["axis"].get(axis)
    if not isinstance(table, Mapping) or not isinstance(table.get("sinumerik"), Mapping):
        return document
    given = sinumerik.plain_values(sinumerik.by_number(table["sinumerik"], table["kind"], f"[axis.{axis}.sinumerik]"), table["kind"])
    of_data = key in given or f"{key}.0" in given
    if not of_data or (value_at(table, key) is None and sinumerik.datum_in_file(table, key, 1.0) is not None):
        return document
    plain = sinumerik.with_plain_keys(table, f"[axis.{axis}]")
    return {**document, "axis": {**document["axis"], axis: plain}}
