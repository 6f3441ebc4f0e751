"""The nominal motion of a machine along set points: about it the decoupled plant evaluates inertia, gravity and coupling."""

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.recorded_times import at_times, simulated_period
from twin.simulation.run import SimulationJob, simulate
from twin.simulation.setpoints import Setpoints, recorded_setpoints


def nominal_motion(machine: Machine, setpoints: Setpoints) -> Motion:
    """The motion of all axes along the set points.

    The position of a linear axis is its delayed set point. Inertia and gravity depend on the rotary axes, so their motion is simulated with
    the decoupled plant along the delayed set points. Raises SimulationError if a rotary axis diverges.
    """
    times = np.arange(len(setpoints.position)) * setpoints.period
    position = setpoints.position.copy()
    for a, axis in enumerate(machine.axes):
        # lag: the delays and, without feedforward, 1 / Kv
        loops = axis.loops
        lag = loops.set_point_delay_s + (1.0 - min(loops.velocity_feedforward, 1.0)) / loops.position_gain_per_s
        position[:, a] = setpoints.at(times - lag)[:, a]
    motion = motion_of(position, setpoints.period)
    rotary = tuple(a for a, axis in enumerate(machine.axes) if axis.kind == "rotary")
    if rotary and np.ptp(setpoints.position[:, rotary], axis=0).max() > 1e-4:
        nominal = simulate(
            machine.with_axes([machine.axis_names[a] for a in rotary]),
            setpoints.part(rotary),
            sample_period=simulated_period(machine, setpoints.period),
            plant_of=lambda change: DecoupledPlant(change, motion.part(rotary)),
        )
        position[:, rotary] = at_times(nominal.trace, times).matrix("position", nominal.trace.axes)
        motion = motion_of(position, setpoints.period)
    return motion


def recorded_job(machine: Machine, run: MeasuredRun, motion: Motion | None = None, noise_seed: int | None = None) -> SimulationJob:
    """A measured run, to be simulated in the decoupled plant along this motion of its axes (default: the nominal one)."""
    actual, setpoints = machine.with_feedforward(run.feedforward), recorded_setpoints(run.trace, machine)
    along = motion or nominal_motion(actual, setpoints)
    period = simulated_period(machine, run.trace.period, run.ballbar)
    return SimulationJob(actual, setpoints, lambda change: DecoupledPlant(change, along), period, run.started_at, noise_seed)


def motion_of(position: np.ndarray, period: float) -> Motion:
    """The motion of positions (sample, axis) at a period [s]."""
    speed = np.gradient(position, period, axis=0)
    return Motion(position, speed, np.gradient(speed, period, axis=0), period)
