"""Scripts and examples of the repository, as modules and carried out."""

from __future__ import annotations

import importlib.util
import runpy
import sys
from types import ModuleType

from tests.conftest import ROOT


def script(path: str, name: str) -> ModuleType:
    """The file at `path` below the repository's top, imported as `name`; as for a script, files beside it can be imported."""
    folder = str((ROOT / path).parent)
    if folder not in sys.path:
        sys.path.append(folder)
    spec = importlib.util.spec_from_file_location(name, ROOT / path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def carried_out(path: str, *arguments: object) -> None:
    """Run an example as a user does, and expect that it ends well."""
    before = sys.argv, sys.path
    sys.argv, sys.path = [path, *map(str, arguments)], [str((ROOT / path).parent), *sys.path]
    try:
        runpy.run_path(str(ROOT / path), run_name="__main__")
        code: object = 0
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.argv, sys.path = before
    assert not code
