"""Normal elasticity and damping of a drive train, found by simulation at several sizes.

The response is not proportional to the elasticity. Where the first mode lies near the rate of the set points, each set point excites it,
and 5 % of the frequency or half the damping decides how strongly. A response scaled from another size would be wrong there.
"""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np

from twin.diagnose.observe import Group, Mapper
from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import Trial, Tuning, tuning_from
from twin.errors import TwinError
from twin.machine.machine import Machine

AROUND = (0.72, 0.8, 0.87, 0.94, 1.0, 1.06, 1.12, 1.19, 1.27, 1.38)
"""Frequencies tried, as multiples of the linear estimate; neighbours lie within the width of a mode."""

MEETING = (0.82, 0.88, 0.94, 1.0, 1.06)
"""Frequencies tried, as multiples of the rate of the set points."""

DAMPED = (-0.9, -0.45, 0.45, 0.9)
"""Exponents of `normal_damping` tried beside the assumed damping."""


class _Tried:
    """Losses of trial drive trains on the runs in which one shows most; each trial is simulated once."""

    def __init__(self, group: Group, tuning: Tuning, axis: str, residual: np.ndarray, shows: np.ndarray, tolerance: float) -> None:
        runs = _runs_that_show(group, axis, shows)
        channels = [c for c in group.channels if c.axis == axis and c.run in runs]
        rows = np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in channels])
        self.group = replace(group, channels=channels)
        self.tuning = tuning_from(
            tuning.nuisances, np.asfortranarray(tuning.jacobian[rows]), tuning.spread, tuning.prior_weight, tuning.further
        )
        self.residual, self.axis, self.tolerance = residual[rows], axis, tolerance
        self.losses: dict[tuple[float, float], float] = {}

    def loss(self, at: tuple[float, float]) -> float:
        """Half the squares that re-tuning leaves beside a drive train `at` (share of the normal elasticity, damping exponent)."""
        if at not in self.losses:
            try:
                answer = answer_of(self.group, self.axis, at, self.tolerance)
                self.losses[at] = self.tuning.loss(self.residual - answer)
            except TwinError:
                self.losses[at] = math.inf
        return self.losses[at]


def _runs_that_show(group: Group, axis: str, shows: np.ndarray) -> set[int]:
    """The fewest runs that hold the share `train_shown` of the squares of `shows` (row,), the response to a drive train."""
    squares: dict[int, float] = {}
    for c in group.channels:
        if c.axis == axis:
            squares[c.run] = squares.get(c.run, 0.0) + float(shows[c.rows] @ shows[c.rows])
    order = sorted(squares, key=lambda run: -squares[run])
    parts = np.cumsum([squares[run] for run in order]) / max(sum(squares.values()), 1e-30)
    return set(order[: int(np.searchsorted(parts, group.thresholds.train_shown)) + 1])


def answer_of(group: Group, axis: str, at: tuple[float, float], tolerance: float) -> np.ndarray:
    """Response (row,) to a drive train `at` (share of the normal elasticity, damping exponent)."""
    elasticity, damping = (Nuisance(axis, quantity, group.thresholds) for quantity in ("elasticity", "damping"))
    return group.response(lambda m: damping.apply(elasticity.apply(m, 1.0 + at[0] * tolerance), 1.0 + at[1] * tolerance), axes=(axis,))


def with_drive_train(
    tuning: Tuning,
    group: Group,
    machine: Machine,
    axis: str,
    linear: Trial,
    residual: np.ndarray,
    mapper: Mapper,
    largest: float,
) -> Tuning:
    """The tuning with the elasticity of an axis' drive train added, and its damping if that explains enough; each linear about its size.

    `linear` is the estimate under a proportional response, `largest` the share of the normal elasticity from which it is an effect. The
    tuning comes back unchanged if no size near it explains `residual` (row,).
    """
    tolerance, t = machine.parameter_tolerance, group.thresholds
    tried = _Tried(group, tuning, axis, residual, linear.column, tolerance)

    def best_of(points: list[tuple[float, float]]) -> tuple[float, float]:
        return min(zip(mapper(tried.loss, points), points))[1]

    def at(mode_hz: float) -> tuple[float, float]:
        return (t.normal_mode_hz / mode_hz) ** 2, 0.0

    linear_hz = t.normal_mode_hz / math.sqrt(linear.size)
    near_cycle = [r / machine.position_cycle for r in MEETING]
    modes = [linear_hz * r for r in AROUND] + [f for f in near_cycle if all(abs(f / linear_hz / r - 1.0) > t.train_finer for r in AROUND)]
    found = best_of([at(f) for f in modes])
    if tried.tuning.loss(tried.residual) - tried.loss(found) < t.imperfection_earned:
        return tuning
    found = best_of([found, *((found[0], d) for d in DAMPED)])
    for step in (t.train_finer, 0.5 * t.train_finer):
        found = best_of([found, *((found[0] * (1.0 + side * step) ** 2, found[1]) for side in (-1, 1))])
        found = best_of([found, *((found[0], found[1] + side * 5.0 * step) for side in (-1, 1))])
    share, damped = found
    if share >= largest:
        return tuning
    worth = tried.loss((share, 0.0)) - tried.loss(found)
    try:
        plain = answer_of(group, axis, (share, 0.0), tolerance)
        whole = answer_of(group, axis, found, tolerance) if damped and worth >= t.imperfection_earned else None
    except TwinError:  # unstable in a run in which it does not show
        return tuning
    tuning = tuning.with_column(Nuisance(axis, "elasticity", t), plain * (UNIFORM / share))
    return tuning if whole is None else tuning.with_column(Nuisance(axis, "damping", t), (whole - plain) * (UNIFORM / damped))
