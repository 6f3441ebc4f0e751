"""A measured run as the diagnosis uses it: trace, machine of this run, nominal motion."""

from dataclasses import dataclass, field
import functools

import numpy as np

from twin.control.position_controller import feedforward_at
from twin.diagnose.settings import T
from twin.effects import with_effects
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import Motion
from twin.simulation.gap import encoders_noise, is_moving
from twin.simulation.motor_and_scale import has_both, motor_minus_scale
from twin.simulation.nominal_motion import nominal_motion
from twin.simulation.position_command import received
from twin.simulation.recorded_times import SAME_PERIOD, simulated_period
from twin.simulation.setpoints import Setpoints, recorded_setpoints


@dataclass(frozen=True, kw_only=True)
class RunView(MeasuredRun):
    """A measured run with the machine of this run and its nominal motion."""

    machine: Machine  # with this run's feedforward
    setpoints: Setpoints  # all axes of the machine
    motion: Motion  # nominal motion of all axes
    file: Machine  # machine file without effects, with its own feedforward
    references: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=dict, repr=False)
    set_points: dict[tuple[str, float], np.ndarray] = field(default_factory=dict, repr=False)

    def reference(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Velocity feedforward, delayed set point, and whether the axis moves or is pushed, each (sample,); cached."""
        if name not in self.references:
            axis = self.machine.axis(name)
            moving = np.ones(len(self.trace.time), bool) if name in self.pushed else is_moving(self.trace, axis)
            self.references[name] = _command(self, axis), self.set_point(axis, axis.loops.position_delay_s), moving
        return self.references[name]

    def set_point(self, axis: Axis, delay: float) -> np.ndarray:
        """Set point (sample,) that the control of an axis uses after a delay [s]; cached."""
        if (axis.name, delay) not in self.set_points:
            own, times = self.setpoints.part((self.machine.axis_names.index(axis.name),)), self.trace.time - self.trace.time[0]
            self.set_points[axis.name, delay] = received(self.machine, axis, lambda ago: own.at(times - ago)[:, 0], delay)
        return self.set_points[axis.name, delay]

    def rows_of(self, name: str, channel: str) -> np.ndarray:
        """Mask (sample,) of the samples that a channel of an axis holds: where the axis moves, at the readings of its ballbar, at position cycles, or all."""
        if channel in ("motor_minus_scale", "current"):
            return self.reference(name)[2]
        if channel == "position" and self.ballbar is not None and name in self.ballbar.axes:
            return self.ballbar.readings_of(name)
        mask = np.zeros(len(self.trace.time), bool)
        mask[:: self.samples_per_cycle if channel == "controller" else 1] = True
        return mask

    @functools.cached_property
    def pushed(self) -> frozenset[str]:
        """Axes with a constant set point whose motor minus scale follows the motion of another axis."""
        return frozenset(name for name in self.trace.axes if _follows_another(self, name))

    @functools.cached_property
    def on_own_path(self) -> frozenset[str]:
        """Axes whose set point is their own recorded motion."""
        return frozenset(name for name in self.trace.axes if self.trace.follows_itself(name))

    @functools.cached_property
    def on_cycles(self) -> bool:
        """Is the sample period a divisor or a multiple of the position cycle? Only then are the samples of the controllers recorded."""
        period, cycle = self.trace.period, self.machine.position_cycle
        cycles = max(period / cycle, cycle / period)
        return simulated_period(self.machine, period) == period and abs(cycles / round(cycles) - 1.0) < SAME_PERIOD

    @property
    def on_each_cycle(self) -> bool:
        """Is there a sample for each position cycle? A slower record lacks speed set points."""
        return self.on_cycles and self.trace.period < self.machine.position_cycle * (1.0 + SAME_PERIOD)

    @property
    def samples_per_cycle(self) -> int:
        """Samples per position cycle, at least 1."""
        return max(1, round(self.machine.position_cycle / self.trace.period))

    def moves(self, name: str) -> bool:
        """Does the axis move in this run, by its own set point or pushed by another axis?"""
        return self.trace.moves(name) or name in self.pushed


def view_of(machine: Machine, run: MeasuredRun) -> RunView:
    """A run with the nominal motion about which the decoupled plant is linearised."""
    actual = with_effects(machine.with_feedforward(run.feedforward), [])
    setpoints = recorded_setpoints(run.trace, actual)
    return RunView(**vars(run), machine=actual, setpoints=setpoints, motion=nominal_motion(actual, setpoints), file=machine)


def _follows_another(view: RunView, name: str) -> bool:
    trace = view.trace
    if trace.moves(name) or not has_both(trace, name):
        return False
    moving = [other for other in trace.axes if trace.moves(other)]
    apart = motor_minus_scale(trace, name)
    apart = apart - apart.mean()
    if not moving or float(np.std(apart)) < T.outlier * encoders_noise(view.machine, view.machine.axis(name)):
        return False
    columns = np.column_stack([np.ones(len(apart)), *(trace.get(other, "setpoint") for other in moving)])
    residual = apart - columns @ np.linalg.lstsq(columns, apart, rcond=None)[0]
    return float(residual @ residual) < (1.0 - T.nearly_all) * float(apart @ apart)


def _command(view: RunView, axis: Axis) -> np.ndarray:
    """Velocity feedforward at the sample times (sample,) [axis units per second]."""
    tp, d = view.machine.position_cycle, axis.loops.feedforward_delay_s
    if axis.loops.velocity_feedforward == 0.0:
        return np.zeros(len(view.trace.time))
    own = view.setpoints.part((view.machine.axis_names.index(axis.name),))
    added = own.held(own.added_feedforward, view.trace.time - view.trace.time[0])
    slope = feedforward_at(functools.partial(view.set_point, axis), d, tp)
    return axis.loops.velocity_feedforward * slope + (added[:, 0] if isinstance(added, np.ndarray) else added)


def rests(view: RunView, name: str, after_s: float, shortest_s: float = 0.0) -> np.ndarray:
    """Mask (sample,): the axis rests, or broke away less than `after_s` ago; rests shorter than `shortest_s` do not count.

    On the circle of a ballbar no axis counts as resting: the circle continues while one axis reverses, and the bar measures it.
    """
    if view.ballbar is not None:
        return np.zeros(len(view.trace.time), bool)
    moving = view.reference(name)[2]
    edges = np.diff(moving.astype(int), prepend=1, append=1)
    stopped, started = np.flatnonzero(edges == -1), np.flatnonzero(edges == 1)
    resting = np.zeros(len(moving), bool)
    for first, last in zip(stopped, started):
        if (last - first) * view.trace.period >= shortest_s:
            resting[first : last + round(after_s / view.trace.period)] = True
    return resting
