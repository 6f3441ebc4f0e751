"""What is read of files of others: one reader of TOML, one of JSON, one way to a file that another file names.

Both readers refuse, in one line, what the code behind them cannot take: nesting beyond `DEEPEST`, whole numbers beyond 64 bits, the
character NUL (no file and no entity can be named with it), text that is not UTF-8, files larger than the limit. `named_file` refuses a
name that leaves the folder of the file that holds it, also through a symbolic link.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import contextlib
import json
import math
from pathlib import Path
import tomllib
from typing import Any

from twin.errors import InputError

LARGEST_TOML_BYTES = 20_000_000
LARGEST_JSON_BYTES = 1_000_000_000
"""A recording of an hour of a SINUMERIK Edge has 200 MB [bytes]."""
DEEPEST = 40
"""Tables within tables, lists within lists."""
LARGEST_INTEGER = 2**63
"""Whole numbers lie below it, as TOML demands; a float64 holds them."""
DIGITS = "a whole number of more than 4300 digits; give one below 2^63"
"""What Python refuses to read as a whole number."""
LARGEST_NUMBER = 1e100
"""Larger numbers of a TOML file are no quantity of anything; their products overflow. Infinity is a word of its own."""


def read_toml(path: Path, what: str = "a valid TOML file") -> dict[str, Any]:
    """The tables of a TOML file; every fault is an InputError in one line with the file."""
    return toml_of(_text(path, LARGEST_TOML_BYTES, what), str(path), what)


def toml_of(text: str, where: str, what: str = "a valid TOML file") -> dict[str, Any]:
    """The tables of a TOML text that comes from `where`."""
    try:
        document = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{where}: not {what}: nested too deeply; write it flat") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not {what}: {error}; correct it there") from None
    except ValueError:
        raise InputError(f"{where}: not {what}: {DIGITS}") from None
    _check(document, where, LARGEST_NUMBER)
    return document


def read_json(path: Path, what: str = "a valid JSON file", largest: int = LARGEST_JSON_BYTES) -> Any:
    """The content of a JSON file; every fault is an InputError in one line with the file."""
    text = _text(path, largest, what)
    try:
        document = json.loads(text)
    except RecursionError:
        raise InputError(f"{path}: not {what}: nested too deeply; write it flat") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not {what} ({error}); it is cut off or damaged: write it again") from None
    except ValueError:
        raise InputError(f"{path}: not {what}: {DIGITS}") from None
    _check(document, str(path))
    return document


def read_json_table(path: Path, what: str = "a valid JSON file") -> dict[str, Any]:
    """The same of a file whose content must be a table."""
    document = read_json(path, what)
    if not isinstance(document, dict):
        raise InputError(f"{path}: not {what}: holds no table {{..}}; write it again")
    return document


@contextlib.contextmanager
def reading(path: Path, kind: str, remedy: str = "export it again") -> Iterator[None]:
    """A block in which a library reads a file of somebody else. Libraries raise any class of error on a damaged file; here all of them are one.

    Raises:
        InputError: `path` is not a readable `kind`, with the reason of the library, and `remedy`.
    """
    try:
        yield
    except InputError:
        raise
    except PermissionError:
        raise InputError(f"{path}: cannot be read; check its permissions") from None
    except MemoryError:
        raise InputError(f"{path}: not a readable {kind} (reading it fills the memory); {remedy}") from None
    except Exception as error:
        raise InputError(f"{path}: not a readable {kind} ({reason_of(error)}); {remedy}") from None


def reason_of(error: Exception) -> str:
    """What a library says of a damaged file, in one short line."""
    return " ".join(str(error).split())[:120] or type(error).__name__


def named_file(name: object, folder: Path, where: str, *, within: Path | None = None) -> Path:
    """The file that another file names, relative to `folder`: it exists and lies inside `within` (default: `folder`).

    Links are followed before that is checked. `where` begins the message: the file that names it, and the key.

    Raises:
        InputError: the name is no text, leaves the folder, or names no file.
    """
    within = folder if within is None else within
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(f"{where}: {name!r} is no name of a file; write it in quotes, relative to {folder.name or folder}")
    file = folder / name
    try:
        inside = not Path(name).is_absolute() and file.resolve().is_relative_to(within.resolve())
        there = inside and file.is_file()
    except (OSError, RuntimeError):  # a circle of links, a name that is too long
        inside, there = True, False
    if not inside:
        raise InputError(f"{where}: '{name}' leaves the folder {within}; copy the file into it and give its name relative to it")
    if not there:
        raise InputError(f"{where}: '{name}': no such file beside {folder.name or folder}; copy it there or correct the name")
    return file


def outer_file(name: object, folder: Path, where: str) -> Path:
    """The file that a file of the user's own making names (a study, a suite): it may lie in any folder, but must be a file."""
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(f"{where}: {name!r} is no name of a file; write it in quotes")
    try:
        there = (folder / name).is_file()
    except OSError:
        there = False
    if not there:
        raise InputError(f"{where}: '{name}': no such file beside {folder.name or folder}; correct it")
    return folder / name


def _text(path: Path, largest: int, what: str) -> str:
    try:
        if not path.is_file():
            raise InputError(f"{path}: no such file; give its path")
        if (size := path.stat().st_size) > largest:
            raise InputError(f"{path}: {size / 1e6:.0f} MB; a file of this kind has at most {largest / 1e6:.0f} MB")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not {what}: {error}; save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: no name of a file; correct it") from None


def _check(document: Any, where: str, largest: float = math.inf) -> None:
    """Refuse nesting, numbers and names that nothing behind the readers can take."""
    # a recording in JSON has millions of floats, and no largest one
    looked_at = (dict, list, str, int) if largest == math.inf else (dict, list, str, int, float)
    waiting: list[tuple[Any, str, int]] = [(document, "", 0)]
    while waiting:
        value, key, depth = waiting.pop()
        if depth > DEEPEST:
            raise InputError(f"{where}: {_short(key)}: nested more than {DEEPEST} deep; write it flat")
        if isinstance(value, Mapping):
            for name, inner in value.items():
                if "\0" in name:
                    raise InputError(f"{where}: the name {_short(repr(name))} holds the character NUL; remove it")
                if isinstance(inner, looked_at):
                    waiting.append((inner, f"{key}.{name}" if key else name, depth + 1))
        elif isinstance(value, list):
            waiting += [(inner, key, depth + 1) for inner in value if isinstance(inner, looked_at)]
        elif isinstance(value, str):
            if "\0" in value:
                raise InputError(f"{where}: {_short(key)}: the text {_short(repr(value))} holds the character NUL; remove it")
        elif isinstance(value, float):
            if largest < abs(value) < math.inf:
                raise InputError(f"{where}: {_short(key)} = {value:g}: no quantity is so large; give less than {largest:g}")
        elif abs(value) >= LARGEST_INTEGER:
            raise InputError(f"{where}: {_short(key)}: a whole number of {len(str(abs(value)))} digits; give one below 2^63, or write 1e20")


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
