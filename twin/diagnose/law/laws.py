"""Unlisted laws of unexplained axes: measured, identified, fitted in closed loop, and kept if they reduce the gap on runs left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.diagnose.law.closed_loop import ClosedLoop, Fitted, Say, State, state_of, with_law
from twin.diagnose.law.filters import filters_of
from twin.diagnose.law.jitter import jitter_of
from twin.diagnose.law.measure import Curve, excess, measured_laws
from twin.diagnose.law.residual import Samples, residuals_of
from twin.diagnose.law.shapes import PER_NUMBER, Described, described
from twin.diagnose.law.springs import springs_of, with_fitted_spring, with_rigid_drive_train
from twin.diagnose.observe import Group
from twin.diagnose.plausible import is_plausible
from twin.diagnose.simulations import Mapper
from twin.effects import Setting, check_setting, settings_of, with_effects
from twin.errors import InputError
from twin.machine.machine import Machine

NOISY = 1.15
"""Power of the residual of a block over noise up to which no law is sought in it."""

LEAST_PREDICTS = 0.15
"""Smallest fraction of the loss on runs left out that a law must predict in its block."""

LEAST_RUNS = 0.6
"""Smallest fraction of the runs, weighted by their loss, that a law must improve."""

TRIED = 3
"""Number of candidates that are described by formulas and fitted in closed loop."""

NEAR_BEST = 0.4
"""Smallest prediction of a further candidate, as a fraction of that of the best one."""

MOST_LAWS = 3
"""Largest number of laws of one axis."""

LEAST_CLOSED = 0.05
"""Smallest fraction of the gap above noise on runs left out that a law must close in closed loop."""

LEAST_OF_ALL = 0.02
"""The same as a fraction of the gap before the first law."""

LEAST_BESIDE = 0.002
"""The same for an effect found by the search, to stay beside the laws."""

LITTLE_LEFT = 0.02
"""Fraction of the gap before the first law below which the search for laws ends."""

LEAST_EVIDENCE = 30.0
"""Smallest decrease of half the sum of squares on runs left out, divided by the inflation over noise, that a law must achieve."""

MOST_EFFECTS = 5
"""Largest number of effects of an axis that a law may replace."""

MOST_PROBABLE = 0.98
"""Upper limit of the probability of a law; unknown alternatives cannot be excluded."""

MOST_PROBABLE_IN_ONE_RUN = 0.9
"""The same for a law that acts in one run only, and that no other run can confirm."""


@dataclass(frozen=True)
class Law:
    """One law: its setting, its measurement, and the fraction of the gap of its axis that it closes on runs left out."""

    setting: Setting
    measured: Described
    samples: Samples = field(repr=False)
    explained: float
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
            if jitter := _jitter(group, machine, corrected, axis, mapper):
                laws.append(jitter)
                corrected, *without = (with_effects(m, [*settings_of(m), jitter.setting]) for m in (corrected, *without))
                left[axis] = 1.0 - jitter.explained
                continue
            best = _search_axis(group, machine, corrected, axis, folds, mapper, say)
            left[axis] = best.left
            if not best.laws or best.fitted is None:
                continue
            laws += best.laws
            fitted = best.fitted
            corrected = fitted.state.corrected()
            without = [_with_axis_of(m, fitted.without(i), axis) for i, m in enumerate(without)]
    return Laws(tuple(laws), corrected, tuple(without), left)


def _jitter(group: Group, machine: Machine, corrected: Machine, axis: str, mapper: Mapper) -> Law | None:
    """The jitter of an axis' scale. Random errors have no response that could be fitted in closed loop; they are sized from the residual."""
    state = state_of(machine, corrected, (axis,), group.thresholds)
    for samples in residuals_of(group.views, state.machine_of, (axis,), mapper):
        if samples.block == "transmission" and (found := jitter_of(samples)):
            setting = check_setting(found.table(axis), machine, "a measured law")
            return Law(setting, found, samples, found.predicts, MOST_PROBABLE, {})
    return None


def _with_axis_of(machine: Machine, state: State, axis: str) -> Machine:
    """A machine with the values and effects of one axis taken from a state."""
    whole = state.corrected()
    document = {**machine.document}
    document["axis"] = {**document["axis"], axis: whole.document["axis"][axis]}
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


def _search_axis(
    group: Group, machine: Machine, corrected: Machine, axis: str, folds: Sequence[Sequence[int]], mapper: Mapper, say: Say
) -> _AxisLaws:
    """Laws of one axis in addition to its effects, or instead of them if that predicts clearly better.

    A search without the law may find effects that do not exist. The search for laws therefore also starts without the effects of the axis
    and restores those that reduce the gap.
    """
    loop = ClosedLoop(group, (axis,), folds, mapper)
    state = state_of(machine, corrected, (axis,), group.thresholds)
    loop = loop.halving_its_only_loud_fold(loop.left(state))
    own = tuple(s for s in state.settings if s.axis == axis and not s.effect.normal)
    if not own or len(own) > MOST_EFFECTS:
        return _search_from(loop, state, axis, machine, say)
    beside = _search_from(loop, state, axis, machine, say, removable=own)
    say(f"{axis}: trying a law instead of {', '.join(s.effect.name for s in own)}")
    bare = replace(state, settings=tuple(s for s in state.settings if s not in own))
    starts = [as_in_the_file(state, axis), bare]
    if any(s.effect.block == "transmission" for s in own):
        starts += [with_law(with_rigid_drive_train(bare, axis), spring) for spring in springs_of(loop.group.views, axis, machine)]
    best = beside
    for start in starts:
        alone = _search_from(loop, start, axis, machine, say, own)
        if alone.fitted is not None and alone.laws and (best.fitted is None or _predicts_clearly_better(loop, alone.fitted, best.fitted)):
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


def _predicts_clearly_better(loop: ClosedLoop, new: Fitted, old: Fitted) -> bool:
    """Whether a fit predicts runs left out better by the margin that each additional effect or law requires. With equal numbers of them, the
    new fit needs the margin once."""
    more = len(new.state.settings) - len(old.state.settings)
    margin = LEAST_EVIDENCE * _inflation(loop, new.held_out) * (more if more < 0 else more + 1)
    return new.held_out + margin < old.held_out


def _search_from(
    loop: ClosedLoop,
    state: State,
    axis: str,
    machine: Machine,
    say: Say,
    restorable: Sequence[Setting] = (),
    removable: Sequence[Setting] = (),
) -> _AxisLaws:
    """Laws of one axis from a start state, added one by one while each reduces the gap enough. Then effects in `restorable` are restored if they
    reduce the gap, and effects in `removable` are removed if they no longer do."""
    tolerance = machine.parameter_tolerance
    first = loop.fit(state, tolerance, steps=2)
    if first is None:
        return _AxisLaws([], None, 1.0)
    only = loop.halved if loop.has_more_folds else None
    fitted = first
    laws: list[Law] = []
    while len(laws) < MOST_LAWS and _loss_above_noise(loop, fitted) > LITTLE_LEFT * _loss_above_noise(loop, first):
        proposals = _propose_laws(loop.group, fitted.state if laws else state, axis, loop.mapper)
        if not proposals:
            break
        say(f"{axis}: {', '.join(_label(d) for d, _ in proposals)} in closed loop")
        tried = [
            (loop.fit(with_law(with_fitted_spring(fitted.state, axis, d, x), s), tolerance, like=fitted), d, x)
            for d, x, s in _settings_of(proposals, axis, machine)
        ]
        best = min(((f, d, x) for f, d, x in tried if f is not None), key=lambda t: t[0].held_out, default=None)
        if best is None or not _justifies_a_law(loop, fitted.held_out, best[0].held_out, LEAST_OF_ALL * _loss_above_noise(loop, first)):
            break
        new, description, samples = best
        share = (fitted.held_out - new.held_out) / max(_loss_above_noise(loop, first), 1e-300)
        certain = 1.0 - np.exp(-(fitted.held_out - new.held_out) / _inflation(loop, new.held_out) / LEAST_EVIDENCE)
        laws.append(
            Law(
                new.state.settings[-1],
                description,
                samples,
                float(min(max(share, 0.0), 1.0)),
                float(min(certain, MOST_PROBABLE if only is None else MOST_PROBABLE_IN_ONE_RUN)),
                _deviations(new, len(new.state.settings) - 1),
                only,
            )
        )
        fitted = new
    if laws:
        fitted = _restore_effects(loop, fitted, restorable, tolerance, LEAST_OF_ALL * _loss_above_noise(loop, first))
        # prefer an effect to a law that predicts no better
        fitted = _replace_laws_by_effects(loop, fitted, laws, restorable, tolerance)
        least = LEAST_BESIDE * _loss_above_noise(loop, first)
        fitted = _remove_settings_that_add_nothing(loop, fitted, [*removable, *(law.setting for law in laws)], tolerance, least)
        fitted = _remove_needless_slip(loop, fitted, axis, tolerance)
        kept = {s.key for s in fitted.state.settings}
        laws = [law for law in laws if law.setting.key in kept]
    # all sizes are those of the last fit
    settings = {s.key: i for i, s in enumerate(fitted.state.settings)}
    at = [settings[law.setting.key] for law in laws]
    doubt = loop.group.thresholds.model_error
    laws = [replace(law, setting=fitted.state.settings[i], deviations=_deviations(fitted, i, doubt)) for law, i in zip(laws, at)]
    unexplained = _loss_above_noise(loop, fitted) / max(_loss_above_noise(loop, first), 1e-300)
    return _AxisLaws(laws, fitted, float(min(max(unexplained, 0.0), 1.0)))


def _restore_effects(loop: ClosedLoop, fitted: Fitted, restorable: Sequence[Setting], tolerance: float, least: float) -> Fitted:
    """The fit with those of the effects `restorable` that reduce the gap on runs left out, best first."""
    waiting = list(restorable)
    while waiting:
        tried = [(loop.fit(with_law(fitted.state, s), tolerance, steps=2, like=fitted), s) for s in waiting]
        best = min(((f, s) for f, s in tried if f is not None), key=lambda t: t[0].held_out, default=None)
        if best is None or not _justifies_a_law(loop, fitted.held_out, best[0].held_out, least):
            break
        waiting.remove(best[1])
        if is_plausible(best[0].state.settings[-1], fitted.state.machine):
            fitted = best[0]
    return fitted


def _replace_laws_by_effects(loop: ClosedLoop, fitted: Fitted, laws: Sequence[Law], effects: Sequence[Setting], tolerance: float) -> Fitted:
    """The fit with an effect instead of each law that predicts runs left out hardly better: by less than LEAST_CLOSED of the loss that the law
    removes and of the loss that remains."""
    for law in laws:
        held = {s.key for s in fitted.state.settings}
        others = tuple(s for s in fitted.state.settings if s.key != law.setting.key)
        tried = [loop.fit(replace(fitted.state, settings=(*others, s)), tolerance, like=fitted) for s in effects if s.key not in held]
        best = min((f for f in tried if f is not None), key=lambda f: f.held_out, default=None)
        without = loop.fit(replace(fitted.state, settings=others), tolerance, steps=2, like=fitted) if best else None
        if best is None or without is None:
            continue
        worse = best.held_out - fitted.held_out
        if worse < LEAST_CLOSED * min(without.held_out - fitted.held_out, max(fitted.held_out, loop.expected)):
            fitted = best
    return fitted


def _remove_settings_that_add_nothing(
    loop: ClosedLoop, fitted: Fitted, removable: Sequence[Setting], tolerance: float, least: float
) -> Fitted:
    """The fit without those of the `removable` settings that no longer reduce the gap enough, or whose size is implausible or not significant, the
    least important first."""
    waiting = {s.key for s in removable}
    small = {
        s.key
        for i, s in enumerate(fitted.state.settings)
        if s.key in waiting and not (is_plausible(s, fitted.state.machine) and _is_significant(fitted, i))
    }
    while waiting:
        tried = []
        for key in waiting:
            state = replace(fitted.state, settings=tuple(s for s in fitted.state.settings if s.key != key))
            tried.append((loop.fit(state, tolerance, steps=2, like=fitted), key))
        best = min(((f, key) for f, key in tried if f is not None), key=lambda t: (t[1] not in small, t[0].held_out), default=None)
        if best is None or (
            best[1] not in small and best[0].held_out > fitted.held_out + max(least, LEAST_EVIDENCE * _inflation(loop, fitted.held_out))
        ):
            break
        fitted = best[0]
        waiting.remove(best[1])
    return fitted


def _remove_needless_slip(loop: ClosedLoop, fitted: Fitted, axis: str, tolerance: float) -> Fitted:
    """The fit without slip before break-away if that predicts runs left out better; the slip was fitted without the laws."""
    kept = tuple(s for s in fitted.state.settings if s.axis != axis or s.effect.normal != "slip")
    if len(kept) == len(fitted.state.settings):
        return fitted
    without = loop.fit(replace(fitted.state, settings=kept), tolerance, steps=2, like=fitted)
    return without if without is not None and without.held_out < fitted.held_out else fitted


def _inflation(loop: ClosedLoop, loss: float) -> float:
    """Loss over the expected loss of noise, at least 1."""
    return max(1.0, loss / max(loop.expected, 1e-300))


def _loss_above_noise(loop: ClosedLoop, fitted: Fitted) -> float:
    """Loss above noise on runs left out."""
    return max(fitted.held_out - loop.expected, 0.0)


def _justifies_a_law(loop: ClosedLoop, before: float, after: float, least: float) -> bool:
    """Whether the decrease of the loss on runs left out justifies a law."""
    gain = before - after
    return gain > least and gain > LEAST_CLOSED * max(before - loop.expected, 0.0) and gain / _inflation(loop, after) > LEAST_EVIDENCE


def _deviations(fitted: Fitted, index: int, model_error: float = 0.0) -> dict[str, float]:
    """Standard deviations of the parameters of a setting; `model_error` is a relative error that does not fall with the number of samples."""
    out = {}
    for u, deviation in zip(fitted.unknowns, fitted.deviations):
        if u.setting == index:
            value = fitted.state.settings[index].parameters[u.name]
            out[u.name] = float(np.hypot(deviation * u.step * (abs(value) if u.logarithmic else 1.0), model_error * value))
    return out


def _is_significant(fitted: Fitted, index: int) -> bool:
    """Whether the 95 % interval of the size of a setting excludes neutral."""
    setting = fitted.state.settings[index]
    size = setting.effect.size
    deviation = _deviations(fitted, index).get(size.name)
    return deviation is None or abs(size.deviation(setting.parameters[size.name])) > 1.96 * deviation


def _label(d: Described) -> str:
    return f"{d.candidate.output} over {d.candidate.variable}{f' of {d.candidate.source}' if d.candidate.source else ''}"


def _propose_laws(group: Group, state: State, axis: str, mapper: Mapper) -> list[tuple[Described, Samples]]:
    """The laws that predict best in the blocks of an axis that are furthest from noise, as formulas, filters or tables."""
    samples = [s for s in residuals_of(group.views, state.machine_of, (axis,), mapper) if excess(s) > NOISY]
    own = state.machine.axis(axis)
    found: list[tuple[float, Described, Samples]] = []
    for s in samples:
        suited = [c for c in measured_laws(s, own) if c.predicts > LEAST_PREDICTS and c.runs_better >= LEAST_RUNS]
        distinct: dict[tuple[str, str, str, bool], Curve] = {}
        for c in suited:
            distinct.setdefault((c.candidate.output, c.candidate.variable, c.candidate.source, bool(c.candidate.period)), c)
        near = [c for c in distinct.values() if c.predicts > NEAR_BEST * suited[0].predicts][: TRIED + 1]
        filters = [f for f in filters_of(s, state.machine) if f.predicts > LEAST_PREDICTS and f.curve.runs_better >= LEAST_RUNS]
        for d in [*(described(s, c, own) for c in near), *filters]:
            found.append((excess(s) * (d.predicts - PER_NUMBER * len(d.numbers)), d, s))
    found.sort(key=lambda f: -f[0])
    return [(d, s) for _, d, s in found[:TRIED]]


def _settings_of(proposals: Sequence[tuple[Described, Samples]], axis: str, machine: Machine) -> list[tuple[Described, Samples, Setting]]:
    """Proposals as settings. The length of a play is its height, which is measured better."""
    out = []
    for d, s in proposals:
        table = d.table(axis)
        if d.candidate.variable == "slack" and "height" in table:
            table = {**table, "length": abs(table["height"])}
        with contextlib.suppress(InputError):  # a parameter out of the bounds of its shape
            out.append((d, s, check_setting(table, machine, "a measured law")))
    return out
