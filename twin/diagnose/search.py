"""The search for the effects of a group of axes.

Each round

    screens all starts with the effects found eliminated      (`twin.diagnose.screen`)
    picks a set of effects, fits each and its rivals          (`twin.diagnose.rivals`)
    fits the winners together with all effects found before
    removes effects that the new ones made redundant.

The search ends when no effect reaches the evidence it needs.
"""

from collections import Counter
from collections.abc import Collection, Sequence
import contextlib
from dataclasses import replace
import math

import numpy as np

from twin.diagnose.cross_validation import evidence_needed, residual_within
from twin.diagnose.fit import fit_effects, no_effect, simulated_response, slopes_of_linear_effects
from twin.diagnose.imperfections import moved_to, on_imperfect_machine, with_imperfections, with_noise_about
from twin.diagnose.not_visible import effects_not_visible
from twin.diagnose.observe import Group, Variation
from twin.diagnose.plausible import is_plausible, is_ruled_out
from twin.diagnose.rivals import Fitted, fit_picks, picks_of
from twin.diagnose.screen import screening
from twin.diagnose.settings import T
from twin.diagnose.setup import Setup
from twin.diagnose.slip import with_drive_trains, with_refitted_slip
from twin.diagnose.starts import starts_of
from twin.diagnose.state import GroupState, Screened, axes_above_noise, closed_share, is_isolated, open_channels
from twin.diagnose.tolerance import tuned
from twin.diagnose.tuning import Tuning, linearised, tuning_of
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.simulation.run import all_or_raise
from twin.system import return_memory


def search(group: Group, setup: Setup) -> GroupState:
    """The final state of a group of axes, with every accepted effect and the rivals it was compared with.

    A ballbar radius does not separate normal imperfections from effects. Imperfections that are fitted first may absorb an effect. The axes
    of a ballbar are therefore searched a second time without imperfections at the start; the state with the lower cost is returned.
    """
    return_memory()  # of the observation
    initial = _initial_state(group)
    initial = initial if setup.quick else with_refitted_slip(initial)
    state = _search_rounds(initial, setup)
    if initial.tuning.are_imperfections.any() and state.fit.settings and group.by_radius:
        tuning = tuning_of(group)
        rigid = GroupState(group, group, tuning, no_effect(group, tuning)).inflated()
        state = min(state, _search_rounds(rigid, setup), key=_cost)
    group = state.group.searched()
    state = replace(state, response_cache={}, group=group, rigid=group if state.rigid is state.group else state.rigid.searched())
    return_memory()
    return state


def _cost(state: GroupState) -> float:
    """Half the squared residual over noise, plus the evidence that its effects and normal imperfections required [nat]."""
    noise_weights = np.concatenate([replace(c, doubt=0.0).weight for c in state.group.channels])
    residual = state.fit.residual(state.group) / state.group.weights * noise_weights
    imperfections = int(state.tuning.are_imperfections.sum())
    return 0.5 * float(residual @ residual) + T.evidence_in_sample * len(state.fit.settings) + T.evidence * imperfections


def _search_rounds(state: GroupState, setup: Setup) -> GroupState:
    """The state after the last round: no further effect reaches the evidence it needs."""
    quick = setup.quick
    axes_of_group = set(state.group.axes)
    times_fitted: Counter[Key] = Counter()
    refitted = False
    while True:
        if not refitted and _imperfections_need_refit(state):
            state, refitted = _refit_imperfections(state), True
        axes = axes_above_noise_within_tolerance(state) if quick else axes_of_group
        if not axes:
            break
        rounds, times = state.rounds, times_fitted.copy()
        state, winners = _round(state, axes, times_fitted, setup)
        if winners and not refitted and not quick and _residual_is_small(state):
            refitted, better = True, _refit_imperfections(state)
            if state.fit.loss - better.fit.loss > T.evidence:  # the winners may explain only what the imperfections left
                state, times_fitted = replace(better, rounds=rounds), times
                continue
        if winners:
            state = _with_accepted(state, winners)
        elif quick or (with_slip := with_refitted_slip(state)) is state:
            break
        else:  # slip is sized only now: sized earlier, it would absorb missing effects
            state = with_slip
        state, refitted = _without_redundant_effects(state, setup), False
    return state


def _round(state: GroupState, axes: Collection[str], times_fitted: Counter[Key], setup: Setup) -> tuple[GroupState, list[Fitted]]:
    """The state with the candidates of one round on these axes, and the accepted effects. Updates `times_fitted`."""
    label = "+".join(state.group.axes)
    setup.progress(f"{label}: screening next to {len(state.fit.settings)} effects")
    starts = [s for s in starts_of(state.group, state.fit.residual(state.group)) if s.axis in axes and s.key not in state.keys]
    screened = screening(state, [s for s in starts if not is_ruled_out(state.group, s)])
    if not state.screened:
        order = sorted(screened.best().items(), key=lambda item: -item[1][1].gain)
        shown = [(key, g.gain, screened.setting(i, g, state.group.machine), closed_share(state, g.gain)) for key, (i, g) in order]
        state = replace(state, screened=tuple(Screened(*one) for one in shown))
        if not setup.quick:
            not_visible = effects_not_visible(state, starts, len(setup.folds))
            state = replace(state, not_visible=not_visible)
    refused = {key for key, times in times_fitted.items() if times >= T.most_fits}
    picks = picks_of(state, screened, refused, setup)
    if not picks:
        return state, []
    setup.progress(f"{label}: fitting {', '.join(' '.join(p.setting.key[:2]) for p in picks)}")
    fitted = fit_picks(state, screened, picks, setup)
    state = replace(state, rounds=(*state.rounds, *(tuple(f.candidate for f in of_pick) for of_pick in fitted)))
    best = [next((f for f in of_pick if f.candidate.plausible), None) for of_pick in fitted]
    found = list({f.candidate.key: f for f in best if f is not None and f.candidate.evidence >= f.candidate.needed}.values())
    winners = _one_at_a_time_where_not_isolated(state.group, found)
    waiting = {f.candidate.key for f in found if f not in winners}
    times_fitted.update(({p.setting.key for p in picks} | {w.candidate.key for w in winners}) - waiting)
    return state, winners


def _one_at_a_time_where_not_isolated(group: Group, found: Sequence[Fitted]) -> list[Fitted]:
    """The accepted effects of a round without those that wait for the next one.

    Effects in blocks that no channel isolates are visible in the same signals, and there a normal imperfection that a louder effect hid looks like
    a second effect. Of an axis with such an effect, only the one with the most evidence is accepted; then its imperfections are fitted again.
    """
    axes = {f.candidate.setting.axis for f in found if not is_isolated(group, f.candidate.setting)}
    most = {axis: max((f for f in found if f.candidate.setting.axis == axis), key=lambda f: f.candidate.evidence) for axis in axes}
    return [f for f in found if f is most.get(f.candidate.setting.axis, f)]


def _initial_state(group: Group) -> GroupState:
    """The state without effects, linearised about the machine with its normal imperfections, with the noise of that machine."""
    rigid = group
    tuning = with_imperfections(tuning_of(group), group, group.residual)
    group, tuning = on_imperfect_machine(group, tuning, group.residual)
    if group is not rigid:
        weights = group.weights
        rigid, group = with_noise_about(rigid, group, no_effect(group, tuning).residual(group))
        tuning = tuning.reweighted(group.weights / weights)
        with contextlib.suppress(TwinError):  # nearly unstable: keep the linearisation of the rigid machine
            tuning = linearised(tuning, group, (), 0.0, only_imperfections=True)
    return GroupState(group, rigid, tuning, no_effect(group, tuning)).inflated()


def _imperfections_need_refit(state: GroupState) -> bool:
    """Is the residual small, but above noise in all or in a single channel, on a machine with normal imperfections?

    These were fitted one by one and may be slightly off.
    """
    return _residual_is_small(state) and (not _is_near_noise(state) or bool(open_channels(state)))


def _is_near_noise(state: GroupState) -> bool:
    """Is the loss hardly more than that of noise?"""
    return state.fit.loss <= (1.0 + T.near_noise) * state.group.expected_loss


def _residual_is_small(state: GroupState) -> bool:
    """Is the residual of a machine with normal imperfections near noise, so that slightly wrong imperfections may cause it?"""
    return bool(state.tuning.are_imperfections.any()) and state.fit.loss <= T.small_residual * state.group.expected_loss


def _refit_imperfections(state: GroupState) -> GroupState:
    """The state with effects and normal imperfections fitted jointly, with slopes on the machine that has all of them.

    The fit ends near noise: imperfections would go on to absorb what is missing in it, such as small effects.
    """
    while (better := _relinearised(state)) is not state:
        before, state = state.fit.loss, better
        try:
            nearer, tuning = moved_to(state.rigid, state.tuning, state.fit.theta)
        except TwinError:  # nearly unstable: the slopes are not valid at this distance
            break
        if nearer is not state.rigid:
            moved = fit_effects(nearer, tuning, state.fit.settings, T.refit_steps, known=state.fit.slopes)
            if moved is not None and moved.loss < state.fit.loss + T.evidence:
                state = replace(state, fit=moved, group=nearer, tuning=tuning)
        if before - state.fit.loss < T.evidence or _is_near_noise(state):
            break
    return state.with_fit(state.fit).inflated()


def _with_accepted(state: GroupState, winners: Sequence[Fitted]) -> GroupState:
    """The state with the winners of a round, all effects fitted jointly. The model error of the effects is added to the noise, and the
    normal imperfections are fitted anew."""
    settings = [*state.fit.settings, *(w.candidate.setting for w in winners)]
    slopes = {name: column for w in winners for name, column in w.slopes.items()} | state.fit.slopes
    known = slopes_of_linear_effects(slopes, settings)
    fit = fit_effects(state.group, state.tuning, settings, T.refit_steps, known=known)
    if fit is None:
        return state
    state = replace(state, fit=fit).with_model_error(fit.response)
    residual = state.rigid.residual - state.fit.response
    tuning = with_imperfections(state.tuning, state.rigid, residual)
    group, tuning = on_imperfect_machine(state.rigid, tuning, residual)
    again = fit_effects(group, tuning, state.fit.settings, T.refit_steps, known=state.fit.slopes)
    if again is not None and again.loss < state.fit.loss:
        state = replace(state, group=group, tuning=tuning, fit=again)
    if not all(s.effect.is_linear for s in state.fit.settings):
        state = _relinearised(state)
    return with_drive_trains(state.with_accepted(len(state.accepted) + 1).inflated())


def _relinearised(state: GroupState) -> GroupState:
    """The state fitted again with columns of the tuning that are right on the machine with its effects; unchanged if the loss does not improve."""
    try:
        tuning = tuning_beside(state)
    except TwinError:  # nearly unstable: keep the columns
        return state
    fit = fit_effects(state.group, tuning, state.fit.settings, T.refit_steps, known=state.fit.slopes)
    return state if fit is None or fit.loss > state.fit.loss else replace(state, tuning=tuning, fit=fit)


def tuning_beside(state: GroupState) -> Tuning:
    """The tuning of the fit with columns that are right on the machine with its effects.

    Columns are simulated again only if the machine at the fitted values, one simulation, answers otherwise than they say, by more than it did
    when they were simulated: a response that bends is not linear there either. Those of normal imperfections, whose response bends most, are
    simulated in any case.
    """
    group, fit, about = state.group, state.fit, state.fit.about
    theta = np.where(about.are_imperfections, 0.0, fit.theta)
    (moved,) = all_or_raise(group.responses([Variation(tuned(about.nuisances, theta * about.spread), fit.settings)]))
    answer = moved - fit.response

    def missed(tuning: Tuning) -> float:
        return tuning.loss(answer - tuning.of_nuisances.times(theta))

    if missed(about) < about.bend + T.price:
        return replace(linearised(about, group, fit.settings, fit.response, only_imperfections=True), bend=about.bend)
    tuning = linearised(about, group, fit.settings, fit.response)
    return replace(tuning, bend=missed(tuning))


def _without_redundant_effects(state: GroupState, setup: Setup) -> GroupState:
    """The state without redundant effects: those whose removal, with the others fitted anew, costs less than the evidence they need."""
    while state.fit.settings:
        all_free = state.tuning.with_free(state.fit.columns)
        margins = [_evidence_margin(state, i, all_free, setup) for i in range(len(state.fit.settings))]
        worst = int(np.argmin(margins))
        if margins[worst] >= 0.0:
            break
        kept = [s for j, s in enumerate(state.fit.settings) if j != worst]
        refitted = fit_effects(state.group, state.tuning, kept, 2, known=state.fit.slopes)
        if refitted is None:
            break
        state = state.with_fit(refitted).inflated()
    return state


def _evidence_margin(state: GroupState, i: int, all_free: Tuning, setup: Setup) -> float:
    """Evidence for effect i next to the others, minus the evidence it needs [nat]; -inf if its size is implausible, inf if the others need it.

    `all_free` is the tuning with the slopes of all effects as free columns; the other effects are refitted with it.
    """
    setting = state.fit.settings[i]
    if not is_plausible(setting, state.group.machine, is_isolated(state.group, setting)):
        return -math.inf
    needed = evidence_needed(state, setting, len(setup.folds))
    columns = [state.tuning.further.size + k for k, f in enumerate(state.fit.free) if f.setting == i]
    tuning = all_free.holding(columns)

    def margin(response_of_others: np.ndarray) -> float:
        loss = tuning.loss(state.group.residual - response_of_others)
        return (loss - state.fit.loss - T.price * len(columns)) / state.inflation - needed

    linear = response_without(state, i) if setting.effect.is_linear else None
    # far above the needed evidence the linear prediction is accurate enough
    if linear is not None and (clear := margin(linear)) > needed:
        return clear
    others = [s for j, s in enumerate(state.fit.settings) if j != i]
    try:
        return margin(simulated_response(state.group, others) if others else np.zeros(state.group.size))
    except TwinError:  # the others cannot be simulated without it: a spring that is too stiff alone, behind a backlash
        return math.inf


def response_without(state: GroupState, i: int) -> np.ndarray | None:
    """Response (row,) to all effects but i, if i is linear in its size; None if its size was not fitted."""
    fit = state.fit
    setting = fit.settings[i]
    size = setting.effect.size
    for k, free in enumerate(fit.free):
        if free.setting == i and free.parameter is size:
            value = setting.parameters[size.name]
            steps = 1.0 / free.unit if free.logarithmic else (value - (size.neutral or 0.0)) / free.unit
            return fit.response - fit.columns.whole(k) * steps
    return None


def axes_above_noise_within_tolerance(state: GroupState) -> set[str]:
    """Axes whose residual exceeds the noise for every machine near the tolerance."""
    tolerance = T.widest * state.group.machine.parameter_tolerance
    return axes_above_noise(state.group, residual_within(state, state.fit, tolerance, normal=False))
