"""What an effect is: one named thing that a machine may have beyond the nominal model.

A unit is one function under `@effect(...)`: its docstring holds the law and its source, the decorator the block it lives
in, its parameters with units and bounds, and the axes that can have it. The function describes how it acts on a `Change`:
a changed control or machine parameter, a term of the compiled loop, or an edit of the MuJoCo model. Writing the function
is all it takes to add an effect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import inspect
import math
from typing import Any

from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine

BLOCKS = ("position controller", "speed controller", "current loop", "mechanics", "transmission", "measurement")

# unit of a quantity at a linear and at a rotary axis
QUANTITIES = {
    "length": ("m", "rad"),
    "speed": ("m/s", "rad/s"),
    "force": ("N", "Nm"),
    "mass": ("kg", "kg m2"),
    "stiffness": ("N/m", "Nm/rad"),
    "damping": ("N s/m", "Nm s/rad"),
    "number": ("1", "1"),
    "time": ("s", "s"),
    "frequency": ("Hz", "Hz"),
    "current": ("A", "A"),
    "torque": ("Nm", "Nm"),
    "angle": ("rad", "rad"),
    "metre": ("m", "m"),
    "kilogram": ("kg", "kg"),
}

Usual = Callable[[Machine, Axis], tuple[float, float]]
"""The range of sizes that is found on machines of this class, as a function of machine and axis."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, SI.

    `low`, `high` are the bounds that are accepted; `usual` the range that is found; `default` is for parameters that only
    shape the effect (None: must be given, unless the unit computes it); `shape` ones are not what the effect is about;
    `neutral` is the value at which the effect is nil; `logarithmic` says that sizes are compared by ratio;
    `periodic` is an angle; `fitted` gives the start of a shape that a fit should find, from the other values.
    """

    name: str
    quantity: str
    low: float = -math.inf
    high: float = math.inf
    usual: Usual | tuple[float, float] | None = None
    default: float | None = None
    shape: bool = False
    neutral: float | None = None
    logarithmic: bool = False
    periodic: bool = False
    fitted: Callable[[Machine, Axis, Mapping[str, float]], float] | None = None

    def unit(self, axis: Axis) -> str:
        """Unit at this axis."""
        if self.quantity == "current":
            return axis.effort_unit
        return QUANTITIES[self.quantity][0 if axis.kind == "linear" else 1]

    def usual_range(self, machine: Machine, axis: Axis) -> tuple[float, float]:
        """Usual sizes on this axis; the bounds where nothing else is known."""
        if self.usual is None:
            return (self.low, self.high)
        return self.usual(machine, axis) if callable(self.usual) else self.usual


@dataclass(frozen=True)
class Effect:
    """A unit of the library; `act(change, axis, **parameters)` puts it on the machine."""

    name: str
    block: str
    summary: str
    parameters: tuple[Parameter, ...]
    act: Callable[..., None]
    can_have: Callable[[Machine, Axis], bool]
    which_axes: str
    from_axis: bool = False
    edits_bodies: bool = False

    @property
    def law(self) -> str:
        """The unit's docstring."""
        return inspect.getdoc(self.act) or ""

    def axes(self, machine: Machine) -> tuple[Axis, ...]:
        """The axes of a machine that can have this effect."""
        return tuple(axis for axis in machine.axes if self.can_have(machine, axis))

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name, or an InputError with the nearest one."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InputError(f"effect {self.name}: no parameter '{name}'; {nearest(name, [p.name for p in self.parameters])}")


EFFECTS: dict[str, Effect] = {}
"""All effects by name, filled by the units themselves."""

AXIS_RULES: dict[str, tuple[str, Callable[[Machine, Axis], bool]]] = {
    "all": ("any axis", lambda machine, axis: True),
    "linear": ("linear axes", lambda machine, axis: axis.kind == "linear"),
    "integral": ("axes whose speed controller has an integral part", lambda machine, axis: axis.has_speed_integral),
    "turning motor": ("axes with a screw or a gear", lambda machine, axis: axis.kind == "rotary" or axis.ratio != 1.0),
    "transmission": ("axes with a rotor of their own behind a screw or a gear", lambda machine, axis: axis.rotor_inertia_kg_m2 > 0.0),
    "scale": ("axes with a measuring system at the load", lambda machine, axis: axis.encoder == "scale"),
    "full turn": (
        "rotary axes that turn fully round",
        lambda machine, axis: axis.kind == "rotary" and axis.travel[1] - axis.travel[0] > 6.28,
    ),
    "tilting": (
        "the rotary axis that tilts the table",
        lambda machine, axis: (
            axis.kind == "rotary" and axis == next(a for a in machine.axes if a.kind == "rotary") and len(_rotary(machine)) > 1
        ),
    ),
}


def _rotary(machine: Machine) -> list[Axis]:
    return [axis for axis in machine.axes if axis.kind == "rotary"]


def effect(
    *, block: str, parameters: tuple[Parameter, ...], axes: str = "all", from_axis: bool = False, edits_bodies: bool = False
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a unit under its function's name; the first line of its docstring is the one-line description."""
    assert block in BLOCKS

    def register(act: Callable[..., None]) -> Callable[..., None]:
        which, can_have = AXIS_RULES[axes]
        summary = (inspect.getdoc(act) or "").split("\n", 1)[0].rstrip(".")
        EFFECTS[act.__name__] = Effect(act.__name__, block, summary, parameters, act, can_have, which, from_axis, edits_bodies)
        return act

    return register


@dataclass(frozen=True)
class Setting:
    """An effect on an axis with checked parameters: one `[[effect]]` table."""

    effect: Effect
    axis: str
    parameters: Mapping[str, float]
    from_axis: str | None = None

    @property
    def key(self) -> tuple[str, str, str | None]:
        """Effect, axis and from_axis: what a machine can have once."""
        return self.effect.name, self.axis, self.from_axis

    def table(self) -> dict[str, Any]:
        """As it stands in a machine file."""
        source = {"from_axis": self.from_axis} if self.from_axis else {}
        return {"name": self.effect.name, "axis": self.axis, **source, **self.parameters}

    @property
    def is_nil(self) -> bool:
        """True where a parameter has the value at which the effect does nothing."""
        return any(p.neutral is not None and self.parameters.get(p.name) == p.neutral for p in self.effect.parameters)


def find_effect(name: str, where: str) -> Effect:
    """The effect of that name, or an InputError with the nearest one."""
    if not isinstance(name, str) or name not in EFFECTS:
        raise InputError(f"{where}: unknown effect '{name}'; {nearest(str(name), EFFECTS)}")
    return EFFECTS[name]


def check_setting(table: Mapping[str, Any], machine: Machine, where: str) -> Setting:
    """A Setting from a table {name, axis, parameters...}; every fault is an InputError."""
    if not isinstance(table, Mapping) or "name" not in table:
        raise InputError(f'{where}: an effect needs a name; write name = "backlash"')
    found = find_effect(table["name"], where)
    where = f"{where}: {found.name}"
    if "axis" not in table:
        raise InputError(f"{where}: 'axis' is missing; name one of {', '.join(machine.axis_names)}")
    if table["axis"] not in machine.axis_names:
        raise InputError(f"{where}: no axis {table['axis']!r}; {nearest(str(table['axis']), machine.axis_names)}")
    axis = machine.axis(table["axis"])
    if not found.can_have(machine, axis):
        able = ", ".join(a.name for a in found.axes(machine)) or "no axis of this machine"
        raise InputError(f"{where}: axis {axis.name} cannot have it: it is for {found.which_axes}; use {able}")
    from_axis = table.get("from_axis")
    if found.from_axis:
        able_names = [a.name for a in found.axes(machine) if a.name != axis.name]
        if from_axis not in able_names:
            told = "is missing" if from_axis is None else f"= {from_axis!r} cannot be"
            able = ", ".join(able_names) or "this machine has none"
            raise InputError(f"{where}: from_axis {told}; name another of the {found.which_axes}: {able}")
    elif from_axis is not None:
        raise InputError(f"{where}: has no from_axis; leave it out")
    values: dict[str, float] = {}
    for key, value in table.items():
        if key in ("name", "axis", "from_axis"):
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
    """The machine's `[[effect]]` tables, checked; the same effect twice on an axis is an error."""
    where = str(machine.path or machine.name)
    settings = tuple(check_setting(table, machine, f"{where}: effect {i + 1}") for i, table in enumerate(machine.effects))
    seen: set[tuple[str, str, str | None]] = set()
    for setting in settings:
        key = setting.key
        if key in seen:
            raise InputError(f"{where}: effect {setting.effect.name} stands twice on axis {setting.axis}; keep one")
        seen.add(key)
    return settings


def parse_setting(text: str, machine: Machine) -> Setting:
    """A Setting from the command line: 'backlash:X:clearance=15e-6,contact_stiffness=6e9'."""
    where = f"--effect {text}"
    parts = text.split(":", 2)
    if len(parts) < 2:
        raise InputError(f"{where}: write NAME:AXIS:PARAMETER=VALUE[,PARAMETER=VALUE], e.g. backlash:X:clearance=15e-6")
    table: dict[str, Any] = {"name": parts[0], "axis": parts[1]}
    for assignment in filter(None, (parts[2] if len(parts) > 2 else "").split(",")):
        key, equals, value = assignment.partition("=")
        if not equals:
            raise InputError(f"{where}: '{assignment}' is no PARAMETER=VALUE")
        if key.strip() in table:
            raise InputError(f"{where}: '{key.strip()}' stands twice; give it once")
        try:
            table[key.strip()] = value.strip() if key.strip() == "from_axis" else float(value)
        except ValueError:
            raise InputError(f"{where}: {key} = '{value}' is no number") from None
    return check_setting(table, machine, where)
