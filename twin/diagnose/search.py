"""Which effects a group of axes has: screen all, fit the best, add one while it earns its place, try each removal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import contextlib
from dataclasses import replace

import numpy as np

from twin.diagnose.candidates import is_scaled, size_parameter, starts_of
from twin.diagnose.cross_validation import EVIDENCE, evidence_needed, held_out_loss, left_within, loss_within
from twin.diagnose.fit import STEPS, Fit, fit_effects, no_effect, tuning_beside
from twin.diagnose.imperfections import moved_to, on_imperfect_machine, with_imperfections
from twin.diagnose.observe import Group, Mapper, with_noise_about
from twin.diagnose.plausible import is_imitated, is_plausible, is_ruled_out
from twin.diagnose.screen import screen
from twin.diagnose.state import NEAR_NOISE, Candidate, Found, closed_share, inflation, localised_on, loud_axes, unexplained
from twin.diagnose.tolerance import NORMAL, WIDEST
from twin.diagnose.tuning import tuning_of
from twin.diagnose.unseen import unseen_effects
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine

MOST_EFFECTS = 3
"""Effects that one group of axes can be found to have."""

REFIT_STEPS = 4
"""Steps of a fit that starts where it has been before."""

LOOKS = 3
"""Times at most that effects and what is normal besides them are fitted about where they were found."""

LITTLE = 1.3
"""Loss over that of noise up to which normal imperfections alone are looked at again: beside an effect that is not yet known they bend."""

MOST_FITTED = 8
RIVALS_WITHIN, BENT_WITHIN = 0.25, 0.08
"""Screened candidates that are fitted in closed loop: those that reach this share of the best one's gain (less for effects
that are not in proportion to their size, which a start may underrate), at most so many."""

LEAST_SHARE = 0.3
"""Share that an effect must close of what the ones before left above noise: where much is left that no effect closes, small gains
are of a model that is not right, and stand for nothing."""

PRICE = 2.0
"""Log likelihood that each further free parameter costs."""


def search(
    group: Group,
    machine: Machine,
    folds: Sequence[Sequence[int]],
    mapper: Mapper,
    progress: Callable[[str], None],
    quick: bool = False,
) -> Found:
    """Forward selection with refit of all accepted effects, then removals.

    Where something is left beside an effect, all that is there is fitted once more together before anything is added to it.
    """
    rigid = group
    tuning = with_imperfections(tuning_of(group, machine, mapper), group, machine, group.residual, mapper)
    group, tuning = on_imperfect_machine(group, tuning, group.residual, mapper)
    if group is not rigid:
        weights = group.weights
        rigid, group = with_noise_about(rigid, group, no_effect(group, tuning).left(group))
        tuning = tuning.reweighed(group.weights / weights)
        with contextlib.suppress(TwinError):  # next to unstable: as it answers as a whole
            tuning = tuning_beside(group, no_effect(group, tuning), machine, mapper, only=NORMAL)
    retuned = no_effect(group, tuning)
    found = Found(group, rigid, tuning, retuned, retuned, inflation(group, retuned))
    # what little is left may be of the normal imperfections, which were found one after another
    looked = not any(n.quantity in NORMAL for n in tuning.nuisances) or retuned.loss > LITTLE * group.expected_loss
    while True:
        if not looked and (found.fit.loss > (1.0 + NEAR_NOISE) * found.group.expected_loss or localised_on(found)):
            _look_again(found, machine, mapper)
            looked = True
        asked = loud_near_tolerance(found, machine) if quick else set(group.axes)
        if len(found.fit.settings) == MOST_EFFECTS or not asked:
            break
        candidates = _round(found, machine, folds, mapper, progress, asked, quick)
        best = next((c for c in candidates if c.plausible), None)
        earned = best is not None and best.evidence >= best.needed and _closes_enough(found, best.fit)
        if earned and not looked:
            looked = True
            if _look_again(found, machine, mapper):
                continue  # what is left is another matter now
        found.rounds.append(candidates)
        if best is None or not earned:
            break
        first = not found.fit.settings
        if quick and best.fit.loss < (1.0 + NEAR_NOISE) * found.group.expected_loss and not localised_on(replace(found, fit=best.fit)):
            _take(found, best.fit)  # what is left is noise: finer sizes are all that is to be had
            break
        _accept(found, best.fit, machine, mapper)
        looked = False
        if first and found.retuned.loss - found.fit.loss < evidence_needed(found, best.setting, len(folds)):
            found.doubt(np.zeros(found.group.size))
            found.accepted.clear()
            found.fit = found.retuned  # what is normal, seen better, explains it as well
            break
    _try_removals(found, machine, folds, mapper)
    return found


def _take(found: Found, fit: Fit) -> None:
    found.fit = fit
    found.accepted.append(fit)
    found.inflation = inflation(found.group, fit)


def _accept(found: Found, fit: Fit, machine: Machine, mapper: Mapper) -> None:
    """Take an effect; it is trusted to a share of what it changes, and what is normal besides it is seen better now."""
    found.fit = fit
    found.doubt(fit.response)
    fit = fit_effects(found.group, machine, found.tuning, fit.settings, mapper, REFIT_STEPS) or found.fit
    left = found.rigid.residual - fit.response
    tuning = with_imperfections(found.tuning, found.rigid, machine, left, mapper)
    group, tuning = on_imperfect_machine(found.rigid, tuning, left, mapper)
    again = fit_effects(group, machine, tuning, fit.settings, mapper, REFIT_STEPS) if group is not found.group else None
    if again is not None:
        fit, found.group, found.retuned = again, group, no_effect(group, tuning)
        found.tuning = tuning
    _take(found, fit)


def _look_again(found: Found, machine: Machine, mapper: Mapper) -> bool:
    """Fit effects and what is normal together, all as it acts on the machine that has them; did that close more?

    An effect found on a machine whose drive train is not yet right is bent by that, and the drive train by the effect.
    """
    before, group = found.fit.loss, found.group
    for _ in range(LOOKS):
        try:
            tuning = tuning_beside(found.group, found.fit, machine, mapper)
        except TwinError:  # next to unstable: nothing is told by what is further off
            break
        again = fit_effects(found.group, machine, tuning, found.fit.settings, mapper, REFIT_STEPS)
        if again is None or again.loss > found.fit.loss:
            break
        gain = found.fit.loss - again.loss
        found.fit = again
        found.tuning = tuning
        try:
            nearer, tuning = moved_to(found.rigid, tuning, again.tuning, mapper)
        except TwinError:
            break
        moved = fit_effects(nearer, machine, tuning, again.settings, mapper, REFIT_STEPS) if nearer is not found.rigid else None
        if moved is not None and moved.loss < again.loss + EVIDENCE:
            gain += again.loss - moved.loss
            found.fit, found.group = moved, nearer
            found.tuning = tuning
        if gain < EVIDENCE:
            break
    if found.group is not group:
        found.retuned = no_effect(found.group, found.tuning)
    if found.accepted:
        found.accepted[-1] = found.fit
    found.inflation = inflation(found.group, found.fit)
    return before - found.fit.loss > EVIDENCE


def _closes_enough(found: Found, fit: Fit) -> bool:
    left = unexplained(found)
    return left < NEAR_NOISE * found.group.expected_loss or found.fit.loss - fit.loss > LEAST_SHARE * left


def loud_near_tolerance(found: Found, machine: Machine) -> set[str]:
    """Axes that keep more than noise, whatever machine near the tolerance this is; what is far off it is no re-tuning."""
    return loud_axes(found.group, left_within(found, found.fit, WIDEST * machine.parameter_tolerance, normal=False))


def _round(found: Found, machine: Machine, folds, mapper, progress, asked, quick) -> list[Candidate]:  # type: ignore[no-untyped-def]
    group, tuning = found.group, found.tuning
    accepted, taken = found.fit.settings, found.keys
    residual = group.residual - found.fit.response
    left = residual - tuning.jacobian @ tuning.solve(residual)
    every = [s for s in starts_of(group, machine, left) if s.axis in asked and s.key not in taken]  # an effect shows on its own axis
    starts = [s for s in every if not is_ruled_out(group, s)]
    progress(f"{'+'.join(group.axes)}: screening {len(starts)} settings")
    target = tuning.remembered(residual)
    best: dict[tuple[str, str, str | None], tuple[float, Setting]] = {}
    for start, screened in zip(starts, mapper(lambda s: screen(found, s, target), starts)):
        if screened is not None and screened[0] > best.get(start.key, (0.0,))[0]:
            best[start.key] = screened
    order = sorted(best.items(), key=lambda item: -item[1][0])
    if not found.rounds:
        found.screened = [(key, gain, setting, closed_share(found, gain)) for key, (gain, setting) in order]
        found.unseen = None if quick else unseen_effects(found, every, machine, len(folds), mapper)
    if not order or order[0][1][0] < EVIDENCE * 0.5:
        order = order[:1]
    most = 3 if quick else MOST_FITTED
    top = order[0][1][0] if order else 0.0
    near = [item for i, item in enumerate(order) if i < 2 or item[1][0] > (RIVALS_WITHIN if _is_linear(item[1][1]) else BENT_WITHIN) * top]
    chosen = near[:most]
    progress(f"{'+'.join(group.axes)}: fitting {', '.join(f'{k[0]} {k[1]}' for k, _ in chosen[:3])} ...")
    steps = 3 if quick else STEPS
    with ThreadPoolExecutor(max(len(chosen), 1)) as fitting:  # they wait for the workers' simulations
        fits = list(fitting.map(lambda item: fit_effects(group, machine, tuning, [*accepted, item[1][1]], mapper, steps), chosen))
    healthy = loss_within(found, found.fit, machine.parameter_tolerance)
    # where no machine near the tolerance is like this one, parameters far off it are no rival of an effect
    base = max(held_out_loss(found, found.fit, folds), loss_within(found, found.fit, WIDEST * machine.parameter_tolerance))
    candidates = []
    for fit in fits:
        if fit is None:
            continue
        # on runs left out, and not more than the drop on all runs pays for its parameters, whatever machine within the tolerance it is
        drop = min(found.fit.loss - fit.loss, healthy - loss_within(found, fit, machine.parameter_tolerance))
        gain = min(base - held_out_loss(found, fit, folds), drop - PRICE * (len(fit.free) - len(found.fit.free)))
        evidence = gain / min(found.inflation, inflation(group, fit))
        last = fit.settings[-1]
        plausible = is_plausible(last, machine) and not is_imitated(found, last, machine)
        needed = evidence_needed(found, last, len(folds))
        candidates.append(Candidate(fit, evidence, needed, plausible, closed_share(found, found.fit.loss - fit.loss)))
    return sorted(candidates, key=lambda c: -(c.evidence - (0.0 if c.plausible else 1e9)))


def _is_linear(setting: Setting) -> bool:
    size = size_parameter(setting.effect)
    return is_scaled(size) and setting.effect.name != "backlash"


def _try_removals(found: Found, machine: Machine, folds: Sequence[Sequence[int]], mapper: Mapper) -> None:
    """Drop an accepted effect that the later ones have made superfluous."""
    while len(found.fit.settings) > 1:
        full = held_out_loss(found, found.fit, folds)
        worst: tuple[float, Fit] | None = None
        for i in range(len(found.fit.settings)):
            rest = [s for j, s in enumerate(found.fit.settings) if j != i]
            fit = fit_effects(found.group, machine, found.tuning, rest, mapper, 2)
            if fit is None:
                continue
            cost = (held_out_loss(found, fit, folds) - full) / found.inflation
            if worst is None or cost < worst[0]:
                worst = (cost, fit)
        if worst is None or worst[0] >= EVIDENCE:
            return
        found.fit = worst[1]
