"""The decorators of all compiled functions: numba without the GIL, cached on disk under a digest of all their sources.

numba's own cache looks at the file of a function only, not at the files of what it calls or takes constants from: after
a change to cascade.py a cached loop would keep the old law. Here a change to any source compiles everything anew. The
sources are the files that use these decorators, what those files import by name, and the files given to `include_source`.
Where a later numba keeps its stamp elsewhere, or no folder is writable, nothing is cached: slower, never stale.
"""

from __future__ import annotations

from collections.abc import Callable
import contextlib
import functools
import hashlib
import os
from pathlib import Path
import re
import sys
from typing import Any

import numba
from numba.core import caching, sigutils
from numba.core.ccallback import CFunc

njit: Any = numba.njit  # its type does not know _nrt

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rb"^from twin((?:\.\w+)*) import (?:\(([^)]*)\)|(.*))$", re.M)
_KERNEL = re.compile(rb"^from twin\.(compiled_functions|simulation\.loop_terms) import", re.M)
_included: set[Path] = set()
_SAID = "TWIN_SAID_NO_CACHE"
"""Environment variable that marks the line about the missing folder as said, also for worker processes."""


def include_source(file: str | Path) -> None:
    """Count one more file, such as a user's own effect, among the sources of compiled functions outside the package.

    Functions of the package call none of it by name (the loop calls laws by address), so that they stay in the cache.
    """
    _included.add(Path(file).resolve())
    digest.cache_clear()


def sources(outside: bool = False) -> list[Path]:
    """The files that decide what the package's compiled functions do, or those `outside` it."""
    kernels = [f for f in _PACKAGE.rglob("*.py") if _KERNEL.search(f.read_bytes())]
    found = {Path(__file__), *kernels, *(f for f in _included if outside and f.is_file())}
    for kernel in kernels:
        for module, in_brackets, in_line in _IMPORT.findall(kernel.read_bytes()):
            base = _PACKAGE.joinpath(*module.decode().split(".")[1:])
            names = re.findall(r"\w+", (in_brackets or in_line).decode())
            found |= {f for f in (base.with_suffix(".py"), *(base / f"{n}.py" for n in names)) if f.is_file()}
    return sorted(found)


@functools.cache
def digest(outside: bool = False) -> str:
    """Digest of `sources`, the stamp of everything in the cache."""
    return hashlib.sha256(b"\0".join(f.read_bytes() for f in sources(outside))).hexdigest()


def compiled(
    function: Callable | None = None,
    *,
    inline: bool = False,
    allocates: bool = False,
    ieee_division: bool = False,
    fastmath: bool | set[str] = False,
) -> Any:
    """Like `numba.njit`, without the GIL and cached.

    Args:
        function: what to compile; without it, a decorator is returned.
        inline: copy a small law into its callers.
        allocates: the function makes arrays. Others do without numba's runtime (`_nrt`), which counts every use of a row.
        ieee_division: a division by zero gives inf or nan, as in C; otherwise it raises ZeroDivisionError.
        fastmath: what the compiler may reorder, see numba; False keeps the order of the source.
    """
    options = {"_nrt": allocates, "inline": "always" if inline else "never", "fastmath": fastmath}
    if ieee_division:
        options["error_model"] = "numpy"

    def wrap(function: Callable) -> Any:
        return _cached(function, lambda: njit(nogil=True, **options)(function))

    return wrap if function is None else wrap(function)


def compiled_callback(signature: Any, function: Callable) -> Any:
    """Like `numba.cfunc`: a C function with an address. It has no caller that an error could reach: division by zero is IEEE's."""
    arguments, result = sigutils.normalize_signature(signature)

    def make() -> CFunc:
        return CFunc(function, (arguments, result), locals={}, options={"nopython": True, "error_model": "numpy"})

    callback = _cached(function, make)
    callback.compile()
    return callback


class _StampedFile(caching.IndexDataCacheFile):
    """A cache file whose stamp holds the digest of all sources; what cannot be read or written is compiled."""

    outside: bool  # True for a function whose file is no part of the package

    @property
    def _source_stamp(self) -> tuple[Any, str]:
        return self.__dict__["_source_stamp"], digest(self.outside)  # the function's own file may lie outside the sources

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # written by an older twin whose types are gone, or damaged
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(key, data)
        except OSError:
            _say_no_cache()


def _cached(function: Callable, make: Callable[[], Any]) -> Any:
    """The dispatcher with caching under our stamp; without caching where this is not possible."""
    dispatcher = make()
    try:
        dispatcher.enable_caching()
    except (RuntimeError, OSError):  # numba finds no folder that it may write
        _say_no_cache()
        return make()
    file = getattr(dispatcher._cache, "_cache_file", None)
    if type(file) is not caching.IndexDataCacheFile or "_source_stamp" not in file.__dict__:
        return make()
    file.__class__ = _StampedFile
    file.__dict__["outside"] = not Path(function.__code__.co_filename).resolve().is_relative_to(_PACKAGE)
    return dispatcher


def _say_no_cache() -> None:
    """Say once, for this process and its workers, that every start compiles."""
    if not os.environ.get(_SAID):
        os.environ[_SAID] = "1"
        print(
            "twin: no folder for compiled functions can be written, so every start compiles them again (about a minute); "
            "set NUMBA_CACHE_DIR to a writable folder",
            file=sys.stderr,
        )
