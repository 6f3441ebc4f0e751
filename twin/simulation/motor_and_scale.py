"""Motor encoder and scale of an axis: their difference, alignment of their zeros, and the deflection of the drive train at the start of a record."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import ENCODERS, Trace


def has_both(trace: Trace, name: str) -> bool:
    """Whether a trace has both encoders of an axis."""
    return all(trace.has(name, signal) for signal in ENCODERS)


def motor_minus_scale(trace: Trace, name: str) -> np.ndarray:
    """Motor encoder minus scale of an axis (sample,) [m, rad]."""
    return trace.get(name, "motor_position") - trace.get(name, "position")


def shifted(trace: Trace, axis: Axis, offset: float) -> Trace:
    """The trace with motor minus scale reduced by `offset` [m, rad]; shifts the encoder that does not close the position loop."""
    signal, sign = ("motor_position", -1.0) if axis.encoder != "motor" else ("position", 1.0)
    return replace(trace, signals={**trace.signals, (axis.name, signal): trace.get(axis.name, signal) + sign * offset})


def with_equal_means(trace: Trace, machine: Machine, axes: Iterable[str]) -> Trace:
    """The trace without the mean of motor minus scale on some axes; the encoders have no common zero, so the mean carries no information."""
    for name in axes:
        if has_both(trace, name):
            trace = shifted(trace, machine.axis(name), float(np.mean(motor_minus_scale(trace, name))))
    return trace


LONGEST_REST_S = 0.3
"""Longest evaluated time from the first sample [s]."""

FEWEST_SAMPLES = 20
"""Fewer samples at rest do not show the settled value."""

CLEAR = 8.0
"""Largest noise of the first sample, in multiples of the scatter at rest."""


def deflection_at_start(trace: Trace, machine: Machine) -> np.ndarray | None:
    """Deflection (axis,) beyond equilibrium at the first sample, motor minus scale [m, rad]; None if no axis has one.

    A record may begin just after the drives are switched on, before a drive train has settled: the difference of the encoders at the first
    sample then differs from its settled value while the set point is at rest. A rigid drive train has no deflection.
    """
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
