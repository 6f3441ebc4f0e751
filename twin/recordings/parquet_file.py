"""Parquet files of others, read in batches: what comes out counts, not what lies on disk.

A column of one long text in many rows is stored once, and a list of a thousand million zeros in a few bytes. So the size of what comes out is
estimated from the metadata, texts stay in their dictionary, lists are not read, and the sum over the batches that are read has a limit of its own.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Any

from twin.documents import reading
from twin.errors import InputError
from twin.limits import refuse_bytes

BATCH = 1 << 16
"""Rows that are decoded at a time."""
REMEDY = "export the recording in parts"
BYTES_PER_NUMBER = 8.0


def read_parquet(path: Path, kind: str = "Parquet file", remedy: str = "write it again", names: Collection[str] | None = None) -> Any:
    """A pyarrow table of the columns `names` (None: all), without lists and structs. Raises InputError."""
    import pyarrow as pa
    import pyarrow.parquet

    with reading(path, kind, remedy), path.open("rb") as opened:
        first = pyarrow.parquet.ParquetFile(opened)
        texts = [field.name for field in first.schema_arrow if _is_text(field.type)]
        file = pyarrow.parquet.ParquetFile(opened, read_dictionary=texts, metadata=first.metadata)
        refuse_bytes(decoded_bytes(file.metadata), str(path), REMEDY)
        schema = file.schema_arrow
        chosen = [i for i, field in enumerate(schema) if (names is None or field.name in names) and not pa.types.is_nested(field.type)]
        if len(set(schema.names)) < len(schema.names):  # a batch is chosen by names
            twice = next(name for name in schema.names if schema.names.count(name) > 1)
            raise InputError(f"{path}: column '{twice}' occurs twice; remove one")
        batches, taken = [], 0.0
        for batch in file.iter_batches(BATCH, columns=[schema.names[i] for i in chosen]):
            taken += batch.nbytes
            refuse_bytes(taken, str(path), REMEDY)
            batches.append(batch)
        return pa.Table.from_batches(batches, pa.schema([schema.field(i) for i in chosen], schema.metadata))


def text_bytes(table: Any) -> float:
    """What the texts of a table take as Python objects, at most [bytes]; a text that many rows share is made for each of them."""
    import pyarrow as pa
    import pyarrow.compute

    total = 0.0
    for column in table.columns:
        for chunk in column.chunks:
            texts = chunk.dictionary if pa.types.is_dictionary(chunk.type) else chunk
            if _is_text(texts.type) and len(texts):
                total += len(chunk) * (pyarrow.compute.max(pyarrow.compute.binary_length(texts)).as_py() or 0.0)
    return total


def decoded_bytes(about: Any) -> float:
    """Estimate of what the columns of a Parquet file take once they are decoded, from its metadata [bytes]."""
    total = 0.0
    for group in range(about.num_row_groups):
        for column in range(about.num_columns):
            chunk = about.row_group(group).column(column)
            total += max(BYTES_PER_NUMBER * chunk.num_values, float(chunk.total_uncompressed_size))
    return total


def parquet_bytes(path: Path) -> float:
    """`decoded_bytes` of a file; 0 if it cannot be read, which its reader reports."""
    import pyarrow.parquet

    try:
        with path.open("rb") as opened:
            return decoded_bytes(pyarrow.parquet.ParquetFile(opened).metadata)
    except Exception:
        return 0.0


def _is_text(kind: Any) -> bool:
    import pyarrow as pa

    return any(test(kind) for test in (pa.types.is_string, pa.types.is_binary, pa.types.is_large_string, pa.types.is_large_binary))
