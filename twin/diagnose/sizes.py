"""How large the effects found are, beside what the twin does not follow.

A search explains as much as it can. Where an axis breaks away some milliseconds sooner than the twin says, a few samples are far
off and depend steeply on everything: to follow them a fit bends all sizes. So the effects are fitted once more where what the fit
leaves around a sample counts as doubt of the twin there, a fault that is the same in many samples (`Channel.weight`); and beside
re-tuning as it acts on the machine that has the effects: a filter in the current and the damping of a drive train answer each other.
"""

from __future__ import annotations

import contextlib
from dataclasses import replace
import math

import numpy as np

from twin.diagnose.fit import fit_effects, tuning_beside
from twin.diagnose.observe import Mapper
from twin.diagnose.plausible import is_plausible
from twin.diagnose.state import Found
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine


def sized(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state with its effects fitted where the twin is right; itself where there is none."""
    if not found.fit.settings:
        return found
    found, t = replace(found, memory={}), found.thresholds
    with contextlib.suppress(TwinError):  # next to unstable: the tuning as it acts without the effects
        found = replace(found, tuning=tuning_beside(found.group, found.fit, machine, mapper))
    change = found.fit.response / found.group.weights
    for _ in range(t.size_rounds):
        found = found.doubted(change * found.group.weights, found.fit.left(found.group))
        fit = fit_effects(found.group, machine, found.tuning, found.fit.settings, mapper, t.size_steps, narrowest=t.slope)
        if fit is None:
            break
        found = found.with_fit(fit)
    return without_implausible(found.inflated(), machine, mapper)


def without_implausible(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state without effects that, seen better than when they were accepted, have a size that no machine has, or no certain size."""
    rest = [s for s in found.fit.settings if is_plausible(s, machine) and _has_size(found, s)]
    if len(rest) == len(found.fit.settings):
        return found
    fit = fit_effects(found.group, machine, found.tuning, rest, mapper, found.thresholds.size_steps)
    if fit is None:
        return found
    accepted = (*found.accepted[: len(rest)][:-1], fit) if rest else ()
    return replace(found, fit=fit, accepted=accepted).inflated()


def _has_size(found: Found, setting: Setting) -> bool:
    """Is the size of an effect certain enough, with its shape taken as known?"""
    fit, size = found.fit, setting.effect.size
    precision = np.diag(fit.information()) / (fit.about.prior_weight * found.inflation)
    for free, known in zip(fit.free, precision):
        if free.parameter is size and fit.settings[free.setting] == setting:
            relative = free.unit if free.logarithmic else free.unit / max(size.deviation(free.value(fit.settings)), 1e-30)
            return 1.96 * relative < found.thresholds.no_size * math.sqrt(float(known))
    return True
