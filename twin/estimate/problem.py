"""A problem: free numbers, and a function from their values to residuals.

    residuals = f(values),  part -> signal -> (row,)                           parts are independent records of one system

Each free number moves one part. Parts are solved side by side. One evaluation moves one number of each part, so that the evaluations of a
difference quotient depend on the part with the most numbers only.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Protocol

import numpy as np

Values = Mapping[Hashable, float]
"""Name of a free number -> its value in the units of the search."""

Residuals = Mapping[str, Mapping[str, np.ndarray]]
"""Part -> signal -> residual (row,)."""


@dataclass(frozen=True)
class Free:
    """A free number in the units of the search: a change of 1 is large there.

    `step`: of the difference quotient; `part`: the part that it moves; `low`, `high`: bounds.
    """

    name: Hashable
    start: float
    step: float
    part: str
    low: float = -math.inf
    high: float = math.inf

    def step_at(self, value: float) -> float:
        """The step away from a bound."""
        return self.step if value + self.step <= self.high else -self.step


class Problem(Protocol):
    """What an estimate needs to know. Shapes of the residuals do not depend on the values."""

    @property
    def free(self) -> Sequence[Free]:
        """The free numbers."""
        ...

    def residuals(self, many: Sequence[Values]) -> Sequence[Residuals | None]:
        """Residuals for several sets of values, evaluated together; None where there are none, as for an unstable system."""
        ...

    def clusters(self, part: str) -> Mapping[str, np.ndarray]:
        """Signal -> cluster (row,) of each row; rows of one cluster are not independent."""
        ...


def by_part(free: Sequence[Free]) -> dict[str, list[Free]]:
    """Part -> its free numbers."""
    return {part: [one for one in free if one.part == part] for part in dict.fromkeys(one.part for one in free)}
