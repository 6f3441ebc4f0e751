"""Initial deflection of the drive trains at the start of a record.

A record may begin just after the drives are switched on, before a drive train has settled. The two encoders show it: motor minus scale at
the first sample differs from its settled value while the set point is at rest. The simulation then starts with the same deflection. A rigid
drive train has none.
"""

from __future__ import annotations

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.two_encoders import has_both, motor_minus_scale

LONGEST_REST_S = 0.3
"""Longest evaluated time from the first sample [s]."""

FEWEST_SAMPLES = 20
"""Smallest number of samples at rest from which the settled value is known."""

CLEAR = 8.0
"""Multiple of the scatter at rest above which the first sample is not noise."""


def deflection_at_start(trace: Trace, machine: Machine) -> np.ndarray | None:
    """Deflection (axis,) beyond equilibrium at the first sample, motor minus scale [m, rad]; None if no axis has one."""
    deflection = np.array([_of_axis(trace, axis) for axis in machine.axes])
    return deflection if deflection.any() else None


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
