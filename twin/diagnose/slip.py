"""Normal imperfections fitted again on the machine with all effects found: slip before break-away, and drive trains that no channel isolates.

The search fits slip on a machine without effects, where an axis at rest carries no load. On the complete machine a drive train that starts
wound up, or a constant force, makes a resting axis creep. The creep determines the stiffness of its contact better than any reversal, and may
reveal slip that the search missed. Creep depends on noise in the loop, so everything is simulated with noise.
"""

from dataclasses import replace
import functools
import math

import numpy as np

from twin.diagnose.columns import Column, Columns
from twin.diagnose.corrected import limited_deviations
from twin.diagnose.fit import fit_effects
from twin.diagnose.imperfections import channels_above_noise, moved_to, shows_slip
from twin.diagnose.observe import Variation
from twin.diagnose.settings import T
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import Nuisance, can_be_imperfect, least_share, tuned
from twin.errors import TwinError
from twin.simulation.run import all_or_raise

STRETCH = 1.8
"""Ratio of successive trial sizes."""

NEARBY = 1.1
"""Ratio for the finite-difference slope of slip."""

FIRST = (0.2, 0.8)
"""First trial sizes on an axis without slip, besides the smallest one, as shares of the largest normal one."""


def with_refitted_slip(state: GroupState) -> GroupState:
    """The state with the slip of each axis fitted again. Unchanged if the loss does not improve, if the residual is so large that effects must be
    missing, or for a machine without tolerance, which has no normal imperfections.
    """
    if state.tuning.spread <= 0.0 or state.fit.loss > T.small_residual * state.group.expected_loss:
        return state
    for slip in [Nuisance(axis, "slip") for axis in state.group.axes if can_be_imperfect(state.group.machine, axis, "slip")]:
        residual = state.fit.residual(state.group) / state.group.weights
        if slip in state.tuning.nuisances or shows_slip(channels_above_noise(state.group, residual), slip.owner):
            state = _sized(state, slip)
    return state


def with_drive_trains(state: GroupState) -> GroupState:
    """The state with the drive train of each axis above noise that has effects, but neither a known elasticity nor a channel that isolates it.

    There the elasticity is only visible in closed loop, together with the effects: a cyclic error shakes the rotor of an elastic train, while a rigid
    one follows it without inertia.
    """
    hidden = sorted({s.axis for s in state.fit.settings if not state.group.has(s.axis, "motor_minus_scale")})
    for spring in [Nuisance(axis, "elasticity") for axis in hidden if can_be_imperfect(state.group.machine, axis, "elasticity")]:
        loud = {axis for axis, _ in channels_above_noise(state.group, state.fit.residual(state.group) / state.group.weights)}
        if state.tuning.spread > 0.0 and spring.owner in loud and spring not in state.tuning.nuisances:
            state = _sized(state, spring)
    return state


def _sized(state: GroupState, slip: Nuisance) -> GroupState:
    """The state with one slip, or one elasticity, at its best size."""
    tolerance, tuning = state.group.machine.parameter_tolerance, state.tuning
    new = slip not in tuning.nuisances
    nuisances = (*tuning.nuisances, slip) if new else tuning.nuisances
    i = nuisances.index(slip)
    _, rows = state.group.part({slip.owner}, range(len(state.group.views)))
    deviations = np.append(limited_deviations(state), [0.0] * new)
    left_by_fit = state.fit.residual(state.group)
    known: dict[float, np.ndarray | TwinError] = {}

    def responses(*at: float) -> list[np.ndarray | TwinError]:
        """Responses at these deviations; what is not known yet is simulated together."""
        new = [d for d in dict.fromkeys(at) if d not in known]
        machines = [tuned(nuisances, np.where(np.arange(len(nuisances)) == i, d, deviations)) for d in new]
        answers = state.rigid.responses([Variation(machine, state.fit.settings, (slip.owner,), True) for machine in machines])
        known.update((d, one if isinstance(one, TwinError) else one[rows]) for d, one in zip(new, answers))
        return [known[d] for d in at]

    @functools.cache
    def loss(deviation: float) -> float:
        residual = left_by_fit.copy()
        (response,) = responses(deviation)
        if isinstance(response, TwinError):  # too stiff for the simulation step
            return math.inf
        residual[rows] = state.rigid.residual[rows] - response
        return tuning.loss(residual)

    def best_of(*at: float) -> float:
        responses(*at)
        return min(at, key=loss)

    least, largest = least_share(state.group.machine, slip) * tolerance, tolerance
    start = 0.0 if new else min(max(float(deviations[i]), least), largest)
    best = best_of(least, *(share * tolerance for share in FIRST)) if new else start
    while (near := best_of(min(best * STRETCH, largest), max(best / STRETCH, least))) != best and loss(near) < loss(best):
        best = near
    around = [d for d in (best / STRETCH, best, best * STRETCH) if least <= d <= largest]
    losses = [loss(d) for d in around]
    if len(around) == 3 and np.isfinite(losses).all():
        curve = np.polyfit(np.log(np.array(around) / best), losses, 2)
        best = min(best, best * math.exp(-0.5 * curve[1] / curve[0]), key=loss) if curve[0] > 0.0 else best
    beyond = best * NEARBY
    if not loss(start) - loss(best) > T.evidence or not math.isfinite(loss(beyond)):
        return state
    column = np.zeros(state.group.size)
    farther, there = all_or_raise(responses(beyond, best))
    column[rows] = (farther - there) * (tuning.spread / (beyond - best))
    return _moved(state, nuisances, i, best, column)


def _moved(state: GroupState, nuisances: tuple[Nuisance, ...], i: int, deviation: float, column: np.ndarray) -> GroupState:
    """The state about the machine with nuisance `i` at this deviation, where its response at its spread is `column` (row,); effects are refitted."""
    tuning, count = state.tuning, len(state.tuning.nuisances)
    missing = np.zeros(len(nuisances) - count)
    base = np.append(tuning.base, missing)
    theta = np.append(state.fit.theta, missing)
    theta[i] = (deviation - base[i]) / tuning.spread
    columns: list[np.ndarray | Column] = [column if k == i else tuning.jacobian.each[k] for k in range(len(nuisances))]
    shown = replace(tuning.with_nuisances(nuisances, Columns(columns, state.group.size)), base=base)
    try:
        group, about = moved_to(state.rigid, shown, theta)
        fit = fit_effects(group, about, state.fit.settings, T.refit_steps, known=state.fit.slopes)
    except TwinError:
        return state
    if fit is None or fit.loss > state.fit.loss:  # the creep improves, but the rest gets worse
        return state
    return replace(state, group=group, tuning=about).with_fit(fit).inflated()
