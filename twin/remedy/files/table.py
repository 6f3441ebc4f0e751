"""What to enter in a control: a datum, or the error of an axis over position by direction of travel, E(P) = true minus commanded position, SI.

A positive error means that the axis goes too far. Between points the error is linear; outside it keeps the value of the end point, or
repeats on a modulo axis. Every format has its own sign; its module converts.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.errors import InputError


class Entry(NamedTuple):
    """One datum to enter: name on the control, new value, old value (None: unknown), unit, grade of the source."""

    name: str
    value: float
    old: float | None
    unit: str
    grade: str

    @property
    def graded(self) -> str:
        """What a file says of a grade below A."""
        return "" if self.grade == "A" else f"grade {self.grade}: check before use"

    @property
    def was(self) -> str:
        """The old value in words."""
        return "old value unknown" if self.old is None else f"was {self.old:.9g}"


@dataclass(frozen=True)
class ErrorTable:
    """Errors of one axis.

    axis       axis that is corrected
    positions  (point,) of `input_axis`, increasing [m or rad]
    forward    (point,) error in positive travel [m or rad]
    backward   (point,) error in negative travel
    input_axis axis whose position is the input; the corrected axis itself unless it is a cross compensation
    modulo     the input repeats with the span of the positions
    """

    axis: str
    positions: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    input_axis: str = ""
    modulo: bool = False

    def __post_init__(self) -> None:
        if len(self.positions) < 2 or not np.all(np.diff(self.positions) > 0.0):
            raise InputError(f"correction table of axis {self.axis}: give two or more positions that increase")
        if not len(self.positions) == len(self.forward) == len(self.backward):
            raise InputError(f"correction table of axis {self.axis}: give one error for each position and direction")

    @property
    def by_direction(self) -> bool:
        """True if the directions differ."""
        return bool(np.any(self.forward != self.backward))

    @property
    def spacing(self) -> float:
        """Distance of the points [m or rad]; 0 if they are not equidistant."""
        steps = np.diff(self.positions)
        return float(steps.mean()) if np.ptp(steps) < 1e-6 * steps.mean() else 0.0

    def error(self, position: np.ndarray | float, direction: int = 1) -> np.ndarray:
        """Error (sample,) at positions (sample,) in a direction of travel (1 or -1)."""
        values = self.forward if direction > 0 else self.backward
        at = np.atleast_1d(np.asarray(position, float))
        if self.modulo:
            at = self.positions[0] + (at - self.positions[0]) % (self.positions[-1] - self.positions[0])
        return np.interp(at, self.positions, values)
