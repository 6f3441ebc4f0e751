"""Decorator of the plant's compiled functions: numba njit, without the GIL, cached on disk.

numba's cache checks only the file of a function, not the files of the functions that it calls: after a change to control.py a
cached loop in plant.py would keep the old law. Here the stamp of the cache is a digest of all sources, so that any change
recompiles all functions. If another numba version stores its stamp elsewhere, or no folder is writable, nothing is cached.

`twin.compiled_functions` does the same for the twin. The plant has its own copy because it must not share code with the twin
that it examines.
"""

from __future__ import annotations

from collections.abc import Callable
import hashlib
from pathlib import Path
from typing import Any

import numba

SOURCES = ("compensation", "compiled", "control", "mechanics", "plant", "tilting_pair")
DIGEST = hashlib.sha256(b"".join((Path(__file__).parent / f"{name}.py").read_bytes() for name in SOURCES)).hexdigest()

njit: Any = numba.njit  # its type does not know _nrt


def compiled(inline: bool = False, allocates: bool = False) -> Callable:
    """Decorator; `inline` copies a small function into its callers.

    A function that does not `allocate` arrays works without numba's reference counting (`_nrt`).
    """

    def wrap(function: Callable) -> Callable:
        plain = njit(nogil=True, error_model="numpy", _nrt=allocates, inline="always" if inline else "never")
        dispatcher: Any = plain(function)
        try:
            dispatcher.enable_caching()
        except (RuntimeError, OSError):  # no folder is writable; the twin prints a warning
            return plain(function)
        file: Any = getattr(dispatcher._cache, "_cache_file", None)
        if not hasattr(file, "_source_stamp"):
            return plain(function)
        file._source_stamp = DIGEST
        try:
            file._load_index()
        except Exception:  # written by an older version with other types: numba would raise at the first call
            file.flush()
        return dispatcher

    return wrap
