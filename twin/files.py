"""Files that commands write: whole or not at all, JSON without NaN, one line where a place cannot be written."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
import threading
from typing import Any

from twin.errors import InputError


def write_whole(path: Path, text: str) -> None:
    """Write a text file beside its place and move it there, so that a process that is stopped leaves nothing half written.

    Others may do the same at the same time.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def write_json(content: Any, path: Path) -> None:
    """Write a document; JSON knows neither NaN nor infinity: what there is none of (the margin of a loop that has none) is null.

    Raises:
        InputError: the place cannot be written to.
    """
    write_text(json.dumps(_finite(content), indent=2, allow_nan=False) + "\n", path)


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
