"""Motor encoder and scale of an axis: their difference, and alignment of their zeros."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace

BOTH = ("motor_position", "position")
"""Signals of the motor encoder and of the scale."""


def has_both(trace: Trace, name: str) -> bool:
    """Whether a trace has both encoders of an axis."""
    return all(trace.has(name, signal) for signal in BOTH)


def motor_minus_scale(trace: Trace, name: str) -> np.ndarray:
    """Motor encoder minus scale of an axis (sample,) [m, rad]."""
    motor, scale = (trace.get(name, signal) for signal in BOTH)
    return motor - scale


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
