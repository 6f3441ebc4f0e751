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
from twin.diagnose.observe import Mapper
from twin.diagnose.plausible import is_plausible, within_tolerance
from twin.diagnose.state import Found, is_cut
from twin.effects import Setting
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
    rest = [
        s
        for s in found.fit.settings
        if is_plausible(s, machine, is_cut(found.group, s)) and _has_size(found, s) and _is_more_than_none(found, s, machine)
    ]
    if len(rest) == len(found.fit.settings):
        return found
    fit = fit_effects(found.group, machine, found.tuning, rest, mapper, found.thresholds.size_steps)
    if fit is None:
        return found
    accepted = (*found.accepted[: len(rest)][:-1], fit) if rest else ()
    return replace(found, fit=fit, accepted=accepted).inflated()


def _has_size(found: Found, setting: Setting) -> bool:
    """Is the size of an effect known well enough, given its shape?"""
    fit, size = found.fit, setting.effect.size
    precision = np.diag(fit.information()) / (fit.about.prior_weight * found.inflation)
    for free, known in zip(fit.free, precision):
        if free.parameter is size and fit.settings[free.setting] == setting:
            relative = free.unit if free.logarithmic else free.unit / max(size.deviation(free.value(fit.settings)), 1e-30)
            return 1.96 * relative < found.thresholds.no_size * math.sqrt(float(known))
    return True


def _is_more_than_none(found: Found, setting: Setting, machine: Machine) -> bool:
    """Does the 95 % interval of a size lie outside nothing and what the tolerance explains? What may be neither is no effect.

    A size on a scale of ratios has no nothing in its interval; see `_has_size`.
    """
    fit, size, within = found.fit, setting.effect.size, within_tolerance(setting, machine)
    deviations = np.sqrt(np.maximum(np.diag(fit.sizes().covariance(found.inflation)), 0.0))
    for free, deviation in zip(fit.free, deviations):
        if free.parameter is size and fit.settings[free.setting] == setting and (within or not free.logarithmic):
            half = 1.96 * float(deviation) * free.unit * (abs(setting.size) if free.logarithmic else 1.0)
            return size.deviation(setting.size) - half > within
    return True
