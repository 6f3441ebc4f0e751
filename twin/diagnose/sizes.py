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

from twin.diagnose.candidates import deviation_of, size_parameter
from twin.diagnose.fit import SLOPE, fit_effects, tuning_beside
from twin.diagnose.observe import Mapper
from twin.diagnose.plausible import is_plausible
from twin.diagnose.state import Found, inflation
from twin.diagnose.tuning import PRIOR_WEIGHT
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine

ROUNDS, STEPS = 2, 3
"""Times that what is left is looked at, and steps of each fit."""

UNTOLD = 5.0
"""Half a 95 % interval over the size from which an effect has none: what may as well be nothing is not said to be there."""


def sized(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """What was found with its effects fitted where the twin is right; itself where there is none."""
    if not found.fit.settings:
        return found
    found = replace(found, answers={})
    with contextlib.suppress(TwinError):  # next to unstable: the tuning as it acts without the effects
        found.tuning = tuning_beside(found.group, found.fit, machine, mapper)
    change = found.fit.response / found.group.weights
    for _ in range(ROUNDS):
        weights = found.group.weights
        found.doubt(change * weights, found.fit.left(found.group))
        fit = fit_effects(found.group, machine, found.tuning, found.fit.settings, mapper, STEPS, narrowest=SLOPE)
        if fit is None:
            break
        found.fit = fit
        found.accepted[-1] = fit
    found.inflation = inflation(found.group, found.fit)
    drop_implausible(found, machine, mapper)
    return found


def drop_implausible(found: Found, machine: Machine, mapper: Mapper) -> None:
    """Take out effects that, seen better than when they were accepted, have no size that is found on machines, or none at all."""
    rest = [s for s in found.fit.settings if is_plausible(s, machine) and _has_size(found, s)]
    if len(rest) < len(found.fit.settings):
        fit = fit_effects(found.group, machine, found.tuning, rest, mapper, STEPS)
        if fit is not None:
            found.fit = fit
            found.accepted = [*found.accepted[: len(rest)][:-1], fit] if rest else []
            found.inflation = inflation(found.group, fit)


def _has_size(found: Found, setting: Setting) -> bool:
    """Is the size of an effect told, if what shapes it is known?"""
    fit, size = found.fit, size_parameter(setting.effect)
    told = np.diag(fit.information()) / (PRIOR_WEIGHT * found.inflation)
    for free, known in zip(fit.free, told):
        if free.parameter is size and fit.settings[free.setting] == setting:
            relative = free.unit if free.logarithmic else free.unit / max(deviation_of(size, free.value(fit.settings)), 1e-30)
            return 1.96 * relative < UNTOLD * math.sqrt(float(known))
    return True
