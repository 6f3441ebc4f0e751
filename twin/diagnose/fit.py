"""Fits in closed loop: effects and toleranced parameters together, by Gauss-Newton on the simulated channels.

    minimise  | z - D(p) - J theta |^2 + w | theta / s |^2

z is the weighted residual of the nominal twin, D(p) the simulated response to effects with parameters p, J the simulated response to
toleranced parameters, s their spread. The weight w accounts for model error: it repeats in every sample and must not pull a parameter out
of its tolerance. theta is eliminated, so that an effect is credited only with what re-tuning cannot explain.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
import functools
import itertools
import math
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from twin.diagnose.columns import Column, Columns, column_of
from twin.diagnose.observe import Group, Variation
from twin.diagnose.settings import T
from twin.diagnose.tuning import Tuning, moved_by
from twin.effects import Setting
from twin.effects.effect import Parameter
from twin.effects.law import NAME
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.machine.machine import Axis, Machine
from twin.simulation.run import all_or_raise

Slope = tuple[Key, str]
"""Key of a column of a fit: that of the effect, and the parameter."""

Settings = tuple[Setting, ...]
Responses = list[np.ndarray | TwinError]
Answer = TypeVar("Answer")
Asks = Generator[list[Settings], Responses, Answer]
"""A calculation that yields settings, receives their simulated responses, and ends with an answer."""


@dataclass(frozen=True)
class Free:
    """A free parameter of a setting, scaled so that a step of 1 is of the order of its usual range."""

    setting: int
    parameter: Parameter
    logarithmic: bool
    unit: float
    farthest: float = 6.0
    """Largest change in one step, in scale units."""

    def value(self, settings: Sequence[Setting]) -> float:
        return settings[self.setting].parameters[self.parameter.name]

    def step(self, value: float) -> float:
        """The scale unit at a value of the parameter."""
        return self.unit * (abs(value) if self.logarithmic else 1.0)

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
        if is_play(s):
            changed = replace(s, parameters={**changed.parameters, "height": math.copysign(new, s.parameters["height"])})
        return tuple(changed if i == self.setting else other for i, other in enumerate(settings))


def relative_step(parameter: Parameter, value: float, axis: Axis, most: float) -> float:
    """Relative step of a parameter for its slope, at most `most`.

    The step of a wavelength or frequency shifts the end of the record by a small part of a wave, or the slope would not be valid.
    """
    return min(most, T.wave_step / max(parameter.waves(value, axis), 1e-9))


def free_parameters(settings: Sequence[Setting], machine: Machine) -> list[Free]:
    """All parameters that have a value in the settings, shapes of effects included."""
    free = []
    for i, setting in enumerate(settings):
        axis = machine.axis(setting.axis)
        own = [p for p in setting.effect.parameters if p.name in setting.parameters]
        if setting.effect.name == NAME:
            free += [f for p in own if (f := _free_of_law(i, p, setting, axis)) is not None]
            continue
        size = setting.effect.size
        for p in own:
            value = setting.parameters[p.name]
            low, high = p.usual_range(machine, axis)
            by_ratio = p.logarithmic and value > 0.0 and not (p is size and p.is_factor)
            if by_ratio:
                free.append(Free(i, p, True, relative_step(p, value, axis, 0.15)))
            elif p.periodic:
                free.append(Free(i, p, False, 0.3))
            else:
                span = high - low if math.isfinite(high - low) and high > low else abs(value) or 1.0
                free.append(Free(i, p, False, max(0.2 * span, 1e-12)))
    return free


LAW_STEP, LAW_ANGLE, LAW_MOVE = 0.03, 0.1, 0.5
"""Scale unit of a number of a law, relative or [rad], and its largest relative change in one step if the law is not proportional to it."""


def is_play(law: Setting) -> bool:
    """Is this the law of a play: a displacement that follows the load up to `height` within a travel of `length`? The two are equal."""
    return law.effect.definition.get("variables") == ["slack"] and "height" in law.parameters


def _free_of_law(i: int, p: Parameter, law: Setting, axis: Axis) -> Free | None:
    """A number of a law. None for zero, a number that the shape does not use, and for one of the two equal numbers of a play."""
    value = law.parameters[p.name]
    if p.periodic:
        return Free(i, p, False, LAW_ANGLE)
    if value == 0.0 or p.shape or not math.isfinite(value) or (is_play(law) and p.name != "length"):
        return None
    unit = relative_step(p, value, axis, LAW_STEP)
    positive = value > 0.0 and (p.logarithmic or p.low >= 0.0)
    proportional = not positive and law.effect.is_linear and p is law.effect.size
    return Free(i, p, positive, unit * (1.0 if positive else abs(value)), math.inf if proportional else LAW_MOVE / LAW_STEP)


class Sizes(NamedTuple):
    """Settings of a fit, free parameters, their information matrix (free, free) in scale units, the prior weight of the tolerance, and `Fit.shifts`."""

    settings: tuple[Setting, ...]
    free: tuple[Free, ...]
    information: np.ndarray
    prior_weight: float
    shifts: np.ndarray

    def deviations(self, inflation: float = 1.0) -> dict[Slope, tuple[Free, float]]:
        """Each free parameter with its standard deviation in scale units.

        The prior weight keeps it from shrinking with the number of samples, because model error is the same in all of them. `inflation` is the
        loss of the fit over that of noise.
        """
        variances = np.diag(np.linalg.pinv(self.information)) * self.prior_weight * inflation + (self.shifts**2).sum(axis=1)
        return {_name(f, self.settings): (f, math.sqrt(max(float(v), 0.0))) for f, v in zip(self.free, variances)}


@dataclass(frozen=True)
class Fit:
    """Effects fitted to a group: settings, tuning, loss, and the columns needed for intervals and cross-validation."""

    settings: tuple[Setting, ...]
    free: list[Free]
    loss: float
    coefficients: np.ndarray  # of the columns of the tuning (column,), theta first
    response: np.ndarray  # D(p), (row,)
    columns: Columns  # dD/dp in scale units, one for each free parameter
    about: Tuning  # the re-tuning that the fit allows
    chances: Columns | None = None  # responses, of one standard deviation each, to what no channel tells from an effect: a trend of zeros

    @property
    def slopes(self) -> dict[Slope, Column]:
        """Columns by effect and parameter, as starting slopes for another fit."""
        return {_name(f, self.settings): column for f, column in zip(self.free, self.columns.each)}

    @property
    def theta(self) -> np.ndarray:
        """Deviations of the nuisances (nuisance,), in units of the spread."""
        return self.coefficients[: len(self.about.nuisances)]

    def residual(self, group: Group) -> np.ndarray:
        """Residual of a group after effects and tuning (row,), weighted."""
        return group.residual - self.response - self.about.jacobian.times(self.coefficients)

    def reweighted(self, scale: np.ndarray, about: Tuning, residual: np.ndarray) -> Fit:
        """The same settings with each row weight multiplied by `scale` (row,); `about` and `residual` (row,) are already reweighted."""
        response = self.response * scale
        left = residual - response
        coefficients, loss = about.solve(left), about.loss(left)
        chances = None if self.chances is None else self.chances.scaled(scale)
        columns = self.columns.scaled(scale)
        return replace(self, response=response, columns=columns, about=about, coefficients=coefficients, loss=loss, chances=chances)

    def sizes(self) -> Sizes:
        """The free parameters with their information, without the rows."""
        return Sizes(self.settings, tuple(self.free), self.information, self.about.prior_weight, self.shifts)

    @functools.cached_property
    def projected(self) -> np.ndarray:
        """Inner products of the columns of the tuning with those of the free parameters (column, free)."""
        return self.about.jacobian.onto(self.columns)

    @functools.cached_property
    def information(self) -> np.ndarray:
        """Information matrix of the free parameters (free, free) in scale units, tuning eliminated."""
        return self.about.inner(self.columns, self.columns, self.projected, self.projected) + 1e-9 * np.eye(len(self.free))

    @functools.cached_property
    def shifts(self) -> np.ndarray:
        """(free, chance) How far one standard deviation of each of the chances moves the free parameters, in scale units."""
        if not self.chances or not self.free:
            return np.zeros((len(self.free), 0))
        towards = self.about.inner(self.columns, self.chances, self.projected, self.about.jacobian.onto(self.chances))
        return np.asarray(np.linalg.solve(self.information, towards))


def slopes_of_linear_effects(slopes: Mapping[Slope, Column], settings: Sequence[Setting]) -> dict[Slope, Column]:
    """Slopes of effects that are linear in their size. Slopes of other effects are only valid where they were computed."""
    keys = {s.key for s in settings if s.effect.is_linear}
    return {name: column for name, column in slopes.items() if name[0] in keys}


def no_effect(group: Group, tuning: Tuning) -> Fit:
    """A fit of re-tuning alone."""
    return fit_with_fixed_effects(group, tuning, (), np.zeros(group.size))


def fit_with_fixed_effects(group: Group, tuning: Tuning, settings: tuple[Setting, ...], response: np.ndarray) -> Fit:
    """A fit of re-tuning with fixed effects whose response is `response` (row,)."""
    residual = group.residual - response
    return Fit(settings, [], tuning.loss(residual), tuning.solve(residual), response, Columns([], group.size), tuning)


def fits_together(group: Group, fits: Sequence[Asks[Fit | None]]) -> list[Fit | None]:
    """Several fits to one group, or None for one that cannot be simulated. What all of them need next is simulated in one batch."""
    results: list[Fit | None] = [None] * len(fits)
    waiting: dict[int, list[Settings]] = {}

    def go_on(i: int, responses: Responses | None) -> None:
        try:
            waiting[i] = next(fits[i]) if responses is None else fits[i].send(responses)
        except StopIteration as stop:
            results[i] = stop.value
        except TwinError:
            results[i] = None

    for i in range(len(fits)):
        go_on(i, None)
    while waiting:
        asked, waiting = waiting, {}
        responses = iter(simulated_responses(group, [settings for wanted in asked.values() for settings in wanted]))
        for i, wanted in asked.items():
            go_on(i, list(itertools.islice(responses, len(wanted))))
    return results


DEVIATIONS, LEAST_STEP = 10.0, 1e-3
"""Smallest finite-difference step of a parameter in its standard deviations beside noise alone, and in scale units."""


def fitting(
    group: Group,
    tuning: Tuning,
    settings: Sequence[Setting],
    steps: int | None = None,
    narrowest: float | None = None,
    moving: Collection[int] | None = None,
    known: Mapping[Slope, Column] = MappingProxyType({}),
    residual: np.ndarray | None = None,
) -> Asks[Fit | None]:
    """Gauss-Newton from these settings; None, or a TwinError, if they cannot be simulated. It yields the settings whose responses it needs next.

    Finite-difference steps start at one scale unit, because a break-away moves by whole samples, and then follow the last move. They end at
    `narrowest`. Its default is the threshold, or less for a parameter that the record determines better: a slope over more than the error of a
    loud effect ends the fit beside its optimum. `steps` defaults to the threshold. `moving` are the indices of the settings that are fitted
    (default: all); the others are fixed. `known` slopes (row,) from a nearby fit are recomputed only if their predicted gain does not come true.
    `residual` (row,) is the residual to explain (default: that of the group).
    """
    residual = group.residual if residual is None else residual
    here = yield from _point(group, tuning, residual, tuple(settings))
    free = [f for f in free_parameters(settings, group.machine) if moving is None or f.setting in moving]
    if here is None or not free:
        return here and here.as_fit([], Columns([], group.size), tuning)
    farthest = np.array([f.farthest for f in free])
    nothing = column_of(np.zeros(0))
    columns = Columns((known.get(_name(f, settings), nothing) for f in free), group.size)
    step_sizes = np.ones(len(free))
    outdated = [i for i, f in enumerate(free) if _name(f, settings) not in known]
    least = np.full(len(free), T.narrow_slope if narrowest is None else narrowest)
    projected = information = None
    for _ in range(T.fit_steps if steps is None else steps):
        slopes = yield from _slopes(group, here.settings, here.response, [(free[i], step_sizes[i]) for i in outdated])
        new = dict(zip(outdated, slopes))
        columns = Columns((new.get(i, column) for i, column in enumerate(columns.each)), group.size)
        if outdated or projected is None or information is None:
            projected = tuning.jacobian.onto(columns)
            information = tuning.inner(columns, columns, projected, projected) + 1e-6 * np.eye(len(free))
            if narrowest is None:
                deviations = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-6))  # rounding: re-tuning may explain a column completely
                least = np.clip(DEVIATIONS * deviations, LEAST_STEP, T.narrow_slope)
        gradient = tuning.inner(columns, here.left, projected, here.projected)
        move = np.clip(np.linalg.solve(information, gradient), -farthest, farthest)
        for part in (1.0, 0.4, 0.1):
            tried = here.settings
            for f, m in zip(free, part * move):
                tried = f.moved(tried, float(m))
            there = yield from _point(group, tuning, residual, tried)
            if there is not None and there.loss < here.loss:
                break
        else:
            there = None
        if there is not None:
            gain, predicted = here.loss - there.loss, _predicted_gain(gradient, information, part * move)
            here = there
            step_sizes = np.clip(np.abs(part * move), least, 1.0)
            if gain < T.converged * max(1.0, 0.002 * here.loss):
                break
            # reuse slopes whose predicted gain came true, or is too small to matter
            valid = gain > T.half * predicted or predicted - gain < T.price
            outdated = [] if valid else list(range(len(free)))
        elif len(outdated) < len(free):
            if _predicted_gain(gradient, information, move) < T.price:
                break
            outdated = list(range(len(free)))  # the known slopes did not reduce the loss
        elif here.loss < (1.0 + T.near_noise) * group.expected_loss or np.all(step_sizes <= least):
            break
        else:
            step_sizes = least
    return here.as_fit(free, columns, tuning)


def fit_effects(group: Group, tuning: Tuning, settings: Sequence[Setting], steps: int | None = None, **how: Any) -> Fit | None:
    """One fit by itself, see `fitting`; None if its settings cannot be simulated."""
    return fits_together(group, [fitting(group, tuning, settings, steps, **how)])[0]


class _Point(NamedTuple):
    """Settings with their response (row,), what is left of the residual (row,), its projection, and the loss."""

    settings: tuple[Setting, ...]
    response: np.ndarray
    left: np.ndarray
    projected: np.ndarray
    loss: float

    def as_fit(self, free: list[Free], columns: Columns, tuning: Tuning) -> Fit:
        return Fit(self.settings, free, self.loss, tuning.inverse @ self.projected, self.response, columns, tuning)


def _point(group: Group, tuning: Tuning, residual: np.ndarray, settings: Settings) -> Asks[_Point | None]:
    """The point of these settings; None if they cannot be simulated."""
    response = (yield [settings])[0] if settings else np.zeros(group.size)
    if isinstance(response, TwinError):
        return None
    left = residual - response
    projected = tuning.jacobian.onto(left)
    return _Point(settings, response, left, projected, tuning.loss(left, projected))


def _predicted_gain(gradient: np.ndarray, information: np.ndarray, move: np.ndarray) -> float:
    """Predicted drop of the loss for a move."""
    return float(gradient @ move - 0.5 * move @ information @ move)


def _name(free: Free, settings: Sequence[Setting]) -> Slope:
    return (settings[free.setting].key, free.parameter.name)


def simulated_response(group: Group, settings: Sequence[Setting], key: Hashable = None) -> np.ndarray:
    """Simulated response of the group's channels to these effects (row,); remembered under a key, if one is given."""
    return all_or_raise(simulated_responses(group, [settings], [key]))[0]


def simulated_responses(group: Group, several: Sequence[Sequence[Setting]], keys: Sequence[Hashable] = ()) -> list[np.ndarray | TwinError]:
    """Response to each of several sets of effects, or the error of its simulation; `keys` as in `Group.responses`."""
    moved = [moved_by(settings, group.axes) for settings in several]
    return group.responses([Variation(None, s, tuple(a for a in group.axes if a in own)) for s, own in zip(several, moved)], keys=keys)


def _slopes(group: Group, settings: Settings, response: np.ndarray, sizes: Sequence[tuple[Free, float]]) -> Asks[list[np.ndarray]]:
    """Finite-difference slope per scale unit of each parameter for the given step, taken towards the inside of the bounds."""
    steps = []
    for f, size in sizes:
        both = [(moved, _distance(f, settings, moved)) for moved in (f.moved(settings, step) for step in (size, -size))]
        steps.append(next(((moved, actual) for moved, actual in both if abs(actual) > 1e-6), None))
    changed = iter(all_or_raise((yield [step[0] for step in steps if step is not None])))
    return [np.zeros(group.size) if step is None else (next(changed) - response) / step[1] for step in steps]


def _distance(f: Free, before: Sequence[Setting], after: Sequence[Setting]) -> float:
    """Change of a parameter in scale units."""
    a, b = f.value(before), f.value(after)
    if f.logarithmic:
        return math.log(b / a) / f.unit if a > 0 and b > 0 else 0.0
    difference = b - a
    if f.parameter.periodic:
        difference = (difference + math.pi) % (2 * math.pi) - math.pi
    return difference / f.unit
