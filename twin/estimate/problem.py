"""A problem: free numbers, and a function from their values to residuals.

    residuals = f(values),  part -> signal -> (row,)                           parts are independent records of one system

Each free number names the parts that it moves. Numbers that share a part, directly or through others, form a block; blocks are solved side
by side. One evaluation moves one number of each part, so that the evaluations of a difference quotient depend on the largest block only.
"""

from __future__ import annotations

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
    """A free number in the units of the search, in which a change of 1 is large.

    `step`: of the difference quotient; `parts`: those that it moves; `low`, `high`: bounds; `deviation`: of what is known of it, about `start`.
    """

    name: Hashable
    start: float
    step: float
    parts: tuple[str, ...]
    low: float = -math.inf
    high: float = math.inf
    deviation: float = math.inf

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


@dataclass(frozen=True)
class Block:
    """Free numbers that share parts, and these parts."""

    free: tuple[Free, ...]
    parts: tuple[str, ...]


def blocks_of(free: Sequence[Free]) -> list[Block]:
    """The blocks of a problem in the order of their first numbers."""
    groups: list[list[Free]] = []
    for one in free:
        joined = [g for g in groups if any(set(one.parts) & set(other.parts) for other in g)]
        groups = [g for g in groups if g not in joined]
        groups.append([*(other for g in joined for other in g), one])
    order = {one.name: i for i, one in enumerate(free)}
    sorted_groups = sorted((sorted(g, key=lambda f: order[f.name]) for g in groups), key=lambda g: order[g[0].name])
    return [Block(tuple(g), tuple(dict.fromkeys(p for f in g for p in f.parts))) for g in sorted_groups]


def batches_of(free: Sequence[Free]) -> list[list[Free]]:
    """Numbers that one evaluation may move together: no two of a batch move the same part."""
    batches: list[list[Free]] = []
    for one in free:
        room = next((b for b in batches if not any(set(one.parts) & set(other.parts) for other in b)), None)
        if room is None:
            batches.append([one])
        else:
            room.append(one)
    return batches
