"""Two methods that fit numbers through the twin's own simulation of one axis: least squares, and an evolution strategy as in PACE.

Least squares (scipy `least_squares`, trust region, Jacobian by differences): all numbers of the axis and of its loops, residuals of all
recorded signals over their noise, intervals from the Jacobian and the scatter of the residual, as `curve_fit` documents them.

PACE (Bjelonic and others 2025): CMA-ES over inertia (armature), viscous friction, Coulomb friction, the bias of the encoder and one delay,
each normalised to -1 to 1 between bounds; the objective is the mean square of the position alone, or of the effort of an axis whose path is its
own recorded motion. It claims no interval.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.control.actuator import EFFORTS
from twin.errors import TwinError
from twin.machine.machine import Machine
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.gap import compared_signals, is_moving, sensor_noise
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.recorded_times import at_times, simulated_period
from twin.simulation.run import SimulationJob, all_or_raise, simulate_each
from twin.simulation.setpoints import recorded_setpoints

from .answer import Answer
from .inputs import Input
from .numbers import numbers_of, sizes_of, with_numbers

EVALUATIONS = 600
"""Simulations of all runs that the evolution strategy may use."""

WORST = 1e3
"""Residual of numbers that cannot be simulated, in times the size of the signal."""


class AxisSimulation:
    """The fitted runs of one axis, simulated with other numbers: difference from the record, by signal, over the noise of its sensor."""

    def __init__(self, one: Input) -> None:
        self.one = one
        (self.axis,) = one.machine.axes
        self.setpoints = [recorded_setpoints(run.trace, one.machine) for run in one.fitted]
        self.motions = [nominal_motion(one.machine, s) for s in self.setpoints]
        traces = [run.trace for run in one.fitted]
        compared = compared_signals(traces[0], self.axis)
        # beside a scale the motor encoder is left out: its zero and the errors of the screw would be taken for errors of the numbers
        self.signals = [s for s in compared if s != "motor_position" or "position" not in compared]  # a position is the first
        self.rows = {
            s: [is_moving(t, self.axis) if s == self.axis.effort else np.ones(len(t.time), bool) for t in traces] for s in self.signals
        }

    def difference(self, machine: Machine, signals: Sequence[str] | None = None) -> dict[str, np.ndarray]:
        """Measured minus simulated (sample of all runs,), SI."""
        jobs = []
        for run, setpoints, motion in zip(self.one.fitted, self.setpoints, self.motions):
            plant = lambda change, motion=motion: DecoupledPlant(change, motion)  # noqa: E731
            period = simulated_period(machine, run.trace.period)
            jobs.append(SimulationJob(machine.with_feedforward(run.feedforward), setpoints, plant, period, run.started_at))
        simulated = [at_times(run.trace, one.trace.time) for run, one in zip(all_or_raise(simulate_each(jobs)), self.one.fitted)]
        return {
            s: np.concatenate(
                [
                    (run.trace.get(self.axis.name, s) - t.get(self.axis.name, s))[kept]
                    for run, t, kept in zip(self.one.fitted, simulated, self.rows[s])
                ]
            )
            for s in signals or self.signals
        }

    def in_noise(self, machine: Machine) -> np.ndarray:
        """All signals over the noise of their sensors, one after the other."""
        found = self.difference(machine)
        return np.concatenate([found[s] / max(sensor_noise(machine, self.axis, s), 1e-9) for s in self.signals])


def least_squares_fit(one: Input) -> Answer:
    """All numbers of the axis by least squares."""
    from scipy.optimize import least_squares

    simulation, start = AxisSimulation(one), numbers_of(one.machine)
    names, sizes = list(start), sizes_of(start)

    def machine_of(x: np.ndarray) -> Machine:
        return with_numbers(one.machine, {n: start[n] + float(d) * sizes[n] for n, d in zip(names, x)})

    def residual(x: np.ndarray) -> np.ndarray:
        return simulation.in_noise(machine_of(x))

    far = np.array([3.0 if n == "constant_force" else 0.8 for n in names])
    found = least_squares(residual, np.zeros(len(names)), bounds=(-far, far), diff_step=1e-3, x_scale="jac", max_nfev=30)
    rows = len(found.fun)
    scatter = float(found.fun @ found.fun) / (rows - len(names))
    half = 1.96 * np.sqrt(np.diag(scatter * np.linalg.pinv(found.jac.T @ found.jac)))
    values = {n: start[n] + float(d) * sizes[n] for n, d in zip(names, found.x)}
    intervals = {n: (values[n], values[n] - h * sizes[n], values[n] + h * sizes[n]) for n, h in zip(names, half.tolist())}
    return Answer(machine_of(found.x), intervals, found.message)


def evolution_fit(one: Input) -> Answer:
    """Inertia, friction, bias of the encoder and delay by CMA-ES on the position, or on the effort where no position can be compared."""
    import cma

    simulation, start = AxisSimulation(one), numbers_of(one.machine)
    signal = simulation.signals[0]
    delays = {n: start[n] for n in start if n.endswith("delay_s")}
    names = ["inertia", "viscous_friction", "coulomb_friction"]
    measured = np.concatenate([run.trace.get(one.axis, signal) for run in one.fitted])
    bias_bound, delay_bound = 0.0 if signal in EFFORTS else 1e-4, 2e-3  # m or rad, s

    def machine_of(x: Sequence[float]) -> Machine:
        values = {n: start[n] * (1.0 + 0.8 * v) for n, v in zip(names, x)}
        return with_numbers(one.machine, values | {n: max(d + delay_bound * x[4], 1e-6) for n, d in delays.items()})

    def mean_square(x: Sequence[float]) -> float:
        try:
            difference = simulation.difference(machine_of(x), [signal])[signal]
        except TwinError:
            return float(np.mean(measured**2)) * WORST
        return float(np.mean((difference - bias_bound * x[3]) ** 2)) * 1e12

    options = {"bounds": [-1, 1], "maxfevals": EVALUATIONS, "seed": 1, "verbose": -9, "tolfun": 1e-6}
    best, strategy = cma.fmin2(mean_square, [0.0] * 5, 0.5, options)
    return Answer(machine_of(best), dict.fromkeys(names), f"stopped by {', '.join(strategy.stop()) or 'its budget'}")
