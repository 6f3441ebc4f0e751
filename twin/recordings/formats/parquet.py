"""Parquet: columns of numbers, with units from the headings ('X.position [mm]')."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.errors import InputError
from twin.recordings.parquet_file import read_parquet
from twin.recordings.signals import ReadOptions, Recording, split_heading, starts_with
from twin.recordings.time_column import share_time


def read(path: Path, options: ReadOptions) -> Recording:
    """All columns of numbers, on the map's time column or interval."""
    import pyarrow as pa

    if not starts_with(path, b"PAR1"):
        raise InputError(f"{path}: not a Parquet file; give it the ending of its true format")
    table = read_parquet(path, remedy="export it again")
    names = table.column_names
    columns: dict[str, tuple[np.ndarray, str]] = {}
    plain_names = [split_heading(name)[0] for name in names]
    for name in names:
        column = table.column(name)
        if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            plain, unit = split_heading(name)
            columns[plain if plain_names.count(plain) == 1 else name] = (column.cast(pa.float64(), safe=False).to_numpy(), unit)
    signals, source, restarts = share_time(columns, options.clock, str(path))
    return Recording(path, "Parquet", signals, None, (f"Parquet: {len(columns)} columns",), restarts=restarts, source=source)
