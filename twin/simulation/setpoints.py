"""Set points of the axes as continuous functions of time, made from samples of any constant period.

A cubic spline interpolates the samples; its acceleration is continuous, so interpolation adds no jerk steps. Before the first sample and
after the last one the axes stand still. A recording that begins in motion gets a lead-in: the axes accelerate from rest to their speed at
the first sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import functools
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation import recorded_forces
from twin.simulation.added_feedforward import added_feedforward
from twin.simulation.motor_and_scale import deflection_at_start
from twin.units import AXIS_UNITS

_OVERLAP = 40
"""Samples beyond each end of a stretch that its spline includes. The influence of a sample decays by 0.27 per sample, here to 1e-23."""

_KEEP_SPLINE = 100_000
"""Longest run, in samples, whose spline is kept."""

_MAX_DELAYS = 64
"""Largest number of delays with cached positions."""

_MAX_COMMANDS = 8
"""Largest number of cached commands of a whole run."""

TRAVEL_TOLERANCE = 1e-9
"""Distance beyond the travel that counts as rounding [m or rad]."""

LEAD_S = 0.4
UP_TO_SPEED = 0.6
"""Shortest lead-in [s], and the fraction of it that accelerates. The transient decays in the rest."""

AT_REST = {"linear": 0.2e-3, "rotary": np.deg2rad(0.2)}
"""Largest speed of the set point of an axis at rest [m/s, rad/s]."""


class Command(NamedTuple):
    """Inputs of all position controllers over a stretch of position cycles, each (cycle, axis)."""

    setpoint: np.ndarray  # delayed, m or rad
    fed_step: np.ndarray  # step over a position cycle of the set point that the feedforward differentiates, m or rad
    velocity_feedforward: np.ndarray  # m/s or rad/s
    torque_feedforward: np.ndarray  # Nm at the motor
    external_force: np.ndarray  # (cycle, axis, 2) on load and motor, at the axis, N or Nm; no cycles without external forces


@dataclass(eq=False, repr=False)
class Setpoints:
    """Set points of the driven axes; position (sample, axis) [m, rad], period [s].

    `before` (sample, axis) is a lead-in: samples at negative times. `injected` (sample, axis) is a torque [Nm at the motor] that a test rig
    adds to the drive's command. `added_feedforward` (sample, axis) is a speed [m/s, rad/s] that the control adds to its velocity
    feedforward. Both are zero outside the samples. `external_force` (sample, axis, 2) acts on load and motor, positive towards +q, counted at
    the axis [N, Nm]; its first and last values continue outside the samples. `deflection` (axis,) is the deflection of the drive trains
    beyond equilibrium at the first sample, motor minus load [m, rad].
    """

    position: np.ndarray
    period: float
    before: np.ndarray | None = None
    injected: np.ndarray | None = None
    added_feedforward: np.ndarray | None = None
    external_force: np.ndarray | None = None
    deflection: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.position = np.ascontiguousarray(self.position, float)
        self._all = self.position if self.before is None else np.concatenate([self.before, self.position])
        self._parts: dict[tuple[int, ...], Setpoints] = {}
        self._cycles: dict[tuple[float, float], np.ndarray] = {}
        self._commands: dict[object, Command] = {}

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return (len(self.position) - 1) * self.period

    @property
    def lead(self) -> float:
        """Length of the lead-in [s]."""
        return (len(self._all) - len(self.position)) * self.period

    @property
    def start(self) -> np.ndarray:
        """Position before the first motion (axis,)."""
        return self._all[0]

    def part(self, axes: tuple[int, ...]) -> Setpoints:
        """The set points of some axes, by index; cached with their spline."""
        if axes not in self._parts:
            index = list(axes)

            def of(values: np.ndarray | None) -> np.ndarray | None:
                return None if values is None else values[:, index]

            arrays = map(of, (self.before, self.injected, self.added_feedforward, self.external_force))
            self._parts[axes] = Setpoints(self.position[:, index], self.period, *arrays)
            self._parts[axes].deflection = None if self.deflection is None else self.deflection[index]
        return self._parts[axes]

    def at_cycles(self, first: int, count: int, period: float, delays: list[float]) -> list[np.ndarray]:
        """Delayed positions (cycle, axis) at position cycles, for each delay [s]; cached for short runs."""
        lead, total = self._cycle_counts(period)
        if self._spline is None or first < -lead:
            times = np.arange(first, first + count) * period
            return list(self.at((times - np.array(delays)[:, None]).ravel()).reshape(len(delays), count, -1))
        out = []
        for delay in delays:
            known = self._cycles.get((period, delay))
            if known is None:
                known = self.at(np.arange(-lead, total) * period - delay)
                if len(self._cycles) >= _MAX_DELAYS:  # a fit or a study varies the delay
                    self._cycles.clear()
                self._cycles[period, delay] = known
            out.append(known[lead + first : lead + first + count])
        return out

    def external_force_at(self, first: int, count: int, period: float) -> np.ndarray:
        """External force (cycle, axis, 2), the mean over each position cycle, which preserves the impulse; no cycles without it."""
        if self.external_force is None:
            return np.zeros((0, 1, 2))
        force = self.external_force
        last = len(force) - 1
        sums = np.concatenate([np.zeros((1, *force.shape[1:])), np.cumsum(force, axis=0)])

        def impulse(cycles: np.ndarray) -> np.ndarray:
            at = cycles * (period / self.period)
            row = np.clip(np.floor(at + 1e-9), 0, last).astype(int)
            return np.asarray(sums[row] + (at - row)[:, None, None] * force[row])

        cycles = np.arange(first, first + count + 1)
        return np.diff(impulse(cycles), axis=0) * (self.period / period)

    @property
    def external_force_at_start(self) -> np.ndarray | float:
        """External force (axis,) before the first motion [N, Nm at the axis]."""
        return 0.0 if self.external_force is None else self.external_force[0].sum(axis=-1)

    def held(self, values: np.ndarray | None, times: np.ndarray) -> np.ndarray | float:
        """Zero-order hold of `injected` or `added_feedforward`, (time, axis); zero outside the samples, and where there is none."""
        if values is None:
            return 0.0
        rows = np.floor(times / self.period + 1e-6).astype(int)
        inside = (rows >= 0) & (rows < len(values))
        return np.where(inside[:, None], values[np.clip(rows, 0, len(values) - 1)], 0.0)

    def command(self, key: object, period: float, first: int, count: int, of: Callable[[int, int], Command]) -> Command:
        """A stretch of the command `of(first, count)`. The whole command of a short run is cached under `key`."""
        if self._spline is None:
            return of(first, count)
        lead, total = self._cycle_counts(period)
        known = self._commands.get(key)
        if known is None:
            known = of(-lead, lead + total)
            if len(self._commands) >= _MAX_COMMANDS:  # a fit or a study varies the parameters of the command
                self._commands.clear()
            self._commands[key] = known
        return Command(*(part[lead + first : lead + first + count] for part in known))

    def _cycle_counts(self, period: float) -> tuple[int, int]:
        """Number of position cycles in the lead-in, and from the first sample to past the last."""
        return round(self.lead / period), int(np.ceil(self.duration / period)) + 2

    @functools.cached_property
    def _spline(self) -> CubicSpline | None:
        """One spline through all samples, or None for runs that are too long or too short."""
        if not 4 <= len(self._all) <= _KEEP_SPLINE:
            return None
        return CubicSpline(np.arange(len(self._all)), self._all, axis=0, bc_type="natural")

    def at(self, times: np.ndarray) -> np.ndarray:
        """Positions (time, axis) at times [s]; constant outside the samples. A long run evaluates one spline over the range of the times."""
        last = len(self._all) - 1
        times = times + self.lead
        at = np.clip(times / self.period, 0, last)
        near = np.rint(at)
        at = np.where(np.abs(at - near) < 1e-9, near, at)  # exact at the samples
        if self._spline is not None:
            return self._spline(at)
        low = int(np.clip(np.floor(times.min() / self.period) - _OVERLAP, 0, last))
        high = int(np.clip(np.ceil(times.max() / self.period) + _OVERLAP, 0, last))
        if high - low < 3:
            low, high = max(0, high - 3), min(last, low + 3)
        index = np.arange(low, high + 1)
        if high - low < 3:
            return np.column_stack([np.interp(at, index, column[low : high + 1]) for column in self._all.T])
        return CubicSpline(index, self._all[low : high + 1], axis=0, bc_type="natural")(at)


def setpoints_of(trace: Trace, machine: Machine) -> Setpoints:
    """Set points of a trace in the machine's axis order. An axis that the trace lacks stays at 0, or at the nearest end of its travel."""
    unknown = [axis for axis in trace.axes if axis not in machine.axis_names]
    if unknown:
        raise InputError(
            f"trace has axis {unknown[0]}, machine {machine.name} has {', '.join(machine.axis_names)}; give the right --machine"
        )
    still = {axis.name: np.full(len(trace.time), np.clip(0.0, *axis.travel)) for axis in machine.axes}
    columns = [trace.get(name, "setpoint") if trace.has(name, "setpoint") else rest for name, rest in still.items()]
    return Setpoints(
        np.column_stack(columns),
        trace.period,
        injected=recorded_forces.injected(trace, machine),
        external_force=recorded_forces.external(trace, machine),
    )


def trace_of(setpoints: Setpoints, machine: Machine) -> Trace:
    """Set points of all axes as a trace from time 0."""
    columns = {(name, "setpoint"): setpoints.position[:, a] for a, name in enumerate(machine.axis_names)}
    return Trace(np.arange(len(setpoints.position)) * setpoints.period, columns, machine.kinds)


def recorded_setpoints(trace: Trace, machine: Machine) -> Setpoints:
    """Set points of a recording with its added feedforward.

    A recording that begins in motion gets a lead-in; any other gets the drive train deflection of its first sample.
    """
    setpoints = setpoints_of(trace, machine)
    setpoints.added_feedforward = added_feedforward(trace, machine, setpoints.at)
    position, period = setpoints.position, setpoints.period
    speed = (position[1] - position[0]) / period
    least = [AT_REST[axis.kind] for axis in machine.axes]
    cycle = max(machine.position_cycle, machine.base_tick)
    samples = np.arange(1, round(4.0 * LEAD_S / period) + 1)
    whole = samples[np.abs(samples * period / cycle - np.rint(samples * period / cycle)) < 1e-6]
    whole = whole[whole * period >= LEAD_S - 1e-12]
    if np.all(np.abs(speed) <= least) or not whole.size:
        setpoints.deflection = deflection_at_start(trace, machine)
        return setpoints
    n = int(whole[0])
    t = np.arange(n) / n
    x = np.minimum(t / UP_TO_SPEED, 1.0)  # the speed ramps up as 3 x^2 - 2 x^3, then stays constant
    remaining = np.where(x < 1.0, UP_TO_SPEED * (0.5 - x**3 + 0.5 * x**4) + 1.0 - UP_TO_SPEED, 1.0 - t)  # integral of the speed from t to 1
    before = position[0] - np.outer(remaining * n * period, speed)
    return Setpoints(position, period, before, setpoints.injected, setpoints.added_feedforward, setpoints.external_force)


def check_travel(setpoints: Setpoints, machine: Machine, where: str) -> None:
    """Raise InputError for the first set point outside the travel of an axis."""
    for a, axis in enumerate(machine.axes):
        low, high = axis.travel
        position = setpoints.position[:, a]
        outside = np.flatnonzero((position < low - TRAVEL_TOLERANCE) | (position > high + TRAVEL_TOLERANCE))
        if outside.size:
            i = outside[0]
            unit, factor = AXIS_UNITS[axis.kind].position
            raise InputError(
                f"{where}: axis {axis.name} set point {position[i] * factor:.6g} {unit} at {i * setpoints.period:.6g} s lies outside the "
                f"travel {low * factor:.6g} .. {high * factor:.6g} {unit}; move the program or correct travel in the machine file"
            )
