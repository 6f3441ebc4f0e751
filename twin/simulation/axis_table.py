"""Tables of the compiled loop: one row per axis, with all its numbers side by side.

Compiled code reads `table.name[axis]` at a fixed distance from the start of the row. With an array for each name it first has to fetch the
address of that array, which took a fifth of the time of a tick.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

AxisTable = Any
"""A numpy record array: rows (axis,) with named columns, whose types only numba checks; `table.name` is a column (axis, ...)."""


def axis_table(columns: NamedTuple) -> AxisTable:
    """The columns, each (axis, ...), as one table with their names."""
    row = np.dtype([(name, values.dtype, values.shape[1:]) for name, values in columns._asdict().items()], align=True)
    table = np.recarray(len(columns[0]), row)
    for name, values in columns._asdict().items():
        table[name] = values
    return table


def one_below_another(tables: Sequence[AxisTable]) -> AxisTable:
    """The rows of several tables of the same columns in one table."""
    return np.concatenate(tables).view(np.recarray)
