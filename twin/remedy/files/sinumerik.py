"""SINUMERIK: archives of machine data, encoder compensation (EEC) and cross compensation (CEC).

    EEC   $AA_ENC_COMP[e,N,axis]: the value is added to the actual position, so a positive value moves the axis in the negative direction:
          value = E (grade A). One table for both directions; N from 0; point N is at MIN + N STEP; the end values hold beyond the ends (C).
    CEC   $AN_CEC[t,N] over the set point of an input axis, for an output axis, for one direction of travel or both. The sign of the motion
          stands in no text that could be read: the writer says so in the file.

Both tables load only while MD32700 ENC_COMP_ENABLE or MD32710 CEC_ENABLE is 0, and act after the axis is referenced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import re

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import PER_SI, ErrorTable

DIRECTION = {"both": 0, "positive": 1, "negative": -1}
_EEC = re.compile(r"\$AA_ENC_COMP(?:_(STEP|MIN|MAX|IS_MODULO))?\[\s*(\d+)\s*,\s*(?:(\d+)\s*,\s*)?(\w+)\s*\]\s*=\s*([^\s;]+)")
_CEC = re.compile(r"\$AN_CEC(?:_([A-Z_]+))?\[\s*(\d+)\s*(?:,\s*(\d+)\s*)?\]\s*=\s*\(?\s*([^\s;)]+)\s*\)?")


@dataclass(frozen=True)
class MachineDatum:
    """One line of an archive: number, name without $MA_, index, axis, new and old value, unit, grade of what is known of it."""

    number: int
    name: str
    axis: str
    value: float
    old: float | None = None
    unit: str = ""
    index: int = 0
    grade: str = "A"
    effective: str = "NewConfig"


def archive(data: Sequence[MachineDatum]) -> str:
    """Archive lines with the old value of each datum beside it, and a second block that restores them."""
    lines = ["; new values; the lines below restore the old ones"]
    lines += [_datum_line(d, d.value, f"{d.unit}, {_was(d)}, effective: {d.effective}{_graded(d)}") for d in data]
    lines += [";", "; to go back:"]
    lines += [f"; {_datum_line(d, d.old, d.unit)}" for d in data if d.old is not None]
    return "\n".join([*lines, "M17", ""])


def _datum_line(d: MachineDatum, value: float, comment: str) -> str:
    return f"N{d.number} $MA_{d.name}[{d.index},{d.axis}]={value:.9g} ; {comment}".rstrip(" ;,")


def _was(d: MachineDatum) -> str:
    return "old value unknown" if d.old is None else f"was {d.old:.9g}"


def _graded(d: MachineDatum) -> str:
    return "" if d.grade == "A" else f"; grade {d.grade}: check before use"


def machine_data(text: str) -> dict[tuple[int, str], float]:
    """Values of archive lines by (number, axis)."""
    line = re.compile(r"^\s*N(\d{4,5})\s+\$MA_\w+\[(?:\d+,)?\s*(\w+)\s*\]\s*=\s*([^\s;]+)", re.M)
    return {(int(number), axis): float(value) for number, axis, value in line.findall(text)}


def eec_file(table: ErrorTable, kind: str, encoder: int = 0, decimals: int = 6) -> str:
    """An EEC archive of one axis. Raises InputError for a table by direction or with unequal spacing."""
    if table.by_direction:
        raise InputError(f"axis {table.axis}: one EEC table serves both directions; use two CEC tables for errors by direction")
    step = _equidistant(table)
    e, axis, per_si = encoder, table.axis, PER_SI[kind]
    lines = [f"%_N_{axis}_EEC_INI", "CHANDATA(1)"]
    lines += [f"$AA_ENC_COMP[{e},{n},{axis}]={_number(value * per_si, decimals)}" for n, value in enumerate(table.forward)]
    lines += [
        f"$AA_ENC_COMP_STEP[{e},{axis}]={_number(step * per_si, decimals)}",
        f"$AA_ENC_COMP_MIN[{e},{axis}]={_number(table.positions[0] * per_si, decimals)}",
        f"$AA_ENC_COMP_MAX[{e},{axis}]={_number(table.positions[-1] * per_si, decimals)}",
        f"$AA_ENC_COMP_IS_MODULO[{e},{axis}]={int(table.modulo)}",
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
    per_si = PER_SI[kind]
    positions = (head["MIN"] + head["STEP"] * np.arange(count)) / per_si
    errors = np.array([values.get(n, 0.0) for n in range(count)]) / per_si
    return ErrorTable(axes.pop(), positions, errors, errors, modulo=bool(head.get("IS_MODULO")))


def cec_file(table: ErrorTable, kind: str, channel_axes: Mapping[str, str], first: int = 0, decimals: int = 6) -> str:
    """A CEC archive: one table for both directions, or two. `channel_axes`: name of each axis in the control ('AX1').

    The values are those of an EEC table (value = E); the file asks to test the sign.
    """
    step = _equidistant(table)
    per_in = per_out = PER_SI[kind]
    ways = [("positive", table.forward), ("negative", table.backward)] if table.by_direction else [("both", table.forward)]
    lines = ["%_N_NC_CEC_INI", "CHANDATA(1)", "; sign not found in any manual: test it with one constant table before use"]
    for t, (way, values) in enumerate(ways, first):
        lines += [f"$AN_CEC[{t},{n}]={_number(value * per_out, decimals)}" for n, value in enumerate(values)]
        lines += [
            f"$AN_CEC_INPUT_AXIS[{t}]=({channel_axes[table.input_axis or table.axis]})",
            f"$AN_CEC_OUTPUT_AXIS[{t}]=({channel_axes[table.axis]})",
            f"$AN_CEC_STEP[{t}]={_number(step * per_in, decimals)}",
            f"$AN_CEC_MIN[{t}]={_number(table.positions[0] * per_in, decimals)}",
            f"$AN_CEC_MAX[{t}]={_number(table.positions[-1] * per_in, decimals)}",
            f"$AN_CEC_DIRECTION[{t}]={DIRECTION[way]}",
            f"$AN_CEC_MULT_BY_TABLE[{t}]=0",
            f"$AN_CEC_IS_MODULO[{t}]={int(table.modulo)}",
        ]
    return "\n".join([*lines, "M17", ""])


def cec_tables(text: str, kind: str) -> list[tuple[int, ErrorTable]]:
    """(direction, table) of each CEC table; the axes keep their names in the control. A table for one direction has the other at 0."""
    tables: dict[int, dict[str, str]] = {}
    values: dict[int, dict[int, float]] = {}
    for name, t, n, value in _CEC.findall(text):
        if name:
            tables.setdefault(int(t), {})[name] = value
        elif n:
            values.setdefault(int(t), {})[int(n)] = float(value)
    out, per_si = [], PER_SI[kind]
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


def _equidistant(table: ErrorTable) -> float:
    if not table.spacing:
        raise InputError(f"axis {table.axis}: SINUMERIK tables are equidistant; interpolate the errors to equal steps")
    return table.spacing


def _number(value: float, decimals: int) -> str:
    """'0.01', '-200.0', '0.0': no exponent, no trailing zeros beyond the first decimal."""
    text = f"{value:.{decimals}f}".rstrip("0")
    return text + "0" if text.endswith(".") else text
