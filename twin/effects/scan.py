"""Methods to read start values of a parameter from a residual: over the motor angle, over the travel, in time, from a resonance.

A scan is data: the kind of scan and its limits. `twin.diagnose.candidates` performs it.
"""

from dataclasses import dataclass
import math

from twin.machine.machine import Axis

USUAL_RUN_S = 15.0
"""Length of a run that the scale of a frequency assumes."""


@dataclass(frozen=True)
class AlongTurn:
    """Sine over the motor angle; the value is its number of periods per turn, from `low` to `high`."""

    low: float = 0.5
    high: float = 40.0

    def waves(self, value: float, axis: Axis) -> float:
        """Number of waves over an axis' travel."""
        return value * _reach(axis) / (2.0 * math.pi * axis.ratio)


@dataclass(frozen=True)
class AlongTravel:
    """Sine over the position that changes sign with the direction of motion; the value is the wavelength [m, rad].

    Wavelengths are sought from a third of the shortest usual one to four times the longest. The phase is zero at q = 0.
    """

    def waves(self, value: float, axis: Axis) -> float:
        """Number of waves over an axis' travel."""
        return _reach(axis) / max(value, 1e-9)


@dataclass(frozen=True)
class InTime:
    """Sine in time; the value is its frequency [Hz], from `low_hz` to `high_hz`."""

    low_hz: float = 1.0
    high_hz: float = 120.0

    def waves(self, value: float, axis: Axis) -> float:
        """Number of periods in a run of usual length."""
        return value * USUAL_RUN_S


@dataclass(frozen=True)
class Resonance:
    """Resonance excited by the acceleration of the axis; the value is its frequency [Hz], from `low_hz` to `high_hz`."""

    low_hz: float = 12.0
    high_hz: float = 90.0
    damping_ratio: float = 0.05


@dataclass(frozen=True)
class LargestCurrent:
    """Possible levels of a clipped current, as fractions of the largest measured current."""

    shares: tuple[float, ...] = (0.85, 0.96, 0.99, 1.02, 1.05, 1.08)


Waves = AlongTurn | AlongTravel | InTime
"""Scans whose value has a phase that an error of it shifts in the course of a record."""

Scan = Waves | Resonance | LargestCurrent


def _reach(axis: Axis) -> float:
    """Travel of an axis [m, rad], at most one turn of a rotary axis."""
    low, high = axis.travel
    return min(high - low, 2.0 * math.pi if axis.kind == "rotary" else math.inf)
