"""One axis in one run, brought to the grid of the position cycles: what the regressions read.

The trace is sampled once or several times a position cycle Tp. A cycle n begins at t_n; positions at the starts of cycles are free
of the saw-tooth within a cycle, so speed and acceleration in its middle come from them alone (cubic spline), and the current is
the mean of the cycle's samples (`between_samples` adds what these miss). Regressions filter both sides alike, without phase: a
symmetric window of finite length, so that noise in the regressors is too small to bias (1e-4 of the acceleration), and a row whose
window lies where the axis slides holds nothing of a reversal, a stop or a clipped sample.
"""

from __future__ import annotations

from dataclasses import dataclass
import functools
import math

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import firwin

from twin.errors import InputError
from twin.identify.between_samples import SETTLED_CYCLES, measured_ripple
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation import recorded_forces

BAND_HZ = 20.0
"""Regressions look below this: drive trains are rigid there (a 150 Hz mode adds 0.4 % of the load at its edge)."""

NYQUIST = 0.4
"""Band times position cycle from which on there is nothing above it to take away (0.5 is the sampling theorem's limit)."""

REACH_S = 0.06
"""Half length of the filter: what lies further away takes no part."""

SLIDING_RAD_PER_S, SLIDING_M_PER_S = 5.0, 8e-3
"""Motor speed from which friction is on its line: 8 mm/s at a 10 mm screw, where Stribeck's excess has gone (it has at 4 mm/s); the
other one is a direct drive's."""

STROKE_S = 0.5
"""A stroke longer than this counts as several clusters."""


@dataclass(frozen=True)
class AxisRun:
    """Signals of one axis on the position cycles (cycle,), at the motor in SI unless said otherwise."""

    run: str
    feedforward: str | None
    cycle: float
    samples_per_cycle: int
    start: np.ndarray  # times t_n [s]
    middle: np.ndarray  # t_n + Tp / 2
    setpoint: CubicSpline  # of the time, axis units
    end: float  # last time of the set points
    position: np.ndarray | None  # scale at t_n, axis units
    angle: np.ndarray  # motor angle at t_n and at the end of the last cycle (cycle + 1,) [rad]
    axis_position: np.ndarray  # at the middle, axis units
    speed: np.ndarray  # at the middle [rad/s]
    acceleration: np.ndarray  # [rad/s2]
    speed_setpoint: np.ndarray | None  # held in the cycle [rad/s]
    velocity_feedforward: np.ndarray | None  # as recorded, held in the cycle, axis units a second
    motor_at_axis: np.ndarray | None  # motor encoder at t_n, axis units
    motor_speed: np.ndarray | None  # mean of the cycle's samples of the speed channel [rad/s]
    current: np.ndarray | None  # mean of the cycle's samples [A]; of an axis without current loop its command [A, V or Nm]
    current_ripple: np.ndarray | None
    speed_ripple: np.ndarray | None
    torque_feedforward: np.ndarray  # at weight 1 without delay [Nm], 0 where the run has none
    deflection: np.ndarray | None  # motor minus scale, mean of the cycle's samples: the saw-tooth cancels; axis units
    known_load: np.ndarray | None  # known outside load, mean of the cycle, as torque at the motor towards +q [Nm]
    injected: np.ndarray | None  # what a rig adds to the command, mean of the cycle, as torque at the motor [Nm]
    slides_above: float  # speed from which friction is on its line [rad/s]
    limited: np.ndarray  # current at its limit, or a channel clipped
    clipped: dict[str, float]  # signal -> seconds that its recording stays on its largest value while the axis goes on

    def filtered(self, values: np.ndarray) -> np.ndarray:
        """Zero-phase low-pass of (cycle,) values; at the ends of the run with the end value beyond."""
        window = low_pass_window(self.cycle)
        return np.convolve(np.pad(values, len(window) // 2, "edge"), window, "valid")

    def setpoint_at(self, times: np.ndarray) -> np.ndarray:
        """Set point at any times; constant outside the run."""
        return self.setpoint(np.clip(times, 0.0, self.end))

    @property
    def jerk(self) -> np.ndarray:
        """(cycle,) at the middle [rad/s3]."""
        return np.gradient(self.acceleration, self.cycle)

    @property
    def strokes(self) -> np.ndarray:
        """(cycle,) number of the stroke: new at each reversal, and every STROKE_S."""
        turned = np.diff(np.sign(self.filtered(self.speed)), prepend=0.0) != 0
        since = np.arange(len(self.speed)) * self.cycle // STROKE_S
        return np.cumsum(turned | (np.diff(since, prepend=0.0) > 0))

    @property
    def sliding(self) -> np.ndarray:
        """(cycle,) True where the axis slides, unlimited, all through the window of the filter."""
        reach = len(low_pass_window(self.cycle)) // 2
        # the current between samples remembers a limit as long as it remembers a step
        remembered = np.convolve(self.limited, np.ones(SETTLED_CYCLES + 1))[: len(self.limited)] > 0.5
        slow = (np.abs(self.speed) < self.slides_above) | remembered
        near = np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5
        near[:reach] = near[-reach:] = True
        return ~near


@functools.lru_cache(maxsize=16)
def low_pass_window(cycle: float) -> np.ndarray:
    """Low-pass of BAND_HZ as a symmetric window (Hamming) of REACH_S to each side; sum 1. Slower cycles hold no more than the band: 1."""
    if cycle * BAND_HZ >= NYQUIST:
        return np.ones(1)
    return firwin(2 * math.ceil(REACH_S / cycle) + 1, BAND_HZ, fs=1.0 / cycle)


def slides_above(axis: Axis) -> float:
    """Speed at the motor from which friction is on its line [rad/s; m/s of a direct drive]."""
    return SLIDING_M_PER_S if axis.drive == "direct" else SLIDING_RAD_PER_S


def axis_run(machine: Machine, axis: Axis, run: MeasuredRun, lateness: dict[str, float] | None = None) -> AxisRun | None:
    """The axis in this run, or None where it has no measured motion.

    `lateness` [s] by signal: how much later than the scale a channel was recorded; it is taken back.
    """
    trace = run.trace
    has = {
        s: trace.has(axis.name, s)
        for s in ("position", "motor_position", "velocity", "velocity_setpoint", "velocity_feedforward", axis.effort)
    }
    if not (has["position"] or has["motor_position"]):
        return None
    cycle = machine.position_cycle
    n = round(cycle / trace.period)
    ticks = round(cycle / machine.base_tick)
    if n < 1 or ticks % n or abs(cycle / trace.period - n) > 1e-3:
        known = ", ".join(f"{cycle / k * 1e3:g}" for k in range(1, ticks + 1) if ticks % k == 0)
        raise InputError(
            f"run {run.name}: sampled every {trace.period * 1e3:g} ms, the position cycle is {cycle * 1e3:g} ms; "
            f"record with a whole number of samples in a position cycle that divides its {ticks} ticks: every {known} ms"
        )
    time = trace.time - trace.time[0]

    def signal(name: str) -> np.ndarray:
        values = trace.get(axis.name, name)
        late = (lateness or {}).get("current" if name == axis.effort else name, 0.0)
        samples = late / trace.period
        if abs(samples - round(samples)) < 1e-6:  # whole samples: no interpolation, a staircase stays one
            return values[np.clip(np.arange(len(values)) + round(samples), 0, len(values) - 1)]
        return CubicSpline(time, values)(np.clip(time + late, 0.0, time[-1]))

    first = _phase(signal("velocity_setpoint"), n) if has["velocity_setpoint"] else 0
    cycles = (len(time) - 1 - first) // n
    at = first + n * np.arange(cycles + 1)
    start = time[at[:-1]]
    middle = start + cycle / 2.0
    setpoint = CubicSpline(time, trace.get(axis.name, "setpoint"))
    motor = signal("motor_position") if has["motor_position"] else signal("position")
    angle = motor[at] / axis.ratio
    if cycles < 3:
        raise InputError(
            f"run {run.name}: {len(time)} samples are {cycles} position cycles; record at least 3 cycles of {cycle * 1e3:g} ms"
        )
    spline = CubicSpline(time[at], angle)
    window = slice(first, first + n * cycles)
    samples = signal(axis.effort)[window] if has[axis.effort] else None
    current = samples.reshape(cycles, n).mean(axis=1) if samples is not None else None
    speed_setpoint = signal("velocity_setpoint")[at[:-1]] / axis.ratio if has["velocity_setpoint"] else None
    two = n >= 2

    def ripple(values: np.ndarray | None) -> np.ndarray | None:
        return measured_ripple(values, n, cycles) if two and values is not None else None

    s = [setpoint(np.clip(start - k * cycle, 0.0, time[-1])) for k in range(3)]
    weight = axis.commissioned_inertia or 0.0
    torque = weight * (s[0] - 2.0 * s[1] + s[2]) / cycle**2 / axis.ratio
    if run.feedforward in ("off", "velocity"):
        torque = np.zeros(cycles)
    limited = np.zeros(cycles, bool)
    if samples is not None:
        limited = (np.abs(samples.reshape(cycles, n)) > 0.97 * axis.motor.peak_current_a).any(axis=1)
        limited |= (_flat(samples, CLIPPED_SAMPLES) | _piled(samples)).reshape(cycles, n).any(axis=1)
    beyond = {}
    for name in ("position", "motor_position", "velocity", "velocity_setpoint"):
        if has[name]:
            beyond[name] = _clipped(signal(name), setpoint(time, 1 if name.startswith("velocity") else 0))
            limited |= beyond[name][window].reshape(cycles, n).any(axis=1)
    pushed, added = (
        known[window].reshape(cycles, n).mean(axis=1) if known is not None else None for known in _known_torques(trace, machine, axis)
    )
    return AxisRun(
        run=run.name,
        feedforward=run.feedforward,
        cycle=cycle,
        samples_per_cycle=n,
        start=start,
        middle=middle,
        setpoint=setpoint,
        end=float(time[-1]),
        position=signal("position")[at[:-1]] if has["position"] else None,
        angle=angle,
        axis_position=spline(middle) * axis.ratio,
        speed=spline(middle, 1),
        acceleration=spline(middle, 2),
        speed_setpoint=speed_setpoint,
        velocity_feedforward=signal("velocity_feedforward")[at[:-1]] if has["velocity_feedforward"] else None,
        motor_at_axis=motor[at[:-1]] if has["motor_position"] else None,
        motor_speed=signal("velocity")[window].reshape(cycles, n).mean(axis=1) / axis.ratio if has["velocity"] else None,
        current=current,
        current_ripple=ripple(samples),
        speed_ripple=ripple(signal("velocity")[window] / axis.ratio if has["velocity"] else None),
        torque_feedforward=torque,
        deflection=(motor - signal("position"))[window].reshape(cycles, n).mean(axis=1)
        if has["motor_position"] and has["position"]
        else None,
        known_load=pushed,
        injected=added,
        slides_above=slides_above(axis),
        limited=limited,
        clipped={name: float(b.sum() * trace.period) for name, b in beyond.items() if b.any()},
    )


def _known_torques(trace: Trace, machine: Machine, axis: Axis) -> tuple[np.ndarray | None, np.ndarray | None]:
    """(sample,) outside load and injected command as torques at the motor [Nm]; None where none is recorded."""
    load = recorded_forces.external_of(trace, axis).sum(axis=1) * axis.ratio if trace.loads(axis.name) else None
    added = recorded_forces.injected(trace, machine) if trace.injections(axis.name) else None
    return load, None if added is None else added[:, machine.axis_names.index(axis.name)]


def _phase(speed_setpoint: np.ndarray, samples_per_cycle: int) -> int:
    """The sample within a cycle at which the speed set point changes; the first where that is not plain."""
    changes = [np.count_nonzero(np.diff(speed_setpoint)[k::samples_per_cycle]) for k in range(samples_per_cycle)]
    most = int(np.argmax(changes))
    return (most + 1) % samples_per_cycle if changes[most] > 2 * sorted(changes)[-2:][0] and samples_per_cycle > 1 else 0


CLIPPED_SAMPLES = 5
"""So many equal samples in a row at a channel's largest value are a limit, not noise."""


PILED_SAMPLES, PILED = 20, 3.0
"""So many samples on a channel's largest value, and so many times as many as on the next one, are a limit, not rounding."""


def _piled(values: np.ndarray) -> np.ndarray:
    """(sample,) True on a largest or smallest value that samples pile up on: a saw-tooth touches a limit for single samples."""
    out = np.zeros(len(values), bool)
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) > 2:
        for end, next_to_it in ((0, 1), (-1, -2)):
            if counts[end] >= max(PILED_SAMPLES, PILED * counts[next_to_it]) and levels[end] != 0.0:
                out |= values == levels[end]
    return out


def _flat(values: np.ndarray, least: int) -> np.ndarray:
    """(sample,) True where a noisy channel stays on its largest or smallest value for `least` samples or more."""
    out = np.zeros(len(values), bool)
    for extreme in (values.max(), values.min()):
        at = values == extreme
        if extreme != 0.0 and at.sum() >= least:
            runs = np.convolve(at, np.ones(least), "same") >= least
            out |= np.convolve(runs, np.ones(least), "same") > 0
    return out


BEYOND_RANGE = 0.02
"""A channel is clipped where the set point goes beyond its largest or smallest value by this share of the set point's range."""


def _clipped(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(sample,) True where a channel is flat at its end while its set point `reference` (sample,) goes on."""
    flat = _flat(values, 4 * CLIPPED_SAMPLES)
    if not flat.any():
        return flat
    # an axis may rest at the end of its way, and a motor encoder count from elsewhere: neither goes on
    reference = reference - np.median(reference - values)
    beyond = np.maximum(reference - values.max(), values.min() - reference) > BEYOND_RANGE * np.ptp(reference)
    # one sample that contradicts says it of its whole stretch: the axis lags behind the set point
    stretch = np.cumsum(np.diff(flat, prepend=False))
    return flat & np.isin(stretch, stretch[flat & beyond])
