"""Laws and effects of one axis in closed loop: the fit of the search, and what a set of them costs.

    cost = sum over channels of n/2 log(1 + S) + price of each term + price of the claim that a law acts          [nat]

S is the mean square over that of noise on runs left out, n the number of independent samples of a channel, at most `shapes`: a model error is
correlated over many samples. It is the negative log density with a model error of unknown size. A channel whose noise is overestimated
(S < 1) counts little. A law or an effect stays if it lowers the cost; the cheaper of two sets is kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
from types import MappingProxyType

import numpy as np

from twin.diagnose.columns import Column
from twin.diagnose.cross_validation import linear_in
from twin.diagnose.fit import Fit, Settings, Slope, fits_together, fitting, simulated_response
from twin.diagnose.law.residual import ONE_RUN
from twin.diagnose.observe import Group
from twin.diagnose.plausible import is_plausible
from twin.diagnose.settings import T
from twin.diagnose.state import inflation
from twin.diagnose.tolerance import SPRING_EFFECT
from twin.diagnose.tuning import Tuning, tuning_of, zeros_of
from twin.effects import Setting
from twin.effects.law import laws_in
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.estimate.regression import NORMAL_95

OUTSIDE = 16.0
"""Price of the claim that something outside the library acts at all [nat]; the laws themselves cost as much as effects, `evidence`."""

IMPOSSIBLE = 1e6
"""Cost of a term that cannot be there [nat]: more than any misfit."""

FEW_STEPS = 2
"""Steps of a fit that starts near its optimum."""

SHORTEST_REST_S = 5e-3
"""An axis sticks during a rest of at least this length. A shorter rest is a reversal without a stop: its motion is not random, and shows laws of friction."""


@dataclass(frozen=True)
class AxisFit:
    """Laws and effects of an axis fitted together: held-out loss (half the squares), misfit (the first sum of the cost), and cost."""

    fit: Fit
    held_out: float
    misfit: float
    cost: float
    inflation: float

    @property
    def settings(self) -> Settings:
        return self.fit.settings

    def deviations(self, key: Key, model_error: float = 0.0) -> dict[str, float]:
        """Standard deviations of the fitted parameters of a setting; `model_error` is a relative error that does not fall with the number of samples."""
        out = {}
        for (of, name), (free, deviation) in self.fit.sizes()._replace(prior_weight=1.0).deviations(self.inflation).items():
            if of == key:
                value = free.value(self.settings)
                out[name] = math.hypot(deviation * free.step(value), model_error * value)
        return out


@dataclass(frozen=True)
class ClosedLoop:
    """One axis of a group about the machine file, without the encoder zeros of each run. Each part of the record is predicted from all others:
    `parts` are the rows of each, `halved` is the fold that was halved, if any.

    `group` weighs its rows as evidence of laws. If it shakes, all simulations have the same noise in the loop: an axis that slips before
    break-away needs it, and so does a set of effects without slip that is compared with a set that has slip.
    """

    group: Group
    axis: str
    parts: tuple[tuple[slice, ...], ...]
    halved: int | None = None

    @functools.cached_property
    def own(self) -> np.ndarray:
        """Mask (row,) of the rows of the axis."""
        return np.concatenate([np.full(len(c.residual), c.axis == self.axis) for c in self.group.channels])

    @functools.cached_property
    def expected(self) -> float:
        """Half the expected squares of the axis from noise."""
        return 0.5 * float(self.group.expected @ self.own)

    @functools.cached_property
    def zeros(self) -> np.ndarray:
        """Orthonormal response (row, n) to the encoder zeros. Each run has its own; no other run predicts them."""
        columns = zeros_of(self.group)
        seen = columns.chosen(i for i, column in enumerate(columns.each) if len(column.values))
        return np.asarray(np.linalg.qr(seen.part())[0])

    @property
    def only_fold(self) -> int | None:
        """The fold that was halved because no other one shows the gap; None for a single fold, which is always halved."""
        return self.halved if len(self.parts) > 2 else None

    def start(self, settings: Settings) -> AxisFit | None:
        """The fit from these settings on the machine file, re-tuned with their slopes; None if they cannot be simulated."""
        key = "start", repr([s.table() for s in settings])  # the same with other weights
        try:
            response = simulated_response(self.group, settings, key) if settings else np.zeros(self.group.size)
            tuning = tuning_of(self.group, settings, response, key)
        except TwinError:
            return None
        return self._fitted([settings], tuning, self.group.residual - response, FEW_STEPS)[0]

    def refits(self, like: AxisFit, several: Sequence[Settings], steps: int | None = None) -> list[AxisFit | None]:
        """The fits from several settings, with the tuning and the known slopes of a fit; None for one that cannot be simulated."""
        return self._fitted(several, like.fit.about, like.fit.residual(self.group), steps, like.fit.slopes)

    def _fitted(
        self,
        several: Sequence[Settings],
        tuning: Tuning,
        residual: np.ndarray,
        steps: int | None,
        known: Mapping[Slope, Column] = MappingProxyType({}),
    ) -> list[AxisFit | None]:
        # what no law explains yet, also on other axes of the group, is model error, and must not pull a parameter out of its tolerance
        unexplained = max(self._inflation(residual), inflation(self.group, residual))
        tuning = tuning.with_prior(T.prior_weight * unexplained)
        fits = [
            fitting(
                self.group, tuning, settings, steps, moving={i for i, s in enumerate(settings) if self._is_free(s, settings)}, known=known
            )
            for settings in several
        ]
        return [None if fit is None else self.with_cost(fit) for fit in fits_together(self.group, fits)]

    def _is_free(self, setting: Setting, settings: Settings) -> bool:
        """Normal imperfections keep their sizes. The spring of an axis with a law between its encoders is fitted again with its damping, because
        the search sized both without that law."""
        if setting.axis != self.axis:
            return False
        return not setting.effect.normal or (setting.effect.name == SPRING_EFFECT and any(is_between_encoders(s) for s in settings))

    def with_cost(self, fit: Fit) -> AxisFit:
        """The fit with its cost. A term costs `IMPOSSIBLE` if its size is implausible or may be zero."""
        group = self.group
        left = linear_in(group, fit, self.parts).held_out([[i] for i in range(len(self.parts))], 1.0)
        left -= self.zeros @ (self.zeros.T @ left)
        misfit, held_out = 0.0, 0.0
        for c in group.channels:
            if c.axis == self.axis:
                square, noise = float(left[c.rows] @ left[c.rows]), float(group.expected[c.rows].sum())
                misfit += 0.5 * min(len(c.residual) / c.correlation, T.shapes) * math.log1p(square / noise)
                held_out += 0.5 * square
        fitted = AxisFit(fit, held_out, misfit, 0.0, self._inflation(fit.residual(group)))
        impossible = sum(not self.is_possible(fitted, s) for s in fit.settings if self._is_free(s, fit.settings))
        return replace(fitted, cost=misfit + self.price(fit.settings) + IMPOSSIBLE * impossible)

    def is_possible(self, fitted: AxisFit, setting: Setting) -> bool:
        """Has a setting a plausible size whose 95 % interval excludes that without effect?"""
        size = setting.effect.size
        deviation = fitted.deviations(setting.key).get(size.name, 0.0)
        significant = abs(size.deviation(setting.size)) > NORMAL_95 * deviation
        return significant and (bool(setting.effect.normal) or is_plausible(setting, self.group.machine))

    def price(self, settings: Settings) -> float:
        """Price of laws and effects together [nat]; none for a normal imperfection, which every axis may have."""
        return T.evidence * sum(not s.effect.normal for s in settings) + OUTSIDE * bool(laws_in(settings))

    def above_noise(self, fitted: AxisFit) -> float:
        """Held-out loss above that of noise."""
        return max(fitted.held_out - self.expected, 0.0)

    def is_clean(self, fitted: AxisFit) -> bool:
        """Whether hardly more than noise is left on runs left out."""
        return fitted.held_out < T.clean_square * self.expected

    def _inflation(self, residual: np.ndarray) -> float:
        return max(1.0, 0.5 * float(residual**2 @ self.own) / max(self.expected, 1e-300))

    def halving(self, fold: int, left: np.ndarray) -> ClosedLoop:
        """The closed loop with a fold divided in time so that the halves of each channel share the loss of a residual `left` (row,)."""
        rows = self.parts[fold]
        middles = [r.start + int(np.searchsorted(loss := np.cumsum(left[r] ** 2), 0.5 * loss[-1])) for r in rows]
        halves = (tuple(slice(r.start, m) for r, m in zip(rows, middles)), tuple(slice(m, r.stop) for r, m in zip(rows, middles)))
        return replace(self, parts=(*self.parts[:fold], *halves, *self.parts[fold + 1 :]), halved=fold)

    def halving_its_only_loud_fold(self, fitted: AxisFit) -> ClosedLoop:
        """A closed loop that halves the fold with almost all of the loss above noise; this one if there is none.

        The other runs do not show a law that acts in one run only. There, each half of that run is predicted from everything else.
        """
        if self.halved is not None:
            return self
        left = fitted.fit.residual(self.group)
        excess = (left**2 - self.group.expected) * self.own
        above = [sum(float(excess[r].sum()) for r in rows) for rows in self.parts]
        loudest = int(np.argmax(above))
        if above[loudest] < ONE_RUN * sum(max(a, 0.0) for a in above):
            return self
        return self.halving(loudest, left)


def closed_loop(group: Group, axis: str, folds: Sequence[Sequence[int]], shakes: bool) -> ClosedLoop:
    """The closed loop of an axis of a group that was observed against the machine file."""
    credit = group.credit_after_rests(SHORTEST_REST_S)
    channels = [replace(c, credit=credit[c.rows]) for c in group.channels]
    group = replace(group, channels=channels, shakes=shakes)
    loop = ClosedLoop(group, axis, tuple(tuple(c.rows for c in group.channels if c.run in fold) for fold in folds))
    return loop.halving(0, np.ones(group.size)) if len(folds) == 1 else loop


def is_between_encoders(law: Setting) -> bool:
    """Whether a law changes motor minus scale: by a displacement, or by a force over the windup."""
    return law.effect.definition.get("output") == "displacement" or law.effect.definition.get("variables") == ["windup"]
