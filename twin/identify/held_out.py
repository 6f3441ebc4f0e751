"""What no fit sees: the last runs of a campaign, or the last stretch of motion of each axis where there are too few runs.

An identified machine is judged there: it must be no worse than the machine file that it started from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from twin.errors import SimulationError
from twin.identify.axis_run import AxisRun
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import Job as PredictJob
from twin.simulation.gap import Prediction, SignalGap, gap_of, is_moving, predict_each
from twin.simulation.setpoints import AT_REST

HELD_OUT_SHARE = 0.3
"""Share of the runs, the last ones, or of the motion of an axis, that no fit sees."""

LEAST_SAMPLES = 20
"""A run in which the motion left out would be shorter than this keeps it: too little to judge anything."""

Table = dict[str, dict[str, dict[str, float | str]]]


@dataclass(frozen=True)
class Division:
    """Runs with the rows that may be fitted: `fitted[axis][run]` is (sample,) bool in the order of `runs`; the rest judges.

    `by_stretch`: axes whose last stretch of motion is left out instead of whole runs.
    """

    runs: tuple[MeasuredRun, ...]
    fitted: Mapping[str, tuple[np.ndarray, ...]]
    by_stretch: tuple[str, ...]

    def training(self) -> list[int]:
        """Runs of which any axis is fitted on any row."""
        return [i for i in range(len(self.runs)) if any(rows[i].any() for rows in self.fitted.values())]

    def held_out(self) -> list[int]:
        """Runs of which no axis is fitted."""
        known = set(self.training())
        return [i for i in range(len(self.runs)) if i not in known]

    def part(self, axis_runs: Mapping[str, Sequence[AxisRun | None]], fitted: bool) -> dict[str, list[AxisRun | None]]:
        """The axis runs with the other rows marked as limited; None where no row is left."""
        out: dict[str, list[AxisRun | None]] = {}
        for axis, seen in axis_runs.items():
            out[axis] = []
            for i, run in enumerate(seen):
                rows = self.fitted[axis][i] if fitted else ~self.fitted[axis][i]
                if run is None or not rows.any():
                    out[axis].append(None)
                elif rows.all():
                    out[axis].append(run)
                else:
                    at = np.clip(np.rint(run.start / self.runs[i].trace.period).astype(int), 0, len(rows) - 1)
                    out[axis].append(replace(run, limited=run.limited | ~rows[at]))
        return out

    def judged(self, axis: str) -> list[tuple[int, np.ndarray]]:
        """(run, (sample,) bool) of the rows that judge an axis; all rows where nothing could be left out."""
        kept = [(i, ~rows) for i, rows in enumerate(self.fitted[axis]) if not rows.all()]
        return kept or [(i, rows.copy()) for i, rows in enumerate(self.fitted[axis])]


def divide_runs(machine: Machine, runs: Sequence[MeasuredRun]) -> Division:
    """Leave out whole runs where there are three or more, never the only one with a feedforward setting or most of an axis' motion."""
    count = max(int(HELD_OUT_SHARE * len(runs)), 1) if len(runs) >= 3 else 0
    training = list(runs)
    aside: set[str] = set()
    for run in reversed(runs):
        if len(aside) < count and sum(r.feedforward == run.feedforward for r in training) > 1:
            training = [r for r in training if r is not run]
            aside.add(run.name)
    fitted, by_stretch = {}, []
    for axis in machine.axes:
        moving = [is_moving(r.trace, axis) if axis.name in r.trace.axes else np.zeros(len(r.trace.time), bool) for r in runs]
        total = sum(int(m.sum()) for m in moving)
        kept = sum(int(m.sum()) for m, r in zip(moving, runs) if r.name not in aside)
        if len(runs) >= 3 and (kept >= 0.5 * total or total == 0):
            fitted[axis.name] = tuple(np.full(len(m), r.name not in aside) for m, r in zip(moving, runs))
        else:
            fitted[axis.name] = _stretch(moving)
            if not all(rows.all() for rows in fitted[axis.name]):
                by_stretch.append(axis.name)
    return Division(tuple(runs), fitted, tuple(by_stretch))


def _stretch(moving: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Rows of each run up to where the last share of its motion begins."""
    out = []
    for m in moving:
        at = np.flatnonzero(m)
        last = int(HELD_OUT_SHARE * len(at))
        out.append(np.arange(len(m)) < at[len(at) - last] if last >= LEAST_SAMPLES else np.ones(len(m), bool))
    return tuple(out)


def held_out_gap(machine: Machine, division: Division) -> Table:
    """Gap of a machine on the rows that judge it: axis -> signal -> RMS, RMS of noise alone, unit. Raises SimulationError where it diverges."""
    asked = sorted({i for a in machine.axis_names for i, _ in division.judged(a)})
    predictions = dict(zip(asked, predict_each([PredictJob(machine, division.runs[i]) for i in asked])))
    squares: dict[str, dict[str, list[tuple[float, float, int, str]]]] = {}
    for axis in machine.axes:
        for i, rows in division.judged(axis.name):
            run = division.runs[i]
            if axis.name not in run.trace.axes or rows.sum() < 3:
                continue
            if np.max(np.abs(np.gradient(run.trace.get(axis.name, "setpoint"), run.trace.period))[rows]) < AT_REST[axis.kind]:
                continue
            for signal, g in _of_rows(machine, run, predictions[i], axis.name, rows).items():
                squares.setdefault(axis.name, {}).setdefault(signal, []).append((g.rms, g.noise, int(rows.sum()), g.unit))
    return {
        axis: {
            s: {
                "rms": math.sqrt(np.average([v[0] ** 2 for v in values], weights=[v[2] for v in values])),
                "noise": math.sqrt(np.average([v[1] ** 2 for v in values], weights=[v[2] for v in values])),
                "unit": values[0][3],
            }
            for s, values in signals.items()
        }
        for axis, signals in squares.items()
    }


def _of_rows(machine: Machine, run: MeasuredRun, prediction: Prediction, axis: str, rows: np.ndarray) -> dict[str, SignalGap]:
    """Gap of one axis on some rows of a run."""
    if rows.all():
        return gap_of(machine, run, prediction).get(axis, {})
    # one row more on each side would be needed for speeds: the set point's speed is taken before the rows are cut
    first, last = int(np.flatnonzero(rows)[0]), int(np.flatnonzero(rows)[-1]) + 1
    part = slice(first, last)

    def cut(trace: Trace) -> Trace:
        return Trace(trace.time[part], {k: v[part] for k, v in trace.signals.items()}, trace.kinds)

    scatter = {k: v[part] for k, v in prediction.scatter.items()}
    return gap_of(machine, replace(run, trace=cut(run.trace)), Prediction(cut(prediction.trace), scatter)).get(axis, {})


def score(signals: Mapping[str, Mapping[str, float | str]]) -> float:
    """Geometric mean of gap over noise of the signals of one axis; infinite without signals."""
    ratios = [math.log(max(float(g["rms"]) / max(float(g["noise"]), 1e-12), 0.1)) for g in signals.values()]
    return math.exp(float(np.mean(ratios))) if ratios else math.inf


def gap_or_reason(machine: Machine, division: Division) -> Table | str:
    """The gap, or one line that says why there is none."""
    try:
        return held_out_gap(machine, division)
    except SimulationError as error:
        return " ".join(str(error).split())
