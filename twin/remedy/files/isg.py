"""Lists of leadscrew error compensation (SSFK) of Beckhoff and ISG kernels: `.lis`, one 'key value' a line, comments after '#'.

Entries are 'actual minus set point' in 0.1 um or 0.0001 degrees (grade A for the format). The set point is shifted against them (C), so
value = E. One published example contradicts itself in the sign of a set point: test a written list with one constant value.
"""

import math

import numpy as np

from twin.errors import InputError
from twin.remedy.files.table import ErrorTable

_PER_SI = {"linear": 1e7, "rotary": 1e4 * 180.0 / math.pi}
"""0.1 um or 0.0001 degrees per SI."""
WIDTH = 29
"""Column of the values."""


def list_of(table: ErrorTable, kind: str, axis_number: int) -> str:
    """The list of an error table with its own positions (not equidistant), by direction if the directions differ."""
    per_si, count = _PER_SI[kind], len(table.positions)
    rows: list[tuple[str, int]] = [
        ("kopf.achs_nr", axis_number),
        ("kw.ssfk.interval", 0),
        ("kw.ssfk.kw_startpos", round(table.positions[0] * per_si)),
        ("kw.ssfk.kw_nr_max", count),
        ("kw.ssfk.unit", 1),
        ("kw.ssfk.bilateral", int(table.by_direction)),
        *([("kw.ssfk.modulo", 1)] if table.modulo else []),
    ]
    for name, values in (("setpoint", table.positions), ("pos", table.forward), *([("neg", table.backward)] if table.by_direction else [])):
        rows += [(f"kw.ssfk.table[{i}].{name}", round(value * per_si)) for i, value in enumerate(values)]
    return "".join(f"{key:<{WIDTH}}{value}\n" for key, value in rows)


def table_of(text: str, axis: str, kind: str) -> ErrorTable:
    """The error table of a list. Raises InputError for a list without points, or with a line that is no number."""
    values: dict[str, int] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            values[words[0]] = int(words[1])
        except (IndexError, ValueError):
            raise InputError(f"list of axis {axis}: line {number}: '{line[:60]}' is not a key and a whole number") from None
    per_si = _PER_SI[kind]
    columns = {name: _column(values, name) for name in ("setpoint", "pos", "neg")}
    if len(columns["setpoint"]) < 2 or len(columns["pos"]) != len(columns["setpoint"]):
        raise InputError(f"list of axis {axis}: give kw.ssfk.table[0].setpoint and .pos for two points or more")
    backward = columns["neg"] if values.get("kw.ssfk.bilateral") else columns["pos"]
    modulo = bool(values.get("kw.ssfk.modulo"))
    return ErrorTable(axis, columns["setpoint"] / per_si, columns["pos"] / per_si, backward / per_si, modulo=modulo)


def _column(values: dict[str, int], name: str) -> np.ndarray:
    out: list[int] = []
    while (key := f"kw.ssfk.table[{len(out)}].{name}") in values:
        out.append(values[key])
    return np.array(out, float)
