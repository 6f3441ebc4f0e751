"""Decorator of the compiled functions of this package: without the GIL, cached by a digest of all sources they are made of.

numba's own cache looks at the file of a function only: after a change to sweep.py a cached `removal` would go on with the old
form. Here a change to any kernel source compiles all of them anew.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import hashlib
from pathlib import Path
from typing import Any

import numba

SOURCES = ("kernels.py", "sweep.py", "removal.py", "dexels.py")


@functools.cache
def digest() -> str:
    """Digest of the kernel sources."""
    here = Path(__file__).parent
    return hashlib.sha256(b"".join((here / name).read_bytes() for name in SOURCES)).hexdigest()


def kernel(function: Callable | None = None, *, several_at_once: bool = False) -> Any:
    """Like `numba.njit`; `several_at_once` lets the compiler reorder sums, for loops that it can take four nails at a time."""
    if function is None:
        return functools.partial(kernel, several_at_once=several_at_once)
    fast = {"contract", "nsz", "arcp"} if several_at_once else False
    plain: Any = numba.njit(nogil=True, error_model="numpy", fastmath=fast)(function)
    plain.enable_caching()
    file: Any = getattr(plain._cache, "_cache_file", None)
    if not hasattr(file, "_source_stamp"):
        return numba.njit(nogil=True, error_model="numpy", fastmath=fast)(function)
    file._source_stamp = digest()
    return plain
