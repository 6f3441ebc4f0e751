"""The effect `law`, for laws that the library lacks: an output of one block as a function of one variable, y = f(x).

    [[effect]]
    name = "law"
    axis = "X"
    block = "mechanics"
    output = "friction"
    variables = ["speed"]
    formula = "height * e^(-((speed - at) / width)^2)"
    height = -489.0                   # N
    width = 0.009                     # m/s

`formula` is a shape of `twin.effects.law_shapes`, by name or equation, followed by its parameters in SI. A curve without a formula
has `points = [[x, y], ...]`, with linear or cubic spline interpolation `between` them. `VARIABLES` and `OUTPUTS` list the variables and
outputs. `from_axis` takes the variable from another axis; `memory_s` filters the output by a first-order lag.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import itertools
import math
from typing import Any, NamedTuple

import numpy as np

from twin.effects import law_terms
from twin.effects.change import Change
from twin.effects.effect import FROM_TABLE, Effect, Parameter, Picture
from twin.effects.law_filters import filter_row
from twin.effects.law_shapes import CURVE, MOST_POINTS, TABLE, Shape, find_shape, row_of, values_of
from twin.effects.setting import Setting
from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine
from twin.simulation import loop_terms
from twin.simulation.loop_terms import CURRENT, DRIVE, FORCE, MEASURE, RECORD, SETPOINT, SPEED, VOLTAGE
from twin.tables import one_of
from twin.units import in_words

NAME = "law"


class Variable(NamedTuple):
    """An independent variable of a law: code in the loop, quantity, description, and the blocks where it is available (empty: all)."""

    code: int
    quantity: str
    words: str
    only: tuple[str, ...] = ()


VARIABLES = {
    "position": Variable(law_terms.V_POSITION, "length", "position of the load"),
    "turn": Variable(law_terms.V_TURN, "angle", "angle of the motor"),
    "velocity": Variable(law_terms.V_VELOCITY, "speed", "signed speed"),
    "speed": Variable(law_terms.V_SPEED, "speed", "speed without sign"),
    "acceleration": Variable(law_terms.V_ACCELERATION, "acceleration", "acceleration"),
    "acceleration_size": Variable(law_terms.V_ACCELERATION_SIZE, "acceleration", "acceleration without sign"),
    "current": Variable(law_terms.V_CURRENT, "current", "motor current"),
    "time": Variable(law_terms.V_TIME, "time", "time since the start of the campaign"),
    "direction": Variable(law_terms.V_DIRECTION, "number", "direction of motion z with memory over `length`: dz/dt = (v - |v| z) / length"),
    "slack": Variable(law_terms.V_SLACK, "number", "position within a play of +-`length`: dz/dt = v / length, limited to -1 .. 1"),
    "following_error": Variable(
        law_terms.V_FOLLOWING_ERROR, "length", "delayed set point minus measured position", ("position controller",)
    ),
    "speed_setpoint": Variable(law_terms.V_SPEED_SETPOINT, "speed", "speed set point", ("position controller",)),
    "windup": Variable(law_terms.V_WINDUP, "length", "rotor minus load position of a drive train with a spring", ("transmission",)),
    "current_setpoint": Variable(law_terms.V_CURRENT_SETPOINT, "current", "current set point", ("speed controller",)),
}
"""Independent variables of laws by their names in a machine file."""


class Output(NamedTuple):
    """An output of a law: quantity, description, stage of the loop, and the signal to which the law is added (-1: a term of its own)."""

    quantity: str
    words: str
    stage: int
    signal: int = -1


OUTPUTS: dict[str, dict[str, Output]] = {
    "mechanics": {
        "force": Output("force", "force on the load, towards +q", FORCE, loop_terms.X_LOAD_FORCE),
        "friction": Output(
            "force", "added to the Coulomb friction, which opposes motion and holds at rest", FORCE, loop_terms.X_FRICTION_LEVEL
        ),
    },
    "transmission": {
        "displacement": Output("length", "motor position minus load position, from the start of a run", MEASURE),
        "force": Output("force", "force on the load towards +q, reaction on the rotor, parallel to the spring of the drive train", FORCE),
    },
    "measurement": {
        "displacement": Output("length", "scale minus load position, from the start of a run", MEASURE, loop_terms.X_SCALE),
        "current": Output(
            "current", "added to the recorded current, which the control does not see", RECORD, loop_terms.X_RECORDED_CURRENT
        ),
    },
    "current loop": {
        "torque": Output("torque", "added to the motor torque", FORCE, loop_terms.X_MOTOR_TORQUE),
        "voltage": Output("voltage", "added to the output voltage of the current controller", VOLTAGE, loop_terms.X_VOLTAGE),
    },
    "speed controller": {"current": Output("current", "added to the current set point", CURRENT, loop_terms.X_CURRENT_SETPOINT)},
    "position controller": {
        "speed": Output("speed", "added to the speed set point", SPEED, loop_terms.X_SPEED_SETPOINT),
        "received_speed": Output(
            "speed", "added to the speed set point at the input of the speed controller; not recorded", DRIVE, loop_terms.X_SPEED_SETPOINT
        ),
        "set_point": Output("length", "added to the delayed set point", SETPOINT, loop_terms.X_SETPOINT),
    },
}
"""Outputs of laws in each block; the first is the default."""

FILTERED = {
    ("speed controller", "current"): "current_setpoint",
    ("position controller", "speed"): "speed_setpoint",
    ("position controller", "received_speed"): "speed_setpoint",
    ("measurement", "current"): "current",
    ("current loop", "torque"): "current",
}
"""Block and output of a filter, and its input variable."""


@dataclass(frozen=True)
class Law:
    """Structure of a law: its table without the fitted numbers."""

    block: str
    output: str
    variable: str
    shape: Shape
    points: tuple[tuple[float, float], ...] = ()
    between: str = "linear"
    period: float = 0.0  # of a periodic curve through points, in the variable's unit; 0: not periodic

    @property
    def is_remembered(self) -> bool:
        """Whether the variable has a memory `length`."""
        return self.variable in ("direction", "slack")

    def definition(self) -> dict[str, Any]:
        """The defining entries of a machine file."""
        head: dict[str, Any] = {"block": self.block, "output": self.output, "variables": [self.variable]}
        if self.shape.code != TABLE:
            return {**head, "formula": self.shape.text(self.variable)}
        return {
            **head,
            "points": [list(p) for p in self.points],
            "between": self.between,
            **({"period": self.period} if self.period else {}),
        }

    def values(self, x: np.ndarray, numbers: Mapping[str, float], axis: Axis) -> np.ndarray:
        """Output (sample,) at values of the variable, without memory."""
        x = np.mod(x, self.period) if self.period else np.asarray(x, float)
        return values_of(self.shape, x, row_of(self.shape, numbers, self.gain(axis), self.points, self.between))

    def gain(self, axis: Axis) -> float:
        """Nominal gain from the variable to the output, which a characteristic bends or clips."""
        if self.output == "torque":
            return axis.motor.torque_constant_nm_per_a
        return axis.loops.position_gain_per_s if self.variable == "following_error" else 1.0


SERVED = {"following_error": ("speed",), "speed_setpoint": ("speed", "received_speed")}
"""Variables of the position controller that come up within a cycle -> outputs that are calculated after them."""


def law_of(table: Mapping[str, Any], where: str) -> Law:
    """The law of a table. Raises InputError for an invalid table."""
    block = one_of(table, "block", OUTPUTS, f"{where}: law", "mechanics")
    output = one_of(table, "output", OUTPUTS[block], f"{where}: law of the {block}", next(iter(OUTPUTS[block])))
    variables = table.get("variables", ())
    if not isinstance(variables, list | tuple) or len(variables) != 1:
        raise InputError(
            f'{where}: law: variables = {variables!r}: give exactly one, e.g. variables = ["speed"]; write a sum as several laws'
        )
    variable = variables[0]
    if not isinstance(variable, str) or variable not in VARIABLES:
        raise InputError(f"{where}: law: no variable {variable!r}; {nearest(str(variable), VARIABLES)}")
    only = VARIABLES[variable].only
    if only and block not in only:
        raise InputError(f"{where}: law: {variable} is available in the {only[0]} only, not in the {block}; use another variable")
    if output not in (served := SERVED.get(variable, (output,))):
        raise InputError(f"{where}: law: {variable} is known to {' and '.join(served)} only, not to {output}; use another output")
    if ("formula" in table) == ("points" in table):
        raise InputError(f"{where}: law: give either a formula or points = [[x, y], ...]")
    if "formula" in table:
        shape = find_shape(table["formula"], variable, f"{where}: law")
        passed = FILTERED.get((block, output))
        if shape.is_filter and variable != passed:
            pairs = ", ".join(f"{o} over {v} in the {b}" for (b, o), v in FILTERED.items())
            raise InputError(f"{where}: law: a {shape.name} filters {pairs}; not {output} over {variable} in the {block}")
        return Law(block, output, variable, shape)
    return Law(block, output, variable, CURVE, *_points_of(table, f"{where}: law"))


def laws_in(settings: Sequence[Setting]) -> tuple[Setting, ...]:
    """The laws among settings."""
    return tuple(s for s in settings if s.effect.name == NAME)


def law_in(setting: Setting) -> Law:
    """The law of a machine's setting."""
    return law_of(setting.table(), f"axis {setting.axis}")


def _points_of(table: Mapping[str, Any], where: str) -> tuple[tuple[tuple[float, float], ...], str, float]:
    """Points, interpolation and period of a curve."""
    between = table.get("between", "linear")
    if between not in ("linear", "cubic"):
        raise InputError(f"{where}: between = {between!r}; write linear or cubic")
    try:
        points = tuple((float(x), float(y)) for x, y in table["points"])
    except (TypeError, ValueError):
        raise InputError(f"{where}: points = {table['points']!r}: write pairs of numbers, points = [[0.0, 1.5], [0.1, 0.8]]") from None
    if not 2 <= len(points) <= MOST_POINTS or not all(math.isfinite(v) for p in points for v in p):
        raise InputError(f"{where}: {len(points)} points: give 2 to {MOST_POINTS} pairs of finite numbers")
    if any(b[0] <= a[0] for a, b in itertools.pairwise(points)):
        raise InputError(f"{where}: the first numbers of points must increase; sort them and remove duplicates")
    period = table.get("period", 0.0)
    if isinstance(period, bool) or not isinstance(period, int | float) or not 0.0 <= period < math.inf:
        raise InputError(f"{where}: period = {period!r}: give a positive number in the variable's unit")
    return points, between, float(period)


def effect_of(table: Mapping[str, Any], where: str) -> Effect:
    """The effect of a law's table."""
    law = law_of(table, where)
    parameters = [_parameter(number, law) for number in law.shape.numbers]
    if law.is_remembered:
        parameters.append(Parameter("length", "length", 1e-9, 10.0, logarithmic=True))
    if "memory_s" in table:
        parameters.append(Parameter("memory_s", "time", 0.0, 1e5, shape=True))
    act = functools.partial(_act, law)
    act.__doc__ = sentence(law)
    return Effect(
        NAME,
        law.block,
        sentence(law),
        tuple(parameters),
        act,
        lambda machine, axis: True,
        "any axis",
        from_axis="from_axis" in table,
        picture=EXAMPLE_PICTURE,
        definition=law.definition(),
    )


FROM_TABLE[NAME] = effect_of

EXAMPLE_PICTURE = Picture("", "reversal")

EXAMPLE: dict[str, Any] = {
    "name": NAME,
    "block": "mechanics",
    "output": "friction",
    "variables": ["speed"],
    "formula": "gaussian",
    "height": -150.0,
    "width": 0.005,
}
"""Example for the page and the picture of `twin effects law`: friction that drops at low speed."""


def sentence(law: Law) -> str:
    """Description of a law in one line."""
    of = VARIABLES[law.variable].words
    output = in_words(law.output)
    how = f"along {law.shape.words}" if law.shape.code != TABLE else f"through {len(law.points)} points"
    return f"A law of the {law.block}: {output} over {of}, {how}"


def _parameter(number: Parameter, law: Law) -> Parameter:
    """A parameter of the law's shape, with the quantity that it has in this law."""
    quantities = {"output": OUTPUTS[law.block][law.output].quantity, "variable": VARIABLES[law.variable].quantity}
    return replace(
        number,
        quantity=quantities.get(number.quantity, number.quantity),
        shape=number.shape or (bool(number.scan) and law.variable == "turn"),  # a sine over the turn is a harmonic of it
        scan=number.scan if law.variable == "position" else "",
        any_size=True,
    )


def _act(law: Law, change: Change, axis: Axis, from_axis: Axis | None = None, **numbers: float) -> None:
    output = OUTPUTS[law.block][law.output]
    own = law_terms.motor_law if law.output == "displacement" else law_terms.spring_law
    source = from_axis or axis
    springs = [("a law over the windup", source)] if law.variable == "windup" else []
    springs += [("a force of the transmission", axis)] if (law.block, law.output) == ("transmission", "force") else []
    for what, needs in springs:
        if needs.name not in change.couplings:
            raise InputError(
                f"law on axis {axis.name}: {what} needs a spring; add a transmission_compliance or backlash to axis {needs.name}"
            )
    if law.output == "voltage" and not axis.actuator.winding:
        raise InputError(f"law on axis {axis.name}: a voltage needs a current loop; the {axis.effort} of this axis is a command")
    cycle = cycle_of(law, change.machine)
    head = [0.0] * law_terms.HEAD
    head[law_terms.P_VARIABLE], head[law_terms.P_SHAPE] = float(VARIABLES[law.variable].code), float(law.shape.code)
    head[law_terms.P_AXIS], head[law_terms.P_FACTOR] = float(change.index(source)), _factor(law, source)
    head[law_terms.P_OFFSET] = change.started_at if law.variable == "time" else 0.0
    head[law_terms.P_LENGTH], head[law_terms.P_MEMORY] = numbers.get("length", 0.0), numbers.get("memory_s", 0.0)
    head[law_terms.P_CYCLE], head[law_terms.P_PERIOD], head[law_terms.P_OUTPUT] = cycle, law.period, float(output.signal)
    head[law_terms.P_IN_THE_MIDDLE], head[law_terms.P_FROM_START] = float(output.stage == FORCE), float(output.stage == MEASURE)
    row = (
        filter_row(law.shape, numbers, cycle)
        if law.shape.is_filter
        else row_of(law.shape, numbers, law.gain(axis), law.points, law.between)
    )
    change.add_term(own if output.signal < 0 else law_terms.added_law, output.stage, axis, [*head, *row])
    if law.output == "force" and law.block != "transmission":
        at = change.index(source)
        change.force_at_rest.append((change.index(axis), lambda start: _at_rest(law, numbers, source, float(start[at]), change.started_at)))


def _factor(law: Law, source: Axis) -> float:
    """Factor of the variable: the ratio of an angle of the motor, the torque constant of a current whose torque is filtered."""
    if law.shape.is_filter and law.output == "torque":
        return source.motor.torque_constant_nm_per_a
    return 1.0 / source.ratio if law.variable == "turn" else 1.0


def cycle_of(law: Law, machine: Machine) -> float:
    """Evaluation period of a law [s]: the cycle of its controller, or the base tick."""
    if law.output == "received_speed":
        return machine.speed_cycle
    if law.block == "position controller":
        return machine.position_cycle
    return machine.current_cycle if law.block == "speed controller" or law.output == "voltage" else machine.base_tick


def _at_rest(law: Law, numbers: Mapping[str, float], source: Axis, position: float, started_at: float) -> float:
    """Force of a law at rest."""
    x = {"position": position, "turn": position / source.ratio, "time": started_at}.get(law.variable, 0.0)
    return float(law.values(np.array([x]), numbers, source)[0])
