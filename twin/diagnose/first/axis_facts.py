"""Facts of an axis from its recording alone, without a model of the machine.

    encoders  w - x = h/2 sign(v) + k a + g x + c                   w motor encoder, x scale, h lost motion

Lag, effort and noise come from `identify.recorded_axis`; here are reversals, encoders and vibration beside them. SI.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.control.actuator import EFFORTS
from twin.diagnose.first.vibration import Line, strongest_line
from twin.estimate.regression import Range, regress
from twin.identify.recorded_axis import (
    LEAST_SAMPLES,
    Friction,
    Strokes,
    at_rows,
    effort_balance,
    lags_of,
    noise_of,
    one_speed,
    position_of,
    strokes_of,
    value_of,
)
from twin.recordings.campaign import MeasuredRun
from twin.recordings.roughness import step_of
from twin.simulation.errors_of_run import REVERSAL_WINDOW


@dataclass(frozen=True)
class Transmission:
    """Motor encoder minus scale [m, rad] without its mean: lowest, highest, and lost motion between the directions."""

    low: float
    high: float
    lost: Range | None


@dataclass(frozen=True)
class AxisFacts:
    """Everything that the recording says about one axis by itself; None where it says nothing."""

    name: str
    kind: str
    signals: tuple[str, ...]
    period: float
    duration: float
    travel: tuple[float, float]
    speeds: tuple[float, float]
    """Tenth and ninetieth percentile of the speed in motion [m/s, rad/s]; both 0 for an axis at rest."""
    strokes: tuple[int, int]
    """Number of strokes in positive and negative direction."""
    noise: float
    step: float
    lags: dict[str, Range]
    """Lag [s] behind the set point by feedforward flag of the runs ('' where it is not known)."""
    following: float | None
    reversal: float | None
    reversals: int
    reversal_stands_out: bool
    friction: Friction | None
    transmission: Transmission | None
    vibration: Line | None
    rows: Strokes | None
    left: dict[str, np.ndarray]
    """What the regressions leave (row,), by 'error' and the name of the effort."""

    @property
    def one_speed(self) -> bool:
        """True if the axis moves at a single speed for most of the time."""
        return self.rows is None or one_speed(self.rows.speed) is not None

    @property
    def speed(self) -> float:
        """Speed that the axis reaches for a tenth of its time in motion [m/s, rad/s]."""
        return self.speeds[1]


def facts_of(runs: Sequence[MeasuredRun], axis: str) -> AxisFacts | None:
    """Facts of one axis from the runs that hold it; None if no run has a position of it."""
    own = [run for run in runs if run.trace.measured_position(axis) and len(run.trace.time) >= LEAST_SAMPLES]
    if not own:
        return None
    rows = strokes_of(own, axis)
    position = np.concatenate([position_of(run, axis) for run in own])
    period, kind = own[0].trace.period, own[0].trace.kinds[axis]
    signals = tuple(
        s for s in dict.fromkeys(s for run in own for a, s in run.trace.signals if a == axis) if all(r.trace.has(axis, s) for r in own)
    )
    left: dict[str, np.ndarray] = {}
    lags: dict[str, Range] = {}
    following, peak, turns, clear = None, None, 0, False
    friction, transmission, line = None, None, None
    low, high, forth, back = 0.0, 0.0, 0, 0
    if rows is not None:
        low, high = np.percentile(np.abs(rows.speed), (10.0, 90.0)).tolist()
        started = rows.speed[np.unique(rows.stroke, return_index=True)[1]]
        forth, back = int((started > 0).sum()), int((started < 0).sum())
        recorded = not any(run.path_is_motion(axis) for run in own)
        if recorded and "setpoint" in signals and any(np.any(run.trace.get(axis, "setpoint") != position_of(run, axis)) for run in own):
            lags, left["error"] = lags_of(own, axis, rows)
            following = max(float(np.abs(r.trace.get(axis, "setpoint") - position_of(r, axis)).max()) for r in own)
            peak, turns, clear = _reversal(rows, left["error"])
        effort = next((s for s in EFFORTS if s in signals and not any(r.fact(axis, s).unsigned for r in own)), None)
        if effort is not None and (found := effort_balance(own, axis, effort, rows, kind)) is not None:
            friction, left[effort] = found
        if {"position", "motor_position"} <= set(signals):
            transmission = _transmission(own, axis, rows)
        source = left.get("error", left.get(effort or ""))
        line = None if source is None else strongest_line(source, rows.stroke, period, "position" if "error" in left else effort or "")
    return AxisFacts(
        axis, kind, signals, period, float(sum(run.trace.time[-1] - run.trace.time[0] for run in own)), (float(position.min()), float(position.max())),
        (low, high), (forth, back), min(noise_of(position_of(run, axis)) for run in own), step_of(position[: 1 << 16]),
        lags, following, peak, turns, clear, friction, transmission, line, rows, left,
    )  # fmt: skip


def _reversal(rows: Strokes, left: np.ndarray) -> tuple[float | None, int, bool]:
    """(median error peak after a reversal [m, rad], number of reversals, whether it exceeds the peaks of equal times elsewhere)."""
    from scipy.stats import mannwhitneyu

    sign = np.sign(rows.speed)
    turns = np.flatnonzero((np.diff(rows.run) == 0) & (np.diff(sign) != 0)) + 1
    after = np.zeros(len(left), bool)
    peaks = []
    for first in turns:
        own = (rows.stroke == rows.stroke[first]) & (rows.time < rows.time[first] + REVERSAL_WINDOW)
        after |= own
        peaks.append(float(np.abs(left[own]).max()))
    if not peaks:
        return None, 0, False
    window = np.floor(rows.time / REVERSAL_WINDOW).astype(int) + rows.stroke * 1_000_000
    others = [float(np.abs(left[(window == w) & ~after]).max()) for w in np.unique(window[~after])]
    stands_out = len(peaks) >= 3 and len(others) >= 3 and float(mannwhitneyu(peaks, others, alternative="greater").pvalue) < 0.01
    return float(np.median(peaks)), len(peaks), stands_out


def _transmission(runs: Sequence[MeasuredRun], axis: str, rows: Strokes) -> Transmission:
    """Motor encoder minus scale over all samples, and its part that changes with the direction."""
    off = [run.trace.get(axis, "motor_position") - run.trace.get(axis, "position") for run in runs]
    off = [o - np.median(o) for o in off]
    columns = np.column_stack([np.sign(rows.speed), rows.speed, rows.acceleration, rows.position, np.ones(len(rows.time))])
    fit = regress(columns, at_rows(runs, rows, off), rows.stroke)
    lost = value_of(fit, {0: 2.0})
    return Transmission(min(float(o.min()) for o in off), max(float(o.max()) for o in off), lost)
