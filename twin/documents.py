"""Safe reading of other people's files: TOML, JSON, files named in files, and errors of reader libraries.

`read_toml` and `read_json` raise an InputError of one line for nesting deeper than `DEEPEST`, integers beyond 64 bits, the character NUL (which no
path and no entity name may contain), text that is not UTF-8 and files above the size limit. `named_file` raises one for a name that leaves the
folder of the file that names it, also through a symbolic link. `reading` turns whatever a library raises into one.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
import contextlib
import json
import math
import os
from pathlib import Path
import re
import tomllib
from typing import Any

from twin.errors import TRACEBACK, InputError, no_file

LARGEST_TOML_BYTES = 20_000_000
LARGEST_JSON_BYTES = 1_000_000_000
"""[bytes]. One hour recorded by a SINUMERIK Edge takes 200 MB."""
DEEPEST = 40
"""Levels of nested tables and lists."""
LARGEST_INTEGER = 2**63
"""Integers must be smaller, as TOML requires."""
DIGITS = "an integer has more than 4300 digits; give one below 2^63"
"""Why Python refuses an integer of so many digits."""
LARGEST_NUMBER = 1e100
"""Larger numbers in a TOML file are refused: no physical quantity is so large, and products would overflow. `inf` is allowed."""


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Every fault raises an InputError of one line that names the file."""
    where, what = str(path), "a valid TOML file"
    text = read_text(path, what)
    document = _parsed(lambda: tomllib.loads(text), where, what, "correct it there")
    _check(document, where, LARGEST_NUMBER)
    return document


def _parsed(content: Callable[[], Any], where: str, what: str, remedy: str) -> Any:
    try:
        return content()
    except RecursionError:
        raise InputError(f"{where}: not {what}: nested too deeply; use fewer levels") from None
    except (tomllib.TOMLDecodeError, json.JSONDecodeError) as error:
        raise InputError(f"{where}: not {what}: {error}; {remedy}") from None
    except ValueError:
        raise InputError(f"{where}: not {what}: {DIGITS}") from None


def read_json(path: Path, what: str = "a valid JSON file", largest: int = LARGEST_JSON_BYTES) -> dict[str, Any]:
    """Read a JSON file whose content is an object. Every fault raises an InputError of one line that names the file."""
    document = json_of(read_text(path, what, largest), str(path), what)
    if not isinstance(document, dict):
        raise InputError(f"{path}: not {what}: the content is not an object {{..}}; write it again")
    return document


def json_of(text: str, where: str, what: str = "a valid JSON file") -> Any:
    """Parse JSON text of any content; `where` names its source in error messages."""
    document = _parsed(lambda: json.loads(text), where, what, "the file is truncated or damaged: write it again")
    _check(document, where)
    return document


def value_at(tables: Any, path: str) -> Any:
    """The value at a path such as `axis.X.travel_m.0`; None if there is none."""
    for key in path.split("."):
        if isinstance(tables, list) and key.isdigit() and int(key) < len(tables):
            tables = tables[int(key)]
        elif isinstance(tables, Mapping) and key in tables:
            tables = tables[key]
        else:
            return None
    return tables


def toml_text(value: str) -> str:
    """A TOML string."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def toml_key(name: str) -> str:
    """A TOML key, quoted where it needs to be."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_text(name)


@contextlib.contextmanager
def reading(path: Path, kind: str, remedy: str = "export it again") -> Iterator[None]:
    """Context around a library that reads `path`: any error of the library becomes an InputError, whatever its class.

    Raises:
        InputError: `path` is not a readable `kind`, with `remedy`. The library's own words mean nothing to the user and are left out;
            with `TWIN_TRACEBACK` its error is raised as it is.
    """
    try:
        yield
    except InputError:
        raise
    except PermissionError:
        raise InputError(f"{path}: cannot be read; check its permissions") from None
    except MemoryError:
        raise InputError(f"{path}: not a readable {kind} (reading it fills the memory); {remedy}") from None
    except Exception:
        if os.environ.get(TRACEBACK):
            raise
        raise InputError(f"{path}: not a readable {kind}; it is damaged, cut off or of another kind: {remedy}") from None


def named_file(name: object, folder: Path, where: str, outer: bool = False) -> Path:
    """Path of the file `name`, which another file names relative to `folder`. It must exist, and inside that folder unless `outer`: a file of the
    user's own (a study, a suite) names files in any folder.

    Symbolic links are resolved first. `where` is the prefix of error messages: the naming file and the key.

    Raises:
        InputError: `name` is not text, leaves the folder, or no such file exists.
    """
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(f"{where}: {name!r} is not a file name; write it in quotes, relative to {folder.name or folder}")
    file = folder / name
    try:
        inside = outer or (not Path(name).is_absolute() and file.resolve().is_relative_to(folder.resolve()))
        there = inside and file.is_file()
    except (OSError, RuntimeError):  # a loop of links, a name that is too long
        inside, there = True, False
    if not inside:
        raise InputError(f"{where}: '{name}' leaves the folder {folder}; copy the file into it and give its name relative to it")
    if not there:
        raise InputError(f"{where}: '{name}': no such file beside {folder.name or folder}; copy it there or correct the name")
    return file


def read_text(path: Path, what: str, largest: int = LARGEST_TOML_BYTES) -> str:
    """The text of a file of at most `largest` bytes. Raises InputError, naming `what` it should be."""
    try:
        if not path.is_file():
            raise no_file(path, "give its path")
        if (size := path.stat().st_size) > largest:
            raise InputError(f"{path}: {size / 1e6:.0f} MB is too large; the limit for such a file is {largest / 1e6:.0f} MB")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not {what}: {error}; save it as UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    except ValueError:
        raise InputError(f"{str(path)!r}: not a file name; correct it") from None


def _check(document: Any, where: str, largest: float = math.inf) -> None:
    """Raise InputError for nesting, numbers and names that later code cannot handle."""
    # recordings in JSON hold millions of floats and have no largest number: skip them
    looked_at = (dict, list, str, int) if largest == math.inf else (dict, list, str, int, float)
    waiting: list[tuple[Any, str, int]] = [(document, "", 0)] if isinstance(document, looked_at) else []
    while waiting:
        value, key, depth = waiting.pop()
        if depth > DEEPEST:
            raise InputError(f"{where}: {_short(key)}: nested more than {DEEPEST} levels deep; use fewer levels")
        if isinstance(value, Mapping):
            for name, inner in value.items():
                if "\0" in name:
                    raise InputError(f"{where}: the name {_short(repr(name))} contains the character NUL; remove it")
                if isinstance(inner, looked_at):
                    waiting.append((inner, f"{key}.{name}" if key else name, depth + 1))
        elif isinstance(value, list):
            waiting += [(inner, key, depth + 1) for inner in value if isinstance(inner, looked_at)]
        elif isinstance(value, str):
            if "\0" in value:
                raise InputError(f"{where}: {_short(key)}: the text {_short(repr(value))} contains the character NUL; remove it")
        elif isinstance(value, float):
            if largest < abs(value) < math.inf:
                raise InputError(f"{where}: {_short(key)} = {value:g} is too large for any quantity; the limit is {largest:g}")
        elif abs(value) >= LARGEST_INTEGER:
            raise InputError(
                f"{where}: {_short(key)}: an integer of {len(str(abs(value)))} digits; give one below 2^63, or write it as 1e20"
            )


def flat(content: Any, path: str = "", nested: Any = (Mapping, list, tuple)) -> dict[str, Any]:
    """Values of nested tables and lists by path: 'axis.X.travel_m.0'."""
    if not isinstance(content, nested):
        return {path: content}
    out: dict[str, Any] = {}
    parts: Iterable[tuple[Any, Any]] = content.items() if isinstance(content, Mapping) else enumerate(content)
    for key, inner in parts:
        out |= flat(inner, f"{path}.{key}" if path else str(key), nested)
    return out


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
