"""Errors of an axis in a run: with and without the constant delay of the control, and after reversals.

    following error        e(t) = s(t) - x(t)
    error without delay    e'(t) = s(t - d) - x(t),   d = position delay of the control, and of a drive that closes the loop (`Loops.set_point_delay_s`)

A control with feedforward delays its set points by d, so e is v d at constant speed: 500 um at 15 m/min and 2 ms, regardless of
the mechanics. e' is the remaining error; backlash, friction and elasticity change it.
"""

from typing import NamedTuple

import numpy as np

from twin.geometry.tool_path import ContourError, contour_error, search_window, tool_path_of
from twin.machine.axis import Axis
from twin.machine.machine import Machine
from twin.recordings.trace import Trace

REVERSAL_WINDOW = 0.1
"""Duration of the search for the error peak after a reversal of the set point [s]."""

SETPOINT_STEP = 1e-9
"""Smallest change from sample to sample that counts as motion of the set point [m, rad]."""


class AxisErrors(NamedTuple):
    """Largest magnitudes [m, rad]: following error, error without the delay, the same after a reversal (None without a reversal)."""

    following: float
    following_rms: float
    without_delay: float
    without_delay_rms: float
    reversal_peak: float | None
    reversals: int


def error_without_delay(trace: Trace, axis: Axis, signal: str = "position") -> np.ndarray:
    """Delayed set point minus position, or another signal of it (sample,) [m, rad]."""
    return delayed_set_point(trace, axis) - trace.get(axis.name, signal)


def delayed_set_point(trace: Trace, axis: Axis) -> np.ndarray:
    """Set point minus the delay of the control (sample,) [m, rad]: the position of an axis without errors."""
    return np.interp(trace.time - axis.loops.set_point_delay_s, trace.time, trace.get(axis.name, "setpoint"))


def reversal_times(trace: Trace, axis: str) -> np.ndarray:
    """Times (reversal,) [s] where the set point starts in the opposite direction, with or without a standstill before."""
    steps = np.diff(trace.get(axis, "setpoint"))
    moving = np.flatnonzero(np.abs(steps) > SETPOINT_STEP)
    turns = moving[1:][np.sign(steps[moving[1:]]) != np.sign(steps[moving[:-1]])]
    return trace.time[turns]


def axis_errors(trace: Trace, axis: Axis, signal: str = "position") -> AxisErrors:
    """The errors of one axis by this signal of its position."""
    following = trace.get(axis.name, "setpoint") - trace.get(axis.name, signal)
    without = error_without_delay(trace, axis, signal)
    times = reversal_times(trace, axis.name)
    after = np.zeros(len(without), bool)
    for first in np.searchsorted(trace.time, times):
        after[first : first + max(1, round(REVERSAL_WINDOW / trace.period))] = True
    return AxisErrors(
        float(np.abs(following).max()),
        float(np.sqrt(np.mean(following**2))),
        float(np.abs(without).max()),
        float(np.sqrt(np.mean(without**2))),
        float(np.abs(without[after]).max()) if after.any() else None,
        len(times),
    )


def contour_error_of(trace: Trace, machine: Machine, signal: str = "position") -> ContourError:
    """Contour error of a run against the path of its set points. Raises TwinError for a machine without a tool or a part frame."""
    return contour_error(tool_path_of(trace, signal, machine), tool_path_of(trace, "setpoint", machine), search_window(machine))
