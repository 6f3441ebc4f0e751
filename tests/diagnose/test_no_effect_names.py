"""The code of the diagnosis names no effect: its properties are fields of the effect, so that a new effect is a single file."""

import ast
from pathlib import Path
import re

import pytest

from twin.effects import EFFECTS

PACKAGE = Path(__file__).resolve().parents[2] / "twin"
FILES = [*sorted((PACKAGE / "diagnose").glob("*.py")), PACKAGE / "exam" / "detectability.py"]


def docstrings(tree: ast.AST) -> set[ast.Constant]:
    """String constants that are statements: docstrings of modules, functions, classes and constants."""
    return {n.value for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)}


def names_in(source: str) -> list[str]:
    """Effect names in the string literals of a source.

    A name that is an English word ("inertia") is allowed in a sentence. A literal that equals the name, or a name with an underscore, is not.
    """
    tree = ast.parse(source)
    plain = docstrings(tree)
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in plain:
            words = {node.value} if " " in node.value else set(re.findall(r"\w+", node.value))
            words |= {word for word in re.findall(r"\w+", node.value) if "_" in word}
            found += [f"line {node.lineno}: {word}" for word in sorted(words & set(EFFECTS))]
    return found


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_no_effect_is_named(file):
    assert names_in(file.read_text(encoding="utf-8")) == [], "add a field to Effect or Parameter instead, see twin/effects/effect.py"


def test_a_name_is_detected():
    source = (
        '"""backlash."""\nSPECIAL = {"inertia": 2.0}\nif name == "backlash":\n    print(f"mass and inertia; torque_ripple of {name}")\n'
    )
    assert names_in(source) == ["line 2: inertia", "line 3: backlash", "line 4: torque_ripple"]
