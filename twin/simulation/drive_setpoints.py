"""Speed set point and torque feedforward at the input of the speed controller, from recorded signals.

If the NC closes the position loop, these are w*_NC and T_ff of the NC, held between samples. If the drive does
(`dsc_delay_s` Td; law in `twin.simulation.cascade`), at every speed cycle T

    w*(T) = w*_NC(T - Td) - Kv (x(T) - x(T - Td)),    T_ff(T) = T_ff,NC(T - Td)

x is the position signal of the position loop, interpolated by a cubic spline.

The blocks of an axis beside its position controller have their own compiled laws over recorded signals, too: `with_blocks`.
"""

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from twin.compiled_functions import compiled
from twin.control.block import Cycles
from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.loop import call_axis_terms
from twin.simulation.loop_terms import (
    MAX_AXES,
    SETPOINT,
    SIGNAL_COUNT,
    SPEED,
    X_FED_STEP,
    X_FOLLOWING_ERROR,
    X_SETPOINT,
    X_SPEED_SETPOINT,
    Term,
    term_table,
)
from twin.simulation.position_command import delay_weights


def closed_on(trace: Trace, axis: Axis) -> str:
    """The recorded position signal of the position loop."""
    return "motor_position" if axis.encoder == "motor" and trace.has(axis.name, "motor_position") else "position"


def speed_set_point(trace: Trace, axis: Axis, speed_cycle: float) -> np.ndarray:
    """Speed set point at the speed controller (sample, speed cycle) [axis units/s]; one column if the NC closes the position loop."""
    sent, signal = trace.get(axis.name, "velocity_setpoint"), closed_on(trace, axis)
    if axis.loops.dsc_delay_s <= 0.0 or not trace.has(axis.name, signal):
        return sent[:, None]
    here = _speed_cycles(trace, speed_cycle)
    back = delay_weights(axis.loops.dsc_delay_s, speed_cycle, linear=True)
    position = CubicSpline(trace.time, trace.get(axis.name, signal))
    before = sum(weight * position(np.maximum(here - d, trace.time[0])) for d, weight in back)
    return received_from_nc(sent, trace, axis, speed_cycle) - axis.loops.position_gain_per_s * (position(here) - before)


def changes_position_law(axis: Axis) -> bool:
    """Whether blocks of the axis change the set point or the output of its position controller from cycle to cycle."""
    return any(b.block.stage in (SETPOINT, SPEED) for b in axis.blocks)


def with_blocks(
    axis: Axis,
    gain: float,
    cycles: Cycles,
    setpoint: np.ndarray,
    fed: np.ndarray,
    error: np.ndarray,
    output: np.ndarray,
    stages: Sequence[int] = (SETPOINT, SPEED),
) -> np.ndarray:
    """Output (cycle,) of a position controller with the blocks of its axis at SETPOINT and SPEED.

    From its gain, its delayed set point, the set point that its feedforward differentiates, its error and its own output, each (cycle,).
    """
    beside = [b for b in axis.blocks if b.block.stage in stages]
    if not beside:
        return output
    terms = [Term(b.block.law, b.block.stage, 0, b.block.constants(b.values, cycles, gain), order=k) for k, b in enumerate(beside)]
    made = np.array(output)
    step = np.diff(fed, prepend=fed[:1])
    _at_each_cycle(term_table(terms, 1), np.zeros((MAX_AXES, SIGNAL_COUNT)), gain, np.array(setpoint), step, np.array(error), made)
    return made


def added_to_setpoint(axis: Axis, cycles: Cycles, setpoint: np.ndarray) -> np.ndarray:
    """What the blocks of an axis at SETPOINT, such as tables and backlash values, add to its set point (cycle,) before the position controller."""
    none = np.zeros(len(setpoint))
    return with_blocks(axis, 1.0, cycles, setpoint, setpoint, none, none, (SETPOINT,))


@compiled
def _at_each_cycle(terms, signals, gain, setpoint, step, error, output):  # type: ignore[no-untyped-def]
    """Pass set point and output (cycle,) of one axis through its terms."""
    for k in range(len(output)):
        signals[0, X_SETPOINT] = setpoint[k]
        call_axis_terms(terms, SETPOINT, signals, 0)
        moved = signals[0, X_SETPOINT] - setpoint[k]
        signals[0, X_FED_STEP] = step[k]
        signals[0, X_FOLLOWING_ERROR] = error[k] + moved
        signals[0, X_SPEED_SETPOINT] = output[k] + gain * moved
        call_axis_terms(terms, SPEED, signals, 0)
        output[k] = signals[0, X_SPEED_SETPOINT]


def received_from_nc(values: np.ndarray, trace: Trace, axis: Axis, speed_cycle: float) -> np.ndarray:
    """Values that the NC sends (sample,) as the drive receives them (sample, speed cycle): delayed by Td, held between samples; one column without Td."""
    if axis.loops.dsc_delay_s <= 0.0:
        return values[:, None]
    here = _speed_cycles(trace, speed_cycle)

    def held(times: np.ndarray) -> np.ndarray:
        return values[np.clip(np.floor((times - trace.time[0]) / trace.period + 1e-6).astype(int), 0, len(values) - 1)]

    back = delay_weights(axis.loops.dsc_delay_s, speed_cycle, linear=True)
    late: np.ndarray = sum((weight * held(here - d) for d, weight in back), np.zeros(here.shape))
    return late


def _speed_cycles(trace: Trace, speed_cycle: float) -> np.ndarray:
    """Times of the speed cycles of each sample (sample, speed cycle) [s]; the last ones lie up to one sample after the record."""
    inside = max(1, round(trace.period / speed_cycle))
    times: np.ndarray = trace.time[:, None] + np.arange(inside) * speed_cycle
    return times
