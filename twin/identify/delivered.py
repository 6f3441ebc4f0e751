"""Compare the commanded with the delivered effort (torque or current) of a drive: gain, delay, offset and limit.

    delivered(t) = g commanded(t - d) + o        below a limit, at which the delivered effort stays while the command grows

A drive that records both (torque set point and torque, or current set point and current) shows inverter, torque constant and saturation
separately from the mechanics. g and o are fitted by least squares on samples away from the limit; d is searched on a grid and refined. SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from twin.estimate.regression import Fit, regress
from twin.machine.axis import Axis
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import OTHER_UNITS, Trace

PAIRS = {"torque": "torque_setpoint", "current": "current_setpoint"}
"""Delivered effort -> the command it answers."""

LONGEST_S, LONGEST_SAMPLES = 0.05, 40
"""Longest delay tried: the shorter of the two."""

CLUSTER_S = 0.1
FLAT, BEYOND, LEAST_SHARE = 0.02, 1.05, 0.002
"""A limit: for at least LEAST_SHARE of the samples the delivered effort is within FLAT of its largest size while the law predicts more than
BEYOND times as much."""

FOLLOWS = 0.5
"""If the law leaves more than this share (RMS) of the delivered effort, the two channels are different quantities and are not compared."""

SURE = 4.0
"""A gain off 1 or an offset is significant from this many standard deviations."""

SMALL = 0.01
"""Smaller deviations of the gain from 1 and smaller offsets (as share of the largest effort) are ignored."""


@dataclass(frozen=True)
class DeliveredEffort:
    """One axis: gain, delay [s] and offset [A, Nm] with standard deviations of gain and offset.

    `left`: residual as share of the delivered effort (RMS); `limit` [A, Nm]: saturation level or None; `most_asked`: largest command.
    """

    axis: str
    effort: str
    gain: float
    gain_deviation: float
    delay_s: float
    offset: float
    offset_deviation: float
    left: float
    limit: float | None
    most_asked: float
    largest: float

    @property
    def off(self) -> bool:
        """Does the delivered effort differ significantly from the command?"""
        gain = abs(self.gain - 1.0) > max(SURE * self.gain_deviation, SMALL)
        offset = abs(self.offset) > max(SURE * self.offset_deviation, SMALL * self.largest)
        return gain or offset or self.limit is not None

    def text(self) -> str:
        """One line."""
        unit = OTHER_UNITS[self.effort]
        said = (
            f"delivered {self.effort} = {self.gain:.4g} (+-{1.96 * self.gain_deviation:.2g}) of the command, {self.delay_s * 1e3:.2f} ms late, "
            f"offset {self.offset:.3g} {unit}; residual {self.left:.1%}"
        )
        if self.limit is not None:
            said += f"; limited to {self.limit:.4g} {unit} while up to {self.most_asked:.4g} {unit} are commanded"
        return said + ("; check inverter, torque constant and limits" if self.off else "")


def delivered_effort(axis: Axis, runs: Sequence[MeasuredRun]) -> DeliveredEffort | None:
    """Commanded against delivered effort of one axis; None if one of them is not recorded or they are unrelated."""
    for effort, command in PAIRS.items():
        traces = [r.trace for r in runs if r.trace.has(axis.name, effort) and r.trace.has(axis.name, command) and len(r.trace.time) > 20]
        traces = [t for t in traces if np.ptp(t.get(axis.name, effort)) > 0.0 and np.ptp(t.get(axis.name, command)) > 0.0]
        if traces and (found := _fitted(axis.name, effort, command, traces)) is not None:
            return found
    return None


def _fitted(axis: str, effort: str, command: str, traces: Sequence[Trace]) -> DeliveredEffort | None:
    given = np.concatenate([t.get(axis, effort) for t in traces])
    asked = np.concatenate([t.get(axis, command) for t in traces])
    everywhere = [np.ones(len(t.time), bool) for t in traces]
    first = _law(axis, effort, command, traces, everywhere)
    if first is None:
        return None
    fit, delay = first
    expected = [fit.values[0] * _late(t, t.get(axis, command), delay) + fit.values[1] for t in traces]
    limit = _limit(given, np.concatenate(expected))
    if limit is not None:
        free = [np.abs(t.get(axis, effort)) < (1.0 - FLAT) * limit for t in traces]
        again = _law(axis, effort, command, traces, free)
        fit, delay = again if again is not None else first
    share = float(np.sqrt(np.mean(fit.residual**2)) / max(float(np.std(given)), 1e-300))
    if not fit.seen[0] or share > FOLLOWS:
        return None
    return DeliveredEffort(
        axis, effort, float(fit.values[0]), float(fit.deviations[0]), delay, float(fit.values[1]), float(fit.deviations[1]), share, limit,
        float(np.abs(asked).max()), float(np.abs(given).max()),
    )  # fmt: skip


def _late(trace: Trace, values: np.ndarray, delay: float) -> np.ndarray:
    return np.interp(trace.time - delay, trace.time, values)


def _law(axis: str, effort: str, command: str, traces: Sequence[Trace], used: Sequence[np.ndarray]) -> tuple[Fit, float] | None:
    """Fit of gain and offset on the used samples of each trace, and the delay [s] with the smallest residual; None with too few samples."""
    step = traces[0].period
    longest = min(LONGEST_S, LONGEST_SAMPLES * step)
    kept = [u & (t.time - t.time[0] >= longest) for t, u in zip(traces, used)]
    y = np.concatenate([t.get(axis, effort)[k] for t, k in zip(traces, kept)])
    if len(y) < 10:
        return None

    def columns(delay: float) -> np.ndarray:
        late = np.concatenate([_late(t, t.get(axis, command), delay)[k] for t, k in zip(traces, kept)])
        return np.column_stack([late, np.ones(len(late))])

    def left(delay: float) -> float:
        x = columns(delay)
        scale = np.maximum(np.abs(x).max(axis=0), 1e-300)
        return float(np.mean((y - x / scale @ np.linalg.lstsq(x / scale, y, rcond=None)[0]) ** 2))

    grid = np.arange(0.0, longest + 0.5 * step, step)
    best = float(grid[int(np.argmin([left(d) for d in grid]))])
    refined = minimize_scalar(left, bounds=(max(best - step, 0.0), best + step), method="bounded", options={"xatol": 1e-3 * step})
    delay = float(refined.x) if refined.fun < left(best) else best
    pieces = [(1_000_000 * n + (t.time - t.time[0]) / CLUSTER_S).astype(int)[k] for n, (t, k) in enumerate(zip(traces, kept))]
    return regress(columns(delay), y, np.concatenate(pieces)), delay


def _limit(given: np.ndarray, expected: np.ndarray) -> float | None:
    """Saturation level of the delivered effort, or None."""
    largest = float(np.abs(given).max())
    stays = (np.abs(given) > (1.0 - FLAT) * largest) & (np.abs(expected) > BEYOND * np.abs(given)) & (np.sign(expected) == np.sign(given))
    return largest if stays.sum() >= max(LEAST_SHARE * len(given), 5) else None
