"""Parquet, Arrow and Feather: columns of numbers, with units from the headings ('X.position [mm]'), and lists of one length, one element for each joint.

A table with dates, or with one value a row under a name, is read as its text would be.
"""

from collections.abc import Mapping
import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.formats import delimited
from twin.recordings.formats.arrays import arrays_recording, try_first
from twin.recordings.formats.text_cells import is_stamp
from twin.recordings.signals import ReadOptions, Recording, head_of
from twin.recordings.table_file import REMEDY, read_parquet

LONGEST_LIST = 64
"""Elements of a list that can be joints; a longer one is a picture or a spectrum."""
LONGEST_WORD = 100
"""Characters of a name or a date."""
FEW = 3
"""Most columns of numbers beside the names and values of a long table: value, time, number of the row."""
_TRIAL = "import sys, pyarrow.parquet\npyarrow.parquet.read_table(sys.argv[1], columns=sys.argv[2:], use_threads=False)"


def read(path: Path, options: ReadOptions) -> Recording:
    """All columns of numbers, on the map's time column or interval."""
    import pyarrow as pa
    import pyarrow.parquet

    if head_of(path).startswith(b"ARROW1"):
        batches, taken = [], 0.0
        with pa.OSFile(str(path)) as opened:
            file = pa.ipc.open_file(opened)
            for i in range(file.num_record_batches):
                batches.append(file.get_batch(i))
                taken += batches[-1].nbytes
                refuse_bytes(taken, str(path), REMEDY)
        return table_recording(pa.Table.from_batches(batches, file.schema), "Arrow", path, options)
    table = read_parquet(path, remedy="export it again")
    if names := [field.name for field in pyarrow.parquet.read_schema(path) if _is_list(field.type)]:
        with contextlib.suppress(InputError):  # a short file may hold a thousand million zeros in one row
            try_first(path, "Parquet", _TRIAL, *names)
            for name, column in zip(names, pyarrow.parquet.read_table(path, columns=names).columns):
                table = table.append_column(name, column)
    return table_recording(table, "Parquet", path, options)


def table_recording(table: Any, kind: str, path: Path, options: ReadOptions, single: Mapping[str, float] | None = None) -> Recording:
    """The columns of numbers of a pyarrow table, and lists of one length, as signals. `single`: numbers beside the table."""
    import pyarrow as pa
    import pyarrow.compute as pc
    import pyarrow.csv

    numbers, words = dict[str, Any](), dict[str, Any]()
    for name, column in zip(table.column_names, table.columns):
        if pa.types.is_floating(column.type) or pa.types.is_integer(column.type):
            numbers[name] = column
        elif _is_list(column.type):
            rows = _rows_of(column)
            numbers |= {f"{name}[{i}]": pa.chunked_array([rows[:, i]]) for i in range(rows.shape[1])}
        elif not pa.types.is_nested(column.type) and not pa.types.is_boolean(column.type):
            texts = column.unique().cast(pa.string()).drop_null()  # a long text in many rows is stored once
            if len(texts) > 1 and pc.max(pc.utf8_length(texts)).as_py() <= LONGEST_WORD:
                words[name] = column.cast(pa.string())
    if any(is_stamp(one.drop_null()[0].as_py()) for one in words.values()) or (words and len(numbers) <= FEW):
        found = delimited.read_made(path, options, lambda file: pa.csv.write_csv(pa.table(numbers | words), file))
        note = f"{kind}: {len(numbers)} columns of numbers, {len(words)} of dates or words"
        return replace(found, format=kind, notes=(note, *found.notes[1:]))
    arrays = {name: column.cast(pa.float64(), safe=False).to_numpy() for name, column in numbers.items()}
    found = arrays_recording(arrays | {name: np.array(value) for name, value in (single or {}).items()}, kind, path, options)
    return replace(found, notes=(f"{kind}: {len(arrays)} columns", *found.notes[1:]))


def _is_list(kind: Any) -> bool:
    import pyarrow as pa

    listed = pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind)
    return listed and (pa.types.is_floating(kind.value_type) or pa.types.is_integer(kind.value_type))


def _rows_of(column: Any) -> np.ndarray:
    """A column of lists as (row, element); no element if their lengths differ, or are no number of joints."""
    import pyarrow.compute as pc

    lengths = pc.list_value_length(column).drop_null().unique().to_pylist()
    if column.null_count or len(lengths) != 1 or not 0 < lengths[0] <= LONGEST_LIST:
        return np.empty((len(column), 0))
    return np.asarray(pc.list_flatten(column).to_numpy(), float).reshape(-1, lengths[0])
