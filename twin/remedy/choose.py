"""The smallest set of changes that reaches a target: what was changed is set back before what is worn is compensated, the best change first,
each tuned beside those before it, until nothing helps further.

A change is kept only if it also helps off the motion it was tuned on: at two other feeds, and with the friction of the machine 20 % higher
and lower. A change that makes one of these worse is refused with the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

from twin.effects import EFFECTS, Setting, settings_of, with_effects
from twin.machine.machine import Machine
from twin.remedy.advice import ADVICE, BACKLASH, PULSE, SET_BACK, TABLE
from twin.remedy.change import Change
from twin.remedy.predict import Motionful, errors_of, with_changes
from twin.remedy.tune_change import tuned

WORTH = 0.02
"""Smallest share of the error that a further change must take away."""
FRICTIONS = (0.8, 1.2)
"""Friction of the machine at which a change is tried beside its own."""
NO_WORSE = 1.02
"""Largest error with a change over that without it, elsewhere; below is chance of the simulation."""


@dataclass(frozen=True)
class Refused:
    """An effect that no setting of the control cures, or a change that does harm, with the reason."""

    effect: str
    axis: str
    reason: str


@dataclass(frozen=True)
class Chosen:
    """The changes in their order with the RMS contour error [m] before and after each, and what was refused."""

    changes: tuple[Change, ...]
    errors: tuple[float, ...]
    refused: tuple[Refused, ...]


def candidates(machine: Machine) -> tuple[list[Change], list[Refused]]:
    """Changes that answer the effects of a machine, and the effects that none answers. Settings of the control come first."""
    changes: list[Change] = []
    refused = []
    for setting in settings_of(machine):
        advice = ADVICE[setting.effect.name]
        functions = advice.with_scale if machine.axis(setting.axis).encoder == "scale" else advice.with_motor_encoder
        if not functions:
            refused.append(Refused(setting.effect.name, setting.axis, advice.refused or "no setting of the control answers it"))
        for function in functions:
            if (setting.axis, function) not in {(c.axis, c.function) for c in changes if function != SET_BACK}:
                changes.append(Change(setting.axis, function, setting))
    pulsed = {c.axis for c in changes if c.function == PULSE}
    changes += [Change(a.name, PULSE) for a in machine.axes if a.name not in pulsed and a.coulomb_friction_nm > 0.0]
    return sorted(changes, key=lambda c: c.function != SET_BACK), refused


def choose(
    machine: Machine,
    on: Sequence[Motionful],
    elsewhere: Sequence[Motionful],
    target: float,
    say: Callable[[str], None] = lambda _text: None,
) -> Chosen:
    """Changes of a machine that bring the RMS contour error over the motions to the target [m], or as near as they can."""
    left, refused = candidates(machine)
    chosen: list[Change] = []
    now = _rms(machine, on)
    errors = [now]
    reversing = {axis for motion in on for axis in _reversing(machine, motion)}
    # what was changed, then what is displaced, then what is late
    back, placed = ([c for c in left if c.function in functions] for functions in ((SET_BACK,), (TABLE, BACKLASH)))
    for pool in (back, placed, [c for c in left if c.function == PULSE and c.axis in reversing]):
        while pool and now > target:
            base = with_changes(machine, chosen)
            say(f"tuning {len(pool)} changes beside {len(chosen)}")
            tried = [tuned(change, base, on) for change in pool]
            results = [_rms(change.applied(base), on) for change in tried]
            best = min(range(len(tried)), key=lambda i: results[i])
            if not results[best] < (1.0 - WORTH) * now:
                break
            change, pool = tried[best], [c for i, c in enumerate(pool) if i != best]
            if change.function != SET_BACK and (harm := _harm(change, base, elsewhere)):
                refused.append(Refused(change.setting.effect.name if change.setting else "friction", change.axis, harm))
                continue
            chosen.append(change)
            now = results[best]
            errors.append(now)
    return Chosen(tuple(chosen), tuple(errors), tuple(refused))


def _rms(machine: Machine, on: Sequence[Motionful]) -> float:
    found = [errors_of([machine], motion)[0] for motion in on]
    return math.sqrt(sum(math.inf if e is None else e.rms**2 for e in found) / len(found))


def _reversing(machine: Machine, motion: Motionful) -> list[str]:
    """Axes with an error after a reversal on a motion."""
    error = errors_of([machine], motion)[0]
    return [] if error is None else [axis for axis, peak in error.peaks.items() if peak > 0.0]


def _harm(change: Change, base: Machine, elsewhere: Sequence[Motionful]) -> str:
    """Where a change makes the error larger than without it, in words; '' if nowhere."""
    for motion in elsewhere:
        for friction in (1.0, *FRICTIONS):
            machine = with_friction(base, change.axis, friction)
            without, with_it = errors_of([machine, change.applied(machine)], motion)
            if without is None or with_it is None or with_it.rms > NO_WORSE * without.rms:
                after = "unstable" if with_it is None else f"{with_it.rms * 1e6:.2f} um"
                before = "unstable" if without is None else f"{without.rms * 1e6:.2f} um"
                return f"on {motion.name} with {friction:.0%} of the friction it makes {before} to {after}: it helps at one feed only"
    return ""


def with_friction(machine: Machine, axis: str, factor: float) -> Machine:
    """The machine with the friction of an axis multiplied, its effects included."""
    if factor == 1.0:
        return machine
    settings = list(settings_of(machine))
    own = next((s for s in settings if s.axis == axis and s.effect.name == "coulomb_friction"), None)
    if own is None:
        return with_effects(machine, [*settings, Setting(EFFECTS["coulomb_friction"], axis, {"factor": factor})])
    return with_effects(machine, [replace(s, parameters={**s.parameters, "factor": s.size * factor}) if s is own else s for s in settings])
