"""Numbers of the card in the units that people use, rounded to what their interval allows."""

import functools
import math
from typing import NamedTuple

from twin.control.actuator import EFFORTS
from twin.estimate.regression import Range
from twin.units import AXIS_UNITS, plain

number = functools.partial(plain, least=0.0)
"""Three digits or more, without an exponent: 0.00123, 12.3, 1234."""


class Shown(NamedTuple):
    """A unit with its factor from SI, and the unit of numbers that have four digits and more in it."""

    unit: str
    factor: float = 1.0
    coarse: "Shown | None" = None

    def at(self, largest: float) -> "Shown":
        """The unit for numbers up to this one: 2.21 deg, not 7970 arcsec."""
        return self.coarse if self.coarse is not None and abs(largest) * self.factor >= 1000.0 else self

    def text(self, value: float) -> str:
        """Three digits: '3.43 A'."""
        unit, factor, _ = self.at(value)
        return f"{number(value * factor)} {unit}"

    def interval(self, value: float, half: float) -> str:
        """With interval, both to the second digit of the half width: '3.43 +- 0.12 A'."""
        if (other := self.at(value)) is not self:
            return other.interval(value, half)
        value, half = value * self.factor, half * self.factor
        if not (math.isfinite(half) and half > 0.0):
            return f"{number(value)} {self.unit}"
        places = max(0, 1 - math.floor(math.log10(half)))
        return f"{value:.{places}f} +- {half:.{places}f} {self.unit}"

    def known(self, value: Range) -> str:
        """An interval, or the bound that it gives if it includes zero: '3.43 +- 0.12 A', 'below 0.885 A'."""
        return self.interval(value.value, value.half) if value.known else f"below {self.text(value.high)}"


def shown(quantity: str, kind: str = "linear") -> Shown:
    """How people read a 'position', 'speed' or 'error' of an axis of this kind, or an effort."""
    if quantity in EFFORTS:
        return Shown(EFFORTS[quantity].unit)
    units = AXIS_UNITS[kind]
    return Shown(*units.error, Shown(*units.position)) if quantity == "error" else Shown(*getattr(units, quantity))
