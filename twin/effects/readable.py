"""Numbers in display units (um, arcsec, per cent, ms) with decimals that match the interval.

interval_text("m", 1.26e-5, 1.242e-5, 1.278e-5)  ->  ('12.60 um', '12.42 to 12.78 um')
"""

import math

from twin.effects.effect import Parameter
from twin.effects.setting import Setting
from twin.machine.machine import Machine
from twin.units import ARCSEC, in_words

READABLE: dict[str, tuple[tuple[float, float, str], ...]] = {
    "m": ((1e-3, 1e6, "um"), (math.inf, 1e3, "mm")),
    "rad": ((1e-2, 1.0 / ARCSEC, "arcsec"),),
    "s": ((0.1, 1e3, "ms"),),
    "m/s": ((1e-4, 1e6, "um/s"), (math.inf, 1e3, "mm/s")),
    "rad/s": ((math.inf, math.degrees(1.0), "deg/s"),),
    "N/m": ((math.inf, 1e-6, "N/um"),),
    "Nm/rad": ((math.inf, 1e-3, "kNm/rad"),),
    "N s/m": ((math.inf, 1e-3, "kN s/m"),),
    "1": ((math.inf, 1.0, ""),),
}
"""Display units: SI unit -> (upper limit of a value, factor, name). Larger values and other units stay as they are."""

FEWEST_DIGITS, MOST_DIGITS, NOTHING = 3, 5, 1e4
"""Significant digits of a number without interval, and with a narrow interval; an interval that is so many times wider than its number says nothing."""


def readable_unit(unit: str, value: float, parameter: Parameter | None = None) -> tuple[str, float, float]:
    """Display unit, factor and offset of an SI value: shown value = factor (value - offset)."""
    if parameter is not None and parameter.is_factor:
        return "%", 100.0, 1.0
    if parameter is not None and unit in parameter.shown:
        return *parameter.shown[unit], 0.0
    return *display_unit(value, unit), 0.0


def display_unit(value: float, unit: str) -> tuple[str, float]:
    """Display unit of an SI value, and the factor to it."""
    return next(((name, factor) for below, factor, name in READABLE.get(unit, ()) if abs(value) < below or below == math.inf), (unit, 1.0))


def readable(value: float, unit: str) -> str:
    """A value with its display unit."""
    name, factor = display_unit(value, unit)
    if factor != 1.0:
        return f"{value * factor:.3g} {name}"
    return f"{value:.4g} {name}" if name else f"{value:.6g}"


def interval_text(unit: str, value: float, low: float, high: float, parameter: Parameter | None = None) -> tuple[str, str]:
    """A value and its interval in display units; '' without interval, 'not determined' if it says nothing."""
    shown, factor, offset = readable_unit(unit, value, parameter)
    numbers = [factor * (x - offset) for x in (value, low, high)]
    half = 0.5 * abs(numbers[2] - numbers[1])
    size = abs(numbers[0]) if math.isfinite(numbers[0]) else 0.0
    known = -math.floor(math.log10(size)) - 1 if size else 0  # decimals of the leading digit, minus one
    decimals = FEWEST_DIGITS + known
    if half > 0.0 and math.isfinite(half):
        decimals = min(1 - math.floor(math.log10(half)), MOST_DIGITS + known)
    decimals = max(decimals, 0)
    sign = "+" if parameter is not None and parameter.is_factor else ""
    texts = [f"{x:{sign}.{decimals}f}" for x in numbers]
    end = f" {shown}" if shown else ""
    interval = f"{texts[1]} to {texts[2]}{end}" if half < NOTHING * size or not size else "not determined"
    return texts[0] + end, interval if half > 0.0 else ""


def parameter_label(name: str) -> str:
    """Parameter name without its unit: 'delay_s' -> 'delay', 'mass_kg' -> 'mass'."""
    for ending in ("_rad", "_kg", "_hz", "_nm", "_s", "_m", "_a"):
        name = name.removesuffix(ending)
    return in_words(name)


def setting_text(setting: Setting, machine: Machine) -> str:
    """An effect with axis and parameters in display units: 'backlash X (clearance 15.0 um)'."""
    values = []
    for name, value in setting.parameters.items():
        parameter = setting.effect.parameter(name)
        text, _ = interval_text(parameter.unit(machine.axis(setting.axis)), value, value, value, parameter)
        values.append(f"{parameter_label(name)} {text}")
    source = f" from {setting.from_axis}" if setting.from_axis else ""
    listed = f" ({', '.join(values)})" if values else ""
    return f"{in_words(setting.effect.name)} {setting.axis}{source}{listed}"
