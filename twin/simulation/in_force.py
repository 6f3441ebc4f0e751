"""What a drive's speed loop was fed with, made of recorded signals.

Where the NC closes the position loop this is what it sends, w*_NC and T_ff, held from one sample to the next. Where the drive does
(`dsc_delay_s` Td; law in `twin.simulation.cascade`), it follows at every speed cycle T

    w*(T) = w*_NC(T - Td) - Kv (x(T) - x(T - Td)),    T_ff(T) = T_ff,NC(T - Td)

x is the signal that closes the position loop, on a cubic spline through its samples.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from twin.machine.machine import Axis
from twin.recordings.trace import Trace
from twin.simulation.cascade import WHOLE_CYCLE


def closed_on(trace: Trace, axis: Axis) -> str:
    """The recorded signal that closes the position loop."""
    return "motor_position" if axis.encoder == "motor" and trace.has(axis.name, "motor_position") else "position"


def speed_set_point(trace: Trace, axis: Axis, speed_cycle: float) -> np.ndarray:
    """w* in force (sample, speed cycle) [axis units a second]; one column where the NC closes the position loop."""
    sent, signal = trace.get(axis.name, "velocity_setpoint"), closed_on(trace, axis)
    if axis.loops.dsc_delay_s <= 0.0 or not trace.has(axis.name, signal):
        return sent[:, None]
    here = _speed_cycles(trace, speed_cycle)
    position = CubicSpline(trace.time, trace.get(axis.name, signal))
    before = sum(weight * position(np.maximum(here - d, trace.time[0])) for d, weight in _back(axis, speed_cycle))
    return sent_before(sent, trace, axis, speed_cycle) - axis.loops.position_gain_per_s * (position(here) - before)


def sent_before(values: np.ndarray, trace: Trace, axis: Axis, speed_cycle: float) -> np.ndarray:
    """What the NC sent (sample,) as the drive has it (sample, speed cycle): Td late, held between the samples; one column without Td."""
    if axis.loops.dsc_delay_s <= 0.0:
        return values[:, None]
    here = _speed_cycles(trace, speed_cycle)

    def held(times: np.ndarray) -> np.ndarray:
        return values[np.clip(np.floor((times - trace.time[0]) / trace.period + 1e-6).astype(int), 0, len(values) - 1)]

    late: np.ndarray = sum((weight * held(here - d) for d, weight in _back(axis, speed_cycle)), np.zeros(here.shape))
    return late


def _speed_cycles(trace: Trace, speed_cycle: float) -> np.ndarray:
    """Times of the speed cycles of each sample (sample, speed cycle) [s]; the last ones lie up to a sample after the record."""
    inside = max(1, round(trace.period / speed_cycle))
    times: np.ndarray = trace.time[:, None] + np.arange(inside) * speed_cycle
    return times


def _back(axis: Axis, speed_cycle: float) -> tuple[tuple[float, float], ...]:
    """(time back [s], weight): the two whole speed cycles between which Td lies."""
    cycles = axis.loops.dsc_delay_s / speed_cycle
    whole = np.floor(cycles + WHOLE_CYCLE)
    part = max(cycles - whole, 0.0)
    return (whole * speed_cycle, 1.0 - part), ((whole + 1.0) * speed_cycle, part)
