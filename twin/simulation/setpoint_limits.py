"""Speed, acceleration and jerk of set points against the limits of the axes."""

import math

import numpy as np

from twin.machine.machine import Machine
from twin.simulation.setpoints import Setpoints

LIMIT_TOLERANCE = 0.01
"""Set points may exceed a limit by this fraction without a warning, because recorded set points are rounded."""

ROUNDING = 1e-8
"""Largest resolution of rounded set points [m or rad]."""

BLOCK = 1_000_000
"""Set points that are judged at a time, for little memory."""


def limit_warnings(setpoints: Setpoints, machine: Machine) -> list[str]:
    """One line for each axis and limit (speed, acceleration, jerk) that the set points exceed, with time and value."""
    # differences span at least a position cycle: over shorter steps, rounding of recorded set points looks like jerk
    every = max(1, round(machine.position_cycle / setpoints.period))
    watch = LimitWatch(machine, every * setpoints.period)
    positions = setpoints.position[::every]
    for first in range(0, len(positions), BLOCK):
        watch.add(positions[first : first + BLOCK])
    return watch.warnings()


class LimitWatch:
    """Maximum speed, acceleration and jerk of each axis over set points (sample, axis) that arrive in consecutive blocks."""

    def __init__(self, machine: Machine, period: float) -> None:
        self.machine, self.period = machine, period
        axes = len(machine.axes)
        self.before = np.empty((0, axes))  # the last samples of the previous block, at most three
        self.count = 0
        self.worst, self.at = np.zeros((3, axes)), np.zeros((3, axes), int)  # largest differences, and their first sample
        self.least_step = np.full(axes, np.inf)

    def add(self, position: np.ndarray) -> None:
        """Add the next block of set points."""
        together = np.vstack([self.before, position])
        first = self.count - len(self.before)
        for order in range(1, 4):
            if len(together) <= order:
                break
            values = np.abs(np.diff(together, order, axis=0))
            if order == 1:
                self.least_step = np.minimum(self.least_step, np.where(values > 0.0, values, np.inf).min(axis=0))
            most = values.argmax(axis=0)
            greatest = values.max(axis=0)
            more = greatest > self.worst[order - 1]
            self.at[order - 1] = np.where(more, first + most, self.at[order - 1])
            self.worst[order - 1] = np.where(more, greatest, self.worst[order - 1])
        self.count += len(position)
        self.before = together[-3:]

    def warnings(self) -> list[str]:
        """One line for each axis and limit that the set points exceed, with time and value."""
        lines = []
        for a, axis in enumerate(self.machine.axes if self.count > 3 else ()):
            unit, factor = ("m", 1.0) if axis.kind == "linear" else ("deg", math.degrees(1.0))
            # error of a rounded set point: half of its apparent resolution
            rounding = min(self.least_step[a], ROUNDING) / 2 if np.isfinite(self.least_step[a]) else 0.0
            quantities = (
                ("speed", axis.max_velocity, "/s"),
                ("acceleration", axis.max_acceleration, "/s2"),
                ("jerk", axis.max_jerk, "/s3"),
            )
            for order, (name, limit, per) in enumerate(quantities, start=1):
                value = self.worst[order - 1, a] / self.period**order
                if value > limit * (1.0 + LIMIT_TOLERANCE) + rounding * 2**order / self.period**order:
                    lines.append(
                        f"axis {axis.name}: set points reach a {name} of {value * factor:.4g} {unit}{per} at "
                        f"{self.at[order - 1, a] * self.period:.3f} s, the limit is {limit * factor:.4g} {unit}{per}"
                    )
        return lines
