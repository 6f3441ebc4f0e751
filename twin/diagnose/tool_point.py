"""Deviation of the tool point in the part frame due to position errors of the axes."""

from collections.abc import Sequence

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.gap import sensor_noise

LOAD = "load_position"
"""Signal of a simulation: true position of the load of an axis."""


class ToolPoint:
    """Distances at the tool in the part frame; for a machine without such a kinematic chain, root sum of squares of its linear axes."""

    def __init__(self, machine: Machine) -> None:
        self.machine = machine
        try:
            self.kinematics: Kinematics | None = kinematics_of(machine)
        except InputError:
            self.kinematics = None
        self._places: dict[int, tuple[Trace, np.ndarray, np.ndarray]] = {}

    def distance(self, base: Trace, other: Trace, axes: Sequence[str]) -> np.ndarray:
        """Distance (sample,) [m] between the tool points of two motions that differ in these axes."""
        return self._moved_by(base, {a: other.get(a, LOAD) - base.get(a, LOAD) for a in axes if other.has(a, LOAD)})

    def squares(self, base: Trace | None, other: Trace | None, axes: Sequence[str]) -> float:
        """Mean square [m2] of that distance."""
        return 0.0 if base is None or other is None else float(np.mean(self.distance(base, other, axes) ** 2))

    def squares_of(self, base: Trace | None, residual: Trace | None, axes: Sequence[str]) -> float:
        """Mean square [m2] at the tool of position deviations (a trace of `position`)."""
        if base is None or residual is None:
            return 0.0
        return float(np.mean(self._moved_by(base, {a: residual.get(a, "position") for a in axes if residual.has(a, "position")}) ** 2))

    def at(self, base: Trace, sample: int) -> tuple[float, ...]:
        """Tool point [m] in the part frame at a sample of a motion; positions of the linear axes for a machine without such a chain."""
        if self.kinematics is None:
            return tuple(float(base.get(a, LOAD)[sample]) for a in base.axes if self.machine.axis(a).kind == "linear")
        return tuple(self._place(base, self.kinematics)[2][sample].tolist())

    def noise_squares(self, base: Trace | None) -> float:
        """Mean square [m2] at the tool due to the noise of the position sensors."""
        if base is None:
            return 0.0
        total = 0.0
        for axis in base.axes:
            sigma = sensor_noise(self.machine, self.machine.axis(axis), "position")
            total += float(np.mean(self._moved_by(base, {axis: np.full(len(base.time), sigma)}) ** 2))
        return total

    def _moved_by(self, base: Trace, by: dict[str, np.ndarray]) -> np.ndarray:
        if not by:
            return np.zeros(len(base.time))
        if self.kinematics is None:
            linear = [d**2 for a, d in by.items() if self.machine.axis(a).kind == "linear"]
            return np.asarray(np.sqrt(np.sum(linear, axis=0))) if linear else np.zeros(len(base.time))
        _, at, tip = self._place(base, self.kinematics)
        moved = at + np.column_stack([np.broadcast_to(by.get(a, 0.0), len(at)) for a in self.kinematics.names])
        return np.asarray(np.linalg.norm(self.kinematics.tip(moved) - tip, axis=1))

    def _place(self, base: Trace, kinematics: Kinematics) -> tuple[Trace, np.ndarray, np.ndarray]:
        """A motion with its axes (sample, 5) and its tool point (sample, 3); cached, because all contributions are compared with the same motions."""
        if id(base) not in self._places:
            at = np.column_stack([base.get(a, LOAD) if base.has(a, LOAD) else np.zeros(len(base.time)) for a in kinematics.names])
            self._places[id(base)] = base, at, kinematics.tip(at)
        return self._places[id(base)]
