"""Numbers of the card in the units that people use, rounded to what their interval allows."""

import functools
import math
from typing import NamedTuple

from twin.control.actuator import EFFORTS
from twin.units import AXIS_UNITS, plain

number = functools.partial(plain, least=0.0)
"""Three digits or more, without an exponent: 0.00123, 12.3, 1234."""


class Shown(NamedTuple):
    """A unit with its factor from SI."""

    unit: str
    factor: float = 1.0

    def text(self, value: float) -> str:
        """Three digits: '3.43 A'."""
        return f"{number(value * self.factor)} {self.unit}"

    def interval(self, value: float, half: float) -> str:
        """With interval, both to the second digit of the half width: '3.43 +- 0.12 A'."""
        value, half = value * self.factor, half * self.factor
        if not (math.isfinite(half) and half > 0.0):
            return f"{number(value)} {self.unit}"
        places = max(0, 1 - math.floor(math.log10(half)))
        return f"{value:.{places}f} +- {half:.{places}f} {self.unit}"


def shown(quantity: str, kind: str = "linear") -> Shown:
    """How people read a 'position', 'speed' or 'error' of an axis of this kind, or an effort."""
    return Shown(EFFORTS[quantity].unit) if quantity in EFFORTS else Shown(*getattr(AXIS_UNITS[kind], quantity))
