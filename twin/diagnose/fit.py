"""Fits in closed loop: effects and toleranced parameters together, by Gauss-Newton on the simulated channels.

    minimise  | z - D(p) - J theta |^2 + w | theta / s |^2

z is the weighted residual of the nominal twin, D(p) the simulated change that the effects with parameters p make, J the
simulated change per toleranced parameter, s their spread. The weight w stands for what many samples do not know: a small fault of
the model is repeated in each of them, and must not pull a parameter beyond its tolerance. theta is eliminated, so that an effect is only credited with
what re-tuning cannot explain.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.simulations import Mapper, in_turn
from twin.diagnose.tolerance import NORMAL
from twin.diagnose.tuning import Tuning, stacked_columns
from twin.effects import Setting
from twin.effects.effect import Parameter
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.simulation.run import all_or_raise

Slope = tuple[tuple[str, str, str | None], str]
"""Effect, axis and from_axis, and the parameter: what a column of a fit is the slope of."""


@dataclass(frozen=True)
class Free:
    """One free parameter of one setting, in a scale in which a step of 1 is of the order of its usual range."""

    setting: int
    parameter: Parameter
    logarithmic: bool
    unit: float

    def value(self, settings: Sequence[Setting]) -> float:
        return settings[self.setting].parameters[self.parameter.name]

    def moved(self, settings: Sequence[Setting], step: float) -> tuple[Setting, ...]:
        """The settings with this parameter moved by `step` scale units, within its bounds."""
        old = self.value(settings)
        new = old * math.exp(step * self.unit) if self.logarithmic else old + step * self.unit
        p = self.parameter
        if p.periodic:
            new %= 2.0 * math.pi
        new = min(max(new, p.low), p.high)
        s = settings[self.setting]
        changed = replace(s, parameters={**s.parameters, p.name: new})
        return tuple(changed if i == self.setting else other for i, other in enumerate(settings))


def free_parameters(settings: Sequence[Setting], machine: Machine, thresholds: Thresholds = DEFAULT) -> list[Free]:
    """What a fit may move: everything that the settings give a number, shapes included."""
    free = []
    for i, setting in enumerate(settings):
        axis = machine.axis(setting.axis)
        size = setting.effect.size
        for p in setting.effect.parameters:
            if p.name not in setting.parameters:
                continue
            value = setting.parameters[p.name]
            low, high = p.usual_range(machine, axis)
            by_ratio = p.logarithmic and value > 0.0 and not (p is size and p.is_factor)
            if by_ratio:
                # a step that shifts the far end of a wave by more than part of a wave has no slope
                waves = p.scan.waves(value, axis, thresholds.wave_run_s) if p.scan else 0.0
                free.append(Free(i, p, True, min(0.15, thresholds.wave_step / max(waves, 1e-9))))
            elif p.periodic:
                free.append(Free(i, p, False, 0.3))
            else:
                span = high - low if math.isfinite(high - low) and high > low else abs(value) or 1.0
                free.append(Free(i, p, False, max(0.2 * span, 1e-12)))
    return free


class Sizes(NamedTuple):
    """Settings of a fit, its free parameters, the information about them (free, free) in scale units, and the weight of the tolerance."""

    settings: tuple[Setting, ...]
    free: tuple[Free, ...]
    information: np.ndarray
    prior_weight: float

    def covariance(self, inflation: float = 1.0) -> np.ndarray:
        """Covariance of the free parameters in scale units.

        The weight that keeps the tolerance from being pulled by many samples keeps this from shrinking with them; what is not modelled
        has `inflation` times the power of noise.
        """
        return np.linalg.pinv(self.information) * self.prior_weight * inflation


@dataclass(frozen=True)
class Fit:
    """Effects fitted to a group: settings, tuning, loss, and what is needed for intervals and for leaving runs out."""

    settings: tuple[Setting, ...]
    free: list[Free]
    loss: float
    tuning: np.ndarray  # in units of the spread
    response: np.ndarray  # D(p), (row,)
    columns: np.ndarray  # dD/dp in scale units, (row, free)
    about: Tuning  # what `tuning` is a tuning of

    @property
    def slopes(self) -> dict[Slope, np.ndarray]:
        """The columns by effect and parameter, for a fit next to this one."""
        return {(self.settings[f.setting].key, f.parameter.name): self.columns[:, i] for i, f in enumerate(self.free)}

    @property
    def retuning(self) -> np.ndarray:
        """What the tuning changes (row,)."""
        return self.about.jacobian @ self.tuning

    def residual(self, group: Group) -> np.ndarray:
        """What effects and tuning leave of a group's residual (row,), weighted."""
        return group.residual - self.response - self.retuning

    def reweighted(self, scale: np.ndarray, about: Tuning, residual: np.ndarray) -> Fit:
        """The same settings where every row weighs `scale` (row,) times as much, with tuning and residual (row,) weighed like that."""
        response = self.response * scale
        left = residual - response
        tuning, loss = about.solve(left), about.loss(left)
        return replace(self, response=response, columns=self.columns * scale[:, None], about=about, tuning=tuning, loss=loss)

    @property
    def linear_effect_slopes(self) -> dict[Slope, np.ndarray]:
        """Those of them that hold elsewhere, too."""
        return slopes_of_linear_effects(self.slopes, self.settings)

    def sizes(self) -> Sizes:
        """What is known of the free parameters, without the rows that it was found from."""
        return Sizes(self.settings, tuple(self.free), self.information(), self.about.prior_weight)

    def information(self) -> np.ndarray:
        """Information of the channels about the free parameters (free, free) in scale units, tuning eliminated."""
        return self.about.inner(self.columns, self.columns) + 1e-9 * np.eye(len(self.free))


def slopes_of_linear_effects(slopes: Mapping[Slope, np.ndarray], settings: Sequence[Setting]) -> dict[Slope, np.ndarray]:
    """The slopes of effects in proportion to their size; those of the others hold nowhere but where they were taken."""
    keys = {s.key for s in settings if s.effect.is_linear}
    return {name: column for name, column in slopes.items() if name[0] in keys}


def no_effect(group: Group, tuning: Tuning) -> Fit:
    """Re-tuning alone."""
    return fit_with_fixed_effects(group, tuning, (), np.zeros(group.size))


def fit_with_fixed_effects(group: Group, tuning: Tuning, settings: tuple[Setting, ...], response: np.ndarray) -> Fit:
    """Re-tuning beside effects that stay as they are and change the channels by `response` (row,)."""
    residual = group.residual - response
    return Fit(settings, [], tuning.loss(residual), tuning.solve(residual), response, np.zeros((group.size, 0)), tuning)


def fit_effects(
    group: Group,
    machine: Machine,
    tuning: Tuning,
    settings: Sequence[Setting],
    mapper: Mapper,
    steps: int | None = None,
    narrowest: float | None = None,
    moving: Collection[int] | None = None,
    known: Mapping[Slope, np.ndarray] = MappingProxyType({}),
    residual: np.ndarray | None = None,
) -> Fit | None:
    """Gauss-Newton from these settings; None where they cannot be simulated. `mapper` maps over threads.

    Slopes are taken over `slope` and then over the last move, at least `narrowest`: what is known to a thousandth needs them there.
    `steps` and `narrowest` left out are those of the thresholds. `moving`: the settings whose parameters move, all by default; the others
    stay as they are, and stand in the tuning as free columns where they may answer. `known` slopes (row,), from a fit next to this one, are
    taken again only where they do not hold what they promise. `residual` (row,) is what is to be explained, that of the group by default.
    """
    settings, t = tuple(settings), group.thresholds
    residual = group.residual if residual is None else residual
    narrowest = t.narrow_slope if narrowest is None else narrowest
    if not settings:
        return no_effect(group, tuning)
    try:
        response = simulated_response(group, settings, mapper)
    except TwinError:
        return None
    best = tuning.loss(residual - response)
    free = [f for f in free_parameters(settings, machine, t) if moving is None or f.setting in moving]
    columns, reach = (
        stacked_columns(*(known.get(_name(f, settings), np.zeros(group.size))[:, None] for f in free)),
        np.full(len(free), t.slope),
    )
    asked = [i for i, f in enumerate(free) if _name(f, settings) not in known]
    for _ in range(t.fit_steps if steps is None else steps):
        try:
            for i, column in zip(asked, _slopes(group, settings, response, [(free[i], reach[i]) for i in asked], mapper)):
                columns[:, i] = column
        except TwinError:
            return None
        information = tuning.inner(columns, columns) + 1e-6 * np.eye(len(free))
        gradient = tuning.inner(columns, (residual - response)[:, None])[:, 0]
        move = np.clip(np.linalg.solve(information, gradient), -t.largest_step, t.largest_step)
        lower = _lower(group, residual, tuning, settings, free, move, best, mapper)
        if lower is not None:
            gain, promised = best - lower.loss, _promised(gradient, information, lower.move)
            best, settings, response = lower.loss, lower.settings, lower.response
            reach = np.clip(np.abs(lower.move), narrowest, t.slope)
            if gain < t.converged * max(1.0, 0.002 * best):
                break
            # slopes that promise what they hold serve for the next step, too, and so do those that promise nothing that decides
            holds = gain > t.slopes_hold * promised or promised - gain < t.price
            asked = [] if holds else list(range(len(free)))
        elif len(asked) < len(free):
            if _promised(gradient, information, move) < t.price:
                break
            asked = list(range(len(free)))  # slopes from elsewhere led nowhere
        elif best < t.above_noise * group.expected_loss or np.all(reach <= narrowest):
            break
        else:
            reach = np.full(len(free), narrowest)
    return Fit(settings, free, best, tuning.solve(residual - response), response, columns, tuning)


def _promised(gradient: np.ndarray, information: np.ndarray, move: np.ndarray) -> float:
    """By how much the slopes say that a move lowers the loss."""
    return float(gradient @ move - 0.5 * move @ information @ move)


def _name(free: Free, settings: Sequence[Setting]) -> Slope:
    return (settings[free.setting].key, free.parameter.name)


class _Lower(NamedTuple):
    loss: float
    settings: tuple[Setting, ...]
    response: np.ndarray
    move: np.ndarray


def _lower(
    group: Group,
    residual: np.ndarray,
    tuning: Tuning,
    settings: tuple[Setting, ...],
    free: Sequence[Free],
    move: np.ndarray,
    best: float,
    mapper: Mapper,
) -> _Lower | None:
    """Where a move, or a part of it, leaves less than `best`."""
    for part in (1.0, 0.4, 0.1):
        tried = settings
        for f, m in zip(free, part * move):
            tried = f.moved(tried, float(m))
        try:
            response = simulated_response(group, tried, mapper)
        except TwinError:
            continue
        loss = tuning.loss(residual - response)
        if loss < best:
            return _Lower(loss, tried, response, part * move)
    return None


def simulated_response(group: Group, settings: Sequence[Setting], mapper: Mapper = in_turn) -> np.ndarray:
    """Simulated change of the group's channels by these effects (row,); `mapper` maps over simulations."""
    return all_or_raise(simulated_responses(group, [settings], mapper))[0]


def simulated_responses(group: Group, several: Sequence[Sequence[Setting]], mapper: Mapper = in_turn) -> list[np.ndarray | TwinError]:
    """The answer to each of several sets of effects, or the error of one that cannot be simulated."""
    moved = [_moved_by(settings, group) for settings in several]
    return group.responses([Variation(None, s, tuple(a for a in group.axes if a in own)) for s, own in zip(several, moved)], mapper=mapper)


def _moved_by(settings: Sequence[Setting], group: Group) -> set[str]:
    """Axes that effects change: in the decoupled plant their own only, unless they edit bodies that several axes carry."""
    return set(group.axes) if any(s.effect.edits_bodies for s in settings) else {s.axis for s in settings}


def relinearised_tuning(group: Group, fit: Fit, machine: Machine, mapper: Mapper, only: Collection[str] = ()) -> Tuning:
    """The tuning of a fit as it acts on the machine that has the fit's effects: they decide when a load changes sides.

    Or that of these quantities `only`.
    """
    if not fit.about.nuisances:
        return fit.about
    t = group.thresholds
    tuning, own = fit.about, _moved_by(fit.settings, group)

    steps, variations = {}, []
    for i, nuisance in enumerate(tuning.nuisances):
        if nuisance.quantity == "slip" or (only and nuisance.quantity not in only):  # what creeps shows in shaken simulations alone
            continue
        step = max(t.nearby, tuning.spread)
        if nuisance.quantity == "damping":
            step = t.nearby * machine.parameter_tolerance
        elif nuisance.quantity in NORMAL:  # a mode is as wide as its damping, and what is smaller than the least stays out of a machine
            step = max(t.within_mode * abs(float(tuning.base[i])), 1.05 * t.least_imperfection * machine.parameter_tolerance)
        steps[i] = step
        axes = tuple(a for a in group.axes if a in own or a in nuisance.axes(group.axes))
        variations.append(Variation(functools.partial(nuisance.apply, factor=1.0 + step), fit.settings, axes))
    columns = np.asfortranarray(tuning.jacobian[:, : len(tuning.nuisances)])
    for (i, step), changed in zip(steps.items(), all_or_raise(group.responses(variations, mapper=mapper))):
        columns[:, i] = (changed - fit.response) * (tuning.spread / step)
    return replace(tuning.of(tuning.nuisances, columns), base=tuning.base)


def _slopes(
    group: Group, settings: tuple[Setting, ...], response: np.ndarray, asked: Sequence[tuple[Free, float]], mapper: Mapper
) -> list[np.ndarray]:
    """Change per scale unit of each parameter, over a step of so many, towards the inside of the bounds."""
    steps = []
    for f, reach in asked:
        both = [(moved, _distance(f, settings, moved)) for moved in (f.moved(settings, step) for step in (reach, -reach))]
        steps.append(next(((moved, actual) for moved, actual in both if abs(actual) > 1e-6), None))
    changed = iter(all_or_raise(simulated_responses(group, [step[0] for step in steps if step is not None], mapper)))
    return [np.zeros(group.size) if step is None else (next(changed) - response) / step[1] for step in steps]


def _distance(f: Free, before: Sequence[Setting], after: Sequence[Setting]) -> float:
    """How far a parameter moved, in scale units."""
    a, b = f.value(before), f.value(after)
    if f.logarithmic:
        return math.log(b / a) / f.unit if a > 0 and b > 0 else 0.0
    difference = b - a
    if f.parameter.periodic:
        difference = (difference + math.pi) % (2 * math.pi) - math.pi
    return difference / f.unit
