"""HEIDENHAIN: parameters as a list to enter by hand, and old correction tables (TNC 306 and its kind).

An old table holds the error of one axis over the position of another, at distances of 2^n um (grade A); empty lines are
interpolated. No literal .COM file of the NCK controls was in reach, so none is made up: its columns are filled into a file that the control
saved (`filled`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
import re

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import PER_SI, ErrorTable


@dataclass(frozen=True)
class MachineParameter:
    """A parameter to enter: name on the control, axis, new and old value, unit, grade."""

    name: str
    axis: str
    value: float
    old: float | None = None
    unit: str = ""
    grade: str = "A"


def parameter_list(parameters: Sequence[MachineParameter]) -> str:
    """One line for each parameter, with its old value; a grade below A is printed."""
    lines = []
    for p in parameters:
        was = "old value unknown" if p.old is None else f"was {p.old:.9g}"
        graded = "" if p.grade == "A" else f"; grade {p.grade}: check before use"
        lines.append(f"{p.name} [{p.axis}] : {p.value:.9g} {p.unit} ; {was}{graded}\n")
    return "".join(lines)


def parameters_of(text: str) -> dict[tuple[str, str], float]:
    """Values of a list by (name, axis)."""
    return {(name, axis): float(value) for name, axis, value in re.findall(r"^(\S+) \[(\w+)\] : (\S+)", text, re.M)}


def old_table(text: str, corrected: str, over: str) -> ErrorTable:
    """The table of lines such as '1 Z-973.616  Y-0.06', in mm: errors of axis `corrected` over axis `over`."""
    positions, errors = [], []
    for line in text.splitlines():
        words = dict(re.findall(r"([A-Z])([-+]?\d*\.?\d+)", line))
        if over in words:
            positions.append(float(words[over]))
            errors.append(float(words[corrected]) if corrected in words else math.nan)
    at, found = np.array(positions), np.array(errors)
    known = np.isfinite(found)
    if known.sum() < 2:
        raise InputError(f"correction table of axis {corrected}: two or more values are needed")
    values = np.interp(at, at[known], found[known]) * 1e-3
    return ErrorTable(corrected, at * 1e-3, values, values, input_axis=over)


def filled(saved: str, table: ErrorTable, kind: str) -> str:
    """A .COM file that the control saved, with the errors of a table at the positions of its lines.

    `saved` has a heading line with AXISPOS and one column named like the axis, optionally BACKLASH. Frame and column widths stay. Raises
    InputError if the heading lacks a column.
    """
    lines = saved.splitlines()
    head = next((i for i, line in enumerate(lines) if "AXISPOS" in line), None)
    if head is None or table.axis not in lines[head].split():
        raise InputError(f"correction file: no heading with AXISPOS and {table.axis}; save one on the control and give it")
    per_si = PER_SI[kind]
    spans = [(m[0], m.start()) for m in re.finditer(r"\S+", lines[head])]
    columns = {name: (start, end) for (name, start), end in zip(spans, [*(s for _, s in spans[1:]), None])}
    begin, end = columns["AXISPOS"]
    for i in range(head + 1, len(lines)):
        try:
            position = float(lines[i][begin:end]) / per_si
        except ValueError:
            continue
        forward, backward = (float(table.error(position, way)[0]) * per_si for way in (1, -1))
        lines[i] = _in_column(lines[i], columns[table.axis], f"{forward:+.4f}")
        if "BACKLASH" in columns:
            lines[i] = _in_column(lines[i], columns["BACKLASH"], f"{backward:+.4f}")
    return "\n".join(lines) + ("\n" if saved.endswith("\n") else "")


def _in_column(line: str, span: tuple[int, int | None], text: str) -> str:
    start, end = span
    width = (end - start) if end is not None else len(text)
    return line.ljust(start)[:start] + text.ljust(width)[:width] + (line[end:] if end is not None else "")
