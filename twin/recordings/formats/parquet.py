"""Parquet: columns of numbers, with units from the headings ('X.position [mm]'), and lists of one length, one element for each joint."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twin.limits import most_bytes
from twin.recordings.signals import ReadOptions, Recording
from twin.recordings.table_file import read_parquet
from twin.recordings.time_column import share_time
from twin.system import tried

LONGEST_LIST = 64
"""Elements of a list that can be joints; a longer one is a picture or a spectrum."""
TRIAL_BYTES, TRIAL_S = 2_000_000_000, 60
"""Address space and processor time of the process that tries lists, before it reads any: a short file may hold a thousand million zeros in one row."""
_TRIAL = "import sys, pyarrow.parquet\npyarrow.parquet.read_table(sys.argv[1], columns=sys.argv[2:], use_threads=False)"


def read(path: Path, options: ReadOptions) -> Recording:
    """All columns of numbers, on the map's time column or interval."""
    table = read_parquet(path, remedy="export it again")
    return table_recording(table, "Parquet", path, options, lists_of(path))


def table_recording(table: Any, kind: str, path: Path, options: ReadOptions, lists: dict[str, np.ndarray]) -> Recording:
    """The columns of numbers of a pyarrow table, and (row, element) lists, as signals."""
    import pyarrow as pa

    columns = {
        name: (table.column(name).cast(pa.float64(), safe=False).to_numpy(), "")
        for name in table.column_names
        if pa.types.is_floating(table.column(name).type) or pa.types.is_integer(table.column(name).type)
    }
    columns |= {f"{name}[{i}]": (values[:, i], "") for name, values in lists.items() for i in range(values.shape[1])}
    signals, source, restarts = share_time(columns, options.clock, str(path))
    return Recording(path, kind, signals, None, (f"{kind}: {len(columns)} columns",), restarts=restarts, source=source)


def lists_of(path: Path) -> dict[str, np.ndarray]:
    """Columns of lists of numbers that all have the same length, (row, element); none if reading them fails or fills the memory."""
    import pyarrow.parquet

    names = [field.name for field in pyarrow.parquet.read_schema(path) if _is_list(field.type)]
    done = tried(_TRIAL, str(path), *names, most_bytes=TRIAL_BYTES + 2 * most_bytes(), seconds=TRIAL_S) if names else None
    if done is None or done.returncode != 0:
        return {}
    return list_columns(pyarrow.parquet.read_table(path, columns=names))


def list_columns(table: Any) -> dict[str, np.ndarray]:
    """The columns of a pyarrow table that are lists of numbers of one length, (row, element)."""
    found = [field.name for field in table.schema if _is_list(field.type)]
    return {name: rows for name in found if (rows := _rows_of(table.column(name))) is not None}


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    listed = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    return listed and (pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type))


def _rows_of(column: Any) -> np.ndarray | None:
    """A column of lists as (row, element); None if their lengths differ, or are no number of joints."""
    import pyarrow.compute as pc

    lengths = pc.list_value_length(column).drop_null().unique().to_pylist()
    if column.null_count or len(lengths) != 1 or not 0 < lengths[0] <= LONGEST_LIST:
        return None
    return np.asarray(pc.list_flatten(column).to_numpy(), float).reshape(-1, lengths[0])
