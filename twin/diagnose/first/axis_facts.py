"""Facts of an axis from its recording alone, without a model of the machine.

    error     s - x = lag v + k a + c                               s set point, x position, v and a speed and acceleration of s
    effort    u = d sign(v) + b v + m a + c  (+ gravity by angle)   u current, torque or voltage, v and a of x
    encoders  w - x = h/2 sign(v) + k a + g x + c                   w motor encoder, h lost motion

Each is a regression on the samples in motion, with intervals whose clusters are strokes (`recordings.least_squares`). A stroke is a stretch
of motion in one direction. What the recorded speeds and directions cannot separate is given as the sum that they do determine. SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from twin.diagnose.first.vibration import Line, strongest_line
from twin.recordings.campaign import MeasuredRun
from twin.recordings.force_sign import low_passed
from twin.recordings.least_squares import Fit, regress
from twin.recordings.roughness import SECOND_DIFFERENCE, roughness, step_of

BAND_HZ = 40.0
"""Band of the speeds and accelerations, and of the efforts that belong to them [Hz]."""
MOVING = 0.02
"""Share of the highest speed of the recording above which an axis moves."""
REVERSAL_S = 0.1
"""Time after a reversal in which its error peak is sought [s]."""
LEAST_SAMPLES = 16
"""Fewest samples of a run, and fewest samples in motion: twice the numbers of the largest regression and some more."""
ONE_SPEED = 1.5
"""Speeds within this factor are one speed: Coulomb and viscous friction are then one number."""
EFFORTS = ("current", "torque", "voltage")


class Value(NamedTuple):
    """A number with the half width of its 95 % interval."""

    value: float
    half: float

    @property
    def known(self) -> bool:
        """True if the interval excludes zero."""
        return bool(abs(self.value) > self.half)


@dataclass(frozen=True)
class Strokes:
    """Samples of an axis in motion, of all runs in a row (row,): signals, run and stroke of each. `steady` marks nearly constant speed."""

    run: np.ndarray
    stroke: np.ndarray
    time: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    position: np.ndarray
    steady: np.ndarray


@dataclass(frozen=True)
class Friction:
    """Friction in the unit of the effort. `at_speed` is the sum of Coulomb and viscous friction at `speed` [m/s, rad/s]."""

    effort: str
    speed: float
    at_speed: Value
    coulomb: Value | None
    viscous: Value | None
    inertia: Value
    constant: Value | None
    against: bool
    peak: float
    explained: float
    """Share of the variance of the effort in motion that the regression explains."""


@dataclass(frozen=True)
class Transmission:
    """Motor encoder minus scale [m, rad] without its mean: lowest, highest, and lost motion between the directions."""

    low: float
    high: float
    lost: Value | None


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
    lags: dict[str, Value]
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
        return self.speeds[1] <= ONE_SPEED * self.speeds[0]

    @property
    def speed(self) -> float:
        """Speed that the axis reaches for a tenth of its time in motion [m/s, rad/s]."""
        return self.speeds[1]


def facts_of(runs: Sequence[MeasuredRun], axis: str) -> AxisFacts | None:
    """Facts of one axis from the runs that hold it; None if no run has a position of it."""
    own = [run for run in runs if _where(run, axis) and len(run.trace.time) >= LEAST_SAMPLES]
    if not own:
        return None
    rows = _strokes(own, axis)
    position = np.concatenate([_position(run, axis) for run in own])
    period, kind = own[0].trace.period, own[0].trace.kinds[axis]
    signals = tuple(
        s for s in dict.fromkeys(s for run in own for a, s in run.trace.signals if a == axis) if all(r.trace.has(axis, s) for r in own)
    )
    left: dict[str, np.ndarray] = {}
    lags: dict[str, Value] = {}
    following, peak, turns, clear = None, None, 0, False
    friction, transmission, line = None, None, None
    if rows is not None:
        recorded = not any(run.fact(axis, "setpoint").made_from in ("position", "motor_position", "velocity") for run in own)
        if recorded and "setpoint" in signals and any(np.any(run.trace.get(axis, "setpoint") != _position(run, axis)) for run in own):
            lags, left["error"] = _lags(own, axis, rows)
            following = max(float(np.abs(r.trace.get(axis, "setpoint") - _position(r, axis)).max()) for r in own)
            peak, turns, clear = _reversal(rows, left["error"])
        effort = next((s for s in EFFORTS if s in signals and not any(r.fact(axis, s).unsigned for r in own)), None)
        if effort is not None and (found := _friction(own, axis, effort, rows, kind)) is not None:
            friction, left[effort] = found
        if {"position", "motor_position"} <= set(signals):
            transmission = _transmission(own, axis, rows)
        source = left.get("error", left.get(effort or ""))
        line = None if source is None else strongest_line(source, rows.stroke, period, "position" if "error" in left else effort or "")
    return AxisFacts(
        axis, kind, signals, period, float(sum(run.trace.time[-1] - run.trace.time[0] for run in own)), (float(position.min()), float(position.max())),
        _speeds(rows), _directions(rows), min(_noise(_position(run, axis)) for run in own), step_of(position[: 1 << 16]),
        lags, following, peak, turns, clear, friction, transmission, line, rows, left,
    )  # fmt: skip


def _where(run: MeasuredRun, axis: str) -> str:
    """The measured position of an axis: its scale, else its motor encoder; '' without one."""
    return next((s for s in ("position", "motor_position") if run.trace.has(axis, s)), "")


def _position(run: MeasuredRun, axis: str) -> np.ndarray:
    return run.trace.get(axis, _where(run, axis))


def _slopes(values: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Speed and acceleration (sample,) within BAND_HZ."""
    speed = np.gradient(low_passed(values, period, BAND_HZ), period)
    return speed, np.gradient(speed, period)


def _strokes(runs: Sequence[MeasuredRun], axis: str) -> Strokes | None:
    """The samples in motion; None if the axis never moves further than its noise."""
    slopes = [_slopes(_position(run, axis), run.trace.period) for run in runs]
    fastest = max(float(np.abs(v).max()) for v, _ in slopes)
    travel = max(float(np.ptp(_position(run, axis))) for run in runs)
    noise = max(_noise(_position(run, axis)) for run in runs)
    if fastest == 0.0 or travel < 10.0 * max(noise, step_of(_position(runs[0], axis))):
        return None
    parts, count = [], 0
    for i, (run, (v, a)) in enumerate(zip(runs, slopes)):
        moving = np.abs(v) > MOVING * fastest
        edge = max(2, len(v) // 200)
        moving[:edge] = moving[-edge:] = False
        sign = np.sign(v) * moving
        begins = np.diff(sign, prepend=0.0) != 0
        stroke = count + np.cumsum(begins & moving)
        count += int((begins & moving).sum())
        keep = np.flatnonzero(moving)
        parts.append(
            np.column_stack([np.full(len(keep), i), stroke[keep], run.trace.time[keep], v[keep], a[keep], _position(run, axis)[keep], keep])
        )
    rows = np.concatenate(parts)
    if len(rows) < LEAST_SAMPLES:
        return None
    steady = np.abs(rows[:, 4]) < 0.1 * np.abs(rows[:, 4]).max()
    return Strokes(rows[:, 0].astype(int), rows[:, 1].astype(int), rows[:, 2], rows[:, 3], rows[:, 4], rows[:, 5], steady)


def _at(runs: Sequence[MeasuredRun], rows: Strokes, values: Sequence[np.ndarray]) -> np.ndarray:
    """Values of each run (sample,) at the rows (row,)."""
    out = np.empty(len(rows.time))
    for i, run in enumerate(runs):
        own = rows.run == i
        out[own] = values[i][np.searchsorted(run.trace.time, rows.time[own] - 0.5 * run.trace.period)]
    return out


def _value(fit: Fit, weights: Sequence[float]) -> Value | None:
    """A linear combination of the fitted numbers with its interval; None if the rows do not determine it."""
    w = np.asarray(weights)
    used = w != 0.0
    if not np.isfinite(fit.covariance[np.ix_(used, used)]).all():
        return None
    return Value(
        float(w @ fit.values), fit.quantile * float(np.sqrt(max(w @ np.where(used[:, None] & used, fit.covariance, 0.0) @ w, 0.0)))
    )


def _lags(runs: Sequence[MeasuredRun], axis: str, rows: Strokes) -> tuple[dict[str, Value], np.ndarray]:
    """Lag [s] of the position behind the set point by feedforward flag, and the error that it leaves (row,)."""
    slopes = [_slopes(run.trace.get(axis, "setpoint"), run.trace.period) for run in runs]
    speed, acceleration = (_at(runs, rows, [s[i] for s in slopes]) for i in (0, 1))
    error = _at(runs, rows, [run.trace.get(axis, "setpoint") - _position(run, axis) for run in runs])
    flags = np.array([run.feedforward or "" for run in runs])[rows.run]
    lags, left = {}, np.zeros(len(error))
    for flag in dict.fromkeys(flags.tolist()):
        own = flags == flag
        fit = regress(np.column_stack([speed, acceleration, np.ones_like(speed)])[own], error[own], rows.stroke[own])
        left[own] = fit.residual
        if (lag := _value(fit, (1.0, 0.0, 0.0))) is not None:
            lags[flag] = lag
    return lags, left


def _reversal(rows: Strokes, left: np.ndarray) -> tuple[float | None, int, bool]:
    """(median error peak after a reversal [m, rad], number of reversals, whether it exceeds the peaks of equal times elsewhere)."""
    from scipy.stats import mannwhitneyu

    sign = np.sign(rows.speed)
    turns = np.flatnonzero((np.diff(rows.run) == 0) & (np.diff(sign) != 0)) + 1
    after = np.zeros(len(left), bool)
    peaks = []
    for first in turns:
        own = (rows.stroke == rows.stroke[first]) & (rows.time < rows.time[first] + REVERSAL_S)
        after |= own
        peaks.append(float(np.abs(left[own]).max()))
    if not peaks:
        return None, 0, False
    window = np.floor(rows.time / REVERSAL_S).astype(int) + rows.stroke * 1_000_000
    others = [float(np.abs(left[(window == w) & ~after]).max()) for w in np.unique(window[~after])]
    stands_out = len(peaks) >= 3 and len(others) >= 3 and float(mannwhitneyu(peaks, others, alternative="greater").pvalue) < 0.01
    return float(np.median(peaks)), len(peaks), stands_out


def _friction(runs: Sequence[MeasuredRun], axis: str, effort: str, rows: Strokes, kind: str) -> tuple[Friction, np.ndarray] | None:
    """Friction, inertia and constant part of an effort; None if the motion explains none of it."""
    sign = np.sign(rows.speed)
    u = _at(runs, rows, [low_passed(run.trace.get(axis, effort), run.trace.period, BAND_HZ) for run in runs])
    # in one direction Coulomb friction and a constant force are one column
    both_ways = bool((sign > 0).any() and (sign < 0).any())
    columns = [sign, rows.speed, rows.acceleration, np.ones_like(sign) if both_ways else np.zeros_like(sign)]
    columns += [np.cos(rows.position) - 1.0, np.sin(rows.position)] if kind == "rotary" and np.ptp(rows.position) > 0.5 else []
    fit = regress(np.column_stack(columns), u, rows.stroke)
    more = [0.0] * (len(columns) - 4)
    at = float(np.median(np.abs(rows.speed[rows.steady]))) if rows.steady.any() else float(np.median(np.abs(rows.speed)))
    total = _value(fit, [1.0, at, 0.0, 0.0, *more])
    inertia = _value(fit, [0.0, 0.0, 1.0, 0.0, *more])
    if total is None or inertia is None or not total.known:
        return None
    # in one direction a weight may outweigh friction: the sign is then not judged
    turned = -1.0 if total.value < 0.0 and both_ways else 1.0
    coulomb, viscous = _value(fit, [turned, 0.0, 0.0, 0.0, *more]), _value(fit, [0.0, turned, 0.0, 0.0, *more])
    low, high = _speeds(rows)
    split = coulomb is not None and viscous is not None and coulomb.value > coulomb.half and viscous.value > -viscous.half
    split = split and both_ways and high > ONE_SPEED * low
    peak = max(float(np.abs(run.trace.get(axis, effort)).max()) for run in runs)
    return (
        Friction(
            effort, at, Value(turned * total.value, total.half), coulomb if split else None, viscous if split else None,
            Value(turned * inertia.value, inertia.half), _value(fit, [0.0, 0.0, 0.0, turned, *more]) if both_ways else None, turned < 0.0, peak,
            1.0 - float(np.var(fit.residual) / max(float(np.var(u)), 1e-300)),
        ),
        turned * fit.residual,
    )  # fmt: skip


def _transmission(runs: Sequence[MeasuredRun], axis: str, rows: Strokes) -> Transmission:
    """Motor encoder minus scale over all samples, and its part that changes with the direction."""
    off = [run.trace.get(axis, "motor_position") - run.trace.get(axis, "position") for run in runs]
    off = [o - np.median(o) for o in off]
    columns = np.column_stack([np.sign(rows.speed), rows.speed, rows.acceleration, rows.position, np.ones(len(rows.time))])
    fit = regress(columns, _at(runs, rows, off), rows.stroke)
    lost = _value(fit, [2.0, 0.0, 0.0, 0.0, 0.0])
    return Transmission(min(float(o.min()) for o in off), max(float(o.max()) for o in off), lost)


def _speeds(rows: Strokes | None) -> tuple[float, float]:
    """Speed below which an axis moves for a tenth of its time in motion, and above which for a tenth [m/s, rad/s]; 0 for an axis at rest."""
    if rows is None:
        return 0.0, 0.0
    low, high = np.percentile(np.abs(rows.speed), (10.0, 90.0))
    return float(low), float(high)


def _directions(rows: Strokes | None) -> tuple[int, int]:
    if rows is None:
        return 0, 0
    _, first = np.unique(rows.stroke, return_index=True)
    return int((rows.speed[first] > 0).sum()), int((rows.speed[first] < 0).sum())


def _noise(values: np.ndarray) -> float:
    """Standard deviation of single samples in the quietest fifth, from second differences."""
    parts = [part for part in np.array_split(values, max(1, len(values) // 100)) if len(part) > 4]
    # most samples of a coarse record equal their neighbours: their median says nothing
    sizes = [roughness(part) or float(np.std(np.diff(part, 2))) for part in parts]
    sizes = [size for size in sizes if size > 0.0]
    return float(np.percentile(sizes, 20) / np.sqrt(SECOND_DIFFERENCE)) if sizes else 0.0
