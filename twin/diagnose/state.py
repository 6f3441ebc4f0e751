"""State of the diagnosis of one group of axes, and measures of the residual that its fit leaves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import functools
from typing import NamedTuple

import numpy as np

from twin.diagnose.channel import exceeds
from twin.diagnose.columns import Column, column_of
from twin.diagnose.fit import Fit, Sizes, no_effect, simulated_responses
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.tuning import Tuning
from twin.effects import Setting
from twin.effects.setting import Key
from twin.errors import TwinError

SHOWS_IN = {"position controller": "controller", "transmission": "motor_minus_scale", "measurement": "motor_minus_scale"}
"""Block -> channel that shows every effect of the block, isolated from the loop."""

ISOLATED_BY = {**SHOWS_IN, "speed controller": "controller"}
"""Block -> channel that isolates the block from the loop. All other blocks are only visible in closed loop."""

AT_ONCE = 16
"""Responses simulated at a time: each run holds the loads along its motion until it has run."""


@dataclass(frozen=True)
class Candidate:
    """An effect on an axis, fitted next to the effects accepted before it.

    `evidence` is the gain in log likelihood on held-out runs [nat], `needed` its threshold, `closes` the share of the remaining residual above
    noise that the fit explains.
    """

    sizes: Sizes
    evidence: float
    needed: float
    plausible: bool
    closes: float
    gain: float  # drop of the loss on all runs

    @property
    def setting(self) -> Setting:
        return self.sizes.settings[-1]

    @property
    def key(self) -> Key:
        return self.setting.key


class CachedResponse(NamedTuple):
    """Simulated response to a setting, and the row weights it was scaled with."""

    column: Column
    weights: np.ndarray


class Screened(NamedTuple):
    """A start after screening: its key, gain, the setting with the best size, and the share of the residual that it would explain."""

    key: Key
    gain: float
    setting: Setting
    closes: float


class Accepted(NamedTuple):
    """The effects after a round, and the mean square over noise that they leave on each axis."""

    settings: tuple[Setting, ...]
    squares: dict[str, float]


@dataclass(frozen=True)
class GroupState:
    """State of the diagnosis of one group of axes. A step takes a state and returns the next one; states are never modified.

    `response_cache` holds simulated responses to starts. A response is not simulated again when the group is linearised about a machine with
    other imperfections, so a screening may use one about an earlier machine.
    """

    group: Group  # linearised about the machine with its normal imperfections
    rigid: Group  # linearised about the machine file
    tuning: Tuning
    fit: Fit
    inflation: float = 1.0  # loss over the loss of noise, at least 1
    accepted: tuple[Accepted, ...] = ()  # after each round
    rounds: tuple[tuple[Candidate, ...], ...] = ()  # candidates of each round, best first
    screened: tuple[Screened, ...] = ()  # of the first round
    not_visible: Mapping[Key, float] | None = None  # invisible effects: smallest visible multiple of the usual size
    unknown: bool = False  # is there a residual that no effect explains?
    response_cache: dict[str, CachedResponse | TwinError] = field(default_factory=dict, repr=False, compare=False)

    @property
    def keys(self) -> set[Key]:
        """Keys of the effects of the fit."""
        return {s.key for s in self.fit.settings}

    @functools.cached_property
    def retuned(self) -> Fit:
        """Re-tuning alone."""
        return no_effect(self.group, self.tuning)

    def cached_responses(self, settings: Sequence[Setting], forget: bool = False) -> list[Column | TwinError]:
        """Response to each setting alone, with the current row weights, or the error of its simulation. Each setting is simulated once.
        With `forget` all other responses are forgotten: spectra of the next residual give other starts."""
        keys = [repr(setting.table()) for setting in settings]
        for key in set(self.response_cache).difference(keys if forget else self.response_cache):
            del self.response_cache[key]
        missing = {key: setting for key, setting in zip(keys, settings) if key not in self.response_cache}
        names = list(missing)
        for first in range(0, len(names), AT_ONCE):
            some = names[first : first + AT_ONCE]
            for key, column in zip(some, simulated_responses(self.group, [[missing[key]] for key in some])):
                self.response_cache[key] = (
                    column if isinstance(column, TwinError) else CachedResponse(column_of(column), self.group.weights)
                )
        return [self._as_weighted(key) for key in keys]

    def remembers(self, setting: Setting) -> bool:
        """Is the response to a setting alone known?"""
        return repr(setting.table()) in self.response_cache

    def _as_weighted(self, key: str) -> Column | TwinError:
        cached, weights = self.response_cache[key], self.group.weights
        if isinstance(cached, TwinError):
            return cached
        if cached.weights is not weights:
            self.response_cache[key] = cached = CachedResponse(cached.column.scaled(weights / cached.weights), weights)
        return cached.column

    def with_fit(self, fit: Fit) -> GroupState:
        """The state with another fit, which also replaces the last accepted one."""
        return replace(self, fit=fit).with_accepted(len(self.accepted)) if self.accepted else replace(self, fit=fit)

    def with_accepted(self, rounds: int) -> GroupState:
        """The state whose fit is that after this number of rounds."""
        left = squares_by_axis(self.group, self.fit.residual(self.group))
        return replace(self, accepted=(*self.accepted[: rounds - 1], Accepted(self.fit.settings, left)))

    def inflated(self) -> GroupState:
        """The state with the inflation computed from its fit."""
        return replace(self, inflation=inflation(self.group, self.fit.residual(self.group)))

    def with_model_error(self, change: np.ndarray, residual: np.ndarray | None = None) -> GroupState:
        """The state with the model error of effects whose response is `change` (row,) added to the noise, and more where the fit leaves
        `residual` (row,); both weighted. The fit is reweighted.
        """
        old = self.group.weights
        residual = np.zeros(self.group.size) if residual is None else residual
        rigid, group = self.rigid.with_model_error(change, residual), self.group.with_model_error(change, residual)
        scale = group.weights / old
        tuning = self.tuning.reweighted(scale)
        about = tuning if self.fit.about is self.tuning else self.fit.about.reweighted(scale)
        return replace(self, rigid=rigid, group=group, tuning=tuning, fit=self.fit.reweighted(scale, about, group.residual))


def squares_by_axis(group: Group, residual: np.ndarray) -> dict[str, float]:
    """Mean square over noise of a residual (row,), weighted, of each axis over runs and measured signals."""
    squares: dict[str, list[float]] = {}
    for channel in group.channels:
        if channel.name != "controller":  # motor_minus_scale represents the motor encoder
            normed = residual[channel.rows] / channel.weight / channel.sigma
            squares.setdefault(channel.axis, []).append(float(np.mean(normed**2)))
    return {axis: float(np.mean(values)) for axis, values in squares.items()}


def excess_of(group: Group, fit: Fit) -> dict[str, float]:
    """Half the squared residual above noise of each axis, weighted as evidence."""
    above = 0.5 * group.credit * (fit.residual(group) ** 2 - group.expected)
    return {axis: sum(float(above[c.rows].sum()) for c in group.channels if c.axis == axis) for axis in group.axes}


def expected_of(group: Group, axis: str) -> float:
    """Half the squares that noise alone causes on an axis."""
    return 0.5 * sum(float(group.expected[c.rows].sum()) for c in group.channels if c.axis == axis)


def closed_share(state: GroupState, gain: float) -> float:
    """Share of the residual above noise that a drop of the loss by `gain` explains, from 0 to 1."""
    noise = state.group.expected_loss
    return float(np.clip(gain / max(state.fit.loss - noise, T.near_noise * noise), 0.0, 1.0))


def open_channels(state: GroupState) -> set[tuple[str, str]]:
    """(axis, channel) whose residual exceeds noise and model error in some run; samples that depend on how the axis stuck do not count."""
    residual, found = state.fit.residual(state.group) / state.group.weights, set()
    for c in state.group.channels:
        u = (residual[c.rows] / c.spread)[c.settled(state.group.views[c.run])]
        if len(u) and exceeds(u, T.by_chance):
            found.add((c.axis, c.name))
    return found


def is_isolated(group: Group, setting: Setting) -> bool:
    """Is the block of an effect isolated by a channel? True for blocks that no channel can isolate."""
    channel = ISOLATED_BY.get(setting.effect.block)
    return channel is None or group.has(setting.axis, channel)


def axes_above_noise(group: Group, residual: np.ndarray) -> set[str]:
    """Axes with a channel whose `residual` (row,), weighted, exceeds noise and model error. Samples that depend on how the axis stuck hardly count."""
    residual = residual / group.weights
    loud = set()
    for c in group.channels:
        if c.name == "controller":
            if not replace(c, residual=residual[c.rows]).is_clean:
                loud.add(c.axis)
        elif float(np.mean(group.credit[c.rows] * (np.square(residual[c.rows] / c.spread) - 1.0))) > T.small_residual - 1.0:
            loud.add(c.axis)
    return loud


def inflation(group: Group, residual: np.ndarray) -> float:
    """Loss that a residual (row,) leaves, over the loss of noise, at least 1. Unmodelled behaviour discounts all evidence by this factor."""
    return max(1.0, 0.5 * float(residual @ residual) / group.expected_loss)
