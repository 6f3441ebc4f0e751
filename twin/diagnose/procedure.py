"""The steps of a diagnosis, one after another: from a campaign and the machine that should explain it to a `Diagnosis`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import os

from threadpoolctl import threadpool_limits

from twin.diagnose.budget import budget_of, noise_of, positions_left
from twin.diagnose.check import check_campaign, notes_of
from twin.diagnose.corrected import HeldOut, corrected_machine, held_out_gaps, is_worse, uncorrected
from twin.diagnose.cross_validation import folds_of
from twin.diagnose.diagnosis import Diagnosis
from twin.diagnose.encoder_zeros import at_rest_without_zeros, notes_of_zeros, with_common_zeros, without_zeros, zeros_left
from twin.diagnose.law.laws import LEAST_CLOSED, Laws
from twin.diagnose.law.step import ALL_BUT, explained_by_many, laws_beside, predictions_with
from twin.diagnose.next_measurement import propose
from twin.diagnose.observe import axis_groups, observe
from twin.diagnose.search import search
from twin.diagnose.settings import DEFAULT, Thresholds
from twin.diagnose.simulations import on_threads
from twin.diagnose.state import GroupState
from twin.diagnose.verdict import judged, named, verdict_of
from twin.diagnose.view import view_of
from twin.diagnose.where import places
from twin.effects import Setting, settings_of, with_effects
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.simulation.gap import gap_of

UNDECIDED = 6.0
"""Gap over noise, on runs left out, above which a diagnosis that finds no effect is no answer; a control that interpolates in its own way between
its cycles leaves 3."""


@threadpool_limits.wrap(limits=1, user_api="blas")
def diagnose(
    campaign: Campaign,
    machine: Machine,
    *,
    quick: bool = False,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[str], None] | None = None,
    thresholds: Thresholds = DEFAULT,
    program: MeasuredRun | None = None,
) -> Diagnosis:
    """Diagnose a campaign against a machine; deterministic for a seed, on one thread for each core by default.

    `program`: set points of a program, on which the budget is asked as well.

    Raises InputError where the campaign is another machine's, holds no measured signal or no motion, or where the machine has effects.
    """
    say = progress or (lambda _: None)
    machine_without = with_effects(machine, [])
    if machine.effects:
        raise InputError(f"machine {machine.name} already has effects; diagnose against the machine without them")
    runs, zeros = with_common_zeros(campaign.runs, machine_without, thresholds)
    campaign = replace(campaign, runs=runs)
    check_campaign(campaign, machine, thresholds)
    folds = folds_of(len(campaign.runs))
    measured = sorted({axis for run in campaign.runs for axis in run.trace.axes})
    threads = threads or os.cpu_count() or 1
    # groups are searched side by side, each asking the same workers for its simulations
    with ThreadPoolExecutor(threads) as workers, ThreadPoolExecutor(threads) as searches:
        mapper = on_threads(workers)

        def search_group(axes: tuple[str, ...]) -> GroupState | None:
            say(f"{'+'.join(axes)}: what noise makes")
            group = observe(views, axes, seed, thresholds)
            if not group.size:
                return None
            return judged(search(group, machine_without, folds, mapper, say, quick), machine_without, mapper, quick)

        views = mapper(lambda run: view_of(machine_without, run, thresholds), campaign.runs)
        groups = axis_groups(machine_without, measured, [run.ballbar.axes for run in campaign.runs if run.ballbar is not None])
        longest_first = sorted(groups, key=len, reverse=True)
        results = dict(zip(longest_first, searches.map(search_group, longest_first)))
    found = [result for axes in groups if (result := results[axes])]

    offsets = {key: offset for f in found for key, offset in f.zeros.items()}
    runs, fitted_zeros = without_zeros(campaign.runs, machine_without, offsets)
    campaign, zeros = replace(campaign, runs=runs), fitted_zeros | zeros
    views = [replace(view, trace=run.trace) for view, run in zip(views, runs)]
    say("simulating the runs left out")
    motions = [view.motion for view in views]
    zeroed = {axis for axis, _ in offsets}

    def aligned(runs: Sequence[MeasuredRun], of: HeldOut, with_laws: Collection[str] = ()) -> tuple[MeasuredRun, ...]:
        """The runs without the zeros of encoders that a prediction leaves: at rest, and in every run of axes `with_laws`."""
        beside = zeros_left(runs, machine_without, of.traces, with_laws)
        return at_rest_without_zeros(without_zeros(runs, machine_without, beside)[0], machine_without, of.traces, zeroed)

    held_out = held_out_gaps(campaign.runs, motions, machine_without, found, folds, engine=not quick, threads=threads)
    runs = aligned(campaign.runs, held_out)
    before, after = (held_out.levels(machine, runs, which) for which in ("before", "after"))
    if any(harmed := [is_worse(f.group.axes, before, after) for f in found]):
        found = [uncorrected(f) if worse else f for f, worse in zip(found, harmed)]
        held_out = held_out_gaps(campaign.runs, motions, machine_without, found, folds, engine=not quick, threads=threads)
        runs = aligned(campaign.runs, held_out)
        after = held_out.levels(machine, runs, "after")
    found = [replace(f, unknown=f.unknown and not explained_by_many(f, before, after)) for f in found]
    settings = named(found)
    corrected = corrected_machine(machine, found)
    laws: Laws | None = None
    best = without_laws = held_out.left(machine, runs)
    with ThreadPoolExecutor(threads) as workers:
        loudest = held_out.loudest(machine, runs)
        asked = () if quick else laws_beside(found, before, after, loudest, machine_without, corrected, folds, on_threads(workers), say)
        for tried in asked:
            if tried.laws:
                with_laws = predictions_with(tried, held_out, campaign.runs, motions, folds, engine=not quick, threads=threads)
                if with_laws is None:
                    continue
                of_laws = {law.axis for law in tried.laws}
                rezeroed, alike = aligned(campaign.runs, with_laws, of_laws), aligned(campaign.runs, held_out, of_laws)
                # what does not shrink the gap on runs left out by more than their zeros do is no law of this machine
                known = min(best, held_out.left(machine, alike))
                if (now := with_laws.left(machine, rezeroed)) - 1.0 < (1.0 - LEAST_CLOSED) * (known - 1.0):
                    laws, predicted, best, runs = tried, with_laws, now, rezeroed
            if best - 1.0 < ALL_BUT * (without_laws - 1.0):
                break
    if laws is not None:
        corrected, held_out = laws.corrected, predicted
        settings = kept_in(corrected, settings)
    traces = held_out.traces
    gaps = {which: {run.name: gap_of(machine, run, of_run[run.name]) for run in runs} for which, of_run in held_out.predictions.items()}
    campaign = replace(campaign, runs=runs)
    notes = [*notes_of(campaign, machine), *notes_of_zeros(zeros, machine)]
    if quick:
        notes.append(
            "a quick look: gaps are the decoupled plant's, not MuJoCo's; laws that no effect describes, and effects that these runs would not show, were not asked for"
        )
    if unstable := [run.name for run in campaign.runs if len(folds) > 1 and run.name not in held_out.runs]:
        notes.append(f"fitted without {', '.join(unstable)} the machine is unstable; there its gap is that of the fit to all runs")
    verdict = verdict_of(found, settings)
    diagnosis = Diagnosis(
        campaign=campaign,
        machine=machine,
        corrected=corrected,
        verdict=verdict,
        found=found,
        settings=settings,
        where=[],
        gaps=gaps,
        held_out=held_out.runs,
        proposal=propose(machine, found, verdict),
        notes=notes,
        thresholds=thresholds,
        predictions=held_out.predictions,
        laws=laws.laws if laws else (),
    )
    loud = [axis for axis in diagnosis.axes if diagnosis.axis_level("after", axis) > UNDECIDED]
    if (verdict == "none" and loud) or (verdict == "effect" and any(diagnosis.keeps_its_gap(axis) for f in found for axis in f.group.axes)):
        # the fit hides what runs left out still show; a quick look leaves axes out that are quiet where the blocks are cut
        diagnosis.decided = not (quick and verdict == "none")
        diagnosis.verdict = verdict = "unknown"
        diagnosis.proposal = propose(machine, found, verdict) if found else diagnosis.proposal
    if diagnosis.laws and diagnosis.explained(diagnosis.axes) >= 1.0 - ALL_BUT:
        diagnosis.verdict = verdict = "law"
    left = [positions_left(run.trace, traces[run.name], machine) for run in runs]
    say("what each effect is worth")
    noise = noise_of(gaps["before"], machine)
    with ThreadPoolExecutor(threads) as pool:
        diagnosis.budget = budget_of(machine, corrected, found, views, left, noise, on_threads(pool))
        if program is not None:
            view = view_of(machine_without, program, thresholds)
            diagnosis.on_program = program.name, budget_of(machine, corrected, found, [view], [None], noise, on_threads(pool))
    order = [row.setting.key for row in diagnosis.budget.rows if row.setting is not None]
    diagnosis.settings = sorted(settings, key=lambda item: order.index(item[0].key) if item[0].key in order else len(order))
    if verdict != "none":
        weights = {axis: max(diagnosis.axis_level("before", axis) ** 2 - 1.0, 0.0) for axis in machine.axis_names}
        say("where the gap lies")
        leading = [*(law.setting for law in diagnosis.laws), *(s for s, _, _ in settings)]
        diagnosis.where = places(found, leading, machine, weights, threads)
    return diagnosis


def kept_in(corrected: Machine, settings: Sequence[tuple[Setting, GroupState, float]]) -> list[tuple[Setting, GroupState, float]]:
    """The effects that the corrected machine holds, with its sizes: a law may have taken the place of some."""
    held = {s.key: s for s in settings_of(corrected)}
    return [(held[setting.key], found, p) for setting, found, p in settings if setting.key in held]
