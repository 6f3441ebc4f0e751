"""Re-tuning: how the nuisances of a group change its channels, and what of a residual they explain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import functools
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import DEFAULT
from twin.diagnose.simulations import Mapper
from twin.diagnose.tolerance import UNIFORM, Nuisance, nuisances_of
from twin.machine.machine import Machine
from twin.simulation.run import all_or_raise
from twin.units import ARCSEC

FREE = 1e-6
"""Weight of zero for a column that may take any size: keeps a column that changes nothing from having one."""


HELD = 1e12
"""Weight of zero, over its own squares, of a column that is held at zero."""


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
    further: np.ndarray = field(default_factory=lambda: np.zeros(0))  # weight of zero of each column beyond the nuisances
    narrower: Tuning | None = field(default=None, repr=False)  # the tuning that this one has further columns beside
    _products: list[np.ndarray] = field(default_factory=list, repr=False, compare=False)

    def products(self, runs: Sequence[Sequence[slice]]) -> np.ndarray:
        """J'J over the rows of each run (run, column, column); remembered. `runs` are the rows of each run, as slices."""
        if not self._products:
            n = self.jacobian.shape[1]
            known = self.narrower.products(runs) if self.narrower else np.zeros((len(runs), 0, 0))
            k = known.shape[1]
            out = np.zeros((len(runs), n, n))
            for run, slices in enumerate(runs):
                out[run, :k, :k] = known[run]
                for rows in slices:
                    new = self.jacobian[rows, k:]
                    out[run, :, k:] += self.jacobian[rows].T @ new
                out[run, k:, :k] = out[run, :k, k:].T
            self._products.append(out)
        return self._products[0]

    @property
    def prior(self) -> np.ndarray:
        """Weight of zero for each column (column,): that of the tolerance for a nuisance, next to none for what stands beside them."""
        return np.concatenate([np.full(len(self.nuisances), self.prior_weight), self.further])

    def of(self, nuisances: Sequence[Nuisance], columns: np.ndarray) -> Tuning:
        """The tuning with these nuisances instead, which change `columns` (row, nuisance) at their spread, and the same further columns."""
        n = len(self.nuisances)
        return tuning_from(nuisances, stacked_columns(columns, self.jacobian[:, n:]), self.spread, self.prior_weight, self.further)

    def with_free(self, columns: np.ndarray, prior: float = FREE) -> Tuning:
        """The tuning with further columns (row, n) beside the nuisances, free to take any size: effects as they answer to a small change."""
        if not columns.size:
            return self
        cross = self.jacobian.T @ columns
        own = columns.T @ columns + prior * np.eye(columns.shape[1])
        further = np.concatenate([self.further, np.full(columns.shape[1], prior)])
        normal = np.block([[self.normal, cross], [cross.T, own]])
        jacobian = stacked_columns(self.jacobian, columns)
        return Tuning(self.nuisances, jacobian, self.spread, normal, _inverse(normal), self.base, self.prior_weight, further, self)

    def holding(self, columns: Sequence[int]) -> Tuning:
        """The tuning with some of its further columns, counted from the first of them, held at zero; it shares the jacobian with this one."""
        own = np.array(columns, int)
        at = own + len(self.nuisances)
        weight = HELD * np.maximum(np.diag(self.normal)[at], FREE)
        normal, further = self.normal.copy(), self.further.copy()
        normal[at, at] += weight
        further[own] += weight
        return replace(self, normal=normal, inverse=_inverse(normal), further=further)

    def project(self, columns: np.ndarray) -> np.ndarray:
        """J' columns, for eliminating the tuning."""
        return self.jacobian.T @ columns

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """Tuning (nuisance,) in units of its spread that fits a residual best."""
        return self.inverse @ (self.jacobian.T @ residual)

    def product(self, a: np.ndarray, b: np.ndarray) -> float:
        """a' P b of two columns (row,)."""
        return float(a @ b - self.project(a) @ self.inverse @ self.project(b))

    def inner(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """a' P b with the tuning eliminated."""
        of_a = self.project(a)
        return a.T @ b - of_a.T @ self.inverse @ (of_a if b is a else self.project(b))

    def loss(self, residual: np.ndarray) -> float:
        """Half the least square that tuning leaves of a residual."""
        return 0.5 * float(self.inner(residual, residual))

    def with_column(self, nuisance: Nuisance, column: np.ndarray) -> Tuning:
        """The tuning with one more nuisance, which changes `column` (row,) at its spread."""
        return self.of([*self.nuisances, nuisance], stacked_columns(self.jacobian[:, : len(self.nuisances)], column[:, None]))

    def reweighted(self, scale: np.ndarray) -> Tuning:
        """The same tuning where every row weighs `scale` (row,) times as much."""
        return replace(
            tuning_from(self.nuisances, np.asfortranarray(self.jacobian * scale[:, None]), self.spread, self.prior_weight, self.further),
            base=self.base,
        )


def tuning_of(group: Group, machine: Machine, mapper: Mapper) -> Tuning:
    """Simulate each toleranced parameter at its spread; `mapper` maps over threads."""
    nuisances = nuisances_of(machine, group.axes, group.thresholds)
    spread = machine.parameter_tolerance * UNIFORM
    if spread <= 0.0 or not nuisances:
        return _with_zeros(tuning_from((), np.zeros((group.size, 0)), 0.0, group.thresholds.prior_weight), group)
    step = max(group.thresholds.nearby, spread)
    variations = [Variation(functools.partial(n.apply, factor=1.0 + step), axes=n.axes(group.axes)) for n in nuisances]
    columns = all_or_raise(group.responses(variations, mapper=mapper))
    plain = tuning_from(nuisances, stacked_columns(*(c[:, None] * (spread / step) for c in columns)), spread, group.thresholds.prior_weight)
    return _with_zeros(plain, group)


def _with_zeros(tuning: Tuning, group: Group) -> Tuning:
    """The tuning with the zeros of encoders as further columns."""
    return tuning.with_free(zeros_of(group), 1.0)


def zeros_of(group: Group) -> np.ndarray:
    """What a constant of each run between motor encoder and scale changes (row, constant), weighted: encoders have no common zero.

    An effect whose law starts at zero in each run and one that carries its phase on differ by that constant alone.
    """
    blocks = [np.zeros((group.size, 0))]
    for axis in group.axes:
        channels = [c for c in group.channels if (c.axis, c.name) == (axis, "motor_minus_scale")]
        if not channels:
            continue
        rotary = group.views[channels[0].run].machine.axis(axis).kind == "rotary"
        each = np.zeros((group.size, len(channels)))
        for i, channel in enumerate(channels):
            each[channel.rows, i] = (ARCSEC if rotary else 1e-6) * channel.weight
        # what goes on from run to run is a screw that grows, not the zero of an encoder
        when = np.array([[0.0 if rotary else group.views[c.run].started_at for c in channels]])
        when -= when.mean()
        blocks.append(each @ (null_space(when) if when.any() else np.eye(len(channels))))
    return stacked_columns(*blocks)


class Trial(NamedTuple):
    """One more nuisance beside a tuning: what it changes at its spread (row,), the loss that it takes away, its best size (1: the
    largest that is normal)."""

    column: np.ndarray
    gain: float
    size: float


def trial_of(tuning: Tuning, column: np.ndarray, residual: np.ndarray) -> Trial:
    """What a nuisance that changes `column` (row,) at its spread would explain of a residual (row,) beside the tuning."""
    slope, curvature = tuning.product(column, residual), tuning.product(column, column) + tuning.prior_weight
    return Trial(column, 0.5 * slope**2 / curvature, slope / curvature * UNIFORM)


def stacked_columns(*blocks: np.ndarray) -> np.ndarray:
    """Blocks of columns (row, n) side by side, column after column in memory."""
    out = np.empty((len(blocks[0]), sum(b.shape[1] for b in blocks)), order="F")
    at = 0
    for block in blocks:
        out[:, at : at + block.shape[1]] = block
        at += block.shape[1]
    return out


def tuning_from(
    nuisances: Sequence[Nuisance],
    jacobian: np.ndarray,
    spread: float,
    prior_weight: float = DEFAULT.prior_weight,
    further: np.ndarray | None = None,
) -> Tuning:
    """The tuning of these nuisances; `jacobian` (row, column) is what each changes at its spread, weighted. Further columns are free."""
    further = np.zeros(0) if further is None else further
    normal = jacobian.T @ jacobian + np.diag(np.concatenate([np.full(len(nuisances), prior_weight), further]))
    return Tuning(tuple(nuisances), jacobian, spread, normal, _inverse(normal), np.zeros(len(nuisances)), prior_weight, further)


def solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares solution of normal x = right (column,) or (column, n), columns brought to one size first."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.asarray((scale * np.linalg.lstsq(normal * np.outer(scale, scale), (scale * right.T).T, rcond=1e-12)[0].T).T)


def _inverse(normal: np.ndarray) -> np.ndarray:
    """Inverse of a positive definite matrix whose columns may differ in size by many powers of ten."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    return np.asarray(scale[:, None] * np.linalg.pinv(normal * np.outer(scale, scale), rcond=1e-13, hermitian=True) * scale)
