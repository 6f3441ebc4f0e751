"""Draw the laws of a machine: each output over its variable, within the range of the axis."""

from collections.abc import Mapping
import math
from pathlib import Path
from typing import Any

import numpy as np

from twin.effects import check_setting, settings_of
from twin.effects.effect import QUANTITIES
from twin.effects.law import EXAMPLE, OUTPUTS, VARIABLES, Law, cycle_of, law_in, laws_in
from twin.effects.law_filters import response
from twin.machine.machine import Axis, Machine
from twin.report import new_figure, save_png
from twin.report.colours import axis_colour, hexadecimal
from twin.units import AXIS_UNITS, in_words

SHOWN_TIME_S = 600.0
"""Range of a law over time."""

ACROSS = 4
"""Largest range of a curve in multiples of its width."""


def range_of(variable: str, machine: Machine, axis: Axis) -> tuple[float, float]:
    """Range of a variable on an axis, SI."""
    speed, current = axis.max_velocity, axis.motor.peak_current_a
    half = {
        "velocity": speed,
        "speed_setpoint": speed,
        "acceleration": axis.max_acceleration,
        "current": current,
        "current_setpoint": current,
    }
    half |= {"direction": 1.0, "slack": 1.0, "following_error": 1e-4, "windup": 1e-4}
    if variable in half:
        return -half[variable], half[variable]
    whole = {"speed": speed, "acceleration_size": axis.max_acceleration, "turn": 2.0 * math.pi, "time": SHOWN_TIME_S}
    return (0.0, whole[variable]) if variable in whole else axis.travel


def shown_in(quantity: str, axis: Axis) -> tuple[str, float]:
    """Display unit of a quantity and factor from SI."""
    units = AXIS_UNITS[axis.kind]
    shown = {"length": units.position, "speed": units.speed, "acceleration": units.acceleration, "angle": ("deg", math.degrees(1.0))}
    shown |= {"current": (axis.effort_unit, 1.0), "number": ("", 1.0)}
    return shown.get(quantity) or (QUANTITIES[quantity][axis.kind != "linear"], 1.0)


def output_in(law: Law, axis: Axis) -> tuple[str, float]:
    """Display unit of the output of a law and factor from SI; that of an error for a displacement."""
    quantity = OUTPUTS[law.block][law.output].quantity
    return AXIS_UNITS[axis.kind].error if quantity == "length" else shown_in(quantity, axis)


def draw_response(place: Any, law: Law, numbers: Mapping[str, float], machine: Machine, colour: str) -> None:
    """Draw magnitude and phase of a filter over frequency, with a second scale for the phase."""
    cycle = cycle_of(law, machine)
    frequency = np.geomspace(1.0, 0.45 / max(cycle, 1e-3), 500)
    passed = response(law.shape, numbers, cycle, frequency)
    place.semilogx(frequency, np.abs(passed), color=colour, linewidth=1.8)
    place.set_xlabel("frequency [Hz]")
    passing = law.output if law.output == "torque" else law.variable  # the torque that a current commands
    place.set_ylabel(f"{in_words(passing)}, after over before")
    place.set_ylim(0.0, 1.3)
    phase = place.twinx()
    phase.semilogx(frequency, np.degrees(np.unwrap(np.angle(passed))), color=colour, linewidth=1.0, linestyle="--")
    phase.set_ylabel("phase [deg] (dashed)")


def draw_laws(machine: Machine, path: Path) -> Path:
    """Write the picture with one panel per law; for a machine without laws, of the example on its first axis."""
    shown = laws_in(settings_of(machine)) or (check_setting({**EXAMPLE, "axis": machine.axis_names[0]}, machine, "twin effects law"),)
    figure, places = new_figure(len(shown), 1, 8.6, 2.8)
    for place, setting in zip(places[:, 0], shown):
        axis, law = machine.axis(setting.axis), law_in(setting)
        source = machine.axis(setting.from_axis) if setting.from_axis else axis
        place.set_title(f"law on axis {axis.name}, {law.block}: {law.definition().get('formula', 'through points')}")
        if law.shape.is_filter:
            draw_response(place, law, setting.parameters, machine, hexadecimal(axis_colour(axis.name)))
            continue
        low, high = range_of(law.variable, machine, source)
        widths = [setting.parameters[n] for n in ("width", "scale", "period") if n in setting.parameters]
        if widths and law.variable != "turn":
            low, high = max(low, -ACROSS * widths[0]), min(high, ACROSS * widths[0])
        x = np.linspace(low, high, 600)
        variable_unit, per = shown_in(VARIABLES[law.variable].quantity, source)
        unit, factor = output_in(law, axis)
        place.plot(per * x, factor * law.values(x, setting.parameters, axis), color=hexadecimal(axis_colour(axis.name)), linewidth=1.8)
        if law.points:
            px, py = np.array(law.points).T
            place.plot(per * px, factor * setting.parameters["scale"] * py, "o", color=hexadecimal(axis_colour(axis.name)), markersize=4)
        place.set_xlabel(f"{in_words(law.variable)}{f' of {source.name}' if source is not axis else ''} [{variable_unit or '1'}]")
        place.set_ylabel(f"{in_words(law.output)} [{unit}]")
    save_png(figure, path, 80)
    return path
