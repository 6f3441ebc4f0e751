"""A recording projected onto the directions in which its machine can change.

Residual r (recording minus the reference twin) and responses J (row, direction) to the unit effects, both weighted by noise, enter as

    G = J' P J,   b = J' P r                 P removes the zeros of the encoders

which is all that later questions need. A change theta of the machine moves b by G theta, whatever the twin lacks: its own fault moves b by the same
amount in each recording of the same program and cancels in a difference. The noise of b has the covariance G.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import functools
from typing import Any

import numpy as np

from twin.diagnose.observe import Group, Variation, axis_groups, observe
from twin.diagnose.simulations import Mapper
from twin.diagnose.tuning import FREE, zeros_of
from twin.diagnose.view import RunView, view_of
from twin.effects import with_effects
from twin.history.columns import Direction, changed, directions_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun


@dataclass(frozen=True)
class Projection:
    """G and b of one group of axes in one run."""

    axes: tuple[str, ...]
    gram: np.ndarray  # (direction, direction)
    right: np.ndarray  # (direction,)

    def __add__(self, other: Projection) -> Projection:
        return Projection(self.axes, self.gram + other.gram, self.right + other.right)


def reference_view(machine: Machine, run: MeasuredRun) -> RunView:
    """A run on the reference machine with the effects that it has."""
    return replace(view_of(machine, run), machine=machine.with_feedforward(run.feedforward))


def groups_of(machine: Machine, runs: Sequence[MeasuredRun]) -> list[tuple[str, ...]]:
    """Coupled axes of which something moves in these runs."""
    moving = sorted({axis for run in runs for axis in run.trace.axes if run.trace.moves(axis)})
    return axis_groups(with_effects(machine, []), moving)


def projected(machine: Machine, run: MeasuredRun, axes: tuple[str, ...], mapper: Mapper, view: RunView | None = None) -> Projection | None:
    """The projection of one run for a group of axes; None if nothing of them was recorded."""
    group = observe([view or reference_view(machine, run)], axes)
    if not group.size:
        return None
    return projection_of(group, responses(group, directions_of(machine, axes), mapper), group.residual)


def responses(group: Group, directions: Sequence[Direction], mapper: Mapper) -> np.ndarray:
    """Weighted response (row, direction) to each unit effect; zero where it cannot be simulated."""
    found: list[Any] = replace(group, mapper=mapper).responses([variation([(d, 1.0)]) for d in directions])
    return np.column_stack([c if isinstance(c, np.ndarray) else np.zeros(group.size) for c in found])


def variation(changes: Sequence[tuple[Direction, float]]) -> Variation:
    """The machine of a view with changes of size."""
    return Variation(functools.partial(changed, changes=changes))


def projection_of(group: Group, columns: np.ndarray, residual: np.ndarray) -> Projection:
    """Inner products over all rows of a group; rows that depend on how an axis stuck hardly count."""
    weight = np.sqrt(group.credit)
    x = np.column_stack([columns, residual, zeros_of(group).part(slice(0, group.size))]) * weight[:, None]
    k = columns.shape[1]
    products = x.T @ x
    free = products[k + 1 :, k + 1 :] + FREE * np.eye(len(products) - k - 1)
    products = products[: k + 1, : k + 1] - products[: k + 1, k + 1 :] @ np.linalg.solve(free, products[k + 1 :, : k + 1])
    return Projection(group.axes, products[:k, :k], products[:k, k])
