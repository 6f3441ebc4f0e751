"""The study file (TOML): factors, design, runs and responses.

seed = 1
machine = "my_machine.toml"          # optional; default: --machine or the Mikron
part = "part.toml"                   # optional: adds the mark depth on this part; for one run: part = .. below [[run]]
answer = ["contour_error_max_um"]    # optional: reported responses; the first one is minimised
recommission = true                  # optional: commission the control with each variant's own inertia and torque constant
retune = "same margins"              # optional: scale speed gains with the inertia and current gains with the winding; default: keep the gains
pareto = [["a_um", "b_s"]]           # optional: trade-offs between pairs of responses; default: the first two of `answer`
least_phase_margin_deg = 30          # optional: a variant with a loop below it is marked and cannot be the best
most_time_at_limit = 0.001           # optional: share of a run for which an axis may be at its current or voltage limit

[fixed]                              # optional: numbers of all variants, by path
"axis.*.loops.torque_feedforward" = 0.0

[[run]]
input = "corner.mpf"                 # program or trace beside the study file
feedforward = "velocity"             # optional: off | velocity | velocity+torque
name = "corner"                      # optional; default: the file's name

[[factor]]
name = "mass"
paths = ["axis.X.moving_mass_kg", "axis.Y.moving_mass_kg"]   # see paths.py; or path = ".."
relative = true                      # values multiply the machine's own numbers
range = [0.5, 2.0]                   # or values = [0.5, 1.0, 2.0]

[[factor]]
name = "X motor"
catalogue = "motors.toml"            # named motors, screws or gears, see catalogue.py
axis = "X"                           # or axes = [..], which get the same entry
installed = "M80"                    # the entry on the present machine
values = ["M80", "M100"]             # optional; default: all entries of that kind

[[tied]]                             # nominal x (ratio of the factor or inertia)^exponent
path = "axis.X.loops.speed_gain_nm_s_per_rad"
to = "inertia.X"                     # a factor's name, or the inertia at the motor of an axis in the home pose
exponent = 1.0                       # or slope = 1.0: nominal + slope x (change of the factor's number)

[design]
kind = "grid"                        # grid | latin_hypercube | sobol | one_at_a_time | list
levels = 5                           # grid and one_at_a_time, for factors with a range
count = 64                           # latin_hypercube; sobol: a power of two, times (factors + 2) variants
rows = [[0.5], [1.0]]                # list
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import re
from typing import Any

from twin.documents import outer_file, read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import FEEDFORWARD, Machine, load_machine
from twin.study.constraints import LEAST_PHASE_MARGIN_DEG, MOST_TIME_AT_LIMIT, Constraint, standing
from twin.study.factors import (
    Factor,
    Tied,
    catalogue_factor_of,
    check_apart,
    factor_of,
    flag,
    known_table,
    numbers,
    tied_of,
)
from twin.study.paths import matching_paths, with_numbers
from twin.tables import is_number

DESIGNS = {"grid": ("levels",), "latin_hypercube": ("count",), "sobol": ("count",), "one_at_a_time": ("levels",), "list": ("rows",)}
"""Designs and their keys."""

TOP = (
    "seed",
    "machine",
    "part",
    "answer",
    "recommission",
    "retune",
    "pareto",
    "least_phase_margin_deg",
    "most_time_at_limit",
    "fixed",
    "run",
    "factor",
    "tied",
    "constraint",
    "design",
)
SAME_MARGINS = "same margins"
"""Value of `retune`: gains follow inertia and winding, so that designs are compared, not tunings."""


@dataclass(frozen=True)
class StudyRun:
    """A program or trace that every variant runs, and the part to cut with it."""

    name: str
    input: Path
    feedforward: str | None
    part: Path | None = None


@dataclass(frozen=True)
class Design:
    """Combination of the factors; `rows` is empty unless the design is a list."""

    kind: str
    levels: int
    count: int
    rows: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Study:
    """A checked study; `machine` includes the [fixed] numbers."""

    path: Path
    machine: Machine
    runs: tuple[StudyRun, ...]
    factors: tuple[Factor, ...]
    tied: tuple[Tied, ...]
    design: Design
    seed: int
    answer: tuple[str, ...]
    recommission: bool
    retune: bool = False
    constraints: tuple[Constraint, ...] = ()
    pareto: tuple[tuple[str, str], ...] = ()

    @property
    def varied(self) -> tuple[str, ...]:
        """All paths that differ from variant to variant."""
        return tuple(p for f in self.factors for p in f.paths) + tuple(p for t in self.tied for p in t.paths)


def read_study(path: str | Path, machine_path: str | Path | None = None) -> Study:
    """Read and check a study file; every error is an InputError with table, key and remedy."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such study file; see docs/study.md for the form")
    document = read_toml(path)
    known_table(document, TOP, str(path))
    own = document.get("machine")
    machine = load_machine(machine_path or (outer_file(own, path.parent, f"{path}: machine") if own else None))
    machine = with_numbers(machine, _fixed(document.get("fixed", {}), machine, f"{path}: [fixed]"))
    design = _design(document.get("design", {}), f"{path}: [design]")
    factors = tuple(
        catalogue_factor_of(table, machine, path, f"{path}: factor {i + 1}")
        if isinstance(table, Mapping) and "catalogue" in table
        else factor_of(table, _column(design, i), machine, f"{path}: factor {i + 1}")
        for i, table in enumerate(_tables(document, "factor", path))
    )
    check_apart(factors, path)
    design = _rows_by_number(design, factors, f"{path}: [design]")
    tied = tuple(
        tied_of(table, factors, machine, f"{path}: tied {i + 1}") for i, table in enumerate(_tables(document, "tied", path, least=0))
    )
    part = _part(document, path, str(path), None)
    runs = tuple(_run(table, path, f"{path}: run {i + 1}", part) for i, table in enumerate(_tables(document, "run", path)))
    for what, names in (("factor", [f.name for f in factors]), ("run", [r.name for r in runs])):
        if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
            raise InputError(f"{path}: two of [[{what}]] have the name '{twice}'; give each its own")
    seed, answer = document.get("seed", 0), document.get("answer", [])
    if not isinstance(seed, int) or seed < 0:
        raise InputError(f"{path}: seed = {seed!r}; give a whole number, 0 or more")
    return Study(
        path=path,
        machine=machine,
        runs=runs,
        factors=factors,
        tied=tied,
        design=design,
        seed=seed,
        answer=tuple(str(a) for a in answer) if isinstance(answer, list) else (str(answer),),
        recommission=flag(document, "recommission", str(path)),
        retune=_retune(document, path),
        constraints=_constraints(document, path),
        pareto=_pairs(document.get("pareto", []), path),
    )


def _column(design: Design, i: int) -> list[Any] | None:
    """Values of a factor in the rows of a list design; None for other designs."""
    return [row[i] for row in design.rows if i < len(row)] if design.kind == "list" else None


def _retune(document: Mapping[str, Any], path: Path) -> bool:
    value = document.get("retune")
    if value not in (None, SAME_MARGINS):
        raise InputError(f'{path}: retune = {value!r}; write "{SAME_MARGINS}", or leave it out to keep the gains')
    return value is not None


def _pairs(pairs: Any, path: Path) -> tuple[tuple[str, str], ...]:
    if not isinstance(pairs, list) or not all(isinstance(p, list) and len(p) == 2 and all(isinstance(n, str) for n in p) for p in pairs):
        raise InputError(f'{path}: pareto = {pairs!r}; give pairs of responses, e.g. [["contour_error_max_um", "cycle_time_s"]]')
    return tuple((a, b) for a, b in pairs)


def _constraints(document: Mapping[str, Any], path: Path) -> tuple[Constraint, ...]:
    margin, share = (
        _bound(document, key, str(path), default)
        for key, default in (("least_phase_margin_deg", LEAST_PHASE_MARGIN_DEG), ("most_time_at_limit", MOST_TIME_AT_LIMIT))
    )
    found = list(standing(margin, share))
    for i, table in enumerate(_tables(document, "constraint", path, least=0)):
        where = f"{path}: constraint {i + 1}"
        known_table(table, ("response", "least", "most"), where)
        if not isinstance(table.get("response"), str):
            raise InputError(f"{where}: 'response' is missing; name a response or a pattern, e.g. current_limit_used_*")
        if "least" not in table and "most" not in table:
            raise InputError(f"{where}: has no bound; give least = .. or most = ..")
        least, most = (_bound(table, key, where) if key in table else None for key in ("least", "most"))
        found.append(Constraint(table["response"], least, most))
    return tuple(found)


def _bound(table: Mapping[str, Any], key: str, where: str, default: float = 0.0) -> float:
    value = table.get(key, default)
    if not is_number(value):
        raise InputError(f"{where}: {key} = {value!r}; give a number")
    return float(value)


def _tables(document: Mapping[str, Any], key: str, path: Path, least: int = 1) -> list[Any]:
    tables = document.get(key, [])
    if not isinstance(tables, list):
        raise InputError(f"{path}: '{key}' must be a list of tables; write [[{key}]]")
    if len(tables) < least:
        raise InputError(f"{path}: no [[{key}]]; give at least one")
    return tables


def _fixed(table: Any, machine: Machine, where: str) -> dict[str, float]:
    """Numbers by path; TOML reads an unquoted path as nested tables."""
    if not isinstance(table, Mapping):
        raise InputError(f'{where}: must be a table; write "axis.X.moving_mass_kg" = 690.0')
    out: dict[str, float] = {}

    def collect(inner: Mapping[str, Any], prefix: str) -> None:
        for key, value in inner.items():
            if isinstance(value, Mapping):
                collect(value, f"{prefix}{key}.")
            else:
                (number,) = numbers([value], f"{prefix}{key}", where)
                out.update(dict.fromkeys(matching_paths(f"{prefix}{key}", machine, where), number))

    collect(table, "")
    return out


def _part(table: Mapping[str, Any], path: Path, where: str, otherwise: Path | None) -> Path | None:
    """The part file of a study or of a run."""
    part = table.get("part")
    return otherwise if part is None else outer_file(part, path.parent, f"{where}: part")


def _run(table: Any, path: Path, where: str, part: Path | None) -> StudyRun:
    known_table(table, ("name", "input", "feedforward", "part"), where)
    if "input" not in table:
        raise InputError(f"{where}: 'input' is missing; name a program or a trace beside the study file")
    source = outer_file(table["input"], path.parent, f"{where}: input")
    feedforward = table.get("feedforward")
    if feedforward is not None and feedforward not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward = {feedforward!r}; use one of {', '.join(FEEDFORWARD)}")
    name = str(table.get("name", source.stem))
    if not re.fullmatch(r"[^/\\\x00-\x1f.][^/\\\x00-\x1f]*", name):
        raise InputError(f"{where}: name = {name!r} becomes part of file names; leave out / and \\, and a leading dot")
    return StudyRun(name, source, feedforward, _part(table, path, where, part))


def _design(table: Any, where: str) -> Design:
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str) or kind not in DESIGNS:
        raise InputError(f"{where}: kind = {kind!r}; use one of {', '.join(DESIGNS)}")
    known_table(table, ("kind", *DESIGNS[kind]), f"{where} of kind {kind}")

    def whole(key: str, default: int, check: Callable[[int], bool], ask: str) -> int:
        value = table.get(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not check(value):
            raise InputError(f"{where}: {key} = {value!r}; {ask}")
        return value

    rows = table.get("rows", [])
    if kind == "list" and (not isinstance(rows, list) or not rows):
        raise InputError(f"{where}: the design has no variant; give rows = [[..], [..]]")
    return Design(
        kind=kind,
        levels=whole("levels", 5, lambda n: n >= 2, "give a whole number, 2 or more"),
        count=whole("count", 64, lambda n: n >= 2 and n & (n - 1) == 0, "the Sobol sequence needs a power of two, such as 64")
        if kind == "sobol"
        else whole("count", 64, lambda n: n >= 1, "the design has no variant; give a whole number, 1 or more"),
        rows=tuple(tuple(row) if isinstance(row, list) else (row,) for row in rows) if kind == "list" else (),
    )


def _rows_by_number(design: Design, factors: Sequence[Factor], where: str) -> Design:
    """The design with the names of catalogue entries in its rows replaced by their indices."""
    rows = []
    for row in design.rows:
        row_numbers: list[float] = []
        given: tuple[Any, ...] = row
        for k, value in enumerate(given):
            factor = factors[k] if k < len(factors) else None
            if factor and factor.choices:
                names = [c.name for c in factor.choices]
                if value not in names:
                    raise InputError(f"{where} rows: {value!r} is no choice of '{factor.name}'; {nearest(str(value), names)}")
                row_numbers.append(float(names.index(value)))
            else:
                row_numbers += numbers([value], "rows", where)
        rows.append(tuple(row_numbers))
    return replace(design, rows=tuple(rows))
