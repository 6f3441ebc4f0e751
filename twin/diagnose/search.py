"""Which effects a group of axes has: screen all, fit the best, add one while it earns its place, try each removal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
import contextlib
from dataclasses import replace

import numpy as np

from twin.diagnose.candidates import starts_of
from twin.diagnose.cross_validation import evidence_needed, held_out_loss, left_within, loss_within
from twin.diagnose.fit import Fit, fit_effects, no_effect, tuning_beside
from twin.diagnose.imperfections import moved_to, on_imperfect_machine, with_imperfections
from twin.diagnose.observe import Group, Mapper, with_noise_about
from twin.diagnose.plausible import is_imitated, is_plausible, is_ruled_out
from twin.diagnose.screen import screen
from twin.diagnose.state import Candidate, Found, Screened, closed_share, inflation, localised_on, loud_axes, unexplained
from twin.diagnose.tolerance import NORMAL
from twin.diagnose.tuning import tuning_of
from twin.diagnose.unseen import unseen_effects
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine


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
    t = group.thresholds
    looked = not any(n.quantity in NORMAL for n in tuning.nuisances) or retuned.loss > t.little_left * group.expected_loss
    while True:
        if not looked and (found.fit.loss > (1.0 + t.near_noise) * found.group.expected_loss or localised_on(found)):
            found, looked = _look_again(found, machine, mapper), True
        asked = loud_near_tolerance(found, machine) if quick else set(group.axes)
        if len(found.fit.settings) == t.most_effects or not asked:
            break
        found, candidates = _round(found, machine, folds, mapper, progress, asked, quick)
        best = next((c for c in candidates if c.plausible), None)
        earned = best is not None and best.evidence >= best.needed and _closes_enough(found, best.fit)
        if earned and not looked:
            looked, before = True, found.fit.loss
            found = _look_again(found, machine, mapper)
            if before - found.fit.loss > t.evidence:
                continue  # what is left is another matter now
        found = replace(found, rounds=(*found.rounds, candidates))
        if best is None or not earned:
            break
        first = not found.fit.settings
        if quick and best.fit.loss < (1.0 + t.near_noise) * found.group.expected_loss and not localised_on(replace(found, fit=best.fit)):
            found = _taken(found, best.fit)  # what is left is noise: finer sizes are all that is to be had
            break
        found, looked = _accepted(found, best.fit, machine, mapper), False
        if first and found.retuned.loss - found.fit.loss < evidence_needed(found, best.setting, len(folds)):
            found = found.doubted(np.zeros(found.group.size))
            found = replace(found, accepted=(), fit=found.retuned)  # what is normal, seen better, explains it as well
            break
    return _without_superfluous(found, machine, folds, mapper)


def _taken(found: Found, fit: Fit) -> Found:
    return replace(found, fit=fit, accepted=(*found.accepted, fit)).inflated()


def _accepted(found: Found, fit: Fit, machine: Machine, mapper: Mapper) -> Found:
    """The state with one more effect. It is trusted to a share of what it changes, and normal imperfections are found anew beside it."""
    found = replace(found, fit=fit).doubted(fit.response)
    steps = found.thresholds.refit_steps
    fit = fit_effects(found.group, machine, found.tuning, fit.settings, mapper, steps) or found.fit
    left = found.rigid.residual - fit.response
    tuning = with_imperfections(found.tuning, found.rigid, machine, left, mapper)
    group, tuning = on_imperfect_machine(found.rigid, tuning, left, mapper)
    again = fit_effects(group, machine, tuning, fit.settings, mapper, steps) if group is not found.group else None
    if again is not None:
        fit, found = again, replace(found, group=group, retuned=no_effect(group, tuning), tuning=tuning)
    return _taken(found, fit)


def _look_again(found: Found, machine: Machine, mapper: Mapper) -> Found:
    """The state with effects and normal imperfections fitted together, all as they act on the machine that has them.

    An effect found on a machine whose drive train is not yet right is bent by that, and the drive train by the effect.
    """
    group, t = found.group, found.thresholds
    for _ in range(t.looks):
        try:
            tuning = tuning_beside(found.group, found.fit, machine, mapper)
        except TwinError:  # next to unstable: slopes from further off say nothing
            break
        again = fit_effects(found.group, machine, tuning, found.fit.settings, mapper, t.refit_steps)
        if again is None or again.loss > found.fit.loss:
            break
        gain = found.fit.loss - again.loss
        found = replace(found, fit=again, tuning=tuning)
        try:
            nearer, tuning = moved_to(found.rigid, tuning, again.tuning, mapper)
        except TwinError:
            break
        moved = fit_effects(nearer, machine, tuning, again.settings, mapper, t.refit_steps) if nearer is not found.rigid else None
        if moved is not None and moved.loss < again.loss + t.evidence:
            gain += again.loss - moved.loss
            found = replace(found, fit=moved, group=nearer, tuning=tuning)
        if gain < t.evidence:
            break
    if found.group is not group:
        found = replace(found, retuned=no_effect(found.group, found.tuning))
    return found.with_fit(found.fit).inflated()


def _closes_enough(found: Found, fit: Fit) -> bool:
    left = unexplained(found)
    return left < found.thresholds.near_noise * found.group.expected_loss or found.fit.loss - fit.loss > found.thresholds.least_share * left


def loud_near_tolerance(found: Found, machine: Machine) -> set[str]:
    """Axes that keep more than noise, whatever machine near the tolerance this is; what is far off it is no re-tuning."""
    return loud_axes(found.group, left_within(found, found.fit, found.thresholds.widest * machine.parameter_tolerance, normal=False))


def _round(  # type: ignore[no-untyped-def]
    found: Found, machine: Machine, folds, mapper, progress, asked, quick
) -> tuple[Found, tuple[Candidate, ...]]:
    """The state after screening, and the candidates of a round, best first: screened over all effects, the best fitted."""
    group, tuning, t = found.group, found.tuning, found.thresholds
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
        screened_all = tuple(Screened(key, gain, setting, closed_share(found, gain)) for key, (gain, setting) in order)
        unseen = None if quick else unseen_effects(found, every, machine, len(folds), mapper)
        found = replace(found, screened=screened_all, unseen=unseen)
    if not order or order[0][1][0] < t.evidence * 0.5:
        order = order[:1]
    most = t.most_fitted_quick if quick else t.most_fitted
    top = order[0][1][0] if order else 0.0
    near = [
        item for i, item in enumerate(order) if i < 2 or item[1][0] > (t.rivals_within if _is_linear(item[1][1]) else t.bent_within) * top
    ]
    chosen = near[:most]
    progress(f"{'+'.join(group.axes)}: fitting {', '.join(f'{k[0]} {k[1]}' for k, _ in chosen[:3])} ...")
    steps = t.quick_steps if quick else t.fit_steps
    with ThreadPoolExecutor(max(len(chosen), 1)) as fitting:  # they wait for the workers' simulations
        fits = list(fitting.map(lambda item: fit_effects(group, machine, tuning, [*accepted, item[1][1]], mapper, steps), chosen))
    healthy = loss_within(found, found.fit, machine.parameter_tolerance)
    # where no machine near the tolerance is like this one, parameters far off it are no rival of an effect
    base = max(held_out_loss(found, found.fit, folds), loss_within(found, found.fit, found.thresholds.widest * machine.parameter_tolerance))
    candidates = []
    for fit in fits:
        if fit is None:
            continue
        # on runs left out, and not more than the drop on all runs pays for its parameters, whatever machine within the tolerance it is
        drop = min(found.fit.loss - fit.loss, healthy - loss_within(found, fit, machine.parameter_tolerance))
        gain = min(base - held_out_loss(found, fit, folds), drop - found.thresholds.price * (len(fit.free) - len(found.fit.free)))
        evidence = gain / min(found.inflation, inflation(group, fit))
        last = fit.settings[-1]
        plausible = is_plausible(last, machine) and not is_imitated(found, last, machine)
        needed = evidence_needed(found, last, len(folds))
        candidates.append(Candidate(fit, evidence, needed, plausible, closed_share(found, found.fit.loss - fit.loss)))
    return found, tuple(sorted(candidates, key=lambda c: -(c.evidence - (0.0 if c.plausible else 1e9))))


def _is_linear(setting: Setting) -> bool:
    return setting.effect.is_linear


def _without_superfluous(found: Found, machine: Machine, folds: Sequence[Sequence[int]], mapper: Mapper) -> Found:
    """The state without accepted effects that the later ones have made superfluous."""
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
        if worst is None or worst[0] >= found.thresholds.evidence:
            break
        found = replace(found, fit=worst[1])
    return found
