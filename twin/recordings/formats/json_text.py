"""JSON: a recording of a SINUMERIK Edge, or a table of anyone: rows as objects (in a list, or one a line), or one list of numbers for each column.

{"Header": ..., "Payload": ...}            SINUMERIK Edge
[{"t": 0.0, "pos": 1.2}, ...]              rows, also without the brackets and commas, one a line
{"t": [0.0, ...], "pos": [1.2, ...]}       columns
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.documents import LARGEST_JSON_BYTES, json_of, read_text
from twin.errors import InputError
from twin.recordings.formats import sinumerik_edge
from twin.recordings.formats.parquet import list_columns, table_recording
from twin.recordings.signals import ReadOptions, Recording

KIND = "a whole JSON file"
LARGEST_BYTES = 100_000_000
"""A table as objects takes ten times its size in memory [bytes]."""
SHAPE = "neither a recording of a SINUMERIK Edge nor rows as objects nor columns as lists of numbers; export it as CSV"


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the recording of a SINUMERIK Edge, or a table."""
    document = _document(path)
    if isinstance(document, Mapping) and {"Header", "Payload"} & document.keys():
        return sinumerik_edge.recording_of(document, path, options)
    if (size := path.stat().st_size) > LARGEST_BYTES:
        raise InputError(
            f"{path}: {size / 1e6:.0f} MB is too large for a table in JSON, the limit is {LARGEST_BYTES / 1e6:.0f} MB; export it as CSV"
        )
    import pyarrow as pa

    try:
        table = (pa.Table.from_pylist(document) if isinstance(document, list) else pa.table(document)).flatten()
    except (pa.ArrowException, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: {SHAPE}") from None
    return table_recording(table, "JSON", path, options, list_columns(table))


def _document(path: Path) -> Any:
    """The content: an object, or a list of rows, which may also stand one a line."""
    text = read_text(path, KIND, LARGEST_JSON_BYTES).strip()
    first, _, rest = text.partition("\n")
    if text.startswith("{") and first.rstrip().endswith("}") and rest.lstrip().startswith("{"):
        text = f"[{','.join(line for line in text.splitlines() if line.strip())}]"
    return json_of(text, str(path), KIND)
