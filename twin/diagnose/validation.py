"""Validation of a correction on held-out runs.

`validated` simulates every run with the nominal machine and with the machine fitted without that run. Axes that the correction makes worse
keep the values of the machine file. `with_laws` then looks for unlisted laws and keeps those that reduce the held-out gap.
"""

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace
import functools
import math

from twin.diagnose.corrected import HeldOut, corrected_machine, held_out_predictions, uncorrected
from twin.diagnose.judgement import (
    LOUD,
    gap_remains,
    is_worse,
    loudest,
    needs_a_law,
    remaining_share,
    unexplained_share,
    worse_signals,
)
from twin.diagnose.law.laws import MOST_EFFECTS, Laws, costs_more_than_a_law, in_the_loop, laws_of, stand_ins
from twin.diagnose.settings import T
from twin.diagnose.setup import Setup
from twin.diagnose.state import GroupState
from twin.effects.setting import Key
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import Motion
from twin.simulation.gap_level import levels, signal_levels
from twin.system import return_memory

Runs = Sequence[MeasuredRun]
Motions = Sequence[Motion]
"""Measured runs, and their nominal motions."""

LARGEST_SHARE = 0.95
"""Largest share of the held-out gap, in the mean over the signals, that laws may leave."""


@dataclass(frozen=True)
class Validated:
    """A correction with its predictions of held-out runs; `before` and `after` are the levels of each axis there."""

    states: list[GroupState]
    held_out: HeldOut
    before: dict[str, float]
    after: dict[str, float]
    corrected: Machine
    laws: Laws | None = None
    stand_ins: Mapping[Key, float] = field(default_factory=dict)  # see `twin.diagnose.law.laws.stand_ins`

    @functools.cached_property
    def left(self) -> dict[str, float]:
        """Level of each axis on held-out runs, with the laws."""
        return levels(self.held_out.gaps["after"])

    @property
    def closed(self) -> dict[str, float]:
        """Share of the squared gap above noise of each axis that the correction closes, with its laws."""
        return {
            axis: 1.0 - min(unexplained_share(before, self.left[axis]), 1.0) for axis, before in self.before.items() if axis in self.left
        }

    @property
    def remaining(self) -> set[str]:
        """Axes on which a considerable gap remains."""
        return {axis for axis, before in self.before.items() if gap_remains(before, self.left.get(axis, 1.0))}

    @property
    def axes_with_law(self) -> set[str]:
        """Axes with an unlisted law."""
        return {law.axis for law in self.laws.laws} if self.laws else set()

    @property
    def doubtful(self) -> set[str]:
        """Axes with an unlisted law or a considerable gap, and those above noise in a group with a residual that no effect explains."""
        unknown = {axis for f in self.states if f.unknown for axis in f.group.axes if self.left.get(axis, 1.0) > T.small_residual}
        return self.axes_with_law | unknown | self.remaining


def validated(setup: Setup, runs: Runs, motions: Motions, states: list[GroupState]) -> Validated:
    """Predictions of all runs. Groups of axes that the correction makes worse are left uncorrected and marked as unknown."""
    setup.progress("simulating the held-out runs")
    held_out = held_out_predictions(setup, runs, motions, states)
    before, after = (levels(held_out.gaps[which]) for which in ("before", "after"))
    if any(worse := [is_worse(s.group.axes, before, after) for s in states]):
        states = [uncorrected(s) if w else s for s, w in zip(states, worse)]
        held_out = held_out_predictions(setup, runs, motions, states)
        after = levels(held_out.gaps["after"])
    doubted = [stand_ins(s) for s in states]
    states = [replace(s, unknown=bool(d) or (s.unknown and not many_effects_explain(s, before, after))) for s, d in zip(states, doubted)]
    every = {key: share for of in doubted for key, share in of.items()}
    return Validated(states, held_out, before, after, corrected_machine(setup.machine, states), stand_ins=every)


def with_laws(setup: Setup, runs: Runs, motions: Motions, validated: Validated) -> Validated:
    """The correction with those unlisted laws that leave the smallest held-out gap, if they close enough of it."""
    if setup.quick:
        return validated
    best, least_share = validated, LARGEST_SHARE
    for laws in find_unlisted_laws(setup, validated):
        share, corrected = _corrected_with(laws, setup, runs, motions, validated)
        if share <= least_share:
            best, least_share = corrected, share
        # where laws leave no considerable gap, other weights of the samples find no better ones
        if least_share < T.remaining or (best.laws and not best.axes_with_law & best.remaining):
            break
    for state in validated.states:
        state.rigid.answers.clear()  # only the search for laws uses them again
    return_memory()
    return best


def many_effects_explain(state: GroupState, before: Mapping[str, float], after: Mapping[str, float]) -> bool:
    """Whether more than MOST_EFFECTS effects of each loud axis of a group explain the runs left out down to noise.

    A missing small effect changes the fitted sizes of the others. Sizes that differ between runs are then no evidence of a law.
    """
    loud = [axis for axis in state.group.axes if before.get(axis, 0.0) > T.small_residual]
    explained = all(before[axis] > LOUD and after.get(axis, 0.0) <= T.small_residual for axis in loud)
    return bool(loud) and explained and all(_effect_count(state, axis) > MOST_EFFECTS for axis in loud)


def find_unlisted_laws(setup: Setup, validated: Validated) -> Iterator[Laws]:
    """Laws of axes that the search left unknown or that are still loud; up to two results, with different weights of the samples."""
    states, before, after = validated.states, validated.before, validated.after
    few = [axis for f in states for axis in f.group.seen_axes if _effect_count(f, axis) <= MOST_EFFECTS]
    of_signal = loudest(signal_levels(validated.held_out.gaps["after"]))

    def is_loud(axis: str) -> bool:
        blocks = [s.effect.block for f in states for s in f.fit.settings if s.axis == axis]
        imitated = len(set(blocks)) < len(blocks)  # a backlash and a spring, for example, imitate a hardening spring
        return needs_a_law(before.get(axis, 0.0), after.get(axis, 0.0), of_signal.get(axis, 0.0), imitated)

    loud = [axis for axis in few if is_loud(axis)]
    axes = [axis for f in states for axis in f.group.seen_axes if f.unknown or axis in loud]
    many = [a for f in states for a in f.group.seen_axes if a not in axes and costs_more_than_a_law(in_the_loop(f.fit.settings, a))]
    for asked, doubted in (([a for a in axes if a in few] + many, False), (axes, True)):
        if asked:
            with contextlib.suppress(TwinError):  # a corrected machine that cannot be simulated has no residual
                yield laws_of(states, asked, setup.folds, setup.progress, doubted, many)


def _effect_count(state: GroupState, axis: str) -> int:
    return sum(s.axis == axis for s in state.fit.settings)


def _corrected_with(laws: Laws, setup: Setup, runs: Runs, motions: Motions, validated: Validated) -> tuple[float, Validated]:
    """The share of the held-out gap that laws leave on their axes, and the correction with them; infinite if they are of no use.

    A law in place of effects that explained their axis leaves what these left.
    """
    held_out = validated.held_out
    if not laws.laws:
        return math.inf, validated
    try:
        predicted = held_out_predictions(setup, runs, motions, laws.states, held_out.predictions["before"])
    except TwinError:
        return math.inf, validated
    # the only run that shows a law is predicted by the machine fitted to all runs
    fitted = {runs[i].name for law in laws.laws if law.only_fold is not None for i in setup.folds[law.only_fold]}
    predicted = replace(predicted, names=[name for name in held_out.names if name not in fitted])
    loud = {law.axis for law in laws.laws} - laws.instead
    without, with_them = (signal_levels(of.gaps["after"]) for of in (held_out, predicted))
    if worse_signals(without, with_them) or (laws.instead and is_worse(laws.instead, validated.after, levels(predicted.gaps["after"]))):
        return math.inf, validated
    share = remaining_share(without, with_them, loud) if loud else 0.0
    return share, replace(validated, held_out=predicted, corrected=laws.corrected, laws=laws)
