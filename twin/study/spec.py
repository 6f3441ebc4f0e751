"""The study file (TOML): factors, design, runs and responses. docs/study.md has its form, with every key and its default."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
import fnmatch
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import field
from msgspec.structs import replace

from twin.documents import flat, named_file, read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import Feedforward, Machine, load_machine
from twin.study.factors import Factor, FactorTable, Tied, TiedTable, catalogue_factor_of, check_apart, factor_of, tied_of
from twin.study.labels import label_of, valued
from twin.study.paths import matching_paths, with_numbers
from twin.tables import Number, Table, Text, Whole, asks, is_number, known_keys, typed

DESIGNS = {"grid": ("levels",), "latin_hypercube": ("count",), "sobol": ("count",), "one_at_a_time": ("levels",), "list": ("rows",)}
"""Designs and their keys."""


class Design(Table, frozen=True):
    """Combination of the factors; `rows` is empty unless the design is a list."""

    kind: Literal["grid", "latin_hypercube", "sobol", "one_at_a_time", "list"]
    levels: Annotated[int, asks("give a whole number, 2 or more", ge=2)] = 5
    count: Annotated[int, asks("the design has no variant; give a whole number, 1 or more", ge=1)] = 64
    rows: Annotated[tuple[tuple[Number | str, ...], ...], asks("give rows of numbers: [[..], [..]]")] = ()


class StudyRun(Table, frozen=True):
    """[[run]]: a program or trace that every variant runs, and the part to cut with it."""

    input: Annotated[str, asks("name a program or a trace beside the study file")]
    feedforward: Feedforward | None = None
    name: Annotated[
        str, asks("it becomes part of file names; leave out / and \\, and a leading dot", pattern=r"^[^/\\\x00-\x1f.][^/\\\x00-\x1f]*$")
    ] = ""
    part: str | None = None


MARGINS, LIMITS = "phase_margin_*_deg", "time_at_*_limit_*_share"
"""Responses whose constraints apply to every study, even if its machine has none of them: a least phase margin of every loop (with less it
rings), and a largest share of a run that an axis may spend at its current or voltage limit (half a millisecond of clipped voltage at a corner
is acceptable)."""


class Constraint(Table, frozen=True):
    """[[constraint]]: a bound on all responses whose names match a pattern (`*` and `?`): not below `least`, not above `most`."""

    response: Annotated[str, asks("name a response or a pattern, e.g. current_limit_used_*")]
    least: Number | None = None
    most: Number | None = None


class StudyFile(Table, frozen=True):
    run: Annotated[tuple[StudyRun, ...], asks("no [[run]]; give at least one", min_length=1)]
    factor: Annotated[tuple[FactorTable, ...], asks("no [[factor]]; give at least one", min_length=1)]
    design: Annotated[Design, asks('write [design] and kind = "grid", or another one, below it')]
    tied: tuple[TiedTable, ...] = ()
    constraint: tuple[Constraint, ...] = ()
    fixed: Annotated[dict[str, Any], asks('write "axis.X.moving_mass_kg" = 690.0 below [fixed]')] = field(default_factory=dict)
    seed: Whole = 0
    machine: Text | None = None
    part: Text | None = None
    answer: Annotated[tuple[str, ...] | str, asks("name responses")] = ()
    recommission: bool = False
    retune: Annotated[Literal["same margins"] | None, asks('write "same margins", or leave it out to keep the gains')] = None
    pareto: Annotated[tuple[tuple[str, str], ...], asks('give pairs of responses, e.g. [["contour_error_max_um", "cycle_time_s"]]')] = ()
    least_phase_margin_deg: Number = 30.0
    most_time_at_limit: Number = 0.001


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


def read_study(path: str | Path, machine_path: str | Path | None = None) -> Study:
    """Read and check a study file; every error is an InputError with table, key and remedy."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such study file; see docs/study.md for the form")
    raw = read_toml(path)
    document = typed(raw, StudyFile, str(path))
    machine = load_machine(
        machine_path or (named_file(document.machine, path.parent, f"{path}: machine", outer=True) if document.machine else None)
    )
    machine = with_numbers(machine, _fixed(document.fixed, machine, f"{path}: [fixed]"))
    design = _checked(document.design, raw["design"], f"{path}: [design]")
    columns = [[row[i] for row in design.rows if i < len(row)] for i in range(len(document.factor))] if design.kind == "list" else None
    factors = tuple(
        catalogue_factor_of(table, machine, path, f"{path}: factor {i + 1}")
        if table.catalogue is not None
        else factor_of(table, columns and columns[i], machine, f"{path}: factor {i + 1}")
        for i, table in enumerate(document.factor)
    )
    check_apart(factors, path)
    part = document.part and str(named_file(document.part, path.parent, f"{path}: part", outer=True))
    runs = tuple(_run(table, path, f"{path}: run {i + 1}", part) for i, table in enumerate(document.run))
    for what, names in (("factor", [f.name for f in factors]), ("run", [r.name for r in runs])):
        if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
            raise InputError(f"{path}: two of [[{what}]] have the name '{twice}'; give each its own")
    for i, table in enumerate(document.constraint):
        if table.least is None and table.most is None:
            raise InputError(f"{path}: constraint {i + 1}: has no bound; give least = .. or most = ..")
    margins = Constraint(response=MARGINS, least=document.least_phase_margin_deg)
    standing = margins, Constraint(response=LIMITS, most=document.most_time_at_limit)
    return Study(
        path=path,
        machine=machine,
        runs=runs,
        factors=factors,
        tied=tuple(tied_of(table, factors, machine, f"{path}: tied {i + 1}") for i, table in enumerate(document.tied)),
        design=_rows_by_number(design, factors, f"{path}: [design]"),
        seed=document.seed,
        answer=(document.answer,) if isinstance(document.answer, str) else document.answer,
        recommission=document.recommission,
        retune=document.retune is not None,
        constraints=(*standing, *document.constraint),
        pareto=document.pareto,
    )


def _fixed(table: Mapping[str, Any], machine: Machine, where: str) -> dict[str, float]:
    """Numbers by path; TOML reads an unquoted path as nested tables."""
    out: dict[str, float] = {}
    for path, value in flat(table).items():
        if not is_number(value):
            raise InputError(f"{where}: {path} = {value!r}; give a number")
        out |= dict.fromkeys(matching_paths(path, machine, where), float(value))
    return out


def _run(table: StudyRun, path: Path, where: str, part: str | None) -> StudyRun:
    """The run with its name and the paths of its files."""
    source = named_file(table.input, path.parent, f"{where}: input", outer=True)
    own = str(named_file(table.part, path.parent, f"{where}: part", outer=True)) if table.part is not None else part
    return replace(table, name=table.name or source.stem, input=str(source), part=own)


def _checked(design: Design, table: Mapping[str, Any], where: str) -> Design:
    """The design, with only the keys of its kind."""
    known_keys(table, ("kind", *DESIGNS[design.kind]), f"{where} of kind {design.kind}")
    if design.kind == "list" and not design.rows:
        raise InputError(f"{where}: the design has no variant; give rows = [[..], [..]]")
    if design.kind == "sobol" and (design.count < 2 or design.count & (design.count - 1)):
        raise InputError(f"{where}: count = {design.count}; the Sobol sequence needs a power of two, such as 64")
    return design


def _rows_by_number(design: Design, factors: Sequence[Factor], where: str) -> Design:
    """The design with the names of catalogue entries in its rows replaced by their indices."""
    rows: list[tuple[float | str, ...]] = []
    for i, row in enumerate(design.rows):
        if len(row) != len(factors):
            raise InputError(f"{where} rows: row {i + 1} needs {len(factors)} numbers, one for each factor")
        found = list(row)
        for k, (value, factor) in enumerate(zip(row, factors)):
            if factor.choices:
                names = [c.name for c in factor.choices]
                if value not in names:
                    raise InputError(f"{where} rows: {value!r} is no choice of '{factor.name}'; {nearest(str(value), names)}")
                found[k] = float(names.index(str(value)))
            elif isinstance(value, str):
                raise InputError(f"{where} rows: {value!r} is no value of '{factor.name}'; give a number")
        rows.append(tuple(found))
    return replace(design, rows=tuple(rows))


def in_words(constraint: Constraint) -> str:
    """A constraint as a phrase: 'phase margin of every loop at least 30 deg'."""
    name = constraint.response
    what = label_of(name.replace("_*_", "_").rstrip("*").rstrip("_")) if "*" in name else label_of(name)
    bounds = [
        f"{words} {valued(name, value)}"
        for words, value in (("at least", constraint.least), ("at most", constraint.most))
        if value is not None
    ]
    return f"{what}{' (all)' if '*' in name else ''} {' and '.join(bounds)}"


def broken_by(constraints: Sequence[Constraint], responses: Mapping[str, float]) -> Iterator[str]:
    """A sentence for each response that breaks a constraint; with several runs the joined value is checked."""
    for constraint in constraints:
        for name in fnmatch.filter(responses, constraint.response):
            value = responses[name]
            if constraint.least is not None and value < constraint.least:
                yield f"{label_of(name)} is {valued(name, value)}, below the least of {valued(name, constraint.least)}"
            if constraint.most is not None and value > constraint.most:
                yield f"{label_of(name)} is {valued(name, value)}, above the limit of {valued(name, constraint.most)}"
