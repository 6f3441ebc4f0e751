"""Counts what decides in the diagnosis: thresholds, fields and writes of its state, long functions.

    python devtools/count_diagnosis.py [FOLDER]      default: twin/diagnose

A threshold is a constant of a module with a number in it, or a field of the class `Thresholds`. Of these, with a provenance, are counted
those whose field names a command or a page, not judgement. A write is an assignment to an attribute of, or a call that changes a list
in, a variable that holds the state (`found`, `f`, `final`).
"""

from __future__ import annotations

import argparse
import ast
from pathlib import Path

STATE, HOLDERS, CHANGING = "GroupState", {"found", "f", "state", "final", "before", "after"}, {"append", "clear", "extend", "pop", "doubt"}
LONG = 100


def numbers_in(node: ast.AST) -> bool:
    """Does an expression hold a number?"""
    return any(isinstance(n, ast.Constant) and isinstance(n.value, int | float) and not isinstance(n.value, bool) for n in ast.walk(node))


def constants_of(tree: ast.Module) -> list[str]:
    """Names of module constants (capitals) that hold a number."""
    names: list[str] = []
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        if targets and (value := getattr(node, "value", None)) is not None and numbers_in(value):
            found = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            names += [name for name in found if name.strip("_").isupper()]
    return names


def fields_of(tree: ast.Module, name: str) -> list[ast.AnnAssign]:
    """Fields of a dataclass."""
    classes = [n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name]
    return [n for c in classes for n in c.body if isinstance(n, ast.AnnAssign)]


def writes_in(tree: ast.Module) -> int:
    """Assignments to attributes of the state, and calls that change it or a list in it."""
    count = 0
    for node in ast.walk(tree):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AugAssign) else []
        flat = [e for t in targets for e in (t.elts if isinstance(t, ast.Tuple) else [t])]
        count += sum(_of_state(e.value if isinstance(e, ast.Starred) else e) for e in flat)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGING:
            count += _of_state(node.func) if node.func.attr == "doubt" else _of_state(node.func.value)
    return count


def _of_state(node: ast.AST) -> bool:
    while isinstance(node, ast.Subscript):
        node = node.value
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in HOLDERS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).resolve().parents[1] / "twin" / "diagnose")
    trees = {f.name: ast.parse(f.read_text(encoding="utf-8")) for f in sorted(parser.parse_args().folder.glob("*.py"))}
    constants = {name: constants_of(tree) for name, tree in trees.items()}
    settings = [f for tree in trees.values() for f in fields_of(tree, "Thresholds")]
    proved = [
        f
        for f in settings
        if f.value is not None and any(isinstance(n, ast.Name) and n.id in ("IMITATION", "PILOT") for n in ast.walk(f.value))
    ]
    state = [f for tree in trees.values() for f in fields_of(tree, STATE)]
    long = [
        (n.end_lineno - n.lineno + 1, f"{name}:{n.name}")
        for name, tree in trees.items()
        for n in ast.walk(tree)
        if isinstance(n, ast.FunctionDef) and n.end_lineno is not None and n.end_lineno - n.lineno + 1 > LONG
    ]
    print(f"constants with numbers beside the code: {sum(map(len, constants.values()))}")
    for name, names in constants.items():
        if names:
            print(f"    {name}: {', '.join(names)}")
    print(f"thresholds in the settings: {len(settings)}, calibrated by a command: {len(proved)}")
    print(f"fields of the state: {len(state)}, writes to it: {sum(map(writes_in, trees.values()))}")
    print(f"functions above {LONG} lines: {len(long)}" + "".join(f"\n    {lines} {name}" for lines, name in sorted(long, reverse=True)))


if __name__ == "__main__":
    main()
