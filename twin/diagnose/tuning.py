"""Re-tuning: how the nuisances of a group change its channels, and what of a residual they explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from twin.diagnose.observe import Group, Mapper
from twin.diagnose.settings import DEFAULT
from twin.diagnose.tolerance import UNIFORM, Nuisance, nuisances_of
from twin.machine.machine import Machine


@dataclass(frozen=True)
class Tuning:
    """The nuisances of a group with their simulated effect on all channels."""

    nuisances: tuple[Nuisance, ...]
    jacobian: np.ndarray  # (row, nuisance), weighted, per spread s
    spread: float
    normal: np.ndarray  # J'J + w
    inverse: np.ndarray
    base: np.ndarray  # (nuisance,) deviations that the group's own machine has already, as fractions
    prior_weight: float = DEFAULT.prior_weight

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
        return tuning_from([*self.nuisances, nuisance], beside(self.jacobian, column[:, None]), self.spread, self.prior_weight)

    def reweighed(self, scale: np.ndarray) -> Tuning:
        """The same tuning where every row weighs `scale` (row,) times as much."""
        return replace(
            tuning_from(self.nuisances, np.asfortranarray(self.jacobian * scale[:, None]), self.spread, self.prior_weight), base=self.base
        )


def tuning_of(group: Group, machine: Machine, mapper: Mapper) -> Tuning:
    """Simulate each toleranced parameter at its spread; `mapper` maps over threads."""
    nuisances = nuisances_of(machine, group.axes, group.thresholds)
    spread = machine.parameter_tolerance * UNIFORM
    if spread <= 0.0 or not nuisances:
        return Tuning((), np.zeros((group.size, 0)), 0.0, np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0), group.thresholds.prior_weight)
    step = max(group.thresholds.nearby, spread)
    columns = list(mapper(lambda n: group.response(lambda m: n.apply(m, 1.0 + step), axes=n.axes(group.axes)), nuisances))
    return tuning_from(nuisances, beside(*(c[:, None] * (spread / step) for c in columns)), spread, group.thresholds.prior_weight)


class Trial(NamedTuple):
    """One more nuisance beside a tuning: what it changes at its spread (row,), the loss that it takes away, its best size (1: the
    largest that is normal)."""

    column: np.ndarray
    gain: float
    size: float


def trial_of(tuning: Tuning, column: np.ndarray, residual: np.ndarray) -> Trial:
    """What a nuisance that changes `column` (row,) at its spread would explain of a residual (row,) beside the tuning."""
    new = tuning.remembered(column)
    slope, curvature = tuning.product(new, tuning.remembered(residual)), tuning.product(new, new) + tuning.prior_weight
    return Trial(column, 0.5 * slope**2 / curvature, slope / curvature * UNIFORM)


def beside(*blocks: np.ndarray) -> np.ndarray:
    """Blocks of columns (row, n) side by side, column after column in memory."""
    out = np.empty((len(blocks[0]), sum(b.shape[1] for b in blocks)), order="F")
    at = 0
    for block in blocks:
        out[:, at : at + block.shape[1]] = block
        at += block.shape[1]
    return out


def tuning_from(nuisances: Sequence[Nuisance], jacobian: np.ndarray, spread: float, prior_weight: float = DEFAULT.prior_weight) -> Tuning:
    """The tuning of these nuisances; `jacobian` (row, nuisance) is what each changes at its spread, weighted."""
    normal = jacobian.T @ jacobian + prior_weight * np.eye(len(nuisances))
    return Tuning(tuple(nuisances), jacobian, spread, normal, np.linalg.inv(normal), np.zeros(len(nuisances)), prior_weight)
