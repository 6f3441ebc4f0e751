"""LinuxCNC: compensation file of a joint and lines of its ini file. Law and loader: `usrmotintf.cc`, `control.c` (grade A).

    trim    type 0: nominal - measured position of a line; type 1: the numbers themselves. Forward or reverse column by the sign of the speed
    motor command = position command + applied value;  position feedback = motor feedback - applied value

So trim = -E: an axis that goes 5 um too far gets -0.005. A table of one point or more replaces BACKLASH. The loader stops silently at the
first line that is not three numbers, so a file has no comments and no blank lines. It takes 256 points and keeps numbers in single precision.
"""

import re

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import ErrorTable
from twin.units import AXIS_UNITS

MOST_POINTS = 256
LONGEST_LINE = 254
"""A longer line is split by the loader."""
_THREE = re.compile(3 * r"\s*((?>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))")
"""Three numbers at the start of a line, as sscanf("%lf %lf %lf") reads them."""


def compensation_file(table: ErrorTable, kind: str) -> str:
    """A compensation file of type 1 for an error table; `kind` of the axis. Raises InputError for what the loader would cut off."""
    if len(table.positions) > MOST_POINTS:
        raise InputError(f"axis {table.axis}: {len(table.positions)} points, LinuxCNC takes {MOST_POINTS}; use a wider spacing")
    per_si = AXIS_UNITS[kind].position[1]
    return "".join(
        f"{p * per_si:.6f} {-f * per_si:.6f} {-b * per_si:.6f}\n" for p, f, b in zip(table.positions, table.forward, table.backward)
    )


def table_of(text: str, axis: str, kind: str, file_type: int = 0) -> ErrorTable:
    """The error table that a compensation file corrects, as LinuxCNC's own loader reads it. Raises InputError where that would leave out a part."""

    def refused(what: str) -> InputError:
        return InputError(f"compensation file of axis {axis}: {what}; repair the file")

    rows: list[tuple[float, float, float]] = []
    for number, line in enumerate(text.removesuffix("\n").split("\n"), 1):
        words = _THREE.match(line[:LONGEST_LINE])
        if words is None:
            raise refused(f"line {number} is not three numbers: the loader stops there")
        if len(line) > LONGEST_LINE:
            raise refused(f"line {number} has more than {LONGEST_LINE} characters: the loader splits it")
        nominal, first, second = map(float, words.groups())
        if rows and nominal <= rows[-1][0]:
            raise refused(f"line {number}: its position does not increase: skipped")
        if len(rows) == MOST_POINTS:
            raise refused(f"line {number}: more than {MOST_POINTS} points: the loader stops there")
        rows.append((nominal, first, second) if file_type == 1 else (nominal, nominal - first, nominal - second))
    table, per_si = np.array(rows), AXIS_UNITS[kind].position[1]
    trims = table[:, 1:].astype(np.float32).astype(float)  # the loader keeps single precision
    return ErrorTable(axis, table[:, 0] / per_si, -trims[:, 0] / per_si, -trims[:, 1] / per_si)


def ini_lines(joint: int, values: dict[str, float | str]) -> str:
    """The lines of a joint's section: '[JOINT_0]', then 'BACKLASH = 0.015' and the like."""
    return f"[JOINT_{joint}]\n" + "".join(
        f"{key} = {value if isinstance(value, str) else f'{value:.9g}'}\n" for key, value in values.items()
    )


def ini_values(text: str) -> dict[tuple[str, str], str]:
    """Values of an ini file by (key, axis); [JOINT_0] is the axis AX1."""
    out: dict[tuple[str, str], str] = {}
    axis = ""
    for line in text.splitlines():
        plain = line.split("#")[0].split(";")[0].strip()
        if plain.startswith("["):
            section = re.fullmatch(r"\[JOINT_(\d+)\]", plain)
            axis = f"AX{int(section[1]) + 1}" if section else ""
        elif axis and "=" in plain:
            key, _, value = plain.partition("=")
            out[key.strip(), axis] = value.strip()
    return out
