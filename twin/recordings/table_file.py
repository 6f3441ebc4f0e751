"""A Parquet or CSV file of others as columns of numbers. Text, repeated columns and files that are too large once read are refused.

What comes out of a Parquet file counts, not what lies on disk: a column of one long text in many rows is stored once, and a list of a thousand
million zeros in a few bytes. So the size is estimated from the metadata, texts stay in their dictionary, lists are not read, and the sum over the
batches that are read has a limit of its own.
"""

from collections import Counter
from collections.abc import Sequence
import contextlib
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.documents import reading
from twin.errors import InputError, no_file
from twin.limits import refuse_bytes
from twin.system import shell_word

BATCH = 1 << 16
"""Rows that are decoded at a time."""
REMEDY = "export the recording in parts"
BYTES_PER_NUMBER = 8.0


def read_parquet(path: Path, remedy: str = "write it again") -> Any:
    """A pyarrow table of the columns of a file without lists and structs. Raises InputError."""
    import pyarrow as pa
    import pyarrow.parquet

    with reading(path, "Parquet file", remedy), path.open("rb") as opened:
        first = pyarrow.parquet.ParquetFile(opened)
        kinds = (pa.string(), pa.binary(), pa.large_string(), pa.large_binary())
        texts = [field.name for field in first.schema_arrow if field.type in kinds]
        file = pyarrow.parquet.ParquetFile(opened, read_dictionary=texts, metadata=first.metadata)
        refuse_bytes(decoded_bytes(file.metadata), str(path), REMEDY)
        schema = file.schema_arrow
        chosen = [i for i, field in enumerate(schema) if not pa.types.is_nested(field.type)]
        _refuse_twice(schema.names, path)  # a batch is chosen by names
        batches, taken = [], 0.0
        for batch in file.iter_batches(BATCH, columns=[schema.names[i] for i in chosen]):
            taken += batch.nbytes
            refuse_bytes(taken, str(path), REMEDY)
            batches.append(batch)
        return pa.Table.from_batches(batches, pa.schema([schema.field(i) for i in chosen], schema.metadata))


def decoded_bytes(about: Any) -> float:
    """Estimate of what the columns of a Parquet file take once they are decoded, from its metadata [bytes].

    The metadata of single columns are not asked: pyarrow ends the process where they contradict each other.
    """
    numbers = BYTES_PER_NUMBER * about.num_rows * about.num_columns
    return float(max(numbers, sum(about.row_group(group).total_byte_size for group in range(about.num_row_groups))))


def _refuse_twice(names: Sequence[str], path: Path) -> None:
    if twice := [name for name, count in Counter(names).items() if count > 1]:
        raise InputError(f"{path}: column '{twice[0]}' occurs twice; remove one")


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Columns of a Parquet or CSV file as float arrays."""
    import pyarrow as pa

    if not path.is_file():
        raise no_file(path, "give a trace (.parquet or .csv)")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; write it again")
    if path.suffix.lower() == ".parquet":
        table = read_parquet(path)
    else:
        with reading(path, "CSV file", "write it again"):
            table = _csv(path)
    names = table.column_names
    if table.num_rows == 0:
        raise InputError(f"{path}: the trace is empty; record at least two samples")
    _refuse_twice(names, path)
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
    """Estimate of the memory that `read_table` takes for a file, from its metadata or its size [bytes]; 0 if it cannot be read, which its reader reports."""
    import pyarrow.parquet

    with contextlib.suppress(Exception), path.open("rb") as opened:
        return (
            decoded_bytes(pyarrow.parquet.ParquetFile(opened).metadata) if path.suffix.lower() == ".parquet" else float(path.stat().st_size)
        )
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
        if (found := uneven_row(error)) is None:
            raise
        raise InputError(
            f"{path}: line {found[0]} {found[1]}; correct it, or import a recording of a control: twin import {shell_word(path)} --out CAMPAIGN"
        ) from None
    return table


def uneven_row(error: Exception) -> tuple[int, str] | None:
    """Line, and what it holds, of a row with too many or too few cells that the CSV reader of pyarrow reports; None for another fault."""
    found = re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+): (.*)", str(error), re.S)
    return (int(found[1]), f"has {found[3]} of {found[2]} cells: '{found[4][:60].strip()}'") if found else None


def _is_number(cell: object) -> bool:
    try:
        float(str(cell))
    except ValueError:
        return False
    return True
