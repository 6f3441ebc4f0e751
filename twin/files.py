"""Files that are there as a whole or not at all: a process that is stopped leaves nothing half written behind."""

from __future__ import annotations

import os
from pathlib import Path
import threading


def write_whole(path: Path, text: str) -> None:
    """Write a text file beside its place and move it there; others may do the same at the same time."""
    partial = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
