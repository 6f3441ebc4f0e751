"""Prepare a campaign for identification: drop unusable channels, check feedforward flags, correct late channels, resample to position cycles."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin.errors import InputError
from twin.identify.axis_run import Runs, axis_run
from twin.identify.check_recording import (
    LEAST_SKEW_S,
    Finding,
    channel_skews,
    checked_flags,
    coverage,
    missing_signals,
    setpoint_shift,
    unusable_channels,
)
from twin.machine.machine import Machine
from twin.recordings.campaign import COPY, Campaign, MeasuredRun, without_copies
from twin.recordings.skew import CERTAIN, Skew

SHORT_S = 0.5
"""A shorter run has no usable content below 20 Hz and is not used."""


@dataclass(frozen=True)
class Recording:
    """Runs with checked flags, their axes on the position cycles (None: no measured motion), findings, skew of each channel."""

    runs: list[MeasuredRun]
    axis_runs: Runs
    findings: list[Finding]
    skews: list[Skew]

    def without_current(self, axes: Iterable[str]) -> Recording:
        """The recording without the current of these axes."""
        changed = {a: [replace(r, current=None, current_ripple=None) if r else None for r in self.axis_runs[a]] for a in axes}
        return replace(self, axis_runs={**self.axis_runs, **changed})


def prepare_recording(machine: Machine, campaign: Campaign) -> Recording:
    """Read a campaign, check flags and correct late channels; `findings` lists all problems. Raises InputError without a usable run."""
    usable, findings = _usable(machine, campaign)
    findings += missing_signals(machine, usable)
    runs = usable
    correct: dict[str, dict[str, float]] = {}
    axis_runs = _axis_runs(machine, runs, {})
    skews: list[Skew] | None = None
    said: list[Finding] = []
    for _ in range(FLAG_ROUNDS):
        flags, said = checked_flags(machine, usable, axis_runs)
        if skews is not None and flags == [r.feedforward for r in runs]:
            break
        runs = [replace(r, feedforward=f) for r, f in zip(usable, flags)]
        skews, correct, axis_runs = _without_skew(machine, runs)
    findings += said
    for item in skews or ():
        if item.signal in correct.get(item.axis, {}):
            signal = machine.axis(item.axis).effort if item.signal == "current" else item.signal
            text = f"{signal} was recorded {item.seconds * 1e3:.3f} ms late (+-{1e3 * item.half:.3f} ms); corrected"
            findings.append(Finding(text, item.axis))
    for axis in machine.axes:
        seen = [r for r in axis_runs[axis.name] if r is not None]
        findings += [Finding(text, axis.name) for text in coverage(axis, seen)]
    return Recording(runs, axis_runs, findings, skews or [])


FLAG_ROUNDS = 2
"""Rounds of flag check and skew correction. They depend on each other: a late channel looks like another feedforward and vice versa."""


def _usable(machine: Machine, campaign: Campaign) -> tuple[list[MeasuredRun], list[Finding]]:
    """The runs that are long enough, without unusable channels, and a finding for each excluded run or channel."""
    campaign, copies = without_copies(campaign)
    runs, findings = [], [Finding(COPY.format(original=original), "", copy) for copy, original in copies.items()]
    for run in campaign.runs:
        length = float(run.trace.time[-1] - run.trace.time[0])
        if length < SHORT_S:
            findings.append(Finding(f"only {length:.3g} s long: not used; record at least {SHORT_S:g} s", "", run.name))
            continue
        unusable = unusable_channels(machine, run)
        findings += unusable.values()
        signals = {key: values for key, values in run.trace.signals.items() if key not in unusable}
        runs.append(replace(run, trace=replace(run.trace, signals=signals)))
    if not runs:
        raise InputError(f"{campaign.path}: no run is longer than {SHORT_S:g} s; record whole moves ('twin plan' proposes some)")
    return runs, findings


def _axis_runs(machine: Machine, runs: Sequence[MeasuredRun], lateness: dict[str, dict[str, float]]) -> Runs:
    return {a.name: [axis_run(machine, a, r, lateness.get(a.name)) if a.name in r.trace.axes else None for r in runs] for a in machine.axes}


def _without_skew(machine: Machine, runs: Sequence[MeasuredRun]) -> tuple[list[Skew], dict[str, dict[str, float]], Runs]:
    """Skew of each channel, applied correction by axis and signal [s], and the corrected axis runs."""
    correct: dict[str, dict[str, float]] = {}
    skews: dict[tuple[str, str], Skew] = {}
    axis_runs, once = _axis_runs(machine, runs, {}), runs[0].trace.period > 0.75 * machine.position_cycle
    for _ in range(SKEW_ROUNDS):
        # A current that is late by an odd number of samples has another phase of the saw-tooth, and a late motor angle makes all other
        # channels look late. Further rounds correct the remaining error.
        for left in _mean_skews(machine, axis_runs):
            taken = correct.get(left.axis, {}).get(left.signal, 0.0)
            skews[left.axis, left.signal] = replace(left, seconds=taken + left.seconds)
        before, correct = correct, {}
        for item in skews.values():
            # a command is ahead of the motion by the lag of what it drives; one sample a cycle of the control, or fewer, show no time between them
            command = item.signal == "current" and not machine.axis(item.axis).actuator.winding
            late = item.seconds if command else abs(item.seconds)
            between = max(machine.position_cycle, runs[0].trace.period)
            if late > max(between if command and once else LEAST_SKEW_S[item.signal], CERTAIN * item.deviation):
                samples = item.seconds / runs[0].trace.period
                whole = abs(samples - round(samples)) < NEAR_SAMPLE
                correct.setdefault(item.axis, {})[item.signal] = runs[0].trace.period * (round(samples) if whole else samples)
        if correct == before:
            break
        axis_runs = _axis_runs(machine, runs, correct)
    return list(skews.values()), correct, axis_runs


SKEW_ROUNDS = 3
NEAR_SAMPLE = 0.2
"""A skew within this fraction of a period from a whole number of samples is rounded to it: recorders delay by whole samples."""


def _mean_skews(machine: Machine, axis_runs: Runs) -> list[Skew]:
    """Skew of each channel: weighted mean over the runs, its standard deviation from their scatter."""
    out = []
    for axis in machine.axes:
        items: dict[str, list[Skew]] = {}
        for seen in axis_runs[axis.name]:
            for skew in channel_skews(machine, axis, seen):
                items.setdefault(skew.signal, []).append(skew)
            if seen is not None and seen.speed_setpoint is not None and np.ptp(seen.axis_position) > 0.01 * axis.max_velocity:
                shift = setpoint_shift(axis, seen)
                items.setdefault("velocity_setpoint", []).append(Skew(axis.name, "velocity_setpoint", shift, seen.cycle / 20.0))
        for signal, several in items.items():
            values = np.array([s.seconds for s in several])
            weights = 1.0 / np.array([max(s.deviation, 1e-6) for s in several]) ** 2
            mean = float(np.median(values) if signal == "velocity_setpoint" else np.average(values, weights=weights))
            scatter = float(np.sqrt(np.average((values - mean) ** 2, weights=weights) / max(len(values) - 1, 1)))
            out.append(Skew(axis.name, signal, mean, max(scatter, float(weights.sum() ** -0.5))))
    return out
