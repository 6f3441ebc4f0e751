"""The verdict on the final state: effects, their probabilities, and whether an unexplained residual remains."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np
from scipy.special import softmax

from twin.diagnose.cross_validation import evidence_needed
from twin.diagnose.observe import Group
from twin.diagnose.settings import T
from twin.diagnose.sizes import with_final_sizes, without_implausible
from twin.diagnose.state import ISOLATED_BY, Candidate, GroupState, excess_of, expected_of, is_isolated, open_channels
from twin.diagnose.tuning import trends_of_zeros
from twin.effects import Setting
from twin.effects.setting import Key


def probabilities_of(candidates: Sequence[Candidate], state: GroupState) -> list[float]:
    """Probability of each candidate of a round compared with its rivals and with "no effect", whose evidence is what the best candidate needs.

    All are 0 if the best candidate had the evidence but was refused, or was removed later.
    """
    best = next((c for c in candidates if c.plausible), None)
    if best is None or (best.evidence >= best.needed and best.key not in state.keys):
        return [0.0] * len(candidates)
    evidence = np.array([c.evidence if c.plausible else -math.inf for c in candidates] + [best.needed])
    return [state.group.confidence(c.key[1]) * float(p) for c, p in zip(candidates, softmax(evidence / T.temperature))]


class Named(NamedTuple):
    """An effect that is named, with the state that found it and its probability."""

    setting: Setting
    state: GroupState
    probability: float


def named_effects(states: Sequence[GroupState]) -> list[Named]:
    """Effects of all groups, most evidence first, with their probability in the round that accepted them."""
    out = []
    for state in states:
        for setting in state.fit.settings:
            probability, gain = state.group.confidence(setting.axis), math.inf
            for candidates in state.rounds:
                for candidate, p in zip(candidates, probabilities_of(candidates, state)):
                    if candidate.key == setting.key:
                        probability, gain = p, candidate.gain
            out.append((gain, Named(setting, state, probability)))
    return [named for _, named in sorted(out, key=lambda item: -item[0])]


def in_open_blocks(state: GroupState) -> set[Key]:
    """The effects whose own block shows a residual after the fit. A block without a channel of its own shows it where no other block of the axis does."""
    shown = {(axis, name) for axis, name in open_channels(state) if name in ISOLATED_BY.values()}
    found = set()
    for setting in state.fit.settings:
        own = ISOLATED_BY.get(setting.effect.block)
        if own is None or not state.group.has(setting.axis, own):
            seen = not any(axis == setting.axis for axis, _ in shown)
        else:
            seen = (setting.axis, own) in shown
        if seen:
            found.add(setting.key)
    return found


def final_state(state: GroupState, quick: bool = False) -> GroupState:
    """The final state: without implausible effects, sized, and with the flag for an unexplained residual."""
    state = without_implausible(state)
    unknown = is_unknown(state)
    final = with_final_sizes(state, quick)
    if len(final.fit.settings) < len(state.fit.settings):  # the residual of a removed effect is unexplained again
        unknown = unknown or is_unknown(final)
    return with_zeros_out(replace(final, unknown=unknown))


def with_zeros_out(state: GroupState) -> GroupState:
    """The state with fitted encoder zeros removed from the residuals: a constant between the encoders in each run is no fault.

    What their scatter leaves unknown widens the intervals.
    """
    theta, zeros = state.fit.theta, state.fit.coefficients[len(state.fit.theta) :]
    offset = state.tuning.others.times(zeros) / state.group.weights

    def shifted(of: Group) -> Group:
        return replace(of, channels=[replace(c, residual=c.residual - offset[c.rows]) for c in of.channels])

    group, rigid = shifted(state.group), shifted(state.rigid)
    coefficients = np.concatenate([theta, np.zeros(len(zeros))])
    loss = state.tuning.loss(group.residual - state.fit.response)
    fit = replace(state.fit, coefficients=coefficients, loss=loss, chances=trends_of_zeros(group, zeros))
    return replace(state, group=group, rigid=rigid, fit=fit)


def is_unknown(state: GroupState) -> bool:
    """Is there a residual on an axis of the group that the effects found do not explain?

    Also true if an effect has different sizes in different runs. Each axis is judged by itself: an axis with a small residual does not compensate
    one with a large residual.
    """
    group = state.group
    before, after = excess_of(group, state.retuned), excess_of(group, state.fit)
    above = [e for axis, e in after.items() if e > (T.clean_square - 1.0) * expected_of(group, axis)]
    return sum(above) > T.remaining * sum(max(e, 0.0) for e in before.values()) or differs_between_runs(state)


def differs_between_runs(state: GroupState) -> bool:
    """Do single runs give an effect a different size, by more than chance and model error?

    With c the slope of the fit over the size and r its residual, run k alone gives the step (c_k' r_k) / (c_k' c_k) with the standard deviation
    1 / sqrt(c_k' c_k). An effect has one size; an effect that resembles another law has one for each motion. Together the deviations of the steps
    from their mean must have the evidence that an effect needs; a step that all runs share is a size that break-aways pulled. Effects in blocks that are not isolated are not tested, because all model errors of the loop bias their size.
    Samples that depend on how an axis stuck are excluded: each break-away is different.
    """
    group = state.group
    residual = state.fit.residual(group)
    settled = np.zeros(group.size, bool)
    for c in group.channels:
        settled[c.rows] = c.settled(group.views[c.run])
    for i, free in enumerate(state.fit.free):
        setting = state.fit.settings[free.setting]
        if free.parameter is not setting.effect.size or not is_isolated(group, setting):
            continue
        column = state.fit.columns.whole(i) * settled
        runs = [group.part(group.axes, {run})[1] for run in range(len(group.views))]
        information = np.array([column[rows] @ column[rows] for rows in runs])
        towards = np.array([column[rows] @ residual[rows] for rows in runs])
        off = towards / np.maximum(information, 1e-300) - towards.sum() / max(information.sum(), 1e-300)
        steps = off[np.abs(off) * np.sqrt(information) > T.beyond_chance]
        gain = 0.5 * float(off**2 @ information)
        relative = free.unit if free.logarithmic else free.unit / max(free.parameter.deviation(free.value(state.fit.settings)), 1e-30)
        has_evidence = len(steps) > 1 and gain > evidence_needed(state, setting, len(group.views))
        if has_evidence and (max(steps) - min(steps)) * relative > T.remaining:
            return True
    return False
