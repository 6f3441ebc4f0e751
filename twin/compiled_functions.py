"""Decorators of compiled functions: numba without the GIL, cached on disk by a digest of all kernel sources.

numba's own cache looks at the file of a function only, not at the files of what it calls or takes constants from: after
a change to cascade.py a cached loop would go on with the old law. Here a change to any source of the kernels compiles all
of them anew. Where a later numba keeps its stamp elsewhere, nothing is cached: slower, never stale.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import hashlib
from pathlib import Path
from typing import Any

import numba
from numba.core import sigutils
from numba.core.ccallback import CFunc

njit: Any = numba.njit  # its type does not know _nrt


@functools.cache
def digest() -> str:
    """Digest of the sources of all kernels: the modules at the top of the package and the effects."""
    here = Path(__file__).parent
    files = sorted(here.rglob("*.py"))
    kernels = [f for f in files if b"compiled_functions import" in f.read_bytes() or f.name in ("compiled_functions.py", "loop_terms.py")]
    return hashlib.sha256(b"".join(f.read_bytes() for f in kernels)).hexdigest()


def compiled(function: Callable | None = None, *, inline: bool = False) -> Any:
    """Like `numba.njit`, for functions of the kernels; `inline` copies a small law into its callers.

    Kernels make no arrays: without numba's runtime (`_nrt`) none is counted when a row of it is looked at, which took
    as long as the law itself.
    """
    if function is None:
        return functools.partial(compiled, inline=inline)
    plain = njit(nogil=True, _nrt=False, inline="always" if inline else "never")
    return _stamped(plain(function)) or plain(function)


def compiled_callback(signature: Any, function: Callable) -> Any:
    """Like `numba.cfunc`: a C function with an address. It has no caller that an error could reach: division by zero is IEEE's."""
    arguments, result = sigutils.normalize_signature(signature)

    def make() -> CFunc:
        return CFunc(function, (arguments, result), locals={}, options={"nopython": True, "error_model": "numpy"})

    callback = _stamped(make()) or make()
    callback.compile()
    return callback


def _stamped(dispatcher: Any) -> Any | None:
    """The function with caching under our stamp; None where this numba has no such stamp."""
    dispatcher.enable_caching()
    file: Any = getattr(dispatcher._cache, "_cache_file", None)
    if not hasattr(file, "_source_stamp"):
        return None
    file._source_stamp = (file._source_stamp, digest())  # the function's own file may lie outside the kernels
    try:
        file._load_index()
    except Exception:  # written by an older twin whose types are gone: numba would raise at the first call
        file.flush()
    return dispatcher
