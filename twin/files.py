"""Files that commands write: whole or not at all, JSON without NaN, one line where a place cannot be written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import contextlib
import json
import math
import os
from pathlib import Path
import tempfile
import threading
from typing import IO, Any

import twin
from twin.errors import InputError

FORMATS = 1
"""Number of the formats of all JSON files."""


@contextlib.contextmanager
def beside(path: str | Path) -> Iterator[Path]:
    """A file beside `path`, to write to: moved into place when all is written, removed when that fails or is stopped.

    A disk that is full, or a command that is stopped, so leaves the old file or none, never half of one. Others may do the same at the
    same time. Makes the folder.

    Raises:
        InputError: the place cannot be written to; the message names `path` and the reason.
    """
    path = Path(path)
    partial = path.with_name(f".{path.stem[:100]}.{os.getpid()}-{threading.get_ident()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        with partial.open("rb") as file:  # what the disk could not take is said here at the latest
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); free the disk or give another place") from None
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file whole or not at all, and the folders to it that are not there.

    Raises:
        InputError: the place cannot be written to.
    """
    with beside(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")  # names of files may hold bytes that are no text


def stamped(content: Mapping[str, Any], schema: str) -> dict[str, Any]:
    """A document headed by its format and the version of twin: {"schema": "gap/1", "version": "0.1.0", ...}.

    `schema` names a JSON Schema of twin/report/schemas; the number rises when a key goes or changes its meaning.
    """
    return {"schema": f"{schema}/{FORMATS}", "version": twin.__version__, **content}


def write_json(content: Mapping[str, Any], path: Path, schema: str) -> None:
    """Write a document with its stamp; JSON knows neither NaN nor infinity: such a value is written as null.

    Raises:
        InputError: the place cannot be written to.
    """
    write_whole(path, json.dumps(_finite(stamped(content, schema)), indent=2, allow_nan=False) + "\n")


def shipped_example(path: str | Path) -> Path:
    """The path itself; where it does not exist and begins with `examples/`, the example of that name that ships with the package.

    Examples lie inside an installed package, and beside the package in a checkout that is installed in place.
    """
    given, package = Path(path), Path(twin.__file__).parent
    if given.exists() or given.parts[:1] != ("examples",):
        return given
    return next((shipped for folder in (package, package.parent) if (shipped := folder / given).exists()), given)


def output_folder(path: str | Path) -> Path:
    """The folder of a command's output, made where it is not there.

    Raises:
        InputError: it cannot be made.
    """
    out = Path(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot make this folder ({error.strerror}); give another --out") from None
    if _held is not None:
        _hold(out, _held)
    return out


def output_file(path: str | Path) -> Path:
    """The file of a command's output, tried before the work is done: its folder is made, and can be written to.

    Raises:
        InputError: it cannot.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: a folder; give the name of a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another place") from None
    return path


LOCK = ".twin-lock"
"""File that a command holds in its folder while it writes there."""
_held: dict[Path, IO[str]] | None = None
"""Folders that the command of this process holds; None outside of a command."""


def hold_folders() -> None:
    """From here on a folder of `output_folder` belongs to this command: another one is refused there."""
    global _held
    _held = {} if _held is None else _held


def release_folders() -> None:
    """The command is done: its folders are free."""
    global _held
    for folder, file in (_held or {}).items():
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink(missing_ok=True)
        file.close()
    _held = None


def _hold(folder: Path, held: dict[Path, IO[str]]) -> None:
    """Hold a folder until the command is done; the system lets go of it where the process is killed."""
    try:
        import fcntl
    except ImportError:  # a system without such locks
        return
    place = folder.resolve()
    if place in held:
        return
    try:
        file = (place / LOCK).open("a+", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror}); give another --out") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        who = file.read(40).strip()
        file.close()
        raise InputError(
            f"{folder}: another command of twin writes here{f' (process {who})' if who else ''}; wait for it, or give another --out"
        ) from None
    except OSError:  # a file system without locks
        file.close()
        return
    if not _is_at(file, place / LOCK):  # its holder removed it between our opening and our locking: another one may be there
        file.close()
        return _hold(folder, held)
    with contextlib.suppress(OSError):
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
    held[place] = file


def _is_at(file: IO[str], path: Path) -> bool:
    """Is this open file still the one at that path?"""
    try:
        return os.path.samestat(os.fstat(file.fileno()), path.stat())
    except OSError:
        return False


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
