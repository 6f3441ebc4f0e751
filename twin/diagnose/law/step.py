"""The step of a diagnosis after the search: laws of the axes that effects do not explain, and the remaining gap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib

from twin.diagnose.corrected import FEWER_REALISATIONS, HeldOut, fitted_without
from twin.diagnose.law.closed_loop import Say
from twin.diagnose.law.laws import MOST_EFFECTS, Laws, laws_of
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import GroupState
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import Motion
from twin.simulation.gap import REALISATIONS, Job, predict_each

ALL_BUT = 0.1
"""Largest unexplained fraction of the gap for the verdict 'law'."""


LOUD = 3.0
"""Gap over noise on runs left out above which a law is sought although effects explain most of the gap of the axis."""

LOUD_SIGNAL = 1.5
"""The same limit for a single signal. A deviation at reversals only contributes little to the gap of an axis."""

NEXT_TO_NOTHING = 1e-3
"""Unexplained fraction of the gap of an axis below which a single loud signal does not trigger the search for a law, unless several effects
share a block."""

QUIET = 1.3
"""Gap over noise on runs left out up to which an axis counts as explained down to noise."""

HARDLY_LOUD = 2.0
"""Gap over noise on runs left out above which a law is sought if effects explain less than half of the gap."""


def gap_remains(before: float, after: float) -> bool:
    """Whether a considerable gap of an axis remains after correction.

    `before`, `after`: gap over noise on runs left out, before and after correction. True above LOUD with more than a tenth of the gap left, or
    above HARDLY_LOUD with more than half of it left.
    """
    left = unexplained_share(before, after)
    return (after > LOUD and left > ALL_BUT) or (after > HARDLY_LOUD and left > 0.5)


def unexplained_share(before: float, after: float) -> float:
    """Fraction of the squared gap above noise that correction leaves; `before`, `after`: gap over noise."""
    return max(after**2 - 1.0, 0.0) / max(before**2 - 1.0, 1e-300)


def many_effects_explain(found: GroupState, before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether more than MOST_EFFECTS effects of each loud axis of a group explain the runs left out down to noise.

    A missing small effect changes the fitted sizes of the others. Sizes that differ between runs are then no evidence of a law.
    """
    loud = [axis for axis in found.group.axes if before.get(axis, 0.0) > QUIET]
    return bool(loud) and all(
        after.get(axis, 0.0) <= QUIET and before[axis] > LOUD and _effect_count(found, axis) > MOST_EFFECTS for axis in loud
    )


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

    `machine` is the nominal machine. `before` and `after` are the gaps over noise by axis on runs left out, `loudest` that of the loudest
    signal of each axis after correction.
    """
    few = [axis for f in found for axis in _recorded_axes(f) if _effect_count(f, axis) <= MOST_EFFECTS]

    def is_loud(axis: str) -> bool:
        was, now = before.get(axis, 0.0), after.get(axis, 0.0)
        imitated = any(_several_in_one_block(f, axis) for f in found)
        one_is = loudest.get(axis, 0.0) > LOUD_SIGNAL and (imitated or unexplained_share(was, now) > NEXT_TO_NOTHING)
        return now > LOUD or gap_remains(was, now) or one_is

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
