"""Imports run one way, as the architecture says: from data over control and mechanics to the loop, the runs and the commands."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "twin"

# a module may import from its own layer and from those above it here; packages count as one
LAYERS = (
    ("errors", "colours", "compiled", "files", "progress", "simplify"),
    ("units", "moves", "native"),
    ("tables",),
    ("machine_keys", "machine_sinumerik"),
    ("machine_axis", "model_file"),
    ("machine", "trace"),
    ("cascade", "plant", "terms", "setpoints", "kinematics", "poses"),
    ("loop", "program"),
    ("effects",),
    ("full_plant", "reduced"),
    ("run",),
    ("campaign", "gap", "summary", "cascade_reference", "toolpath", "surface"),
    ("report", "replay"),  # how pages and recordings are drawn; what they show is the business of those above
    ("identify", "machines", "study"),
    ("readers",),
    ("diagnose", "exam", "regress"),
    ("demo", "benchmark", "friction_check"),
    ("commands",),
    ("cli",),
    ("__main__",),
)
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}


def imports() -> dict[str, set[str]]:
    """Top-level module or package of `twin` -> those that it imports, also inside functions."""
    found: dict[str, set[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        module = file.relative_to(PACKAGE).with_suffix("").parts[0]
        targets = found.setdefault(module, set())
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                parts = node.module.split(".")
                if parts[0] == "twin":
                    targets |= {parts[1]} if len(parts) > 1 else {alias.name for alias in node.names}
            elif isinstance(node, ast.Import):
                targets |= {alias.name.split(".")[1] for alias in node.names if alias.name.startswith("twin.")}
        targets.discard(module)
    return found


def test_imports_run_one_way() -> None:
    backward = [
        f"{module} imports {target}"
        for module, targets in imports().items()
        for target in targets
        if module in RANK and target in RANK and RANK[target] > RANK[module]
    ]
    assert not backward


def test_no_module_is_imported_in_a_circle() -> None:
    graph = imports()
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path, module])
        if module not in done:
            for target in graph.get(module, ()):
                visit(target, (*path, module))
            done.add(module)

    for module in graph:
        visit(module, ())


def test_the_core_has_a_place_in_the_layers() -> None:
    assert RANK.keys() <= imports().keys()  # a module that was renamed has lost its place
    assert {"errors", "units", "machine", "trace", "cascade", "plant", "loop", "run", "gap", "cli"} <= imports().keys() & RANK.keys()
