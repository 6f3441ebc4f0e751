"""A law as a sentence with numbers, and as an entry of `diagnosis.json`."""

import math
from typing import Any

import numpy as np

from twin.diagnose.law.known_physics import Known, known_causes
from twin.diagnose.law.laws import FoundLaw
from twin.effects.law import VARIABLES, law_in
from twin.effects.law_shapes import TABLE
from twin.effects.readable import display_unit, readable
from twin.estimate.regression import NORMAL_95
from twin.machine.axis import Axis
from twin.machine.machine import Machine
from twin.simulation.law_picture import output_in, shown_in
from twin.units import in_words

PASSED = {"time_constant_s": "of", "time_s": "of", "width": "of relative width", "frequency_hz": "at"}
"""Prepositions of the parameters of a filter."""


def matching_causes(law: FoundLaw) -> tuple[Known, ...]:
    """Known physical causes that match a law."""
    c = law.measured.relation
    height = next((v for k, v in law.setting.parameters.items() if k in ("height", "amplitude")), 0.0)
    return known_causes(c.output, c.variable, law.measured.shape, int(np.sign(height)))


def _value(law: FoundLaw, name: str, axis: Axis, source: Axis, signed: bool = False) -> str:
    """A value with its uncertainty in display units: '(485 +- 2) N'; the magnitude only, unless `signed`."""
    value, deviation = law.setting.parameters[name], law.deviations.get(name, 0.0)
    parameter = law.setting.effect.parameter(name)
    unit = parameter.unit(axis)
    quantity, factor = _display_unit(law, name, axis, source) or (unit, 1.0)
    value = value if signed else abs(value)
    if not deviation:
        return readable(value, unit) if factor == 1.0 else f"{factor * value:.3g} {quantity}"
    digits = max(0, -math.floor(math.log10(max(NORMAL_95 * factor * deviation, 1e-12))))
    return f"({factor * value:.{digits}f} +- {NORMAL_95 * factor * deviation:.{digits}f}) {quantity}".removesuffix(" 1").rstrip()


def _display_unit(law: FoundLaw, name: str, axis: Axis, source: Axis) -> tuple[str, float] | None:
    """Display unit and factor of a parameter of the shape."""
    described = law_in(law.setting)
    of = next((n.quantity for n in described.shape.numbers if n.name == name), "length" if name == "length" else "")
    if of == "output":
        return output_in(described, axis)
    if of == "variable":
        return shown_in(VARIABLES[described.variable].quantity, source)
    if of == "time":
        return display_unit(law.setting.parameters[name], "s")
    return shown_in("length", axis) if of == "length" else None


def sentence(law: FoundLaw, machine: Machine) -> str:
    """The law in one sentence: 'a friction on X that is (485 +- 2) N lower below (9.0 +- 0.1) mm/s'."""
    axis = machine.axis(law.axis)
    source = machine.axis(law.setting.from_axis) if law.setting.from_axis else axis
    described = law_in(law.setting)
    p = law.setting.parameters
    head = f"a {in_words(described.output)} on {law.axis}"
    over = VARIABLES[described.variable].words.split(":")[0].split(" z ")[0] + (f" of {source.name}" if source is not axis else "")
    name = described.shape.name
    if described.shape.is_filter:
        numbers = " and ".join(f"{PASSED[n.name]} {_value(law, n.name, axis, source)}" for n in described.shape.numbers if n.name in p)
        late = {"measurement": "recorded current", "current loop": "delivered torque"}.get(described.block, over)
        return f"{described.shape.words} in the {late} of {law.axis}, {numbers}"
    if described.shape.code == TABLE:
        low, high = (float(f([y for _, y in described.points])) * p["scale"] for f in (min, max))
        unit, factor = output_in(described, axis)
        return f"{head} that varies from {factor * low:.3g} to {factor * high:.3g} {unit} with the {over}"
    if name in ("gaussian", "exponential") and described.variable == "speed" and described.output == "friction":
        width = "width" if name == "gaussian" else "scale"
        return f"{head} that is {_value(law, 'height', axis, source)} {'lower' if p['height'] < 0 else 'higher'} below {_value(law, width, axis, source)}"
    if name == "gaussian" and "at" in p and described.output == "friction":
        height, at, width = (_value(law, n, axis, source) for n in ("height", "at", "width"))
        return f"{head} that is {height} {'lower' if p['height'] < 0 else 'higher'} around {at} of the {over}, over a width of {width}"
    if described.variable == "direction":
        return f"{head} of {_value(law, 'height', axis, source)} {'against' if p['height'] < 0 else 'with'} the motion, which reverses within {_value(law, 'length', axis, source)} of travel"
    if described.variable == "slack":
        return f"{head} of {_value(law, 'height', axis, source)} to either side, which reverses within {_value(law, 'length', axis, source)} of travel"
    if described.output == "voltage" and name in ("saturation", "stage"):
        width = _value(law, "scale" if name == "saturation" else "width", axis, source)
        return f"{head} of {_value(law, 'height', axis, source)} {'against' if p['height'] < 0 else 'with'} the current, which reverses within {width}"
    if name == "jitter":
        return f"random errors of the scale of {law.axis} in proportion to its speed: the scale is read {_value(law, 'deviation_s', axis, source)} too early or too late (standard deviation)"
    if name == "sine":
        return f"{head} that is a sine of amplitude {_value(law, 'amplitude', axis, source)} with period {_value(law, 'period', axis, source)} of the {over}"
    numbers = ", ".join(f"{n.name} {_value(law, n.name, axis, source, signed=True)}" for n in described.shape.numbers if n.name in p)
    return f"{head} over the {over}, {described.shape.words} ({numbers})"


def entry(law: FoundLaw, machine: Machine) -> dict[str, Any]:
    """The law as an entry of `diagnosis.json`: SI, 95 % intervals, measured points with their standard deviations."""
    axis = machine.axis(law.axis)
    table = law.setting.table()
    curve = law.measured.curve
    return {
        "axis": law.axis,
        "block": law.block,
        "output": table["output"],
        "variables": list(table["variables"]),
        **({"from_axis": law.setting.from_axis} if law.setting.from_axis else {}),
        "formula": table.get("formula", "table"),
        "parameters": {
            name: {
                "value": value,
                "low": value - NORMAL_95 * law.deviations.get(name, 0.0),
                "high": value + NORMAL_95 * law.deviations.get(name, 0.0),
                "unit": law.setting.effect.parameter(name).unit(axis),
            }
            for name, value in law.setting.parameters.items()
        },
        **({"points": [list(p) for p in table["points"]]} if "points" in table else {}),
        "probability": law.probability,
        "explained": law.explained,
        "sentence": sentence(law, machine),
        "looks_like": [{"name": k.name, "sentence": k.sentence, "to_be_sure": k.to_be_sure} for k in matching_causes(law)],
        "measured": {"x": curve.x.tolist(), "y": curve.y.tolist(), "deviation": curve.band.tolist(), "predicts": law.measured.predicts},
    }
