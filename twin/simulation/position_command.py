"""The command of the position controllers: delayed set point and feedforward at each position cycle.

The control differentiates the set points s(t) backwards over its position cycle Tp, with delay d and axis units per motor radian r:

    v_ff = a_v (s(t - d) - s(t - d - Tp)) / Tp
    T_ff = a_t J_ff (s(t - d) - 2 s(t - d - Tp) + s(t - d - 2 Tp)) / Tp^2 / r

Set point filters that the machine file lists (`twin.control.set_point_filters`) act on all three alike.

With `setpoint_interpolation = "linear"` the delay of a set point is interpolated linearly between the NC's samples at its position
cycles: a set point delayed by 1.5 cycles is the mean of the values one and two cycles old.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from twin.control.block import Cycles
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.setpoints import Command, Setpoints

WHOLE_CYCLE = 1e-9
"""A delay this close to a whole number of position cycles counts as whole."""


def command_of(machine: Machine, commissioned_inertia: np.ndarray, setpoints: Setpoints, first_cycle: int, count: int) -> Command:
    """The command of `count` position cycles from `first_cycle` on; `commissioned_inertia` (axis,) [kg m2 at the motor]."""
    tp = machine.position_cycle
    laws = [
        _CommandLaw(
            axis.loops.position_delay_s,
            axis.loops.feedforward_delay_s,
            axis.loops.velocity_feedforward,
            axis.loops.acceleration_weight * inertia,
            axis.ratio,
            machine.setpoint_interpolation == "linear",
        )
        for axis, inertia in zip(machine.axes, commissioned_inertia.tolist())
    ]

    kernels = [kernel_of(axis, machine) for axis in machine.axes]
    key = (tp, *laws, *(kernel.tobytes() for kernel in kernels))
    return setpoints.command(key, tp, first_cycle, count, lambda first, n: _evaluated(setpoints, laws, kernels, tp, first, n))


def with_command_columns(trace: Trace, machine: Machine, setpoints: Setpoints) -> Trace:
    """The trace with `velocity_feedforward` [m/s, rad/s], held over each position cycle, and `acceleration` [m/s2, rad/s2] of the motor in axis units.

    A SINUMERIK records them as VFFWS and TFFWS; identification reads weight and delay of the feedforward from them. The loop records
    `torque_feedforward`.
    """
    cycle = np.floor(trace.time / machine.position_cycle + 1e-6).astype(int)
    command = command_of(machine, commissioned_inertia(machine), setpoints, 0, int(cycle[-1]) + 1)
    signals = dict(trace.signals)
    for a, axis in enumerate(machine.axes):
        signals[axis.name, "velocity_feedforward"] = command.velocity_feedforward[cycle, a]
        if trace.has(axis.name, "velocity"):
            signals[axis.name, "acceleration"] = np.gradient(trace.get(axis.name, "velocity"), trace.time)
    return replace(trace, signals=signals)


def kernel_of(axis: Axis, cycles: Cycles) -> np.ndarray:
    """Weights of the set point filters of an axis at the last position cycles, newest first; [1] without a filter."""
    kernel = np.ones(1)
    for listed in axis.blocks:
        if listed.block.kernel is not None:
            kernel = np.convolve(kernel, listed.block.kernel(listed.values, cycles))
    return kernel


def _evaluated(setpoints: Setpoints, laws: list[_CommandLaw], kernels: list[np.ndarray], tp: float, first: int, count: int) -> Command:
    """The command of `count` position cycles of length `tp` [s]; `kernels` hold the set point filter of each axis."""
    # one spline evaluation serves all axes and delays
    delays = sorted({d for law in laws for wanted in (law.delay, *law.steps_back(tp)) for d, _ in delay_weights(wanted, tp, law.linear)})
    back = max(map(len, kernels)) - 1
    at = dict(zip(delays, setpoints.at_cycles(first - back, count + back, tp, delays)))
    setpoint, step, velocity, torque = np.empty((4, count, len(laws)))
    for a, law in enumerate(laws):

        def read(delay: float, a: int = a, law: _CommandLaw = law) -> np.ndarray:
            values = sum((weight * at[d][:, a] for d, weight in delay_weights(delay, tp, law.linear)), start=np.zeros(count + back))
            return np.convolve(values, kernels[a])[back : back + count] if back else values

        now, before, earlier = map(read, law.steps_back(tp))
        setpoint[:, a] = read(law.delay)
        step[:, a] = now - before
        velocity[:, a] = law.velocity_feedforward * step[:, a] / tp
        acceleration = (now - 2.0 * before + earlier) / tp**2
        torque[:, a] = law.commissioned_inertia * acceleration / law.ratio
    has_feedforward = np.array([law.velocity_feedforward != 0.0 for law in laws])
    times = np.arange(first, first + count) * tp
    velocity += setpoints.held(setpoints.added_feedforward, times) * has_feedforward
    torque += setpoints.held(setpoints.injected, times)
    return Command(setpoint, step, velocity, torque, setpoints.external_force_at(first, count, tp))


def received(machine: Machine, axis: Axis, setpoint: Callable[[float], np.ndarray], delay: float) -> np.ndarray:
    """The set point (sample,) that the control of an axis uses after a delay [s], behind its set point filters; `setpoint` gives it any time [s] ago."""
    cycle, linear = machine.position_cycle, machine.setpoint_interpolation == "linear"
    parts, kernel = delay_weights(delay, cycle, linear), kernel_of(axis, machine).tolist()
    return np.sum([weight * share * setpoint(d + k * cycle) for d, weight in parts for k, share in enumerate(kernel)], axis=0)


def delay_weights(delay: float, cycle: float, linear: bool) -> list[tuple[float, float]]:
    """(delay, weight) of the samples that make up a delayed set point: one sample, or with `linear` the two neighbouring NC samples."""
    if not linear:
        return [(delay, 1.0)]
    whole = math.floor(delay / cycle + WHOLE_CYCLE)
    part = max(delay / cycle - whole, 0.0)
    return [(n * cycle, weight) for n, weight in ((whole, 1.0 - part), (whole + 1, part)) if weight > WHOLE_CYCLE]


class _CommandLaw(NamedTuple):
    """Parameters of one axis' command."""

    delay: float  # s
    feedforward_delay: float  # s
    velocity_feedforward: float  # weight a_v
    commissioned_inertia: float  # a_t J_ff, kg m2 at the motor
    ratio: float  # axis units per motor rad
    linear: bool

    def steps_back(self, cycle: float) -> tuple[float, float, float]:
        """Delays of the three set points in a second difference."""
        return self.feedforward_delay, self.feedforward_delay + cycle, self.feedforward_delay + 2.0 * cycle
