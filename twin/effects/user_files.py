"""User files: `--effects FILE` adds the effects and control blocks of a Python file to the libraries, for one command and its worker processes.

The file holds functions under `@effect(...)` (`twin.effects.effect`) or blocks under `register(Block(...))` (`twin.control`). Worker processes find the
files in the environment variable `TWIN_EFFECTS` and load them when they import `twin.effects`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
import contextlib
import hashlib
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
import os
from pathlib import Path
import sys
from types import CodeType
from typing import Any

from twin.compiled_functions import include_source
from twin.control.library import BLOCKS
from twin.effects.control_blocks import add_effects_of_blocks
from twin.effects.effect import EFFECTS
from twin.errors import InputError

VARIABLE = "TWIN_EFFECTS"
"""Environment variable with the files, separated like PATH."""

REGISTRIES: tuple[dict[str, Any], ...] = (EFFECTS, BLOCKS)
_loaded: dict[Path, list[tuple[dict[str, Any], str]]] = {}


class _FromSource(SourceFileLoader):
    """Loader without bytecode cache, because the cache detects changes by size and whole seconds only."""

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.get_data(self.path), self.path)


@contextlib.contextmanager
def effects_of(files: Sequence[str | Path]) -> Iterator[None]:
    """Context in which the library includes the effects of these files, also in child processes.

    Raises InputError for a file that cannot be imported, has no effect, or redefines an effect.
    """
    before = os.environ.get(VARIABLE)
    added = [path for path in dict.fromkeys(Path(file).resolve() for file in files) if path not in _loaded]
    try:
        share(added)
        yield
    finally:
        for path in added:
            for registry, name in _loaded.pop(path, []):
                registry.pop(name, None)
        os.environ.pop(VARIABLE, None)
        if before is not None:
            os.environ[VARIABLE] = before


def load(file: str | Path, given_by: str = "--effects") -> None:
    """Add the effects and blocks of a file to the libraries. A faulty file leaves them unchanged."""
    path = Path(file).resolve()
    if path in _loaded:
        return
    where = f"{given_by} {file}"
    if not path.is_file():
        raise InputError(f"{where}: there is no such file; give a Python file with functions under @effect(...)")
    known = [dict(registry) for registry in REGISTRIES]
    module_name = f"twin_effects_{path.stem}_{hashlib.sha256(str(path).encode()).hexdigest()[:8]}"
    loader = _FromSource(module_name, str(path))
    spec = spec_from_loader(module_name, loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules[module_name] = module
    include_source(path)
    try:
        loader.exec_module(module)
        add_effects_of_blocks()
        new = [(registry, name) for registry, before in zip(REGISTRIES, known) for name in registry if name not in before]
        if not new:
            raise InputError("the file has no effect; write @effect(...) from twin.effects.effect above a function")
    except BaseException as error:
        for registry, before in zip(REGISTRIES, known):
            registry.clear()
            registry.update(before)
        del sys.modules[module_name]
        if isinstance(error, InputError):
            raise InputError(f"{where}: {error}") from None
        if isinstance(error, Exception | SystemExit):
            raise InputError(
                f"{where}: cannot be imported{_line_of(error, path)}: {type(error).__name__}: {error}; correct the file"
            ) from None
        raise
    _loaded[path] = new


def load_from_environment() -> None:
    """Load the files that the parent process has loaded."""
    for file in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        load(file, VARIABLE)


def loaded_files() -> tuple[Path, ...]:
    """Files whose effects are in the library."""
    return tuple(_loaded)


def share(files: Sequence[Path]) -> None:
    """Load these files in this process and its future child processes, for workers that were not started by the process that loaded them."""
    for file in files:
        load(file)
    os.environ[VARIABLE] = os.pathsep.join(str(path) for path in _loaded)


def _line_of(error: BaseException, path: Path) -> str:
    """Line number of an import error in the file, '' if unknown."""
    line = error.lineno if isinstance(error, SyntaxError) else None
    trace = error.__traceback__
    while trace is not None:
        if trace.tb_frame.f_code.co_filename == str(path):
            line = trace.tb_lineno
        trace = trace.tb_next
    return f" (line {line})" if line else ""
