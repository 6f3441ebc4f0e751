"""Unlisted laws of the axes that stay unexplained: measured, recognised, fitted in closed loop, and kept where the gap shrinks on runs left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twin.diagnose.law.filters import filters_of
from twin.diagnose.law.keep import ClosedLoop, Fitted, Say, State, state_of, with_law
from twin.diagnose.law.measure import Curve, excess, measured_laws
from twin.diagnose.law.residual import Samples, residuals_of
from twin.diagnose.law.shapes import PER_NUMBER, Described, described
from twin.diagnose.law.springs import springs_of, sprung, unwound
from twin.diagnose.observe import Group
from twin.diagnose.plausible import is_plausible
from twin.diagnose.simulations import Mapper
from twin.effects import Setting, check_setting
from twin.errors import InputError
from twin.machine.machine import Machine

NOISY = 1.15
"""Power of a block's residual over noise up to which nothing is asked of it."""

LEAST_PREDICTS = 0.15
"""Share of the loss on runs left out that a law must predict in its block."""

LEAST_RUNS = 0.6
"""Share of the runs, weighted by what they leave, on which a law must be better."""

TRIED = 3
"""Candidates of a block that are described by formulas and tried in closed loop."""

NEAR_BEST = 0.4
"""Share of what the best candidate predicts from which another one is tried."""

MOST_LAWS = 3
"""Laws of one axis."""

LEAST_CLOSED = 0.05
"""Share of the gap above noise that a law must close on runs left out, in closed loop."""

LEAST_OF_ALL = 0.02
"""The same share of what the corrected twin left before any law."""

LEAST_BESIDE = 0.002
"""The same share that an effect which was found without the laws must close beside them to stay."""

LITTLE_LEFT = 0.02
"""Share of that from which on nothing more is looked for."""

LEAST_EVIDENCE = 30.0
"""Half the squares, over how far the twin is from noise, that a law must take away on runs left out."""

MOST_EFFECTS = 5
"""Effects of an axis that a law may be asked to stand in for: of more, each has earned its place beside the others."""

MOST_PROBABLE = 0.98
"""What nobody listed cannot be ruled out."""


@dataclass(frozen=True)
class Law:
    """One law that was kept: as it stands in the machine, how it was measured, and what it closes of its axis' gap on runs left out."""

    setting: Setting
    measured: Described
    samples: Samples = field(repr=False)
    explained: float
    probability: float
    deviations: dict[str, float]

    @property
    def axis(self) -> str:
        return self.setting.axis

    @property
    def block(self) -> str:
        return self.setting.effect.block


@dataclass(frozen=True)
class Laws:
    """The laws of a machine, with the machines that have them: fitted to all runs, and to all but each fold."""

    laws: tuple[Law, ...]
    corrected: Machine
    without_fold: tuple[Machine, ...]
    left: dict[str, float]  # share of each axis' gap above noise that stays unexplained, on runs left out


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
    """Laws of these axes beside the corrected twin.

    groups          the groups of axes as they were observed against `machine`, the nominal machine without effects
    corrected       what the search left: re-tuned, with its effects
    axes            the axes of which something is unexplained
    without_fold    the corrected machine fitted without the runs of each of `folds`
    """
    laws: list[Law] = []
    without = list(without_fold)
    left: dict[str, float] = {}
    for group in groups:
        for axis in [a for a in group.axes if a in axes]:
            say(f"{axis}: is there a law that no effect describes?")
            best = _of_axis(group, machine, corrected, axis, folds, mapper, say)
            left[axis] = best.left
            if not best.laws or best.fitted is None:
                continue
            laws += best.laws
            fitted = best.fitted
            corrected = fitted.state.corrected()
            without = [_taken_over(m, fitted.without(i), axis) for i, m in enumerate(without)]
    return Laws(tuple(laws), corrected, tuple(without), left)


def _taken_over(machine: Machine, state: State, axis: str) -> Machine:
    """A machine with all that a state says of one axis."""
    whole = state.corrected()
    document = {**machine.document}
    document["axis"] = {**document["axis"], axis: whole.document["axis"][axis]}
    effects = [e for e in machine.effects if e["axis"] != axis] + [e for e in whole.effects if e["axis"] == axis]
    return machine.with_values({f"axis.{axis}.{k}": v for k, v in _leaves(whole.document["axis"][axis])} | {"effect": effects})


def _leaves(table: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, float]]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{prefix}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{prefix}{key}", value


@dataclass(frozen=True)
class _OfAxis:
    """Laws of one axis from one start, the fit that holds them, and the share of the gap above noise that is left."""

    laws: list[Law]
    fitted: Fitted | None
    left: float


def _of_axis(
    group: Group, machine: Machine, corrected: Machine, axis: str, folds: Sequence[Sequence[int]], mapper: Mapper, say: Say
) -> _OfAxis:
    """Laws of one axis beside the effects that were found on it, or instead of them where that predicts clearly better.

    A search that lacks the law puts effects in its place that are not there. Laws are therefore looked for from the machine without the
    axis' effects, too; those of the effects that still earn their place come back.
    """
    loop = ClosedLoop(group, (axis,), folds, mapper)
    state = state_of(machine, corrected, (axis,), group.thresholds)
    own = tuple(s for s in state.settings if s.axis == axis and not s.effect.normal)
    if not own or len(own) > MOST_EFFECTS:
        return _from(loop, state, axis, machine, say)
    beside = _from(loop, state, axis, machine, say, idle=own)
    say(f"{axis}: a law instead of {', '.join(s.effect.name for s in own)}?")
    bare = replace(state, settings=tuple(s for s in state.settings if s not in own))
    starts = [bare]
    if any(s.effect.block == "transmission" for s in own):
        starts += [with_law(unwound(bare, axis), spring) for spring in springs_of(loop.group.views, axis, machine)]
    best = beside
    for start in starts:
        alone = _from(loop, start, axis, machine, say, own)
        if alone.fitted is not None and alone.laws and (best.fitted is None or _clearly_better(loop, alone.fitted, best.fitted)):
            best = alone
            if best.left < LITTLE_LEFT:
                break
    return best


def _clearly_better(loop: ClosedLoop, new: Fitted, old: Fitted) -> bool:
    """Does a fit predict runs left out better by what each effect or law more must earn? As many of both: the old one stays unless the
    other is clearly better."""
    more = len(new.state.settings) - len(old.state.settings)
    margin = LEAST_EVIDENCE * _inflation(loop, new.held_out) * (more if more < 0 else more + 1)
    return new.held_out + margin < old.held_out


def _from(
    loop: ClosedLoop, state: State, axis: str, machine: Machine, say: Say, back: Sequence[Setting] = (), idle: Sequence[Setting] = ()
) -> _OfAxis:
    """Laws of one axis from a state on, one after another while each earns its place; then effects come `back` that earn theirs, and those
    go that are `idle` beside the laws."""
    tolerance = machine.parameter_tolerance
    first = loop.fit(state, tolerance, steps=2)
    if first is None:
        return _OfAxis([], None, 1.0)
    fitted = first
    laws: list[Law] = []
    while len(laws) < MOST_LAWS and _above(loop, fitted) > LITTLE_LEFT * _above(loop, first):
        proposals = _proposals(loop.group, fitted.state if laws else state, axis, loop.mapper)
        if not proposals:
            break
        say(f"{axis}: {', '.join(_named(d) for d, _ in proposals)} in closed loop")
        tried = [
            (loop.fit(with_law(sprung(fitted.state, axis, d, x), s), tolerance, like=fitted), d, x)
            for d, x, s in _settings(proposals, axis, machine)
        ]
        best = min(((f, d, x) for f, d, x in tried if f is not None), key=lambda t: t[0].held_out, default=None)
        if best is None or not _earned(loop, fitted.held_out, best[0].held_out, LEAST_OF_ALL * _above(loop, first)):
            break
        new, description, samples = best
        share = (fitted.held_out - new.held_out) / max(_above(loop, first), 1e-300)
        certain = 1.0 - np.exp(-(fitted.held_out - new.held_out) / _inflation(loop, new.held_out) / LEAST_EVIDENCE)
        laws.append(
            Law(
                new.state.settings[-1],
                description,
                samples,
                float(min(max(share, 0.0), 1.0)),
                float(min(certain, MOST_PROBABLE)),
                _deviations(new, len(new.state.settings) - 1),
            )
        )
        fitted = new
    if laws:
        fitted = _with_those_that_earn(loop, fitted, back, tolerance, LEAST_OF_ALL * _above(loop, first))
        # what an effect explains no law needs to stand in for
        fitted = _named_instead(loop, fitted, laws, back, tolerance)
        least = LEAST_BESIDE * _above(loop, first)
        fitted = _without_idle(loop, fitted, [*idle, *(law.setting for law in laws)], tolerance, least)
        fitted = _without_slip(loop, fitted, axis, tolerance)
        kept = {s.key for s in fitted.state.settings}
        laws = [law for law in laws if law.setting.key in kept]
    # sizes of all laws are those of the last fit
    settings = {s.key: i for i, s in enumerate(fitted.state.settings)}
    at = [settings[law.setting.key] for law in laws]
    doubt = loop.group.thresholds.model_error
    laws = [replace(law, setting=fitted.state.settings[i], deviations=_deviations(fitted, i, doubt)) for law, i in zip(laws, at)]
    unexplained = _above(loop, fitted) / max(_above(loop, first), 1e-300)
    return _OfAxis(laws, fitted, float(min(max(unexplained, 0.0), 1.0)))


def _with_those_that_earn(loop: ClosedLoop, fitted: Fitted, back: Sequence[Setting], tolerance: float, least: float) -> Fitted:
    """The fit with those of the effects `back` that shrink the gap on runs left out, best first."""
    waiting = list(back)
    while waiting:
        tried = [(loop.fit(with_law(fitted.state, s), tolerance, steps=2, like=fitted), s) for s in waiting]
        best = min(((f, s) for f, s in tried if f is not None), key=lambda t: t[0].held_out, default=None)
        if best is None or not _earned(loop, fitted.held_out, best[0].held_out, least):
            break
        waiting.remove(best[1])
        if is_plausible(best[0].state.settings[-1], fitted.state.machine):
            fitted = best[0]
    return fitted


def _named_instead(loop: ClosedLoop, fitted: Fitted, laws: Sequence[Law], effects: Sequence[Setting], tolerance: float) -> Fitted:
    """The fit with effects in place of those laws that predict runs left out next to no better: by less than a twentieth of what the law
    closes, and of what it leaves."""
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


def _without_idle(loop: ClosedLoop, fitted: Fitted, idle: Sequence[Setting], tolerance: float, least: float) -> Fitted:
    """The fit without those of the effects that no longer earn their place, or have a size that no machine has or none, the least needed
    first."""
    waiting = {s.key for s in idle}
    small = {
        s.key
        for i, s in enumerate(fitted.state.settings)
        if s.key in waiting and not (is_plausible(s, fitted.state.machine) and _has_size(fitted, i))
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


def _without_slip(loop: ClosedLoop, fitted: Fitted, axis: str, tolerance: float) -> Fitted:
    """The fit without slip before break-away where that predicts runs left out better: it was sized beside what the laws may have replaced."""
    kept = tuple(s for s in fitted.state.settings if s.axis != axis or s.effect.normal != "slip")
    if len(kept) == len(fitted.state.settings):
        return fitted
    without = loop.fit(replace(fitted.state, settings=kept), tolerance, steps=2, like=fitted)
    return without if without is not None and without.held_out < fitted.held_out else fitted


def _inflation(loop: ClosedLoop, loss: float) -> float:
    """How much larger than noise alone what is left is; at least 1."""
    return max(1.0, loss / max(loop.expected, 1e-300))


def _above(loop: ClosedLoop, fitted: Fitted) -> float:
    """Loss above noise on runs left out."""
    return max(fitted.held_out - loop.expected, 0.0)


def _earned(loop: ClosedLoop, before: float, after: float, least: float) -> bool:
    """Does a law shrink the gap on runs left out by enough?"""
    gain = before - after
    return gain > least and gain > LEAST_CLOSED * max(before - loop.expected, 0.0) and gain / _inflation(loop, after) > LEAST_EVIDENCE


def _deviations(fitted: Fitted, index: int, model_error: float = 0.0) -> dict[str, float]:
    """Standard deviations of the numbers of a setting, in their own units; `model_error` is the share that no number of samples takes away."""
    out = {}
    for u, deviation in zip(fitted.unknowns, fitted.deviations):
        if u.setting == index:
            value = fitted.state.settings[index].parameters[u.name]
            out[u.name] = float(np.hypot(deviation * u.step * (abs(value) if u.logarithmic else 1.0), model_error * value))
    return out


def _has_size(fitted: Fitted, index: int) -> bool:
    """Is the size of a setting known from none: outside its own 95 % interval?"""
    setting = fitted.state.settings[index]
    size = setting.effect.size
    deviation = _deviations(fitted, index).get(size.name)
    return deviation is None or abs(size.deviation(setting.parameters[size.name])) > 1.96 * deviation


def _named(d: Described) -> str:
    return f"{d.candidate.output} over {d.candidate.variable}{f' of {d.candidate.source}' if d.candidate.source else ''}"


def _proposals(group: Group, state: State, axis: str, mapper: Mapper) -> list[tuple[Described, Samples]]:
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


def _settings(proposals: Sequence[tuple[Described, Samples]], axis: str, machine: Machine) -> list[tuple[Described, Samples, Setting]]:
    """Proposals as settings. Play turns over within its own width: samples that are milliseconds apart show that less well than its height."""
    out = []
    for d, s in proposals:
        table = d.table(axis)
        play = [{**table, "length": abs(table["height"])}] if d.candidate.variable == "slack" and "height" in table else []
        for start in (table, *play):
            with contextlib.suppress(InputError):  # a number outside what its shape allows
                out.append((d, s, check_setting(start, machine, "a measured law")))
    return out
