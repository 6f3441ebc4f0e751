"""What a search has found of a group of axes, and what it leaves above noise."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from twin.diagnose.channel import Channel
from twin.diagnose.fit import Fit, no_effect
from twin.diagnose.observe import ENOUGH, Group
from twin.diagnose.tuning import Tuning
from twin.effects import Setting

NEAR_NOISE = 0.02
"""Excess over noise up to which a residual counts as noise, and evidence alone decides."""

STANDS_OUT = 1.3
"""Mean square over noise from which a single channel counts as not explained."""

SYSTEMATIC = 5.0
"""Mean square over noise and doubt from which what is left in most runs is of another law. A true law keeps up to 3.3 (a current limit
clips noise too, which the twin's expectation has none of), next of kin that no other rule tells keep 60 and more."""

SHOWS_IN = {"position controller": "controller", "transmission": "windup", "measurement": "windup"}
"""The cut channel in which every effect of a block shows."""

CUT_BY = {**SHOWS_IN, "speed controller": "controller"}
"""The channel that cuts a block out of the loop; the others are seen in the closed loop alone."""

QUIET = 0.25
"""Mean square above noise up to which a quick look leaves a channel alone."""


@dataclass
class Candidate:
    """One effect on one axis, fitted together with what was accepted before; `evidence` is on runs left out, `needed` to be there."""

    fit: Fit
    evidence: float
    needed: float
    plausible: bool
    closes: float  # share of what was left above noise that the fit closes

    @property
    def setting(self) -> Setting:
        return self.fit.settings[-1]

    @property
    def key(self) -> tuple[str, str, str | None]:
        return self.setting.key


class Answer(NamedTuple):
    """What a start changes, remembered by a tuning, and the weights of its rows."""

    remembered: tuple[np.ndarray, np.ndarray]
    weights: np.ndarray
    tuning: Tuning


@dataclass
class Found:
    """Result for one group: the final fit, the candidates of each round, and what is left."""

    group: Group  # about the machine with its normal imperfections
    rigid: Group  # about the machine as its file says
    tuning: Tuning
    fit: Fit
    retuned: Fit
    inflation: float
    unknown: bool = False  # is something left that no effect explains?
    accepted: list[Fit] = field(default_factory=list)  # with one effect, with two, ...
    rounds: list[list[Candidate]] = field(default_factory=list)
    screened: list[tuple[tuple[str, str, str | None], float, Setting, float]] = field(default_factory=list)  # in the first round
    # effects that would not show, with the usual sizes from which they would; None: not asked
    unseen: dict[tuple[str, str, str | None], float] | None = None
    answers: dict[str, Answer] = field(default_factory=dict, repr=False)  # of starts, for later rounds

    @property
    def keys(self) -> set[tuple[str, str, str | None]]:
        """Effects of the final fit, each with its axis."""
        return {s.key for s in self.fit.settings}

    def remembered(self, key: str, simulate: Callable[[], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """What a start changes (row,), simulated once, weighted as now and with its projection on the tuning."""
        known = self.answers.get(key)
        if known is None or known.weights is not self.group.weights or known.tuning is not self.tuning:
            if known is None:
                column = simulate().astype(np.float32)
            elif known.weights is self.group.weights:
                column = known.remembered[0]
            else:
                column = (known.remembered[0] * (self.group.weights / known.weights)).astype(np.float32)
            known = self.answers[key] = Answer(self.tuning.remembered(column), self.group.weights, self.tuning)
        return known.remembered

    def doubt(self, change: np.ndarray, left: np.ndarray | None = None) -> None:
        """Doubt what effects change by `change` (row,), and where they leave `left` (row,), both weighted; fits weigh accordingly."""
        old = self.group.weights
        left = np.zeros(self.group.size) if left is None else left
        self.rigid, self.group = self.rigid.doubted(change, left), self.group.doubted(change, left)
        scale = self.group.weights / old
        fits = (self.fit, *self.accepted)
        shared = {id(t): t for t in (self.tuning, *(f.about for f in fits))}
        tunings = {key: tuning.reweighed(scale) for key, tuning in shared.items()}
        self.fit, *self.accepted = (f.reweighed(scale, tunings[id(f.about)], self.group.residual) for f in fits)
        self.tuning = tunings[id(self.tuning)]
        self.retuned = no_effect(self.group, self.tuning)


def excess_of(group: Group, fit: Fit) -> dict[str, float]:
    """Half the squares above noise that a fit leaves of each axis; where an axis was stuck they count as little as for evidence."""
    above = 0.5 * group.credit * (fit.left(group) ** 2 - group.expected)
    return {axis: sum(float(above[c.rows].sum()) for c in group.channels if c.axis == axis) for axis in group.axes}


def expected_of(group: Group, axis: str) -> float:
    """Half the squares that noise alone makes of an axis."""
    return 0.5 * sum(float(group.expected[c.rows].sum()) for c in group.channels if c.axis == axis)


def closed(found: Found) -> float:
    """Half the squares over noise that the effects close beyond re-tuning."""
    left = (found.group.in_noise(fit.left(found.group)) for fit in (found.retuned, found.fit))
    before, after = (0.5 * float(rows @ rows) for rows in left)
    return before - after


def closed_share(found: Found, gain: float) -> float:
    """Share of what the fit leaves above noise that a drop of half the squares by `gain` closes, from 0 to 1."""
    noise = found.group.expected_loss
    return float(np.clip(gain / max(found.fit.loss - noise, NEAR_NOISE * noise), 0.0, 1.0))


def settled_channels(found: Found) -> Iterator[tuple[Channel, np.ndarray]]:
    """Every channel with what the fit leaves of it over noise and doubt, where nothing shows any more how the axis was stuck (sample,)."""
    group = found.group
    left = found.fit.left(group) / group.weights
    for c in group.channels:
        yield c, (left[c.rows] / c.spread)[c.settled(group.views[c.run])]


def localised_on(found: Found) -> set[str]:
    """Axes of which something is left in one channel of one run, although the whole looks like noise."""
    axes = set()
    for channel, u in settled_channels(found):
        if channel.name != "controller" and len(u) > 1000 and float(np.mean(u**2)) > 1.6:
            axes.add(channel.axis)
        if channel.name == "controller" and float(np.mean(u**2)) > 4.0:
            axes.add(channel.axis)
    return axes


def is_systematic(found: Found) -> bool:
    """Does a channel of an axis keep more than noise and doubt in most of its runs? The law found is then a relative of the true one.

    Chance (which flank, when it broke away) leaves much in one run; a wrong law in all.
    """
    levels: dict[tuple[str, str], list[float]] = {}
    for c, u in settled_channels(found):
        if len(u) > ENOUGH:
            levels.setdefault((c.axis, c.name), []).append(float(np.mean(u**2)))
    return any(len(runs) > 1 and float(np.median(runs)) > SYSTEMATIC for runs in levels.values())


def is_cut(group: Group, setting: Setting) -> bool:
    """Is the block of an effect cut out of the loop, where a channel can do that?"""
    channel = CUT_BY.get(setting.effect.block)
    return channel is None or any(c.axis == setting.axis and c.name == channel for c in group.channels)


def unexplained(found: Found) -> float:
    """Half the squares above noise that a fit leaves, in all or in single channels that stand out: what it does not know."""
    standing_out = 0.0
    for c, u in settled_channels(found):
        if len(u) and float(np.mean(u**2)) > STANDS_OUT:
            weight = (c.spread * c.weight)[c.settled(found.group.views[c.run])]
            standing_out += 0.5 * float(np.sum((u**2 - 1.0) * weight**2))
    return max(sum(excess_of(found.group, found.fit).values()), standing_out)


def loud_axes(group: Group, left: np.ndarray) -> set[str]:
    """Axes of which `left` (row,), weighted, is more than noise and doubt in some channel. Where an axis was stuck counts as little as for
    evidence."""
    left = left / group.weights
    loud = set()
    for c in group.channels:
        if c.name == "controller":
            if not replace(c, residual=left[c.rows]).is_clean:
                loud.add(c.axis)
        elif float(np.mean(group.credit[c.rows] * (np.square(left[c.rows] / c.spread) - 1.0))) > QUIET:
            loud.add(c.axis)
    return loud


def inflation(group: Group, fit: Fit) -> float:
    """How much larger than noise alone the residual of a fit is (>= 1): what is not modelled discounts all evidence."""
    left = fit.left(group)
    return max(1.0, 0.5 * float(left @ left) / group.expected_loss)
