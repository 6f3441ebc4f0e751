"""Fits of picked effects and their rivals in closed loop, and the evidence for each.

A pick is a start that the screening selected. Its rivals are starts that explain the same part of the residual. Each of them is fitted next
to the effects found, while the linear responses of the other picks stay free.
"""

from collections.abc import Collection, Sequence
import itertools
from typing import NamedTuple

import numpy as np

from twin.diagnose.columns import Column, Columns
from twin.diagnose.cross_validation import evidence_needed, held_out_loss, loss_within
from twin.diagnose.fit import Asks, Fit, Slope, fit_with_fixed_effects, fits_together, fitting, simulated_response
from twin.diagnose.observe import Group
from twin.diagnose.plausible import is_plausible
from twin.diagnose.screen import Gain, Screening
from twin.diagnose.settings import T
from twin.diagnose.setup import Setup
from twin.diagnose.state import Candidate, GroupState, closed_share, inflation, is_isolated
from twin.effects import Setting
from twin.effects.setting import Key
from twin.simulation.run import all_or_raise


class Fitted(NamedTuple):
    """A candidate with the slopes of its parameters; the joint fit of all effects starts from them."""

    candidate: Candidate
    slopes: dict[Slope, Column]


class Pick(NamedTuple):
    """Index of a picked start, its setting, and the settings of its rivals, best first."""

    start: int
    setting: Setting
    rivals: tuple[Setting, ...]


def picks_of(state: GroupState, screened: Screening, refused: Collection[Key], setup: Setup) -> list[Pick]:
    """Effects that together explain the residual, best first. Each is picked with the responses of the earlier ones eliminated."""
    machine = state.group.machine
    picks: list[Pick] = []
    passed = set(refused)
    first = 0.0
    while True:
        best = {key: item for key, item in screened.best().items() if key not in passed}
        if not best:
            break
        key, (start, gain) = max(best.items(), key=lambda item: item[1][1].gain)
        passed.add(key)
        setting = screened.setting(start, gain, machine)
        first, needed = first or gain.gain, evidence_needed(state, setting, len(setup.folds))
        if gain.gain < max(T.doubt * first, T.half * needed):
            break
        if setting.effect.is_linear and len(setting.parameters) == 1 and gain.gain < needed:
            continue  # a fit of the size alone gains no more than the screening
        after = screened.without(start)
        others = sorted((item for k, item in best.items() if k != key), key=lambda item: -item[1].gain)
        rivals = [(i, g) for i, g in others if _is_rival(i, g, screened, after, gain)]
        picks.append(Pick(start, setting, tuple(screened.setting(i, g, machine) for i, g in rivals[: T.most_rivals])))
        screened = after
    return picks


def _is_rival(start: int, own: Gain, screened: Screening, after: Screening, gain: Gain) -> bool:
    """Whether a start explains the same as a pick with this gain; `after` has the pick eliminated. The screening of nonlinear effects is coarse."""
    within = T.rivals_within if screened.starts[start].effect.is_linear else T.remaining
    return own.gain > within * gain.gain and after.gain(start).gain < T.half * own.gain


def fit_picks(state: GroupState, screened: Screening, picks: Sequence[Pick], setup: Setup) -> list[tuple[Fitted, ...]]:
    """Each pick and its rivals fitted in closed loop next to the effects found, best first, implausible ones last. Responses of other picks are free."""
    fit = state.fit
    starts = [screened.starts[pick.start].settings for pick in picks]
    responses = [Columns(all_or_raise(state.cached_responses(settings)), state.group.size) for settings in starts]
    nonlinear = _nonlinear(fit.settings)
    # responses of linear effects add up, so those are simulated together only once, at the end
    residual = state.group.residual - fit.response + (simulated_response(state.group, nonlinear) if nonlinear else 0.0)
    first = state.tuning.further.size + len(fit.columns)
    ends = first + np.cumsum([0, *(len(r) for r in responses)])
    all_free = state.tuning.with_free(fit.columns.beside(*responses))

    tunings = [all_free.holding(range(*ends[i : i + 2])) for i in range(len(picks))]
    bases = [fit_with_fixed_effects(state.group, tuning, fit.settings, fit.response) for tuning in tunings]
    started = [(base, setting) for base, pick in zip(bases, picks) for setting in (pick.setting, *pick.rivals)]
    steps = T.refit_steps if setup.quick else T.fit_steps
    fits = iter(fits_together(state.group, [_fit_beside(state.group, base, residual, setting, steps) for base, setting in started]))
    out = []
    for base, pick in zip(bases, picks):
        own = [fit for fit in itertools.islice(fits, 1 + len(pick.rivals)) if fit is not None]
        candidates = _candidates(state, base, own, setup)
        out.append(tuple(sorted(candidates, key=lambda f: (f.candidate.plausible, f.candidate.evidence), reverse=True)))
    return out


def _nonlinear(settings: Sequence[Setting]) -> list[Setting]:
    return [s for s in settings if not s.effect.is_linear]


def _fit_beside(group: Group, base: Fit, residual: np.ndarray, setting: Setting, steps: int) -> Asks[Fit | None]:
    """One setting fitted next to a fit with fixed effects: first with the nonlinear ones only, to the `residual` (row,) that the linear ones leave;
    then simulated once with all of them.

    If the joint simulation is worse than linear superposition predicts, the setting is fitted again with all effects.
    """
    nonlinear = _nonlinear(base.settings)
    partial = yield from fitting(group, base.about, [*nonlinear, setting], steps, moving={len(nonlinear)}, residual=residual)
    if partial is None or len(nonlinear) == len(base.settings):
        return partial
    moving, known = {len(base.settings)}, partial.slopes
    settings = [*base.settings, partial.settings[-1]]
    together = yield from fitting(group, base.about, settings, 1, moving=moving, known=known)
    if together is None or together.loss < partial.loss + max(T.price, T.doubt * (base.loss - partial.loss)):
        return together
    return (yield from fitting(group, base.about, settings, steps, moving=moving))


def _candidates(state: GroupState, base: Fit, fits: Sequence[Fit], setup: Setup) -> list[Fitted]:
    """The fits as candidates, each with its evidence: the gain in log likelihood on held-out runs, at most the penalised gain on all runs."""
    machine, folds = state.group.machine, setup.folds
    tolerance = machine.parameter_tolerance
    base_loss = loss_within(state, base, tolerance)
    # a base that needs parameters far outside the tolerance is no alternative to an effect
    base_held_out = max(held_out_loss(state, base, folds), loss_within(state, base, T.widest * tolerance))
    candidates = []
    for fit in fits:
        drop = base.loss - fit.loss
        closes = closed_share(state, drop)
        penalised = min(drop, base_loss - loss_within(state, fit, tolerance)) - T.price * len(fit.free)
        gain = min(base_held_out - held_out_loss(state, fit, folds), penalised)
        evidence = gain / min(state.inflation, inflation(state.group, fit.residual(state.group)))
        setting = fit.settings[-1]
        plausible = is_plausible(setting, machine, is_isolated(state.group, setting))
        needed = evidence_needed(state, setting, len(folds))
        candidates.append(Fitted(Candidate(fit.sizes(), evidence, needed, plausible, closes, drop), fit.slopes))
    return candidates
