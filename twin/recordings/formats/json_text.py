"""JSON: a recording of a SINUMERIK Edge, or a table of anyone: rows, columns or channels.

{"Header": ..., "Payload": ...}                                    SINUMERIK Edge
[{"t": 0.0, "pos": 1.2}, ...]                                      rows, also without the brackets and commas, one a line
{"t": [0.0, ...], "pos": [1.2, ...]}                               columns
{"columns": ["t", "pos"], "data": [[0.0, 1.2], ...]}               names and rows
{"channels": [{"name": "pos", "unit": "mm", "data": [1.2, ...]}]}  channels; single numbers beside them may be the interval
{"test 1": [[0.0, 1.2], ...], "test 2": [[9.0, 1.4], ...]}         pieces: rows of as many numbers, without names
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import UnionType
from typing import Any

from twin.documents import LARGEST_JSON_BYTES, json_of, read_text
from twin.errors import InputError
from twin.recordings.formats import sinumerik_edge
from twin.recordings.formats.parquet import LONGEST_LIST, table_recording
from twin.recordings.signals import ReadOptions, Recording
from twin.recordings.time_column import UNNAMED

KIND = "a whole JSON file"
LARGEST_BYTES = 100_000_000
"""A table as objects takes ten times its size in memory [bytes]."""
SHAPE = "neither a recording of a SINUMERIK Edge nor rows, columns or channels of numbers; export it as CSV"
_LABELS, _VALUES, _UNITS = ("name", "label", "signal", "channel", "id"), ("data", "values", "samples", "y"), ("unit", "units")
"""Keys of a channel."""


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the recording of a SINUMERIK Edge, or a table."""
    text = read_text(path, KIND, LARGEST_JSON_BYTES).strip()
    first, _, rest = text.partition("\n")
    if text.startswith("{") and first.rstrip().endswith("}") and rest.lstrip().startswith("{"):  # rows, one a line
        text = f"[{','.join(line for line in text.splitlines() if line.strip())}]"
    document = json_of(text, str(path), KIND)
    if isinstance(document, Mapping) and {"Header", "Payload"} & document.keys():
        return sinumerik_edge.recording_of(document, path, options)
    if (size := path.stat().st_size) > LARGEST_BYTES:
        too_large = f"{size / 1e6:.0f} MB is too large for a table in JSON, the limit is {LARGEST_BYTES / 1e6:.0f} MB"
        raise InputError(f"{path}: {too_large}; export it as CSV")
    import pyarrow as pa

    found = dict(_found("", document))
    columns = {name: values for name, values in found.items() if isinstance(values, list)}
    lengths = Counter(map(len, columns.values())).most_common(1)
    if not lengths:
        raise InputError(f"{path}: {SHAPE}")
    try:
        table = pa.table({name: values for name, values in columns.items() if len(values) == lengths[0][0]})
        while any(pa.types.is_struct(field.type) for field in table.schema):
            table = table.flatten()
    except (pa.ArrowException, TypeError, ValueError, AttributeError):
        raise InputError(f"{path}: {SHAPE}") from None
    return table_recording(table, "JSON", path, options, {n: v for n, v in found.items() if isinstance(v, int | float)})


def _found(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Columns (lists) and single numbers of a document, by their path."""
    if isinstance(value, Mapping):
        label, values, unit = (next((value[key] for key in keys if key in value), None) for keys in (_LABELS, _VALUES, _UNITS))
        heads: list[str] = next((own for own in value.values() if _of(own, str)), [])
        pieces = [own for own in value.values() if _of(own, list) and all(_of(row, int | float) for row in own)]
        if isinstance(label, str) and isinstance(values, list):
            yield (f"{label} [{unit}]" if unit else label), values
        elif heads and _of(values, list) and all(len(row) == len(heads) for row in values or ()):
            yield from ((head, list(own)) for head, own in zip(heads, zip(*values)))  # type: ignore[misc]
        elif len(pieces) > 1 and len({len(row) for own in pieces for row in own}) == 1 < len(pieces[0][0]) <= LONGEST_LIST:
            rows = [row for own in sorted(pieces, key=lambda own: own[0][0]) for row in own]
            yield from ((UNNAMED.format(i + 1), list(own)) for i, own in enumerate(zip(*rows)))
        else:
            for key, own in value.items():
                yield from _found(f"{name}.{key}".lstrip("."), own)
    elif _of(value, Mapping) and any(isinstance(value[0].get(key), list) for key in _VALUES) and value[0].keys() & set(_LABELS):
        for channel in value:
            yield from _found(name, channel)
    elif _of(value, Mapping):
        for key in dict.fromkeys(k for row in value for k in row):
            yield f"{name}.{key}".lstrip("."), [row.get(key) for row in value]
    elif isinstance(value, list | int | float) and not isinstance(value, bool):
        yield name, value


def _of(value: Any, kind: type | UnionType) -> bool:
    """True for a list of this kind with at least one element."""
    return isinstance(value, list) and bool(value) and all(isinstance(one, kind) for one in value)
