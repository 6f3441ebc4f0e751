"""An effect on an axis with checked parameters: one `[[effect]]` table of a machine file, or one `--effect`."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
import re
from typing import Any

from twin.effects.effect import FROM_TABLE, Effect, find_effect
from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import parameter
from twin.units import RECORDED_UNITS, dimension_recorded

Key = tuple[str, str, str | None]
"""Effect, axis, and the axis that drives the effect (or None)."""


@dataclass(frozen=True)
class Setting:
    """An effect on an axis with checked parameters; `from_axis` is the source axis, if the effect has one."""

    effect: Effect
    axis: str
    parameters: Mapping[str, float]
    from_axis: str | None = None

    @property
    def key(self) -> Key:
        """Effect, axis and from_axis; unique in a machine."""
        return self.effect.key, self.axis, self.from_axis

    def table(self) -> dict[str, Any]:
        """The `[[effect]]` table of a machine file."""
        source = {"from_axis": self.from_axis} if self.from_axis else {}
        return {"name": self.effect.name, "axis": self.axis, **source, **self.effect.definition, **self.parameters}

    def factor_on(self, field: str) -> float:
        """Factor of the effect on a field of the axis, its motor or its loops; 1 without influence."""
        return math.prod(self.parameters[p.name] for p in self.effect.parameters if p.multiplies == field and p.name in self.parameters)

    def paths(self, machine: Machine) -> list[str]:
        """Paths in the machine file of the numbers that the effect changes or acts like."""
        fields = {*self.effect.sets, *(p.multiplies for p in self.effect.parameters if p.multiplies)}
        return [path for field in sorted(fields) if (path := self.path_of(field, machine))]

    def path_of(self, field: str, machine: Machine) -> str:
        """Path in the machine file of a field of the axis, its motor or its loops; "" without one."""
        axis = machine.axis(self.axis)
        key = parameter(field).key(axis.drive if axis.drive != "direct" else "screw")
        return machine.in_file(f"axis.{self.axis}.{key}", 0.0)[0] if key else ""

    @property
    def size(self) -> float:
        """Value of the effect's size parameter."""
        return self.parameters[self.effect.size.name]

    @property
    def is_nil(self) -> bool:
        """True if a parameter is neutral, so that the effect does nothing."""
        return any(p.neutral is not None and self.parameters.get(p.name) == p.neutral for p in self.effect.parameters)


def key_in(entry: Mapping[str, Any]) -> Key:
    """The key of the effect of an entry of a document, which names it as `Setting.key` does."""
    return entry["effect"], entry["axis"], entry.get("from_axis")


def check_setting(table: Mapping[str, Any], machine: Machine, where: str) -> Setting:
    """A Setting from a table {name, axis, parameters...}. Raises InputError for an invalid table."""
    if not isinstance(table, Mapping) or "name" not in table:
        raise InputError(f'{where}: an effect needs a name; write name = "backlash"')
    made = FROM_TABLE.get(table["name"]) if isinstance(table["name"], str) else None
    found = made(table, where) if made else find_effect(table["name"], where)
    where = f"{where}: {found.name}"
    if "axis" not in table:
        raise InputError(f"{where}: 'axis' is missing; give one of {', '.join(machine.axis_names)}")
    axis = _axis_of(table, machine, where)
    if not found.can_have(machine, axis):
        able = ", ".join(a.name for a in found.axes(machine)) or "no axis of this machine"
        raise InputError(f"{where}: axis {axis.name} cannot have it: it is for {found.which_axes}; use {able}")
    from_axis = table.get("from_axis")
    if found.from_axis:
        sources = found.sources(machine, axis.name)
        if from_axis not in sources:
            fault = "is missing" if from_axis is None else f"= {from_axis!r} cannot be"
            able = ", ".join(map(str, sources)) or "this machine has none"
            raise InputError(f"{where}: from_axis {fault}; name another of the {found.which_axes}: {able}")
    elif from_axis is not None:
        raise InputError(f"{where}: has no from_axis; leave it out")
    values: dict[str, float] = {}
    for key, value in table.items():
        if key in ("name", "axis", "from_axis") or key in found.definition:
            continue
        parameter = found.parameter(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise InputError(f"{where}: {key} = {value!r}: expected a number in {parameter.unit(axis)}")
        if not parameter.low <= value <= parameter.high and value != parameter.neutral:
            raise InputError(
                f"{where}: {key} = {value:g} {parameter.unit(axis)} is out of bounds; give {parameter.low:g} to {parameter.high:g} {parameter.unit(axis)}"
            )
        values[key] = float(value)
    for parameter in found.parameters:
        if parameter.name not in values:
            if parameter.default is not None:
                values[parameter.name] = parameter.default
            elif not parameter.shape:
                raise InputError(f"{where}: '{parameter.name}' is missing; give it in {parameter.unit(axis)}")
    return Setting(found, axis.name, values, from_axis)


def settings_of(machine: Machine) -> tuple[Setting, ...]:
    """The checked `[[effect]]` tables of a machine, without those on or from axes that are not driven.

    They are checked once and kept with the machine. Raises InputError for an invalid table or a duplicate effect.
    """
    if "settings" not in machine.derived:
        machine.derived["settings"] = _checked(machine)
    settings: tuple[Setting, ...] = machine.derived["settings"]
    return settings


def _checked(machine: Machine) -> tuple[Setting, ...]:
    where = str(machine.path or machine.name)
    still = [name for name in machine.document["axis"] if name not in machine.axis_names]
    settings = tuple(
        check_setting(table, machine, f"{where}: effect {i + 1}")
        for i, table in enumerate(machine.effects)
        if not (isinstance(table, Mapping) and (table.get("axis") in still or table.get("from_axis") in still))
    )
    keys = [setting.key for setting in settings]
    for i, setting in enumerate(settings):
        if setting.key in keys[:i]:
            raise InputError(f"{where}: effect {setting.effect.name} is given twice on axis {setting.axis}; keep one")
    return settings


def _axis_of(table: Mapping[str, Any], machine: Machine, where: str) -> Axis:
    """The axis that a table names. Raises InputError if the machine has none of this name."""
    if table["axis"] not in machine.axis_names:
        raise InputError(f"{where}: no axis {table['axis']!r}; {nearest(str(table['axis']), machine.axis_names)}")
    return machine.axis(table["axis"])


def parse_setting(text: str, machine: Machine, option: str = "--effect") -> Setting:
    """A Setting from the command line: 'backlash:X:clearance=15e-6,contact_stiffness=6e9'; a value may have a unit (15um)."""
    where = f"{option} {text}"
    parts = text.split(":", 2)
    if len(parts) < 2:
        raise InputError(f"{where}: write NAME:AXIS:PARAMETER=VALUE[,PARAMETER=VALUE], e.g. backlash:X:clearance=15e-6")
    table: dict[str, Any] = {"name": parts[0], "axis": parts[1]}
    for assignment in filter(None, (parts[2] if len(parts) > 2 else "").split(",")):
        key, equals, value = assignment.partition("=")
        if not equals:
            raise InputError(f"{where}: '{assignment}' is not of the form PARAMETER=VALUE")
        if key.strip() in table:
            raise InputError(f"{where}: '{key.strip()}' is given twice; give it once")
        try:
            table[key.strip()] = value.strip() if key.strip() == "from_axis" else float(value)
        except ValueError:
            table[key.strip()] = _with_unit(value, key.strip(), table, machine, where)
    return check_setting(table, machine, where)


def _with_unit(text: str, key: str, table: Mapping[str, Any], machine: Machine, where: str) -> float:
    """A value with its unit, such as 20um, in the unit of the parameter (SI)."""
    given = re.fullmatch(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s].*?)\s*", text)
    if given is None:
        raise InputError(f"{where}: {key} = '{text}' is not a number")
    unit = given[2].replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
    effect = find_effect(table["name"], where)
    wanted = effect.parameter(key).unit(_axis_of(table, machine, where))
    alike = [u for u in RECORDED_UNITS if wanted in RECORDED_UNITS and dimension_recorded(u) == dimension_recorded(wanted)]
    if unit != wanted and unit not in alike:
        others = f" (or {', '.join(u for u in alike if u != wanted)})" if len(alike) > 1 else ""
        raise InputError(f"{where}: {key} = '{text}': give it in {wanted}{others}")
    return float(given[1]) * (1.0 if unit == wanted else RECORDED_UNITS[unit][1])
