"""The decorator of the plant's compiled functions: numba njit, without the GIL, cached on disk.

numba's cache looks only at the file of a function, not at the files of the functions that it calls: after a change to
control.py a cached loop in plant.py would keep the old law. Here the cache's stamp is a digest of all sources of
the compiled functions, so that a change to any of them compiles all anew. Where a later numba keeps its stamp elsewhere, or
no folder is writable, nothing is cached: slower, never stale.

`twin.compiled_functions` does the same for the twin. This one stays apart because the plant examines the twin: it imports
nothing of it, so that no fault can hide by being in both.
"""

from __future__ import annotations

from collections.abc import Callable
import hashlib
from pathlib import Path
from typing import Any

import numba

SOURCES = ("compiled", "control", "friction", "measurement", "mechanics", "plant", "tilting_pair")
DIGEST = hashlib.sha256(b"".join((Path(__file__).parent / f"{name}.py").read_bytes() for name in SOURCES)).hexdigest()

njit: Any = numba.njit  # its type does not know _nrt


def compiled(inline: bool = False, allocates: bool = False) -> Callable:
    """Decorator; `inline` copies a small law into its callers.

    A function that `allocates` no arrays does without numba's runtime (`_nrt`), which counts every use of one.
    """

    def wrap(function: Callable) -> Callable:
        plain = njit(nogil=True, error_model="numpy", _nrt=allocates, inline="always" if inline else "never")
        dispatcher: Any = plain(function)
        try:
            dispatcher.enable_caching()
        except (RuntimeError, OSError):  # no folder is writable; the twin has said so
            return plain(function)
        file: Any = getattr(dispatcher._cache, "_cache_file", None)
        if not hasattr(file, "_source_stamp"):
            return plain(function)
        file._source_stamp = DIGEST
        try:
            file._load_index()
        except Exception:  # written by an older version whose types are gone: numba would raise at the first call
            file.flush()
        return dispatcher

    return wrap
