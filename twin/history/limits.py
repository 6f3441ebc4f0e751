"""When a growing change is a fault: at the usual size of its effect, at a size that the user gives, or where it alone moves the tool by a tolerance.

usual sizes of a size s:  |s| / unit, of a spring  unit / s        unit: the usual size (`columns.Direction`)
tolerance:                theta W / w(theta)                       w: largest displacement of the tool on the last recording by a change theta
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math

from twin.diagnose.tool_point import ToolPoint
from twin.effects import Setting
from twin.errors import TwinError
from twin.history.columns import Direction, changed
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.remedy.motions import given_motion
from twin.remedy.predict import decoupled

HARMLESS = 1e-9
"""A change that displaces the tool by less does not move it [m]."""


@dataclass(frozen=True)
class Limit:
    """A size [usual sizes; inf: none], and what it is in words."""

    size: float = 1.0
    text: str = "its usual size as a fault"


USUAL = Limit()

LimitOf = Callable[[Direction, float], Limit]
"""The limit of a change of a direction, whose size now is known [usual sizes]."""


def limits_of(machine: Machine, given: Sequence[Setting], tolerance: float | None, runs: Callable[[], Sequence[MeasuredRun]]) -> LimitOf:
    """Sizes that are given count first, then the tolerance [m] on the runs of the last recording, then the usual size."""
    sizes = {(s.effect.name, s.axis, s.from_axis or ""): s for s in given}

    def limit(direction: Direction, size: float) -> Limit:
        own = sizes.get(direction.cause)
        if own is not None:
            kind, unit = own.effect.size, direction.unit
            return Limit(abs(unit / own.size if kind.is_spring else kind.deviation(own.size) / unit), "the given limit")
        if tolerance is None:
            return USUAL
        moved = displacement(machine, direction, size, runs())
        reached = abs(size) * tolerance / moved if moved > HARMLESS else math.inf
        return Limit(reached, f"{tolerance * 1e6:.4g} um at the tool point on this program")

    return limit


def displacement(machine: Machine, direction: Direction, size: float, runs: Sequence[MeasuredRun]) -> float:
    """Largest displacement [m] of the true tool point by a change of this size [usual sizes] on the set points of these runs."""
    place, found = ToolPoint(machine), 0.0
    for run in runs:
        own = machine.with_feedforward(run.feedforward)
        motion = given_motion(run.name, run.trace, own)
        try:
            base, other = decoupled([own, changed(own, [(direction, size)])], motion)
        except TwinError:  # it diverges
            return math.inf
        found = max(found, float(place.distance(base, other, base.axes).max()))
    return found
