"""The control law held against what the controller saw: set point and position in, what it made of them out.

Where a speed set point is recorded it is the output of the position controller:

    e = v* - Kv (s(t - d) - q) - a_v ds/dt

Where both controllers are P and the record has a sample at each of their cycles, their command u is the output of both:

    e = u K / Kp - (Kv (s(t - d) - q) + a_v ds/dt - w),    w the speed that they differentiate from q

e in axis units a second; q the measuring system that closes the loop.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np
from scipy.ndimage import maximum_filter1d

from twin.diagnose.view import RunView
from twin.effects import Setting
from twin.effects.law import NAME as LAW
from twin.effects.law import law_in
from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.drive_setpoints import closed_on
from twin.simulation.gap import SAME_PERIOD
from twin.units import AXIS_UNITS

Characteristic = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""What a position controller adds to its law (sample,) for a following error and a speed set point (sample,), SI."""


def characteristic_of(settings: Sequence[Setting], axis: Axis) -> Characteristic | None:
    """What effects and unlisted laws make of the position controller of an axis, as a function of its inputs; None where nothing does."""
    own = [s for s in settings if s.axis == axis.name]
    more = (math.prod(s.factor_on("position_gain_per_s") for s in own) - 1.0) * axis.loops.position_gain_per_s
    laws = [(law_in(s), s) for s in own if s.effect.name == LAW and s.effect.block == "position controller"]
    laws = [(law, s) for law, s in laws if law.output == "speed" and law.variable in INPUTS and not law.shape.is_filter]
    if more == 0.0 and not laws:
        return None

    def added(following_error: np.ndarray, speed_setpoint: np.ndarray) -> np.ndarray:
        x = dict(zip(INPUTS, (following_error, speed_setpoint)))
        return sum((law.values(x[law.variable], s.parameters, axis) for law, s in laws), more * following_error)

    return added


INPUTS = ("following_error", "speed_setpoint")
"""What the law of a position controller that nobody listed may be a characteristic of."""


def law_error(trace: Trace, view: RunView, axis: Axis, added: Characteristic | None = None) -> np.ndarray | None:
    """e at the position cycles (cycle,) of a trace, measured or simulated; None where the measured signals do not show it.

    `added` is what a simulated controller adds to the law. That one is fed with the measured position, as the block is cut: where an
    axis came to rest by chance, e is that of where it really was.
    """
    measured, name = view.trace, axis.name
    signal = closed_on(measured, axis)
    if not measured.has(name, signal) or not view.on_cycles:
        return None
    command, delayed, _ = view.reference(name)
    position = trace.get(name, signal)
    wanted = command + axis.loops.position_gain_per_s * (delayed - position)
    if measured.has(name, "velocity_setpoint"):
        error = trace.get(name, "velocity_setpoint") - wanted
        if added is not None:
            real = measured.get(name, signal)
            error += added(delayed - real, command + axis.loops.position_gain_per_s * (delayed - real)) - added(delayed - position, wanted)
        return error[:: _cycle_samples(view, axis)]
    if not _shows_command(view, axis):
        return None
    u = trace.get(name, axis.effort)
    error = u * axis.commissioned_torque_constant * axis.ratio / axis.loops.speed_gain_nm_s_per_rad - (
        wanted - _differentiated(position, view, axis)
    )
    error[np.abs(u) > view.thresholds.clipped * axis.motor.peak_current_a] = 0.0  # a clipped command says nothing about the law
    error[: axis.loops.speed_mean_cycles + 1] = 0.0  # and the first ones not where the axis was before
    return error


def law_sigma(view: RunView, axis: Axis) -> float:
    """What rounding of the record leaves of e (standard deviation)."""
    noise = view.machine.noise(axis)
    least = view.thresholds.law_floor * noise.speed or 1e-9
    if view.trace.has(axis.name, "velocity_setpoint"):
        return max(_rounding(view.trace, axis) / np.sqrt(12.0), least)
    # the controller may have seen one count of its encoder more or less than the record holds
    resolution = max(noise.motor_resolution if closed_on(view.trace, axis) == "motor_position" else noise.position_resolution, 1e-12)
    return max(resolution / (max(axis.loops.speed_mean_cycles, 1) * view.machine.speed_cycle), least)


def law_model_error(view: RunView, axis: Axis) -> np.ndarray:
    """How far e may be wrong though the controller is right (cycle,): standard deviation, a fault that is the same in many samples.

    A law fitted to a recording differs from the one that runs in the control, by a share of the speed; and by how it reads between its
    cycles. A law whose delays are whole cycles is that of the control's design, and exact.
    """
    t = view.thresholds
    if not _part_of_cycle(view, axis) and axis.loops.dsc_delay_s == 0.0:
        return np.zeros(len(view.trace.time))[:: _cycle_samples(view, axis)]
    speed = _around(np.abs(view.motion.speed[:, view.machine.axis_names.index(axis.name)]), view)
    between = axis.loops.position_gain_per_s * between_cycles(view, axis)
    return np.hypot(t.law_share * speed, between)[:: _cycle_samples(view, axis)]


def between_cycles(view: RunView, axis: Axis) -> np.ndarray:
    """How far a delayed set point may be from the one that the control reads (sample,) [m or rad].

    A delay of n + p cycles falls between two set points of the control. Nobody recorded what lies there; a straight line and a curve differ
    by p (1 - p) / 2 Tp^2 |a|. A control that delays by whole cycles, or of which the file says how it interpolates, leaves nothing open.
    """
    tp = view.machine.position_cycle
    part = _part_of_cycle(view, axis)
    if view.machine.setpoint_interpolation == "linear" or not part:
        return np.zeros(len(view.trace.time))
    acceleration = np.abs(view.motion.acceleration[:, view.machine.axis_names.index(axis.name)])
    return 0.5 * part * (1.0 - part) * tp**2 * _around(acceleration, view)


def _part_of_cycle(view: RunView, axis: Axis) -> float:
    """Part of a cycle by which the delay of the set point exceeds whole ones, 0 where it is a whole number."""
    part = (axis.loops.position_delay_s / view.machine.position_cycle + 1e-6) % 1.0
    return part if part > 1e-3 else 0.0


def _around(values: np.ndarray, view: RunView) -> np.ndarray:
    """Largest value within the time by which the twin may be early or late (sample,)."""
    largest: np.ndarray = maximum_filter1d(values, 2 * round(view.thresholds.lag_s / view.trace.period) + 1)
    return largest[: len(view.trace.time)]


def _cycle_samples(view: RunView, axis: Axis) -> int:
    """Samples from one value of e to the next."""
    return max(1, round(view.machine.position_cycle / view.trace.period)) if view.trace.has(axis.name, "velocity_setpoint") else 1


def _shows_command(view: RunView, axis: Axis) -> bool:
    """Is the command recorded at each cycle of two P controllers that differentiate the position?"""
    machine, period = view.machine, view.trace.period
    cycles = (machine.speed_cycle, machine.position_cycle)
    return (
        not axis.has_speed_integral
        and axis.loops.speed_mean_cycles > 0
        and axis.loops.speed_filter_time_s == 0.0
        and axis.loops.torque_feedforward == 0.0
        and view.trace.has(axis.name, axis.effort)
        and all(abs(cycle / period - 1.0) < SAME_PERIOD for cycle in cycles)
    )


def _differentiated(position: np.ndarray, view: RunView, axis: Axis) -> np.ndarray:
    n = axis.loops.speed_mean_cycles
    before = np.concatenate([np.full(n, position[0]), position[:-n]])
    return (position - before) / (n * view.machine.speed_cycle)


def _rounding(trace: Trace, axis: Axis) -> float:
    """Step of the decimal grid on which the recorded speed set point lies, in SI (0: none seen)."""
    factor = AXIS_UNITS[axis.kind].speed[1]
    values = trace.get(axis.name, "velocity_setpoint") * factor
    for digits in range(1, 7):
        if np.all(np.abs(values * 10**digits - np.rint(values * 10**digits)) < 1e-4):
            return 10.0**-digits / factor
    return 0.0
