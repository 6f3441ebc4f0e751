"""Compiled functions: one decorator, one digest, and a start without any folder that can be written."""

import ast
import os
from pathlib import Path
import select
import shutil
import subprocess
import sys

import pytest

from twin import compiled_functions

PACKAGE = Path(compiled_functions.__file__).parent
ALLOWED = {PACKAGE / "compiled_functions.py", PACKAGE / "exam" / "plant" / "compiled.py"}  # the second plant imports nothing of twin
DECORATORS = {"njit", "jit", "cfunc", "vectorize", "guvectorize", "generated_jit", "CFunc"}


def raw_decorators(source: str) -> list[int]:
    """Lines that take a decorator straight from numba."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "numba":
            lines += [node.lineno for alias in node.names if alias.name in DECORATORS]
        elif isinstance(node, ast.Attribute) and node.attr in DECORATORS and isinstance(node.value, ast.Name) and node.value.id == "numba":
            lines.append(node.lineno)
    return lines


def test_numba_is_called_in_one_place() -> None:
    found = {f"{f}:{n}" for f in PACKAGE.rglob("*.py") if f not in ALLOWED for n in raw_decorators(f.read_text(encoding="utf-8"))}
    assert not found, "use twin.compiled_functions.compiled"
    assert raw_decorators("import numba\n@numba.njit\ndef f(): ...")
    assert raw_decorators("from numba import njit")


def test_the_digest_covers_kernels_their_constants_and_included_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = {f.relative_to(PACKAGE).as_posix() for f in compiled_functions.sources()}
    assert {"simulation/loop.py", "program/blend.py", "surface/sweep.py", "effects/forces.py", "compiled_functions.py"} <= names
    monkeypatch.setattr(compiled_functions, "_included", set())
    before, inside = compiled_functions.digest(outside=True), compiled_functions.digest()
    effect = tmp_path / "effect.py"
    effect.write_text("law = 1\n")
    compiled_functions.include_source(effect)
    first = compiled_functions.digest(outside=True)
    effect.write_text("law = 2\n")
    compiled_functions.include_source(effect)
    assert len({before, first, compiled_functions.digest(outside=True)}) == 3
    assert compiled_functions.digest() == inside  # the package's own functions stay in the cache
    monkeypatch.setattr(compiled_functions, "_included", set())
    compiled_functions.digest.cache_clear()
    assert compiled_functions.digest(outside=True) == before


def test_the_digest_covers_a_module_whose_constants_a_kernel_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiled_functions, "_PACKAGE", tmp_path)
    (tmp_path / "kernel.py").write_text("from twin.compiled_functions import compiled\nfrom twin.program import moves\n")
    (tmp_path / "program").mkdir()
    (tmp_path / "program" / "moves.py").write_text("LINE = 1\n")
    assert tmp_path / "program" / "moves.py" in compiled_functions.sources()


def test_a_wheel_has_the_digest_of_its_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Although the examples, some with compiled functions, lie inside an installed package."""
    before = compiled_functions.digest()
    shutil.copytree(PACKAGE, tmp_path / "twin", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(PACKAGE.parent / "examples", tmp_path / "twin" / "examples", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(compiled_functions, "_PACKAGE", tmp_path / "twin")
    monkeypatch.setattr(compiled_functions, "__file__", str(tmp_path / "twin" / "compiled_functions.py"))
    assert compiled_functions.digest.__wrapped__() == before


MODULE = "from twin.compiled_functions import compiled\n@compiled\ndef square(x):\n    return x * x\n@compiled\ndef cube(x):\n    return x * square(x)\n"


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    # an interpreter that finds its libraries by PYTHONPATH keeps them
    path = os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH"))))
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**{k: v for k, v in os.environ.items() if k != compiled_functions._SAID}, "PYTHONPATH": path, **environment},
        check=True,
    )


def test_without_a_folder_to_write_it_runs_and_says_so_once(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    below = str(blocked / "below")
    (tmp_path / "__pycache__").write_text("")  # where the cache would lie beside the module
    (tmp_path / "kernels.py").write_text(MODULE)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import kernels; print(kernels.cube(2.0))"
    done = run(code, HOME=below, XDG_CACHE_HOME=below, NUMBA_CACHE_DIR=below)
    assert done.stdout == "8.0\n"
    assert done.stderr.count("no writable folder for compiled functions") == 1
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="a pseudo-terminal")
def test_a_terminal_hears_once_that_functions_are_compiled(tmp_path: Path) -> None:
    """And nothing when the cache holds them, nor where no terminal is."""
    import pty

    (tmp_path / "kernels.py").write_text(MODULE)
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import kernels; kernels.cube(2.0)"
    environment = {k: v for k, v in os.environ.items() if k not in (compiled_functions._SAID_COMPILING, compiled_functions._SAID)}
    path = os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH"))))

    def heard(cache: str, on_terminal: bool) -> int:
        ours, theirs = pty.openpty()
        where = {"stderr": theirs if on_terminal else subprocess.PIPE, "text": True}
        try:
            done = subprocess.run(
                [sys.executable, "-c", code],
                env={**environment, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / cache)},
                check=True,
                **where,
            )
            said = done.stderr or ""
            if on_terminal and select.select([ours], [], [], 0.0)[0]:
                said = os.read(ours, 10_000).decode()
        finally:
            os.close(theirs)
            os.close(ours)
        return said.count("compiling, once")

    assert [heard("a", True), heard("a", True), heard("b", False), heard("b", True), heard("c", True)] == [1, 0, 0, 0, 1]


def test_a_change_of_any_source_compiles_anew(tmp_path: Path) -> None:
    """`helper` lies in another file, where numba's own stamp does not look."""
    package = tmp_path / "kernels.py"
    helper = tmp_path / "helper.py"
    package.write_text("from twin.compiled_functions import compiled\nfrom helper import law\n@compiled\ndef run(x):\n    return law(x)\n")
    code = (
        f"import sys; sys.dont_write_bytecode = True; sys.path.insert(0, {str(tmp_path)!r}); from twin.compiled_functions import include_source;"
        f"include_source({str(helper)!r}); import kernels; print(kernels.run(2.0), sum(kernels.run.stats.cache_hits.values()))"
    )
    for factor, hits in ((3, 0), (3, 1), (4, 0)):
        helper.write_text(f"from twin.compiled_functions import compiled\n@compiled\ndef law(x):\n    return {factor} * x\n")
        assert run(code, NUMBA_CACHE_DIR=str(tmp_path / "cache")).stdout == f"{2.0 * factor} {hits}\n"
