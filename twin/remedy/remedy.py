"""A remedy: from a diagnosis or a corrected machine to changes, their predicted benefit, and what no setting cures."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any

import numpy as np

from twin.control.block import BLOCKS
from twin.control.number import unit_of_key
from twin.documents import read_json
from twin.effects import settings_of, with_effects
from twin.effects.readable import readable
from twin.effects.setting import key_in
from twin.errors import InputError, TwinError
from twin.estimate.regression import NORMAL_95
from twin.machine.check import Asked
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.remedy.advice import ADVICE, BACKLASH, GAIN, OFFSET, SET_BACK, TABLE, advice_on
from twin.remedy.change import Change
from twin.remedy.choose import Calibrated, Refused, Task, choose, error_on, faults_of
from twin.remedy.predict import ToolError, drawn, errors_of, simulated, slowed, tool_error, with_changes
from twin.remedy.tune import mode_needed
from twin.units import AXIS_UNITS, in_words

OVERRIDES = (0.9, 0.75, 0.5, 0.3)
"""Shares of the feed that are tried where the changes do not reach the goal. Friction may make a slower feed worse, so each is simulated."""

Deviations = Mapping[tuple[str, str, str | None], Mapping[str, float]]
"""Standard deviations of the sizes of effects, by effect and parameter [SI]."""


@dataclass(frozen=True)
class Remedy:
    """A chosen remedy, judged in MuJoCo on the motion that was asked for.

    changes       in their order
    errors        RMS contour error [m] before and after each change, on the decoupled plant
    alone         error with only this change, by change; None if the machine diverges with it
    low, high     2.5 % and 97.5 % of the error after all changes, over machines drawn from the intervals of the diagnosis
    runs          the simulated motion before and after
    faultless     RMS contour error [m] that the machine has without its faults, where the changes do not reach the goal; 0 where they do
    slower        the last resort, where the changes do not reach the goal: shares of the feed that were tried, and the errors after the changes
    """

    task: Task
    remedied: Machine
    changes: Sequence[Change]
    errors: Sequence[float]
    refused: Sequence[Refused]
    before: ToolError
    after: ToolError
    alone: Sequence[ToolError | None]
    low: float
    high: float
    runs: Mapping[str, Trace]
    slower: Sequence[tuple[float, ToolError]]
    faultless: float = 0.0

    @property
    def duration(self) -> float:
        """Time of the motion [s]."""
        return self.task.on.setpoints.duration

    @property
    def override(self) -> tuple[float, ToolError] | None:
        """The largest share of the feed that reaches the goal after the changes; None if no tried share does."""
        return next(((share, error) for share, error in self.slower if self.task.goal.met(error)), None)


def remedy(task: Task, deviations: Deviations, say: Callable[[str], None] = lambda _text: None) -> Remedy:
    """The remedy of a machine with effects on a motion. Changes are tuned there, and kept where none of the motions elsewhere gets worse."""
    machine, on, goal = task.machine, task.on, task.goal
    changes, errors, refused = choose(task, say)
    remedied = with_changes(machine, changes)
    say("predicting in MuJoCo")
    variants = [machine, remedied, *(change.applied(machine) for change in changes)]
    found = simulated(variants, on, lambda trace, own: (tool_error(trace, own), trace), engine=True)
    runs = [one for one in found[:2] if not isinstance(one, TwinError)]
    if len(runs) < 2:
        raise ArithmeticError("a machine that ran on the decoupled plant diverges in MuJoCo")
    (before, _), (after, _) = runs
    low, high = after.rms, after.rms
    if deviations:
        say("predicting with the intervals of the diagnosis")
        others = [with_changes(m, changes) for m in drawn(machine, deviations)]
        # the decoupled plant differs from MuJoCo by a constant; its scatter is what counts
        low, high = _spread(after.rms, errors_of(others, on))
    slower: list[tuple[float, ToolError]] = []
    faultless = 0.0
    if not goal.met(after):
        faults = {s.key for s in faults_of(machine, task.calibrated)}
        faultless = error_on(with_effects(machine, [s for s in settings_of(machine) if s.key not in faults]), on).rms
        say("trying a slower feed")
        for share in OVERRIDES:
            slower.append((share, error_on(remedied, slowed(on, machine, share))))
            if goal.met(slower[-1][1]):
                break
    alone = [None if isinstance(one, TwinError) else one[0] for one in found[2:]]
    both = {"before": runs[0][1], "after": runs[1][1]}
    return Remedy(task, remedied, changes, errors, refused, before, after, alone, low, high, both, slower, faultless)


def _spread(value: float, errors: Sequence[ToolError]) -> tuple[float, float]:
    found = np.array([e.rms for e in errors if math.isfinite(e.rms)])
    if len(found) < 3:
        return 0.0, math.inf
    half = NORMAL_95 * float(np.std(found, ddof=1))
    return max(value - half, 0.0), value + half


def remedy_document(found: Remedy) -> dict[str, Any]:
    """Content of `remedy.json`: um RMS at the tool point on the motion asked for."""
    return {
        "motion": found.task.on.name,
        "unit": "um RMS at the tool point",
        "target_um": 1e6 * found.task.goal.rms,
        "tolerance_um": 1e6 * found.task.goal.largest if math.isfinite(found.task.goal.largest) else None,
        "before": 1e6 * found.before.rms,
        "after": 1e6 * found.after.rms,
        "low": 1e6 * found.low,
        "high": 1e6 * found.high if math.isfinite(found.high) else None,
        "largest": {"before": 1e6 * found.before.largest, "after": 1e6 * found.after.largest},
        "duration_s": found.duration,
        "slower": [
            {"override": share, "rms": 1e6 * e.rms, "largest": 1e6 * e.largest, "more_s": found.duration * (1.0 / share - 1.0)}
            for share, e in found.slower
            if math.isfinite(e.rms)
        ],
        "quadrant_peaks": {
            axis: {"before": to * before, "after": to * found.after.peaks[axis], "unit": unit}
            for axis, before in found.before.peaks.items()
            for unit, to in [AXIS_UNITS[found.task.machine.axis(axis).kind].error]
            if before > 0.0
        },
        "changes": [_change(found, i) for i in range(len(found.changes))],
        "refused": [{"effect": r.effect, "axis": r.axis, "reason": r.reason} for r in found.refused],
        "at_the_machine": [{"effect": s.effect.name, "axis": s.axis, "do": advice_on(s.effect).machine} for s in faults_of(found.task.machine, found.task.calibrated) if advice_on(s.effect).machine],
    }  # fmt: skip


def _change(found: Remedy, i: int) -> dict[str, Any]:
    change = found.changes[i]
    advice = advice_on(change.setting.effect) if change.setting else ADVICE[GAIN if change.function == GAIN else "coulomb_friction"]
    offset = OFFSET if change.function == BACKLASH else ""
    worse = (advice.worse, offset, late_wave(change, found.remedied), _mode(change, found.remedied, found.task.asked))
    return {
        "axis": change.axis,
        "function": change.function,
        "effect": change.setting.effect.name if change.setting else None,
        "parameters": change.table(found.task.machine),
        "before": 1e6 * found.errors[i],
        "after": 1e6 * found.errors[i + 1],
        "alone": None if (alone := found.alone[i]) is None else 1e6 * alone.rms,
        "worse": [text for text in worse if text],
        "grade": advice.grade,
    }


def late_wave(change: Change, machine: Machine) -> str:
    """The feed at which a table removes half of its wave, in words; '' for a change without a wave. The position loop leaves w / sqrt(w^2 + Kv^2) of a wave w."""
    if change.function != TABLE or math.hypot(change.values["sine"], change.values["cosine"]) == 0.0:
        return ""
    axis = machine.axis(change.axis)
    unit, to = AXIS_UNITS[axis.kind].speed
    half = axis.loops.position_gain_per_s / math.sqrt(3.0) * change.values["wavelength"] / (2.0 * math.pi)
    return f"the table acts through the position gain: above {60.0 * to * half:.3g} {unit.removesuffix('/s')}/min more than half of the wave is left; a higher position gain leaves less (twin tune)"


def _mode(change: Change, machine: Machine, asked: Asked) -> str:
    """What a raised position gain needs of the mechanics in its loop; '' for another change, or where the machine file holds the first mode."""
    axis = machine.axis(change.axis)
    needed = mode_needed(machine, axis, asked) if change.function == GAIN and axis.encoder == "scale" else None
    return f"needs a first mode of the drive train above {needed:.0f} Hz to keep half of the margins: measure it first" if needed else ""


def sentence(found: Remedy, change: Change) -> str:
    """A change in words: what to set, with numbers and units."""
    if change.function == SET_BACK and change.setting is not None:
        return f"{change.axis}: set back what the diagnosis calls {in_words(change.setting.effect.name)} to its commissioned value"
    if change.function == GAIN:
        gain = found.task.machine.axis(change.axis).loops.position_gain_per_s
        return f"{change.axis}: raise the position gain from {gain:.4g} to {change.values['position_gain_per_s']:.4g} 1/s"
    kind, table = found.task.machine.axis(change.axis).kind, change.table(found.task.machine)
    keys = {n.key(kind): in_words(n.name) for n in BLOCKS[change.function].numbers}
    numbers = ", ".join(f"{keys[key]} {readable(value, unit_of_key(key))}" for key, value in table.items())
    return f"{change.axis}: {in_words(change.function)} ({numbers})"


def refusals(found: Sequence[Refused]) -> list[str]:
    """The refused effects as sentences."""
    return [f"{r.axis}: {in_words(r.effect)}: {r.reason}" for r in found]


def machine_file_of(source: Path) -> tuple[Path, Mapping[str, Any]]:
    """(machine file with effects, document of the diagnosis or empty). Raises InputError for anything else."""
    if source.suffix.lower() == ".toml" and source.is_file():
        return source, {}
    document = source / "diagnosis.json" if source.is_dir() else source
    if not document.is_file() or document.suffix.lower() != ".json":
        raise InputError(f"{source}: no diagnosis there; give its folder, its diagnosis.json, or a machine file (.toml)")
    machine = document.parent / "machine.toml"
    if not machine.is_file():
        raise InputError(f"{document.parent}: the corrected machine.toml is missing; diagnose again")
    return machine, read_json(document)


def calibrated_in(document: Mapping[str, Any]) -> Calibrated:
    """The effects of a diagnosis that stand for numbers which the machine file had only assumed or tried."""
    return {key_in(one) for one in document.get("calibrated", [])}


def deviations_of(document: Mapping[str, Any]) -> Deviations:
    """Standard deviations of the parameters of the effects of a diagnosis, from their 95 % intervals."""
    out: dict[tuple[str, str, str | None], dict[str, float]] = {}
    for effect in document.get("effects", []):
        own = {
            name: (p["high"] - p["low"]) / (2.0 * NORMAL_95)
            for name, p in effect.get("parameters", {}).items()
            if isinstance(p.get("low"), int | float) and isinstance(p.get("high"), int | float)
        }
        out[key_in(effect)] = own
    return out
