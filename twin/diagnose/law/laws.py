"""Unlisted laws of unexplained axes: measured, recognised as formulas, fitted in closed loop, and kept if they lower its cost.

A law is a term like an effect: both are fitted, added, exchanged and removed by the same cost (`twin.diagnose.law.closed_loop`).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace
import math

from twin.diagnose.corrected import corrected_by, corrected_machine
from twin.diagnose.fit import fit_effects, simulated_response
from twin.diagnose.law.closed_loop import FEW_STEPS, OUTSIDE, AxisFit, ClosedLoop, Settings, closed_loop
from twin.diagnose.law.filters import filters_of
from twin.diagnose.law.jitter import jitter_of
from twin.diagnose.law.measure import excess
from twin.diagnose.law.proposals import STRONG, WEAK, ProposedLaw, Selection, label, measured_in, propose_laws
from twin.diagnose.law.residual import Samples, residuals_of
from twin.diagnose.law.shapes import Described
from twin.diagnose.law.springs import in_place_of_a_play, with_fitted_spring, with_normal_elasticity, with_recorded_spring
from twin.diagnose.settings import T
from twin.diagnose.state import SHOWS_IN, GroupState
from twin.diagnose.tolerance import drive_train_of, is_normal, tuned, with_added
from twin.diagnose.tuning import Tuning
from twin.effects import Setting, check_setting, settings_of
from twin.effects.law import laws_in
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.machine.machine import Machine

MOST_LAWS = 12
"""Largest number of laws of one axis."""

MOST_EFFECTS = 5
"""Largest number of effects of an axis that several laws may replace; a larger number is compared with one law."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class FoundLaw:
    """One law: its setting, its measurement, and the fraction of the gap of its axis that it closes on runs left out."""

    setting: Setting
    measured: Described
    samples: Samples = field(repr=False)
    explained: float  # of a jitter, the share of the scatter of single samples
    probability: float
    deviations: dict[str, float]
    only_fold: int | None = None  # fold with the only run that shows the law; there, each half was predicted from the other

    @property
    def axis(self) -> str:
        return self.setting.axis

    @property
    def block(self) -> str:
        return self.setting.effect.block


@dataclass(frozen=True)
class Laws:
    """The laws of a machine, the states of its groups with them, and the corrected machine.

    `instead` are the axes on which laws replaced effects that explained the gap. `beside` is the probability of each effect that stays beside
    a law: what its removal costs there.
    """

    laws: tuple[FoundLaw, ...]
    states: tuple[GroupState, ...]
    corrected: Machine
    beside: Mapping[Key, float] = field(default_factory=dict)
    instead: frozenset[str] = frozenset()


def laws_of(
    found: Sequence[GroupState],
    axes: Sequence[str],
    folds: Sequence[Sequence[int]],
    progress: Progress = lambda _: None,
    doubted: bool = False,
    explained: Collection[str] = (),
) -> Laws:
    """Laws of these axes, beside or instead of the effects that the search found; on those of them that are `explained`, only if a filter shows.

    The search gives little weight to samples with large errors. A law may act just there, so all samples weigh the same, unless `doubted`.
    """
    machine = found[0].group.machine
    laws: list[FoundLaw] = []
    states: list[GroupState] = []
    beside: dict[Key, float] = {}
    for state in found:
        for axis in [a for a in state.group.axes if a in axes]:
            progress(f"{axis}: searching for an unlisted law")
            with contextlib.suppress(TwinError):  # a corrected machine that cannot be simulated has no residual; other axes may have laws
                state, of_axis, certain = _laws_of_axis(state, axis, folds, progress, doubted, axis in explained)
                laws += of_axis
                beside |= certain
        states.append(state)
    instead = frozenset(explained) & {law.axis for law in laws}
    return Laws(tuple(laws), tuple(states), corrected_machine(machine, states), beside, instead)


def _laws_of_axis(
    state: GroupState, axis: str, folds: Sequence[Sequence[int]], progress: Progress, doubted: bool, explained: bool
) -> tuple[GroupState, list[FoundLaw], dict[Key, float]]:
    """The state of a group with the laws of one of its axes, the laws, and the probability of each effect beside them."""
    if jitter := _jitter(residuals_of(state.group.views, corrected_by(state), axis, state.group.mapper), axis, state):
        return replace(state, fit=replace(state.fit, settings=(*state.fit.settings, jitter.setting))), [jitter], {}
    # a filter changes how the loop swings: several numbers of a drive, each a little off, may imitate that down to noise
    if explained and not _strong_filters(state, axis, without=in_the_loop(state.fit.settings, axis)):
        return state, [], {}
    settings = settings_of(corrected_machine(state.group.machine, [state]))
    group = state.rigid if doubted else replace(state.rigid, channels=[replace(c, doubt=0.0) for c in state.rigid.channels])
    slips = any(s.axis == axis and s.effect.normal == "slip" for s in settings)
    loop = closed_loop(group, axis, folds, slips)
    others = tuple(s for s in settings if s.axis != axis and not s.effect.edits_bodies)
    own = tuple(s for s in settings if s not in others)
    if others:
        response = simulated_response(loop.group, others) / loop.group.weights
        channels = [replace(c, residual=c.residual - response[c.rows]) for c in loop.group.channels]
        loop = replace(loop, group=replace(loop.group, channels=channels))
    best = _search_axis(loop, own, progress)
    if not (best and best.laws):
        return state, [], {}
    found = _state_with(closed_loop(group, axis, folds, slips), best.fitted, others) or state
    return found, _laws_in(best), _probabilities_beside(best)


def _jitter(blocks: Sequence[Samples], axis: str, state: GroupState) -> FoundLaw | None:
    """The jitter of an axis' scale. Random errors have no response that could be fitted in closed loop; they are sized from the residual."""
    for samples in blocks:
        if samples.block == "transmission" and (found := jitter_of(samples)):
            setting = check_setting(found.table(axis), state.group.machine, "a measured law")
            return FoundLaw(setting, found, samples, found.predicts, state.group.confidence(axis), {})
    return None


def _state_with(loop: ClosedLoop, fitted: AxisFit, others: Settings) -> GroupState | None:
    """The state of a group with the laws and effects of one axis and those of its other axes, fitted together."""
    group, fit, joint = loop.group, fitted.fit, fitted.fit
    if others:
        moving = {f.setting for f in fit.free} | {i for i, s in enumerate(others, len(fit.settings)) if not s.effect.normal}
        together = fit_effects(group, fit.about, [*fit.settings, *others], 1, moving=moving, known=fit.slopes)
        if together is None:
            return None
        joint = together
    return GroupState(group, group, fit.about, joint).inflated()


@dataclass(frozen=True)
class _AxisLaws:
    """Laws of one axis from one start by their keys, their fit, and the fit without each term."""

    loop: ClosedLoop
    laws: Mapping[Key, tuple[ProposedLaw, float]]  # with the share of the gap that it closed when it was added
    fitted: AxisFit
    without: Mapping[Key, AxisFit]


def _laws_in(found: _AxisLaws) -> list[FoundLaw]:
    """The laws of an axis with their share of the gap and their probability."""
    loop = found.loop
    cap = loop.group.confidence(loop.axis) if loop.only_fold is None else T.confidence_in_one_run
    laws = []
    for setting in laws_in(found.fitted.settings):
        proposal, closed = found.laws[setting.key]
        probability = min(_certain(found, setting), cap)
        deviations = found.fitted.deviations(setting.key, T.model_error)
        laws.append(
            FoundLaw(setting, proposal.measured, proposal.samples, min(max(closed, 0.0), 1.0), probability, deviations, loop.only_fold)
        )
    return laws


def _probabilities_beside(found: _AxisLaws) -> dict[Key, float]:
    """Probability of each effect that stays beside the laws; 0 for the spring that a law over the windup complements, which is a part of it."""
    settings = found.fitted.settings
    laws = laws_in(settings)
    wound = any(law.effect.definition["variables"] == ["windup"] for law in laws)
    spring = drive_train_of(settings, found.loop.axis) if wound else []
    return {s.key: 0.0 if s in spring else _certain(found, s) for s in settings if s not in laws}


def _certain(found: _AxisLaws, setting: Setting) -> float:
    """Probability that a term is there: the odds of the cost without it, as in a round of the search; 1 if nothing can be simulated without it."""
    without = found.without.get(setting.key)
    if without is None:
        return 1.0
    more = found.loop.price(found.fitted.settings) - found.loop.price(without.settings)
    return 1.0 / (1.0 + math.exp(min((found.fitted.misfit + more - without.misfit) / T.temperature, 50.0)))


def _search_axis(loop: ClosedLoop, settings: Settings, progress: Progress) -> _AxisLaws | None:
    """Laws of one axis in addition to its effects, or instead of them if that costs less.

    A search without the law may find effects that do not exist, re-tune the axis, or bend its drive train, only to imitate the law. The search
    for laws therefore also starts without the effects of the axis, and with a spring in place of a backlash, and restores those that lower the
    cost. It ends where hardly more than noise is left.
    """
    axis, machine = loop.axis, loop.group.machine
    own = tuple(s for s in settings if s.axis == axis and not s.effect.normal)
    first = loop.start(settings)
    if first is None:
        return None
    loop = loop.halving_its_only_loud_fold(first)
    best = _search_from(loop, loop.with_cost(first.fit), own, progress, (STRONG, WEAK))
    bent = any(not is_normal(machine, s) for s in drive_train_of(settings, axis))
    if best is None or (not own and (not bent or loop.is_clean(best.fitted))):
        return best
    progress(f"{axis}: trying a law instead of {', '.join(s.effect.name for s in own) or 'a soft drive train'}")
    bare = tuple(s for s in settings if s not in own)
    sprung = [(*bare, spring) for spring in in_place_of_a_play(loop, own)]
    without = [tuple(s for s in settings if s.axis != axis), *([bare] if own else [])]
    # beside a spring of the recorded stiffness, a law over the windup predicts little of the force, and may still be all that is wrong
    rounds = [
        [*((start, [STRONG]) for start in sprung), *((with_recorded_spring(loop, start), [STRONG, WEAK]) for start in sprung)],
        *([(start, [STRONG])] for start in without),
    ]
    for starts in rounds:
        before = best
        for start, selections in starts:
            most, beat = (MOST_LAWS, math.inf) if len(own) <= MOST_EFFECTS else (1, best.fitted.cost)
            alone = _search_from(loop, loop.start(start), own, progress, selections, most, beat)
            if alone and alone.laws and alone.fitted.cost < best.fitted.cost:
                best = alone
        if best is not before and loop.is_clean(best.fitted):
            break
    return best


def _search_from(
    loop: ClosedLoop,
    first: AxisFit | None,
    effects: Settings,
    progress: Progress,
    selections: Sequence[Selection] = (STRONG,),
    most: int = MOST_LAWS,
    beat: float = math.inf,
) -> _AxisLaws | None:
    """Laws of one axis from a start, at most `most`, added one by one while they lower the cost; then, if they cost less than `beat`, terms are
    exchanged, `effects` among them.

    Candidates of each of the `selections` are tried if none of the one before lowers the cost.
    """
    if first is None:
        return None
    fitted, at_first = first, loop.above_noise(first)
    laws: dict[Key, tuple[ProposedLaw, float]] = {}
    waiting: list[ProposedLaw] = []  # laws that lower the cost, but less than the one that was added
    while len(laws) < most and loop.above_noise(fitted) >= T.near_noise * at_first:
        cheaper = _cheaper(loop, fitted, waiting, selections, progress)
        if not cheaper:
            break
        (new, best), *others = cheaper
        waiting = [proposal for _, proposal in others]
        laws[new.settings[-1].key] = best, (fitted.held_out - new.held_out) / max(at_first, 1e-300)
        fitted = with_normal_elasticity(loop, new)
    laws = laws if fitted.cost < beat else {}
    fitted, without = settled(loop, fitted, effects) if laws else (fitted, {})
    kept = {s.key for s in fitted.settings}
    return _AxisLaws(loop, {key: law for key, law in laws.items() if key in kept}, fitted, without)


def costs_more_than_a_law(effects: Sequence[Setting]) -> bool:
    """Is one unlisted law the smaller claim than these effects?"""
    return T.evidence * len(effects) > T.evidence + OUTSIDE


def in_the_loop(settings: Sequence[Setting], axis: str) -> Settings:
    """The effects of an axis, other than normal ones, in blocks that no channel isolates: each changes how the closed loop swings."""
    return tuple(s for s in settings if s.axis == axis and not s.effect.normal and s.effect.block not in SHOWS_IN)


def _strong_filters(state: GroupState, axis: str, without: Settings = ()) -> dict[str, float]:
    """Blocks of the axis that show a strong filter -> the share that it predicts, on runs left out, of what the effects but `without` leave there."""
    group = state.group
    blocks = residuals_of(group.views, corrected_by(state, without), axis, group.mapper)
    best = {s.block: max((d.predicts for d in filters_of(s, group.machine)), default=0.0) for s in blocks if excess(s) > T.clean_square}
    return {block: share for block, share in best.items() if share > STRONG.predicts}


def stand_ins(state: GroupState) -> dict[Key, float]:
    """Effects in the closed loop whose own block shows a strong filter all the same -> the share of its rest that the filter predicts.

    A block is evaluated on its recorded inputs: the effect that is there leaves noise. In the closed loop an effect may stand in for the filter.
    """
    found: dict[Key, float] = {}
    for axis in state.group.axes:
        if own := in_the_loop(state.fit.settings, axis):
            left = _strong_filters(state, axis)
            found |= {s.key: left[s.effect.block] for s in own if s.effect.block in left}
    return found


def _cheaper(
    loop: ClosedLoop, fitted: AxisFit, waiting: Sequence[ProposedLaw], selections: Sequence[Selection], progress: Progress
) -> list[tuple[AxisFit, ProposedLaw]]:
    """Fits with one more law that cost less, best first: a law that waits, or one of the first of the selections that brings any."""
    axis, machine, known = loop.axis, loop.group.machine, set[str]()
    about: Tuning = fitted.fit.about
    of_tuning = tuned(about.nuisances, fitted.fit.theta * about.spread)
    blocks = residuals_of(loop.group.views, lambda m: with_added(of_tuning(m), fitted.settings), axis, loop.group.mapper)
    measured = measured_in(blocks, machine, axis)
    for selection in selections:
        proposed = [p for p in propose_laws(measured, machine, axis, selection) if label(p.measured) not in known]
        known |= {label(p.measured) for p in proposed}
        proposed += [p for p in waiting if label(p.measured) not in known]
        waiting = ()
        if not proposed:
            continue
        progress(f"{axis}: {', '.join(label(p.measured) for p in proposed)} in closed loop")
        fits = loop.refits(fitted, [(*with_fitted_spring(fitted.settings, machine, axis, d, x), s) for d, x, s in proposed])
        both = [(fit, p) for fit, p in zip(fits, proposed) if fit is not None and fit.cost < fitted.cost]
        tried = [(fit, p._replace(setting=fit.settings[-1])) for fit, p in both]
        if tried:
            return sorted(tried, key=lambda t: t[0].cost)
    return []


def settled(loop: ClosedLoop, fitted: AxisFit, effects: Settings) -> tuple[AxisFit, dict[Key, AxisFit]]:
    """The cheapest fit that is reached by adding one of the `effects`, by an effect in place of a law, and by removing a term other
    than a normal elasticity; and the fits without each of its terms."""
    while True:
        settings = fitted.settings
        held = {s.key for s in settings}
        absent = [e for e in effects if e.key not in held]
        laws = laws_in(settings)
        removable = [
            s for s in settings if s.axis == loop.axis and (s.effect.normal != "elasticity" or not is_normal(loop.group.machine, s))
        ]
        fewer = [tuple(o for o in settings if o is not s) for s in removable]
        changed = loop.refits(fitted, [*fewer, *((*settings, e) for e in absent)], FEW_STEPS)
        without = {s.key: fit for s, fit in zip(removable, changed)}
        # an exchange starts where the other terms already do without the law
        bare = [fit for law in laws if (fit := without[law.key]) is not None]
        tried = [*changed, *(f for fit in bare for f in loop.refits(fit, [(*fit.settings, e) for e in absent], FEW_STEPS))]
        best = min((f for f in tried if f is not None), key=lambda f: f.cost, default=fitted)
        if best.cost >= fitted.cost:
            return fitted, {key: f for key, f in without.items() if f is not None}
        fitted = best
