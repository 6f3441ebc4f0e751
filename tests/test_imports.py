"""Imports run one way, between rooms and between files; what may stand at the top of the package is listed."""

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[1] / "twin"

TOP = {
    "__init__",
    "__main__",
    "compiled_functions",
    "documents",
    "errors",
    "files",
    "limits",
    "progress",
    "stopping",
    "system",
    "tables",
    "units",
}
"""The small modules that every room stands on."""

ORDER = (
    ("report",),  # a toolbox of drawing: pages, figures, curves; it imports no room
    ("estimate",),  # problem, linearised, solved; it knows no machine and imports no room
    ("control",),  # blocks: parameters, compiled updates, linear models, laws
    ("machine",),  # check, loops and data sheet of a machine read its simulation: see BORROWED
    ("geometry",),
    ("recordings",),
    ("simulation", "effects"),
    ("program",),
    ("surface", "iso230"),
    ("replay", "compare"),
    ("identify",),
    ("diagnose", "study"),
    ("remedy", "history"),
    ("exam", "regress"),
    ("desk",),  # lists what the others wrote; starts commands, imports none
    ("cli",),
)
"""A room may import from rooms above it here and from its own line."""

BORROWED = {
    ("machine", "simulation"),  # loops, check: linear models of the loops of a machine that is there
    ("machine", "effects"),  # check, loops: effects that a machine file lists
    ("machine", "recordings"),
    ("control", "simulation"),  # the stages and signals of the compiled loop
    ("machine", "geometry"),
    ("geometry", "simulation"),  # kinematics and tool path read the compiled model
    ("geometry", "recordings"),
    ("recordings", "simulation"),
}
"""Rooms that import against the order; between files there is no circle all the same."""


def imports_of(file: Path) -> set[str]:
    """Modules of twin that a file imports, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module is not None:
            base = node.module if not node.level else ".".join([*file.relative_to(PACKAGE.parent).parts[: -node.level], node.module])
            if base.split(".")[0] == "twin":
                found |= {f"{base}.{alias.name}" for alias in node.names} | {base}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name.startswith("twin.")}
    return found


def files() -> dict[str, Path]:
    """Module name -> file."""
    return {".".join(f.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): f for f in PACKAGE.rglob("*.py")}


def graph() -> dict[str, set[str]]:
    """Module -> modules that it imports by name; a package that is only on the way to a module does not count."""
    known = files()
    edges = {}
    for module, file in known.items():
        targets = {t for t in imports_of(file) if t in known and t != module}
        edges[module] = {t for t in targets if not any(other.startswith(t + ".") for other in targets)}
    return edges


def test_no_file_is_imported_in_a_circle() -> None:
    edges, done = graph(), set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module not in done:
            for target in sorted(edges[module]):
                visit(target, (*path, module))
            done.add(module)

    for module in edges:
        visit(module, ())


def test_rooms_import_one_way() -> None:
    rank = {room: i for i, line in enumerate(ORDER) for room in line}
    backward = []
    for module, targets in graph().items():
        for target in targets:
            ours, theirs = (name.split(".")[1] if "." in name else "" for name in (module, target))
            if ours in rank and theirs in rank and rank[theirs] > rank[ours] and (ours, theirs) not in BORROWED:
                backward.append(f"{module} imports {target}")
    assert not backward


def test_top_of_the_package() -> None:
    assert {f.stem for f in PACKAGE.glob("*.py")} == TOP
    rooms = {f.name for f in PACKAGE.iterdir() if f.is_dir() and (f / "__init__.py").exists()}
    assert rooms <= {room for line in ORDER for room in line}
