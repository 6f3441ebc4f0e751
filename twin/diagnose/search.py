"""Which effects a group of axes has: all that earn their place, found together.

A round screens every start beside what is known (`twin.diagnose.screen`), picks a set of effects from that linear problem, fits each
picked one and its rivals in closed loop, takes the winners, and fits all effects together. Effects that others have made superfluous
leave. The rounds end when no effect earns its place. At the end each effect is held against its rivals once more, beside all others.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
import contextlib
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from twin.diagnose.candidates import Start, starts_of
from twin.diagnose.cross_validation import evidence_needed, held_out_loss, left_within, loss_within
from twin.diagnose.fit import (
    Fit,
    Slope,
    fit_effects,
    fit_with_fixed_effects,
    no_effect,
    relinearised_tuning,
    simulated_response,
    slopes_of_linear_effects,
)
from twin.diagnose.imperfections import moved_to, on_imperfect_machine, with_imperfections
from twin.diagnose.not_visible import effects_not_visible
from twin.diagnose.observe import Group, with_noise_about
from twin.diagnose.plausible import CONTROL_BLOCKS, is_imitated, is_plausible, is_ruled_out
from twin.diagnose.screen import Gain, Screening, screening
from twin.diagnose.simulations import Mapper
from twin.diagnose.slip import with_refitted_slip
from twin.diagnose.state import Candidate, GroupState, Key, Screened, axes_above_noise, closed_share, inflation, is_cut, localised_on
from twin.diagnose.tolerance import NORMAL
from twin.diagnose.tuning import Tuning, stacked_columns, tuning_of
from twin.effects import Setting
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.simulation.run import all_or_raise

Folds = Sequence[Sequence[int]]


class Fitted(NamedTuple):
    """A candidate with the slopes of its parameters, from which all effects are fitted together."""

    candidate: Candidate
    slopes: dict[Slope, np.ndarray]


class Pick(NamedTuple):
    """A start picked from the screening, its setting, and the settings of its rivals, best first."""

    start: int
    setting: Setting
    rivals: tuple[Setting, ...]


def search(
    group: Group, machine: Machine, folds: Folds, mapper: Mapper, progress: Callable[[str], None], quick: bool = False
) -> GroupState:
    """The last state of a group of axes: all effects that earn their place, each with the rivals that it was held against.

    A radius does not cut normal imperfections from an effect. Those that are found first are then fitted to it, and part its rivals by how well each
    goes with them. So a ballbar's axes are searched a second time with imperfections beside the effects only, and the simpler answer is taken.
    """
    begun = _initial_state(group, machine, mapper)
    begun = begun if quick else with_refitted_slip(begun, machine, mapper)
    found = _search_rounds(begun, machine, folds, mapper, progress, quick)
    imperfect = any(n.quantity in NORMAL for n in begun.tuning.nuisances)
    if imperfect and found.fit.settings and group.by_radius:
        tuning = tuning_of(group, machine, mapper)
        retuned = no_effect(group, tuning)
        rigid = GroupState(group, group, tuning, retuned, retuned, inflation(group, retuned))
        found = min(found, _search_rounds(rigid, machine, folds, mapper, progress, quick), key=_cost)
    return found


def _cost(state: GroupState) -> float:
    """Half the squares over noise that a state leaves, and what its effects and normal imperfections must have brought [nat]."""
    t, left = state.thresholds, state.group.in_noise(state.fit.left(state.group))
    normal = sum(n.quantity in NORMAL for n in state.tuning.nuisances)
    return 0.5 * float(left @ left) + t.evidence_in_sample * len(state.fit.settings) + t.imperfection_earned * normal


def _search_rounds(
    state: GroupState, machine: Machine, folds: Folds, mapper: Mapper, progress: Callable[[str], None], quick: bool
) -> GroupState:
    """The state when no further effect earns its place."""
    t, group = state.thresholds, state.group
    asked_of: Counter[Key] = Counter()
    looked = False
    for _ in range(t.rounds):
        if not looked and _imperfections_need_refit(state):
            state, looked = _refit_imperfections(state, machine, mapper), True
        asked = axes_above_noise_within_tolerance(state, machine) if quick else set(group.axes)
        if not asked:
            break
        state, winners = _round(state, asked, asked_of, machine, folds, mapper, progress, quick)
        if winners:
            state = _with_accepted(state, winners, machine, mapper)
        elif quick or (slipping := with_refitted_slip(state, machine, mapper)) is state:
            break
        else:  # a slip that is sized while effects are missing stands in for them
            state = slipping
        state, looked = _without_redundant_effects(state, machine, folds, mapper), False
    return state


def _round(
    state: GroupState,
    asked: Collection[str],
    asked_of: Counter[Key],
    machine: Machine,
    folds: Folds,
    mapper: Mapper,
    progress: Callable[[str], None],
    quick: bool,
) -> tuple[GroupState, list[Fitted]]:
    """The state with what was screened and fitted on the axes `asked`, and the effects that earn their place; counts how often each was `asked_of`."""
    t, of = state.thresholds, "+".join(state.group.axes)
    progress(f"{of}: screening beside {len(state.fit.settings)} effects")
    starts = [s for s in starts_of(state.group, machine, state.fit.left(state.group)) if s.axis in asked and s.key not in state.keys]
    screened = _screened(state, starts, mapper)
    if not state.screened:
        state = replace(state, screened=_screened_effects(state, screened, machine))
        if not quick:
            state = replace(state, not_visible=effects_not_visible(state, starts, machine, len(folds), mapper))
    refused = {key for key, times in asked_of.items() if times >= t.most_asked}
    picks = _picks(state, screened, machine, refused, len(folds))
    if not picks:
        return state, []
    progress(f"{of}: fitting {', '.join(' '.join(p.setting.key[:2]) for p in picks)}")
    contests = _fit_picks(state, screened, picks, machine, folds, mapper, quick)
    state = replace(state, rounds=(*state.rounds, *(tuple(f.candidate for f in contest) for contest in contests)))
    best = [next((f for f in contest if f.candidate.plausible), None) for contest in contests]
    winners = list({f.candidate.key: f for f in best if f is not None and f.candidate.evidence >= f.candidate.needed}.values())
    asked_of.update({p.setting.key for p in picks} | {w.candidate.key for w in winners})
    return state, winners


def _initial_state(group: Group, machine: Machine, mapper: Mapper) -> GroupState:
    """The state before any effect: about the machine with its normal imperfections, with noise as it is there."""
    rigid = group
    tuning = with_imperfections(tuning_of(group, machine, mapper), group, machine, group.residual, mapper)
    group, tuning = on_imperfect_machine(group, tuning, group.residual, mapper)
    if group is not rigid:
        weights = group.weights
        rigid, group = with_noise_about(rigid, group, no_effect(group, tuning).left(group))
        tuning = tuning.reweighted(group.weights / weights)
        with contextlib.suppress(TwinError):  # next to unstable: as it answers as a whole
            tuning = relinearised_tuning(group, no_effect(group, tuning), machine, mapper, only=NORMAL)
    retuned = no_effect(group, tuning)
    return GroupState(group, rigid, tuning, retuned, retuned, inflation(group, retuned))


def _imperfections_need_refit(state: GroupState) -> bool:
    """Is what is left so little that it may be of the normal imperfections, which were found one after another?"""
    t, noise = state.thresholds, state.group.expected_loss
    if not any(n.quantity in NORMAL for n in state.tuning.nuisances) or state.fit.loss > t.little_left * noise:
        return False
    return state.fit.loss > (1.0 + t.near_noise) * noise or bool(localised_on(state))


def _refit_imperfections(state: GroupState, machine: Machine, mapper: Mapper) -> GroupState:
    """The state with effects and normal imperfections fitted together, all as they act on the machine that has them."""
    t, group = state.thresholds, state.group
    for _ in range(t.looks):
        before = state.fit.loss
        try:
            tuning = relinearised_tuning(state.group, state.fit, machine, mapper)
            fit = fit_effects(state.group, machine, tuning, state.fit.settings, mapper, t.refit_steps, known=state.fit.slopes)
            if fit is None or fit.loss > before:
                break
            state = replace(state, fit=fit, tuning=tuning)
            nearer, tuning = moved_to(state.rigid, tuning, fit.tuning[: len(tuning.nuisances)], mapper)
        except TwinError:  # next to unstable: slopes from further off say nothing
            break
        if nearer is not state.rigid:
            moved = fit_effects(nearer, machine, tuning, fit.settings, mapper, t.refit_steps, known=fit.slopes)
            if moved is not None and moved.loss < fit.loss + t.evidence:
                state = replace(state, fit=moved, group=nearer, tuning=tuning)
        if before - state.fit.loss < t.evidence:
            break
    if state.group is not group:
        state = replace(state, retuned=no_effect(state.group, state.tuning))
    return state.with_fit(state.fit).inflated()


def _screened(state: GroupState, starts: Sequence[Start], mapper: Mapper) -> Screening:
    return screening(state, [s for s in starts if not is_ruled_out(state.group, s)], state.group.residual - state.fit.response, mapper)


def _screened_effects(state: GroupState, screened: Screening, machine: Machine) -> tuple[Screened, ...]:
    """All effects as they were screened, the best first."""
    order = sorted(screened.best().items(), key=lambda item: -item[1][1].gain)
    return tuple(Screened(key, g.gain, screened.setting(i, g, machine), closed_share(state, g.gain)) for key, (i, g) in order)


def _picks(state: GroupState, screened: Screening, machine: Machine, refused: Collection[Key], folds: int) -> list[Pick]:
    """Effects that explain what is left together, the best first: each is picked beside those before it."""
    t = state.thresholds
    picks: list[Pick] = []
    passed = set(refused)
    first = 0.0
    while len(picks) < t.together:
        best = {key: item for key, item in screened.best().items() if key not in passed}
        if not best:
            break
        key, (start, gain) = max(best.items(), key=lambda item: item[1][1].gain)
        passed.add(key)
        setting = screened.setting(start, gain, machine)
        first, needed = first or gain.gain, evidence_needed(state, setting, folds)
        if gain.gain < max(t.span * first, t.promising * needed):
            break
        if setting.effect.is_linear and len(setting.parameters) == 1 and gain.gain < t.sure * needed:
            continue  # a size alone: a fit gains no more than its screening says
        after = screened.without(start)
        rivals = sorted((item for k, item in best.items() if k != key), key=lambda item: -item[1].gain)
        picks.append(Pick(start, setting, tuple(screened.setting(i, g, machine) for i, g in _rivals(screened, after, rivals, gain))))
        screened = after
    return picks


def _rivals(screened: Screening, after: Screening, others: Sequence[tuple[int, Gain]], gain: Gain) -> list[tuple[int, Gain]]:
    """Of other starts those that explain the same as one that gained `gain` and was eliminated `after`, at most `most_rivals`."""
    t = screened.thresholds

    def near(i: int, g: Gain) -> bool:
        within = t.rivals_within if screened.starts[i].effect.is_linear else t.bent_within
        return g.gain > within * gain.gain and after.gain(i).gain < t.same_gain * g.gain

    return [(i, g) for i, g in others if near(i, g)][: t.most_rivals]


def _fit_picks(
    state: GroupState, screened: Screening, picks: Sequence[Pick], machine: Machine, folds: Folds, mapper: Mapper, quick: bool
) -> list[tuple[Fitted, ...]]:
    """Each pick and its rivals fitted in closed loop beside what was found, the others' answers free; best first."""
    answers = [
        stacked_columns(*(column[:, None] for column in all_or_raise(state.cached_responses(screened.starts[p.start].settings))))
        for p in picks
    ]
    bending = tuple(s for s in state.fit.settings if not s.effect.is_linear)
    # effects in proportion to their size add to what the others answer; they are simulated together once, at the end
    rest = state.group.residual - state.fit.response + (simulated_response(state.group, bending, mapper) if bending else 0.0)
    before = state.tuning.further.size + state.fit.columns.shape[1]
    ends = before + np.cumsum([0, *(a.shape[1] for a in answers)])
    all_free = state.tuning.with_free(stacked_columns(state.fit.columns, *answers))

    def contest(i: int) -> tuple[Fitted, ...]:
        base = fit_with_fixed_effects(state.group, all_free.holding(range(ends[i], ends[i + 1])), state.fit.settings, state.fit.response)
        return _fit_with_rivals(state, base, bending, rest, (picks[i].setting, *picks[i].rivals), machine, folds, mapper, quick)

    with ThreadPoolExecutor(2) as contests:
        return list(contests.map(contest, range(len(picks))))


def _fit_with_rivals(
    state: GroupState,
    base: Fit,
    bending: tuple[Setting, ...],
    rest: np.ndarray,
    settings: Sequence[Setting],
    machine: Machine,
    folds: Folds,
    mapper: Mapper,
    quick: bool,
) -> tuple[Fitted, ...]:
    """Settings fitted one by one beside a fit, best first.

    `bending` are those of the fit's effects that are simulated with each; `rest` (row,) is the residual that the other ones leave them.
    """
    t = state.thresholds
    steps = t.quick_steps if quick else t.fit_steps

    def fitted(setting: Setting) -> Fit | None:
        alone = fit_effects(state.group, machine, base.about, [*bending, setting], mapper, steps, moving={len(bending)}, residual=rest)
        if alone is None or len(bending) == len(base.settings):
            return alone
        moving, known = {len(base.settings)}, alone.slopes
        settings = [*base.settings, alone.settings[-1]]
        together = fit_effects(state.group, machine, base.about, settings, mapper, 1, moving=moving, known=known)
        if together is None or together.loss < alone.loss + max(t.price, t.doubt * (base.loss - alone.loss)):
            return together
        return fit_effects(state.group, machine, base.about, settings, mapper, steps, moving=moving)

    with ThreadPoolExecutor(len(settings)) as fitting:  # they wait for the workers' simulations
        fits = [fit for fit in fitting.map(fitted, settings) if fit is not None]
    healthy = loss_within(state, base, machine.parameter_tolerance)
    # where no machine near the tolerance is like this one, parameters far off it are no rival of an effect
    level = max(held_out_loss(state, base, folds), loss_within(state, base, t.widest * machine.parameter_tolerance))
    fitted_ones = []
    for fit in fits:
        drop = base.loss - fit.loss
        closes = closed_share(state, drop)
        # on runs left out, and not more than the drop on all runs pays for its parameters, whatever machine within the tolerance it is
        paid = min(drop, healthy - loss_within(state, fit, machine.parameter_tolerance)) - t.price * len(fit.free)
        gain = min(level - held_out_loss(state, fit, folds), paid)
        evidence = gain / min(state.inflation, inflation(state.group, fit))
        last = fit.settings[-1]
        plausible = is_plausible(last, machine, is_cut(state.group, last)) and not is_imitated(state, last, machine)
        needed = evidence_needed(state, last, len(folds))
        if base.settings and last.effect.block in CONTROL_BLOCKS and closes < t.least_share:
            plausible = False  # beside another effect a control is only wrong where that explains what is left
        fitted_ones.append(Fitted(Candidate(fit.sizes(), evidence, needed, plausible, closes, drop), fit.slopes))
    return tuple(sorted(fitted_ones, key=lambda f: -(f.candidate.evidence - (0.0 if f.candidate.plausible else 1e9))))


def _with_accepted(state: GroupState, winners: Sequence[Fitted], machine: Machine, mapper: Mapper) -> GroupState:
    """The state with more effects, all fitted together. They are trusted to a share of what they change, and normal imperfections are
    found anew beside them."""
    t = state.thresholds
    settings = [*state.fit.settings, *(w.candidate.setting for w in winners)]
    slopes = {name: column for w in winners for name, column in w.slopes.items()} | state.fit.slopes
    fit = fit_effects(state.group, machine, state.tuning, settings, mapper, t.refit_steps, known=slopes_of_linear_effects(slopes, settings))
    if fit is None:
        return state
    state = replace(state, fit=fit).doubted(fit.response)
    left = state.rigid.residual - state.fit.response
    tuning = with_imperfections(state.tuning, state.rigid, machine, left, mapper)
    group, tuning = on_imperfect_machine(state.rigid, tuning, left, mapper)
    again = fit_effects(group, machine, tuning, state.fit.settings, mapper, t.refit_steps, known=state.fit.slopes)
    if again is not None and again.loss < state.fit.loss:
        state = replace(state, group=group, retuned=no_effect(group, tuning), tuning=tuning, fit=again)
    state = _with_relinearised_tuning(state, machine, mapper)
    return replace(state, accepted=(*state.accepted, state.fit)).inflated()


def _with_relinearised_tuning(state: GroupState, machine: Machine, mapper: Mapper) -> GroupState:
    """The state with re-tuning as it acts on the machine that has the effects, where one of them bends what the others answer."""
    settings = state.fit.settings
    if all(s.effect.is_linear for s in settings):
        return state
    try:
        tuning = relinearised_tuning(state.group, state.fit, machine, mapper)
    except TwinError:  # next to unstable: as it acts without the effects
        return state
    fit = fit_effects(state.group, machine, tuning, settings, mapper, state.thresholds.refit_steps, known=state.fit.slopes)
    return state if fit is None or fit.loss > state.fit.loss else replace(state, tuning=tuning, fit=fit)


def _without_redundant_effects(state: GroupState, machine: Machine, folds: Folds, mapper: Mapper) -> GroupState:
    """The state without effects that the others have made superfluous: what each closes beside them must still be its evidence."""
    while state.fit.settings:
        all_free = state.tuning.with_free(state.fit.columns)
        missed = [_evidence_margin(state, i, all_free, machine, folds, mapper) for i in range(len(state.fit.settings))]
        worst = int(np.argmin(missed))
        if missed[worst] >= 0.0:
            break
        rest = [s for j, s in enumerate(state.fit.settings) if j != worst]
        refitted = fit_effects(state.group, machine, state.tuning, rest, mapper, 2, known=state.fit.slopes)
        if refitted is None:
            break
        state = state.with_fit(refitted).inflated()
    return state


def _evidence_margin(state: GroupState, i: int, all_free: Tuning, machine: Machine, folds: Folds, mapper: Mapper) -> float:
    """By how much what effect i closes beside the others is more than the evidence that it needs [nat]; -inf where no machine has its size.

    `all_free` is the tuning with the effects' slopes beside it, by which the others are fitted anew.
    """
    setting = state.fit.settings[i]
    if not is_plausible(setting, machine, is_cut(state.group, setting)):
        return -math.inf
    needed = evidence_needed(state, setting, len(folds))
    own = [state.tuning.further.size + k for k, f in enumerate(state.fit.free) if f.setting == i]
    tuning = all_free.holding(own)

    def beyond(others: np.ndarray) -> float:
        loss = tuning.loss(state.group.residual - others)
        return (loss - state.fit.loss - state.thresholds.price * len(own)) / state.inflation - needed

    others = response_without(state, i) if setting.effect.is_linear else None
    # where an effect is far above what it needs, its slope says so surely enough
    if others is not None and (clear := beyond(others)) > needed:
        return clear
    rest = [s for j, s in enumerate(state.fit.settings) if j != i]
    return beyond(simulated_response(state.group, rest, mapper) if rest else np.zeros(state.group.size))


def response_without(state: GroupState, i: int) -> np.ndarray | None:
    """What all effects but i change (row,), if i changes in proportion to its size; None where the size was not fitted."""
    fit = state.fit
    setting = fit.settings[i]
    size = setting.effect.size
    for k, free in enumerate(fit.free):
        if free.setting == i and free.parameter is size:
            value = setting.parameters[size.name]
            steps = 1.0 / free.unit if free.logarithmic else (value - (size.neutral or 0.0)) / free.unit
            return fit.response - fit.columns[:, k] * steps
    return None


def axes_above_noise_within_tolerance(state: GroupState, machine: Machine) -> set[str]:
    """Axes that keep more than noise, whatever machine near the tolerance this is; what is far off it is no re-tuning."""
    return axes_above_noise(state.group, left_within(state, state.fit, state.thresholds.widest * machine.parameter_tolerance, normal=False))
