"""Commanded against delivered effort: does the actuator make what it is asked for?

    delivered(t) = g commanded(t - d) + o        below a limit, at which the delivered effort stays while the command goes on

Where a drive records both (torque set point and torque, or current set point and current), this is a block by itself: inverter, torque constant,
saturation. g, d and o are fitted by least squares, d on a grid and then refined, on samples away from the limit. SI throughout.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from twin.machine.axis import Axis
from twin.recordings.campaign import MeasuredRun
from twin.recordings.least_squares import Fit, regress
from twin.recordings.trace import OTHER_UNITS, Trace

PAIRS = {"torque": "torque_setpoint", "current": "current_setpoint"}
"""Delivered effort -> the command it answers."""

LONGEST_S, LONGEST_SAMPLES = 0.05, 40
"""Delays up to the shorter of both are tried."""

CLUSTER_S = 0.1
FLAT, BEYOND, LEAST_SHARE = 0.02, 1.05, 0.002
"""A limit: the delivered effort stays within FLAT of its largest size while the law expects BEYOND times as much, for LEAST_SHARE of the samples or more."""

FOLLOWS = 0.5
"""A delivered effort of which the command leaves more than this share (RMS) is another quantity."""

SURE = 4.0
"""Standard deviations from which a gain off 1 or an offset is said."""

SMALL = 0.01
"""A gain this near to 1, and an offset below this share of the largest effort, are none."""


@dataclass(frozen=True)
class DeliveredEffort:
    """One axis: gain, delay [s] and offset [A, Nm] with the deviations of gain and offset; `left`: share of the delivered effort that the law leaves (RMS);
    `limit` [A, Nm] where it stays while more is asked, else None; `most_asked` is the largest command."""

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
        """Does the actuator not make what it is asked for?"""
        gain = abs(self.gain - 1.0) > max(SURE * self.gain_deviation, SMALL)
        offset = abs(self.offset) > max(SURE * self.offset_deviation, SMALL * self.largest)
        return gain or offset or self.limit is not None

    def text(self) -> str:
        """One line."""
        unit = OTHER_UNITS[self.effort]
        said = (
            f"delivered {self.effort} = {self.gain:.4g} (+-{1.96 * self.gain_deviation:.2g}) of the commanded, {self.delay_s * 1e3:.2f} ms late, "
            f"offset {self.offset:.3g} {unit}; {self.left:.1%} is left"
        )
        if self.limit is not None:
            said += f"; it stays at {self.limit:.4g} {unit} where up to {self.most_asked:.4g} {unit} are asked: a limit"
        return said + ("; look at inverter, torque constant and limits" if self.off else "")


def delivered_effort(axis: Axis, runs: Sequence[MeasuredRun]) -> DeliveredEffort | None:
    """Commanded against delivered effort of one axis; None where not both are recorded, or where they have nothing to do with each other."""
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
    """Fit of gain and offset on the used samples of each trace, and the delay [s] that leaves least; None with too few samples."""
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
    """The size at which the delivered effort stays while the law expects more, or None."""
    largest = float(np.abs(given).max())
    stays = (np.abs(given) > (1.0 - FLAT) * largest) & (np.abs(expected) > BEYOND * np.abs(given)) & (np.sign(expected) == np.sign(given))
    return largest if stays.sum() >= max(LEAST_SHARE * len(given), 5) else None
