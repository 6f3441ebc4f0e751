"""Decorators of all compiled functions: numba without the GIL, cached on disk under a digest of all their sources.

numba's own cache checks only the file of a function, not the files of the functions and constants that it uses: after a change to cascade.py, a
cached loop would keep the old law. Here a change to any source recompiles everything. The sources are the files that use these decorators, the
modules that those files import from twin, and the files given to `include_source`. If a later numba stores its stamp elsewhere, or no folder is
writable, nothing is cached: slower, but never stale.
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
from numba.core import caching, event, sigutils
from numba.core.ccallback import CFunc

njit: Any = numba.njit  # its type does not know _nrt

_PACKAGE = Path(__file__).parent
_IMPORT = re.compile(rb"^from twin((?:\.\w+)*) import (?:\(([^)]*)\)|(.*))$", re.M)
_KERNEL = re.compile(rb"^from twin\.(compiled_functions|simulation\.loop_terms) import", re.M)
_included: set[Path] = set()
_SAID, _SAID_COMPILING = "TWIN_SAID_NO_CACHE", "TWIN_SAID_COMPILING"
"""Environment variables: set once a note is printed, so that workers do not repeat it."""


class _SayOnce(event.Listener):
    """Prints one line on a terminal before functions are compiled: numba reports it once it has looked in its cache."""

    def on_start(self, _event: Any) -> None:
        """A compilation begins."""
        if sys.stderr is not None and sys.stderr.isatty():
            _say_once(_SAID_COMPILING, "compiling, once after an installation or an update (up to a minute)")

    def on_end(self, _event: Any) -> None:
        """A compilation ends."""


event.register("numba:compile", _SayOnce())


def include_source(file: str | Path) -> None:
    """Add a file outside the package, such as a user's own effect, to the sources of the functions compiled outside the package.

    Functions of the package stay cached, because none calls it by name: the loop calls laws by address.
    """
    _included.add(Path(file).resolve())
    digest.cache_clear()


def _is_of_package(file: Path) -> bool:
    """Whether a file belongs to the package itself. The examples that an installed twin has beside it are users' files, as in a checkout."""
    return file.is_relative_to(_PACKAGE) and not file.is_relative_to(_PACKAGE / "examples")


def sources(outside: bool = False) -> list[Path]:
    """Source files of the package's compiled functions; with `outside`, also those given to `include_source`."""
    kernels = [f for f in _PACKAGE.rglob("*.py") if _is_of_package(f) and _KERNEL.search(f.read_bytes())]
    found = {Path(__file__), *kernels, *(f for f in _included if outside and f.is_file())}
    for kernel in kernels:
        for module, in_brackets, in_line in _IMPORT.findall(kernel.read_bytes()):
            base = _PACKAGE.joinpath(*module.decode().split(".")[1:])
            names = re.findall(r"\w+", (in_brackets or in_line).decode())
            found |= {f for f in (base.with_suffix(".py"), *(base / f"{n}.py" for n in names)) if f.is_file()}
    return sorted(found)


@functools.cache
def digest(outside: bool = False) -> str:
    """SHA-256 of `sources`, the stamp of all cache entries."""
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
        function: the function to compile; if missing, a decorator is returned.
        inline: copy the function into its callers; for small laws.
        allocates: the function creates arrays. Other functions run without numba's runtime (`_nrt`), which counts every reference to a row.
        ieee_division: division by zero gives inf or nan, as in C; otherwise it raises ZeroDivisionError.
        fastmath: numba's option; False keeps the order of operations of the source.
    """
    options = {"_nrt": allocates, "inline": "always" if inline else "never", "fastmath": fastmath}
    if ieee_division:
        options["error_model"] = "numpy"

    def wrap(function: Callable) -> Any:
        return _cached(function, lambda: njit(nogil=True, **options)(function))

    return wrap if function is None else wrap(function)


def compiled_callback(signature: Any, function: Callable) -> Any:
    """Like `numba.cfunc`: a C function with an address. It cannot raise to a caller, so division by zero gives inf or nan."""
    arguments, result = sigutils.normalize_signature(signature)

    def make() -> CFunc:
        return CFunc(function, (arguments, result), locals={}, options={"nopython": True, "error_model": "numpy"})

    callback = _cached(function, make)
    callback.compile()
    return callback


class _StampedFile(caching.IndexDataCacheFile):
    """A cache index whose stamp contains the digest of all sources. An entry that cannot be read or written is compiled instead."""

    outside: bool  # True for a function defined outside the package

    @property
    def _source_stamp(self) -> tuple[Any, str]:
        return self.__dict__["_source_stamp"], digest(self.outside)  # the function's own file may not be among the sources

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # damaged, or written by an older twin with types that no longer exist
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(key, data)
        except OSError:
            _say_once(_SAID, _NO_CACHE)


def _cached(function: Callable, make: Callable[[], Any]) -> Any:
    """The dispatcher, cached under our stamp if possible."""
    dispatcher = make()
    try:
        dispatcher.enable_caching()
    except (RuntimeError, OSError):  # numba finds no writable folder
        _say_once(_SAID, _NO_CACHE)
        return make()
    file = getattr(dispatcher._cache, "_cache_file", None)
    if type(file) is not caching.IndexDataCacheFile or "_source_stamp" not in file.__dict__:
        return make()
    file.__class__ = _StampedFile
    file.__dict__["outside"] = not _is_of_package(Path(function.__code__.co_filename).resolve())
    return dispatcher


_NO_CACHE = "no writable folder for compiled functions, so every start compiles them again (about a minute); set NUMBA_CACHE_DIR to a writable folder"


def _say_once(variable: str, text: str) -> None:
    """Print a line above any bar, once for this process and its workers."""
    if not os.environ.get(variable):
        from tqdm import tqdm

        os.environ[variable] = "1"
        tqdm.write(f"twin: {text}", file=sys.stderr)
