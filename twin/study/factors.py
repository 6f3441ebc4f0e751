"""Factors of a study (numbers of the machine or catalogue entries) and the numbers tied to them, read from tables and checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.documents import outer_file
from twin.errors import InputError, nearest
from twin.machine.machine import Machine
from twin.study.catalogue import Choice, choices_of
from twin.study.paths import matching_paths, number_at, unit_at
from twin.tables import is_number, known_keys

INERTIA = "inertia."


@dataclass(frozen=True)
class Factor:
    """One varied quantity: paths into the machine that take the same value (or the same multiplier, if `relative`).

    With `choices` (catalogue entries) a value is the index of an entry, and `paths` are all numbers that any entry changes.
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
        """A value as text: the name of a choice, otherwise the number."""
        return self.choices[round(value)].name if self.choices else f"{value:.4g}"

    @property
    def unit(self) -> str:
        """Unit of its values: 'kg', 'times nominal'; '' for catalogue entries and numbers without a unit."""
        if self.choices:
            return ""
        return "times nominal" if self.relative else unit_at(self.paths[0])

    @property
    def titled(self) -> str:
        """Name and unit for tables and plots."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def said(self, value: float) -> str:
        """A value with its unit: '850 kg', '0.7 times nominal', or the name of a catalogue entry."""
        return f"{self.shown(value)} {self.unit}".rstrip()


@dataclass(frozen=True)
class Tied:
    """Paths that follow a factor or `inertia.AXIS`: nominal x ratio^exponent, or nominal + slope x change of the factor's number."""

    paths: tuple[str, ...]
    to: str
    exponent: float
    slope: float | None


def known_table(table: object, keys: Sequence[str], where: str) -> None:
    """Raise InputError unless this is a table with these keys only."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: must be a table; see docs/study.md for the form")
    known_keys(table, keys, where)


def flag(table: Mapping[str, Any], key: str, where: str) -> bool:
    """A Boolean of a table; false by default."""
    value = table.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{where}: {key} = {value!r}; write true or false")
    return value


def numbers(values: Any, what: str, where: str) -> tuple[float, ...]:
    """A list of numbers."""
    if not isinstance(values, list) or not all(map(is_number, values)):
        raise InputError(f"{where}: {what} = {values!r}; give a list of numbers")
    return tuple(float(v) for v in values)


def factor_of(table: Any, listed: Sequence[Any] | None, machine: Machine, where: str) -> Factor:
    """A factor for a number of the machine file; `listed` are its values in a design of kind list, otherwise None."""
    known_table(table, ("name", "path", "paths", "relative", "values", "range"), where)
    asked = table.get("paths", [table["path"]] if "path" in table else [])
    if not isinstance(asked, list) or not asked or not all(isinstance(one, str) for one in asked):
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file, e.g. axis.X.moving_mass_kg")
    name = str(table.get("name", asked[0]))
    where = f"{where}: '{name}'"
    paths = tuple(dict.fromkeys(p for one in asked for p in matching_paths(one, machine, where)))
    relative = flag(table, "relative", where)
    if relative and (lacking := next((p for p in paths if number_at(machine, p) is None), None)):
        raise InputError(f"{where}: relative, but the machine lacks {lacking}; give absolute values or put the effect into its file")
    values = numbers(table.get("values", []), "values", where)
    limits = numbers(table.get("range", []), "range", where)
    if limits and (len(limits) != 2 or limits[0] >= limits[1]):
        raise InputError(f"{where}: range = {list(limits)}; give [low, high] with low below high")
    if values and limits:
        raise InputError(f"{where}: has both values and a range; give one of them")
    if listed is not None:
        return Factor(name, paths, relative, numbers(list(listed), "rows", where), None)
    if not values and not limits:
        raise InputError(f"{where}: has neither values nor a range; give values = [..] or range = [low, high]")
    if not limits and len(set(values)) < 2:
        raise InputError(f"{where}: has only one value; give two or more, or put it under [fixed]")
    return Factor(name, paths, relative, values, (limits[0], limits[1]) if limits else None)


def catalogue_factor_of(table: Mapping[str, Any], machine: Machine, path: Path, where: str) -> Factor:
    """A factor that chooses between entries of a catalogue beside the study file `path`, for some axes."""
    known_table(table, ("name", "catalogue", "axis", "axes", "installed", "values"), where)
    names = table.get("axes", [table["axis"]] if "axis" in table else [])
    if not isinstance(names, list) or not names:
        raise InputError(f"{where}: 'axis' is missing; name the axis, e.g. axis = \"X\"")
    if (wrong := next((name for name in names if name not in machine.axis_names), None)) is not None:
        raise InputError(f"{where}: no axis {wrong!r}; {nearest(str(wrong), machine.axis_names)}")
    values, installed = table.get("values", []), table.get("installed")
    if not isinstance(values, list) or not all(isinstance(v, str) for v in values):
        raise InputError(f"{where}: values = {values!r}; give names from the catalogue, or omit the key for all entries")
    if not isinstance(installed, str):
        raise InputError(f"{where}: 'installed' is missing; name the catalogue entry that the machine has now")
    choices = choices_of(
        outer_file(table["catalogue"], path.parent, f"{where}: catalogue"), [machine.axis(name) for name in names], installed, values, where
    )
    paths = dict.fromkeys(p for c in choices for p, _ in (*c.values, *c.added_inertia))
    name = str(table.get("name", f"{Path(str(table['catalogue'])).stem} of {' '.join(names)}"))
    return Factor(name, tuple(paths), False, tuple(float(i) for i in range(len(choices))), None, choices, installed)


def check_apart(factors: Sequence[Factor], path: Path) -> None:
    """Refuse two factors that set the same number; only the inertias of a motor and a screw add up."""
    for factor in factors:
        own = {p for choice in factor.choices for p, _ in choice.values}
        for other in factors:
            both = set(other.paths) & (own if other.choices else set(factor.paths) if factor.choices else set())
            if other is not factor and both:
                raise InputError(f"{path}: factors '{factor.name}' and '{other.name}' both set {min(both)}; leave one of them out")


def tied_of(table: Any, factors: Sequence[Factor], machine: Machine, where: str) -> Tied:
    """Numbers tied to a factor or to the inertia at a motor."""
    known_table(table, ("path", "to", "exponent", "slope"), where)
    names = [f.name for f in factors]
    to = str(table.get("to"))
    inertias = [f"{INERTIA}{axis}" for axis in machine.axis_names]
    if to not in (*names, *inertias):
        raise InputError(f"{where}: to = {table.get('to')!r}; {nearest(to, (*names, *inertias))}")
    if "path" not in table:
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file")
    paths = tuple(matching_paths(str(table["path"]), machine, where))
    if "slope" in table and ("exponent" in table or to in inertias):
        raise InputError(f"{where}: slope needs a factor and excludes exponent; give one of them")
    exponent, *slope = numbers([table.get("exponent", 1.0), *([table["slope"]] if "slope" in table else [])], "exponent, slope", where)
    factor = next((f for f in factors if f.name == to), None)
    if factor and factor.choices:
        raise InputError(
            f"{where}: to = {to!r} is a catalogue choice, which has no ratio; tie it to {INERTIA}AXIS, or give the number under [fixed]"
        )
    if factor and not factor.relative and not slope and number_at(machine, factor.paths[0]) == 0.0:
        raise InputError(f"{where}: {factor.paths[0]} is 0 on the present machine, so it has no ratio; give a slope")
    lacking = [p for p in (*paths, *(factor.paths if factor and not factor.relative else ())) if number_at(machine, p) is None]
    if lacking:
        raise InputError(f"{where}: the machine lacks {lacking[0]}, so it has no nominal value to scale; give it under [fixed]")
    return Tied(paths, to, exponent, slope[0] if slope else None)
