"""Units. Everything inside twin is SI (m, rad, s, N, kg, A); all conversions are defined here."""

import math

from twin.errors import InputError, nearest

# unit: (dimension, factor to SI)
_LENGTH = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
_ANGLE = {"rad": 1.0, "deg": math.pi / 180.0}
_PER = {"s": 1.0, "min": 1.0 / 60.0}
UNITS: dict[str, tuple[str, float]] = {
    "1": ("number", 1.0),
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "A": ("current", 1.0),
    "Nm": ("torque", 1.0),
    "N": ("force", 1.0),
    "V": ("voltage", 1.0),
    **{u: ("length", f) for u, f in _LENGTH.items()},
    **{u: ("angle", f) for u, f in _ANGLE.items()},
    **{f"{u}/{p}": ("speed", f * g) for u, f in _LENGTH.items() for p, g in _PER.items()},
    **{f"{u}/{p}": ("angular speed", f * g) for u, f in _ANGLE.items() for p, g in _PER.items()},
    **{f"{u}/s2": ("acceleration", f) for u, f in _LENGTH.items()},
    **{f"{u}/s2": ("angular acceleration", f) for u, f in _ANGLE.items()},
}

ARCSEC = math.pi / 180.0 / 3600.0
"""One arcsecond [rad]."""


LEAST_SHOWN = 1e-3
"""Smallest number [um, arcsec, A, x noise] that a report writes out; no machine is measured or simulated to less."""


def in_words(name: str) -> str:
    """A name of the code in words: 'coulomb_friction' -> 'Coulomb friction', 'velocity_setpoint' -> 'velocity set point'."""
    return name.replace("_", " ").replace("coulomb", "Coulomb").replace("setpoint", "set point")


def plain(value: float, digits: int = 3, sign: str = "", least: float = LEAST_SHOWN) -> str:
    """A number for people, with at least so many significant digits and without exponent: '14400', '0.0123', '< 0.001', '0'; `sign` '+' shows both signs."""
    size = abs(value)
    if not math.isfinite(value):
        return str(value)
    if size < least or size == 0.0:
        return f"< {least:g}" if size > 1e-6 * least else "0"
    return f"{value:{sign}.{max(digits - 1 - math.floor(math.log10(size)), 0)}f}"


def round_up(value: float, steps: tuple[float, ...] = (1.0, 2.0, 5.0, 10.0)) -> float:
    """The smallest round number, a step times a power of ten, that is not below a value above 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * next((step for step in steps if step * power >= value * (1.0 - 1e-9)), steps[-1])


def round_down(value: float) -> float:
    """The largest round number, 1, 2 or 5 times a power of ten, that is not above a value above 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-9))


def factor_to_si(unit: str, where: str) -> float:
    """Factor from `unit` to SI; `where` is the prefix of the error message."""
    if unit not in UNITS:
        raise InputError(f"{where}: unknown unit [{unit}]; {nearest(unit, UNITS)}")
    return UNITS[unit][1]


class AxisUnits:
    """People's units of the quantities of one kind of axis, each as (name, factor from SI)."""

    def __init__(self, position: str, speed: str, error: str, error_per_si: float) -> None:
        self.position = (position, 1.0 / UNITS[position][1])
        self.speed = (speed, 1.0 / UNITS[speed][1])
        self.acceleration = (f"{speed}2", 1.0 / UNITS[f"{speed}2"][1])
        self.error = (error, error_per_si)


AXIS_UNITS = {
    "linear": AxisUnits("mm", "mm/s", "um", 1e6),
    "rotary": AxisUnits("deg", "deg/s", "arcsec", 1.0 / ARCSEC),
}
"""Output units by kind of axis: mm, mm/s, um for linear; deg, deg/s, arcsec for rotary."""

RECORDED_UNITS: dict[str, tuple[str, float]] = {
    **UNITS,
    "ns": ("time", 1e-9),
    "min": ("time", 60.0),
    "mA": ("current", 1e-3),
    "mV": ("voltage", 1e-3),
    "kN": ("force", 1e3),
    **{u: ("length", f) for u, f in {"cm": 1e-2, "in": 0.0254}.items()},
    **{u: ("angle", f) for u, f in {"mrad": 1e-3, "arcsec": ARCSEC}.items()},
    **{f"{u}/{p}": ("speed", f * g) for u, f in {"cm": 1e-2, "in": 0.0254}.items() for p, g in _PER.items()},
    "rev": ("turns", 2.0 * math.pi),
    **{f"rev/{p}": ("turning speed", 2.0 * math.pi * g) for p, g in _PER.items()},
}
"""Units of imported recordings. Revolutions are motor revolutions [rad]; to become travel they need the travel per revolution."""


def dimension_recorded(unit: str) -> str:
    """Dimension of a unit of RECORDED_UNITS."""
    return RECORDED_UNITS[unit][0]
