"""Slip before break-away, sized once more on the machine that has all effects and normal imperfections found.

The search sizes slip on a machine without either, where an axis at rest carries nothing. On the whole machine a drive train that starts wound up,
or a force that holds, makes an axis creep where it stands: that shows how soft its contact is better than any reversal. Slip that is missed
there may be found here. What creeps, creeps because of the noise in the loop, so that everything is simulated with it.
"""

from __future__ import annotations

from dataclasses import replace
import functools
import math

import numpy as np

from twin.diagnose.corrected import within
from twin.diagnose.fit import fit_effects, no_effect
from twin.diagnose.imperfections import dirty_channels, moved_to, shows_slip
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import Found
from twin.diagnose.tolerance import Nuisance, tuned
from twin.diagnose.tuning import beside
from twin.errors import TwinError
from twin.machine.machine import Machine

STRETCH = 1.8
"""Factor from one size that is tried to the next."""

NEARBY = 1.1
"""Factor over which the slope of a slip is taken."""

FIRST = (0.2, 0.8)
"""Sizes tried first on an axis without slip, beside the least one, as shares of the largest normal one."""


def with_slip_beside(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state with the slip of each axis as it predicts best beside all that was found; unchanged where that gains nothing, while so
    much is left that effects must be missing, and of a machine without tolerance, which has no normal imperfection."""
    if found.tuning.spread <= 0.0 or found.fit.loss > found.thresholds.little_left * found.group.expected_loss:
        return found
    for slip in [Nuisance(axis, "slip", found.thresholds) for axis in found.group.axes]:
        left = found.fit.left(found.group) / found.group.weights
        if slip in found.tuning.nuisances or shows_slip(dirty_channels(found.group, left), slip.owner):
            found = _sized(found, machine, slip, mapper)
    return found


def _sized(found: Found, machine: Machine, slip: Nuisance, mapper: Mapper) -> Found:
    """The state with a slip at its best size."""
    t, tolerance, tuning = found.thresholds, machine.parameter_tolerance, found.tuning
    new = slip not in tuning.nuisances
    nuisances = (*tuning.nuisances, slip) if new else tuning.nuisances
    i = nuisances.index(slip)
    rows = np.concatenate([np.arange(c.rows.start, c.rows.stop) for c in found.group.channels if c.axis == slip.owner])
    deviations = np.append(within(found, tolerance), [0.0] * new)
    left_by_fit = found.fit.left(found.group)

    @functools.cache
    def response(deviation: float) -> np.ndarray:
        there = deviations.copy()
        there[i] = deviation
        whole = found.rigid.response(tuned(nuisances, there), found.fit.settings, (slip.owner,), shaken=True, mapper=mapper)
        return whole[rows]

    @functools.cache
    def loss(deviation: float) -> float:
        left = left_by_fit.copy()
        try:
            left[rows] = found.rigid.residual[rows] - response(deviation)
        except TwinError:  # a spring that no tick can follow
            return math.inf
        return tuning.loss(left)

    least, largest = t.least_slip * tolerance, tolerance
    start = 0.0 if new else min(max(float(deviations[i]), least), largest)
    best = min((least, *(share * tolerance for share in FIRST)), key=loss) if new else start
    while (near := min((min(best * STRETCH, largest), max(best / STRETCH, least)), key=loss)) != best and loss(near) < loss(best):
        best = near
    around = [math.log(d / best) for d in (best / STRETCH, best, best * STRETCH) if least <= d <= largest]
    losses = [loss(best * math.exp(x)) for x in around]
    if len(around) == 3 and np.isfinite(losses).all():
        curve = np.polyfit(around, losses, 2)
        best = min(best, best * math.exp(-0.5 * curve[1] / curve[0]), key=loss) if curve[0] > 0.0 else best
    beyond = best * NEARBY
    if not loss(start) - loss(best) > t.imperfection_earned or not math.isfinite(loss(beyond)):
        return found
    column = np.zeros(found.group.size)
    column[rows] = (response(beyond) - response(best)) * (tuning.spread / (beyond - best))
    return _moved(found, machine, nuisances, i, best, column, mapper)


def _moved(
    found: Found, machine: Machine, nuisances: tuple[Nuisance, ...], i: int, deviation: float, column: np.ndarray, mapper: Mapper
) -> Found:
    """The state about the machine with nuisance `i` at this deviation, where it changes `column` (row,) at its spread; effects fitted anew."""
    tuning, known = found.tuning, len(found.tuning.nuisances)
    missing = np.zeros(len(nuisances) - known)
    base = np.append(tuning.base, missing)
    theta = np.append(found.fit.tuning[:known], missing)
    theta[i] = (deviation - base[i]) / tuning.spread
    columns = beside(tuning.jacobian[:, :known], np.zeros((found.group.size, len(missing))))
    columns[:, i] = column
    shown = replace(tuning.of(nuisances, columns), base=base)
    try:
        group, about = moved_to(found.rigid, shown, theta, mapper)
        fit = fit_effects(group, machine, about, found.fit.settings, mapper, found.thresholds.refit_steps, known=found.fit.slopes)
    except TwinError:
        return found
    if fit is None or fit.loss > found.fit.loss:  # what creeps is better for it, and all else worse
        return found
    return replace(found, group=group, tuning=about, retuned=no_effect(group, about)).with_fit(fit).inflated()
