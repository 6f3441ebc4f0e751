"""SINUMERIK: archives of machine data and encoder compensation (EEC); cross compensation (CEC) is read only.

    EEC   $AA_ENC_COMP[e,N,axis]: the value is added to the actual position, so a positive value moves the axis in the negative direction:
          value = E (grade A). One table for both directions; N from 0; point N is at MIN + N STEP; the end values hold beyond the ends (C).
    CEC   $AN_CEC[t,N] over the set point of an input axis, for an output axis, for one direction of travel or both. The sign of the motion
          stands in no text that could be read, and no effect acts between axes, so none is written.

Both tables load only while MD32700 ENC_COMP_ENABLE or MD32710 CEC_ENABLE is 0, and act after the axis is referenced.
"""

from collections.abc import Sequence
from functools import partial
import re

import numpy as np

from twin.errors import InputError
from twin.machine.sinumerik import archive_values
from twin.remedy.files.table import Entry, ErrorTable
from twin.units import AXIS_UNITS

_number = partial(np.format_float_positional, precision=6, unique=False, trim="0")
_EEC = re.compile(r"\$AA_ENC_COMP(?:_(STEP|MIN|MAX|IS_MODULO))?\[\s*(\d+)\s*,\s*(?:(\d+)\s*,\s*)?(\w+)\s*\]\s*=\s*([^\s;]+)")
_CEC = re.compile(r"\$AN_CEC(?:_([A-Z_]+))?\[\s*(\d+)\s*(?:,\s*(\d+)\s*)?\]\s*=\s*\(?\s*([^\s;)]+)\s*\)?")


def archive(data: Sequence[tuple[str, Entry]]) -> str:
    """Archive lines of (axis, 'MD32450 BACKLASH' and its values) with the old value beside each, and a second block that restores them."""
    lines = ["; new values; the lines below restore the old ones"]
    for axis, e in data:
        lines.append(_line(axis, e, e.value, f"{e.unit}, {e.was}, effective: NewConfig{'; ' if e.graded else ''}{e.graded}"))
    lines += [";", "; to go back:"]
    lines += [f"; {_line(axis, e, e.old, e.unit)}" for axis, e in data if e.old is not None]
    return "\n".join([*lines, "M17", ""])


def _line(axis: str, entry: Entry, value: float, comment: str) -> str:
    number, _, name = entry.name.partition(" ")
    return f"N{number[2:]} $MA_{name}[0,{axis}]={value:.9g} ; {comment}".rstrip(" ;,")


def machine_data(text: str) -> dict[tuple[str, str], str]:
    """Values of the axis data of an archive by ('MD32450', axis)."""
    return {(f"MD{number}", index[-1]): value for number, area, index, value in archive_values(text) if area == "A" and index[-1]}


def eec_file(table: ErrorTable, kind: str) -> str:
    """An EEC archive of the first encoder of an axis. Raises InputError for a table by direction or with unequal spacing."""
    if table.by_direction:
        raise InputError(f"axis {table.axis}: one EEC table serves both directions; enter what differs as a backlash value")
    if not table.spacing:
        raise InputError(f"axis {table.axis}: SINUMERIK tables are equidistant; interpolate the errors to equal steps")
    axis, per_si = table.axis, AXIS_UNITS[kind].position[1]
    lines = [f"%_N_{axis}_EEC_INI", "CHANDATA(1)"]
    lines += [f"$AA_ENC_COMP[0,{n},{axis}]={_number(value * per_si)}" for n, value in enumerate(table.forward)]
    lines += [
        f"$AA_ENC_COMP_STEP[0,{axis}]={_number(table.spacing * per_si)}",
        f"$AA_ENC_COMP_MIN[0,{axis}]={_number(table.positions[0] * per_si)}",
        f"$AA_ENC_COMP_MAX[0,{axis}]={_number(table.positions[-1] * per_si)}",
        f"$AA_ENC_COMP_IS_MODULO[0,{axis}]={int(table.modulo)}",
        "M17",
    ]
    return "\n".join(lines) + "\n"


def eec_table(text: str, kind: str) -> ErrorTable:
    """The table of an EEC archive. Points without a line are 0. Raises InputError for a file without range or step."""
    values: dict[int, float] = {}
    head: dict[str, float] = {}
    axes = set()
    for name, _, number, axis, value in _EEC.findall(text):
        axes.add(axis)
        if name:
            head[name] = float(value)
        elif number:
            values[int(number)] = float(value)
    if len(axes) != 1 or not {"STEP", "MIN", "MAX"} <= head.keys():
        raise InputError("EEC archive: give $AA_ENC_COMP_STEP, _MIN and _MAX of one axis")
    count = round((head["MAX"] - head["MIN"]) / head["STEP"]) + 1
    per_si = AXIS_UNITS[kind].position[1]
    positions = (head["MIN"] + head["STEP"] * np.arange(count)) / per_si
    errors = np.array([values.get(n, 0.0) for n in range(count)]) / per_si
    return ErrorTable(axes.pop(), positions, errors, errors, modulo=bool(head.get("IS_MODULO")))


def cec_tables(text: str, kind: str) -> list[tuple[int, ErrorTable]]:
    """(direction, table) of each CEC table; the axes keep their names in the control. A table for one direction has the other at 0."""
    tables: dict[int, dict[str, str]] = {}
    values: dict[int, dict[int, float]] = {}
    for name, t, n, value in _CEC.findall(text):
        if name:
            tables.setdefault(int(t), {})[name] = value
        elif n:
            values.setdefault(int(t), {})[int(n)] = float(value)
    out, per_si = [], AXIS_UNITS[kind].position[1]
    for t, head in sorted(tables.items()):
        if missing := {"INPUT_AXIS", "OUTPUT_AXIS", "STEP", "MIN"} - head.keys():
            raise InputError(f"CEC archive: table {t} lacks {', '.join(f'$AN_CEC_{m}' for m in sorted(missing))}")
        own = values.get(t, {})
        count = max(own, default=1) + 1
        positions = (float(head["MIN"]) + float(head["STEP"]) * np.arange(count)) / per_si
        errors = np.array([own.get(n, 0.0) for n in range(count)]) / per_si
        direction = int(head.get("DIRECTION", 0))
        forward, backward = (errors if direction != -1 else 0.0 * errors), (errors if direction != 1 else 0.0 * errors)
        modulo = bool(int(head.get("IS_MODULO", 0)))
        out.append((direction, ErrorTable(head["OUTPUT_AXIS"], positions, forward, backward, head["INPUT_AXIS"], modulo)))
    return out
