"""The size of a change that is too large for its slope: the change is simulated, projected, and scaled until it shows what the recordings show.

y(theta) = w'b(theta) / w'G e                         b(theta): the simulated change, projected as a recording is (`twin.history.series`)
theta <- theta y / y(theta)                           until y(theta) = y
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import functools

import numpy as np

from twin.history.columns import Direction
from twin.history.judge import SizeOf
from twin.history.projection import Linearised
from twin.history.series import Series, filters

STEPS, CLOSE, FACTOR = 8, 0.002, 4.0
"""Most simulations of a change, the relative accuracy of its size, and the largest factor on the slope's size."""


def sizes_on(runs_of: Callable[[tuple[str, ...]], Sequence[Linearised]]) -> SizeOf:
    """Sizes by simulation on the runs of a group of axes; the slope's size where it cannot be simulated."""
    runs_of = functools.cache(runs_of)

    def shown(direction: Direction, series: Series, theta: float) -> float | None:
        """The change theta of a direction, by its slope [usual sizes]; None if it cannot be simulated."""
        axes, gram = series.axes, np.sum([run.gram for run in runs_of(series.axes)], axis=0)
        k = [d.name for d in series.directions].index(direction.name)
        w = filters(gram, series.scatter)[:, k]
        rights = [right for run in runs_of(axes) if (right := run.right_of([(direction, theta)])) is not None]
        if len(rights) < len(runs_of(axes)) or (own := float(w @ gram[:, k])) <= 0.0:
            return None
        return float(w @ np.sum(rights, axis=0)) / own

    def size_of(direction: Direction, series: Series, y: float) -> float:
        theta = y
        for _ in range(STEPS if runs_of(series.axes) else 0):
            found = shown(direction, series, theta)
            if found is None or found * y <= 0.0 or not 1.0 / FACTOR < theta / y < FACTOR:
                return y
            theta *= y / found
            if abs(y / found - 1.0) < CLOSE:
                break
        return theta

    return size_of
