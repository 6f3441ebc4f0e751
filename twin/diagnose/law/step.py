"""The step of a diagnosis after the search: laws of the axes that effects do not explain, and the remaining gap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib

from twin.diagnose.corrected import FEWER_REALISATIONS, HeldOut, fitted_without
from twin.diagnose.judgement import QUIET, is_explained_to_noise, needs_a_law
from twin.diagnose.law.closed_loop import Say
from twin.diagnose.law.laws import MOST_EFFECTS, Laws, laws_of
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import GroupState
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import Motion
from twin.simulation.gap import REALISATIONS, Job, predict_each


def many_effects_explain(found: GroupState, before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether more than MOST_EFFECTS effects of each loud axis of a group explain the runs left out down to noise.

    A missing small effect changes the fitted sizes of the others. Sizes that differ between runs are then no evidence of a law.
    """
    loud = [axis for axis in found.group.axes if before.get(axis, 0.0) > QUIET]
    return bool(loud) and is_explained_to_noise(before, after, loud) and all(_effect_count(found, axis) > MOST_EFFECTS for axis in loud)


def find_unlisted_laws(
    found: Sequence[GroupState],
    before: Mapping[str, float],
    after: Mapping[str, float],
    loudest: Mapping[str, float],
    machine: Machine,
    corrected: Machine,
    folds: Sequence[Sequence[int]],
    mapper: Mapper,
    say: Say,
) -> Iterator[Laws]:
    """Laws of axes that the search left unknown or that are still loud; yields up to two results, with different weights of the samples.

    `machine` is the nominal machine. `before` and `after` are the levels by axis on runs left out, `loudest` that of the loudest
    signal of each axis after correction.
    """
    few = [axis for f in found for axis in _recorded_axes(f) if _effect_count(f, axis) <= MOST_EFFECTS]

    def is_loud(axis: str) -> bool:
        imitated = any(_several_in_one_block(f, axis) for f in found)
        return needs_a_law(before.get(axis, 0.0), after.get(axis, 0.0), loudest.get(axis, 0.0), imitated)

    loud = [axis for axis in few if is_loud(axis)]
    axes = [axis for f in found for axis in _recorded_axes(f) if f.unknown or axis in loud]
    if not axes:
        return
    without = [fitted_without(machine, found, fold if len(folds) > 1 else []) for fold in folds]
    # the search down-weights samples with large errors; a law may act just there, so search with equal weights, too
    for groups, asked in (([f.rigid.without_doubt() for f in found], [a for a in axes if a in few]), ([f.rigid for f in found], axes)):
        if asked:
            with contextlib.suppress(TwinError):  # a corrected machine that cannot be simulated has no residual
                yield laws_of(groups, machine, corrected, asked, folds, without, mapper, say)


def _recorded_axes(found: GroupState) -> list[str]:
    """Axes of a group with recorded signals besides set points."""
    return [axis for axis in found.group.axes if any(channel.axis == axis for channel in found.group.channels)]


def _several_in_one_block(found: GroupState, axis: str) -> bool:
    """Whether several effects share a block of an axis. They may imitate one law: a backlash and a spring, for example, a hardening spring."""
    blocks = [s.effect.block for s in found.fit.settings if s.axis == axis]
    return len(set(blocks)) < len(blocks)


def _effect_count(found: GroupState, axis: str) -> int:
    return sum(s.axis == axis for s in found.fit.settings)


def predictions_with_laws(
    laws: Laws,
    held_out: HeldOut,
    runs: Sequence[MeasuredRun],
    motions: Sequence[Motion],
    folds: Sequence[Sequence[int]],
    engine: bool,
    threads: int,
) -> HeldOut | None:
    """Predictions after correction with the laws, of each run by the machine fitted without it; None if a simulation fails.

    The only run that shows a law is predicted by the machine fitted to all runs; it is then not among the held-out runs.
    """
    realisations = REALISATIONS if engine else FEWER_REALISATIONS
    jobs = [
        Job(laws.without_fold[k], runs[i], realisations, motion=motions[i], engine=engine) for k, fold in enumerate(folds) for i in fold
    ]
    try:
        predictions = {job.run.name: prediction for job, prediction in zip(jobs, predict_each(jobs, threads=threads))}
    except TwinError:
        return None
    fitted = {runs[i].name for law in laws.laws if law.only_fold is not None for i in folds[law.only_fold]}
    left_out = [name for name in held_out.runs if name not in fitted]
    return HeldOut({**held_out.predictions, "after": predictions}, left_out)
