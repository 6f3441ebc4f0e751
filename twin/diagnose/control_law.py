"""Error of the control law at the measured inputs: set point and position in, command out.

If the speed set point is recorded, it is the output of the position controller:

    e = v* - Kv (s(t - d) - q) - a_v ds/dt            and what its blocks make of the law (`drive_setpoints.with_blocks`)

If both controllers are P controllers and the record has a sample at each of their cycles, the output of both is their command u:

    e = u K / Kp - (Kv (s(t - d) - q) + a_v ds/dt - w),    w the speed that the control differentiates from q

e in axis units per second; q is the measuring system that closes the loop.
"""

from collections.abc import Callable, Sequence
import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from twin.control.command_columns import AT_LIMIT
from twin.control.speed_controller import differentiation
from twin.control.speed_set_point_filters import lag_of, lagged
from twin.diagnose.settings import T
from twin.diagnose.view import RunView
from twin.effects import Setting
from twin.effects.law import NAME as LAW
from twin.effects.law import law_in
from twin.machine.machine import Axis
from twin.recordings.roughness import decimal_place, step_of
from twin.recordings.trace import Trace
from twin.simulation.drive_setpoints import changes_position_law, closed_on, with_blocks
from twin.simulation.recorded_times import SAME_PERIOD
from twin.units import AXIS_UNITS


class Characteristic(NamedTuple):
    """What effects and unlisted laws make of a position controller: factor of its gain, and speed (sample,) of following error and speed set point, SI."""

    factor: float
    speed: Callable[[np.ndarray, np.ndarray], np.ndarray]


def characteristic_of(settings: Sequence[Setting], axis: Axis) -> Characteristic | None:
    """The characteristic of effects and unlisted laws on an axis; None if they leave its position controller alone."""
    own = [s for s in settings if s.axis == axis.name]
    factor = math.prod(s.factor_on("position_gain_per_s") for s in own)
    laws = [(law_in(s), s) for s in own if s.effect.name == LAW and s.effect.block == "position controller"]
    laws = [(law, s) for law, s in laws if law.output == "speed" and law.variable in INPUTS and not law.shape.is_filter]
    if factor == 1.0 and not laws:
        return None

    def speed(following_error: np.ndarray, speed_setpoint: np.ndarray) -> np.ndarray:
        x = dict(zip(INPUTS, (following_error, speed_setpoint)))
        return sum((law.values(x[law.variable], s.parameters, axis) for law, s in laws), np.zeros(len(following_error)))

    return Characteristic(factor, speed)


INPUTS = ("following_error", "speed_setpoint")
"""Inputs of an unlisted law of a position controller."""


BEGIN = 4
"""Cycles after which a block knows the last set points: three differences of them."""


def law_error(trace: Trace, view: RunView, axis: Axis, added: Characteristic | None = None) -> np.ndarray | None:
    """e at the position cycles (cycle,) of a trace, measured or simulated; None if the measured signals do not contain it.

    `added` is what a simulated controller adds to the law. It is evaluated at the measured position, because the rest position of an axis is
    partly random.
    """
    measured, name = view.trace, axis.name
    signal = closed_on(measured, axis)
    own_blocks = changes_position_law(axis)
    if not measured.has(name, signal) or not (view.on_each_cycle if own_blocks else view.on_cycles):
        return None
    command, delayed, _ = view.reference(name)
    position = trace.get(name, signal)
    gain = axis.loops.position_gain_per_s
    if measured.has(name, "velocity_setpoint"):
        every, machine, lag = view.samples_per_cycle, view.machine, lag_of(axis.blocks)
        fed = view.set_point(axis, axis.loops.feedforward_delay_s)[::every]

        def law(position: np.ndarray, of: Characteristic | None = None) -> np.ndarray:
            error = (delayed - position)[::every]
            own = gain * (of.factor if of else 1.0)
            made = with_blocks(axis, own, machine, delayed[::every], fed, error, command[::every] + own * error)
            return made + of.speed(error, made) if of else made

        made = law(position, added)
        if added is not None:
            real = measured.get(name, signal)
            made += law(real) - law(real, added)
        if lag is not None:
            made = lagged(made, machine.position_cycle, lag.values["time_constant"], machine.speed_cycle)
        error = trace.get(name, "velocity_setpoint")[::every] - made
        error[: BEGIN if own_blocks else 0] = 0.0  # the cycles before the record are unknown
        return error
    if own_blocks or not _shows_command(view, axis):
        return None
    u = trace.get(name, axis.effort)
    n, rate = differentiation(axis.loops, view.machine.speed_cycle)
    differentiated = (position - np.concatenate([np.full(n, position[0]), position[:-n]])) * rate
    error = u * axis.commissioned_torque_constant * axis.ratio / axis.loops.speed_gain_nm_s_per_rad - (
        command + gain * (delayed - position) - differentiated
    )
    error[np.abs(u) > AT_LIMIT * axis.motor.peak_current_a] = 0.0  # a saturated command does not follow the law
    error[: n + 1] = 0.0  # the position before the first samples is unknown
    return error


def law_sigma(view: RunView, axis: Axis) -> float:
    """Standard deviation of e due to rounding of the record."""
    noise = view.machine.noise(axis)
    least = T.doubt * noise.speed or 1e-9
    if view.trace.has(axis.name, "velocity_setpoint"):
        factor = AXIS_UNITS[axis.kind].speed[1]
        step = decimal_place(view.trace.get(axis.name, "velocity_setpoint") * factor, coarsest=1, off=1e-4) / factor
        # the feedforward is the difference of two set points that are rounded apart
        fed = axis.loops.velocity_feedforward * np.sqrt(2.0) / view.machine.position_cycle
        of_setpoints = (axis.loops.position_gain_per_s + fed) * step_of(view.trace.get(axis.name, "setpoint"))
        return max(float(np.hypot(step, of_setpoints)) / np.sqrt(12.0), least)
    # the controller may have read one encoder count more or less than recorded
    resolution = max(noise.motor_resolution if closed_on(view.trace, axis) == "motor_position" else noise.position_resolution, 1e-12)
    return max(resolution * differentiation(axis.loops, view.machine.speed_cycle)[1], least)


def law_model_error(view: RunView, axis: Axis) -> np.ndarray:
    """Standard deviation of e for a healthy controller due to model error, correlated over many samples (cycle,).

    A law fitted to a recording deviates from the real one by a share of the speed, and by its interpolation between the cycles. A law without
    blocks whose delays are whole cycles is the designed one and exact.
    """
    if not _part_of_cycle(view, axis) and axis.loops.dsc_delay_s == 0.0 and not axis.blocks:
        return np.zeros(len(view.trace.time))[:: view.samples_per_cycle]
    speed = _around(np.abs(view.motion.speed[:, view.machine.axis_names.index(axis.name)]), view)
    between = axis.loops.position_gain_per_s * between_cycles(view, axis)
    return np.hypot(T.law_share * speed, between)[:: view.samples_per_cycle]


def between_cycles(view: RunView, axis: Axis) -> np.ndarray:
    """Largest difference between a delayed set point and the set point that the control reads (sample,) [m or rad].

    A delay of n + p cycles falls between two set points of the control. A straight line and a curve differ there by p (1 - p) / 2 Tp^2 |a|.
    The difference is zero if the delay is a whole number of cycles or the machine file gives the interpolation.
    """
    tp = view.machine.position_cycle
    part = _part_of_cycle(view, axis)
    if view.machine.setpoint_interpolation == "linear" or not part:
        return np.zeros(len(view.trace.time))
    acceleration = np.abs(view.motion.acceleration[:, view.machine.axis_names.index(axis.name)])
    return 0.5 * part * (1.0 - part) * tp**2 * _around(acceleration, view)


def _part_of_cycle(view: RunView, axis: Axis) -> float:
    """Fractional part of the set-point delay in cycles; 0 for whole numbers."""
    part = (axis.loops.position_delay_s / view.machine.position_cycle + 1e-6) % 1.0
    return part if part > 1e-3 else 0.0


def _around(values: np.ndarray, view: RunView) -> np.ndarray:
    """Largest value within `lag_s` before and after each sample (sample,): the twin may be early or late by so much."""
    largest: np.ndarray = maximum_filter1d(values, 2 * round(T.lag_s / view.trace.period) + 1)
    return largest[: len(view.trace.time)]


def _shows_command(view: RunView, axis: Axis) -> bool:
    """Is the command recorded at each cycle of two P controllers that differentiate the position?"""
    machine, period = view.machine, view.trace.period
    cycles = (machine.speed_cycle, machine.position_cycle)
    return (
        bool(axis.loops.within_law)
        and axis.loops.speed_filter_time_s == 0.0
        and axis.loops.torque_feedforward == 0.0
        and view.trace.has(axis.name, axis.effort)
        and all(abs(cycle / period - 1.0) < SAME_PERIOD for cycle in cycles)
    )
