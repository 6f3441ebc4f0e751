"""Re-tuning: the linear response of the channels to the nuisance parameters, and the part of a residual that it explains."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from twin.diagnose.channel import Channel
from twin.diagnose.columns import Column, Columns
from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import T
from twin.diagnose.tolerance import UNIFORM, Nuisance, nuisances_of
from twin.effects import Setting
from twin.estimate.regression import NORMAL_95, quantile
from twin.simulation.encoder_zeros import TREND, beside_place, growth_times
from twin.simulation.run import all_or_raise
from twin.units import ARCSEC

FREE = 1e-6
"""Prior weight of a free column. It keeps the coefficient of a column without a response at zero."""


HELD = 1e12
"""Prior weight of a column that is held at zero, over its own squares."""


@dataclass(frozen=True)
class Tuning:
    """Nuisance parameters of a group with the simulated response of all channels to each.

    Further columns are free columns next to the nuisances: encoder zeros, or responses to effects.
    """

    nuisances: tuple[Nuisance, ...]
    jacobian: Columns  # weighted, per spread of a nuisance
    spread: float
    normal: np.ndarray  # J'J + w
    base: np.ndarray  # (nuisance,) deviations about which the group is linearised, as fractions
    prior_weight: float
    further: np.ndarray  # prior weight of each further column
    bend: float = 0.0  # loss of what the columns of the parameters missed on the machine on which they were simulated
    _products: dict[tuple[tuple[tuple[int, int], ...], ...], np.ndarray] = field(default_factory=dict, repr=False, compare=False)

    def __post_init__(self) -> None:
        self.normal.flags.writeable = False  # tunings share it: a change in place would change another state

    @functools.cached_property
    def inverse(self) -> np.ndarray:
        """Inverse of `normal`, whose columns may differ in scale by many orders of magnitude."""
        scale = scales_of(self.normal)
        return np.asarray(scale[:, None] * np.linalg.pinv(self.normal * np.outer(scale, scale), rcond=1e-13, hermitian=True) * scale)

    def products(self, runs: Sequence[Sequence[slice]]) -> np.ndarray:
        """J'J over the rows of each run (run, column, column); cached. `runs` are the row slices of each run."""
        key = tuple(tuple((rows.start, rows.stop) for rows in slices) for slices in runs)
        if key not in self._products:
            self._products[key] = self.jacobian.grams(runs)
        return self._products[key]

    @property
    def prior(self) -> np.ndarray:
        """Prior weight of each column (column,): that of the tolerance for a nuisance, almost zero for a free column."""
        return np.concatenate([np.full(len(self.nuisances), self.prior_weight), self.further])

    @property
    def are_imperfections(self) -> np.ndarray:
        """Mask (nuisance,) of the normal imperfections."""
        return np.array([n.is_imperfection for n in self.nuisances], bool)

    @property
    def of_nuisances(self) -> Columns:
        """The columns of the nuisances."""
        return self.jacobian.chosen(range(len(self.nuisances)))

    @property
    def others(self) -> Columns:
        """The further columns."""
        return self.jacobian.chosen(range(len(self.nuisances), len(self.jacobian)))

    def with_nuisances(self, nuisances: Sequence[Nuisance], columns: Columns) -> Tuning:
        """The tuning with other nuisances, whose response at their spread is `columns`, and the same further columns."""
        return tuning_from(nuisances, columns.beside(self.others), self.spread, self.prior_weight, self.further)

    def with_free(self, columns: Columns, prior: float = FREE) -> Tuning:
        """The tuning with further columns whose coefficients are free: linear responses to effects."""
        if not len(columns):
            return self
        cross = self.jacobian.onto(columns)
        own = columns.gram() + prior * np.eye(len(columns))
        further = np.concatenate([self.further, np.full(len(columns), prior)])
        normal = np.block([[self.normal, cross], [cross.T, own]])
        return Tuning(self.nuisances, self.jacobian.beside(columns), self.spread, normal, self.base, self.prior_weight, further)

    def holding(self, columns: Sequence[int]) -> Tuning:
        """The tuning with some of its further columns, counted from the first of them, held at zero; it shares the jacobian."""
        own = np.array(columns, int)
        at = own + len(self.nuisances)
        weight = HELD * np.maximum(np.diag(self.normal)[at], FREE)
        normal, further = self.normal.copy(), self.further.copy()
        normal[at, at] += weight
        further[own] += weight
        return replace(self, normal=normal, further=further)

    def with_prior(self, weight: float) -> Tuning:
        """The tuning with another prior weight of the nuisances; it shares the jacobian."""
        normal, n = self.normal.copy(), range(len(self.nuisances))
        normal[n, n] += weight - self.prior_weight
        return replace(self, normal=normal, prior_weight=weight)

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """Coefficients (column,), in spreads for the nuisances, that fit a residual best."""
        return np.asarray(self.inverse @ self.jacobian.onto(residual))

    def inner(self, a: Columns, b: np.ndarray | Columns, of_a: np.ndarray, of_b: np.ndarray) -> np.ndarray:
        """a' P b for columns, P the projection that eliminates the tuning; `of_a` is J'a, `of_b` is J'b."""
        return np.asarray(a.onto(b) - of_a.T @ self.inverse @ of_b)

    def loss(self, residual: np.ndarray, projected: np.ndarray | None = None) -> float:
        """Half the squared residual, plus the prior, after re-tuning. `projected` is J' residual if it is known."""
        projected = self.jacobian.onto(residual) if projected is None else projected
        return 0.5 * float(residual @ residual - projected @ self.inverse @ projected)

    def with_column(self, nuisance: Nuisance, column: np.ndarray) -> Tuning:
        """The tuning with one more nuisance, whose response at its spread is `column` (row,)."""
        return self.with_nuisances([*self.nuisances, nuisance], self.of_nuisances.beside(Columns([column], len(column))))

    def reweighted(self, scale: np.ndarray) -> Tuning:
        """The same tuning with each row weight multiplied by `scale` (row,)."""
        columns = self.jacobian.scaled(scale)
        return replace(tuning_from(self.nuisances, columns, self.spread, self.prior_weight, self.further), base=self.base)


def tuning_of(group: Group, settings: Sequence[Setting] = (), response: np.ndarray | float = 0.0, key: Hashable = None) -> Tuning:
    """The tuning of all toleranced parameters of the machine with these effects, whose own response is `response` (row,); `key` as in `linearised`."""
    nuisances = nuisances_of(group.machine, group.axes)
    spread = group.machine.parameter_tolerance * UNIFORM
    if spread <= 0.0:
        nuisances = ()
    columns = Columns([np.zeros(group.size)] * len(nuisances), group.size)
    nothing = tuning_from(nuisances, columns, spread).with_free(zeros_of(group), 1.0)  # encoder zeros are further columns
    return linearised(nothing, group, settings, response, key=key)


def linearised(
    tuning: Tuning,
    group: Group,
    settings: Sequence[Setting],
    response: np.ndarray | float,
    only_imperfections: bool = False,
    key: Hashable = None,
) -> Tuning:
    """The tuning with the simulated response to its nuisances on the machine with these effects, or to its normal imperfections only.

    The simulations are remembered under a key of the machine, if one is given.
    The response depends on the effects: with backlash, for example, the load changes sides later.
    """
    own, steps, variations, keys = moved_by(settings, group.axes), {}, [], []
    for i, nuisance in enumerate(tuning.nuisances):
        if only_imperfections and not nuisance.is_imperfection:
            continue
        steps[i] = max(T.nearby, tuning.spread)
        if nuisance.quantity == "damping":
            steps[i] = T.nearby * group.machine.parameter_tolerance
        elif nuisance.is_imperfection:  # narrower than the width of the mode, and above the smallest size that is applied
            steps[i] = max(2.0 * T.nearby * abs(float(tuning.base[i])), 1.05 * T.doubt * group.machine.parameter_tolerance)
        axes = tuple(a for a in group.axes if a in own or a in nuisance.axes(group.axes))
        shaken = nuisance.quantity == "slip"  # creep is only visible with noise in the loop
        variations.append(Variation(functools.partial(nuisance.apply, factor=1.0 + steps[i]), settings, axes, shaken))
        keys.append(None if key is None else (key, nuisance))
    if not steps:
        return tuning
    if creeping := {axis for variation in variations if variation.shaken for axis in variation.axes}:
        variations.append(Variation(None, settings, tuple(a for a in group.axes if a in creeping), True))
        keys.append(None)
    answers = all_or_raise(group.responses(variations, keys=keys))
    columns: list[np.ndarray | Column] = list(tuning.of_nuisances.each)
    for (i, step), variation, changed in zip(steps.items(), variations, answers):
        columns[i] = (changed - (answers[-1] if variation.shaken else response)) * (tuning.spread / step)
    return replace(tuning.with_nuisances(tuning.nuisances, Columns(columns, group.size)), base=tuning.base)


def moved_by(settings: Sequence[Setting], axes: Sequence[str]) -> tuple[str, ...]:
    """Axes on which effects act. In the decoupled plant this is their own axis, unless they edit bodies, which all of `axes` carry."""
    return tuple(axes if any(s.effect.edits_bodies for s in settings) else dict.fromkeys(s.axis for s in settings))


def zeros_of(group: Group) -> Columns:
    """Responses, weighted, to a constant between motor encoder and scale in each run: encoders have no common zero.

    A law that restarts at zero in each run differs by this constant alone from a law that keeps its phase.
    """
    return Columns((_with_zeros(group, channels, zeros) for channels, when in _encoders(group) for zeros in _no_trend(when)), group.size)


def trends_of_zeros(group: Group, zeros: np.ndarray) -> Columns:
    """Response, weighted, to the trend over the start times that the fitted coefficients `zeros` of `zeros_of` would show by chance, one for each axis.

    Growth of the screw is told from the zeros by its trend alone. How an axis stuck at the start displaces each run, too, so the zeros scatter
    about the trend, and this scatter limits what is known of the growth. The trend has the size of Student's t over that of a normal distribution.
    """
    columns, first = [], 0
    for channels, when in _encoders(group):
        basis = _no_trend(when)
        offsets = zeros[first : first + len(basis)] @ basis
        first += len(basis)
        freedom = len(channels) - TREND
        if when.any():
            views, axis = [group.views[c.run] for c in channels], group.machine.axis(channels[0].axis)
            scatter = float(np.linalg.norm(beside_place(views, axis, offsets))) / math.sqrt(freedom) * quantile(freedom) / NORMAL_95
            columns.append(_with_zeros(group, channels, scatter / np.linalg.norm(when) * when))
    return Columns(columns, group.size)


def _encoders(group: Group) -> Iterator[tuple[list[Channel], np.ndarray]]:
    """The channels of two encoders of each axis, and the times (channel,) [s] over which a trend of them is growth, not an encoder zero."""
    for name in group.axes:
        if channels := [c for c in group.channels if (c.axis, c.name) == (name, "motor_minus_scale")]:
            yield channels, growth_times([group.views[c.run] for c in channels], group.machine.axis(name))


def _no_trend(when: np.ndarray) -> np.ndarray:
    """(zeros, channel) Differences of encoder zeros without a trend, orthogonal and of length 1."""
    return np.asarray(null_space(when[None, :]).T if when.any() else np.eye(len(when)))


def _with_zeros(group: Group, channels: Sequence[Channel], zeros: np.ndarray) -> np.ndarray:
    """Response (row,), weighted, to a constant in each of the channels [um or arcsec]."""
    column = np.zeros(group.size, np.float32)
    for channel, zero in zip(channels, zeros):
        column[channel.rows] = (ARCSEC if group.machine.axis(channel.axis).kind == "rotary" else 1e-6) * zero * channel.weight
    return column


class Trial(NamedTuple):
    """One more nuisance next to a tuning: its response at its spread (row,), the gain in loss, and its best size (1: largest normal size)."""

    column: np.ndarray
    gain: float
    size: float


def trial_of(tuning: Tuning, column: np.ndarray, residual: np.ndarray) -> Trial:
    """The gain of a nuisance with response `column` (row,) at its spread, for a residual (row,), next to the tuning."""
    one, projected = column.astype(float), tuning.jacobian.onto(column)
    removed = tuning.inverse @ projected
    slope = float(one @ residual - removed @ tuning.jacobian.onto(residual))
    curvature = float(one @ one - removed @ projected) + tuning.prior_weight
    return Trial(column, 0.5 * slope**2 / curvature, slope / curvature * UNIFORM)


def tuning_from(
    nuisances: Sequence[Nuisance], jacobian: Columns, spread: float, prior_weight: float | None = None, further: np.ndarray | None = None
) -> Tuning:
    """A tuning from nuisances and `jacobian`, their weighted response at their spread. Columns beyond the nuisances are free."""
    prior_weight = T.prior_weight if prior_weight is None else prior_weight
    further = np.zeros(0) if further is None else further
    normal = jacobian.gram() + np.diag(np.concatenate([np.full(len(nuisances), prior_weight), further]))
    return Tuning(tuple(nuisances), jacobian, spread, normal, np.zeros(len(nuisances)), prior_weight, further)


def scales_of(normal: np.ndarray) -> np.ndarray:
    """Factors (column,) that make the columns of normal equations equally long."""
    return np.asarray(1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300)))


def solved(normal: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least-squares solution of normal x = right, (column,) or (column, n), with the columns scaled to equal size."""
    scale = scales_of(normal)
    return np.asarray((scale * np.linalg.lstsq(normal * np.outer(scale, scale), (scale * right.T).T, rcond=1e-12)[0].T).T)
