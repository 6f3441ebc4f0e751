"""Control law and lumped mechanics of an axis from its recording, without a data sheet.

command:   u(t) as in `control.command_law`                     the recorded command is that of the speed controller itself
           w*(t) = Kv (s(t - d) - x(t)) + a f(t)                 or a speed set point w* is recorded; feedforward f may be
in drive:  w(t + lag) = w*(t - Td) - Kv (x(t) - x(t - Td))       Td = 0 if the NC closes the position loop
mechanics: u = m dv/dt + d sign(v) + b v + c - f/K               u: recorded current, voltage or torque; f: known external load

Without lead, ratio and motor data, m, d, b and c are known only in units of the command: m is the inertia over the torque constant,
referred to the axis, in A/(m/s2) or the like. These are the lumped parameters. If a known external load is recorded, the response of
the command gives K [N or Nm per unit of the command], which converts them to kilograms and newtons. SI; positions in m or rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import lsq_linear

from twin.control.command_law import CommandRun, command_law
from twin.errors import InputError
from twin.recordings.campaign import MeasuredRun
from twin.recordings.excitation import one_speed
from twin.recordings.force_sign import low_passed, recorded_sign
from twin.recordings.least_squares import solved
from twin.recordings.profile_speed import PROFILE

BAND_HZ = 40.0
LONGEST_DELAY_CYCLES = 8
LONGEST_DSC_S = 0.012
LONGEST_LAG_S = 0.006
DSC_RESIDUAL = 0.6
"""The position loop is closed in the drive if that leaves less than this share of the speed error."""
LARGEST_RESIDUAL = 0.02
"""The command follows the law if less than this share (RMS) is left."""
MOVING = 0.02
"""Share of the highest speed above which an axis moves."""
EXPLAINED = 0.5
"""Share of the command's variance that the mechanics must explain; otherwise they count as unknown."""
MOST_OF_PEAK = 2.0
"""Largest part of the balance as a multiple of the largest recorded command: filtered peaks and opposing parts."""

LEAST_LOAD = 0.3
"""The response to an external load is visible if its share of the command (RMS) exceeds this share of the residual."""
LEAST_SAMPLES = 25
"""Fewest samples of a run that is read."""
LEAST_ROWS = 4
"""Fewest samples in motion for each number of the mechanics."""
EFFORTS = ("current", "voltage", "torque")


@dataclass(frozen=True)
class Law:
    """Identified position controller: gain [1/s], delays [s], feedforward weight; `left` is the residual of the command [m/s, RMS]."""

    gain: float
    delay: float
    feedforward: float
    feedforward_delay: float
    left: float = 0.0
    measured: bool = True
    dsc_delay: float = 0.0
    lag: float = 0.0  # of the speed loop
    integral_time: float = math.nan  # of the speed controller; inf: it has none, NaN: the recording does not show it
    speed_gain: float = 0.0  # command per m/s; 0: derived from the lag
    mean_cycles: int = 0

    @property
    def direct(self) -> bool:
        """True if the recorded command shows the speed controller."""
        return self.speed_gain > 0.0


@dataclass(frozen=True)
class Mechanics:
    """Lumped parameters in units of the command per axis unit. `explained`: share of the command's variance that they explain."""

    effort: str
    inertia: float
    coulomb: float
    viscous: float
    constant: float
    gravity: tuple[float, float]  # factors of cos q and sin q, for rotary axes
    explained: float
    peak: float
    force_per_unit: float | None = None  # N or Nm per unit of the command, if a known external load gives it
    steady_speed: float | None = None  # the one speed of the recording: `coulomb` is then the whole friction there

    @property
    def scale(self) -> float:
        """Factor from lumped parameters to forces; 1 if no load gives it."""
        return self.force_per_unit or 1.0

    @property
    def forces(self) -> Mechanics:
        """The same in N and kg or Nm and kg m2 if a known load gives the scale, else unchanged."""
        k = self.scale
        return replace(
            self, inertia=k * self.inertia, coulomb=k * self.coulomb, viscous=k * self.viscous, constant=k * self.constant,
            gravity=(k * self.gravity[0], k * self.gravity[1]), peak=k * self.peak,
        )  # fmt: skip


@dataclass(frozen=True)
class AxisLumps:
    """All identified data of an axis. `notes` name what could not be identified."""

    name: str
    kind: str
    encoder: str
    travel: tuple[float, float]
    speed: float
    acceleration: float
    period: float
    law: Law
    mechanics: Mechanics | None
    noise: float
    effort_noise: float
    notes: tuple[str, ...] = field(default=())

    @property
    def forces(self) -> Mechanics | None:
        """Mechanics in N and kg or Nm and kg m2 if a known load gives the scale, else lumped; None if unknown."""
        return self.mechanics.forces if self.mechanics else None


@dataclass(frozen=True)
class _Run:
    """Signals of one run of an axis (sample,), SI."""

    period: float
    setpoint: np.ndarray
    position: np.ndarray
    command: np.ndarray | None
    feedforward: np.ndarray | None
    effort: np.ndarray | None
    speed: np.ndarray | None
    load: np.ndarray | None = None  # known external load [N, Nm at the axis]
    injected: np.ndarray | None = None  # added to the command by a test rig, in its unit


def lumps_of(runs: Sequence[MeasuredRun], axis: str) -> AxisLumps:
    """Law and lumped parameters of one axis from all runs of a campaign. Raises InputError if no position or motion is recorded."""
    traces = [run.trace for run in runs if run.trace.has(axis, "setpoint")]
    kind = traces[0].kinds[axis]
    encoder = "scale" if all(t.has(axis, "position") for t in traces) else "motor"
    if kind == "rotary" and all(t.has(axis, "motor_position") for t in traces):
        encoder = "motor"
    where = "position" if encoder == "scale" else "motor_position"
    if not all(t.has(axis, where) for t in traces):
        raise InputError(f"axis {axis}: no position is recorded in every run; leave the axis out of the campaign")
    unsigned = {s for s in EFFORTS if any(recorded_sign(run, axis, s).unsigned for run in runs)}
    effort = next((s for s in EFFORTS if s not in unsigned and all(t.has(axis, s) for t in traces)), "")
    parts = [
        _Run(
            t.period,
            t.get(axis, "setpoint"),
            t.get(axis, where),
            t.signals.get((axis, "velocity_setpoint")),
            t.signals.get((axis, "velocity_feedforward")),
            t.signals.get((axis, effort)),
            t.signals.get((axis, "velocity")),
            next(iter(t.loads(axis).values()), None),
            t.injections(axis).get({"current": "A", "voltage": "V", "torque": "Nm"}.get(effort, "")),
        )
        for t in traces
        if len(t.time) >= LEAST_SAMPLES and np.ptp(t.get(axis, "setpoint")) > 0.0
    ]
    if not parts:
        raise InputError(f"axis {axis}: it moves in no run of {LEAST_SAMPLES} samples or more; record a longer move")
    notes: list[str] = [f"{s} is recorded without a sign: not used; record it with its sign" for s in sorted(unsigned)]
    notes += [PROFILE] if any(axis in run.profiles for run in runs) else []
    feedforward_flag = next((run.feedforward for run in runs if run.feedforward), None)
    mechanics = _mechanics(parts, kind, effort, notes) if effort else None
    if any(run.fact(axis, "setpoint").made_from in ("position", "motor_position", "velocity") for run in runs):
        notes.append(
            "no set point is recorded, the recorded motion is the path: gain, delay and feedforward of the position loop are assumed"
        )
        law = Law(50.0, 0.0, 1.0, 0.0, measured=False, lag=1.5e-3)
    else:
        law = (_direct_law(parts) if effort else None) or _position_law(parts, feedforward_flag, notes)
    if not effort:
        notes.append("no signed current, voltage or torque is recorded: mass and friction cannot be identified and are assumed")
    low, high = min(float(p.setpoint.min()) for p in parts), max(float(p.setpoint.max()) for p in parts)
    speeds, accelerations = zip(*(_motion(p) for p in parts))
    return AxisLumps(
        axis, kind, encoder, (low, high), max(speeds), max(accelerations), parts[0].period, law, mechanics,
        _noise([p.position for p in parts]), _noise([p.effort for p in parts if p.effort is not None]), tuple(notes),
    )  # fmt: skip


def _delayed(values: np.ndarray, period: float, delay: float) -> np.ndarray:
    """Values delayed by `delay` [s], linear between samples as in a control; constant before the first."""
    times = np.arange(len(values)) * period
    return np.interp(times - delay, times, values)


def _position_law(parts: Sequence[_Run], feedforward_flag: str | None, notes: list[str]) -> Law:
    """Gain, delay and feedforward of the position controller, and where the position loop is closed."""
    law = _command_law([p for p in parts if p.command is not None])
    if law is None:
        return _lag_law(parts, feedforward_flag, notes)
    return _with_drive_loop([p for p in parts if p.command is not None], law)


def _command_law(parts: Sequence[_Run]) -> Law | None:
    """Fit w* = Kv (s(t - d) - x) + a f by least squares, with d on a grid; None if the command does not follow this law."""
    if not parts:
        return None
    tp = parts[0].period
    cut = LONGEST_DELAY_CYCLES + 2
    size = np.sqrt(np.mean(np.concatenate([p.command[cut:] for p in parts]) ** 2))  # type: ignore[index]

    def fit(delay: float, ff_delay: float | None) -> tuple[float, np.ndarray]:
        rows, values = [], []
        for p in parts:
            assert p.command is not None
            error = _delayed(p.setpoint, tp, delay) - p.position
            fed = p.feedforward if p.feedforward is not None else _slope(p, ff_delay or 0.0)
            rows.append(np.column_stack([error, fed, np.ones_like(error)])[cut:])
            values.append(p.command[cut:])
        x, y = np.concatenate(rows), np.concatenate(values)
        b = solved(x, y)
        return float(np.sqrt(np.mean((y - x @ b) ** 2))), b

    def best_of(delays: Sequence[float]) -> tuple[float, np.ndarray, float, float | None]:
        return min(((*fit(d, f), d, f) for d in delays for f in ((None,) if own else (0.0, d))), key=lambda r: r[0])

    own = all(p.feedforward is not None for p in parts)
    best = best_of(_steps(0.0, LONGEST_DELAY_CYCLES * tp, tp / 4))
    for step in (tp / 16, tp / 128):
        best = best_of(_steps(max(best[2] - 4.0 * step, 0.0), best[2] + 4.0 * step, step))
    left, (gain, weight, _), delay, ff_delay = best
    if not gain > 0.0 or left > LARGEST_RESIDUAL * size:
        return None
    if own:
        ff_delay, fed = _feedforward_delay(parts, tp)
        weight *= fed
    return Law(float(gain), delay, float(weight), float(ff_delay or 0.0), left)


def _slope(p: _Run, delay: float) -> np.ndarray:
    """Backward difference of the set point over one cycle."""
    return (_delayed(p.setpoint, p.period, delay) - _delayed(p.setpoint, p.period, delay + p.period)) / p.period


def _feedforward_delay(parts: Sequence[_Run], tp: float) -> tuple[float, float]:
    """Delay [s] and weight of the recorded feedforward relative to the slope of the set point."""
    best = (np.inf, 0.0, 1.0)
    cut = LONGEST_DELAY_CYCLES + 3
    y = np.concatenate([p.feedforward[cut:] for p in parts])  # type: ignore[index]
    if not np.any(y):
        return 0.0, 0.0
    for delay in _steps(0.0, LONGEST_DELAY_CYCLES * tp, tp / 4):
        x = np.concatenate([_slope(p, delay)[cut:] for p in parts])
        weight = float(x @ y) / max(float(x @ x), 1e-300)
        best = min(best, (float(np.mean((y - weight * x) ** 2)), delay, weight))
    return best[1], best[2]


def _with_drive_loop(parts: Sequence[_Run], law: Law) -> Law:
    """The law with the delay of the command to the drive (0: the NC closes the loop), and the lag of the speed loop."""
    tp = parts[0].period
    shown: dict[float, tuple[float, float]] = {}
    prepared = []
    for p in parts:
        time = np.arange(len(p.position)) * tp
        inner = time[12:-6] if len(time) > 60 else time[2:-2]
        position, command = CubicSpline(time, _smooth(p.position, tp)), CubicSpline(time, p.command)
        prepared.append((inner, position, command))
    lags = _steps(0.0, LONGEST_LAG_S, 0.25e-3)
    for dsc in _steps(0.0, LONGEST_DSC_S, 0.25e-3):
        errors = []
        for lag in lags:
            total, count = 0.0, 0
            for inner, position, command in prepared:
                t = inner - lag
                t = t[(t - dsc > 0.0)]
                wanted = command(t - dsc) - law.gain * (position(t) - position(t - dsc))
                off = position(t + lag, 1) - wanted
                total, count = total + float(off @ off), count + len(off)
            errors.append((np.sqrt(total / max(count, 1)), lag))
        shown[dsc] = min(errors)
    best = min(shown, key=lambda d: shown[d][0])
    if best > 0.0 and shown[best][0] < DSC_RESIDUAL * shown[0.0][0]:
        return replace(law, dsc_delay=best, lag=shown[best][1])
    return replace(law, lag=shown[0.0][1])


def _direct_law(parts: Sequence[_Run]) -> Law | None:
    """The law of a controller that gives the recorded command itself, without a current loop; None if the command follows none."""
    runs = []
    for p in parts:
        assert p.effort is not None
        runs.append(CommandRun(p.period, p.setpoint, p.position, p.speed, p.effort if p.injected is None else p.effort - p.injected))
    found = command_law(runs)
    if found is None:
        return None
    return Law(
        found.position_gain, found.delay, found.feedforward, found.delay, found.left, integral_time=found.integral_time,
        speed_gain=found.speed_gain, mean_cycles=found.mean_cycles,
    )  # fmt: skip


def _lag_law(parts: Sequence[_Run], feedforward_flag: str | None, notes: list[str]) -> Law:
    """The law without a recorded speed set point: one lag between set point and position."""
    notes.append(
        "no speed set point that follows a position controller is recorded: gain and delays cannot be separated, only their sum, the lag"
    )
    tp = parts[0].period

    def left(lag: float) -> float:
        return sum(len(p.position) * float(np.var(p.position - _delayed(p.setpoint, tp, lag))) for p in parts)

    lag = max(min(_steps(0.0, 0.3, max(tp / 8, 0.25e-3)), key=left), 1e-3)
    if feedforward_flag in ("velocity", "velocity+torque") or (feedforward_flag is None and lag < 12e-3):
        notes.append(
            f"the lag of the position, {lag * 1e3:.2f} ms, is taken as a delay under full velocity feedforward; the gain is assumed"
        )
        return Law(50.0, max(lag - 1.5e-3, 0.0), 1.0, max(lag - 1.5e-3, 0.0), measured=False, lag=1.5e-3)
    notes.append(f"the lag of the position, {lag * 1e3:.2f} ms, is taken as 1 / gain without feedforward")
    return Law(1.0 / lag, 0.0, 0.0, 0.0, measured=False, lag=min(2e-3, 0.1 * lag))


def _mechanics(parts: Sequence[_Run], kind: str, effort: str, notes: list[str]) -> Mechanics | None:
    """Lumped parameters by least squares with physical signs, from the samples where the axis moves."""
    rows, values, speeds = [], [], []
    for p in parts:
        assert p.effort is not None
        motion, u = _smooth(p.position, p.period), _smooth(p.effort, p.period)
        speed = np.gradient(motion, p.period)
        acceleration = np.gradient(speed, p.period)
        edge = max(4, len(u) // 50)
        keep = np.abs(speed) > MOVING * np.abs(speed).max()
        keep[:edge] = keep[-edge:] = False
        columns = [acceleration, np.sign(speed), speed, np.ones_like(speed)]
        columns += [np.cos(motion), np.sin(motion)] if kind == "rotary" else []
        if any(part.load is not None for part in parts):
            columns.append(np.zeros_like(speed) if p.load is None else -_smooth(p.load, p.period))
        rows.append(np.column_stack(columns)[keep])
        values.append(u[keep])
        speeds.append(speed[keep])
    x, y = np.concatenate(rows), np.concatenate(values)
    peak = max(float(np.abs(p.effort).max()) for p in parts if p.effort is not None)
    if len(y) < LEAST_ROWS * x.shape[1]:
        notes.append(f"the axis moves in {len(y)} samples only: mass and friction cannot be identified from the {effort}")
        return None
    # at a single speed in one direction Coulomb friction, weight and viscous friction cannot be separated
    scale = np.maximum(np.sqrt(np.mean(x**2, axis=0)), 1e-300)
    low = np.full(x.shape[1], -np.inf)
    low[:3] = 0.0
    loaded = any(part.load is not None for part in parts)
    if loaded:
        low[-1] = 0.0
    one_way = min(np.mean(x[:, 1] > 0), np.mean(x[:, 1] < 0)) < 0.02
    steady = one_speed(np.concatenate(speeds))
    columns = [i for i in range(x.shape[1]) if not (one_way and i == 1) and not (steady and i == 2)]
    if steady:
        notes.append(
            f"the axis moves at one speed, {steady:.3g} {'m' if kind == 'linear' else 'rad'}/s: only the sum of Coulomb and viscous friction at "
            "this speed is known, and is given as Coulomb friction; record several speeds to separate them"
        )
    if one_way:
        notes.append(
            f"the axis moves one way only: Coulomb friction and constant force cannot be separated, both are given as constant {effort}"
        )
    # no part of the balance exceeds the largest recorded command: larger ones would cancel each other unseen
    high = MOST_OF_PEAK * peak / np.maximum(np.abs(x).max(axis=0), 1e-300)
    low = np.maximum(low, -high)
    found = lsq_linear(x[:, columns] / scale[columns], y, bounds=((low * scale)[columns], (high * scale)[columns]))
    b = np.zeros(x.shape[1])
    b[columns] = found.x / scale[columns]
    left = float(np.std(y - x @ b))
    explained = 1.0 - left**2 / max(float(np.var(y)), 1e-300)
    if explained < EXPLAINED or b[0] <= 0.0:
        notes.append(f"motion explains {max(explained, 0.0):.0%} of the {effort}: mass and friction cannot be identified and are assumed")
        return None
    gravity = (float(b[4]), float(b[5])) if kind == "rotary" else (0.0, 0.0)
    force = None
    if loaded and float(b[-1]) * float(np.std(x[:, -1])) > LEAST_LOAD * left:
        force = 1.0 / float(b[-1]) if effort != "torque" else None
    elif loaded:
        notes.append(
            f"the {effort} does not respond to the recorded load: the load is too small, or it is part of the {effort} "
            '(then map it as signal = "injected_command")'
        )
    return Mechanics(effort, float(b[0]), float(b[1]), float(b[2]), float(b[3]), gravity, explained, peak, force, steady)


def _smooth(values: np.ndarray, period: float) -> np.ndarray:
    return low_passed(values, period, BAND_HZ)


def _motion(p: _Run) -> tuple[float, float]:
    """Highest speed and acceleration of the set point, without those caused by rounding."""
    s = _smooth(p.setpoint, p.period)
    speed = np.gradient(s, p.period)
    return float(np.abs(speed).max()), float(np.abs(np.gradient(speed, p.period)).max())


def _noise(columns: Sequence[np.ndarray]) -> float:
    """Standard deviation of single samples in the quietest part, from third differences (sqrt(20) times that of white noise)."""
    found = []
    for values in columns:
        third = np.diff(values, 3)
        windows = [float(np.std(w)) for w in np.array_split(third, max(1, len(third) // 50)) if len(w) > 3]
        found += windows
    return float(np.percentile(found, 20)) / np.sqrt(20.0) if found else 0.0


def _steps(first: float, last: float, step: float) -> list[float]:
    return [first + i * step for i in range(round((last - first) / step) + 1)]
