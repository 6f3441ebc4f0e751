"""What an effect is: one named thing that a machine may have beyond the nominal model.

An effect is one function under `@effect(...)`. Its docstring holds the law and its source. The decorator holds everything
else that the twin knows about it: block, parameters with units and bounds, axes, how a diagnosis starts and judges it, its
units for people, what separates it from its rivals, its picture. The function describes how it acts on a `Change`: a changed
parameter of control or machine, a term of the compiled loop, or an edit of the MuJoCo model. Nothing else has to be written
for a new effect: every field but block and parameters has a default that suits one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import inspect
import math
from typing import Any, Literal

from twin.effects.picture import Picture
from twin.effects.scan import Scan
from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine

BLOCKS = ("position controller", "speed controller", "current loop", "mechanics", "transmission", "measurement")

# unit of a quantity at a linear and at a rotary axis
QUANTITIES = {
    "factor": ("1", "1"),
    "length": ("m", "rad"),
    "speed": ("m/s", "rad/s"),
    "force": ("N", "Nm"),
    "mass": ("kg", "kg m2"),
    "stiffness": ("N/m", "Nm/rad"),
    "damping": ("N s/m", "Nm s/rad"),
    "number": ("1", "1"),
    "acceleration": ("m/s2", "rad/s2"),
    "time": ("s", "s"),
    "frequency": ("Hz", "Hz"),
    "current": ("A", "A"),
    "voltage": ("V", "V"),
    "torque": ("Nm", "Nm"),
    "angle": ("rad", "rad"),
    "metre": ("m", "m"),
    "kilogram": ("kg", "kg"),
}

PERCENT = {"1": ("%", 100.0)}
DEGREES = {"rad": ("deg", math.degrees(1.0))}
"""Units for people that parameters share: SI unit -> (unit, factor)."""

Usual = Callable[[Machine, Axis], tuple[float, float]]
"""The range of sizes that is found on machines of this class, as a function of machine and axis."""

AN_ACCELERATION = Picture()

SeparatingMove = Literal["micro-reversals", "constant speeds", "accelerations", "chirp", "rest"]
"""Moves that a diagnosis can propose as the next measurement."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, SI.

    name, quantity     its name and what it is; `QUANTITIES` gives the unit. A "factor" multiplies a parameter of the machine
    low, high          bounds that are accepted
    usual              range that is found on machines; the bounds where nothing else is known
    default            value of a parameter that only shapes the effect (None: must be given, unless the effect computes it)
    shape              True for a parameter that is not what the effect is about; it is not scored
    neutral            value at which the effect does nothing. The first parameter with one is the effect's size
    logarithmic        sizes are compared by ratio
    periodic           an angle
    fitted             start of a shape that a fit should find, from the values of the others

    How a diagnosis starts it:
    multiplies         field of the axis, its motor or its loops that a factor multiplies
    starts             number of sizes that are simulated as starts; 2 of a range around neutral are one on either side
    bends              what the effect does is not in proportion to its size: a single start may underrate it
    scan               how start values are read from the residual, instead of from the usual range
    lag_cycle          for the time constant of a sampled lag: the field of the machine with the cycle c at which it is sampled.
                       It delays by c / (exp(c / T) - 1), next to nothing below half a cycle

    When a diagnosis believes its size:
    beyond_tolerance   multiple of the machine's parameter tolerance from which a deviation is an effect
    part_of            what the tolerance is a share of, for a size that is no factor [its unit]
    any_size           any size is believed, also one far outside the usual range
    judged_with        name of another parameter: the product of both is compared with the usual sizes

    shown              unit for people: SI unit -> (unit, factor); without an entry the usual one of that SI unit
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
    multiplies: str = ""
    starts: int = 1
    bends: bool = False
    scan: Scan | None = None
    lag_cycle: Literal["", "position_cycle", "speed_cycle", "current_cycle"] = ""
    beyond_tolerance: float = 0.0
    part_of: Callable[[Machine, Axis], float] | None = None
    any_size: bool = False
    judged_with: str = ""
    shown: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def unit(self, axis: Axis) -> str:
        """Unit at this axis."""
        if self.quantity == "current":
            return axis.effort_unit
        return QUANTITIES[self.quantity][0 if axis.kind == "linear" else 1]

    def usual_range(self, machine: Machine, axis: Axis) -> tuple[float, float]:
        """Usual sizes on this axis, within the bounds; the bounds where nothing else is known."""
        if self.usual is None:
            return (self.low, self.high)
        low, high = self.usual(machine, axis) if callable(self.usual) else self.usual
        return (min(max(low, self.low), self.high), min(max(high, self.low), self.high))

    @property
    def is_factor(self) -> bool:
        """True where the value multiplies a parameter of the machine."""
        return self.quantity == "factor"

    @property
    def is_scaled(self) -> bool:
        """True where what the effect does is about in proportion to the deviation from neutral (not so for springs and limits)."""
        return self.neutral is not None and math.isfinite(self.neutral)

    @property
    def is_spring(self) -> bool:
        """True for a stiffness that is infinite on a rigid machine: the effect is about in proportion to 1 / stiffness."""
        return self.quantity == "stiffness" and self.neutral == math.inf

    def deviation(self, value: float) -> float:
        """Distance of a value from doing nothing; 1 for an angle."""
        if self.periodic:
            return 1.0
        return abs(value - (self.neutral or 0.0 if self.is_scaled else 0.0))


@dataclass(frozen=True)
class Effect:
    """An effect of the library or of a user's file; `act(change, axis, **parameters)` puts it on the machine.

    separating_move    move that separates it best from its nearest rivals: what a diagnosis proposes as the next measurement
    rivals             the same in words: what looks alike, and what parts them
    contains           names of effects that this one includes: they leave a machine that gets this one
    imitated_by        names of effects of which a little, normal on any machine, looks like a little of this one
    normal             name of a normal imperfection that this effect is a large case of: "elasticity" of a drive train,
                       "slip" of a contact before it breaks away
    picture            what its picture shows
    definition         of an effect that is made from its own table (`effect_from_table`): the entries that make it what it is
    """

    name: str
    block: str
    summary: str
    parameters: tuple[Parameter, ...]
    act: Callable[..., None]
    can_have: Callable[[Machine, Axis], bool]
    which_axes: str
    from_axis: bool = False
    edits_bodies: bool = False
    separating_move: SeparatingMove = "constant speeds"
    rivals: str = ""
    contains: tuple[str, ...] = ()
    imitated_by: tuple[str, ...] = ()
    normal: Literal["", "elasticity", "slip"] = ""
    picture: Picture = AN_ACCELERATION
    definition: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """What a machine can have once on an axis: its name, and of one made from its table also what makes it what it is."""
        return " ".join([self.name, *(f"{k}={v}" for k, v in self.definition.items() if k != "points")])

    @property
    def law(self) -> str:
        """The function's docstring."""
        return inspect.getdoc(self.act) or ""

    @property
    def size(self) -> Parameter:
        """The parameter that says how large the effect is: the first with a neutral value, one that is no shape if there is one."""
        sizes = [p for p in self.parameters if p.neutral is not None]
        return next((p for p in sizes if not p.shape), sizes[0])

    @property
    def phase(self) -> Parameter | None:
        """The angle that shapes a wave: such an effect is a sum of a sine and a cosine."""
        return next((p for p in self.parameters if p.periodic and p.shape), None)

    @property
    def is_linear(self) -> bool:
        """True where what it does is about in proportion to its size."""
        return self.size.is_scaled and not self.size.bends

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
"""All effects by name. The decorator fills it."""

FROM_TABLE: dict[str, Callable[[Mapping[str, Any], str], Effect]] = {}
"""Effects that are made from their own `[[effect]]` table: name -> function of the table and of the place for messages.

They have no usual size and no start: a diagnosis does not search them among the effects of the library.
"""

AXIS_RULES: dict[str, tuple[str, Callable[[Machine, Axis], bool]]] = {
    "all": ("any axis", lambda machine, axis: True),
    "linear": ("linear axes", lambda machine, axis: axis.kind == "linear"),
    "rotary": ("rotary axes", lambda machine, axis: axis.kind == "rotary"),
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
    *,
    block: str,
    parameters: tuple[Parameter, ...],
    axes: str = "all",
    from_axis: bool = False,
    edits_bodies: bool = False,
    separating_move: SeparatingMove = "constant speeds",
    rivals: str = "",
    contains: tuple[str, ...] = (),
    imitated_by: tuple[str, ...] = (),
    normal: Literal["", "elasticity", "slip"] = "",
    picture: Picture = AN_ACCELERATION,
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a function as an effect under its own name; the first line of its docstring is the one-line description.

    `axes` is a key of `AXIS_RULES`; the other arguments are the fields of `Effect`. Raises InputError where they do not fit.
    """

    def register(act: Callable[..., None]) -> Callable[..., None]:
        name = act.__name__
        _check(name, block, parameters, axes)
        which, can_have = AXIS_RULES[axes]
        summary = (inspect.getdoc(act) or "").split("\n", 1)[0].rstrip(".")
        EFFECTS[name] = Effect(
            name,
            block,
            summary,
            parameters,
            act,
            can_have,
            which,
            from_axis,
            edits_bodies,
            separating_move,
            rivals,
            contains,
            imitated_by,
            normal,
            picture,
        )
        return act

    return register


def _check(name: str, block: str, parameters: tuple[Parameter, ...], axes: str) -> None:
    """Refuse an effect that the twin could not use, in one line."""
    where = f"effect {name}"
    if name in EFFECTS:
        raise InputError(f"{where}: the twin has an effect of that name already; give it another name")
    if block not in BLOCKS:
        raise InputError(f"{where}: no block '{block}'; {nearest(block, BLOCKS)}")
    if axes not in AXIS_RULES:
        raise InputError(f"{where}: no rule '{axes}' for axes; {nearest(axes, AXIS_RULES)}")
    for p in parameters:
        if p.quantity not in QUANTITIES:
            raise InputError(f"{where}: parameter {p.name}: no quantity '{p.quantity}'; {nearest(p.quantity, QUANTITIES)}")
        if p.name in ("name", "axis", "from_axis"):
            raise InputError(f"{where}: a parameter cannot be called '{p.name}'; give it another name")
    if all(p.neutral is None for p in parameters):
        raise InputError(f"{where}: no parameter has a neutral value; say at which value of its size it does nothing")


def find_effect(name: str, where: str) -> Effect:
    """The effect of that name, or an InputError with the nearest one."""
    if not isinstance(name, str) or name not in EFFECTS:
        raise InputError(f"{where}: unknown effect '{name}'; {nearest(str(name), EFFECTS)}; for one of your own give --effects FILE")
    return EFFECTS[name]
