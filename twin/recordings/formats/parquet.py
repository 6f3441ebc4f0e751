"""Parquet: columns of numbers, with units from the headings ('X.position [mm]')."""

from __future__ import annotations

from pathlib import Path

from twin.recordings.signals import ReadOptions, Recording, split_heading
from twin.recordings.table_file import read_parquet
from twin.recordings.time_column import share_time


def read(path: Path, options: ReadOptions) -> Recording:
    """All columns of numbers, on the map's time column or interval."""
    import pyarrow as pa

    table = read_parquet(path, remedy="export it again")
    split = {name: split_heading(name) for name in table.column_names}
    plain = [name for name, _ in split.values()]
    columns = {
        own if plain.count(own) == 1 else name: (table.column(name).cast(pa.float64(), safe=False).to_numpy(), unit)
        for name, (own, unit) in split.items()
        if pa.types.is_floating(table.column(name).type) or pa.types.is_integer(table.column(name).type)
    }
    signals, source, restarts = share_time(columns, options.clock, str(path))
    return Recording(path, "Parquet", signals, None, (f"Parquet: {len(columns)} columns",), restarts=restarts, source=source)
