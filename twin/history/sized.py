"""The size of a change that is too large for its slope: the change is simulated, projected, and scaled until it shows what the recordings show.

y(theta) = w'b(theta) / w'G e                         b(theta): the simulated change, projected as a recording is (`twin.history.series`)
theta <- theta y / y(theta)                           until y(theta) = y
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

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


def sizes_on(runs: Sequence[MeasuredRun], machine: Machine, mapper: Mapper) -> SizeOf:
    """Sizes by simulation on the set points of these runs; the slope's size where it cannot be simulated."""

    def size_of(direction: Direction, axes: tuple[str, ...], y: float) -> float:
        shown, theta = _shown(direction, machine, axes, runs, mapper), y
        for _ in range(STEPS):
            found = shown(theta)
            if found is None or found * y <= 0.0 or not 1.0 / FACTOR < theta / y < FACTOR:
                return y
            theta *= y / found
            if abs(y / found - 1.0) < CLOSE:
                break
        return theta

    return size_of


def _shown(
    direction: Direction, machine: Machine, axes: tuple[str, ...], runs: Sequence[MeasuredRun], mapper: Mapper
) -> Callable[[float], float | None]:
    """What the recordings of a change theta of a direction show of it [usual sizes]; None if it cannot be simulated."""
    directions = directions_of(machine, axes)
    k, scatter = [d.name for d in directions].index(direction.name), scatter_of(directions)
    groups = [g for g in (observe([reference_view(machine, run)], axes) for run in runs) if g.size]
    columns = [responses(g, directions, mapper) for g in groups]
    gram = np.sum([projection_of(g, c, g.residual).gram for g, c in zip(groups, columns)], axis=0)
    w = filters(gram, scatter)[:, k]

    def shown(theta: float) -> float | None:
        total = 0.0
        for group, own in zip(groups, columns):
            [response] = replace(group, mapper=mapper).responses([variation([(direction, theta)])])
            if not isinstance(response, np.ndarray):
                return None
            total += float(w @ projection_of(group, own, response).right)
        return total / float(w @ gram[:, k])

    return shown
