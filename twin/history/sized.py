"""The size of a change that is too large for its slope: the change is simulated, projected, and scaled until it shows what the recordings show.

y(theta) = w'b(theta) / w'G e                         b(theta): the simulated change, projected as a recording is (`twin.history.series`)
theta <- theta y / y(theta)                           until y(theta) = y
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import functools

import numpy as np

from twin.diagnose.observe import observe
from twin.diagnose.simulations import Mapper
from twin.history.columns import Direction, directions_of
from twin.history.judge import SizeOf
from twin.history.projection import projection_of, reference_view, responses, variation
from twin.history.series import filters, scatter_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun

STEPS, CLOSE, FACTOR = 8, 0.002, 4.0
"""Most simulations of a change, the relative difference at which its size is found, and the largest factor on the slope's size."""


def sizes_on(runs: Callable[[], Sequence[MeasuredRun]], machine: Machine, mapper: Mapper) -> SizeOf:
    """Sizes by simulation on the set points of these runs; the slope's size where it cannot be simulated."""
    shown_by = functools.cache(lambda axes: _Shown(machine, axes, runs(), mapper))

    def size_of(direction: Direction, axes: tuple[str, ...], y: float) -> float:
        shown, theta = shown_by(axes), y
        for _ in range(STEPS):
            found = shown(direction, theta)
            if found is None or found * y <= 0.0 or not 1.0 / FACTOR < theta / y < FACTOR:
                return y
            theta *= y / found
            if abs(y / found - 1.0) < CLOSE:
                break
        return theta

    return size_of


class _Shown:
    """What recordings of changes of a group of axes show of them; the slopes of the group are simulated once."""

    def __init__(self, machine: Machine, axes: tuple[str, ...], runs: Sequence[MeasuredRun], mapper: Mapper) -> None:
        self.directions = directions_of(machine, axes)
        observed = [replace(g, mapper=mapper) for g in (observe([reference_view(machine, run)], axes) for run in runs) if g.size]
        self.groups = [(g, responses(g, self.directions, mapper)) for g in observed]
        count = len(self.directions)
        self.gram = np.sum([np.zeros((count, count)), *(projection_of(g, c, g.residual).gram for g, c in self.groups)], axis=0)

    def __call__(self, direction: Direction, theta: float) -> float | None:
        """The change theta of a direction, by its slope [usual sizes]; None if it cannot be simulated."""
        k = [d.name for d in self.directions].index(direction.name)
        w = filters(self.gram, scatter_of(self.directions))[:, k]
        total = 0.0
        for group, columns in self.groups:
            [response] = group.responses([variation([(direction, theta)])])
            if not isinstance(response, np.ndarray):
                return None
            total += float(w @ projection_of(group, columns, response).right)
        own = float(w @ self.gram[:, k])
        return total / own if own > 0.0 else None
