"""Messages of ROS as the command line prints them: `ros2 topic echo /joint_states > run.txt`, `---` between them.

A message is a mapping in YAML, of which only what these programs write is read: nested keys, and lists of numbers or names, with a dash a line or in
brackets. Lists beside a list of names belong to them: `elbow_joint/position`.
"""

from collections.abc import Iterator
from pathlib import Path
import re

from twin.documents import LARGEST_JSON_BYTES, read_text
from twin.errors import InputError
from twin.recordings.formats.parquet import table_recording
from twin.recordings.signals import ReadOptions, Recording

Scalar = float | str | None
_LINE = re.compile(r"( *)(?:(- )|([\w.]+):)\s*(.*)")


def read(path: Path, options: ReadOptions) -> Recording:
    """Each number of the messages as a signal."""
    import pyarrow as pa

    rows = [row for text in re.split(r"(?m)^---\s*$", read_text(path, "a text of messages", LARGEST_JSON_BYTES)) if (row := _row(text))]
    if len(rows) < 2:
        raise InputError(f"{path}: only {len(rows)} message{'s' * (len(rows) != 1)}; a trace needs at least two")
    names = dict.fromkeys(name for row in rows for name in row)
    return table_recording(pa.table({name: [row.get(name) for row in rows] for name in names}), "messages of ROS", path, options)


def _row(text: str) -> dict[str, float]:
    """The numbers of one message by their names."""
    lists: dict[str, list[Scalar]] = {}
    for name, value in _values(text):
        lists.setdefault(name, []).append(value)
    names = next((own for own in lists.values() if len(own) > 1 and all(isinstance(one, str) for one in own)), [])
    out: dict[str, float] = {}
    for name, own in lists.items():
        named = [f"{joint}/{name}" for joint in names] if len(own) == len(names) else [f"{name}[{i}]" for i in range(len(own))]
        out |= {full: one for full, one in zip(named if len(own) > 1 else [name], own) if isinstance(one, float)}
    return out


def _values(text: str) -> Iterator[tuple[str, Scalar]]:
    """Path and value of each line of a message; those of a list share their path."""
    path: list[tuple[int, str]] = []
    for line in filter(None, map(_LINE.fullmatch, text.splitlines())):
        depth = len(line[1]) + bool(line[2])  # a dash may stand below the key itself
        path = [(at, key) for at, key in path if at < depth]
        if line[3]:
            path.append((depth, line[3]))
        name = ".".join(key for _, key in path)
        for one in line[4].strip("[] ").split(",") if line[4].strip() else ():
            yield name, _scalar(one.strip())


def _scalar(text: str) -> Scalar:
    """A number, None for none, or a word."""
    try:
        value = float(text)
    except ValueError:
        return None if text in (".nan", "null") else text.strip("'\"")
    return value if value == value else None
