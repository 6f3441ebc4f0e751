"""The control that a recording does not show, tried: the numbers with which the simulated axis follows like the recorded one.

Numbers of the position controller, if they are assumed, and gain and integral time of the speed controller are searched together (`estimate.search`): a gain,
a delay and a feedforward with the same lag differ in how the axis accelerates.
"""

from collections.abc import Collection, Hashable, Iterator, Sequence
from dataclasses import replace
import math

import numpy as np

from twin.control import position_controller, speed_controller
from twin.estimate.problem import Values
from twin.identify.drive_residuals import DriveResiduals, follows_recorded_path
from twin.machine.axis_lumps import AxisControl, AxisLumps
from twin.machine.commented import TRIED
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun

STARTS = ((1.0, 0.004), (1.0, 0.03), (4.0, 0.03), (4.0, 0.3))
"""Starts of the search: factor of the lag of the speed controller, and its integral time [s]. The optima of the integral time lie apart."""

SETTLING_PART = 20
"""One part in SETTLING_PART of each run is left out at its start: the recorded axis may still move from before."""


class TriedControl(DriveResiduals):
    """The problem of the controls of some axes, whose mechanics are known; position and command are compared."""

    def __init__(self, machine: Machine, runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps]) -> None:
        self.lumps = {one.name: one for one in lumps}
        rows = [np.arange(len(run.trace.time)) >= len(run.trace.time) // SETTLING_PART for run in runs]
        super().__init__(machine, runs, dict.fromkeys(self.lumps, rows), (), self.lumps)

    def signals(self, name: str) -> list[str]:
        one = self.lumps[name]
        return [one.where, *([one.mechanics.effort] if one.mechanics else [])]

    def _is_seen(self, axis: Axis) -> bool:
        return any(run.trace.moves(axis.name) for run in self.runs)

    def _fields_of(self, axis: Axis, known: Collection[tuple[str, str]]) -> list[str]:
        law = self.lumps[axis.name].law
        is_open = not law.measured and not follows_recorded_path(axis, self.runs)
        assumed = axis.loops.searched(position_controller.PARAMETERS, self.fed(axis) if law.partly_fed else ()) if is_open else []
        fed = ["torque_feedforward"] if is_open and law.acceleration else []
        return [*assumed, *fed, *axis.loops.searched(speed_controller.PARAMETERS)]

    def values(self, x: Values, axes: Collection[str]) -> tuple[dict[str, object], dict[str, float]]:
        """As those of a machine file, whose feedforward is as late as the set point, because the recording shows only one lag."""
        values, forces = super().values(x, axes)
        loops = [f"axis.{n}.loops." for n in axes if "position_delay_s" in self.fields[n]]
        return values | {f"{key}feedforward_delay_s": values[f"{key}position_delay_s"] for key in loops}, forces

    def control_at(self, name: str, values: Values) -> AxisControl:
        """The control of an axis at these values of the search."""
        law, found = self.lumps[name].law, self.found(name, values)
        return replace(
            law,
            gain=found.get("position_gain_per_s", law.gain),
            delay=found.get("position_delay_s", law.delay),
            feedforward=found.get("velocity_feedforward", law.feedforward),
            lag=law.lag * self._value(name, "speed_gain_nm_s_per_rad") / found["speed_gain_nm_s_per_rad"],
            acceleration=law.acceleration * found.get("torque_feedforward", 1.0),
            integral_time=found.get("speed_integral_time_s", law.integral_time),
            origin=TRIED if "position_gain_per_s" in found else law.origin,
        )


def tried_controls(machine: Machine, runs: Sequence[MeasuredRun], lumps: Sequence[AxisLumps]) -> dict[str, AxisControl]:
    """The best control of each of these axes of the machine, searched from the one that it has."""
    problem = TriedControl(machine, runs, lumps)
    starts = {tuple(start.values()): start for start in _starts(problem)}  # some are equal
    ends = [end for start in starts.values() if (end := problem.searched(start)) is not None] if problem.names else []
    return {n: problem.control_at(n, min(ends, key=lambda end: end.scores[n]).values) for n in problem.names if ends}


def _starts(problem: TriedControl) -> Iterator[dict[Hashable, float]]:
    """The laws with the speed controllers of STARTS; one that a command shows nearly starts there."""
    for softer, integral_time in STARTS:
        start = {f.name: f.start for f in problem.free}
        for name in (n for n in problem.names if problem.lumps[n].law.origin != TRIED):
            start[name, "speed_gain_nm_s_per_rad"] -= math.log(softer)
            if (name, "speed_integral_time_s") in start:
                start[name, "speed_integral_time_s"] = math.log(integral_time)
        yield start
