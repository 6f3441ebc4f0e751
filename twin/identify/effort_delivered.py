"""Compare the commanded with the delivered effort (torque or current) of a drive: gain, delay, offset and limit.

    delivered(t) = g commanded(t - d) + o        below a limit; there the delivered effort stays while the command grows

A drive that records both (torque set point and torque, or current set point and current) shows inverter, torque constant and saturation
separately from the mechanics. g and o are fitted by least squares on samples away from the limit; d is searched on a grid and refined. SI.

Noise in the set point would make g too small, so both signals are compared below BAND_HZ. The samples show a current and its set point at fixed
phases of the position cycle, between which both move: even a faultless drive then shows g below 1. What counts is therefore the
difference from g and o of the twin in the same runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.optimize import minimize_scalar

from twin.estimate.regression import NORMAL_95, Fit, regress, solved
from twin.identify.axis_run import BAND_HZ
from twin.machine.axis import Axis
from twin.recordings.campaign import MeasuredRun
from twin.recordings.relations import low_passed
from twin.recordings.trace import OTHER_UNITS

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
    """One axis: fit of gain and offset [A, Nm], and delay [s].

    `left`: residual as share of the delivered effort (RMS); `limit` [A, Nm]: saturation level or None; `most_asked`: largest command; `twin`:
    the same fit of the twin's signals, None for an actuator that delivers what it is asked.
    """

    effort: str
    fit: Fit
    delay_s: float
    left: float
    limit: float | None
    most_asked: float
    largest: float
    twin: Fit | None = None

    @property
    def off(self) -> bool:
        """Does the delivered effort differ significantly from that of a faultless drive?"""
        usual, deviations = np.array([1.0, 0.0]), self.fit.deviations
        if self.twin is not None:
            usual, deviations = self.twin.values, np.hypot(deviations, self.twin.deviations)
        apart = np.abs(self.fit.values - usual) > np.maximum(SURE * deviations, SMALL * np.array([1.0, self.largest]))
        return bool(apart.any()) or self.limit is not None

    def beside(self, twin: DeliveredEffort | None) -> DeliveredEffort:
        """The same beside the twin's."""
        return self if twin is None else replace(self, twin=twin.fit)

    def text(self) -> str:
        """One line."""
        unit, (gain, offset) = OTHER_UNITS[self.effort], self.fit.values
        usual = "" if self.twin is None else f" (a faultless drive, sampled alike: {self.twin.values[0]:.4g})"
        said = (
            f"delivered {self.effort} = {gain:.4g} (+-{NORMAL_95 * self.fit.deviations[0]:.2g}) of the command{usual}, {self.delay_s * 1e3:.2f} ms late, "
            f"offset {offset:.3g} {unit}; residual {self.left:.1%}"
        )
        if self.limit is not None:
            said += f"; limited to {self.limit:.4g} {unit} while up to {self.most_asked:.4g} {unit} are commanded"
        return said + ("; check inverter, torque constant and limits" if self.off else "")


def delivered_effort(axis: Axis, runs: Sequence[MeasuredRun]) -> DeliveredEffort | None:
    """Commanded against delivered effort of one axis; None if one of them is not recorded or they are unrelated."""
    for effort, command in PAIRS.items():
        traces = [r.trace for r in runs if r.trace.has(axis.name, effort) and r.trace.has(axis.name, command) and len(r.trace.time) > 20]
        records = [_Record(t.time - t.time[0], t.get(axis.name, command), t.get(axis.name, effort)) for t in traces]
        records = [r for r in records if np.ptp(r.given) > 0.0 and np.ptp(r.asked) > 0.0]
        if records and (found := _fitted(effort, records, traces[0].period)) is not None:
            return found
    return None


class _Record(NamedTuple):
    """One run (sample,): time from its start [s], commanded and delivered effort."""

    time: np.ndarray
    asked: np.ndarray
    given: np.ndarray

    def late(self, delay: float) -> np.ndarray:
        """The command a delay ago."""
        return np.interp(self.time - delay, self.time, self.asked)

    def slow(self, step: float) -> _Record:
        """The record below BAND_HZ."""
        return self._replace(asked=low_passed(self.asked, step, BAND_HZ), given=low_passed(self.given, step, BAND_HZ))


def _fitted(effort: str, records: Sequence[_Record], step: float) -> DeliveredEffort | None:
    asked, given = (np.concatenate([getattr(r, name) for r in records]) for name in ("asked", "given"))
    largest = float(np.abs(given).max())
    slow = [r.slow(step) for r in records]
    first = _law(records, slow, step, math.inf)
    if first is None:
        return None
    fit, delay = first
    expected = fit.values[0] * np.concatenate([r.late(delay) for r in records]) + fit.values[1]
    stays = (np.abs(given) > (1.0 - FLAT) * largest) & (np.abs(expected) > BEYOND * np.abs(given)) & (np.sign(expected) == np.sign(given))
    limit = largest if stays.sum() >= max(LEAST_SHARE * len(given), 5) else None
    if limit is not None:
        fit, delay = _law(records, slow, step, (1.0 - FLAT) * limit) or first
    share = float(np.sqrt(np.mean(fit.residual**2)) / max(float(np.std(np.concatenate([r.given for r in slow]))), 1e-300))
    if not fit.seen[0] or share > FOLLOWS:
        return None
    return DeliveredEffort(effort, fit, delay, share, limit, float(np.abs(asked).max()), largest)


def _law(records: Sequence[_Record], slow: Sequence[_Record], step: float, below: float) -> tuple[Fit, float] | None:
    """Fit of gain and offset of the slow records where the recorded effort is below a limit, and the delay [s] with the smallest residual; None with
    too few samples."""
    longest = min(LONGEST_S, LONGEST_SAMPLES * step)
    reach = 2 * math.ceil(0.5 / (BAND_HZ * step)) + 1  # the low pass reaches half a period of its band to both sides
    kept = [(r.time >= longest) & ~maximum_filter1d(np.abs(r.given) >= below, reach, mode="nearest") for r in records]
    y = np.concatenate([r.given[k] for r, k in zip(slow, kept)])
    if len(y) < 10:
        return None

    def columns(delay: float) -> np.ndarray:
        return np.column_stack([np.concatenate([r.late(delay)[k] for r, k in zip(slow, kept)]), np.ones(len(y))])

    def left(delay: float) -> float:
        x = columns(delay)
        return float(np.mean((y - x @ solved(x, y)) ** 2))

    best = min(np.arange(0.0, longest + 0.5 * step, step).tolist(), key=left)
    refined = minimize_scalar(left, bounds=(max(best - step, 0.0), best + step), method="bounded", options={"xatol": 1e-3 * step})
    delay = float(refined.x) if refined.fun < left(best) else best
    pieces = [(1_000_000 * n + r.time / CLUSTER_S).astype(int)[k] for n, (r, k) in enumerate(zip(records, kept))]
    return regress(columns(delay), y, np.concatenate(pieces)), delay
