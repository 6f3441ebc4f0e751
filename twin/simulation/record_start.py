"""The start of a record: how far each drive train is wound up there beyond its balance.

A record may begin just after the drives took over, with a drive train that has not yet come to its balance. The two encoders show it:
motor minus scale at the first sample differs from what it settles to while the set point still stands. The twin then starts wound up
like that, too; a rigid drive train has nothing to wind up.
"""

from __future__ import annotations

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.two_encoders import has_both, motor_minus_scale

LONGEST_REST_S = 0.3
"""Time from the first sample on that is looked at, at most [s]: what comes later is no start."""

FEWEST_SAMPLES = 20
"""Samples at rest below which it is not known what the difference settles to."""

CLEAR = 8.0
"""Multiple of the scatter at rest from which on the first sample is no noise."""


def windup_at_start(trace: Trace, machine: Machine) -> np.ndarray | None:
    """Windup (axis,) beyond balance at the first sample, motor minus scale [m, rad]; None where no axis shows one."""
    wound = np.array([_of_axis(trace, axis) for axis in machine.axes])
    return wound if wound.any() else None


def _of_axis(trace: Trace, axis: Axis) -> float:
    if not (trace.has(axis.name, "setpoint") and has_both(trace, axis.name)):
        return 0.0
    setpoint = trace.get(axis.name, "setpoint")[: round(LONGEST_REST_S / trace.period)]
    moved = np.flatnonzero(setpoint != setpoint[:1])
    rest = slice(0, int(moved[0]) if moved.size else len(setpoint))
    difference = motor_minus_scale(trace, axis.name)[rest]
    if len(difference) < FEWEST_SAMPLES:
        return 0.0
    settled = difference[len(difference) // 2 :]
    beyond = float(difference[0] - np.mean(settled))
    return beyond if abs(beyond) > CLEAR * float(np.std(settled)) else 0.0
