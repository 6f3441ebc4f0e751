"""The table of readers by file ending. To add a format, add a module with `read(path, options)` and a line here."""

from __future__ import annotations

import importlib
from pathlib import Path

from twin.errors import InputError, nearest
from twin.recordings.signals import ReadOptions, Recording, check_readable

READERS = {
    ".csv": "delimited",
    ".txt": "delimited",
    ".asc": "delimited",
    ".tsv": "delimited",
    ".dat": "delimited",
    ".xml": "sinumerik",
    ".json": "sinumerik_edge",
    ".tdms": "tdms",
    ".mf4": "mdf",
    ".mdf": "mdf",
    ".mat": "matlab",
    ".parquet": "parquet",
}


def read_recording(path: str | Path, options: ReadOptions) -> Recording:
    """Read a recorded file of any known format."""
    path = Path(path)
    check_readable(path)
    suffix = path.suffix.lower()
    if suffix not in READERS:
        raise InputError(f"{path}: no reader for '{suffix or 'a file without ending'}'; {nearest(suffix, READERS)}")
    recording = importlib.import_module(f"twin.recordings.formats.{READERS[suffix]}").read(path, options)
    if not recording.signals:
        raise InputError(f"{path}: holds no signal; export the recording again")
    return recording
