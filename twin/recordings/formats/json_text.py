"""JSON: a recording of a SINUMERIK Edge, or a table of anyone: rows as objects (in a list, or one a line), or one list of numbers for each column.

{"Header": ..., "Payload": ...}            SINUMERIK Edge
[{"t": 0.0, "pos": 1.2}, ...]              rows, also without the brackets and commas, one a line
{"t": [0.0, ...], "pos": [1.2, ...]}       columns
"""

from __future__ import annotations

from collections.abc import Mapping
import json
from pathlib import Path
from typing import Any

from twin.documents import read_json, read_text
from twin.errors import InputError
from twin.recordings.formats import sinumerik_edge
from twin.recordings.formats.parquet import recording_of, rows_of
from twin.recordings.signals import ReadOptions, Recording

EDGE = b'"Header"'
BEGIN_BYTES = 4096
LARGEST_BYTES = 100_000_000
"""A table as objects takes ten times its size in memory [bytes]."""
SHAPE = "neither rows as objects nor columns as lists of numbers; export the recording as CSV"


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the recording of a SINUMERIK Edge, or a table."""
    with path.open("rb") as file:
        if EDGE in file.read(BEGIN_BYTES):
            return sinumerik_edge.read(path, options)
    import pyarrow as pa

    document = _document(path)
    try:
        table = pa.Table.from_pylist(document) if isinstance(document, list) else pa.table(document)
    except (pa.ArrowException, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: {SHAPE}") from None
    table = table.flatten()
    lists = {n: rows for n in table.column_names if pa.types.is_list(table[n].type) and (rows := rows_of(table[n])) is not None}
    return recording_of(table, "JSON", path, options, lists)


def _document(path: Path) -> Any:
    """The rows, a list of objects, or the columns, an object. Raises InputError for anything else."""
    text = read_text(path, "a JSON recording", LARGEST_BYTES).strip()
    lines = text.splitlines()
    if text.startswith("{") and not (len(lines) > 1 and lines[0].rstrip().endswith("}")):
        return read_json(path, "a whole JSON file", LARGEST_BYTES)
    try:
        document = json.loads(text) if text.startswith("[") else [json.loads(line) for line in lines if line.strip()]
    except (ValueError, RecursionError):
        raise InputError(f"{path}: not a whole JSON file; the file is truncated or damaged: write it again") from None
    if not (isinstance(document, list) and document and all(isinstance(row, Mapping) for row in document)):
        raise InputError(f"{path}: {SHAPE}")
    return document
