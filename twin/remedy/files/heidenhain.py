"""HEIDENHAIN: parameters as a list to enter by hand, and old correction tables (TNC 306 and its kind).

An old table holds the error of one axis over the position of another, at distances of 2^n um (grade A); empty lines are
interpolated. No literal .COM file of the NCK controls was in reach, so none is made up: its columns are filled into a file that the control
saved (`filled`).
"""

from collections.abc import Sequence
import contextlib
import math
import re

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import Entry, ErrorTable
from twin.units import AXIS_UNITS

COARSER = 4.0 / 3.0
"""Largest distance of the lines of a file, in units of the spacing of a table with a wave: twelve of sixteen points."""


def parameter_list(parameters: Sequence[tuple[str, Entry]]) -> str:
    """One line for each parameter of an axis, with its old value; a grade below A is printed."""
    return "".join(f"{e.name} [{axis}] : {e.value:.9g} {e.unit} ; {e.was}{'; ' if e.graded else ''}{e.graded}\n" for axis, e in parameters)


def parameters_of(text: str) -> dict[tuple[str, str], str]:
    """Values of a list by (name, axis)."""
    return {(name, axis): value for name, axis, value in re.findall(r"^(\S+) \[(\w+)\] : (\S+)", text, re.M)}


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


def holds(saved: str, axis: str) -> bool:
    """True for a .COM file with a column of this axis."""
    return any("AXISPOS" in line and axis in line.split() for line in saved.splitlines())


def filled(saved: str, table: ErrorTable, kind: str) -> str:
    """A .COM file that the control saved, with the errors of a table at the positions of its lines.

    `saved` has a heading line with AXISPOS and one column named like the axis, optionally BACKLASH. Frame and column widths stay. Raises
    InputError if the heading lacks a column, or if the lines leave out points of the table.
    """
    lines = saved.splitlines()
    if not holds(saved, table.axis):
        raise InputError(f"correction file: no heading with AXISPOS and {table.axis}; save one on the control and give it")
    head = next(i for i, line in enumerate(lines) if "AXISPOS" in line)
    per_si = AXIS_UNITS[kind].position[1]
    spans = [(m[0], m.start()) for m in re.finditer(r"\S+", lines[head])]
    columns = {name: (start, end) for (name, start), end in zip(spans, [*(s for _, s in spans[1:]), None])}
    begin, end = columns["AXISPOS"]
    at = {}
    for i in range(head + 1, len(lines)):
        with contextlib.suppress(ValueError):
            at[i] = float(lines[i][begin:end]) / per_si
    widest = float(np.diff(sorted(at.values())).max(initial=0.0))
    if len(table.positions) > 2 and widest > COARSER * table.spacing:
        raise InputError(
            f"correction file of axis {table.axis}: its lines are {widest * per_si:.4g} apart, the wave needs {COARSER * table.spacing * per_si:.4g} or less"
        )
    for i, position in at.items():
        forward, backward = (float(table.error(position, way)[0]) * per_si for way in (1, -1))
        lines[i] = _in_column(lines[i], columns[table.axis], f"{forward:+.4f}")
        if "BACKLASH" in columns:
            lines[i] = _in_column(lines[i], columns["BACKLASH"], f"{backward:+.4f}")
    return "\n".join(lines) + ("\n" if saved.endswith("\n") else "")


def _in_column(line: str, span: tuple[int, int | None], text: str) -> str:
    start, end = span
    width = (end - start) if end is not None else len(text)
    return line.ljust(start)[:start] + text.ljust(width)[:width] + (line[end:] if end is not None else "")
