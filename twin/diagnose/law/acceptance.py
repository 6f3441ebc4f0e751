"""Acceptance of laws in closed loop: the gain on runs left out that a law must bring, and the effects that stay beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.law.closed_loop import ClosedLoop, Fitted, with_law
from twin.diagnose.plausible import is_plausible
from twin.effects import Setting

LEAST_CLOSED = 0.05
"""Smallest fraction of the gap above noise on runs left out that a law must close in closed loop."""

LEAST_OF_ALL = 0.02
"""The same as a fraction of the gap before the first law."""

LEAST_BESIDE = 0.002
"""The same for an effect found by the search, to stay beside the laws."""

LEAST_EVIDENCE = 30.0
"""Smallest decrease of half the sum of squares on runs left out, divided by the inflation over noise, that a law must achieve."""


def loss_above_noise(loop: ClosedLoop, fitted: Fitted) -> float:
    """Loss above noise on runs left out."""
    return max(fitted.held_out - loop.expected, 0.0)


def justifies_a_law(loop: ClosedLoop, before: float, after: float, least: float) -> bool:
    """Whether the decrease of the loss on runs left out justifies a law."""
    gain = before - after
    return gain > least and gain > LEAST_CLOSED * max(before - loop.expected, 0.0) and gain / loop.inflation(after) > LEAST_EVIDENCE


def predicts_clearly_better(loop: ClosedLoop, new: Fitted, old: Fitted) -> bool:
    """Whether a fit predicts runs left out better by the margin that each additional effect or law requires. With equal numbers of them, the
    new fit needs the margin once."""
    more = len(new.state.settings) - len(old.state.settings)
    margin = LEAST_EVIDENCE * loop.inflation(new.held_out) * (more if more < 0 else more + 1)
    return new.held_out + margin < old.held_out


def deviations_of(fitted: Fitted, index: int, model_error: float = 0.0) -> dict[str, float]:
    """Standard deviations of the parameters of a setting; `model_error` is a relative error that does not fall with the number of samples."""
    out = {}
    for u, deviation in zip(fitted.unknowns, fitted.deviations):
        if u.setting == index:
            value = fitted.state.settings[index].parameters[u.name]
            out[u.name] = float(np.hypot(deviation * u.step * (abs(value) if u.logarithmic else 1.0), model_error * value))
    return out


def is_significant(fitted: Fitted, index: int) -> bool:
    """Whether the 95 % interval of the size of a setting excludes neutral."""
    setting = fitted.state.settings[index]
    size = setting.effect.size
    deviation = deviations_of(fitted, index).get(size.name)
    return deviation is None or abs(size.deviation(setting.parameters[size.name])) > 1.96 * deviation


def restore_effects(loop: ClosedLoop, fitted: Fitted, restorable: Sequence[Setting], tolerance: float, least: float) -> Fitted:
    """The fit with those of the effects `restorable` that reduce the gap on runs left out, best first."""
    waiting = list(restorable)
    while waiting:
        tried = [(loop.fit(with_law(fitted.state, s), tolerance, steps=2, like=fitted), s) for s in waiting]
        best = min(((f, s) for f, s in tried if f is not None), key=lambda t: t[0].held_out, default=None)
        if best is None or not justifies_a_law(loop, fitted.held_out, best[0].held_out, least):
            break
        waiting.remove(best[1])
        if is_plausible(best[0].state.settings[-1], fitted.state.machine, thresholds=loop.group.thresholds):
            fitted = best[0]
    return fitted


def replace_laws_by_effects(
    loop: ClosedLoop, fitted: Fitted, laws: Sequence[Setting], effects: Sequence[Setting], tolerance: float
) -> Fitted:
    """The fit with an effect instead of each law that predicts runs left out hardly better: by less than LEAST_CLOSED of the loss that the law
    removes and of the loss that remains."""
    for law in laws:
        held = {s.key for s in fitted.state.settings}
        others = tuple(s for s in fitted.state.settings if s.key != law.key)
        tried = [loop.fit(replace(fitted.state, settings=(*others, s)), tolerance, like=fitted) for s in effects if s.key not in held]
        best = min((f for f in tried if f is not None), key=lambda f: f.held_out, default=None)
        without = loop.fit(replace(fitted.state, settings=others), tolerance, steps=2, like=fitted) if best else None
        if best is None or without is None:
            continue
        worse = best.held_out - fitted.held_out
        if worse < LEAST_CLOSED * min(without.held_out - fitted.held_out, max(fitted.held_out, loop.expected)):
            fitted = best
    return fitted


def remove_settings_that_add_nothing(
    loop: ClosedLoop, fitted: Fitted, removable: Sequence[Setting], tolerance: float, least: float
) -> Fitted:
    """The fit without those of the `removable` settings that no longer reduce the gap enough, or whose size is implausible or not significant, the
    least important first."""
    waiting = {s.key for s in removable}
    small = {
        s.key
        for i, s in enumerate(fitted.state.settings)
        if s.key in waiting and not (is_plausible(s, fitted.state.machine, thresholds=loop.group.thresholds) and is_significant(fitted, i))
    }
    while waiting:
        tried = []
        for key in waiting:
            state = replace(fitted.state, settings=tuple(s for s in fitted.state.settings if s.key != key))
            tried.append((loop.fit(state, tolerance, steps=2, like=fitted), key))
        best = min(((f, key) for f, key in tried if f is not None), key=lambda t: (t[1] not in small, t[0].held_out), default=None)
        if best is None or (
            best[1] not in small and best[0].held_out > fitted.held_out + max(least, LEAST_EVIDENCE * loop.inflation(fitted.held_out))
        ):
            break
        fitted = best[0]
        waiting.remove(best[1])
    return fitted


def remove_needless_slip(loop: ClosedLoop, fitted: Fitted, axis: str, tolerance: float) -> Fitted:
    """The fit without slip before break-away if that predicts runs left out better; the slip was fitted without the laws."""
    kept = tuple(s for s in fitted.state.settings if s.axis != axis or s.effect.normal != "slip")
    if len(kept) == len(fitted.state.settings):
        return fitted
    without = loop.fit(replace(fitted.state, settings=kept), tolerance, steps=2, like=fitted)
    return without if without is not None and without.held_out < fitted.held_out else fitted
