"""The sim-to-real gap: simulate every run of a campaign and compare signal by signal.

The prediction is the mean of a few simulations with measuring noise in the loop, recorded without noise. The noise that the control sees
moves an axis that is about to stick. `noise` is the gap of measuring noise alone:
each realisation against the mean of the others, plus the noise of the sensors. `own_noise` is one realisation against the mean of very many.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from twin.control.actuator import EFFORTS
from twin.control.speed_controller import differentiation
from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.roughness import quiet_noise
from twin.recordings.trace import ENCODERS, OTHER_UNITS, POSITIONS, SPEEDS, Trace
from twin.simulation.decoupled_plant import Motion
from twin.simulation.motor_and_scale import with_equal_means
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.nominal_motion import recorded_job
from twin.simulation.recorded_times import as_recorded
from twin.simulation.run import all_or_raise, simulate_each
from twin.simulation.setpoints import AT_REST, check_travel
from twin.system import cores
from twin.units import AXIS_UNITS

COMPARED = ("position", "motor_position", "velocity", "current", "voltage", "torque")
"""Compared signals. Of the last three, only the output of the axis' speed controller is compared."""

REALISATIONS = 4
"""Number of simulations with noise in the loop for mean and scatter."""

LEAST_NOISE = {"position": 1e-9, "motor_position": 1e-9, "velocity": 1e-7, "current": 1e-4}
"""Smallest noise of a record, SI."""

LEAST_COMMAND = 1e-4
"""Resolution of a command, as a fraction of its limit: that of a converter."""


@dataclass(frozen=True)
class SignalGap:
    """Gap of one signal of one axis in one run, in `unit`: RMS, maximum, RMS of noise alone, and that without the noise of the prediction.

    `times_noise_moving` is the gap over noise while the set point moves, or of the whole run for an axis that rests. Where an axis sticks after a
    motion depends on its history.
    """

    rms: float
    max: float
    noise: float
    own_noise: float
    unit: str
    times_noise_moving: float

    @property
    def is_compared(self) -> bool:
        """Whether there were samples to compare: the effort of a resting axis has none."""
        return self.rms > 0.0

    @property
    def times_noise(self) -> float:
        """RMS of the whole run over noise; 0 without noise."""
        return self.rms / self.noise if self.noise > 0.0 else 0.0


@dataclass(frozen=True)
class Prediction:
    """Prediction of a run: mean trace of the positions and of what was recorded, and the scatter (sample,) of each (axis, signal) due to noise, SI.

    `error` is the share of the squared scatter that is the error of the mean.
    """

    trace: Trace
    scatter: dict[tuple[str, str], np.ndarray]
    error: float


def predict(
    machine: Machine, run: MeasuredRun, realisations: int = REALISATIONS, motion: Motion | None = None, engine: bool = True
) -> Prediction:
    """Simulate a measured run's set points; scatter (sample,) is the standard deviation between noise realisations.

    MuJoCo simulates one realisation. The decoupled plant along the `motion` of the axes (default: their nominal motion) gives the differences of
    the other realisations, which agree with those of MuJoCo, in a tenth of the time. Without `engine`, all come from the decoupled plant.
    """
    job = recorded_job(machine, run, motion)
    check_travel(job.setpoints, machine, f"run {run.name}")
    jobs = [job._replace(plant_of=MujocoPlant, noise_seed=0)] if engine else []
    if realisations > 1 or not engine:
        jobs += [job._replace(noise_seed=i) for i in range(realisations)]
    traces = [as_recorded(simulated.without_noise, run.trace.time, run.ballbar) for simulated in all_or_raise(simulate_each(jobs))]
    by_engine = traces.pop(0) if engine and len(traces) > 1 else None
    signals, scatter, error = {}, {}, 1.0 / max(realisations, 2)
    for key in [key for key in traces[0].signals if key in run.trace.signals or key[1] in POSITIONS]:
        stack = np.stack([trace.signals[key] for trace in traces])
        signals[key] = stack.mean(axis=0)
        if by_engine is not None:
            signals[key] += by_engine.signals[key] - stack[0]
        # deviation of one realisation from the mean of the others: var (1 + 1 / (n - 1)) = var / (1 - 1 / n)
        spread = stack.std(axis=0, ddof=1) if realisations > 1 else np.zeros_like(signals[key])
        scatter[key] = spread / np.sqrt(1.0 - error)
    return Prediction(with_equal_means(Trace(run.trace.time, signals, machine.kinds), machine, run.own_zeros), scatter, error)


class Job(NamedTuple):
    """Arguments of `predict`."""

    machine: Machine
    run: MeasuredRun
    realisations: int = REALISATIONS
    motion: Motion | None = None
    engine: bool = True


def predict_campaign(
    machine: Machine, runs: Sequence[MeasuredRun], *, realisations: int = REALISATIONS, progress: Callable[[str], None] | None = None
) -> dict[str, Prediction]:
    """`predict` for several runs on all cores; the result does not depend on the number of workers."""
    predictions = predict_each([Job(machine, run, realisations) for run in runs], progress=progress)
    return {run.name: prediction for run, prediction in zip(runs, predictions)}


def predict_each(jobs: Sequence[Job], *, threads: int | None = None, progress: Callable[[str], None] | None = None) -> list[Prediction]:
    """`predict` for all jobs, in order. The longest jobs start first, to balance the load."""
    order = sorted(range(len(jobs)), key=lambda i: -len(jobs[i].run.trace.time) * jobs[i].realisations)
    results: dict[int, Prediction] = {}
    with ThreadPoolExecutor(threads or cores()) as pool:
        for i, prediction in zip(order, pool.map(lambda i: predict(*jobs[i]), order)):
            results[i] = prediction
            if progress:
                progress(jobs[i].run.name)
    return [results[i] for i in range(len(jobs))]


def compared_signals(trace: Trace, axis: Axis) -> list[str]:
    """Recorded signals of an axis that are compared; of the efforts only the axis' own, and only this along a path that is the recorded motion itself."""
    out = [s for s in COMPARED if trace.has(axis.name, s) and (s not in EFFORTS or s == axis.effort)]
    return [s for s in out if s in EFFORTS] if trace.follows_itself(axis.name) else out


def check_compared(campaign: Campaign, machine: Machine) -> None:
    """Raise InputError if no signal of any run is compared with the twin."""
    traces = [run.trace for run in campaign.runs]
    if any(compared_signals(trace, axis) for trace in traces for axis in machine.axes):
        return
    if any(trace.follows_itself(axis) for trace in traces for axis in trace.axes):
        raise InputError(
            f"{campaign.path}: nothing to compare: the set points are the recorded motion itself, and no force of a motor is recorded; "
            "record the set point, or a current or torque"
        )
    raise InputError(f"{campaign.path}: no run holds a measured signal ({', '.join(COMPARED)}); record at least the position")


def gap_of(machine: Machine, run: MeasuredRun, prediction: Prediction) -> dict[str, dict[str, SignalGap]]:
    """Gap by axis and signal, for the signals of the run. Where the machine file does not give the noise of a signal, the fine changes in the quiet
    stretches of its record count as noise: it cannot be larger."""
    table: dict[str, dict[str, SignalGap]] = {}
    for axis in machine.axes:
        if axis.name not in run.trace.axes:
            continue
        signals = {}
        # an effort is compared in motion only, which needs set points; the other signals of an axis without them count over the whole run
        known = run.trace.has(axis.name, "setpoint") or run.trace.has(axis.name, axis.effort)
        in_motion = is_moving(run.trace, axis) if known else np.zeros(len(run.trace.time), bool)
        for signal in compared_signals(run.trace, axis):
            difference = run.trace.get(axis.name, signal) - prediction.trace.get(axis.name, signal)
            scatter = prediction.scatter[axis.name, signal]
            moving = in_motion
            if signal in EFFORTS:
                difference, scatter, moving = difference[moving], scatter[moving], moving[moving]
            if not moving.any():
                moving = ~moving
            unit, factor = gap_unit(axis, signal)
            given = sensor_noise(machine, axis, signal)
            at_most = 0.0 if given else math.sqrt(quiet_noise(run.trace.get(axis.name, signal))[0])
            sensor = max(given, at_most, LEAST_NOISE.get(signal, 0.0))
            if signal == "position" and run.ballbar is not None and axis.name in run.ballbar.axes:
                sensor = math.sqrt(_mean_square(run.ballbar.noise_of(axis.name)))
            noise, own_noise = (np.sqrt(share * _mean_square(scatter) + sensor**2) for share in (1.0, 1.0 - prediction.error))
            largest = float(np.abs(difference).max()) if difference.size else 0.0
            noise_moving = np.sqrt(_mean_square(scatter[moving]) + sensor**2)
            signals[signal] = SignalGap(
                float(np.sqrt(_mean_square(difference)) * factor),
                largest * factor,
                float(noise * factor),
                float(own_noise * factor),
                unit,
                float(np.sqrt(_mean_square(difference[moving])) / noise_moving) if noise_moving > 0.0 else 0.0,
            )
        table[axis.name] = signals
    return table


def gap_unit(axis: Axis, signal: str) -> tuple[str, float]:
    """Display unit of a difference of signals and factor from SI: um or arcsec, mm/s or deg/s; A, V, Nm or N, or the unit in which a lumped machine has its forces."""
    if signal in POSITIONS:
        return AXIS_UNITS[axis.kind].error
    if signal in SPEEDS:
        return AXIS_UNITS[axis.kind].speed
    return (axis.effort_unit if signal == axis.effort else axis.motor_unit if OTHER_UNITS[signal] == "Nm" else OTHER_UNITS[signal], 1.0)


def is_moving(trace: Trace, axis: Axis) -> np.ndarray:
    """Mask (sample,) of a moving set point; an axis that the trace does not have stands still.

    Only there the current or command is compared: that of a sticking axis depends on its history.
    """
    if axis.name not in trace.axes:
        return np.zeros(len(trace.time), bool)
    return np.abs(np.gradient(trace.get(axis.name, "setpoint"), trace.period)) > AT_REST[axis.kind]


def sensor_noise(machine: Machine, axis: Axis, signal: str) -> float:
    """Standard deviation of a sensor, with quantisation [SI].

    Where the machine has no current loop, the gains amplify an encoder step into the effort, K (1 / (n Ts) + Kv) step, and it has the noise of its
    own that its record shows.
    """
    noise = machine.noise(axis)
    if signal == axis.effort and not axis.actuator.winding:
        commissioned = axis.commissioned_torque_constant
        gain = axis.loops.speed_gain_nm_s_per_rad / (commissioned * axis.ratio)
        n, rate = differentiation(axis.loops, machine.speed_cycle)
        steps = (noise.motor_resolution * rate if n else noise.speed) + axis.loops.position_gain_per_s * (
            noise.motor_resolution if axis.encoder == "motor" else noise.position_resolution
        )
        amplified = max(gain * steps / float(np.sqrt(12.0)), LEAST_COMMAND * axis.motor.peak_current_a)
        return float(np.hypot(amplified, noise.current))
    return noise.total({"motor_position": "motor", "velocity": "speed"}.get(signal, signal))


def encoders_noise(machine: Machine, axis: Axis) -> float:
    """Standard deviation of motor encoder minus scale due to the sensors [m, rad]."""
    return max(math.hypot(*(sensor_noise(machine, axis, signal) for signal in ENCODERS)), LEAST_NOISE["position"])


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(values**2)) if values.size else 0.0
