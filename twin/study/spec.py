"""The study file (TOML): what is varied, by which design, on which runs, and what is answered.

seed = 1
machine = "my_machine.toml"          # optional; else --machine or the Mikron
answer = ["contour_error_max_um"]    # optional: what the report looks at first; the first one is minimised

[[run]]
input = "corner.mpf"                 # program or trace, beside the study file
feedforward = "velocity"             # optional: off | velocity | velocity+torque

[[factor]]
name = "mass"
paths = ["axis.X.moving_mass_kg", "axis.Y.moving_mass_kg"]   # or "axis.*.loops.position_gain_per_s", "effect.backlash.X.clearance"
relative = true                      # values are factors on what the file has
range = [0.5, 2.0]                   # or values = [0.5, 1.0, 2.0]

[[tied]]                             # follows a factor: nominal x (factor / its nominal)^exponent
path = "axis.X.loops.speed_gain_nm_s_per_rad"
to = "mass"
exponent = 1.0

[design]
kind = "grid"                        # grid | latin_hypercube | sobol | one_at_a_time | list
levels = 5                           # grid and one_at_a_time, for factors with a range
count = 64                           # latin_hypercube; sobol: base count, times (factors + 2) variants
rows = [[0.5], [1.0]]                # list
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import fnmatch
import math
from pathlib import Path
import tomllib
from typing import Any

from twin.effects.effect import find_effect
from twin.errors import InputError, nearest
from twin.machine import FEEDFORWARD, Machine, load_machine

DESIGNS = ("grid", "latin_hypercube", "sobol", "one_at_a_time", "list")


@dataclass(frozen=True)
class Factor:
    """One thing that is varied: paths into the machine file that take the same value (or factor, when `relative`)."""

    name: str
    paths: tuple[str, ...]
    relative: bool
    values: tuple[float, ...]
    range: tuple[float, float] | None

    @property
    def low(self) -> float:
        return self.range[0] if self.range else min(self.values)

    @property
    def high(self) -> float:
        return self.range[1] if self.range else max(self.values)


@dataclass(frozen=True)
class Tied:
    """A path that follows a factor: nominal x (factor / nominal of the factor) ^ exponent."""

    path: str
    to: str
    exponent: float


@dataclass(frozen=True)
class StudyRun:
    """One program or trace that every variant runs."""

    name: str
    input: Path
    feedforward: str | None


@dataclass(frozen=True)
class Study:
    """A checked study."""

    path: Path
    machine: Machine
    runs: tuple[StudyRun, ...]
    factors: tuple[Factor, ...]
    tied: tuple[Tied, ...]
    design: Mapping[str, Any]
    seed: int
    answer: tuple[str, ...]
    part: Path | None
    text: str


def read_study(path: str | Path, machine_path: str | None = None) -> Study:
    """Read and check a study file; every fault is an InputError with table, key and remedy."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
        document = tomllib.loads(text)
    except FileNotFoundError:
        raise InputError(f"{path}: no such study file; see docs/study.md for the form") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not a valid TOML file: {error}; correct it there") from None
    for key in document:
        if key not in ("seed", "machine", "answer", "run", "factor", "tied", "design", "part", "name"):
            raise InputError(
                f"{path}: unknown key '{key}'; {nearest(key, ('seed', 'machine', 'answer', 'run', 'factor', 'tied', 'design', 'part'))}"
            )
    own = document.get("machine")
    machine = load_machine(machine_path or (path.parent / own if own else None))
    factors = tuple(_factor(table, machine, f"{path}: factor {i + 1}") for i, table in enumerate(_tables(document, "factor", path)))
    if len({f.name for f in factors}) < len(factors):
        raise InputError(f"{path}: two factors have one name; give each its own")
    tied = tuple(_tied(table, factors, machine, f"{path}: tied {i + 1}") for i, table in enumerate(document.get("tied", [])))
    design = document.get("design", {})
    if design.get("kind") not in DESIGNS:
        raise InputError(f"{path}: [design] kind = {design.get('kind')!r}; use one of {', '.join(DESIGNS)}")
    answer = document.get("answer", [])
    return Study(
        path=path,
        machine=machine,
        runs=tuple(_run(table, path, f"{path}: run {i + 1}") for i, table in enumerate(_tables(document, "run", path))),
        factors=factors,
        tied=tied,
        design=design,
        seed=int(document.get("seed", 0)),
        answer=tuple(answer if isinstance(answer, list) else [answer]),
        part=path.parent / document["part"] if "part" in document else None,
        text=text,
    )


def _tables(document: Mapping[str, Any], key: str, path: Path) -> list[Any]:
    tables = document.get(key, [])
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{path}: no [[{key}]]; give at least one")
    return tables


def _run(table: Mapping[str, Any], path: Path, where: str) -> StudyRun:
    if "input" not in table:
        raise InputError(f"{where}: 'input' is missing; name a program or a trace beside the study file")
    source = path.parent / str(table["input"])
    if not source.is_file():
        raise InputError(f"{where}: input '{table['input']}': no such file beside {path.name}; correct it")
    feedforward = table.get("feedforward")
    if feedforward is not None and feedforward not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward = '{feedforward}'; use one of {', '.join(FEEDFORWARD)}")
    return StudyRun(source.stem, source, feedforward)


def _factor(table: Mapping[str, Any], machine: Machine, where: str) -> Factor:
    asked = table.get("paths", [table["path"]] if "path" in table else [])
    if not asked:
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file, e.g. axis.X.moving_mass_kg")
    paths = tuple(p for one in asked for p in matching_paths(one, machine, where))
    name = str(table.get("name", asked[0]))
    relative = bool(table.get("relative", False))
    values, limits = table.get("values", []), table.get("range")
    if not values and limits is None:
        raise InputError(f"{where}: '{name}' has neither values nor a range; give values = [..] or range = [low, high]")
    numbers = [*values, *(limits or [])]
    if not all(isinstance(v, int | float) and math.isfinite(v) for v in numbers) or (
        limits is not None and (len(limits) != 2 or limits[0] >= limits[1])
    ):
        raise InputError(f"{where}: '{name}': values and range must be numbers, range = [low, high] with low below high")
    return Factor(
        name, paths, relative, tuple(float(v) for v in values), (float(limits[0]), float(limits[1])) if limits is not None else None
    )


def _tied(table: Mapping[str, Any], factors: Sequence[Factor], machine: Machine, where: str) -> Tied:
    names = [f.name for f in factors]
    if table.get("to") not in names:
        raise InputError(f"{where}: to = {table.get('to')!r} is no factor; {nearest(str(table.get('to')), names)}")
    if "path" not in table:
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file")
    (path, *more) = matching_paths(table["path"], machine, where)
    if more:
        raise InputError(f"{where}: '{table['path']}' matches several numbers; tie them one by one")
    return Tied(path, table["to"], float(table.get("exponent", 1.0)))


def matching_paths(pattern: str, machine: Machine, where: str) -> list[str]:
    """Paths of numbers in the machine file that a path with wildcards names; effects as effect.NAME.AXIS.PARAMETER."""
    if pattern.startswith("effect."):
        parts = pattern.split(".")
        if len(parts) != 4:
            raise InputError(f"{where}: '{pattern}': write effect.NAME.AXIS.PARAMETER, e.g. effect.backlash.X.clearance")
        find_effect(parts[1], where).parameter(parts[3])
        machine.axis(parts[2])
        return [pattern]
    known = list(numbers_of(machine.document))
    found = [p for p in known if fnmatch.fnmatchcase(p, pattern)]
    if not found:
        raise InputError(f"{where}: no number '{pattern}' in machine {machine.name}; {nearest(pattern, known)}")
    return found


def numbers_of(table: Mapping[str, Any], prefix: str = "") -> list[str]:
    """Paths of all numbers of a machine file."""
    out = []
    for key, value in table.items():
        path = f"{prefix}{key}"
        if isinstance(value, Mapping):
            out += numbers_of(value, f"{path}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            out.append(path)
    return out
