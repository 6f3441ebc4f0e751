"""Re-tuning: how the nuisances of a group change its channels, and what of a residual they explain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import functools
from typing import NamedTuple

import numpy as np

from twin.diagnose.observe import Group, rebased
from twin.diagnose.tolerance import NORMAL, UNIFORM, WIDEST, Nuisance, nuisances_of, tuned
from twin.errors import TwinError
from twin.machine import Machine

PRIOR_WEIGHT = 50.0
"""Weight w of the tolerance against the samples: a parameter at the edge of its tolerance costs 75 of log likelihood."""

NEARBY = 0.03
"""Share by which a parameter is changed to see what its spread does: beside that, a break-away a sample earlier or later is small."""

SHARES = (0.05, 0.2, 0.8)
"""Sizes at which a normal imperfection is tried, as shares of the largest that is normal: its answer is not in proportion."""

EARNED = 14.0
"""Log likelihood that a normal imperfection must bring to be looked at."""

DAMPED = 0.3
"""Share of what is normal by which damping is changed to see what it does."""

UNCHANGED = 0.15
"""A size that a fit moves by less than this (relative) needs no new simulation."""


@dataclass
class Tuning:
    """The nuisances of a group with their simulated effect on all channels."""

    nuisances: tuple[Nuisance, ...]
    jacobian: np.ndarray  # (row, nuisance), weighted, per spread s
    spread: float
    normal: np.ndarray  # J'J + w
    inverse: np.ndarray
    base: np.ndarray  # (nuisance,) deviations that the group's own machine has already, as fractions

    def project(self, columns: np.ndarray) -> np.ndarray:
        """J' columns, for eliminating the tuning."""
        return self.jacobian.T @ columns

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """Tuning (nuisance,) in units of its spread that fits a residual best."""
        return self.inverse @ (self.jacobian.T @ residual)

    def remembered(self, a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A column with its projection, for inner products that are asked for again and again."""
        return a, self.project(a)

    def product(self, a: tuple[np.ndarray, np.ndarray], b: tuple[np.ndarray, np.ndarray]) -> float:
        """a' P b of remembered columns."""
        return float(a[0] @ b[0] - a[1] @ self.inverse @ b[1])

    def inner(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a' P b with the tuning eliminated."""
        return a.T @ b - self.project(a).T @ self.inverse @ self.project(b)

    def loss(self, residual: np.ndarray) -> float:
        """Half the least square that tuning leaves of a residual."""
        return 0.5 * float(self.inner(residual, residual))

    def with_column(self, nuisance: Nuisance, column: np.ndarray) -> Tuning:
        """The tuning with one more nuisance, which changes `column` (row,) at its spread."""
        return tuning_from([*self.nuisances, nuisance], beside(self.jacobian, column[:, None]), self.spread)

    def reweighed(self, scale: np.ndarray) -> Tuning:
        """The same tuning where every row weighs `scale` (row,) times as much."""
        return replace(tuning_from(self.nuisances, np.asfortranarray(self.jacobian * scale[:, None]), self.spread), base=self.base)


def tuning_of(group: Group, machine: Machine, mapper: Callable) -> Tuning:  # type: ignore[type-arg]
    """Simulate each toleranced parameter at its spread; `mapper` maps over threads."""
    nuisances = nuisances_of(machine, group.axes)
    spread = machine.parameter_tolerance * UNIFORM
    if spread <= 0.0 or not nuisances:
        return Tuning((), np.zeros((group.size, 0)), 0.0, np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    step = max(NEARBY, spread)
    columns = list(mapper(lambda n: group.response(lambda m: n.apply(m, 1.0 + step), axes=n.axes(group.axes)), nuisances))
    return tuning_from(nuisances, beside(*(c[:, None] * (spread / step) for c in columns)), spread)


def with_imperfections(tuning: Tuning, group: Group, machine: Machine, residual: np.ndarray, mapper: Callable) -> Tuning:  # type: ignore[type-arg]
    """The tuning with those normal imperfections that `residual` (row,) shows, each linear about its size there.

    Only where a channel asks for it: elasticity where motor and scale part (or, where only one of them was recorded, where that does not
    follow), slip where the position does not follow.
    """
    if not tuning.nuisances:
        return tuning
    parameters = [i for i, n in enumerate(tuning.nuisances) if n.quantity not in NORMAL]
    plain = tuning_from([tuning.nuisances[i] for i in parameters], tuning.jacobian[:, parameters], tuning.spread)
    left = (residual - plain.jacobian @ plain.solve(residual)) / group.weights
    dirty = {(c.axis, c.name) for c in group.channels if not replace(c, residual=left[c.rows]).is_clean}
    cut = {c.axis for c in group.channels if c.name == "windup"}
    wanted = [Nuisance(a, "elasticity") for a in group.axes if (a, "windup" if a in cut else "position") in dirty]
    wanted += [Nuisance(a, "slip") for a in group.axes if (a, "position") in dirty]
    current = plain
    for nuisance in wanted:
        trial = functools.partial(_at_share, current, group, machine, nuisance, residual)
        best = max((t for t in mapper(trial, SHARES) if t is not None), key=lambda t: t.gain, default=None)
        for _ in range(2):
            if best is None or not 0.0 < best.size < 1.0 or best.gain < EARNED:
                best = None
                break
            size = best.size
            better = trial(size)
            if better is None or better.gain < best.gain:
                break
            best = better
            if abs(better.size / size - 1.0) < UNCHANGED:
                break
        if best is not None:
            current = current.with_column(nuisance, best.column)
            if nuisance.quantity == "elasticity":
                current = _with_damping(current, group, machine, nuisance, size, residual)
    return current


def on_imperfect_machine(group: Group, tuning: Tuning, residual: np.ndarray) -> tuple[Group, Tuning]:
    """Group and tuning about the machine with the normal imperfections that `residual` (row,) shows: an effect acts on that one.

    A force on a drive train that gives also winds it up; nothing of that is in a sum of both.
    """
    return moved_to(group, replace(tuning, base=np.zeros(len(tuning.nuisances))), tuning.solve(residual))


def moved_to(rigid: Group, tuning: Tuning, theta: np.ndarray) -> tuple[Group, Tuning]:
    """Group and tuning about the machine whose normal imperfections are a tuning (nuisance,) further, from the one without any."""
    normal = np.array([n.quantity in NORMAL for n in tuning.nuisances], bool)
    if not normal.any():
        return rigid, tuning
    base = np.where(normal, tuning.base + theta * tuning.spread, 0.0)
    return rebased(rigid, tuned(tuning.nuisances, base)), replace(tuning, base=base)


class Trial(NamedTuple):
    """One more nuisance beside a tuning: what it changes at its spread (row,), the loss that it takes away, its best size (1: the
    largest that is normal)."""

    column: np.ndarray
    gain: float
    size: float


def trial_of(tuning: Tuning, column: np.ndarray, residual: np.ndarray) -> Trial:
    """What a nuisance that changes `column` (row,) at its spread would explain of a residual (row,) beside the tuning."""
    new = tuning.remembered(column)
    slope, curvature = tuning.product(new, tuning.remembered(residual)), tuning.product(new, new) + PRIOR_WEIGHT
    return Trial(column, 0.5 * slope**2 / curvature, slope / curvature * UNIFORM)


def _at_share(tuning: Tuning, group: Group, machine: Machine, nuisance: Nuisance, residual: np.ndarray, share: float) -> Trial | None:
    """A nuisance simulated at this share of what is normal; None where it cannot be simulated."""
    try:
        answer = group.response(
            lambda m: nuisance.apply(m, 1.0 + share * machine.parameter_tolerance),
            axes=(nuisance.owner,),
            shaken=nuisance.quantity == "slip",
        )
    except TwinError:
        return None
    return trial_of(tuning, answer * (UNIFORM / share), residual)


def _with_damping(tuning: Tuning, group: Group, machine: Machine, elasticity: Nuisance, share: float, residual: np.ndarray) -> Tuning:
    """The tuning, whose last nuisance is an elasticity of this share of what is normal, with its damping where that earns its place."""
    damping = Nuisance(elasticity.owner, "damping")
    tolerance = machine.parameter_tolerance

    def answer(damped: float) -> np.ndarray:
        return group.response(
            lambda m: damping.apply(elasticity.apply(m, 1.0 + share * tolerance), 1.0 + damped * tolerance), axes=(damping.owner,)
        )

    step = DAMPED
    try:
        plain = answer(0.0)
        for _ in range(2):  # its answer is not in proportion: the second time about as much as there is
            damped = trial_of(tuning, (answer(step) - plain) * (UNIFORM / step), residual)
            if damped.gain < EARNED:
                return tuning
            if abs(damped.size / step - 1.0) < UNCHANGED or abs(damped.size) < DAMPED * UNCHANGED:
                break
            step = min(max(damped.size, -1.0), 1.0)
    except TwinError:
        return tuning
    return tuning.with_column(damping, damped.column) if abs(damped.size) < WIDEST else tuning


def beside(*blocks: np.ndarray) -> np.ndarray:
    """Blocks of columns (row, n) side by side, column after column in memory."""
    out = np.empty((len(blocks[0]), sum(b.shape[1] for b in blocks)), order="F")
    at = 0
    for block in blocks:
        out[:, at : at + block.shape[1]] = block
        at += block.shape[1]
    return out


def tuning_from(nuisances: Sequence[Nuisance], jacobian: np.ndarray, spread: float) -> Tuning:
    """The tuning of these nuisances; `jacobian` (row, nuisance) is what each changes at its spread, weighted."""
    normal = jacobian.T @ jacobian + PRIOR_WEIGHT * np.eye(len(nuisances))
    return Tuning(tuple(nuisances), jacobian, spread, normal, np.linalg.inv(normal), np.zeros(len(nuisances)))
