"""Set points as the axis cards see them: from recorded samples to the values of each position cycle.

Recorded set points of any constant period are interpolated by a cubic spline (continuous acceleration, so no jerk is
added), read at arbitrary delays. The control differentiates them backwards over its position cycle Tp:

    v_ff = a_v (s(t - d) - s(t - d - Tp)) / Tp
    T_ff = a_t J_ff (s(t - d) - 2 s(t - d - Tp) + s(t - d - 2 Tp)) / Tp^2 / r

With `setpoint_interpolation = "linear"` a delayed set point lies on the straight line between the NC's samples at its position
cycles: a delay of 1.5 cycles is the mean of the values one and two cycles old.

Before the first sample the machine stood on it; after the last one it stays there. A recording that begins in motion gets a
lead-in: the axes come up from rest to the speed that they have at its first sample.
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation import known_forces
from twin.simulation.fed_speed import beside_slope
from twin.simulation.record_start import windup_at_start
from twin.units import AXIS_UNITS, deg_from_rad

_OVERLAP = 40
"""Samples beside a stretch that its spline also sees: the influence of a far sample decays by 0.27 a sample, to 1e-23."""

_KEEP_SPLINE = 100_000
"""Samples up to which one spline is kept for the whole run."""

_MOST_DELAYS = 64
"""Delays whose positions are remembered at once."""

_MOST_COMMANDS = 8
"""Commands of a whole run that are remembered at once."""

TRAVEL_TOLERANCE = 1e-9
"""Set points may exceed the travel by rounding only [m or rad]."""

LEAD_S = 0.4
UP_TO_SPEED = 0.6
"""Least length of a lead-in [s], and the part of it in which the speed is reached: its transient has died when the recording begins."""

WHOLE_CYCLE = 1e-9
"""A delay this close to a whole number of position cycles is whole."""

AT_REST = {"linear": 0.2e-3, "rotary": np.deg2rad(0.2)}
"""Set point speeds up to which an axis is at rest [m/s, rad/s]."""

LIMIT_TOLERANCE = 0.01
"""Fraction by which set points may exceed a limit before a warning: recorded ones are rounded."""

ROUNDING = 1e-8
"""Greatest step of the grid [m or rad] on which rounded set points lie."""


class Setpoints:
    """Set points of the driven axes as continuous functions of time; position (sample, axis) [m, rad], period [s].

    `before` (sample, axis) holds samples ahead of the first one, at negative times: a lead-in. `injected` (sample, axis) is what a test rig
    adds to the drive's command, as torque at the motor [Nm]; `fed` (sample, axis) is what the control adds to its velocity feedforward
    [m/s, rad/s]. Nothing of these is added outside the samples. `outside` (sample, axis, 2) are known forces on load and motor from outside,
    towards +q, counted at the axis [N, Nm]; before the first sample and after the last one they stay as they are there. `wound` (axis,) is
    how far the drive trains are wound up beyond their balance at the first sample, motor minus load [m, rad].
    """

    def __init__(
        self,
        position: np.ndarray,
        period: float,
        before: np.ndarray | None = None,
        injected: np.ndarray | None = None,
        fed: np.ndarray | None = None,
        outside: np.ndarray | None = None,
        wound: np.ndarray | None = None,
    ) -> None:
        self.injected, self.fed, self.outside, self.wound = injected, fed, outside, wound
        self.position = np.ascontiguousarray(position, float)
        self.period = period
        self.before = self.position[:0] if before is None else before
        self._all = self.position if before is None else np.concatenate([before, self.position])
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
        return len(self.before) * self.period

    @property
    def start(self) -> np.ndarray:
        """Where the axes stand before they move (axis,)."""
        return self._all[0]

    def part(self, axes: tuple[int, ...]) -> Setpoints:
        """The same set points of some axes only, by index; remembered, with their spline."""
        if axes not in self._parts:
            index = list(axes)
            self._parts[axes] = Setpoints(
                self.position[:, index],
                self.period,
                self.before[:, index] if len(self.before) else None,
                None if self.injected is None else self.injected[:, index],
                None if self.fed is None else self.fed[:, index],
                None if self.outside is None else self.outside[:, index],
                None if self.wound is None else self.wound[index],
            )
        return self._parts[axes]

    def at_cycles(self, first: int, count: int, period: float, delays: list[float]) -> list[np.ndarray]:
        """For each delay (cycle, axis) positions that long before the position cycles; remembered for short runs."""
        if self._spline is None:
            times = np.arange(first, first + count) * period
            return list(self.at((times - np.array(delays)[:, None]).ravel()).reshape(len(delays), count, -1))
        lead, total = self._whole(period)
        out = []
        for delay in delays:
            known = self._cycles.get((period, delay))
            if known is None:
                known = self.at(np.arange(-lead, total) * period - delay)
                if len(self._cycles) >= _MOST_DELAYS:  # where the delay itself is varied or fitted
                    self._cycles.clear()
                self._cycles[period, delay] = known
            out.append(known[lead + first : lead + first + count])
        return out

    def injected_at(self, first: int, count: int, period: float) -> np.ndarray | float:
        """(cycle, axis) injected torque [Nm] at position cycles; 0 where nothing is injected."""
        return self._held(self.injected, np.arange(first, first + count) * period)

    def fed_at(self, times: np.ndarray) -> np.ndarray | float:
        """(time, axis) speed that is fed forward beside the slope of the set points [m/s, rad/s]; 0 where none is."""
        return self._held(self.fed, times)

    def outside_at(self, first: int, count: int, period: float) -> np.ndarray:
        """(cycle, axis, 2) mean outside force over each position cycle; no cycles where none is known. A short push keeps its impulse."""
        if self.outside is None:
            return np.zeros((0, 1, 2))
        last = len(self.outside) - 1
        sums = np.concatenate([np.zeros((1, *self.outside.shape[1:])), np.cumsum(self.outside, axis=0)])

        def impulse(cycles: np.ndarray) -> np.ndarray:
            at = cycles * (period / self.period)
            row = np.clip(np.floor(at + 1e-9), 0, last).astype(int)
            return sums[row] + (at - row)[:, None, None] * self.outside[row]  # type: ignore[index]

        cycles = np.arange(first, first + count + 1)
        return np.diff(impulse(cycles), axis=0) * (self.period / period)

    @property
    def outside_at_start(self) -> np.ndarray | float:
        """(axis,) outside force while the axes stand before they move [N, Nm at the axis]."""
        return 0.0 if self.outside is None else self.outside[0].sum(axis=-1)

    def _held(self, values: np.ndarray | None, times: np.ndarray) -> np.ndarray | float:
        """Values (time, axis) held from their sample on."""
        if values is None:
            return 0.0
        rows = np.floor(times / self.period + 1e-6).astype(int)
        inside = (rows >= 0) & (rows < len(values))
        return np.where(inside[:, None], values[np.clip(rows, 0, len(values) - 1)], 0.0)

    def command(self, key: object, period: float, first: int, count: int, of: Callable[[int, int], Command]) -> Command:
        """A stretch of the command that `of(first, count)` gives; of short runs the whole is remembered under `key`."""
        if self._spline is None:
            return of(first, count)
        lead, total = self._whole(period)
        known = self._commands.get(key)
        if known is None:
            known = of(-lead, lead + total)
            if len(self._commands) >= _MOST_COMMANDS:  # where what makes it is varied or fitted
                self._commands.clear()
            self._commands[key] = known
        return Command(*(part[lead + first : lead + first + count] for part in known))

    def _whole(self, period: float) -> tuple[int, int]:
        """Position cycles of the lead-in, and those from the first sample to beyond the last one."""
        return round(self.lead / period), int(np.ceil(self.duration / period)) + 2

    @functools.cached_property
    def _spline(self) -> CubicSpline | None:
        """One spline through all samples, where that is cheap to keep."""
        if not 4 <= len(self._all) <= _KEEP_SPLINE:
            return None
        return CubicSpline(np.arange(len(self._all)), self._all, axis=0, bc_type="natural")

    def at(self, times: np.ndarray) -> np.ndarray:
        """(time, axis) positions at times [s] that lie close together, constant outside the samples."""
        last = len(self._all) - 1
        times = times + self.lead if len(self.before) else times
        at = np.clip(times / self.period, 0, last)
        near = np.rint(at)
        at = np.where(np.abs(at - near) < 1e-9, near, at)  # a sample's own time gives the sample itself
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


class Command(NamedTuple):
    """Inputs of all position controllers over a stretch of position cycles, each (cycle, axis)."""

    setpoint: np.ndarray  # delayed, m or rad
    velocity_feedforward: np.ndarray  # m/s or rad/s
    torque_feedforward: np.ndarray  # Nm at the motor
    outside: np.ndarray  # (cycle, axis, 2) known forces on load and motor from outside, at the axis; no cycles where there are none


def command_of(machine: Machine, commissioned_inertia: np.ndarray, setpoints: Setpoints, first_cycle: int, count: int) -> Command:
    """The command of `count` position cycles from `first_cycle` on; `commissioned_inertia` (axis,) [kg m2 at the motor]."""
    tp = machine.position_cycle
    laws = [
        _Law(
            axis.loops.position_delay_s,
            axis.loops.feedforward_delay_s,
            axis.loops.velocity_feedforward,
            axis.loops.acceleration_weight * inertia,
            axis.ratio,
            machine.setpoint_interpolation == "linear",
        )
        for axis, inertia in zip(machine.axes, commissioned_inertia.tolist())
    ]

    feeds = np.array([law.velocity_feedforward != 0.0 for law in laws])

    def of(first: int, count: int) -> Command:
        # one spline evaluation for all axes, delays and steps back
        delays = sorted({d for law in laws for wanted in (law.delay, *law.steps_back(tp)) for d, _ in law.weights(wanted, tp)})
        at = dict(zip(delays, setpoints.at_cycles(first, count, tp, delays)))
        setpoint, fed_speed, fed_torque = np.empty((3, count, len(laws)))
        out = Command(setpoint, fed_speed, fed_torque, setpoints.outside_at(first, count, tp))
        for a, law in enumerate(laws):

            def read(delay: float, a: int = a, law: _Law = law) -> np.ndarray:
                return sum((weight * at[d][:, a] for d, weight in law.weights(delay, tp)), start=np.zeros(count))

            now, before, earlier = map(read, law.steps_back(tp))
            out.setpoint[:, a] = read(law.delay)
            out.velocity_feedforward[:, a] = law.velocity_feedforward * (now - before) / tp
            acceleration = (now - 2.0 * before + earlier) / tp**2
            out.torque_feedforward[:, a] = law.fed_inertia * acceleration / law.ratio
        out.velocity_feedforward[:] += setpoints.fed_at(np.arange(first, first + count) * tp) * feeds
        out.torque_feedforward[:] += setpoints.injected_at(first, count, tp)
        return out

    return setpoints.command((tp, *laws), tp, first_cycle, count, of)


def delay_weights(delay: float, cycle: float, linear: bool) -> list[tuple[float, float]]:
    """Delays and weights of the set points that a delayed one is made of: itself, or (`linear`) the NC's two samples on both sides."""
    if not linear:
        return [(delay, 1.0)]
    whole = math.floor(delay / cycle + WHOLE_CYCLE)
    part = max(delay / cycle - whole, 0.0)
    return [(n * cycle, weight) for n, weight in ((whole, 1.0 - part), (whole + 1, part)) if weight > WHOLE_CYCLE]


class _Law(NamedTuple):
    """The numbers that turn an axis' set points into its command: delays [s], speed weight, fed inertia [kg m2 at the motor], ratio, interpolation."""

    delay: float
    feedforward_delay: float
    velocity_feedforward: float
    fed_inertia: float
    ratio: float
    linear: bool = False

    def weights(self, delay: float, cycle: float) -> list[tuple[float, float]]:
        """Delays and weights of the set points that a delayed one is made of: itself, or the NC's two samples on both sides."""
        return delay_weights(delay, cycle, self.linear)

    def steps_back(self, cycle: float) -> tuple[float, float, float]:
        """Delays of the three set points that a second difference takes."""
        return self.feedforward_delay, self.feedforward_delay + cycle, self.feedforward_delay + 2.0 * cycle


def setpoints_of(trace: Trace, machine: Machine) -> Setpoints:
    """Set points of a trace for the machine's axes in its order; axes that the trace lacks stay at 0 or the travel's nearest end."""
    unknown = [axis for axis in trace.axes if axis not in machine.axis_names]
    if unknown:
        raise InputError(
            f"trace has axis {unknown[0]}, machine {machine.name} has {', '.join(machine.axis_names)}; give the right --machine"
        )
    columns = []
    for axis in machine.axes:
        if trace.has(axis.name, "setpoint"):
            columns.append(trace.get(axis.name, "setpoint"))
        else:
            columns.append(np.full(len(trace.time), np.clip(0.0, *axis.travel)))
    columns_of = (known_forces.injected(trace, machine), known_forces.outside(trace, machine))
    return Setpoints(np.column_stack(columns), trace.period, injected=columns_of[0], outside=columns_of[1])


def recorded_setpoints(trace: Trace, machine: Machine) -> Setpoints:
    """Set points of a recording: with a lead-in where it begins in motion, else with the windup of its first sample, and with what a recorded
    feedforward holds beside their slope."""
    setpoints = setpoints_of(trace, machine)
    setpoints.fed = beside_slope(trace, machine, setpoints.at)
    position, period = setpoints.position, setpoints.period
    speed = (position[1] - position[0]) / period
    least = [AT_REST[axis.kind] for axis in machine.axes]
    cycle = max(machine.position_cycle, machine.base_tick)
    samples = np.arange(1, round(4.0 * LEAD_S / period) + 1)
    whole = samples[np.abs(samples * period / cycle - np.rint(samples * period / cycle)) < 1e-6]
    whole = whole[whole * period >= LEAD_S - 1e-12]
    if np.all(np.abs(speed) <= least) or not whole.size:
        setpoints.wound = windup_at_start(trace, machine)
        return setpoints
    n = int(whole[0])
    t = np.arange(n) / n
    x = np.minimum(t / UP_TO_SPEED, 1.0)  # the speed grows as 3 x^2 - 2 x^3, then stays
    missing = np.where(x < 1.0, UP_TO_SPEED * (0.5 - x**3 + 0.5 * x**4) + 1.0 - UP_TO_SPEED, 1.0 - t)  # its integral from t to 1
    before = position[0] - np.outer(missing * n * period, speed)
    return Setpoints(position, period, before, setpoints.injected, setpoints.fed, setpoints.outside)


def check_travel(setpoints: Setpoints, machine: Machine, where: str) -> None:
    """Raise InputError at the first set point outside an axis' travel."""
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


def limit_warnings(setpoints: Setpoints, machine: Machine) -> list[str]:
    """One line for each axis and limit (speed, acceleration, jerk) that the set points exceed, with place and amount."""
    # differences over at least a position cycle, so that the rounding of recorded set points does not count as jerk
    every = max(1, round(machine.position_cycle / setpoints.period))
    watch = LimitWatch(machine, every * setpoints.period)
    watch.add(setpoints.position[::every])
    return watch.warnings()


class LimitWatch:
    """The greatest speed, acceleration and jerk of each axis over set points (sample, axis) that come in blocks, one behind the other."""

    def __init__(self, machine: Machine, period: float) -> None:
        self.machine, self.period = machine, period
        axes = len(machine.axes)
        self.before = np.empty((0, axes))  # at most three samples
        self.count = 0
        self.worst, self.at = np.zeros((3, axes)), np.zeros((3, axes), int)  # differences, and the sample from which each goes
        self.least_step = np.full(axes, np.inf)

    def add(self, position: np.ndarray) -> None:
        """The set points that follow."""
        together = np.vstack([self.before, position])
        first = self.count - len(self.before)
        for order in range(1, 4):
            if len(together) <= order:
                break
            values = np.abs(np.diff(together, order, axis=0))
            if order == 1:
                self.least_step = np.minimum(self.least_step, np.where(values > 0.0, values, np.inf).min(axis=0))
            most = values.argmax(axis=0)
            greatest = values.max(axis=0)
            more = greatest > self.worst[order - 1]
            self.at[order - 1] = np.where(more, first + most, self.at[order - 1])
            self.worst[order - 1] = np.where(more, greatest, self.worst[order - 1])
        self.count += len(position)
        self.before = together[-3:]

    def warnings(self) -> list[str]:
        """One line for each axis and limit that they exceed, with place and amount."""
        lines = []
        for a, axis in enumerate(self.machine.axes):
            unit, factor = (axis.kind == "linear" and ("m", 1.0)) or ("deg", deg_from_rad(1.0))
            if self.count < 4:
                continue
            # what rounding of the recorded set points alone does to each difference: half a step of the grid on which they seem to lie
            rounding = min(self.least_step[a], ROUNDING) / 2 if np.isfinite(self.least_step[a]) else 0.0
            quantities = (
                ("speed", axis.max_velocity, "/s"),
                ("acceleration", axis.max_acceleration, "/s2"),
                ("jerk", axis.max_jerk, "/s3"),
            )
            for order, (name, limit, per) in enumerate(quantities, start=1):
                value = self.worst[order - 1, a] / self.period**order
                if value > limit * (1.0 + LIMIT_TOLERANCE) + rounding * 2**order / self.period**order:
                    lines.append(
                        f"axis {axis.name}: set points reach a {name} of {value * factor:.4g} {unit}{per} at "
                        f"{self.at[order - 1, a] * self.period:.3f} s, the limit is {limit * factor:.4g} {unit}{per}"
                    )
        return lines
