"""Measuring noise of each signal, from the parts of a campaign in which the axis stands still.

At standstill the control reacts to the encoder noise, so the current scatters by more than the noise of its sensor. A simulated standstill
with the machine file's noise shows this scatter, and its ratio to the measured one scales the file's value:
    noise = file's noise x measured scatter / simulated scatter         scatter: of differences from sample to sample
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

REST_S = 0.08
"""Shorter standstills are not used."""

SETTLE_S = 0.05
"""First part of each standstill that is not used, because the loop still settles."""

KEYS = {
    ("linear", "position"): "linear_scale_noise_m",
    ("rotary", "position"): "rotary_encoder_noise_deg",
    ("linear", "velocity"): "speed_noise_m_per_s",
    ("rotary", "velocity"): "speed_noise_deg_per_s",
}


def measured_noise(machine: Machine, runs: Sequence[MeasuredRun]) -> dict[str, float]:
    """Values for [measurement] by key, in file units; keys without standstill or signal are missing."""
    spread: dict[tuple[str, str], list[float]] = {}
    weight: dict[tuple[str, str], list[int]] = {}
    reference = _simulated_standstill(machine, runs[0].trace.period)
    for run in runs:
        for axis in machine.axes:
            for part in standstills(run.trace, axis):
                for signal in ("position", "velocity", "current"):
                    if run.trace.has(axis.name, signal) and reference.has(axis.name, signal):
                        ratio = _scatter(run.trace.get(axis.name, signal)[part]) / max(_scatter(reference.get(axis.name, signal)), 1e-15)
                        key = ("all" if signal == "current" else axis.kind, signal)
                        spread.setdefault(key, []).append(ratio**2)
                        weight.setdefault(key, []).append(part.stop - part.start)
    out = {}
    table = machine.document.get("measurement", {})
    for key, ratios in spread.items():
        name = "current_noise_a" if key[1] == "current" else KEYS[key]
        if table.get(name):
            out[name] = float(f"{table[name] * np.sqrt(np.average(ratios, weights=weight[key])):.4g}")
    return out


def standstills(trace: Trace, axis: Axis) -> list[slice]:
    """Sample ranges in which the set point of the axis stands still, without their first part."""
    if axis.name not in trace.axes:
        return []
    still = np.diff(trace.get(axis.name, "setpoint"), prepend=np.nan) == 0.0
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(int)))
    skip, least = round(SETTLE_S / trace.period), round(REST_S / trace.period)
    return [slice(a + skip, b) for a, b in zip(edges[::2], edges[1::2]) if b - a - skip >= least]


def _scatter(values: np.ndarray) -> float:
    return float(np.std(np.diff(values))) if len(values) > 2 else 0.0


def _simulated_standstill(machine: Machine, period: float) -> Trace:
    start = np.array([np.clip(0.0, *axis.travel) for axis in machine.axes])
    setpoints = Setpoints(np.tile(start, (round(1.0 / period), 1)), period)
    return simulate(machine, setpoints, sample_period=period, noise_seed=0).trace
