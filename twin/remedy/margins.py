"""Margins that are asked of the loops: no change and no tuning goes below them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
import math

from twin.control.linear import Loop
from twin.machine.check import LEAST_GAIN, LEAST_PHASE_DEG, MOST_PEAK
from twin.machine.loops import loops_of, margins_of
from twin.machine.machine import Machine

GRID = 600
"""Margins are located on so many frequencies while a gain is sought."""


@dataclass(frozen=True)
class Asked:
    """Smallest margins of speed and position loop: phase [deg] by loop, gain [1]."""

    phase: Mapping[str, float] = field(default_factory=lambda: dict(LEAST_PHASE_DEG))
    gain: float = LEAST_GAIN
    peak: float = MOST_PEAK
    """Largest gain of the closed position loop."""

    def missed(self, loop: Loop) -> str:
        """What a loop falls short of, in words; '' for nothing."""
        m = margins_of(loop, GRID)
        if not m.stable:
            return f"the {loop.name} loop is unstable"
        if m.phase < self.phase[loop.name]:
            return f"the {loop.name} loop has a phase margin of {m.phase:.0f} degrees; {self.phase[loop.name]:g} are asked"
        if m.gain < self.gain:
            return f"the {loop.name} loop has a gain margin of {20 * math.log10(m.gain):.1f} dB; {20 * math.log10(self.gain):.1f} are asked"
        if loop.name == "position" and m.peak > self.peak:
            return f"the closed position loop peaks at {m.peak:.2f}; above {self.peak:g} it overshoots"
        return ""

    def missed_by(self, machine: Machine, axis: str) -> str:
        """The same for speed and position loop of an axis."""
        return next((text for loop in loops_of(machine, machine.axis(axis))[-2:] if (text := self.missed(loop))), "")


def asked_of(phase_deg: float | None, gain_db: float) -> Asked:
    """The margins that the user gives; without a phase those of `twin machine check`."""
    return Asked(dict(LEAST_PHASE_DEG) if phase_deg is None else dict.fromkeys(LEAST_PHASE_DEG, phase_deg), 10.0 ** (gain_db / 20.0))
