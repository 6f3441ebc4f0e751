"""The sizes of the effects found, fitted once more with less weight where the twin is wrong.

If an axis breaks away a few milliseconds earlier than the twin predicts, a few samples are far off and depend steeply on every
parameter. A fit that follows them distorts all sizes. The final fit therefore takes the residual around a sample as doubt of the twin
there, a fault that many samples share (`Channel.weight`). It also re-tunes the machine with the effects in place: a current filter, for
example, can be traded for the damping of a drive train.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
import math

import numpy as np

from twin.diagnose.fit import fit_effects, relinearised_tuning
from twin.diagnose.plausible import is_plausible, within_tolerance
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import GroupState, is_cut
from twin.errors import TwinError
from twin.machine.machine import Machine


def sized(state: GroupState, machine: Machine, mapper: Mapper) -> GroupState:
    """The state with its effects fitted with these doubts; unchanged if it has none."""
    if not state.fit.settings:
        return state
    state, t = replace(state, response_cache={}), state.thresholds
    with contextlib.suppress(TwinError):  # nearly unstable: keep the tuning of the machine without effects
        state = replace(state, tuning=relinearised_tuning(state.group, state.fit, machine, mapper))
    change = state.fit.response / state.group.weights
    for _ in range(t.size_rounds):
        state = state.doubted(change * state.group.weights, state.fit.residual(state.group))
        known = state.fit.linear_effect_slopes
        fit = fit_effects(state.group, machine, state.tuning, state.fit.settings, mapper, t.size_steps, narrowest=t.slope, known=known)
        if fit is None:
            break
        state = state.with_fit(fit)
    return without_implausible(state.inflated(), machine, mapper)


def without_implausible(state: GroupState, machine: Machine, mapper: Mapper) -> GroupState:
    """The state without the effects whose final size no machine has, or is too uncertain."""
    if not state.fit.settings:
        return state
    known = _sizes_are_known(state, machine)
    rest = [s for s, sure in zip(state.fit.settings, known) if sure and is_plausible(s, machine, is_cut(state.group, s), state.thresholds)]
    if len(rest) == len(state.fit.settings):
        return state
    fit = fit_effects(state.group, machine, state.tuning, rest, mapper, state.thresholds.size_steps)
    if fit is None:
        return state
    accepted = (*state.accepted[: len(rest)][:-1], fit) if rest else ()
    return replace(state, fit=fit, accepted=accepted).inflated()


def _sizes_are_known(state: GroupState, machine: Machine) -> list[bool]:
    """Of each effect: is its size known well enough, given its shape, and more than nothing and than what the tolerance explains?

    A size on a scale of ratios has no nothing in its 95 % interval: only the first is asked of it, where no tolerance is like the effect.
    """
    sizes = state.fit.sizes()
    given_shape = np.diag(sizes.information) / (sizes.prior_weight * state.inflation)
    deviations = np.sqrt(np.maximum(np.diag(sizes.covariance(state.inflation)), 0.0))
    known = [True] * len(sizes.settings)
    for free, precision, deviation in zip(sizes.free, given_shape, deviations):
        setting = sizes.settings[free.setting]
        size = setting.effect.size
        if free.parameter is not size:
            continue
        value, within = size.deviation(setting.size), within_tolerance(setting, machine)
        relative = free.unit if free.logarithmic else free.unit / max(value, 1e-30)
        has_size = 1.96 * relative < state.thresholds.no_size * math.sqrt(float(precision))
        half = 1.96 * float(deviation) * free.unit * (abs(setting.size) if free.logarithmic else 1.0)
        is_more = value - half > within or (free.logarithmic and not within)
        known[free.setting] = has_size and is_more
    return known
