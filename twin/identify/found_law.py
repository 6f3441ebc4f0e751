"""A law that was found for a recorded position controller: its numbers, and what it leaves of the record (see `position_control`)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
import functools
import math

import numpy as np

from twin.control.block import Block
from twin.estimate.held_out_gain import held_out
from twin.estimate.regression import Fit
from twin.identify.position_law import OF_COLUMNS_S, OF_ROUNDING, PositionLaw, pieces


@dataclass(frozen=True)
class Found:
    """A law with its fit and its numbers x: those of NAMES, and perhaps a time.

    `others`: numbers of laws that fit as well, whose distance widens the intervals. `left`: RMS of what it leaves, `rounding`: what the rounding of
    the record makes of it [axis units a second]. `left_out` (piece,): mean squares of the pieces of the motion, each predicted by the rest of the record.
    `words`: what it has beside NAMES; its time stands for {}. `lag`: the block that has this time, `blocks`: numbers of others, as `keyed`.
    """

    law: PositionLaw
    fit: Fit
    x: np.ndarray
    others: list[np.ndarray]
    left: float
    rounding: float
    left_out: np.ndarray
    words: str = ""
    lag: Block | None = None
    blocks: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    delayed: bool = True

    @property
    def apart(self) -> np.ndarray:
        """How far the numbers (n,) of laws that fit as well are from those of this one."""
        return np.abs(np.array([*self.others, self.x]) - self.x).max(axis=0)

    @property
    def half_of_time(self) -> float:
        """Half interval [s] of its time; 0 without one."""
        return float(self.fit.quantile * math.hypot(self.fit.deviations[4], self.apart[4], OF_COLUMNS_S)) if len(self.x) > 4 else 0.0

    @functools.cached_property
    def leaves_only_rounding(self) -> bool:
        """Whether nothing that it leaves is larger than the rounding of the recorded speed set point, so that no short event is in it."""
        return float(np.abs(self.fit.residual).max()) <= OF_ROUNDING * 0.5 * self.law.step


def found_law(law: PositionLaw, fit: Fit, x: np.ndarray, others: list[np.ndarray], left: float) -> Found:
    """A law with its numbers x, which leave `left`."""
    keep = law.usable_rows()
    left_out = held_out(law.columns(x, keep), law.rest(x, keep), pieces(keep))
    rounding = OF_ROUNDING * math.hypot(law.of_rounding(x), law.step / math.sqrt(12.0))
    return Found(law, fit, x, others, left, rounding, left_out)


def rms(fit: Fit) -> float:
    """RMS of what a law leaves."""
    return float(np.sqrt(np.mean(fit.residual**2)))
