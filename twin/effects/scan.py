"""How the start values of a parameter are read from a residual: along the motor's turn, along the travel, in time, from a swing.

A scan is data: it says what to look through and between which limits. `twin.diagnose.candidates` carries it out.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

from twin.machine.machine import Axis


@dataclass(frozen=True)
class AlongTurn:
    """Waves over the motor's angle, from `low` to `high` a turn; the value is the number of waves a turn."""

    low: float = 0.5
    high: float = 40.0

    def waves(self, value: float, axis: Axis, seconds: float) -> float:
        """Number of waves over an axis' travel."""
        return value * _reach(axis) / (2.0 * math.pi * axis.ratio)


@dataclass(frozen=True)
class AlongTravel:
    """Waves over the position, turned round with the direction of motion; the value is the wavelength [m, rad].

    Wavelengths are sought from a third of the shortest usual one to four times the longest. The wave is a sine from q = 0.
    """

    def waves(self, value: float, axis: Axis, seconds: float) -> float:
        """Number of waves over an axis' travel."""
        return _reach(axis) / max(value, 1e-9)


@dataclass(frozen=True)
class InTime:
    """Waves in time from `low_hz` to `high_hz`; the value is the frequency [Hz]."""

    low_hz: float = 1.0
    high_hz: float = 120.0

    def waves(self, value: float, axis: Axis, seconds: float) -> float:
        """Number of waves in a run of so many seconds."""
        return value * seconds


@dataclass(frozen=True)
class Resonance:
    """A swinging mass that the axis' acceleration excites, from `low_hz` to `high_hz`; the value is its frequency [Hz]."""

    low_hz: float = 12.0
    high_hz: float = 90.0
    damping_ratio: float = 0.05

    def waves(self, value: float, axis: Axis, seconds: float) -> float:
        """Zero: a swing dies out, its phase does not run away over a run."""
        return 0.0


@dataclass(frozen=True)
class LargestCurrent:
    """Shares of the largest current that was measured: levels at which a clipped current would show."""

    shares: tuple[float, ...] = (0.85, 0.96, 0.99, 1.02, 1.05, 1.08)

    def waves(self, value: float, axis: Axis, seconds: float) -> float:
        """Zero: a level is no wave."""
        return 0.0


Scan = AlongTurn | AlongTravel | InTime | Resonance | LargestCurrent


def _reach(axis: Axis) -> float:
    """Travel of an axis, at most a turn of a rotary one [m, rad]."""
    low, high = axis.travel
    return min(high - low, 2.0 * math.pi if axis.kind == "rotary" else math.inf)
