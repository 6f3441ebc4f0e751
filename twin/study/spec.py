"""The study file (TOML): what is varied, by which design, on which runs, and what is answered.

seed = 1
machine = "my_machine.toml"          # optional; else --machine or the Mikron
part = "part.toml"                   # optional: also the depth of the mark on this part
answer = ["contour_error_max_um"]    # optional: what the report looks at first; the first one is minimised
recommission = true                  # optional: the control is commissioned with each variant's own inertia and torque constant
retune = "same margins"              # optional: speed gains follow the inertia, current gains the winding; else the gains stay
pareto = [["a_um", "b_s"]]           # optional: trade-offs between pairs of responses; else between all of `answer`
least_phase_margin_deg = 30          # optional: a variant with a loop below it is marked and is never the best
most_time_at_limit = 0.001           # optional: share of a run for which an axis may be at its current or voltage limit

[fixed]                              # optional: numbers that all variants have, by path
"axis.*.loops.torque_feedforward" = 0.0

[[run]]
input = "corner.mpf"                 # program or trace, beside the study file
feedforward = "velocity"             # optional: off | velocity | velocity+torque
name = "corner"                      # optional: the file's name else

[[factor]]
name = "mass"
paths = ["axis.X.moving_mass_kg", "axis.Y.moving_mass_kg"]   # see paths.py; or path = ".."
relative = true                      # values are factors on what the machine has
range = [0.5, 2.0]                   # or values = [0.5, 1.0, 2.0]

[[factor]]
name = "X motor"
catalogue = "motors.toml"            # named motors, screws or gears, see catalogue.py
axis = "X"                           # or axes = [..], which get the same
installed = "M80"                    # what the machine has now
values = ["M80", "M100"]             # optional: else all of that kind

[[tied]]                             # follows: its nominal x (ratio of what it follows)^exponent
path = "axis.X.loops.speed_gain_nm_s_per_rad"
to = "inertia.X"                     # a factor's name, or the inertia at an axis' motor in the home pose
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
from twin.study.catalogue import Choice, choices_of
from twin.study.constraints import LEAST_PHASE_MARGIN_DEG, MOST_TIME_AT_LIMIT, Constraint, standing
from twin.study.paths import matching_paths, number_at, with_numbers
from twin.tables import is_number, known_keys

DESIGNS = {"grid": ("levels",), "latin_hypercube": ("count",), "sobol": ("count",), "one_at_a_time": ("levels",), "list": ("rows",)}
"""Designs, and the keys that each takes."""

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
INERTIA = "inertia."
SAME_MARGINS = "same margins"
"""Word of `retune`: gains follow inertia and winding, so that designs are compared and not their tunings."""


@dataclass(frozen=True)
class Factor:
    """One thing that is varied: paths into the machine that take the same value (or factor, when `relative`).

    With `choices`, entries of a catalogue, a value is the number of an entry, from 0 on, and `paths` are all that any of them changes.
    """

    name: str
    paths: tuple[str, ...]
    relative: bool
    values: tuple[float, ...]
    range: tuple[float, float] | None
    choices: tuple[Choice, ...] = ()
    installed: str = ""

    @property
    def low(self) -> float:
        return self.range[0] if self.range else min(self.values)

    @property
    def high(self) -> float:
        return self.range[1] if self.range else max(self.values)

    def shown(self, value: float) -> str:
        """A value as people read it: the name of a choice, else the number."""
        return self.choices[round(value)].name if self.choices else f"{value:.4g}"


@dataclass(frozen=True)
class Tied:
    """Paths that follow a factor or `inertia.AXIS`: nominal x ratio^exponent, or nominal + slope x change of the factor's number."""

    paths: tuple[str, ...]
    to: str
    exponent: float
    slope: float | None


@dataclass(frozen=True)
class StudyRun:
    """One program or trace that every variant runs."""

    name: str
    input: Path
    feedforward: str | None


@dataclass(frozen=True)
class Design:
    """How the factors are combined; `rows` is empty unless the design is a list."""

    kind: str
    levels: int
    count: int
    rows: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Study:
    """A checked study; `machine` is the one that is varied, with its fixed numbers."""

    path: Path
    machine: Machine
    runs: tuple[StudyRun, ...]
    factors: tuple[Factor, ...]
    tied: tuple[Tied, ...]
    design: Design
    seed: int
    answer: tuple[str, ...]
    part: Path | None
    recommission: bool
    retune: bool = False
    constraints: tuple[Constraint, ...] = ()
    pareto: tuple[tuple[str, str], ...] = ()

    @property
    def varied(self) -> tuple[str, ...]:
        """All paths that differ from variant to variant."""
        return tuple(p for f in self.factors for p in f.paths) + tuple(p for t in self.tied for p in t.paths)


def read_study(path: str | Path, machine_path: str | Path | None = None) -> Study:
    """Read and check a study file; every fault is an InputError with table, key and remedy."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such study file; see docs/study.md for the form")
    document = read_toml(path)
    _known(document, TOP, str(path))
    own = document.get("machine")
    machine = load_machine(machine_path or (outer_file(own, path.parent, f"{path}: machine") if own else None))
    machine = with_numbers(machine, _fixed(document.get("fixed", {}), machine, f"{path}: [fixed]"))
    design = _design(document.get("design", {}), f"{path}: [design]")
    factors = tuple(
        _catalogue_factor(table, machine, path, f"{path}: factor {i + 1}")
        if isinstance(table, Mapping) and "catalogue" in table
        else _factor(table, design, i, machine, f"{path}: factor {i + 1}")
        for i, table in enumerate(_tables(document, "factor", path))
    )
    _check_apart(factors, path)
    design = _rows_by_number(design, factors, f"{path}: [design]")
    tied = tuple(_tied(table, factors, machine, f"{path}: tied {i + 1}") for i, table in enumerate(document.get("tied", [])))
    runs = tuple(_run(table, path, f"{path}: run {i + 1}") for i, table in enumerate(_tables(document, "run", path)))
    for what, names in (("factor", [f.name for f in factors]), ("run", [r.name for r in runs])):
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise InputError(f"{path}: two of [[{what}]] have the name '{twice}'; give each its own")
    seed, answer, part = document.get("seed", 0), document.get("answer", []), document.get("part")
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
        part=outer_file(part, path.parent, f"{path}: part") if part is not None else None,
        recommission=_flag(document, "recommission", str(path)),
        retune=_retune(document, path),
        constraints=_constraints(document, path),
        pareto=_pairs(document.get("pareto", []), path),
    )


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
    for i, table in enumerate(document.get("constraint", [])):
        where = f"{path}: constraint {i + 1}"
        _known(table, ("response", "least", "most"), where)
        if not isinstance(table.get("response"), str):
            raise InputError(f"{where}: 'response' is missing; name a response or a pattern, e.g. current_limit_used_*")
        if "least" not in table and "most" not in table:
            raise InputError(f"{where}: has no bound; give least = .. or most = ..")
        found.append(Constraint(table["response"], *(_bound(table, key, where) if key in table else None for key in ("least", "most"))))
    return tuple(found)


def _bound(table: Mapping[str, Any], key: str, where: str, default: float = 0.0) -> float:
    value = table.get(key, default)
    if not is_number(value):
        raise InputError(f"{where}: {key} = {value!r}; give a number")
    return float(value)


def _known(table: object, keys: Sequence[str], where: str) -> None:
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: must be a table; see docs/study.md for the form")
    known_keys(table, keys, where)


def _tables(document: Mapping[str, Any], key: str, path: Path) -> list[Any]:
    tables = document.get(key, [])
    if not isinstance(tables, list) or not tables:
        raise InputError(f"{path}: no [[{key}]]; give at least one")
    return tables


def _flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{where}: {key} = {value!r}; write true or false")
    return value


def _numbers(values: Any, what: str, where: str) -> tuple[float, ...]:
    if not isinstance(values, list) or not all(map(is_number, values)):
        raise InputError(f"{where}: {what} = {values!r}; give a list of numbers")
    return tuple(float(v) for v in values)


def _fixed(table: Any, machine: Machine, where: str) -> dict[str, float]:
    """Numbers by path; a path that was not quoted has become tables within tables."""
    if not isinstance(table, Mapping):
        raise InputError(f'{where}: must be a table; write "axis.X.moving_mass_kg" = 690.0')
    out: dict[str, float] = {}

    def collect(inner: Mapping[str, Any], prefix: str) -> None:
        for key, value in inner.items():
            if isinstance(value, Mapping):
                collect(value, f"{prefix}{key}.")
            else:
                (number,) = _numbers([value], f"{prefix}{key}", where)
                out.update(dict.fromkeys(matching_paths(f"{prefix}{key}", machine, where), number))

    collect(table, "")
    return out


def _run(table: Any, path: Path, where: str) -> StudyRun:
    _known(table, ("name", "input", "feedforward"), where)
    if "input" not in table:
        raise InputError(f"{where}: 'input' is missing; name a program or a trace beside the study file")
    source = outer_file(table["input"], path.parent, f"{where}: input")
    feedforward = table.get("feedforward")
    if feedforward is not None and feedforward not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward = {feedforward!r}; use one of {', '.join(FEEDFORWARD)}")
    name = str(table.get("name", source.stem))
    if not re.fullmatch(r"[^/\\\x00-\x1f.][^/\\\x00-\x1f]*", name):
        raise InputError(f"{where}: name = {name!r}: files are named after it; leave out / and \\, and a dot at its start")
    return StudyRun(name, source, feedforward)


def _factor(table: Any, design: Design, column: int, machine: Machine, where: str) -> Factor:
    _known(table, ("name", "path", "paths", "relative", "values", "range"), where)
    asked = table.get("paths", [table["path"]] if "path" in table else [])
    if not isinstance(asked, list) or not asked or not all(isinstance(one, str) for one in asked):
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file, e.g. axis.X.moving_mass_kg")
    name = str(table.get("name", asked[0]))
    where = f"{where}: '{name}'"
    paths = tuple(dict.fromkeys(p for one in asked for p in matching_paths(one, machine, where)))
    relative = _flag(table, "relative", where)
    if relative and (lacking := next((p for p in paths if number_at(machine, p) is None), None)):
        raise InputError(f"{where}: relative, but the machine lacks {lacking}; give absolute values or put the effect into its file")
    values = _numbers(table.get("values", []), "values", where)
    limits = _numbers(table.get("range", []), "range", where)
    if limits and (len(limits) != 2 or limits[0] >= limits[1]):
        raise InputError(f"{where}: range = {list(limits)}; give [low, high] with low below high")
    if values and limits:
        raise InputError(f"{where}: has both values and a range; give one of them")
    if design.kind == "list":
        # the rows show its values
        own = [row[column] for row in design.rows if column < len(row)]
        return Factor(name, paths, relative, _numbers(own, "rows", where), None)
    if not values and not limits:
        raise InputError(f"{where}: has neither values nor a range; give values = [..] or range = [low, high]")
    if not limits and len(set(values)) < 2:
        raise InputError(f"{where}: has one value only; give two or more, or put it under [fixed]")
    return Factor(name, paths, relative, values, (limits[0], limits[1]) if limits else None)


def _catalogue_factor(table: Mapping[str, Any], machine: Machine, path: Path, where: str) -> Factor:
    _known(table, ("name", "catalogue", "axis", "axes", "installed", "values"), where)
    names = table.get("axes", [table["axis"]] if "axis" in table else [])
    if not isinstance(names, list) or not names:
        raise InputError(f"{where}: 'axis' is missing; name the axis whose drive is chosen, e.g. axis = \"X\"")
    if wrong := next((name for name in names if name not in machine.axis_names), None):
        raise InputError(f"{where}: no axis {wrong!r}; {nearest(str(wrong), machine.axis_names)}")
    values, installed = table.get("values", []), table.get("installed")
    if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
        raise InputError(f"{where}: values = {values!r}; give names of the catalogue, or leave it out for all")
    if not isinstance(installed, str):
        raise InputError(f"{where}: 'installed' is missing; name the entry of the catalogue that the machine has now")
    choices = choices_of(
        outer_file(table["catalogue"], path.parent, f"{where}: catalogue"), [machine.axis(name) for name in names], installed, values, where
    )
    paths = dict.fromkeys(p for c in choices for p, _ in (*c.values, *c.added_inertia))
    name = str(table.get("name", f"{Path(str(table['catalogue'])).stem} of {' '.join(names)}"))
    return Factor(name, tuple(paths), False, tuple(float(i) for i in range(len(choices))), None, choices, installed)


def _check_apart(factors: Sequence[Factor], path: Path) -> None:
    """What a catalogue sets no other factor may set; inertias of a motor and a screw add up."""
    for factor in factors:
        own = {p for choice in factor.choices for p, _ in choice.values}
        for other in factors:
            both = set(other.paths) & (own if other.choices else set(factor.paths) if factor.choices else set())
            if other is not factor and both:
                raise InputError(f"{path}: factors '{factor.name}' and '{other.name}' both set {min(both)}; leave one of them out")


def _tied(table: Any, factors: Sequence[Factor], machine: Machine, where: str) -> Tied:
    _known(table, ("path", "to", "exponent", "slope"), where)
    names = [f.name for f in factors]
    to = str(table.get("to"))
    inertias = [f"{INERTIA}{axis}" for axis in machine.axis_names]
    if to not in (*names, *inertias):
        raise InputError(f"{where}: to = {table.get('to')!r}; {nearest(to, (*names, *inertias))}")
    if "path" not in table:
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file")
    paths = tuple(matching_paths(str(table["path"]), machine, where))
    if "slope" in table and ("exponent" in table or to in inertias):
        raise InputError(f"{where}: slope goes with a factor and without exponent; give one of them")
    exponent, *slope = _numbers([table.get("exponent", 1.0), *([table["slope"]] if "slope" in table else [])], "exponent, slope", where)
    factor = next((f for f in factors if f.name == to), None)
    if factor and factor.choices:
        raise InputError(
            f"{where}: to = {to!r} is a choice of a catalogue, which has no ratio; tie it to {INERTIA}AXIS, or give the number under [fixed]"
        )
    if factor and not factor.relative and not slope and number_at(machine, factor.paths[0]) == 0.0:
        raise InputError(f"{where}: {factor.paths[0]} is 0 on the machine as it is, so there is no ratio; give a slope")
    lacking = [p for p in (*paths, *(factor.paths if factor and not factor.relative else ())) if number_at(machine, p) is None]
    if lacking:
        raise InputError(f"{where}: the machine lacks {lacking[0]}, so there is no nominal to scale; give it under [fixed]")
    return Tied(paths, to, exponent, slope[0] if slope else None)


def _design(table: Any, where: str) -> Design:
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if kind not in DESIGNS:
        raise InputError(f"{where}: kind = {kind!r}; use one of {', '.join(DESIGNS)}")
    _known(table, ("kind", *DESIGNS[kind]), f"{where} of kind {kind}")

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
    """Rows of a list in which the names of a catalogue's entries are their numbers."""
    rows = []
    for row in design.rows:
        numbers: list[float] = []
        given: tuple[Any, ...] = row
        for k, value in enumerate(given):
            factor = factors[k] if k < len(factors) else None
            if factor and factor.choices:
                names = [c.name for c in factor.choices]
                if value not in names:
                    raise InputError(f"{where} rows: {value!r} is no choice of '{factor.name}'; {nearest(str(value), names)}")
                numbers.append(float(names.index(value)))
            else:
                numbers += _numbers([value], "rows", where)
        rows.append(tuple(numbers))
    return replace(design, rows=tuple(rows))
