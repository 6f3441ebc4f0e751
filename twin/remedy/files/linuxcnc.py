"""LinuxCNC: compensation file of a joint and lines of its ini file. Law and loader: `usrmotintf.cc`, `control.c` (grade A).

    trim    type 0: nominal - measured position of a line; type 1: the numbers themselves. Forward or reverse column by the sign of the speed
    motor command = position command + applied value;  position feedback = motor feedback - applied value

So trim = -E: an axis that goes 5 um too far gets -0.005. A table of one point or more replaces BACKLASH. The loader stops silently at the
first line that is not three numbers, so a file has no comments and no blank lines. It takes 256 points and keeps numbers in single precision.
"""

from __future__ import annotations

from dataclasses import dataclass
import re

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import PER_SI, ErrorTable

MOST_POINTS = 256
LONGEST_LINE = 254
"""A longer line is split by the loader."""
_THREE = re.compile(3 * r"\s*((?>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))")
"""Three numbers at the start of a line, as sscanf("%lf %lf %lf") reads them."""


@dataclass(frozen=True)
class Trims:
    """What the loader keeps of a compensation file, in machine units: nominal positions and trims (point,), and what it dropped."""

    nominal: np.ndarray
    forward: np.ndarray
    reverse: np.ndarray
    dropped: tuple[str, ...]


def load(text: str, kind: int = 0) -> Trims:
    """The trims as LinuxCNC's own loader reads them, with its silent stops; `dropped` says what it left out and why."""
    rows: list[tuple[float, float, float]] = []
    dropped = []
    for number, line in enumerate(text.split("\n"), 1):
        words = _THREE.match(line[:LONGEST_LINE])
        if words is None:
            if line or number < len(text.split("\n")):
                dropped.append(f"line {number} is not three numbers: the loader stops there")
            break
        if len(line) > LONGEST_LINE:
            dropped.append(f"line {number} has more than {LONGEST_LINE} characters: the loader splits it")
        nominal, first, second = map(float, words.groups())
        if rows and nominal <= rows[-1][0]:
            dropped.append(f"line {number}: its position does not increase: skipped")
            continue
        if len(rows) == MOST_POINTS:
            dropped.append(f"line {number}: more than {MOST_POINTS} points: the loader stops there")
            break
        rows.append((nominal, first, second) if kind == 1 else (nominal, nominal - first, nominal - second))
    table = np.array(rows, float).reshape(-1, 3)
    # the loader keeps single precision
    trims = table[:, 1:].astype(np.float32).astype(float)
    return Trims(table[:, 0], trims[:, 0], trims[:, 1], tuple(dropped))


def compensation_file(table: ErrorTable, kind: str) -> str:
    """A compensation file of type 1 for an error table; `kind` of the axis. Raises InputError for what the loader would cut off."""
    if len(table.positions) > MOST_POINTS:
        raise InputError(f"axis {table.axis}: {len(table.positions)} points, LinuxCNC takes {MOST_POINTS}; use a wider spacing")
    per_si = PER_SI[kind]
    return "".join(
        f"{p * per_si:.6f} {-f * per_si:.6f} {-b * per_si:.6f}\n" for p, f, b in zip(table.positions, table.forward, table.backward)
    )


def table_of(text: str, axis: str, kind: str, file_type: int = 0) -> ErrorTable:
    """The error table that a compensation file corrects. Raises InputError if the loader would leave out part of it."""
    trims = load(text, file_type)
    if trims.dropped:
        raise InputError(f"compensation file of axis {axis}: {trims.dropped[0]}; repair the file")
    per_si = PER_SI[kind]
    return ErrorTable(axis, trims.nominal / per_si, -trims.forward / per_si, -trims.reverse / per_si)


def ini_lines(joint: int, values: dict[str, float | str]) -> str:
    """The lines of a joint's section: '[JOINT_0]', then 'BACKLASH = 0.015' and the like."""
    return f"[JOINT_{joint}]\n" + "".join(
        f"{key} = {value if isinstance(value, str) else f'{value:.9g}'}\n" for key, value in values.items()
    )


def ini_values(text: str) -> dict[int, dict[str, str]]:
    """The keys of each [JOINT_n] section of an ini file."""
    out: dict[int, dict[str, str]] = {}
    joint: int | None = None
    for line in text.splitlines():
        plain = line.split("#")[0].split(";")[0].strip()
        if plain.startswith("["):
            section = re.fullmatch(r"\[JOINT_(\d+)\]", plain)
            joint = int(section[1]) if section else None
        elif joint is not None and "=" in plain:
            key, _, value = plain.partition("=")
            out.setdefault(joint, {})[key.strip()] = value.strip()
    return out
