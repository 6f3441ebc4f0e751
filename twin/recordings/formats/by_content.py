"""The reader of a file: its first bytes decide, the ending only where they do not. To add a format, add a module with `read(path, options)` and a line here."""

import importlib
import importlib.util
from pathlib import Path
from typing import NamedTuple

from twin.documents import reading
from twin.errors import InputError
from twin.recordings.on_change import with_values_held
from twin.recordings.signals import ReadOptions, Recording, head_of
from twin.recordings.timing import without_repeats
from twin.recordings.wrapped import unwrapped


class _Format(NamedTuple):
    """A format: its name, first bytes, endings, and the package on PyPI that reads it; the extra that installs it is called like the module.

    `sure`: every file of it begins with these bytes. `module`: the one that reads it, if it is not called like the format.
    """

    name: str
    begins: tuple[bytes, ...] = ()
    endings: tuple[str, ...] = ()
    package: str = ""
    sure: bool = True
    module: str = ""


_FORMATS = {
    "tdms": _Format("a TDMS file", (b"TDSm",), (".tdms",), "npTDMS"),
    "mdf": _Format("an MDF file", (b"MDF ", b"UnFinMF "), (".mf4", ".mdf"), "asammdf"),
    "parquet": _Format("a Parquet file", (b"PAR1",), (".parquet",)),
    "matlab": _Format("a MATLAB file", (b"MATLAB ",), (".mat",), sure=False),
    "hdf5": _Format("an HDF5 file", (b"\x89HDF",), (".h5", ".hdf5"), "h5py"),
    "arrow": _Format("an Arrow file", (b"ARROW1",), (".arrow", ".feather"), module="parquet"),
    "arrays": _Format("an array of numpy", (b"\x93NUMPY",), (".npy",)),
    "packed": _Format("an archive", (b"PK\x03\x04", b"\x1f\x8b"), (".xlsx", ".npz", ".zip", ".gz")),
    "xml_text": _Format("an XML recording", (b"<",)),
    "json_text": _Format("a JSON recording", (b"{", b"[{", b"[[")),
    "ros_text": _Format("a text of messages", (b"header:",)),
    "delimited": _Format("a text of numbers", sure=False),
}
"""By the module that reads them."""
FORMATS = "text of any layout (.csv .txt .log .dat ...), SINUMERIK trace and MTConnect (.xml), Edge and other .json .xlsx .tdms .mf4 .mat .h5 .npz .arrow .parquet; .zip .gz of one of them"


def read_recording(path: str | Path, options: ReadOptions) -> Recording:
    """Read a recorded file of any known format.

    Raises:
        InputError: the file is missing, empty, damaged or holds no signal, or the package for its format is not installed.
    """
    path = Path(path)
    head = head_of(path).removeprefix(b"\xef\xbb\xbf").removeprefix(b"\xff\xfe").removeprefix(b"\xfe\xff").replace(b"\x00", b"").lstrip()
    heads = head, b"".join(head.split())  # JSON may have spaces between its brackets
    begun = next((reader for reader, form in _FORMATS.items() if any(own.startswith(form.begins) for own in heads)), "")
    reader = begun or next((reader for reader, form in _FORMATS.items() if path.suffix.lower() in form.endings), "delimited")
    form = _FORMATS[reader]
    if not begun and form.sure:
        raise InputError(f"{path}: not {form.name}; give it the ending of its true format")
    if options.dialect.get("columns") and reader not in ("delimited", "packed"):
        raise InputError(f"{path}: its format names its columns; --columns is for text without a heading")
    if form.package and importlib.util.find_spec(form.package.lower()) is None:
        raise InputError(f"{path}: {form.name} needs the package {form.package}; install it with: pip install 'twin[{reader}]'")
    with reading(path, form.name.split(" ", 1)[1]):  # the one boundary: whatever a reader or its library raises becomes one line
        recording = importlib.import_module(f"twin.recordings.formats.{form.module or reader}").read(path, options)
    if not recording.signals:
        raise InputError(f"{path}: holds no signal beside a time or numbers of the rows; export the signals of the axes with their time")
    return unwrapped(with_values_held(without_repeats(recording)))
