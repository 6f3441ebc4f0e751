"""Divide a campaign into training and held-out motion, and judge machines by their gap on the held-out part.

Held out are the last runs or, with too few runs, the last part of the motion of each axis. An identified machine must not be worse there
than the machine file that it started from: for each axis the best stage goes into the machine file. An axis whose loops would be unstable or whose gap
would grow keeps its values, with a finding.
"""

from collections.abc import Mapping, Sequence, Set
import copy
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np

from twin.errors import InputError, SimulationError
from twin.identify.axis_run import AxisRun, Runs
from twin.identify.check_recording import Finding
from twin.identify.drive_residuals import follows_recorded_path, position_is_informative
from twin.identify.rotary_pair import pair_of
from twin.machine.loops import loops_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import Job as PredictJob
from twin.simulation.gap import Prediction, SignalGap, gap_of, is_moving, predict_each
from twin.simulation.summary import listed

HELD_OUT_SHARE = 0.3
"""Share of the runs, or of the motion of an axis, that is held out; it is taken from the end."""

LEAST_SAMPLES = 20
"""Least number of held-out samples of a run; with fewer the whole run is used for training."""

Table = dict[str, dict[str, dict[str, float | str]]]


@dataclass(frozen=True)
class Division:
    """Runs and their training rows: `fitted[axis][run]` is (sample,) bool in the order of `runs`; the other rows are held out.

    `by_stretch`: axes whose last part of the motion is held out instead of whole runs.
    """

    runs: tuple[MeasuredRun, ...]
    fitted: Mapping[str, tuple[np.ndarray, ...]]
    by_stretch: tuple[str, ...]

    def training(self) -> list[int]:
        """Runs with training rows of at least one axis."""
        return [i for i in range(len(self.runs)) if any(rows[i].any() for rows in self.fitted.values())]

    def left_out_names(self) -> tuple[str, ...]:
        """Runs without training rows, and held-out stretches of motion, as printed."""
        names = [run.name for i, run in enumerate(self.runs) if i not in self.training()]
        return (*names, *([f"the last {100 * HELD_OUT_SHARE:.0f} % of the motion of {listed(self.by_stretch)}"] if self.by_stretch else []))

    def training_part(self, axis_runs: Runs) -> Runs:
        """The training part of the axis runs: all other rows are marked as limited; None without rows."""

        def part(run: AxisRun | None, rows: np.ndarray, period: float) -> AxisRun | None:
            if run is None or not rows.any():
                return None
            at = np.clip(np.rint(run.start / period).astype(int), 0, len(rows) - 1)
            return replace(run, limited=run.limited | ~rows[at])

        periods = [run.trace.period for run in self.runs]
        return {axis: [part(*one) for one in zip(seen, self.fitted[axis], periods)] for axis, seen in axis_runs.items()}

    def judged(self, axis: str) -> list[tuple[int, np.ndarray]]:
        """(run, (sample,) bool) of the held-out rows of an axis; all rows if nothing could be held out."""
        kept = [(i, ~rows) for i, rows in enumerate(self.fitted[axis]) if not rows.all()]
        return kept or [(i, rows.copy()) for i, rows in enumerate(self.fitted[axis])]


def divide_runs(machine: Machine, runs: Sequence[MeasuredRun]) -> Division:
    """Hold out whole runs if there are at least three, else the last part of each run's motion.

    The only run with a feedforward setting is never held out. An axis that would lose most of its motion has the last part held out instead.
    """
    count = max(int(HELD_OUT_SHARE * len(runs)), 1) if len(runs) >= 3 else 0
    training = list(runs)
    aside: set[str] = set()
    for run in reversed(runs):
        if len(aside) < count and sum(r.feedforward == run.feedforward for r in training) > 1:
            training = [r for r in training if r is not run]
            aside.add(run.name)
    fitted, by_stretch = {}, []
    for axis in machine.axes:
        moving = [is_moving(r.trace, axis) for r in runs]
        total = sum(int(m.sum()) for m in moving)
        kept = sum(int(m.sum()) for m, r in zip(moving, runs) if r.name not in aside)
        if len(runs) >= 3 and (kept >= 0.5 * total or total == 0):
            fitted[axis.name] = tuple(np.full(len(m), r.name not in aside) for m, r in zip(moving, runs))
        else:
            fitted[axis.name] = _stretch(moving)
            if not all(rows.all() for rows in fitted[axis.name]):
                by_stretch.append(axis.name)
    return Division(tuple(runs), fitted, tuple(by_stretch))


def all_fitted(machine: Machine, runs: Sequence[MeasuredRun]) -> Division:
    """Nothing held out."""
    return Division(tuple(runs), {name: tuple(np.ones(len(r.trace.time), bool) for r in runs) for name in machine.axis_names}, ())


def _stretch(moving: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Training rows of each run: all before the last HELD_OUT_SHARE of its motion."""
    out = []
    for m in moving:
        at = np.flatnonzero(m)
        last = int(HELD_OUT_SHARE * len(at))
        out.append(np.arange(len(m)) < at[len(at) - last] if last >= LEAST_SAMPLES else np.ones(len(m), bool))
    return tuple(out)


def gap_or_reason(machine: Machine, division: Division) -> Table | str:
    """Gap of a machine on held-out rows in the decoupled plant: axis -> signal -> RMS, RMS of noise alone, unit; or why the simulation failed."""
    asked = sorted({i for a in machine.axis_names for i, _ in division.judged(a)})
    try:
        predictions = dict(zip(asked, predict_each([PredictJob(machine, division.runs[i], engine=False) for i in asked])))
    except SimulationError as error:
        return " ".join(str(error).split())
    parts: dict[str, dict[str, list[tuple[SignalGap, int]]]] = {}
    for axis in machine.axes:
        for i, rows in division.judged(axis.name):
            run = division.runs[i]
            if rows.sum() < 3 or not is_moving(run.trace, axis)[rows].any():
                continue
            for signal, g in _of_rows(machine, run, predictions[i], axis.name, rows).items():
                parts.setdefault(axis.name, {}).setdefault(signal, []).append((g, int(rows.sum())))
    return {axis: {s: _mean_gap(own) for s, own in signals.items()} for axis, signals in parts.items()}


def _mean_gap(parts: Sequence[tuple[SignalGap, int]]) -> dict[str, float | str]:
    """RMS of the gap and of its noise over parts of so many rows."""
    gaps, weights = zip(*parts)
    rms, noise = (math.sqrt(np.average([v**2 for v in values], weights=weights)) for values in zip(*((g.rms, g.noise) for g in gaps)))
    return {"rms": rms, "noise": noise, "unit": gaps[0].unit}


def _of_rows(machine: Machine, run: MeasuredRun, prediction: Prediction, axis: str, rows: np.ndarray) -> dict[str, SignalGap]:
    """Gap of one axis on some rows of a run."""
    if rows.all():
        return gap_of(machine, run, prediction).get(axis, {})
    # one row more on each side would be needed for speeds: the set point's speed is taken before the rows are cut
    first, last = int(np.flatnonzero(rows)[0]), int(np.flatnonzero(rows)[-1]) + 1
    part = slice(first, last)
    predicted = Prediction(prediction.trace.samples(part), {k: v[part] for k, v in prediction.scatter.items()}, prediction.error)
    return gap_of(machine, replace(run, trace=run.trace.samples(part)), predicted).get(axis, {})


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
    pair = rotary.axes if (rotary := pair_of(before)) else ()

    def grown(axis: str, table: Table) -> float:
        judging = position_is_informative(before, axis, division.runs)
        if isinstance(start, str) or not (judging or follows_recorded_path(before.axis(axis), division.runs)):
            return 1.0  # an assumed controller makes this gap
        return ratio({s: g for s, g in table[axis].items() if judging or s == before.axis(axis).effort}, start.get(axis, {}))

    for group in [*([n] for n in names if n not in pair), *([list(pair)] if pair else [])]:
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
    """One machine: the table and effects of each axis from its stage, bodies from that of the rotary pair, everything else from the first."""
    if len(set(stage_of.values())) == 1 and len(stage_of) == len(before.axes):
        return stages[next(iter(stage_of.values()))]
    base = next(iter(stages.values())) if stage_of else before
    document = copy.deepcopy(dict(base.document))
    effects = [dict(e) for e in base.effects if e.get("axis") not in before.axis_names]
    for axis in before.axes:
        source = stages[stage_of[axis.name]] if axis.name in stage_of else before
        document["axis"][axis.name] = copy.deepcopy(source.document["axis"][axis.name])
        effects += [dict(e) for e in source.effects if e.get("axis") == axis.name]
    if before.bodies and (pair := pair_of(before)):
        source = stages[stage_of[pair.outer]] if pair.outer in stage_of else before
        document["body"] = copy.deepcopy(source.document["body"])
    if effects or "effect" in document:
        document["effect"] = effects
    return Machine(document, before.model_path, before.path)
