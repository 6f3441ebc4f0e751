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

from twin.diagnose.fit import fit_effects, tuning_beside
from twin.diagnose.plausible import is_plausible, within_tolerance
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import Found, is_cut
from twin.errors import TwinError
from twin.machine.machine import Machine


def sized(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state with its effects fitted with these doubts; unchanged if it has none."""
    if not found.fit.settings:
        return found
    found, t = replace(found, memory={}), found.thresholds
    with contextlib.suppress(TwinError):  # nearly unstable: keep the tuning of the machine without effects
        found = replace(found, tuning=tuning_beside(found.group, found.fit, machine, mapper))
    change = found.fit.response / found.group.weights
    for _ in range(t.size_rounds):
        found = found.doubted(change * found.group.weights, found.fit.left(found.group))
        known = found.fit.straight_slopes
        fit = fit_effects(found.group, machine, found.tuning, found.fit.settings, mapper, t.size_steps, narrowest=t.slope, known=known)
        if fit is None:
            break
        found = found.with_fit(fit)
    return without_implausible(found.inflated(), machine, mapper)


def without_implausible(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state without the effects whose final size no machine has, or is too uncertain."""
    if not found.fit.settings:
        return found
    known = _sizes_are_known(found, machine)
    rest = [s for s, sure in zip(found.fit.settings, known) if sure and is_plausible(s, machine, is_cut(found.group, s))]
    if len(rest) == len(found.fit.settings):
        return found
    fit = fit_effects(found.group, machine, found.tuning, rest, mapper, found.thresholds.size_steps)
    if fit is None:
        return found
    accepted = (*found.accepted[: len(rest)][:-1], fit) if rest else ()
    return replace(found, fit=fit, accepted=accepted).inflated()


def _sizes_are_known(found: Found, machine: Machine) -> list[bool]:
    """Of each effect: is its size known well enough, given its shape, and more than nothing and than what the tolerance explains?

    A size on a scale of ratios has no nothing in its 95 % interval: only the first is asked of it, where no tolerance is like the effect.
    """
    sizes = found.fit.sizes()
    given_shape = np.diag(sizes.information) / (sizes.prior_weight * found.inflation)
    deviations = np.sqrt(np.maximum(np.diag(sizes.covariance(found.inflation)), 0.0))
    known = [True] * len(sizes.settings)
    for free, precision, deviation in zip(sizes.free, given_shape, deviations):
        setting = sizes.settings[free.setting]
        size = setting.effect.size
        if free.parameter is not size:
            continue
        value, within = size.deviation(setting.size), within_tolerance(setting, machine)
        relative = free.unit if free.logarithmic else free.unit / max(value, 1e-30)
        has_size = 1.96 * relative < found.thresholds.no_size * math.sqrt(float(precision))
        half = 1.96 * float(deviation) * free.unit * (abs(setting.size) if free.logarithmic else 1.0)
        is_more = value - half > within or (free.logarithmic and not within)
        known[free.setting] = has_size and is_more
    return known
