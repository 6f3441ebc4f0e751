"""Files in files: a workbook (.xlsx), arrays of numpy (.npz), and one recording in a ZIP or gzip archive.

A sheet becomes a text of cells separated by tabs, so that headings, units and dates are found as in any text.
"""

import csv
from dataclasses import replace
from datetime import datetime, timedelta
import gzip
from pathlib import Path
from typing import IO
import zipfile

from twin.errors import InputError
from twin.limits import refuse_bytes
from twin.recordings.formats import arrays, delimited
from twin.recordings.signals import ReadOptions, Recording, head_of, of_given_file
from twin.recordings.table_file import REMEDY

_BLOCK = 1 << 22


def read(path: Path, options: ReadOptions) -> Recording:
    """The recording in an archive; what is packed is known from what the archive holds, not from its ending."""
    folder = options.scratch / f"{path.name}.unpacked"
    folder.mkdir(parents=True, exist_ok=True)
    if not zipfile.is_zipfile(path):
        with gzip.open(path) as packed:
            return _inner(packed, folder / path.name.removesuffix(".gz"), path, options)
    with zipfile.ZipFile(path) as archive:
        files = [one for one in archive.infolist() if not one.is_dir() and not one.filename.startswith("__MACOSX/")]
        if any(one.filename == "xl/workbook.xml" for one in files):
            refuse_bytes(float(sum(one.file_size for one in files)), str(path), REMEDY)
            return _sheet(path, options)
        if files and all(one.filename.endswith(".npy") for one in files):
            return arrays.read(path, options)
        if len(files) != 1:
            raise InputError(f"{path}: an archive of {len(files)} files; unpack it and give the recordings")
        with archive.open(files[0]) as packed:
            return _inner(packed, folder / Path(files[0].filename).name, path, options)


def _inner(packed: IO[bytes] | gzip.GzipFile, file: Path, path: Path, options: ReadOptions) -> Recording:
    """The one file of an archive, read as if it had been given. An archive in an archive is refused."""
    from twin.recordings.formats.by_content import read_recording

    with file.open("wb") as out:
        while block := packed.read(_BLOCK):
            out.write(block)
            refuse_bytes(float(out.tell()), str(path), REMEDY)
    if head_of(file).startswith((b"PK", b"\x1f\x8b")):
        raise InputError(f"{path}: an archive in an archive; unpack it")
    return of_given_file(path, file, lambda: read_recording(file, options))


def _sheet(path: Path, options: ReadOptions) -> Recording:
    """The largest sheet of a workbook, as text."""
    try:
        from python_calamine import CalamineWorkbook
    except ImportError:
        raise InputError(f"{path}: a workbook needs the package python-calamine; install it with: pip install 'twin[excel]'") from None
    book = CalamineWorkbook.from_path(str(path))
    sheets = [book.get_sheet_by_name(name) for name in book.sheet_names]
    sheet = max(sheets, key=lambda one: one.total_height * one.total_width)

    def write(file: Path) -> None:
        with file.open("w", encoding="utf-8", newline="") as out:
            csv.writer(out, delimiter="\t", lineterminator="\n").writerows([_cell(value) for value in row] for row in sheet.iter_rows())

    recording = delimited.read_made(path, options, write)
    others = [name for name in book.sheet_names if name != sheet.name]
    notes = (f"sheet '{sheet.name}'" + (f"; not read: {', '.join(others)}" if others else ""), *recording.notes[1:])
    return replace(recording, format="Excel", notes=notes)


def _cell(value: object) -> str:
    """A cell as it would stand in an exported text. A whole number has no decimals, a duration is in s."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    if isinstance(value, timedelta):
        return repr(value.total_seconds())
    return value.isoformat(" ") if isinstance(value, datetime) else " ".join(str(value).split())
