"""Choose for each axis which identified values go into the machine file: the best stage, never worse than the file before.

The criterion is the gap on held-out motion. An axis whose loops would be unstable or whose gap would grow keeps its values, with a finding.
"""

from collections.abc import Mapping, Sequence, Set
import copy
from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from twin.errors import InputError, SimulationError
from twin.identify.check_recording import Finding
from twin.identify.drive_residuals import follows_recorded_path, position_is_informative
from twin.identify.held_out import Division, Table
from twin.machine.loops import loops_of
from twin.machine.machine import Machine

GROWN_GAP = 1.02
"""A gap has grown if it is larger than before by this factor."""


@dataclass(frozen=True)
class Choice:
    """The machine to write, findings, notes, and the reason why nothing is to be written ('' if the machine is to be written)."""

    machine: Machine
    findings: Sequence[Finding] = ()
    notes: Sequence[Finding] = ()
    refused: str = ""
    stage_of: Mapping[str, str] | None = None  # axis -> stage of its values; a missing axis keeps the file before


def ratio(after: Mapping[str, Mapping[str, Any]], before: Mapping[str, Mapping[str, Any]]) -> float:
    """Geometric mean over the signals of one axis: gap after over gap before, both at least the noise."""
    logs = []
    for signal in after.keys() & before.keys():
        a, b = after[signal], before[signal]
        floor = max(min(float(a["noise"]), float(b["noise"])), 1e-12)
        logs.append(math.log(max(float(a["rms"]), floor) / max(float(b["rms"]), floor)))
    return math.exp(float(np.mean(logs))) if logs else math.inf


def unstable_loops(machine: Machine) -> dict[str, str]:
    """Axis -> the first of its loops that is unstable."""
    out: dict[str, str] = {}
    for axis in machine.axes:
        try:
            for loop in loops_of(machine, axis):
                if not loop.is_stable:
                    out[axis.name] = loop.name
                    break
        except (InputError, SimulationError, ValueError, np.linalg.LinAlgError):
            continue
    return out


def choose_stages(
    before: Machine, stages: Mapping[str, Machine], tables: Mapping[str, Table | str], division: Division, agreeing: Set[str]
) -> Choice:
    """The best stage of each axis. `stages`: in order of preference for ties; `tables`: gaps of the stages and of 'before'; `agreeing`: axes
    whose values in the file before lie in the identified intervals."""
    start = tables["before"]
    known = {name: table for name, table in tables.items() if not isinstance(table, str)}
    failed = [reason for reason in tables.values() if isinstance(reason, str)]
    moving = {axis for table in known.values() for axis in table}
    unstable_before = unstable_loops(before)
    unstable = {name: {a: loop for a, loop in unstable_loops(m).items() if a not in unstable_before} for name, m in stages.items()}
    findings, notes = list[Finding](), list[Finding]()
    best: dict[str, str] = {}
    names = list(before.axis_names)
    pair = [n for n in names if n in ("A", "C") and before.bodies]

    def grown(axis: str, table: Table) -> float:
        judging = position_is_informative(before.axis(axis), division.runs)
        if isinstance(start, str) or not (judging or follows_recorded_path(before.axis(axis), division.runs)):
            return 1.0  # an assumed controller makes this gap
        return ratio({s: g for s, g in table[axis].items() if judging or s == before.axis(axis).effort}, start.get(axis, {}))

    for group in [*([n] for n in names if n not in pair), *([pair] if pair else [])]:
        scores = {}
        for name, table in known.items():
            seen = [a for a in group if a in table]
            if name != "before" and seen and not any(a in unstable[name] for a in group):
                scores[name] = math.exp(float(np.mean([math.log(grown(a, table)) for a in seen])))
        good = {name: s for name, s in scores.items() if s <= GROWN_GAP}
        if good:
            best |= dict.fromkeys(group, min(good, key=lambda name: good[name] * (1.0 if name != "refined" else 1.0 / GROWN_GAP)))
            continue
        notes += [
            Finding("the values of the file before stay; they agree with the recording, each lies in its identified interval", a)
            for a in group
            if a in agreeing
        ]
        for axis in (a for a in group if a in moving and a not in agreeing):
            why = sorted({f"the {s[axis]} loop would be unstable" for s in unstable.values() if axis in s})
            why += [f"the gap on held-out motion would be {min(scores.values()):.3g} times as large"] if scores else []
            findings.append(
                Finding(f"keeps the values of the file before: {'; '.join(why or failed or ['no signal to judge it by'])}", axis)
            )
    if isinstance(start, str):
        findings.append(Finding(f"the machine file before cannot follow the recorded set points ({start})"))
    # an axis that could not be judged is no reason to refuse, because no gap is known to grow
    if not best and stages and (moving or failed) and not (moving and moving <= agreeing):
        reasons = "; ".join(map(str, findings)) or (failed or ["no axis moves in the held-out motion"])[0]
        said = f"no machine file is written: no identified value is better than the file before ({reasons})"
        return Choice(before, findings, notes, said, {})
    stage_of = {**{a: next(iter(stages)) for a in names if a not in moving}, **best}
    return Choice(_assembled(before, stages, stage_of), findings, notes, "", stage_of)


def _assembled(before: Machine, stages: Mapping[str, Machine], stage_of: Mapping[str, str]) -> Machine:
    """One machine: the table, effects and bodies of each axis from its stage, everything else from the first stage."""
    if len(set(stage_of.values())) == 1 and len(stage_of) == len(before.axes):
        return stages[next(iter(stage_of.values()))]
    base = next(iter(stages.values())) if stage_of else before
    document = copy.deepcopy(dict(base.document))
    effects = [dict(e) for e in base.effects if e.get("axis") not in before.axis_names]
    for axis in before.axes:
        source = stages[stage_of[axis.name]] if axis.name in stage_of else before
        document["axis"][axis.name] = copy.deepcopy(source.document["axis"][axis.name])
        effects += [dict(e) for e in source.effects if e.get("axis") == axis.name]
    if before.bodies and "A" in before.axis_names:
        source = stages[stage_of["A"]] if "A" in stage_of else before
        document["body"] = copy.deepcopy(source.document["body"])
    if effects or "effect" in document:
        document["effect"] = effects
    return Machine(document, before.model_path, before.path)
