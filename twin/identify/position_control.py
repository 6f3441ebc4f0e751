"""The position controller, read from its own signals: gain, feedforward weight and delays.

At the start t of every position cycle the control makes, from the set point s and the scale x that the trace holds,

    v* = Kv (s(t - d_pos) - x(t)) + a_v (s(t - d_ff) - s(t - d_ff - Tp)) / Tp

v* is recorded without noise and x as the control saw it, so the law holds to rounding and to whatever it does not contain.
The four unknowns follow by Gauss-Newton on the splines of the set points; a weight of its own for each run shows a wrong flag.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.identify.axis_run import AxisRun
from twin.machine.machine import Axis
from twin.recordings.least_squares import Fit, regress

NAMES = ("position_gain_per_s", "velocity_feedforward", "position_delay_s", "feedforward_delay_s")
ITERATIONS = 8

UNTOLD = 3.0
"""A gain within so many standard deviations of 0 is none."""

FLOOR = {"position_gain_per_s": 3e-5, "velocity_feedforward": 6e-7, "position_delay_s": 1.2e-8, "feedforward_delay_s": 4e-9}
"""What rounded columns and the splines of the set points leave, as a standard deviation: not random from sample to sample."""


@dataclass(frozen=True)
class PositionControl:
    """Values of NAMES with their fit, residual RMS of v* [axis units a second], and the feedforward weight of each run."""

    values: dict[str, float]
    deviations: dict[str, float]
    quantile: float
    condition: float
    residual_rms: float
    weight_by_run: dict[str, float]


def fit_position_control(axis: Axis, runs: Sequence[AxisRun]) -> PositionControl | None:
    """Gauss-Newton from the machine file's values; None where no run has scale and speed set point."""
    runs = [r for r in runs if r.speed_setpoint is not None and r.position is not None and np.ptp(r.angle) * axis.ratio > 1e-5]
    if not runs:
        return None
    loops = axis.loops
    x = np.array([loops.position_gain_per_s, loops.velocity_feedforward or 1.0, loops.position_delay_s, loops.feedforward_delay_s])
    on = [0.0 if r.feedforward == "off" else 1.0 for r in runs]
    fit: Fit | None = None
    for _ in range(ITERATIONS):
        rows, y, clusters = [], [], []
        for k, run in enumerate(runs):
            j, e = _linearised(run, axis, x, on[k])
            use = ~run.limited
            rows.append(j[use])
            y.append(e[use])
            clusters.append((run.strokes + 100_000 * k)[use])
        fit = regress(np.vstack(rows), np.concatenate(y), np.concatenate(clusters))
        x = x + fit.values
        if np.all(np.abs(fit.values) < 1e-9):
            break
    assert fit is not None
    if not np.all(np.isfinite(x)) or x[0] <= UNTOLD * fit.deviations[0]:
        return None  # a run of one speed tells no gain from a delay
    values = dict(zip(NAMES, x.tolist()))
    deviations = {n: float(np.hypot(d, FLOOR[n])) for n, d in zip(NAMES, fit.deviations)}
    return PositionControl(
        values, deviations, fit.quantile, fit.condition, float(np.sqrt(np.mean(fit.residual**2))), _weights(axis, runs, x)
    )


def _linearised(run: AxisRun, axis: Axis, x: np.ndarray, on: float) -> tuple[np.ndarray, np.ndarray]:
    """Columns (cycle, 4) of the four corrections and the residual of v* (cycle,), in axis units a second."""
    kv, a_v, d_pos, d_ff = x
    t, tp = run.start, run.cycle
    assert run.position is not None
    assert run.speed_setpoint is not None
    error = run.setpoint_at(t - d_pos) - run.position
    slope = (run.setpoint_at(t - d_ff) - run.setpoint_at(t - d_ff - tp)) / tp
    residual = run.speed_setpoint * axis.ratio - kv * error - on * a_v * slope
    moved = (run.setpoint(np.clip(t - d_pos, 0.0, run.end), 1)) * (t > d_pos)
    change = (run.setpoint(np.clip(t - d_ff, 0.0, run.end), 1) - run.setpoint(np.clip(t - d_ff - tp, 0.0, run.end), 1)) / tp
    return np.column_stack([error, on * slope, -kv * moved, -on * a_v * change]), residual


def _weights(axis: Axis, runs: Sequence[AxisRun], x: np.ndarray) -> dict[str, float]:
    """Feedforward weight of each run alone, the rest as found: about 0 or a_v; NaN where the axis hardly moves."""
    out = {}
    for run in runs:
        columns, residual = _linearised(run, axis, np.array([x[0], 0.0, x[2], x[3]]), 1.0)
        slope = columns[:, 1]
        power = float(slope @ slope)
        out[run.run] = float(slope @ residual / power) if power > 1e-3 * len(slope) * axis.max_velocity**2 * 1e-2 else float("nan")
    return out
