"""Counts of the structure of a checkout: size, loose modules, import cycles, untyped and long functions, numeric constants.

python -m devtools.structure [--root CHECKOUT] [--json]
"""

from __future__ import annotations

import argparse
import ast
import json
from pathlib import Path
import tomllib

LONG_LINES, MANY_ARGUMENTS = 100, 12
KERNEL_DECORATORS = ("compiled", "term", "intrinsic")


def sources(root: Path) -> dict[str, ast.Module]:
    """Module name -> syntax tree of every file of the package."""
    package = root / "twin"
    return {
        ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): ast.parse(file.read_text(encoding="utf-8"))
        for file in sorted(package.rglob("*.py"))
    }


def imported(module: str, tree: ast.Module, known: set[str], is_package: bool) -> set[str]:
    """Modules of the package that a module names in its imports, also inside functions."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parts = module.split(".")[: None if is_package and node.level == 1 else -(node.level - is_package)]
                base = ".".join([*parts, *([node.module] if node.module else [])])
            found |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    found = {name for name in found & known if name != module}
    return {name for name in found if not any(other.startswith(name + ".") for other in found)}


def circles(edges: dict[str, set[str]]) -> list[list[str]]:
    """Groups of files that import each other, directly or indirectly (strongly connected components, Tarjan 1972)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in edges[node]:
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            at = stack.index(node)
            groups.append(sorted(stack[at:]))
            del stack[at:]

    for node in edges:
        if node not in index:
            visit(node)
    return [group for group in groups if len(group) > 1]


def functions(tree: ast.Module) -> list[ast.FunctionDef]:
    """Every function and method."""
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def is_untyped(function: ast.FunctionDef) -> bool:
    """Lacks the type of an argument (except self and cls) or of the result."""
    arguments = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return function.returns is None or any(a.annotation is None and a.arg not in ("self", "cls") for a in arguments)


def is_kernel(function: ast.FunctionDef) -> bool:
    """Is it compiled? Numba gives the arguments of a kernel their types at its first call."""
    decorators = (d.func if isinstance(d, ast.Call) else d for d in function.decorator_list)
    return any(isinstance(d, ast.Name) and d.id in KERNEL_DECORATORS for d in decorators)


def numeric_constants(tree: ast.Module) -> int:
    """Module constants with numbers."""
    count = 0
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name) and n.id.isupper()]
        value = getattr(node, "value", None)
        if value is not None and any(isinstance(n, ast.Constant) and isinstance(n.value, int | float) for n in ast.walk(value)):
            count += len(names)
    return count


def named_effects(trees: dict[str, ast.Module]) -> dict[str, str]:
    """Effect -> the module that defines it."""
    return {
        function.name: module
        for module, tree in trees.items()
        if module.startswith("twin.effects.")
        for function in functions(tree)
        if any(isinstance(d, ast.Call) and isinstance(d.func, ast.Name) and d.func.id == "effect" for d in function.decorator_list)
    }


def files_that_say(trees: dict[str, ast.Module], word: str) -> set[str]:
    """Modules with a string equal to the word, as in code for one particular effect; without the second plant."""
    return {
        module
        for module, tree in trees.items()
        if not module.startswith("twin.exam") and any(isinstance(node, ast.Constant) and node.value == word for node in ast.walk(tree))
    }


def files_for_an_effect(trees: dict[str, ast.Module]) -> list[int]:
    """Number of modules that name each effect, including its own."""
    return [len({module, *files_that_say(trees, name)}) for name, module in named_effects(trees).items()]


def files_for_a_format(trees: dict[str, ast.Module]) -> list[int]:
    """Number of modules that name each reader of a trace format, including its own."""
    folder = "twin.recordings.formats."
    readers = [module for module in trees if module.startswith(folder) and not module.endswith((".by_content", ".__init__"))]
    return [len({module, *files_that_say(trees, module.removeprefix(folder))}) for module in readers]


def thresholds(trees: dict[str, ast.Module]) -> int:
    """Number of thresholds in the settings of a diagnosis."""
    settings = trees.get("twin.diagnose.settings", ast.Module([], []))
    return sum(isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "_of" for node in ast.walk(settings))


def exempt_modules(root: Path) -> list[str]:
    """Patterns of modules that the type checker exempts."""
    checker = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8")).get("tool", {}).get("mypy", {})
    patterns: list[str] = []
    for override in checker.get("overrides", []):
        if override.get("disallow_untyped_defs") is False or override.get("ignore_errors"):
            names = override["module"]
            patterns += [names] if isinstance(names, str) else names
    return patterns


def counts(root: Path) -> dict[str, int]:
    """All counts of a checkout."""
    trees = sources(root)
    packages = {m for m in trees if (root / Path(*m.split(".")) / "__init__.py").is_file()}
    edges = {module: imported(module, tree, set(trees), module in packages) for module, tree in trees.items()}
    every = [function for tree in trees.values() for function in functions(tree)]
    lengths = [(f.end_lineno or f.lineno) - f.lineno + 1 for f in every]
    arguments = [len(f.args.posonlyargs) + len(f.args.args) + len(f.args.kwonlyargs) for f in every]
    edges.pop("twin")  # imports everything lazily
    found = circles({module: targets - {"twin"} for module, targets in edges.items()})
    effects, formats = files_for_an_effect(trees), files_for_a_format(trees)
    package = root / "twin"
    return {
        "lines of the package": sum(len(file.read_text(encoding="utf-8").splitlines()) for file in package.rglob("*.py")),
        "files of the package": len(trees),
        "loose modules at the top": len([f for f in package.glob("*.py") if not f.name.startswith("__")]),
        "groups of files that import each other": len(found),
        "files in such groups": sum(map(len, found)),
        "functions": len(every),
        "untyped functions": sum(is_untyped(f) for f in every if not is_kernel(f)),
        "compiled kernels": sum(map(is_kernel, every)),
        f"functions above {LONG_LINES} lines": sum(n > LONG_LINES for n in lengths),
        f"functions above {MANY_ARGUMENTS} arguments": sum(n > MANY_ARGUMENTS for n in arguments),
        "numeric constants in diagnose/": sum(numeric_constants(t) for m, t in trees.items() if m.startswith("twin.diagnose")),
        "thresholds of a diagnosis in one object": thresholds(trees),
        "effects": len(effects),
        "effects that one file names": effects.count(1),
        "readers of a trace format": len(formats),
        "readers that at most two files name": sum(n <= 2 for n in formats),
        "modules exempt from the type checker": sum(_matches(m, exempt_modules(root)) for m in trees),
    }


def _matches(module: str, patterns: list[str]) -> bool:
    return any(module == p or (p.endswith(".*") and (module + ".").startswith(p[:-1])) for p in patterns)


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, default=Path(__file__).resolve().parents[1], help="checkout to count (default: this one)")
    parser.add_argument("--json", action="store_true", help="as JSON")
    given = parser.parse_args()
    found = counts(given.root)
    print(json.dumps(found, indent=1) if given.json else "\n".join(f"{value:>7}  {what}" for what, value in found.items()))


if __name__ == "__main__":
    main()
