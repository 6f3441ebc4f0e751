"""The developers' tools name only what exists in the package; most of them run too long for a test."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

from tests.conftest import ROOT


@pytest.mark.parametrize("file", sorted((ROOT / "devtools").glob("*.py")), ids=lambda file: file.stem)
def test_imported_names_exist(file: Path) -> None:
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "twin":
            module = importlib.import_module(node.module)
            missing = [
                a.name for a in node.names if not hasattr(module, a.name) and not importlib.util.find_spec(f"{node.module}.{a.name}")
            ]
            assert not missing, f"{file.name}: {node.module} has no {', '.join(missing)}"
