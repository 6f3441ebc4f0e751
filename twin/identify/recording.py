"""A recording before it is believed: every axis on the position cycles, flags of the feedforward checked, late channels taken back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.campaign import Campaign, MeasuredRun
from twin.identify.axis_run import AxisRun, axis_run
from twin.identify.direct import Runs
from twin.identify.findings import (
    LATE_S,
    Finding,
    Late,
    checked_flags,
    coverage,
    late_channels,
    missing_signals,
    shifted_setpoint,
    stuck_channels,
)
from twin.machine import Machine

LEFT_OUT_SHARE = 0.3
"""Share of the runs, the last ones, that no fit sees (none of fewer than three)."""


@dataclass(frozen=True)
class Recording:
    """Runs with checked flags, each axis of each run on the position cycles (None: no measured motion), findings, skew of each channel."""

    runs: list[MeasuredRun]
    axis_runs: dict[str, list[AxisRun | None]]
    findings: list[Finding]
    late: list[Late]

    def divided(self) -> tuple[list[MeasuredRun], list[MeasuredRun]]:
        """Runs to learn from, and the last ones to check on; the only run with a feedforward setting is never left out."""
        count = max(int(LEFT_OUT_SHARE * len(self.runs)), 1) if len(self.runs) >= 3 else 0
        training = list(self.runs)
        aside: list[MeasuredRun] = []
        for run in reversed(self.runs):
            if len(aside) < count and sum(r.feedforward == run.feedforward for r in training) > 1:
                training = [r for r in training if r is not run]
                aside.insert(0, run)
        return training, aside

    def part(self, runs: Sequence[MeasuredRun]) -> Runs:
        """The axis runs of some of the runs."""
        names = {r.name for r in runs}
        return {a: [x for x, r in zip(seen, self.runs) if r.name in names] for a, seen in self.axis_runs.items()}


def prepared(machine: Machine, campaign: Campaign) -> Recording:
    """Read a campaign: flags checked, late channels taken back, everything noticed on the way in `findings`."""
    runs = list(campaign.runs)
    findings = missing_signals(machine, runs) + [f for run in runs for f in stuck_channels(machine, run)]

    def read(lateness: dict[str, dict[str, float]]) -> dict[str, list[AxisRun | None]]:
        return {
            a.name: [axis_run(machine, a, r, lateness.get(a.name)) if a.name in r.trace.axes else None for r in runs] for a in machine.axes
        }

    axis_runs = read({})
    flags, said = checked_flags(machine, runs, axis_runs)
    findings += said
    runs = [replace(r, feedforward=f) for r, f in zip(runs, flags)]
    axis_runs = read({})
    late = _skew(machine, runs, axis_runs)
    correct: dict[str, dict[str, float]] = {}
    for _ in range(SKEW_ROUNDS):
        # a current that is late by odd samples shows another phase of its saw-tooth: what the first round leaves, the second finds
        late, more = late if not correct else _remaining(late, _skew(machine, runs, axis_runs), correct), False
        for item in late:
            if abs(item.seconds) > max(LATE_S[item.signal], 4.0 * item.deviation):
                taken = _whole(item.seconds, runs[0].trace.period)
                more |= correct.get(item.axis, {}).get(item.signal) != taken
                correct.setdefault(item.axis, {})[item.signal] = taken
        if not more:
            break
        axis_runs = read(correct)
    for item in late:
        if item.signal in correct.get(item.axis, {}):
            told = f"{item.signal} was recorded {item.seconds * 1e3:.3f} ms late (+-{1.96e3 * item.deviation:.3f} ms); taken back"
            findings.append(Finding("", item.axis, told))
    for axis in machine.axes:
        findings += coverage(machine, axis, [r for r in axis_runs[axis.name] if r is not None])
    return Recording(runs, axis_runs, findings, late)


SKEW_ROUNDS = 3
NEAR_SAMPLE = 0.2
"""A skew within this fraction of a period from whole samples is taken as whole samples: recorders are late by those."""


def _whole(seconds: float, period: float) -> float:
    samples = seconds / period
    return round(samples) * period if abs(samples - round(samples)) < NEAR_SAMPLE else seconds


def _remaining(before: Sequence[Late], now: Sequence[Late], correct: dict[str, dict[str, float]]) -> list[Late]:
    """Skews after a correction: what was taken back and what is left, where a correction was made."""
    left = {(c.axis, c.signal): c for c in now}
    out = []
    for item in before:
        taken = correct.get(item.axis, {}).get(item.signal)
        after = left.get((item.axis, item.signal))
        out.append(replace(item, seconds=taken + after.seconds, deviation=after.deviation) if taken is not None and after else item)
    return out


def _skew(machine: Machine, runs: Sequence[MeasuredRun], axis_runs: dict[str, list[AxisRun | None]]) -> list[Late]:
    """Skew of each channel over the runs: weighted mean, its deviation from their scatter."""
    out = []
    for axis in machine.axes:
        items: dict[str, list[Late]] = {}
        for run, seen in zip(runs, axis_runs[axis.name]):
            for late in late_channels(machine, axis, run, seen):
                items.setdefault(late.signal, []).append(late)
            if seen is not None and np.ptp(seen.axis_position) > 0.01 * axis.max_velocity:
                shift = shifted_setpoint(axis, seen, run.trace.period)
                items.setdefault("velocity_setpoint", []).append(Late(axis.name, "velocity_setpoint", shift, seen.cycle / 20.0))
        for signal, several in items.items():
            values = np.array([s.seconds for s in several])
            weights = 1.0 / np.array([max(s.deviation, 1e-6) for s in several]) ** 2
            mean = float(np.average(values, weights=weights))
            if signal == "velocity_setpoint":
                mean = float(np.median(values))
            scatter = float(np.sqrt(np.average((values - mean) ** 2, weights=weights) / max(len(values) - 1, 1)))
            out.append(Late(axis.name, signal, mean, max(scatter, float(weights.sum() ** -0.5))))
    return out
