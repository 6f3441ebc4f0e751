"""The steps of a diagnosis in their order, from a campaign and a machine to a `Diagnosis`."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
import contextlib
from dataclasses import replace
import functools
import math

from threadpoolctl import threadpool_limits

from twin.diagnose.axis_groups import axis_groups
from twin.diagnose.budget import budget_over, noise_of, parts_of, positions_left
from twin.diagnose.check_campaign import check_campaign, notes_of
from twin.diagnose.corrected import corrected_by
from twin.diagnose.cross_validation import folds_of
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.judgement import EVEN, LOUD, above_noise, final_verdict
from twin.diagnose.law.laws import FoundLaw, Laws
from twin.diagnose.next_measurement import propose, propose_for
from twin.diagnose.observe import Group, observe
from twin.diagnose.recorded_control import unlisted_blocks
from twin.diagnose.search import search
from twin.diagnose.setup import Setup
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import is_normal
from twin.diagnose.validation import Validated, validated, with_laws
from twin.diagnose.verdict import Named, final_state, in_open_blocks, named_effects
from twin.diagnose.view import RunView, view_of
from twin.diagnose.where import places
from twin.effects import Setting, settings_of
from twin.errors import InputError, TwinError
from twin.machine.commented import divided_masses
from twin.machine.machine import Machine
from twin.recordings.campaign import COPY, Campaign, MeasuredRun, without_copies
from twin.simulation.encoder_zeros import clear_zeros, notes_of_zeros, with_common_zeros, zeros_left
from twin.simulation.gap_level import levels_at_rest_too
from twin.simulation.recorded_noise import with_recorded_noise
from twin.system import cores, return_memory


@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    campaign: Campaign,
    machine: Machine,
    *,
    quick: bool = False,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
    program: MeasuredRun | None = None,
) -> Diagnosis:
    """Diagnose a campaign against a machine. The result depends on the seed, not on the number of threads (default: one per core).

    `program` holds the set points of a program; the budget is then computed for it as well.

    Raises InputError if the campaign belongs to another machine, holds no measured signal or no motion, or if the machine has effects.
    """
    if machine.effects:
        raise InputError(f"machine {machine.name} already has effects; diagnose against the machine without them")
    check_campaign(campaign, machine)
    campaign, copies = without_copies(campaign)
    machine, of_noise = with_recorded_noise(machine, campaign.runs)
    runs, zeros = with_common_zeros(campaign.runs, machine)
    campaign = replace(campaign, runs=runs)
    folds = folds_of(len(campaign.runs))
    count = threads or cores()
    with ThreadPoolExecutor(count) as workers:
        setup = Setup(machine, folds, workers.map, progress or (lambda _: None), quick, seed, count)
        views, states = _searched(setup, campaign)
        motions = [view.motion for view in views]
        correction = with_laws(setup, runs, motions, validated(setup, runs, motions, states))
        zeros = clear_zeros(zeros_left(runs, machine, correction.held_out.traces), machine) | zeros
        diagnosis = _diagnosis_of(setup, replace(campaign, runs=correction.held_out.runs), correction, zeros)
        diagnosis = replace(
            diagnosis, notes=[*diagnosis.notes, *of_noise, *(f"run {c} {COPY.format(original=o)}" for c, o in copies.items())]
        )
        diagnosis = _with_verdict(setup, diagnosis)
        by_certainty = [named.setting for named in diagnosis.named]
        diagnosis = _with_budget(setup, diagnosis, views, program)
        return _with_places(setup, diagnosis, by_certainty)


def _searched(setup: Setup, campaign: Campaign) -> tuple[list[RunView], list[GroupState]]:
    """Views of the runs, and the judged state of each group of axes for which something was recorded, in the machine's order.

    The groups are searched in parallel, largest first; all of them share one pool for simulations. A group that an axis of another one pushes is
    searched again with that axis corrected: its acceleration contains the swinging of its own drive train.
    """
    machine, mapper = setup.machine, setup.mapper

    def search_group(axes: tuple[str, ...]) -> tuple[Group, GroupState] | None:
        setup.progress(f"{'+'.join(axes)}: simulating the noise")
        group = observe(views, axes, setup.seed, mapper)
        return (group, search(group, setup)) if group.size else None

    def pushed(group: Group, state: GroupState) -> GroupState:
        pushing = {s.from_axis for s in state.fit.settings}.difference(state.group.axes)
        corrected = [corrected_by(other) for _, other in found if pushing.intersection(other.group.axes)]
        if corrected and not setup.quick:
            with contextlib.suppress(TwinError):  # nearly unstable: keep the search with the axis as in the file
                machines = [functools.reduce(lambda machine, of: of(machine), corrected, view.machine) for view in group.views]
                state = search(replace(group, views=[replace(v, machine=m) for v, m in zip(group.views, machines)], answers={}), setup)
        return final_state(state, setup.quick)

    views = list(mapper(lambda run: view_of(machine, run), campaign.runs))
    return_memory()
    measured = sorted({axis for run in campaign.runs for axis in run.trace.axes})
    groups = axis_groups(machine, measured, [run.ballbar.axes for run in campaign.runs if run.ballbar is not None])
    largest_first = sorted(groups, key=len, reverse=True)
    with ThreadPoolExecutor(setup.threads) as searches:
        results = dict(zip(largest_first, searches.map(search_group, largest_first)))
        found = [result for axes in groups if (result := results[axes])]
        return views, list(searches.map(lambda result: pushed(*result), found))


def _diagnosis_of(setup: Setup, campaign: Campaign, correction: Validated, zeros: dict[str, float]) -> Diagnosis:
    """The diagnosis before verdict, budget and places are final: effects of the corrected machine, gaps and notes."""
    machine, states = setup.machine, correction.states
    named = named_effects(states)
    if correction.laws is not None:
        named = effects_beside_laws(correction.laws, named)
    named, laws = _as_probable_as_complete(correction, named)
    named = play_or_friction(machine, named)
    verdict = "unknown" if any(state.unknown for state in states) else "effect" if named else "none"
    return Diagnosis(
        campaign=campaign,
        machine=machine,
        corrected=correction.corrected,
        verdict=verdict,
        states=states,
        named=named,
        where=[],
        held_out=correction.held_out,
        proposal=propose(machine, states, verdict, {n.setting.key for n in named}, [law.axis for law in laws]),
        notes=_notes(setup, campaign, correction, zeros),
        laws=laws,
        without_laws=correction.after,
    )


def _notes(setup: Setup, campaign: Campaign, correction: Validated, zeros: dict[str, float]) -> list[str]:
    """Limits of this diagnosis: missing signals, encoder zeros, a quick look, laws that one run shows, folds without a stable machine."""
    notes = [*notes_of(campaign, setup.machine), *notes_of_zeros(zeros, setup.machine)]
    if setup.quick:
        notes.append(
            "quick look: the gaps come from the decoupled plant, not from MuJoCo; unlisted laws and invisible effects were not checked; "
            "the budget leaves out re-tuned parameters"
        )
    names = [run.name for run in campaign.runs]
    fitted = set()
    for law in correction.laws.laws if correction.laws else ():
        if law.measured.shape == "jitter":
            notes.append(
                f"axis {law.axis}: random errors cannot be predicted sample by sample; the corrected machine scatters as much, and the noise in"
                ' "gap over noise" includes this scatter'
            )
        if law.only_fold is not None:
            shows = [names[i] for i in setup.folds[law.only_fold]]
            fitted |= set(shows)
            notes.append(
                f"axis {law.axis}: only {' and '.join(shows)} shows the law of the {law.block}; each half was predicted from the rest, the gap there is"
                " that of the fit to all runs; a second run with the same motion would confirm the law"
            )
    if unstable := [name for name in names if len(setup.folds) > 1 and name not in correction.held_out.names and name not in fitted]:
        notes.append(f"the machine fitted without {', '.join(unstable)} is unstable; the gap there is that of the fit to all runs")
    return notes


def effects_beside_laws(laws: Laws, named: Sequence[Named]) -> list[Named]:
    """The effects that the corrected machine holds, with its sizes. A law may have replaced some of them, or left a spring that is normal.

    An effect beside a law is no more probable than what its removal costs there. The spring of a law over the windup is a part of the law.
    """
    corrected, kept = laws.corrected, []
    held = {s.key: s for s in settings_of(corrected)}
    for found, state, probability in named:
        now, beside = held.get(found.key), laws.beside.get(found.key, 1.0)
        if now is not None and beside > 0.0 and (not is_normal(corrected, now) or is_normal(corrected, found)):
            kept.append(Named(now, state, probability * beside))
    return kept


def _as_probable_as_complete(correction: Validated, named: Sequence[Named]) -> tuple[list[Named], tuple[FoundLaw, ...]]:
    """Effects and laws with their final probabilities. On an axis with a law or something unknown, each is at most as probable as the share of the
    gap that the correction closes: what only resembles the true cause leaves a part of it. So does an effect that stands in for a filter, in its own
    block. An effect whose own block shows something that no law describes is one of two causes: it, or one that resembles it.
    """
    most = {axis: share for axis, share in correction.closed.items() if axis in correction.doubtful}
    without_law = correction.doubtful - correction.axes_with_law
    even = {key for state in correction.states for key in in_open_blocks(state) if key[1] in without_law}

    def complete(one: Named) -> float:
        key = one.setting.key
        return min(one.probability, most.get(key[1], 1.0), 1.0 - correction.stand_ins.get(key, 0.0), EVEN if key in even else 1.0)

    laws = correction.laws.laws if correction.laws else ()
    return (
        [one._replace(probability=complete(one)) for one in named],
        tuple(replace(law, probability=min(law.probability, most.get(law.axis, 1.0))) for law in laws),
    )


def play_or_friction(machine: Machine, named: Sequence[Named]) -> list[Named]:
    """Named effects, a play with a probability of at most EVEN where friction of the load may be it.

    Friction on the load winds the spring of a drive train like a play at each reversal, by 2 Fc / k. Where the file only assumes how much of the
    friction is there, a play of less is one of two causes.
    """
    divided = divided_masses(machine)
    stiffness = {n.setting.axis: n.setting.parameters["stiffness"] for n in named if "stiffness" in n.setting.parameters}

    def is_one_of_two(one: Setting) -> bool:
        wound = 2.0 * machine.axis(one.axis).coulomb_friction / stiffness.get(one.axis, math.inf)
        return one.axis in divided and 0.0 < one.parameters.get("clearance", 0.0) < wound

    return [one._replace(probability=min(one.probability, EVEN)) if is_one_of_two(one.setting) else one for one in named]


def _with_verdict(setup: Setup, diagnosis: Diagnosis) -> Diagnosis:
    """The diagnosis with the verdict that the held-out gaps allow."""
    before, after = diagnosis.levels["before"], diagnosis.levels["after"]
    verdict = final_verdict(diagnosis.verdict, before, after, bool(diagnosis.laws))
    if verdict == "unknown" != diagnosis.verdict:
        # a quick look skips axes whose blocks show no more than noise, so that a gap there is not examined
        decided = not (setup.quick and diagnosis.verdict == "none")
        named = {n.setting.key for n in diagnosis.named}
        proposal = propose(setup.machine, diagnosis.states, "unknown", named) if diagnosis.states else diagnosis.proposal
        diagnosis = replace(diagnosis, decided=decided, proposal=proposal)
    if verdict == "effect" and len(diagnosis.calibrated) == len(diagnosis.named):
        verdict = "unknown" if diagnosis.laws else "none"
    axis, level = max(after.items(), key=lambda item: item[1], default=("", 1.0))
    if verdict == "none" and level > LOUD:
        diagnosis = replace(diagnosis, proposal=propose_for(setup.machine, diagnosis.states, axis, level))
    whole = levels_at_rest_too(diagnosis.held_out.gaps["after"])
    notes = [*notes_of_what_remains(after, whole), *_notes_of_division(setup.machine, diagnosis.named)]
    return replace(diagnosis, verdict=verdict, notes=[*diagnosis.notes, *notes])


def _notes_of_division(machine: Machine, named: Sequence[Named]) -> list[str]:
    """Axes with a named drive train whose size rests on how the file assumes its mass to divide."""
    sprung = {n.setting.axis for n in named if any(p.quantity == "stiffness" for p in n.setting.effect.parameters)}
    return [
        f"axis {axis}: the file assumes how the mass divides between motor and load, and the division of friction follows from it: the stiffness "
        "of its drive train holds for this division only and may be several times off, and a small play may be friction on the load"
        for axis in sorted(sprung & divided_masses(machine))
    ]


def notes_of_what_remains(moving: Mapping[str, float], whole: Mapping[str, float]) -> list[str]:
    """Axes whose remaining gap is large. Levels over the noise by axis: in motion, and over whole runs."""
    notes = []
    for axis, level in moving.items():
        at_rest = whole.get(axis, 0.0)
        if at_rest > LOUD and level < 0.5 * at_rest:
            notes.append(
                f"axis {axis}: {level:.1f} x noise remains in motion and {at_rest:.1f} x noise over whole runs; where an axis sticks after a"
                " motion depends on its history"
            )
        elif level > LOUD:
            notes.append(
                f"axis {axis}: {level:.1f} x noise remains in motion, which nothing named here explains; a cause named on this axis may stand in"
                " for another one"
            )
    return notes


def _with_budget(setup: Setup, diagnosis: Diagnosis, views: Sequence[RunView], program: MeasuredRun | None) -> Diagnosis:
    """The diagnosis with its gap budget, also for a program, and with its effects in the order of the budget."""
    machine, corrected, states = setup.machine, diagnosis.corrected, diagnosis.states
    residuals = [positions_left(run.trace, diagnosis.held_out.traces[run.name], machine) for run in diagnosis.campaign.runs]
    setup.progress("computing the gap budget")
    noise = noise_of(diagnosis.held_out.gaps["before"], machine)
    on_program = None
    parts = [part for part in parts_of(machine, corrected, states) if not (setup.quick and part.kind == "re-tuned")]
    budget = budget_over(parts, machine, corrected, views, residuals, noise, setup.mapper)
    if program is not None:
        view = view_of(machine, program)
        on_program = program.name, budget_over(parts, machine, corrected, [view], [None], noise, setup.mapper)
    return_memory()
    order = [row.setting.key for row in budget.rows if row.setting is not None]
    named = sorted(diagnosis.named, key=lambda n: order.index(n.setting.key) if n.setting.key in order else len(order))
    return replace(diagnosis, budget=budget, on_program=on_program, named=named)


def _with_places(setup: Setup, diagnosis: Diagnosis, effects: Sequence[Setting]) -> Diagnosis:
    """The diagnosis with the places of the gap; unchanged for the verdict 'none'. Laws, then `effects`, claim the blocks in this order.

    Where the place is a position controller that no effect explains, a note says which block of its control the machine file lacks.
    """
    if diagnosis.verdict == "none":
        return diagnosis
    weights = {axis: above_noise(level) for axis, level in diagnosis.levels["before"].items()}
    setup.progress("locating the gap")
    claims = [*(law.setting for law in diagnosis.laws), *effects]
    where = places(diagnosis.states, claims, setup.machine, weights)
    open_axes = () if diagnosis.verdict == "effect" else dict.fromkeys(p["axis"] for p in where if p["block"] == "position controller")
    notes = unlisted_blocks(setup.machine, diagnosis.campaign.runs, open_axes)
    return replace(diagnosis, where=where, notes=[*notes, *diagnosis.notes])
