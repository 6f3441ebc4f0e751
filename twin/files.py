"""Files that commands write: whole or not at all, JSON without NaN, one line where a place cannot be written."""

from __future__ import annotations

from collections.abc import Mapping
import json
import math
import os
from pathlib import Path
import threading
from typing import Any

import twin
from twin.errors import InputError

FORMATS = 1
"""Number of the formats of all JSON files."""


def write_whole(path: Path, text: str) -> None:
    """Write a text file beside its place and move it there, so that a process that is stopped leaves nothing half written.

    Others may do the same at the same time.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


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
    write_text(json.dumps(_finite(stamped(content, schema)), indent=2, allow_nan=False) + "\n", path)


def write_text(text: str, path: Path) -> None:
    """Write a text file, and the folders to it that are not there.

    Raises:
        InputError: the place cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another place") from None


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
    return out


def _finite(content: Any) -> Any:
    if isinstance(content, dict):
        return {key: _finite(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_finite(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content
