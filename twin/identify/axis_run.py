"""Signals of one axis in one run, resampled to the position cycles: the input of the regressions.

The trace has one or several samples per position cycle Tp. Cycle n begins at t_n. Positions at the starts of cycles are free of the
saw-tooth within a cycle, so speed and acceleration at mid-cycle come from these positions alone (cubic spline). The current is the mean
of the cycle's samples; `between_samples` corrects it to the true mean. Regressions filter both sides with the same symmetric window of
finite length. It has no phase lag and reduces the noise in the regressors until their bias is negligible (1e-4 of the acceleration).
A row counts only if the axis slides during its whole window, so reversals, stops and clipped samples do not enter it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import functools
import math

import numpy as np
import scipy
from scipy.interpolate import CubicSpline

from twin.control.position_controller import torque_feedforward_at
from twin.errors import InputError
from twin.identify.between_samples import SETTLED_CYCLES
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation import recorded_forces
from twin.simulation.drive_setpoints import added_to_setpoint
from twin.simulation.position_command import received

BAND_HZ = 20.0
"""Upper frequency limit of the regressions. Below it drive trains are rigid: at the limit a 150 Hz mode adds 0.4 % of the load."""

NYQUIST = 0.4
"""From this product of band and position cycle on, no filter is applied: the sampling leaves almost nothing above the band (limit: 0.5)."""

REACH_S = 0.06
"""Half length of the filter window."""

SLIDING_RAD_PER_S, SLIDING_M_PER_S = 5.0, 8e-3
"""Friction is linear in speed at higher speeds: motor speed of a screw drive (8 mm/s with a 10 mm screw) and speed of a direct drive.
The Stribeck excess has decayed at 4 mm/s. A slow axis slides above SLIDING_SHARE of its highest speed."""

SLIDING_SHARE = 0.1

STROKE_S = 0.5
"""Longer strokes are split into clusters of this length."""


@dataclass(frozen=True)
class AxisRun:
    """Signals of one axis on the position cycles (cycle,), at the motor in SI unless noted otherwise."""

    feedforward: str | None
    cycle: float
    position_cycle: float  # of the position controller; below `cycle` where it computes more than once between two samples
    speed_cycle: float
    samples_per_cycle: int
    start: np.ndarray  # times t_n [s]
    sent: CubicSpline  # set point of the time, axis units
    setpoint: CubicSpline  # the same behind the filters that the machine file lists
    added: np.ndarray  # what tables and backlash values of the control add to it for the position controller, axis units
    position: np.ndarray | None  # scale at t_n, axis units
    angle: np.ndarray  # motor angle at t_n and at the end of the last cycle (cycle + 1,) [rad]
    axis_position: np.ndarray  # at the middle, axis units
    speed: np.ndarray  # at the middle [rad/s]
    acceleration: np.ndarray  # [rad/s2]
    speed_setpoint: np.ndarray | None  # held in the cycle [rad/s]
    velocity_feedforward: np.ndarray | None  # as recorded, held in the cycle, axis units a second
    motor_at_axis: np.ndarray | None  # motor encoder at t_n, axis units
    motor_speed: np.ndarray | None  # mean of the cycle's samples of the speed channel [rad/s]
    current: np.ndarray | None  # mean of the cycle's samples [A]; without a current loop the command [A, V or Nm]
    current_ripple: np.ndarray | None
    speed_ripple: np.ndarray | None
    deflection: np.ndarray | None  # motor minus scale, mean of the cycle's samples: the saw-tooth cancels; axis units
    known_load: np.ndarray  # recorded outside load, mean of the cycle, as torque at the motor towards +q [Nm]
    injected: np.ndarray  # command that a test rig adds, mean of the cycle, as torque at the motor [Nm]
    slides_above: float  # friction is linear in speed at higher speeds [rad/s]
    limited: np.ndarray  # True where the current is at its limit or a channel is clipped
    clipped: dict[str, float]  # signal -> seconds of clipped recording

    def filtered(self, values: np.ndarray) -> np.ndarray:
        """Zero-phase low-pass of (cycle,) values, padded with the end values."""
        window = low_pass_window(self.cycle)
        return np.convolve(np.pad(values, len(window) // 2, "edge"), window, "valid")

    def setpoint_at(self, times: np.ndarray) -> np.ndarray:
        """Set point at any times; constant outside the run."""
        return self.setpoint(np.clip(times, 0.0, self.end))

    def torque_feedforward(self, axis: Axis, delay: float = 0.0) -> np.ndarray:
        """(cycle,) At weight 1 [Nm], 0 in runs without it."""
        if self.feedforward in ("off", "velocity"):
            return np.zeros(len(self.start))
        return torque_feedforward_at(
            lambda ago: self.setpoint_at(self.start - ago), delay, self.position_cycle, control_inertia(axis), axis.ratio
        )

    @property
    def middle(self) -> np.ndarray:
        """(cycle,) t_n + Tp / 2."""
        return self.start + 0.5 * self.cycle

    @property
    def end(self) -> float:
        """Last time of the set points."""
        return float(self.sent.x[-1])

    @property
    def jerk(self) -> np.ndarray:
        """(cycle,) at the middle [rad/s3]."""
        return np.gradient(self.acceleration, self.cycle)

    @property
    def sliding_sign(self) -> np.ndarray:
        """(cycle,) direction of the speed, 0 where the axis hardly moves."""
        return np.sign(self.speed) * (np.abs(self.speed) > 0.1 * self.slides_above)

    @property
    def strokes(self) -> np.ndarray:
        """(cycle,) number of the stroke; a new one begins at each reversal and after every STROKE_S."""
        turned = np.diff(np.sign(self.filtered(self.speed)), prepend=0.0) != 0
        since = np.arange(len(self.speed)) * self.cycle // STROKE_S
        return np.cumsum(turned | (np.diff(since, prepend=0.0) > 0))

    def clusters(self, run: int) -> np.ndarray:
        """(cycle,) strokes with numbers of their own beside those of other runs."""
        return self.strokes + 100_000 * run

    @property
    def sliding(self) -> np.ndarray:
        """(cycle,) True where the axis slides without a limit during the whole filter window."""
        reach = len(low_pass_window(self.cycle)) // 2
        # a limit affects the current between samples for as many cycles as a step does
        remembered = np.convolve(self.limited, np.ones(SETTLED_CYCLES + 1))[: len(self.limited)] > 0.5
        slow = (np.abs(self.speed) < self.slides_above) | remembered
        near = np.convolve(slow, np.ones(2 * reach + 1), "same") > 0.5
        near[:reach] = near[-reach:] = True
        return ~near


Runs = dict[str, list[AxisRun | None]]
"""Axis -> its runs in the order of the campaign; None where the motion of the axis was not measured."""


@functools.lru_cache(maxsize=16)
def low_pass_window(cycle: float) -> np.ndarray:
    """Symmetric low-pass window (Hamming) with cutoff BAND_HZ and half length REACH_S, sum 1; [1] where the cycle is slower than the band."""
    if cycle * BAND_HZ >= NYQUIST:
        return np.ones(1)
    return scipy.signal.firwin(2 * math.ceil(REACH_S / cycle) + 1, BAND_HZ, fs=1.0 / cycle)


def slides_above(axis: Axis) -> float:
    """Friction is linear in speed above this motor speed [rad/s; m/s of a direct drive]."""
    if axis.drive == "direct":
        return min(SLIDING_M_PER_S, SLIDING_SHARE * axis.max_velocity)
    return min(SLIDING_RAD_PER_S, SLIDING_SHARE * axis.max_velocity / axis.ratio)


def control_inertia(axis: Axis) -> float:
    """J_ff [kg m2 at the motor]. Identification starts from a machine that has it written down (`with_commissioned_inertia`)."""
    assert axis.commissioned_inertia is not None
    return axis.commissioned_inertia


def moved_inertia(axis: Axis) -> float:
    """Inertia [kg m2 at the motor] of the moving mass that the machine file states; 0 without one."""
    return (axis.moving_mass_kg or 0.0) * axis.ratio**2


def _signals_of(trace: Trace, axis: Axis, lateness: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Recorded signals (sample,) of an axis by name, each shifted by the lateness of its channel [s]."""
    time, out = trace.time - trace.time[0], {}
    for name, values in ((signal, values) for (of, signal), values in trace.signals.items() if of == axis.name):
        late = lateness.get("current" if name == axis.effort else name, 0.0)
        samples = late / trace.period
        if abs(samples - round(samples)) < 1e-6:  # whole samples: shift without interpolation, so a staircase keeps its edges
            out[name] = values[np.clip(np.arange(len(values)) + round(samples), 0, len(values) - 1)]
        else:
            out[name] = CubicSpline(time, values)(np.clip(time + late, 0.0, time[-1]))
    return out


def _ripple(cycles: np.ndarray) -> np.ndarray | None:
    """Mean course within a cycle of a signal (cycle, sample): the sample at mid-cycle minus the mean of those at its ends; None with one sample a cycle."""
    samples = cycles.shape[1]
    if samples < 2:
        return None
    start, middle = cycles[:, 0], cycles[:, samples // 2]
    return middle - 0.5 * (start + np.append(start[1:], start[-1]))


def axis_run(machine: Machine, axis: Axis, run: MeasuredRun, lateness: dict[str, float] | None = None) -> AxisRun | None:
    """Signals of an axis in a run; None if its motion was not measured.

    `lateness`: signal -> delay [s] of the channel against the scale, which is corrected. Raises InputError for an unsuitable sample period.
    """
    trace, cycle = run.trace, cycle_of(machine, axis, run.trace.period)
    signals = _signals_of(trace, axis, lateness or {})
    position, encoder = signals.get("position"), signals.get("motor_position")
    motor = encoder if encoder is not None else position
    if motor is None:
        return None
    bounds = _cycle_bounds(machine, run, signals.get("velocity_setpoint"), cycle)

    def cycles(values: np.ndarray) -> np.ndarray:
        """(cycle, sample) of a signal (sample,)."""
        return values[bounds[0] : bounds[-1]].reshape(len(bounds) - 1, -1)

    recorded = {name: cycles(values) for name, values in signals.items()}
    starts, means = {n: table[:, 0] for n, table in recorded.items()}, {n: table.mean(axis=1) for n, table in recorded.items()}

    def at_motor(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values / axis.ratio

    def ripple(name: str, ratio: float = 1.0) -> np.ndarray | None:
        return _ripple(recorded[name] / ratio) if name in recorded else None

    time = trace.time - trace.time[0]
    start = time[bounds[:-1]]
    middle = start + 0.5 * cycle
    recorded_setpoint = CubicSpline(time, trace.get(axis.name, "setpoint"))
    setpoint = _behind_filters(machine, axis, recorded_setpoint)
    angle = motor[bounds] / axis.ratio
    spline = CubicSpline(time[bounds], angle)
    beyond = _beyond(axis, signals, recorded_setpoint)
    injected = recorded_forces.injected(trace, machine)
    return AxisRun(
        feedforward=run.feedforward,
        cycle=cycle,
        position_cycle=machine.position_cycle,
        speed_cycle=machine.speed_cycle,
        samples_per_cycle=int(bounds[1] - bounds[0]),
        start=start,
        sent=recorded_setpoint,
        setpoint=setpoint,
        added=_added(machine, axis, setpoint(start), cycle),
        position=starts.get("position"),
        angle=angle,
        axis_position=spline(middle) * axis.ratio,
        speed=spline(middle, 1),
        acceleration=spline(middle, 2),
        speed_setpoint=at_motor(starts.get("velocity_setpoint")),
        velocity_feedforward=starts.get("velocity_feedforward"),
        motor_at_axis=starts.get("motor_position"),
        motor_speed=at_motor(means.get("velocity")),
        current=means.get(axis.effort),
        current_ripple=ripple(axis.effort),
        speed_ripple=ripple("velocity", axis.ratio),
        deflection=cycles(encoder - position).mean(axis=1) if encoder is not None and position is not None else None,
        known_load=cycles(recorded_forces.external_of(trace, axis).sum(axis=1) * axis.ratio).mean(axis=1),
        injected=np.zeros(len(start)) if injected is None else cycles(injected[:, machine.axis_names.index(axis.name)]).mean(axis=1),
        slides_above=slides_above(axis),
        limited=np.any([cycles(values).any(axis=1) for values in beyond.values()], axis=0) if beyond else np.zeros(len(start), bool),
        clipped={n: float(values.sum() * trace.period) for n, values in beyond.items() if n != axis.effort and values.any()},
    )


def behind_blocks(machine: Machine, axis: Axis, run: AxisRun) -> AxisRun:
    """A run with its set points behind the blocks of this axis."""
    setpoint = _behind_filters(machine, axis, run.sent)
    return replace(run, setpoint=setpoint, added=_added(machine, axis, setpoint(run.start), run.cycle))


def _added(machine: Machine, axis: Axis, setpoint: np.ndarray, cycle: float) -> np.ndarray:
    """What tables and backlash values add to the set point (cycle,); none where not each cycle of the control is recorded."""
    return added_to_setpoint(axis, machine, setpoint) if cycle == machine.position_cycle else np.zeros(len(setpoint))


def _behind_filters(machine: Machine, axis: Axis, setpoint: CubicSpline) -> CubicSpline:
    """The set point behind the filters that the machine file lists."""
    if not any(b.block.kernel for b in axis.blocks):
        return setpoint
    return CubicSpline(setpoint.x, received(machine, axis, lambda ago: setpoint(np.maximum(setpoint.x - ago, 0.0)), 0.0))


def cycle_of(machine: Machine, axis: Axis, period: float) -> float:
    """The cycle of the rows: that of the position controller, or the sample period where a control with an ideal actuator is recorded every few cycles.

    Then no model of a current loop needs what it does between two samples.
    """
    cycle = machine.position_cycle
    skipped = round(period / cycle)
    return period if skipped > 1 and abs(period / cycle - skipped) < 1e-3 and not axis.actuator.winding else cycle


def _cycle_bounds(machine: Machine, run: MeasuredRun, speed_setpoint: np.ndarray | None, cycle: float) -> np.ndarray:
    """(cycle + 1,) First sample of each position cycle of a run, and the sample after the last one.

    Raises InputError if they have no whole number of samples, or if there are fewer than three.
    """
    period = run.trace.period
    n = round(cycle / period)
    ticks = round(cycle / machine.base_tick)
    if n < 1 or ticks % n or abs(cycle / period - n) > 1e-3:
        known = ", ".join(f"{cycle / k * 1e3:g}" for k in range(1, ticks + 1) if ticks % k == 0)
        raise InputError(
            f"run {run.name}: sampled every {period * 1e3:g} ms, the position cycle is {cycle * 1e3:g} ms; "
            f"record with a whole number of samples in a position cycle that divides its {ticks} ticks: every {known} ms"
        )
    first = _phase(speed_setpoint, n)
    samples = len(run.trace.time)
    cycles = (samples - 1 - first) // n
    if cycles < 3:
        raise InputError(f"run {run.name}: {samples} samples are {cycles} position cycles; record at least 3 cycles of {cycle * 1e3:g} ms")
    return first + n * np.arange(cycles + 1)


def _beyond(axis: Axis, signals: Mapping[str, np.ndarray], setpoint: CubicSpline) -> dict[str, np.ndarray]:
    """Signal -> (sample,) True where the effort is at its limit or another channel is clipped."""
    out = {}
    if (effort := signals.get(axis.effort)) is not None:
        out[axis.effort] = (np.abs(effort) > 0.97 * axis.motor.peak_current_a) | _flat(effort, CLIPPED_SAMPLES) | _piled(effort)
    for name in ("position", "motor_position", "velocity", "velocity_setpoint"):
        if name in signals:
            out[name] = _clipped(signals[name], setpoint(setpoint.x, 1 if name.startswith("velocity") else 0))
    return out


def _phase(speed_setpoint: np.ndarray | None, samples_per_cycle: int) -> int:
    """Index of the sample within a cycle where the speed set point changes; 0 if it cannot be determined."""
    if speed_setpoint is None or samples_per_cycle == 1:
        return 0
    changes = [np.count_nonzero(np.diff(speed_setpoint)[k::samples_per_cycle]) for k in range(samples_per_cycle)]
    most = int(np.argmax(changes))
    return (most + 1) % samples_per_cycle if changes[most] > 2 * sorted(changes)[-2] else 0


CLIPPED_SAMPLES = 5
"""This many equal samples in a row at a channel's largest value indicate a limit, not noise."""

PILED_SAMPLES, PILED = 20, 3.0
"""A limit: at least PILED_SAMPLES samples on a channel's largest value, and at least PILED times as many as on the next level."""


def _piled(values: np.ndarray) -> np.ndarray:
    """(sample,) True at a largest or smallest value that many samples share; a saw-tooth touches a limit with single samples only."""
    out = np.zeros(len(values), bool)
    levels, counts = np.unique(values, return_counts=True)
    if len(levels) > 2:
        for end, next_to_it in ((0, 1), (-1, -2)):
            if counts[end] >= max(PILED_SAMPLES, PILED * counts[next_to_it]) and levels[end] != 0.0:
                out |= values == levels[end]
    return out


def _flat(values: np.ndarray, least: int) -> np.ndarray:
    """(sample,) True where a noisy channel stays at its largest or smallest value for `least` samples or more."""
    out = np.zeros(len(values), bool)
    for extreme in (values.max(), values.min()):
        at = values == extreme
        if extreme != 0.0 and at.sum() >= least:
            runs = np.convolve(at, np.ones(least), "same") >= least
            out |= np.convolve(runs, np.ones(least), "same") > 0
    return out


BEYOND_RANGE = 0.02
"""A channel is clipped if the set point exceeds its largest or smallest value by this share of the set point's range."""


def _clipped(values: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(sample,) True where a channel is flat at an extreme value while its set point `reference` (sample,) moves beyond it."""
    flat = _flat(values, 4 * CLIPPED_SAMPLES)
    if not flat.any():
        return flat
    # Remove the offset of the zero points. An axis that rests at the end of its travel is not clipped: its set point rests, too.
    reference = reference - np.median(reference - values)
    beyond = np.maximum(reference - values.max(), values.min() - reference) > BEYOND_RANGE * np.ptp(reference)
    # one sample beyond the range marks its whole flat stretch as clipped, because the axis lags behind the set point
    stretch = np.cumsum(np.diff(flat, prepend=False))
    return flat & np.isin(stretch, stretch[flat & beyond])
