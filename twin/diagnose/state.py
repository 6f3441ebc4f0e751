"""The state of a diagnosis of one group of axes, and what its fit leaves above noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from twin.diagnose.channel import Channel
from twin.diagnose.fit import Fit, Sizes, no_effect, simulated_responses
from twin.diagnose.observe import Group
from twin.diagnose.settings import Thresholds
from twin.diagnose.simulations import Mapper, in_turn
from twin.diagnose.tuning import Tuning
from twin.effects import Setting
from twin.errors import TwinError

Key = tuple[str, str, str | None]
"""Effect, axis, and the axis that it comes from."""

SHOWS_IN = {"position controller": "controller", "transmission": "motor_minus_scale", "measurement": "motor_minus_scale"}
"""The cut channel in which every effect of a block shows."""

CUT_BY = {**SHOWS_IN, "speed controller": "controller"}
"""The channel that cuts a block out of the loop; the others are seen in the closed loop alone."""


@dataclass(frozen=True)
class Candidate:
    """One effect on one axis, fitted together with the effects accepted before it.

    `evidence` is its log likelihood on runs left out, `needed` what it must reach, `closes` the share of what was left above noise that the
    fit closes.
    """

    sizes: Sizes
    evidence: float
    needed: float
    plausible: bool
    closes: float
    gain: float  # half the drop of the squares

    @property
    def setting(self) -> Setting:
        return self.sizes.settings[-1]

    @property
    def key(self) -> Key:
        return self.setting.key


class CachedResponse(NamedTuple):
    """Simulated change that a setting makes (row,), and the weights of its rows."""

    column: np.ndarray
    weights: np.ndarray


class Screened(NamedTuple):
    """A start as it was screened: effect and axis, gain, the setting it stands for, the share that it would close."""

    key: Key
    gain: float
    setting: Setting
    closes: float


@dataclass(frozen=True)
class GroupState:
    """State of the diagnosis of one group of axes. A step takes one and returns the next; none is ever changed.

    `memory` holds simulated answers of starts. It saves time and changes no result.
    """

    group: Group  # about the machine with its normal imperfections
    rigid: Group  # about the machine as its file says
    tuning: Tuning
    fit: Fit
    retuned: Fit  # re-tuning alone
    inflation: float  # power of the residual over that of noise, at least 1
    accepted: tuple[Fit, ...] = ()  # with one effect, with two, ...
    rounds: tuple[tuple[Candidate, ...], ...] = ()  # candidates of each round, best first
    screened: tuple[Screened, ...] = ()  # of the first round
    not_visible: Mapping[Key, float] | None = (
        None  # effects that would not show, with the multiple of their usual size from which they would
    )
    zeros: Mapping[tuple[str, int], float] = field(default_factory=dict)  # axis and run -> motor encoder minus scale that is no fault [SI]
    unknown: bool = False  # is something left that no effect explains?
    response_cache: dict[str, CachedResponse | TwinError] = field(default_factory=dict, repr=False, compare=False)

    @property
    def thresholds(self) -> Thresholds:
        """The thresholds of this diagnosis."""
        return self.group.thresholds

    @property
    def keys(self) -> set[Key]:
        """Effects of the final fit, each with its axis."""
        return {s.key for s in self.fit.settings}

    def cached_responses(self, settings: Sequence[Setting], mapper: Mapper = in_turn) -> list[np.ndarray | TwinError]:
        """What each setting alone changes (row,), simulated once and weighted as the group is now; or its error."""
        keys = [repr(setting.table()) for setting in settings]
        missing = {key: setting for key, setting in zip(keys, settings) if key not in self.response_cache}
        for key, column in zip(missing, simulated_responses(self.group, [[setting] for setting in missing.values()], mapper)):
            self.response_cache[key] = (
                column if isinstance(column, TwinError) else CachedResponse(column.astype(np.float32), self.group.weights)
            )
        return [self._as_weighted(key) for key in keys]

    def _as_weighted(self, key: str) -> np.ndarray | TwinError:
        known, weights = self.response_cache[key], self.group.weights
        if isinstance(known, TwinError):
            return known
        if known.weights is not weights:
            self.response_cache[key] = known = CachedResponse((known.column * (weights / known.weights)).astype(np.float32), weights)
        return known.column

    def with_fit(self, fit: Fit) -> GroupState:
        """The state with this fit as its last one, which replaces the last accepted one."""
        return replace(self, fit=fit, accepted=(*self.accepted[:-1], fit) if self.accepted else ())

    def inflated(self) -> GroupState:
        """The state with the inflation of its own fit."""
        return replace(self, inflation=inflation(self.group, self.fit))

    def doubted(self, change: np.ndarray, residual: np.ndarray | None = None) -> GroupState:
        """The state where effects that change the rows by `change` (row,) are trusted to a share of that, and the twin less where they
        leave `left` (row,); both weighted. All fits are weighed anew."""
        old = self.group.weights
        residual = np.zeros(self.group.size) if residual is None else residual
        rigid, group = self.rigid.doubted(change, residual), self.group.doubted(change, residual)
        scale = group.weights / old
        shared = {id(t): t for t in (self.tuning, self.fit.about, *(f.about for f in self.accepted))}
        tunings = {key: tuning.reweighted(scale) for key, tuning in shared.items()}
        fit, *accepted = (f.reweighted(scale, tunings[id(f.about)], group.residual) for f in (self.fit, *self.accepted))
        tuning = tunings[id(self.tuning)]
        return replace(self, rigid=rigid, group=group, tuning=tuning, fit=fit, accepted=tuple(accepted), retuned=no_effect(group, tuning))


def excess_of(group: Group, fit: Fit) -> dict[str, float]:
    """Half the squares above noise that a fit leaves of each axis; where an axis was stuck they count as little as for evidence."""
    above = 0.5 * group.credit * (fit.residual(group) ** 2 - group.expected)
    return {axis: sum(float(above[c.rows].sum()) for c in group.channels if c.axis == axis) for axis in group.axes}


def expected_of(group: Group, axis: str) -> float:
    """Half the squares that noise alone makes of an axis."""
    return 0.5 * sum(float(group.expected[c.rows].sum()) for c in group.channels if c.axis == axis)


def closed_share(state: GroupState, gain: float) -> float:
    """Share of what the fit leaves above noise that a drop of half the squares by `gain` closes, from 0 to 1."""
    noise = state.group.expected_loss
    return float(np.clip(gain / max(state.fit.loss - noise, state.thresholds.near_noise * noise), 0.0, 1.0))


def settled_channels(state: GroupState) -> Iterator[tuple[Channel, np.ndarray]]:
    """Every channel with what the fit leaves of it over noise and doubt, where nothing shows any more how the axis was stuck (sample,)."""
    group = state.group
    residual = state.fit.residual(group) / group.weights
    for c in group.channels:
        yield c, (residual[c.rows] / c.spread)[c.settled(group.views[c.run])]


def localised_on(state: GroupState) -> set[str]:
    """Axes of which something is left in one channel of one run, although the whole looks like noise."""
    axes, t = set(), state.thresholds
    for channel, u in settled_channels(state):
        if channel.name != "controller" and len(u) > t.local_samples and float(np.mean(u**2)) > t.local_square:
            axes.add(channel.axis)
        if channel.name == "controller" and float(np.mean(u**2)) > t.local_law_square:
            axes.add(channel.axis)
    return axes


def is_systematic(state: GroupState) -> bool:
    """Does a channel of an axis keep more than noise and doubt in most of its runs? The law found is then a relative of the true one.

    Chance (which flank, when it broke away) leaves much in one run; a wrong law in all.
    """
    t = state.thresholds
    levels: dict[tuple[str, str], list[float]] = {}
    for c, u in settled_channels(state):
        if len(u) > t.enough_samples:
            levels.setdefault((c.axis, c.name), []).append(float(np.mean(u**2)))
    return any(len(runs) > 1 and float(np.median(runs)) > t.systematic for runs in levels.values())


def is_cut(group: Group, setting: Setting) -> bool:
    """Is the block of an effect cut out of the loop, where a channel can do that?"""
    channel = CUT_BY.get(setting.effect.block)
    return channel is None or any(c.axis == setting.axis and c.name == channel for c in group.channels)


def unexplained(state: GroupState) -> float:
    """Half the squares above noise that a fit leaves, in all or in single channels that stand out: what it does not know."""
    standing_out = 0.0
    for c, u in settled_channels(state):
        if len(u) and float(np.mean(u**2)) > state.thresholds.stands_out:
            weight = (c.spread * c.weight)[c.settled(state.group.views[c.run])]
            standing_out += 0.5 * float(np.sum((u**2 - 1.0) * weight**2))
    return max(sum(excess_of(state.group, state.fit).values()), standing_out)


def axes_above_noise(group: Group, residual: np.ndarray) -> set[str]:
    """Axes of which `left` (row,), weighted, is more than noise and doubt in some channel. Where an axis was stuck counts as little as for
    evidence."""
    residual = residual / group.weights
    loud = set()
    for c in group.channels:
        if c.name == "controller":
            if not replace(c, residual=residual[c.rows]).is_clean:
                loud.add(c.axis)
        elif float(np.mean(group.credit[c.rows] * (np.square(residual[c.rows] / c.spread) - 1.0))) > group.thresholds.quiet:
            loud.add(c.axis)
    return loud


def inflation(group: Group, fit: Fit) -> float:
    """How much larger than noise alone the residual of a fit is (>= 1): what is not modelled discounts all evidence."""
    residual = fit.residual(group)
    return max(1.0, 0.5 * float(residual @ residual) / group.expected_loss)
