"""Arrow and Feather files: the columns of numbers, and lists of one length, as in Parquet."""

from __future__ import annotations

from pathlib import Path

from twin.limits import refuse_bytes
from twin.recordings.formats.parquet import list_columns, table_recording
from twin.recordings.signals import ReadOptions, Recording
from twin.recordings.table_file import REMEDY


def read(path: Path, options: ReadOptions) -> Recording:
    """All columns of numbers, on the map's time column or interval."""
    import pyarrow as pa

    batches, taken = [], 0.0
    with pa.OSFile(str(path)) as opened:
        file = pa.ipc.open_file(opened)
        for i in range(file.num_record_batches):
            batches.append(file.get_batch(i))
            taken += batches[-1].nbytes
            refuse_bytes(taken, str(path), REMEDY)
    table = pa.Table.from_batches(batches, file.schema)
    return table_recording(table, "Arrow", path, options, list_columns(table))
