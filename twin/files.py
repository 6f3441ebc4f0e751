"""Output files: written completely or not at all, JSON without NaN, and a lock on each output folder."""

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
"""Format number of all JSON files."""


@contextlib.contextmanager
def beside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file next to `path`. It replaces `path` when the block ends, and is removed when the block raises.

    A full disk or a stopped command therefore leaves the old file or none, never a partial one. Several processes may write the same path. Creates
    the folder.

    Raises:
        InputError: the file cannot be written; the message names `path` and the reason.
    """
    path = Path(path)
    partial = path.with_name(f".{path.stem[:100]}.{os.getpid()}-{threading.get_ident()}{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        with partial.open("rb") as file:  # reports a full disk at the latest here
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); free some space or choose another path") from None
    except BaseException:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_whole(path: Path, text: str) -> None:
    """Write a text file completely or not at all, and create its folders.

    Raises:
        InputError: the file cannot be written.
    """
    with beside(path) as partial:
        partial.write_text(text, encoding="utf-8", errors="replace")  # file names may contain bytes that are not text


def stamped(content: Mapping[str, Any], schema: str) -> dict[str, Any]:
    """The document with its format and the version of twin in front: {"schema": "gap/1", "version": "0.1.0", ...}.

    `schema` names a JSON Schema in twin/report/schemas. Its number rises when a key is removed or changes its meaning.
    """
    return {"schema": f"{schema}/{FORMATS}", "version": twin.__version__, **content}


def write_json(content: Mapping[str, Any], path: Path, schema: str) -> None:
    """Write a stamped document as JSON. NaN and infinity, which JSON lacks, are written as null.

    Raises:
        InputError: the file cannot be written.
    """
    write_whole(path, json.dumps(_finite(stamped(content, schema)), indent=2, allow_nan=False) + "\n")


def shipped_example(path: str | Path) -> Path:
    """The path itself or, if it does not exist and starts with `examples/`, the example of that name shipped with twin.

    Examples lie inside an installed package, and beside the package in an editable installation.
    """
    given, package = Path(path), Path(twin.__file__).parent
    if given.exists() or given.parts[:1] != ("examples",):
        return given
    return next((shipped for folder in (package, package.parent) if (shipped := folder / given).exists()), given)


def output_folder(path: str | Path) -> Path:
    """Create a command's output folder and lock it for this command.

    Raises:
        InputError: the folder cannot be created, or another command is writing to it.
    """
    out = Path(path)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: cannot create this folder ({error.strerror}); choose another --out") from None
    if _held is not None:
        _hold(out, _held)
    return out


def output_file(path: str | Path) -> Path:
    """Path of an output file, checked before the work: its folder is created and must be writable.

    Raises:
        InputError: the file cannot be written there.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give a file name")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another path") from None
    return path


LOCK = ".twin-lock"
"""Lock file of a command in its output folder."""
_held: dict[Path, IO[str]] | None = None
"""Locked folders of the command of this process; None outside of a command."""


def hold_folders() -> None:
    """Start locking: from now on `output_folder` locks its folder for this command."""
    global _held
    _held = {} if _held is None else _held


def release_folders() -> None:
    """Release all folders of this command."""
    global _held
    for folder, file in (_held or {}).items():
        with contextlib.suppress(OSError):
            (folder / LOCK).unlink(missing_ok=True)
        file.close()
    _held = None


def _hold(folder: Path, held: dict[Path, IO[str]]) -> None:
    """Lock a folder until the command ends. The system releases the lock if the process is killed."""
    try:
        import fcntl
    except ImportError:  # a system without file locks
        return
    place = folder.resolve()
    if place in held:
        return
    try:
        file = (place / LOCK).open("a+", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror}); choose another --out") from None
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.seek(0)
        who = file.read(40).strip()
        file.close()
        raise InputError(
            f"{folder}: another twin command is writing here{f' (process {who})' if who else ''}; wait for it or choose another --out"
        ) from None
    except OSError:  # a file system without locks
        file.close()
        return
    if not _is_at(file, place / LOCK):  # removed by its owner between our open and our lock; there may be a new one
        file.close()
        return _hold(folder, held)
    with contextlib.suppress(OSError):
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
    held[place] = file


def _is_at(file: IO[str], path: Path) -> bool:
    """True if the path still refers to this open file."""
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
