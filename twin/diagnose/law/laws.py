"""Unlisted laws of unexplained axes: measured, identified, fitted in closed loop, and kept if they reduce the gap on runs left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.diagnose.law.acceptance import (
    LEAST_BESIDE,
    LEAST_EVIDENCE,
    LEAST_OF_ALL,
    deviations_of,
    justifies_a_law,
    loss_above_noise,
    predicts_clearly_better,
    remove_needless_slip,
    remove_settings_that_add_nothing,
    replace_laws_by_effects,
    restore_effects,
)
from twin.diagnose.law.closed_loop import ClosedLoop, Fitted, Say, State, state_of, with_law
from twin.diagnose.law.jitter import jitter_of
from twin.diagnose.law.proposals import STRONG, WEAK, Selection, label, measured_in, propose_laws, settings_of_proposals
from twin.diagnose.law.residual import Samples, residuals_of
from twin.diagnose.law.shapes import Described
from twin.diagnose.law.springs import springs_of, with_fitted_spring, with_normal_elasticity, with_rigid_drive_train
from twin.diagnose.observe import Group
from twin.diagnose.simulations import Mapper
from twin.diagnose.tolerance import drive_train_of, is_normal
from twin.effects import Setting, check_setting, settings_of, with_effects
from twin.machine.machine import Machine

MOST_LAWS = 12
"""Largest number of laws of one axis."""

LITTLE_LEFT = 0.02
"""Fraction of the gap before the first law below which the search for laws ends."""

MOST_EFFECTS = 5
"""Largest number of effects of an axis that a law may replace."""


@dataclass(frozen=True)
class Law:
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
    """The laws of a machine, with the machine fitted to all runs and those fitted without each fold."""

    laws: tuple[Law, ...]
    corrected: Machine
    without_fold: tuple[Machine, ...]
    left: dict[str, float]  # by axis, unexplained fraction of the gap above noise on runs left out


def laws_of(
    groups: Sequence[Group],
    machine: Machine,
    corrected: Machine,
    axes: Sequence[str],
    folds: Sequence[Sequence[int]],
    without_fold: Sequence[Machine],
    mapper: Mapper,
    say: Say = lambda _: None,
) -> Laws:
    """Laws of these axes in addition to the corrected machine.

    groups          groups of axes, observed against `machine`, the nominal machine without effects
    corrected       result of the search: the re-tuned machine with its effects
    axes            axes with an unexplained gap
    without_fold    the corrected machine fitted without the runs of each of `folds`
    """
    laws: list[Law] = []
    without = list(without_fold)
    left: dict[str, float] = {}
    for group in groups:
        for axis in [a for a in group.axes if a in axes]:
            say(f"{axis}: searching for an unlisted law")
            state = state_of(machine, corrected, (axis,), group.thresholds)
            blocks = residuals_of(group.views, state.machine_of, (axis,), mapper)
            if jitter := _jitter(blocks, axis, machine, group.confidence(axis)):
                laws.append(jitter)
                corrected, *without = (with_effects(m, [*settings_of(m), jitter.setting]) for m in (corrected, *without))
                left[axis] = 1.0 - jitter.explained
                continue
            slips = any(s.axis == axis and s.effect.normal == "slip" for s in state.settings)
            best = _search_axis(ClosedLoop(group, (axis,), folds, mapper, slips), state, blocks, axis, machine, say)
            left[axis] = best.left
            if not best.laws or best.fitted is None:
                continue
            laws += best.laws
            fitted = best.fitted
            corrected = fitted.state.corrected()
            without = [_with_axis_of(m, fitted.without(i), axis) for i, m in enumerate(without)]
    return Laws(tuple(laws), corrected, tuple(without), left)


def _jitter(blocks: Sequence[Samples], axis: str, machine: Machine, probability: float) -> Law | None:
    """The jitter of an axis' scale. Random errors have no response that could be fitted in closed loop; they are sized from the residual."""
    for samples in blocks:
        if samples.block == "transmission" and (found := jitter_of(samples)):
            setting = check_setting(found.table(axis), machine, "a measured law")
            return Law(setting, found, samples, found.predicts, probability, {})
    return None


def _with_axis_of(machine: Machine, state: State, axis: str) -> Machine:
    """A machine with the values and effects of one axis taken from a state."""
    whole = state.corrected()
    effects = [e for e in machine.effects if e["axis"] != axis] + [e for e in whole.effects if e["axis"] == axis]
    return machine.with_values({f"axis.{axis}.{k}": v for k, v in _numbers_in(whole.document["axis"][axis])} | {"effect": effects})


def _numbers_in(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _numbers_in(value, f"{prefix}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{prefix}{key}", value


@dataclass(frozen=True)
class _AxisLaws:
    """Laws of one axis from one start, their fit, and the remaining fraction of the gap above noise."""

    laws: list[Law]
    fitted: Fitted | None
    left: float


def _search_axis(loop: ClosedLoop, state: State, blocks: Sequence[Samples], axis: str, machine: Machine, say: Say) -> _AxisLaws:
    """Laws of one axis in addition to its effects, or instead of them if that predicts clearly better. `blocks` are the residuals of `state`.

    A search without the law may find effects that do not exist. The search for laws therefore also starts without the effects of the axis
    and restores those that reduce the gap.
    """
    loop = loop.halving_its_only_loud_fold(loop.left(state))
    own = tuple(s for s in state.settings if s.axis == axis and not s.effect.normal)
    beside = _search_from(loop, state, axis, machine, say, removable=own, blocks=blocks, selections=(STRONG, WEAK))
    if len(own) > MOST_EFFECTS:
        return beside
    bent = any(not is_normal(machine, s, loop.group.thresholds) for s in drive_train_of(state.settings, axis))
    if not own and (not bent or beside.left < LITTLE_LEFT):
        return beside
    say(f"{axis}: trying a law instead of {', '.join(s.effect.name for s in own) or 'a soft drive train'}")
    bare = replace(state, settings=tuple(s for s in state.settings if s not in own))
    starts = [as_in_the_file(state, axis), bare] if own else [as_in_the_file(state, axis)]
    if bent:
        starts += [with_law(with_rigid_drive_train(bare, axis), spring) for spring in springs_of(loop.group.views, axis, machine)]
    best = beside
    for start in starts:
        alone = _search_from(loop, start, axis, machine, say, own)
        if alone.fitted is not None and alone.laws and (best.fitted is None or predicts_clearly_better(loop, alone.fitted, best.fitted)):
            best = alone
            if best.left < LITTLE_LEFT:
                break
    return best


def as_in_the_file(state: State, axis: str) -> State:
    """The state with one axis as in the machine file: nominal values, no effects.

    The search may have re-tuned an axis, or bent its drive train, only to imitate a law.
    """
    values = {path: value for path, value in state.values.items() if not path.startswith(f"axis.{axis}.")}
    return replace(state, values=values, settings=tuple(s for s in state.settings if s.axis != axis))


def _search_from(
    loop: ClosedLoop,
    state: State,
    axis: str,
    machine: Machine,
    say: Say,
    restorable: Sequence[Setting] = (),
    removable: Sequence[Setting] = (),
    blocks: Sequence[Samples] | None = None,
    selections: Sequence[Selection] = (STRONG,),
) -> _AxisLaws:
    """Laws of one axis from a start state, added one by one while each reduces the gap enough. Then effects in `restorable` are restored if they
    reduce the gap, and effects in `removable` are removed if they no longer do. `blocks` are the residuals of the start state, if known. Candidates
    of each of the `selections` are tried if none of the one before reduces the gap."""
    tolerance = machine.parameter_tolerance
    first = loop.fit(state, tolerance, steps=2)
    if first is None:
        return _AxisLaws([], None, 1.0)
    fitted = first
    laws: list[Law] = []
    waiting: list[_Proposal] = []  # laws that reduce the gap, but less than the one that was added
    while len(laws) < MOST_LAWS and loss_above_noise(loop, fitted) >= LITTLE_LEFT * loss_above_noise(loop, first):
        if laws or blocks is None:
            blocks = residuals_of(loop.group.views, (fitted.state if laws else state).machine_of, (axis,), loop.mapper)
        justified = _justified(loop, fitted, loss_above_noise(loop, first), blocks, waiting, axis, machine, selections, say)
        if not justified:
            break
        (new, description, samples), *others = justified
        waiting = [(d, x, f.state.settings[-1]) for f, d, x in others]
        laws.append(_law_of(loop, fitted, new, loss_above_noise(loop, first), description, samples, axis))
        fitted = with_normal_elasticity(loop, new, axis, tolerance)
    if laws:
        fitted = restore_effects(loop, fitted, restorable, tolerance, LEAST_OF_ALL * loss_above_noise(loop, first))
        # prefer an effect to a law that predicts no better
        fitted = replace_laws_by_effects(loop, fitted, [law.setting for law in laws], restorable, tolerance)
        least = LEAST_BESIDE * loss_above_noise(loop, first)
        fitted = remove_settings_that_add_nothing(loop, fitted, [*removable, *(law.setting for law in laws)], tolerance, least)
        fitted = remove_needless_slip(loop, fitted, axis, tolerance)
        kept = {s.key for s in fitted.state.settings}
        laws = [law for law in laws if law.setting.key in kept]
    # all sizes are those of the last fit
    settings = {s.key: i for i, s in enumerate(fitted.state.settings)}
    at = [settings[law.setting.key] for law in laws]
    doubt = loop.group.thresholds.model_error
    laws = [replace(law, setting=fitted.state.settings[i], deviations=deviations_of(fitted, i, doubt)) for law, i in zip(laws, at)]
    unexplained = loss_above_noise(loop, fitted) / max(loss_above_noise(loop, first), 1e-300)
    return _AxisLaws(laws, fitted, float(min(max(unexplained, 0.0), 1.0)))


_Proposal = tuple[Described, Samples, Setting]


def _justified(
    loop: ClosedLoop,
    fitted: Fitted,
    loss_at_first: float,
    blocks: Sequence[Samples],
    waiting: Sequence[_Proposal],
    axis: str,
    machine: Machine,
    selections: Sequence[Selection],
    say: Say,
) -> list[tuple[Fitted, Described, Samples]]:
    """Fits of one more law that reduce the gap enough, best first.

    Tried are the laws `waiting` and the candidates of the first of the `selections` that brings one. `loss_at_first`: loss above noise before
    the first law.
    """
    known: set[str] = set()
    measured = measured_in(blocks, machine, axis)
    for selection in selections:
        proposed = settings_of_proposals(propose_laws(measured, machine, axis, selection), axis, machine)
        proposed = [p for p in proposed if label(p[0]) not in known]
        known |= {label(d) for d, _, _ in proposed}
        proposed += [p for p in waiting if label(p[0]) not in known]
        waiting = ()
        if not proposed:
            continue
        say(f"{axis}: {', '.join(label(d) for d, _, _ in proposed)} in closed loop")
        tolerance = machine.parameter_tolerance
        fits = [(loop.fit(with_law(with_fitted_spring(fitted.state, axis, d, x), s), tolerance, like=fitted), d, x) for d, x, s in proposed]
        tried = sorted(((f, d, x) for f, d, x in fits if f is not None), key=lambda t: t[0].held_out)
        if found := [t for t in tried if justifies_a_law(loop, fitted.held_out, t[0].held_out, LEAST_OF_ALL * loss_at_first)]:
            return found
    return []


def _law_of(
    loop: ClosedLoop, before: Fitted, after: Fitted, loss_at_first: float, description: Described, samples: Samples, axis: str
) -> Law:
    """The law that is the last setting of the fit `after`, with its share of the gap and its probability."""
    gain = before.held_out - after.held_out
    certain = 1.0 - np.exp(-gain / loop.inflation(after.held_out) / LEAST_EVIDENCE)
    group = loop.group
    return Law(
        after.state.settings[-1],
        description,
        samples,
        float(min(max(gain / max(loss_at_first, 1e-300), 0.0), 1.0)),
        float(min(certain, group.confidence(axis) if loop.only_fold is None else group.thresholds.confidence_in_one_run)),
        deviations_of(after, len(after.state.settings) - 1),
        loop.only_fold,
    )
