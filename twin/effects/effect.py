"""Effects: named deviations of a machine from its nominal model.

An effect is one function under `@effect(...)`. Its docstring states the law and its source. The decorator states the rest: block,
parameters with units and bounds, axes, start values and plausibility for diagnosis, display units, rivals, picture. The function applies
the effect to a `Change`: it changes a parameter of control or machine, adds a term to the compiled loop, or edits the MuJoCo model. A new
effect needs nothing else; all fields except block and parameters have defaults.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
import inspect
import math
from typing import Any, Literal

from twin.control.structures import INTEGRAL
from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine

BLOCKS = ("position controller", "speed controller", "current loop", "mechanics", "transmission", "measurement")

# unit of a quantity on a linear and on a rotary axis
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
"""Common display units: SI unit -> (unit, factor)."""

Usual = Callable[[Machine, Axis], tuple[float, float]]
"""Usual range of a parameter as a function of machine and axis."""

Move = Literal["acceleration", "reversal", "slow", "constant speed", "gentle", "jerk", "micro", "chirp", "turn", "again"]
"""Moves of the pictures. An effect with a `from_axis` is shown on an axis at constant speed while `from_axis` accelerates."""


@dataclass(frozen=True)
class Picture:
    """The picture of an effect. All fields are optional; the default is an acceleration of the first axis.

    `look` is the caption. `sizes` default to the middle of the usual range. `axis` and `with_axes` are ignored on machines
    without them. The current is averaged over `smooth_s`, which removes the steps of the position cycle.
    """

    look: str = ""
    move: Move = "acceleration"
    axis: str = ""
    feedforward: str | None = None
    sizes: Mapping[str, float] = field(default_factory=dict)
    from_axis: str = ""
    with_axes: str = ""
    started_at: float = 0.0
    smooth_s: float = 0.002


AN_ACCELERATION = Picture()

Scan = Literal["", "turn", "travel", "time", "resonance", "largest current"]
"""How `twin.diagnose.start_values` reads start values from a residual: periods per motor turn of a sine over the motor angle; wavelength [m, rad] of a
sine over the travel that changes sign with the direction of motion, with phase zero at q = 0; frequency [Hz] of a sine in time; frequency of a
resonance that the acceleration excites; levels of a clipped current."""

USUAL_RUN_S = 15.0
"""Length of a run that the scale of a frequency assumes."""

SeparatingMove = Literal["micro-reversals", "constant speeds", "accelerations", "chirp", "rest"]
"""Moves that a diagnosis can propose as next measurement."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect, SI.

    name, quantity     name and quantity; `QUANTITIES` gives the unit. A "factor" multiplies a parameter of the machine
    low, high          accepted bounds
    usual              usual range on machines; defaults to the bounds
    default            default value (None: required, unless the effect computes it)
    shape              True for a parameter that shapes the effect and is not scored
    neutral            value without effect. The first parameter that has one is the size of the effect
    logarithmic        sizes are compared by ratio
    periodic           an angle
    fitted             start value of a fitted shape parameter as a function of the other values

    Start values of a diagnosis:
    multiplies         field of the axis, its motor or its loops that a factor multiplies
    starts             number of simulated start sizes; 2 for a range around neutral give one on each side
    bends              the response is not proportional to the size, so a single start may underestimate the effect
    scan               method that reads start values from the residual instead of the usual range
    lag_cycle          for the time constant T of a sampled first-order lag: machine field of its cycle c.
                       The lag delays by c / (exp(c / T) - 1), which is negligible below half a cycle

    Plausibility in a diagnosis:
    beyond_tolerance   largest normal deviation, in multiples of the machine's parameter tolerance; a larger one is an effect
    part_of            reference value of the tolerance for a size that is not a factor [its unit]
    normal_size        largest size that every machine may have [its unit]
    any_size           any size is plausible, even far outside the usual range
    judged_with        name of another parameter; the product of both is compared with the usual sizes

    shown              display unit: SI unit -> (unit, factor); defaults to the usual display unit of that SI unit
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
    scan: Scan = ""
    lag_cycle: Literal["", "position_cycle", "speed_cycle", "current_cycle"] = ""
    beyond_tolerance: float = 0.0
    part_of: Callable[[Machine, Axis], float] | None = None
    normal_size: Callable[[Machine, Axis], float] | None = None
    any_size: bool = False
    judged_with: str = ""
    shown: Mapping[str, tuple[str, float]] = field(default_factory=dict)

    def unit(self, axis: Axis) -> str:
        """Unit at this axis."""
        if self.quantity == "current":
            return axis.effort_unit
        return axis.unit(QUANTITIES[self.quantity][0 if axis.kind == "linear" else 1])

    def usual_range(self, machine: Machine, axis: Axis) -> tuple[float, float]:
        """Usual range on this axis, within the bounds; the bounds if none is given."""
        if self.usual is None:
            return (self.low, self.high)
        low, high = self.usual(machine, axis) if callable(self.usual) else self.usual
        return (min(max(low, self.low), self.high), min(max(high, self.low), self.high))

    @property
    def is_factor(self) -> bool:
        """True if the value multiplies a parameter of the machine."""
        return self.quantity == "factor"

    @property
    def is_scaled(self) -> bool:
        """True if the response is roughly proportional to the deviation from neutral; false for springs and limits."""
        return self.neutral is not None and math.isfinite(self.neutral)

    @property
    def is_spring(self) -> bool:
        """True for a stiffness that is infinite on a rigid machine: the response is roughly proportional to 1 / stiffness."""
        return self.quantity == "stiffness" and self.neutral == math.inf

    def waves(self, value: float, axis: Axis) -> float:
        """Number of waves of a sine over an axis' travel, at most one turn of a rotary axis, or over a run of usual length; 0 for another parameter."""
        reach = min(axis.travel[1] - axis.travel[0], 2.0 * math.pi if axis.kind == "rotary" else math.inf)
        if self.scan == "turn":
            return value * reach / (2.0 * math.pi * axis.ratio)
        if self.scan == "travel":
            return reach / max(value, 1e-9)
        return value * USUAL_RUN_S if self.scan == "time" else 0.0

    def deviation(self, value: float) -> float:
        """Distance of a value from neutral; 1 for an angle."""
        if self.periodic:
            return 1.0
        return abs(value - (self.neutral or 0.0 if self.is_scaled else 0.0))


def factor_of(number: str, low: float, high: float, usual: tuple[float, float], **more: Any) -> Parameter:
    """The factor of an effect that multiplies a number of the axis, its motor or its loops."""
    return Parameter("factor", "factor", low, high, usual, neutral=1.0, logarithmic=True, multiplies=number, **more)


@dataclass(frozen=True)
class Effect:
    """An effect of the library or of a user's file; `act(change, axis, **parameters)` applies it to the machine.

    separating_move    move that separates it best from its rivals; a diagnosis proposes it as next measurement
    rivals             similar effects, and how to distinguish them, in words
    contains           names of effects that this one includes; a machine that gets this one loses them
    normal             normal imperfection that this effect is a large case of: "elasticity" of a drive train,
                       "slip" of a contact before break-away
    picture            content of its picture
    definition         defining entries of an effect that is made from its own table (`FROM_TABLE`)
    sets               fields of the axis or its loops, or 'block.NAME.NUMBER', that it changes or acts like, besides those that its factors multiply
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
    normal: Literal["", "elasticity", "slip"] = ""
    picture: Picture = AN_ACCELERATION
    definition: Mapping[str, Any] = field(default_factory=dict)
    sets: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Identity of the effect on an axis: its name, and the definition of an effect made from its own table."""
        return " ".join([self.name, *(f"{k}={v}" for k, v in self.definition.items() if k != "points")])

    @property
    def block_of_control(self) -> str:
        """The block of the control whose strength it is; '' for another effect."""
        number = self.size.multiplies
        return number.split(".")[1] if number.startswith("block.") else ""

    @property
    def law(self) -> str:
        """The function's docstring."""
        return inspect.getdoc(self.act) or ""

    @property
    def size(self) -> Parameter:
        """The size parameter: the first with a neutral value, preferably one that is not a shape."""
        sizes = [p for p in self.parameters if p.neutral is not None]
        return next((p for p in sizes if not p.shape), sizes[0])

    @property
    def phase(self) -> Parameter | None:
        """The phase angle of a sinusoidal effect, which is a sum of a sine and a cosine."""
        return next((p for p in self.parameters if p.periodic and p.shape), None)

    @property
    def is_linear(self) -> bool:
        """True if the response is roughly proportional to the size."""
        return self.size.is_scaled and not self.size.bends

    def axes(self, machine: Machine) -> tuple[Axis, ...]:
        """The axes of a machine that can have this effect."""
        return tuple(axis for axis in machine.axes if self.can_have(machine, axis))

    def sources(self, machine: Machine, axis: str) -> list[str | None]:
        """What `from_axis` may be on an axis: others that can have the effect, None for an effect without one; empty if the axis cannot have it."""
        able = [a.name for a in self.axes(machine)]
        return [] if axis not in able else [name for name in able if name != axis] if self.from_axis else [None]

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name, or an InputError with the nearest one."""
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise InputError(f"effect {self.name}: no parameter '{name}'; {nearest(name, [p.name for p in self.parameters])}")


EFFECTS: dict[str, Effect] = {}
"""All effects by name. The decorator fills it."""

FROM_TABLE: dict[str, Callable[[Mapping[str, Any], str], Effect]] = {}
"""Effects made from their own `[[effect]]` table: name -> function of the table and of a location for error messages.

They have no usual size and no start values, so a diagnosis does not search them among the effects of the library.
"""

AXIS_RULES: dict[str, tuple[str, Callable[[Machine, Axis], bool]]] = {
    "all": ("any axis", lambda machine, axis: True),
    "linear": ("linear axes", lambda machine, axis: axis.kind == "linear"),
    "rotary": ("rotary axes", lambda machine, axis: axis.kind == "rotary"),
    "integral": ("axes whose speed controller has an integral part", lambda machine, axis: axis.loops.has(INTEGRAL)),
    "turning motor": ("axes with a screw or a gear", lambda machine, axis: axis.drive != "direct"),
    "transmission": ("axes with a rotor of their own behind a screw or a gear", lambda machine, axis: axis.rotor_inertia_kg_m2 > 0.0),
    "scale": ("axes with a measuring system at the load", lambda machine, axis: axis.encoder == "scale"),
    "full turn": (
        "rotary axes that turn fully round",
        lambda machine, axis: axis.kind == "rotary" and axis.travel[1] - axis.travel[0] > 6.28,
    ),
    "tilting": (
        "the rotary axis that tilts the table",
        lambda machine, axis: (rotary := [a for a in machine.axes if a.kind == "rotary"])[:1] == [axis] and len(rotary) > 1,
    ),
}


def effect(
    *, block: str, parameters: tuple[Parameter, ...], axes: str = "all", **fields: Any
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Register a function as an effect under its name; the first line of its docstring is the summary.

    `axes` is a key of `AXIS_RULES`; `fields` are further fields of `Effect`. Raises InputError for invalid arguments.
    """

    def register(act: Callable[..., None]) -> Callable[..., None]:
        name = act.__name__
        _check(name, block, parameters, axes)
        which, can_have = AXIS_RULES[axes]
        summary = (inspect.getdoc(act) or "").split("\n", 1)[0].rstrip(".")
        EFFECTS[name] = Effect(name, block, summary, parameters, act, can_have, which, **fields)
        return act

    return register


def _check(name: str, block: str, parameters: tuple[Parameter, ...], axes: str) -> None:
    """Raise InputError for an invalid definition of an effect."""
    where = f"effect {name}"
    if name in EFFECTS:
        raise InputError(f"{where}: an effect of that name exists already; use another name")
    if block not in BLOCKS:
        raise InputError(f"{where}: no block '{block}'; {nearest(block, BLOCKS)}")
    if axes not in AXIS_RULES:
        raise InputError(f"{where}: unknown rule for axes '{axes}'; {nearest(axes, AXIS_RULES)}")
    for p in parameters:
        if p.quantity not in QUANTITIES:
            raise InputError(f"{where}: parameter {p.name}: unknown quantity '{p.quantity}'; {nearest(p.quantity, QUANTITIES)}")
        if p.name in ("name", "axis", "from_axis"):
            raise InputError(f"{where}: the parameter name '{p.name}' is reserved; use another name")
    if all(p.neutral is None for p in parameters):
        raise InputError(f"{where}: no parameter has a neutral value; set `neutral` of the size, the value without effect")


def find_effect(name: str, where: str) -> Effect:
    """The effect of that name, or an InputError with the nearest one."""
    if not isinstance(name, str) or name not in EFFECTS:
        raise InputError(f"{where}: unknown effect '{name}' ({nearest(str(name), EFFECTS)}); for your own effects give --effects FILE")
    return EFFECTS[name]
