"""A Parquet or CSV file as columns of numbers. Text, repeated columns and files that are too large are refused."""

from __future__ import annotations

from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.documents import reading
from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.parquet_file import parquet_bytes, read_parquet


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a Parquet or CSV file as float arrays."""
    import pyarrow as pa

    if not path.is_file():
        raise InputError(f"{path}: no such file; give a trace (.parquet or .csv)")
    if path.suffix == ".parquet":
        table = read_parquet(path)
    else:
        with reading(path, "CSV file", "write it again"):
            table = _csv(path)
    names = table.column_names
    if table.num_rows == 0:
        raise InputError(f"{path}: the trace is empty; record at least two samples")
    if len(set(names)) != len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise InputError(f"{path}: column '{twice}' occurs twice; remove one")
    columns = {}
    for name in names:
        column = table.column(name)
        if not (pa.types.is_floating(column.type) or pa.types.is_integer(column.type)):
            cells = (cell.as_py() for cell in column)
            row, cell = next(((i, c) for i, c in enumerate(cells, start=1) if not _is_number(c)), (1, column[0].as_py()))
            raise InputError(f"{path}: column '{name}': row {row} holds {str(cell)[:40]!r}, which is not a number; correct or remove it")
        columns[name] = column.cast(pa.float64(), safe=False).to_numpy()  # missing cells become NaN
    return columns


def table_bytes(path: Path) -> float:
    """Estimate of the memory that `read_table` takes for a file, from its metadata or its size [bytes]."""
    if path.suffix == ".parquet":
        return parquet_bytes(path)
    try:
        return float(path.stat().st_size)
    except OSError:  # its reader reports it
        return 0.0


def refuse_large_text(path: Path) -> None:
    """Refuse a text, also a compressed one, whose cells would take too much memory as numbers."""
    import pyarrow as pa

    size = cells = 0
    with pa.input_stream(str(path), compression="detect") as stream:
        while block := stream.read(1 << 22):
            size, cells = size + len(block), cells + block.count(b",") + block.count(b"\n")
            refuse_bytes(max(size, 8 * cells), str(path), "cut the recording into runs")


def _csv(path: Path) -> Any:
    """The table of a CSV file in UTF-8 or, if that fails, in Latin-1."""
    import pyarrow as pa
    import pyarrow.csv

    refuse_large_text(path)
    try:
        table = pyarrow.csv.read_csv(path, read_options=pyarrow.csv.ReadOptions(use_threads=False))
        _ = table.column_names  # decodes the headings
    except UnicodeDecodeError:
        table = pyarrow.csv.read_csv(path, read_options=pyarrow.csv.ReadOptions(encoding="latin1"))
    except pa.ArrowInvalid as error:
        if not (found := re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+): (.*)", str(error), re.S)):
            raise
        line, expected, given, row = found.groups()
        raise InputError(f"{path}: line {line} has {given} of {expected} cells: '{row[:60].strip()}'; correct or remove it") from None
    return table


def _is_number(cell: object) -> bool:
    try:
        float(str(cell))
    except ValueError:
        return False
    return True
