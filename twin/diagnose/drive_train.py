"""Normal elasticity and damping of a drive train, identified by simulation at several sizes.

The response is not linear in the elasticity. If the first mode is close to the rate of the set points, each set point excites it, and how
strongly depends much on its frequency (5 %) and damping (half). A response scaled from another size would be wrong there.
"""

from collections.abc import Sequence
import functools
import math

import numpy as np

from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import T
from twin.diagnose.tolerance import UNIFORM, Nuisance
from twin.diagnose.tuning import Trial, Tuning, tuning_from
from twin.errors import TwinError
from twin.machine.machine import Machine

AROUND = (0.72, 0.8, 0.87, 0.94, 1.0, 1.06, 1.12, 1.19, 1.27, 1.38)
"""Trial frequencies, as multiples of the linear estimate; neighbours are closer than the width of a mode."""

MEETING = (0.82, 0.88, 0.94, 1.0, 1.06)
"""Trial frequencies, as multiples of the rate of the set points."""

DAMPED = (-0.9, -0.45, 0.45, 0.9)
"""Trial exponents of `normal_damping`, besides the assumed damping."""


Point = tuple[float, float]
"""A drive train: share of the largest normal elasticity, damping exponent."""


class _TrialLosses:
    """Losses of trial drive trains in the runs with the largest response; each trial is simulated once."""

    def __init__(self, group: Group, tuning: Tuning, axis: str, residual: np.ndarray, shows: np.ndarray) -> None:
        runs = _runs_that_show(group, axis, shows)
        self.group, rows = group.part({axis}, runs)
        self.tuning = tuning_from(tuning.nuisances, tuning.jacobian.at(rows), tuning.spread, tuning.prior_weight, tuning.further)
        self.residual, self.axis = residual[rows], axis
        self.losses: dict[Point, float] = {}  # loss after re-tuning

    def best_of(self, points: Sequence[Point]) -> Point:
        """The point with the smallest loss after re-tuning; the smallest point among equals."""
        new = [at for at in dict.fromkeys(points) if at not in self.losses]
        for at, answer in zip(new, responses_of(self.group, self.axis, new)):
            self.losses[at] = self.tuning.loss(self.residual - answer) if isinstance(answer, np.ndarray) else math.inf
        return min((self.losses[at], at) for at in points)[1]


def _runs_that_show(group: Group, axis: str, shows: np.ndarray) -> set[int]:
    """The smallest set of runs that holds the share `most` of the squares of `shows` (row,), the response to a drive train."""
    squares: dict[int, float] = {}
    for c in group.channels:
        if c.axis == axis:
            squares[c.run] = squares.get(c.run, 0.0) + float(shows[c.rows] @ shows[c.rows])
    order = sorted(squares, key=lambda run: -squares[run])
    parts = np.cumsum([squares[run] for run in order]) / max(sum(squares.values()), 1e-30)
    return set(order[: int(np.searchsorted(parts, T.most)) + 1])


def responses_of(group: Group, axis: str, points: Sequence[Point]) -> list[np.ndarray | TwinError]:
    """Response (row,) to the drive train at each point, or the error of its simulation."""
    tolerance = group.machine.parameter_tolerance
    elasticity, damping = (Nuisance(axis, quantity) for quantity in ("elasticity", "damping"))

    def with_train(machine: Machine, at: Point) -> Machine:
        return damping.apply(elasticity.apply(machine, 1.0 + at[0] * tolerance), 1.0 + at[1] * tolerance)

    return group.responses([Variation(functools.partial(with_train, at=at), axes=(axis,)) for at in points])


def with_drive_train(tuning: Tuning, group: Group, axis: str, linear: Trial, residual: np.ndarray, largest: float) -> Tuning:
    """The tuning with the elasticity of an axis' drive train, and its damping if that has enough evidence; each linear about its size.

    `linear` is the estimate for a linear response, `largest` the largest share of the normal elasticity that is no effect. The tuning is
    unchanged if no size near the estimate explains `residual` (row,).
    """
    tried = _TrialLosses(group, tuning, axis, residual, linear.column)

    best_of = tried.best_of

    def at(mode_hz: float) -> Point:
        return (T.normal_mode_hz / mode_hz) ** 2, 0.0

    linear_hz = T.normal_mode_hz / math.sqrt(linear.size)
    near_cycle = [r / group.machine.position_cycle for r in MEETING]
    modes = [linear_hz * r for r in AROUND] + [f for f in near_cycle if all(abs(f / linear_hz / r - 1.0) > T.nearby for r in AROUND)]
    found = best_of([at(f) for f in modes])
    if tried.tuning.loss(tried.residual) - tried.losses[found] < T.evidence:
        return tuning
    found = best_of([found, *((found[0], d) for d in DAMPED)])
    for step in (T.nearby, 0.5 * T.nearby):
        found = best_of([found, *((found[0] * (1.0 + side * step) ** 2, found[1]) for side in (-1, 1))])
        found = best_of([found, *((found[0], found[1] + side * 5.0 * step) for side in (-1, 1))])
    share, damping = found
    if share >= largest:
        return tuning
    best_of([(share, 0.0)])
    worth = tried.losses[share, 0.0] - tried.losses[found]
    points = [(share, 0.0), found] if damping and worth >= T.evidence else [(share, 0.0)]
    plain, *damped_response = responses_of(group, axis, points)
    whole = damped_response[0] if damped_response else None
    if isinstance(plain, TwinError) or isinstance(whole, TwinError):  # unstable in one of the other runs
        return tuning
    tuning = tuning.with_column(Nuisance(axis, "elasticity"), plain * (UNIFORM / share))
    return tuning if whole is None else tuning.with_column(Nuisance(axis, "damping"), (whole - plain) * (UNIFORM / damping))
