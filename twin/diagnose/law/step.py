"""The step of a diagnosis after the search: laws of the axes that effects do not explain, and the remaining gap."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib

from twin.diagnose.judgement import QUIET, is_explained_to_noise, needs_a_law
from twin.diagnose.law.laws import MOST_EFFECTS, Laws, Say, laws_of
from twin.diagnose.simulations import Mapper
from twin.diagnose.state import GroupState
from twin.errors import TwinError
from twin.machine.machine import Machine


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
    for asked, doubted in (([a for a in axes if a in few], False), (axes, True)):
        if asked:
            with contextlib.suppress(TwinError):  # a corrected machine that cannot be simulated has no residual
                yield laws_of(found, machine, asked, folds, mapper, say, doubted)


def _recorded_axes(found: GroupState) -> list[str]:
    """Axes of a group with recorded signals besides set points."""
    return [axis for axis in found.group.axes if any(channel.axis == axis for channel in found.group.channels)]


def _several_in_one_block(found: GroupState, axis: str) -> bool:
    """Whether several effects share a block of an axis. They may imitate one law: a backlash and a spring, for example, a hardening spring."""
    blocks = [s.effect.block for s in found.fit.settings if s.axis == axis]
    return len(set(blocks)) < len(blocks)


def _effect_count(found: GroupState, axis: str) -> int:
    return sum(s.axis == axis for s in found.fit.settings)
