"""The reader of a file: its first bytes decide, the ending only where they do not. To add a format, add a module with `read(path, options)` and a line here."""

from __future__ import annotations

import importlib
from pathlib import Path

from twin.documents import reading
from twin.errors import InputError
from twin.recordings.signals import ReadOptions, Recording, check_readable

_BEGINS: tuple[tuple[bytes, str], ...] = (
    (b"TDSm", "tdms"),
    (b"MDF ", "mdf"),
    (b"UnFinMF ", "mdf"),
    (b"PAR1", "parquet"),
    (b"MATLAB ", "matlab"),
    (b"\x89HDF", "matlab"),
    (b"<", "sinumerik"),
    (b"{", "sinumerik_edge"),
)
_BINARY = {".tdms": "tdms", ".mf4": "mdf", ".mdf": "mdf", ".mat": "matlab", ".parquet": "parquet"}
_NAMES = {"tdms": "TDMS file", "mdf": "MDF file", "parquet": "Parquet file", "matlab": "MATLAB file", "sinumerik": "SINUMERIK trace",
          "sinumerik_edge": "SINUMERIK Edge recording", "delimited": "text of numbers"}  # fmt: skip
FORMATS = "text of any layout (.csv .txt .log .dat ...), SINUMERIK trace (.xml) and Edge (.json), .tdms .mf4 .mat .parquet"


def read_recording(path: str | Path, options: ReadOptions) -> Recording:
    """Read a recorded file of any known format.

    Raises:
        InputError: the file is missing, empty, damaged or holds no signal.
    """
    path = Path(path)
    check_readable(path)
    reader = _reader(path)
    if options.dialect.get("columns") and reader != "delimited":
        raise InputError(f"{path}: its format names its columns; --columns is for text without a heading")
    with reading(path, _NAMES[reader]):  # the one boundary: whatever a reader or its library raises becomes one line
        recording = importlib.import_module(f"twin.recordings.formats.{reader}").read(path, options)
    if not recording.signals:
        raise InputError(f"{path}: holds no signal; export the recording again")
    return recording


def _reader(path: Path) -> str:
    with open(path, "rb") as file:
        head = file.read(64)
    begin = head.removeprefix(b"\xef\xbb\xbf").removeprefix(b"\xff\xfe").removeprefix(b"\xfe\xff").replace(b"\x00", b"").lstrip()
    named = next((reader for magic, reader in _BEGINS if begin.startswith(magic)), "")
    # the binary formats say themselves what is missing where the first bytes are not theirs
    return named or _BINARY.get(path.suffix.lower(), "delimited")
