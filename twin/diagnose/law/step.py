"""The step of a diagnosis after the search: laws of the axes that no effect explains, and how far the gap shrinks with them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import replace

from twin.diagnose.corrected import FEWER_REALISATIONS, HeldOut, fitted_without
from twin.diagnose.law.keep import Say
from twin.diagnose.law.laws import MOST_EFFECTS, Laws, laws_of
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import GroupState
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import Motion
from twin.simulation.gap import REALISATIONS, Job, predict_each

ALL_BUT = 0.1
"""Share of the gap that may stay unexplained where the verdict is 'law'."""


LOUD = 3.0
"""Gap over noise on runs left out from which an axis is asked for a law although effects explain most of it."""

LOUD_SIGNAL = 1.5
"""The same of one signal: what only shows at reversals is little of an axis, and as evidence it counts next to nothing."""

NEXT_TO_NOTHING = 1e-3
"""Share of an axis' gap that effects may leave without being asked for the sake of one loud signal: it is small beside what they explain."""

QUIET = 1.3
"""The same up to which an axis is at its noise, as nearly as runs left out say."""

HARDLY_LOUD = 2.0
"""The same where effects explain less than half of the gap: they are no answer."""


def keeps_its_gap(before: float, after: float) -> bool:
    """Is an axis loud after correction, with more than a tenth of its gap left, or hardly loud, with most of it?

    `before` and `after` correction: its gap over noise on runs left out.
    """
    left = share_left(before, after)
    return (after > LOUD and left > ALL_BUT) or (after > HARDLY_LOUD and left > 0.5)


def share_left(before: float, after: float) -> float:
    """Share of an axis' gap above noise, in squares, that correction leaves; `before` and `after` it: its gap over noise."""
    return max(after**2 - 1.0, 0.0) / max(before**2 - 1.0, 1e-300)


def explained_by_many(found: GroupState, before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Do many effects of each loud axis of a group explain runs left out down to noise?

    What is missing beside many small effects bends the sizes of the others: that they differ between runs is then no sign of a law.
    """
    loud = [axis for axis in found.group.axes if before.get(axis, 0.0) > QUIET]
    return bool(loud) and all(
        after.get(axis, 0.0) <= QUIET and before[axis] > LOUD and _effects(found, axis) > MOST_EFFECTS for axis in loud
    )


def laws_beside(
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
    """Laws of the axes of groups that the search left unknown, and of those that are loud still: an answer, and one by other weights.

    `machine` is the nominal one, `before` and `after` correction: gaps over noise of axes on runs left out; `loudest`: that of the loudest
    signal of an axis after correction.
    """
    few = [axis for f in found for axis in _recorded(f) if _effects(f, axis) <= MOST_EFFECTS]

    def is_loud(axis: str) -> bool:
        was, now = before.get(axis, 0.0), after.get(axis, 0.0)
        one_is = loudest.get(axis, 0.0) > LOUD_SIGNAL and share_left(was, now) > NEXT_TO_NOTHING
        return now > LOUD or keeps_its_gap(was, now) or one_is

    loud = [axis for axis in few if is_loud(axis)]
    axes = [axis for f in found for axis in _recorded(f) if f.unknown or axis in loud]
    if not axes:
        return
    without = [fitted_without(machine, found, fold if len(folds) > 1 else []) for fold in folds]
    # the search trusts the twin less where it is far off; a law may be just there, or beside what chance makes of it
    for groups, asked in (([f.rigid.without_doubt() for f in found], [a for a in axes if a in few]), ([f.rigid for f in found], axes)):
        if asked:
            with contextlib.suppress(TwinError):  # a corrected twin that cannot be simulated has no residual to look at
                yield laws_of(groups, machine, corrected, asked, folds, without, mapper, say)


def _recorded(found: GroupState) -> list[str]:
    """Axes of a group of which more was recorded than set points."""
    return [axis for axis in found.group.axes if any(channel.axis == axis for channel in found.group.channels)]


def _effects(found: GroupState, axis: str) -> int:
    return sum(s.axis == axis for s in found.fit.settings)


def predictions_with(
    laws: Laws,
    held_out: HeldOut,
    runs: Sequence[MeasuredRun],
    motions: Sequence[Motion],
    folds: Sequence[Sequence[int]],
    engine: bool,
    threads: int,
) -> HeldOut | None:
    """What is predicted after correction with the laws, each run by the machine fitted without it; None where that one cannot run."""
    realisations = REALISATIONS if engine else FEWER_REALISATIONS
    jobs = [
        Job(laws.without_fold[k], runs[i], realisations, motion=motions[i], engine=engine) for k, fold in enumerate(folds) for i in fold
    ]
    try:
        predictions = {job.run.name: prediction for job, prediction in zip(jobs, predict_each(jobs, threads=threads))}
    except TwinError:
        return None
    return replace(held_out, predictions={**held_out.predictions, "after": predictions})
