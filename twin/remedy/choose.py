"""The smallest set of changes that reaches a target: what was changed is set back before what is worn is compensated, the best change first,
until the goal is met or nothing helps further. What was too small beside the rest is tried once more when the rest is gone: a lead error of 0.6 um
does not show beside quadrants of 5 um, and is a third of what their pulses leave.

A change is kept only if it does no harm off the motion it was tuned on: at other feeds and radii, and with the friction of the machine 20 % higher
and lower. No change takes a current near its limit or a loop below the asked margins, and none is proposed that the control cannot hold. What is
refused is named with the numbers.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from twin.effects import EFFECTS, Setting, settings_of, with_effects
from twin.machine.check import LARGEST_SHARE, Asked
from twin.machine.machine import Machine
from twin.remedy.advice import BACKLASH, PULSE, SET_BACK, TABLE, advice_on
from twin.remedy.change import Change
from twin.remedy.control_data import CONTROLS, REFUSED, WITH_CHARACTERISTIC, entries_of
from twin.remedy.predict import Motionful, ToolError, errors_of, with_changes
from twin.remedy.tune_change import faster, tuned

WORTH = 0.02
"""Smallest share of the error that a further change must take away."""
FRICTIONS = (0.8, 1.2)
"""A change is also tried with these multiples of the machine's friction."""
NO_WORSE = 1.02
"""Largest error with a change over that without it, elsewhere; below is chance of the simulation."""


@dataclass(frozen=True)
class Refused:
    """An effect that no setting of the control cures, or a change that does harm, with the reason."""

    effect: str
    axis: str
    reason: str


@dataclass(frozen=True)
class Goal:
    """What is asked of the contour error [m]: its RMS, and its largest value."""

    rms: float
    largest: float = math.inf

    def met(self, error: ToolError) -> bool:
        """True if an error is within both."""
        return error.rms <= self.rms and error.largest <= self.largest


Calibrated = Collection[tuple[str, str, str | None]]
"""Effects by which a diagnosis corrected numbers that were only assumed or tried, by name, axis and driving axis: they are no faults."""


@dataclass(frozen=True)
class Task:
    """What is asked: a machine, the motion `on` which it is to reach the goal within the margins `asked`, and motions elsewhere that must not get worse.

    `control`: changes are those that it can hold.
    """

    machine: Machine
    on: Motionful
    elsewhere: Sequence[Motionful]
    goal: Goal
    asked: Asked
    control: str = CONTROLS[0]
    calibrated: Calibrated = ()


def faults_of(machine: Machine, calibrated: Calibrated = ()) -> list[Setting]:
    """The effects of a machine that are to be answered."""
    return [s for s in settings_of(machine) if s.key not in calibrated]


def candidates(machine: Machine, control: str = CONTROLS[0], calibrated: Calibrated = ()) -> tuple[list[Change], list[Refused]]:
    """Changes that answer the effects of a machine, and the effects that none answers. Settings of the control come first."""
    changes: list[Change] = []
    refused = []
    for setting in faults_of(machine, calibrated):
        advice = advice_on(setting.effect)
        functions = advice.functions(machine.axis(setting.axis).encoder)
        held = [function for function in functions if (function, control) not in REFUSED]
        if not held:
            reason = next((REFUSED[function, control] for function in functions), advice.refused or "no setting of the control answers it")
            refused.append(Refused(setting.effect.name, setting.axis, reason))
        for function in held:
            if (setting.axis, function) not in {(c.axis, c.function) for c in changes if function != SET_BACK}:
                changes.append(Change(setting.axis, function, setting))
    pulsed = {c.axis for c in changes if c.function == PULSE}
    if (PULSE, control) not in REFUSED:
        changes += [Change(a.name, PULSE) for a in machine.axes if a.name not in pulsed and a.coulomb_friction_nm > 0.0]
    return sorted(changes, key=lambda c: c.function != SET_BACK), refused


def choose(task: Task, say: Callable[[str], None] = lambda _text: None) -> tuple[list[Change], list[float], list[Refused]]:
    """Changes that bring the contour error to the goal, or as near as they can, the RMS error [m] before and after each, and what was refused."""
    machine, on, goal = task.machine, task.on, task.goal
    left, refused = candidates(machine, task.control, task.calibrated)
    chosen: list[Change] = []
    now = error_on(machine, on)
    left = [c for c in left if c.function != PULSE or now.peaks.get(c.axis, 0.0) > 0.0]
    errors = [now.rms]
    # what was changed, then what is displaced, then what is late, then what was too small beside the rest
    for functions in ((SET_BACK,), (TABLE, BACKLASH), (PULSE,), (SET_BACK, TABLE, BACKLASH)):
        if PULSE in functions and not goal.met(now):
            base = with_changes(machine, chosen)
            raised = faster(base, on, task.asked)
            steps = errors_of([with_changes(base, raised[: i + 1]) for i in range(len(raised))], on)
            if steps and steps[-1].rms < (1.0 - WORTH) * now.rms and not _harm(raised, base, task):
                errors += [error.rms for error in steps]
                chosen, now = [*chosen, *raised], steps[-1]
        pool = [c for c in left if c.function in functions]
        if goal.met(now) or not pool:
            continue
        base = with_changes(machine, chosen)
        say(f"tuning {len(pool)} changes beside {len(chosen)}")
        tried = [_held(tuned(change, base, [on]), base, task.control, refused) for change in pool]
        first = [error.rms for error in errors_of([change.applied(base) for change in tried], on)]
        for i in np.argsort(first, kind="stable"):
            if goal.met(now):
                break
            base, change = with_changes(machine, chosen), tried[i]
            if not error_on(change.applied(base), on).rms < (1.0 - WORTH) * now.rms:
                continue
            left.remove(pool[i])
            best, after, harm = _tried(change, base, task)
            if harm:
                refused.append(Refused(change.setting.effect.name if change.setting else "friction", change.axis, harm))
            elif after.rms < (1.0 - WORTH) * now.rms:
                chosen.append(best)
                now = after
                errors.append(now.rms)
    return chosen, errors, refused


def error_on(machine: Machine, on: Motionful) -> ToolError:
    """The error of a machine on a motion; an infinite one where the simulation diverges."""
    return errors_of([machine], on)[0]


def _held(change: Change, machine: Machine, control: str, refused: list[Refused]) -> Change:
    """A change as far as the control holds it: of a table whose wave needs too many points the line remains, and the wave is refused."""
    if change.function != TABLE or change.values["slope"] == 0.0 or not (reason := entries_of(change, machine, control).refused):
        return change
    if (wave := Refused("cyclic_error", change.axis, reason)) not in refused:
        refused.append(wave)
    return replace(change, values={**change.values, "sine": 0.0, "cosine": 0.0})


def _tried(change: Change, base: Machine, task: Task) -> tuple[Change, ToolError, str]:
    """A change, its error, and the harm that it does in words. A pulse that does harm at another feed gets a characteristic over acceleration."""
    harm = entries_of(change, base, task.control).refused or _harm([change], base, task)
    if harm and change.function == PULSE and task.control in WITH_CHARACTERISTIC:
        other = tuned(change, base, [task.on, *task.elsewhere], shaped=True)
        if not _harm([other], base, task):
            change, harm = other, ""
    return change, error_on(change.applied(base), task.on), harm


def _harm(changes: Sequence[Change], base: Machine, task: Task) -> str:
    """Where changes make the error larger than without them, come near a limit or fall below a margin, in words; '' if nowhere."""
    change = changes[0]
    if change.function == SET_BACK:
        missed = task.asked.missed_by(change.applied(base), change.axis) if _raises_a_gain(change.setting) else ""
        return f"with the commissioned values {missed}: tune the loops (twin tune)" if missed else ""
    frictions = (1.0, *FRICTIONS)
    machines = [with_friction(base, change.axis, friction) for friction in frictions]
    for motion in (task.on, *task.elsewhere):
        found = errors_of([*machines, *(with_changes(machine, changes) for machine in machines)], motion)
        for friction, without, with_it in zip(frictions, found, found[len(frictions) :]):
            if with_it.rms > NO_WORSE * without.rms:
                said = [f"{e.rms * 1e6:.2f} um" if math.isfinite(e.rms) else "unstable" for e in (without, with_it)]
                return f"on {motion.name} with {friction:.0%} of the friction it makes {said[0]} to {said[1]}: it helps at one feed only"
            for axis in (c.axis for c in changes):
                if (share := with_it.shares.get(axis, 0.0)) > max(LARGEST_SHARE, without.shares.get(axis, 0.0)):
                    return f"on {motion.name} the current of {axis} reaches {share:.0%} of its limit"
    return ""


def _raises_a_gain(setting: Setting | None) -> bool:
    """True if setting back a deviation makes a loop faster, which may cost margins."""
    if setting is None:
        return False
    faster = {"position_gain": setting.size < 1.0, "speed_gain": setting.size < 1.0, "speed_integral_time": setting.size > 1.0}
    return faster.get(setting.effect.name, False)


def with_friction(machine: Machine, axis: str, factor: float) -> Machine:
    """The machine with the friction of an axis multiplied, its effects included."""
    if factor == 1.0:
        return machine
    settings = list(settings_of(machine))
    own = next((s for s in settings if s.axis == axis and s.effect.name == "coulomb_friction"), None)
    if own is None:
        return with_effects(machine, [*settings, Setting(EFFECTS["coulomb_friction"], axis, {"factor": factor})])
    return with_effects(machine, [replace(s, parameters={**s.parameters, "factor": s.size * factor}) if s is own else s for s in settings])
