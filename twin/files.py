"""Output files: written completely or not at all, JSON without NaN, and a lock on each output folder."""

from collections.abc import Iterator, Mapping
import contextlib
from dataclasses import dataclass
import errno
import functools
import json
import math
import os
from pathlib import Path
import secrets
import stat
import tempfile
from typing import Any

from filelock import lock_descriptor

import twin
from twin.errors import InputError
from twin.stopping import removals
from twin.system import BY_DESCRIPTOR, Folder, pour, pours_into

FORMATS = 1
"""Format number of all JSON files."""


@contextlib.contextmanager
def beside(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file next to `path`. It replaces `path` when the block ends, and is removed when the block raises.

    A full disk or a stopped command therefore leaves the old file or none, never a partial one. Several processes may write the same path. Creates
    the folder. Only a regular file is replaced: the content is written into a device or a pipe; a link is refused, and so is a folder that is no
    longer the one that `output_folder` opened.

    Raises:
        InputError: the file cannot be written; the message names `path` and the reason.
    """
    path = Path(path)
    partial = path.parent / f".{path.stem[:40]}.{secrets.token_hex(8)}{path.suffix[:10]}"
    try:
        if pours_into(path):
            with tempfile.TemporaryDirectory(prefix="twin-") as scratch:
                yield Path(scratch) / path.name
                pour(Path(scratch) / path.name, path)
            return
        with _folder_of(path) as folder:
            _refuse_other_kinds(folder, path)
            remove = functools.partial(folder.remove, partial.name)
            removals.append(remove)
            try:
                yield partial
                descriptor = folder.open(partial.name)
                try:
                    os.fsync(descriptor)  # reports a full disk at the latest here
                finally:
                    os.close(descriptor)
                _refuse_other_kinds(folder, path)
                if _made is not None and folder.look(path.name) is None:
                    _made.append(path)
                folder.replace(path.name, partial.name)
            finally:
                remove()
                removals.remove(remove)
                with contextlib.suppress(OSError):
                    partial.unlink()  # at another place, if the folder was replaced meanwhile
    except OSError as error:
        reason = "its folder was replaced meanwhile" if isinstance(error, FileNotFoundError) else error.strerror or error
        raise InputError(f"{path}: cannot be written ({reason}); free some space or choose another path") from None


_made: list[Path] | None = None
"""New files since `all_or_none` began."""


@contextlib.contextmanager
def all_or_none() -> Iterator[None]:
    """Context around several files that are written together: if it raises, the new ones among them are removed."""
    global _made
    _made = []
    try:
        yield
    except BaseException:
        for path in _made:
            with contextlib.suppress(OSError):
                path.unlink()
        raise
    finally:
        _made = None


def _refuse_other_kinds(folder: Folder, path: Path) -> None:
    """Raise InputError unless `path` is free or a regular file."""
    if (found := folder.look(path.name or ".")) is None or stat.S_ISREG(found.st_mode):
        return
    kind = "a link" if stat.S_ISLNK(found.st_mode) else "a folder" if stat.S_ISDIR(found.st_mode) else "a device or socket"
    raise InputError(f"{path}: is {kind} and is not replaced; remove it or choose another path")


@contextlib.contextmanager
def _folder_of(path: Path) -> Iterator[Folder]:
    """The open folder of a file: below a folder that this command holds, by descriptors from there."""
    place = Path(os.path.abspath(path.parent))
    above = next((held for held in (place, *place.parents) if _held is not None and held in _held), None)
    with contextlib.ExitStack() as stack:
        if above is None or _held is None:
            place.mkdir(parents=True, exist_ok=True)
            yield stack.enter_context(Folder(place))
        else:
            folder = _held[above].folder
            for name in place.relative_to(above).parts:
                folder = stack.enter_context(folder.below(name))
            yield folder


def write_whole(path: Path, text: str) -> None:
    """Write a text file completely or not at all, and create its folders.

    Raises:
        InputError: the file cannot be written.
    """
    with beside(path) as partial:
        # names may contain bytes that are not text; line ends stay
        partial.write_text(text, encoding="utf-8", errors="replace", newline="")


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
    """Path of an output file, checked before the work: its folder is created and must be writable, and is held until the command ends.

    Raises:
        InputError: the file cannot be written there.
    """
    path = Path(path)
    place = Path(os.path.abspath(path.parent))
    try:
        if pours_into(path):
            if not os.access(path, os.W_OK):
                raise PermissionError(13, "Permission denied")
            return path
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
        with contextlib.ExitStack() as stack:
            folder = stack.enter_context(Folder(path.parent))
            _refuse_other_kinds(folder, path)
            if _held is not None and place not in _held:
                _held[place] = _Held(folder)
                stack.pop_all()  # it stays open until the command ends
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); choose another path") from None
    return path


LOCK = ".twin-lock"
"""Lock file of a command in its output folder."""


@dataclass
class _Held:
    """A folder that this command writes to, and the descriptor of its lock file if it is locked."""

    folder: Folder
    lock: int | None = None


_held: dict[Path, _Held] | None = None
"""Folders of the command of this process by their absolute path; None outside of a command."""


def hold_folders() -> None:
    """Start locking: from now on `output_folder` locks its folder for this command."""
    global _held
    _held = {} if _held is None else _held
    if release_folders not in removals:
        removals.insert(0, release_folders)


def release_folders() -> None:
    """Release all folders of this command."""
    global _held
    for held in (_held or {}).values():
        if held.lock is not None:
            held.folder.remove(LOCK)
            os.close(held.lock)
            if not BY_DESCRIPTOR:  # Windows removes no open file
                held.folder.remove(LOCK)
        held.folder.close()
    _held = None


def _hold(path: Path, held: dict[Path, _Held]) -> None:
    """Lock a folder until the command ends. The system releases the lock if the process is killed."""
    place = Path(os.path.abspath(path))
    if place in held and held[place].lock is not None:
        return
    folder = held[place].folder if place in held else Folder(place)
    held[place] = _Held(folder)  # closed with the others, also after an error
    try:
        lock = folder.open(LOCK, create=True)
    except FileExistsError:
        raise InputError(f"{path / LOCK}: is no regular file; remove it or choose another --out") from None
    except OSError as error:
        reason = "is a link; remove it" if error.errno == errno.ELOOP else f"cannot be written ({error.strerror})"
        raise InputError(f"{path / LOCK}: {reason} or choose another --out") from None
    try:
        free = lock_descriptor(lock, blocking=False)
    except OSError:  # a file system without locks
        os.close(lock)
        return
    if not free:
        who = ""
        with contextlib.suppress(OSError):  # Windows lets nobody read what is locked
            who = os.read(lock, 40).decode(errors="replace").strip()
        os.close(lock)
        if any(os.path.samestat(os.fstat(own.lock), os.stat(path / LOCK)) for own in held.values() if own.lock is not None):
            return  # the same folder by another path
        raise InputError(
            f"{path}: another twin command is writing here{f' (process {who})' if who.isdigit() else ''}; wait for it or choose another --out"
        )
    now = folder.look(LOCK)
    if now is None or not os.path.samestat(
        os.fstat(lock), now
    ):  # removed by its owner between our open and our lock; there may be a new one
        os.close(lock)
        return _hold(path, held)
    with contextlib.suppress(OSError):
        os.ftruncate(lock, 0)
        os.write(lock, f"{os.getpid()}\n".encode())
    held[place].lock = lock


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
