"""Factors of a study (numbers of the machine or catalogue entries) and the numbers tied to them, read from tables and checked."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from twin.documents import named_file
from twin.errors import InputError, nearest
from twin.machine.machine import Machine
from twin.study.catalogue import Choice, choices_of
from twin.study.paths import INERTIA, matching_paths, number_at, unit_at
from twin.tables import Number, Table, Text, asks

READ_IN = {"m": ("mm", 1e3), "m/rev": ("mm/rev", 1e3), "s": ("ms", 1e3), "H": ("mH", 1e3)}
"""Unit of a machine file -> people's unit, and the factor."""


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

    @property
    def read_in(self) -> tuple[str, float]:
        """People's unit of its values, and the factor to it: 'mm/rev', 1000; ('', 1) for catalogue entries and numbers without a unit."""
        if self.choices:
            return "", 1.0
        unit = "times nominal" if self.relative else unit_at(self.paths[0])
        return READ_IN.get(unit, (unit, 1.0))

    @property
    def unit(self) -> str:
        """People's unit of its values: 'kg', 'mm/rev', 'times nominal'."""
        return self.read_in[0]

    def shown(self, value: float) -> str:
        """A value as text: the name of a choice, otherwise the number in `unit`."""
        return self.choices[round(value)].name if self.choices else f"{value * self.read_in[1]:.4g}"

    @property
    def titled(self) -> str:
        """Name and unit for tables and plots."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def value_text(self, value: float) -> str:
        """A value with its unit: '850 kg', '0.7 times nominal', or the name of a catalogue entry."""
        return f"{self.shown(value)} {self.unit}".rstrip()


@dataclass(frozen=True)
class Tied:
    """Paths that follow a factor or `inertia.AXIS`: nominal x ratio^exponent, or nominal + slope x change of the factor's number."""

    paths: tuple[str, ...]
    to: str
    exponent: float
    slope: float | None


class FactorTable(Table, frozen=True):
    """[[factor]]: a number of the machine file, or a choice between entries of a catalogue."""

    name: Text | None = None
    path: str | None = None
    paths: tuple[str, ...] = ()
    relative: bool = False
    values: Annotated[tuple[Number | str, ...], asks("give a list of numbers, or of names from the catalogue")] = ()
    range: Annotated[tuple[Number, Number], asks("give a list of numbers: [low, high]")] | None = None
    catalogue: str | None = None
    axis: str | None = None
    axes: tuple[str, ...] = ()
    installed: str | None = None


class TiedTable(Table, frozen=True):
    """[[tied]]."""

    path: Annotated[str, asks("name a number of the machine file")]
    to: str
    exponent: Number | None = None
    slope: Number | None = None


def factor_of(table: FactorTable, listed: Sequence[Any] | None, machine: Machine, where: str) -> Factor:
    """A factor for a number of the machine file; `listed` are its values in a design of kind list, otherwise None."""
    asked = table.paths or ((table.path,) if table.path else ())
    if not asked:
        raise InputError(f"{where}: 'path' is missing; name a number of the machine file, e.g. axis.X.moving_mass_kg")
    name = table.name or asked[0]
    where = f"{where}: '{name}'"
    paths = tuple(dict.fromkeys(p for one in asked for p in matching_paths(one, machine, where)))
    if table.relative and (lacking := next((p for p in paths if number_at(machine, p) is None), None)):
        raise InputError(f"{where}: relative, but the machine lacks {lacking}; give absolute values or put the effect into its file")
    values = _numbers(table.values, "values", where)
    if table.range and not table.range[0] < table.range[1]:
        raise InputError(f"{where}: range = {list(table.range)}; give [low, high] with low below high")
    if values and table.range:
        raise InputError(f"{where}: has both values and a range; give one of them")
    if listed is not None:
        return Factor(name, paths, table.relative, _numbers(listed, "rows", where), None)
    if not values and not table.range:
        raise InputError(f"{where}: has neither values nor a range; give values = [..] or range = [low, high]")
    if not table.range and len(set(values)) < 2:
        raise InputError(f"{where}: has only one value; give two or more, or put it under [fixed]")
    return Factor(name, paths, table.relative, values, table.range)


def _numbers(values: Sequence[Any], what: str, where: str) -> tuple[float, ...]:
    if wrong := [value for value in values if isinstance(value, str)]:
        raise InputError(f"{where}: {what} holds {wrong[0]!r}; give a list of numbers")
    return tuple(map(float, values))


def catalogue_factor_of(table: FactorTable, machine: Machine, path: Path, where: str) -> Factor:
    """A factor that chooses between entries of a catalogue beside the study file `path`, for some axes."""
    names = table.axes or ((table.axis,) if table.axis else ())
    if not names:
        raise InputError(f"{where}: 'axis' is missing; name the axis, e.g. axis = \"X\"")
    if table.installed is None:
        raise InputError(f"{where}: 'installed' is missing; name the catalogue entry that the machine has now")
    if (wrong := next((value for value in table.values if not isinstance(value, str)), None)) is not None:
        raise InputError(f"{where}: values holds {wrong!r}; give names from the catalogue, or omit the key for all entries")
    catalogue = named_file(table.catalogue, path.parent, f"{where}: catalogue", outer=True)
    choices = choices_of(catalogue, [machine.axis(name) for name in names], table.installed, [str(v) for v in table.values], where)
    paths = dict.fromkeys(p for c in choices for p, _ in (*c.values, *c.added_inertia))
    name = table.name or f"{catalogue.stem} of {' '.join(names)}"
    return Factor(name, tuple(paths), False, tuple(float(i) for i in range(len(choices))), None, choices, table.installed)


def check_apart(factors: Sequence[Factor], path: Path) -> None:
    """Refuse two factors that set the same number; only the inertias of a motor and a screw add up."""
    for factor in factors:
        own = {p for choice in factor.choices for p, _ in choice.values}
        for other in factors:
            both = set(other.paths) & (own if other.choices else set(factor.paths) if factor.choices else set())
            if other is not factor and both:
                raise InputError(f"{path}: factors '{factor.name}' and '{other.name}' both set {min(both)}; leave one of them out")


def tied_of(table: TiedTable, factors: Sequence[Factor], machine: Machine, where: str) -> Tied:
    """Numbers tied to a factor or to the inertia at a motor."""
    names = [f.name for f in factors]
    inertias = [f"{INERTIA}{axis}" for axis in machine.axis_names]
    if table.to not in (*names, *inertias):
        raise InputError(f"{where}: to = {table.to!r}; {nearest(table.to, (*names, *inertias))}")
    paths = tuple(matching_paths(table.path, machine, where))
    if table.slope is not None and (table.exponent is not None or table.to in inertias):
        raise InputError(f"{where}: slope needs a factor and excludes exponent; give one of them")
    factor = next((f for f in factors if f.name == table.to), None)
    if factor and factor.choices:
        raise InputError(
            f"{where}: to = {table.to!r} is a catalogue choice, which has no ratio; tie it to {INERTIA}AXIS, or give the number under [fixed]"
        )
    if factor and not factor.relative and table.slope is None and number_at(machine, factor.paths[0]) == 0.0:
        raise InputError(f"{where}: {factor.paths[0]} is 0 on the present machine, so it has no ratio; give a slope")
    lacking = [p for p in (*paths, *(factor.paths if factor and not factor.relative else ())) if number_at(machine, p) is None]
    if lacking:
        raise InputError(f"{where}: the machine lacks {lacking[0]}, so it has no nominal value to scale; give it under [fixed]")
    return Tied(paths, table.to, 1.0 if table.exponent is None else table.exponent, table.slope)
