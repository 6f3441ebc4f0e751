"""`import twin`: every public name is there, lazily; the examples of docs/python.md and README.md run."""

from __future__ import annotations

import inspect
from pathlib import Path
import re
import subprocess
import sys

import pytest

from tests.conftest import ROOT
import twin

FENCE = re.compile(r"^```python\n(.*?)^```", re.M | re.S)


@pytest.mark.parametrize("name", [name for name in twin.__all__ if name != "__version__"])
def test_public_names(name: str) -> None:
    found = getattr(twin, name)
    assert found.__doc__
    if callable(found) and name[0].islower():
        hints = inspect.signature(found)
        assert all(p.annotation is not inspect.Parameter.empty for p in hints.parameters.values())
        assert hints.return_annotation is not inspect.Signature.empty


def test_import_is_lazy() -> None:
    loaded = "import sys, twin; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True, cwd=ROOT).stdout.split()
    assert not {"mujoco", "numba", "numpy", "pyarrow", "rerun"} & set(modules)


def test_packages_are_called_like_their_function() -> None:
    import twin.diagnose.procedure

    assert inspect.ismodule(twin.diagnose)
    assert inspect.signature(twin.diagnose) == inspect.signature(twin.diagnose.procedure.diagnose)


def test_unknown_name() -> None:
    with pytest.raises(AttributeError, match="no attribute 'simulat'"):
        twin.simulat  # noqa: B018


def test_py_typed_is_part_of_the_package() -> None:
    assert (Path(twin.__file__).parent / "py.typed").is_file()


@pytest.mark.parametrize("page", ["docs/python.md", "README.md"])
def test_examples_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    blocks = FENCE.findall((ROOT / page).read_text(encoding="utf-8"))
    assert blocks
    for name in ("examples", "models"):
        (tmp_path / name).symlink_to(ROOT / name)
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, page, "exec"), names)
    out = capsys.readouterr().out
    assert re.search(r"9\.69 um +18\.1 um", out), "the example proves what 15 um of backlash cost"
    if page == "docs/python.md":
        assert "X, Y, Z, A and C as they should be" in out
