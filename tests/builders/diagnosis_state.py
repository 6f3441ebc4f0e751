"""States of a diagnosis with chosen numbers: real groups, fits and states whose residuals are given, not simulated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.diagnose.channel import Channel
from twin.diagnose.columns import Columns
from twin.diagnose.fit import Fit, no_effect
from twin.diagnose.observe import Group
from twin.diagnose.state import GroupState
from twin.diagnose.tuning import Tuning, tuning_from
from twin.diagnose.view import RunView
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace
from twin.simulation.decoupled_plant import Motion
from twin.simulation.setpoints import Setpoints

PERIOD_S = 1e-3
MOVING_STEP_M = 1e-4


def view_with(machine: Machine, moving: np.ndarray, name: str = "run") -> RunView:
    """A run in which the set point of every axis moves where `moving` (sample,) is true."""
    position = MOVING_STEP_M * np.cumsum(moving)[:, None] * np.ones(len(machine.axes))
    time = PERIOD_S * np.arange(len(moving))
    trace = Trace(
        time, {(axis, "setpoint"): position[:, a] for a, axis in enumerate(machine.axis_names)}, {a.name: a.kind for a in machine.axes}
    )
    speed = np.gradient(position, PERIOD_S, axis=0)
    motion = Motion(position, speed, np.gradient(speed, PERIOD_S, axis=0), PERIOD_S)
    nothing = np.zeros(len(moving))
    references = {axis: (nothing, position[:, a], moving) for a, axis in enumerate(machine.axis_names)}
    setpoints = Setpoints(position, PERIOD_S)
    return RunView(name, trace, None, 0.0, machine=machine, file=machine, setpoints=setpoints, motion=motion, references=references)


def group_of(runs: Sequence[np.ndarray], axes: str = "X", moving: np.ndarray | None = None) -> Group:
    """A group of which each run leaves these rows (sample,) of the speed of each axis, in units of its noise.

    The axes move all the time, or where `moving` (sample,) says so. Every row weighs 1.
    """
    machine = load_machine().with_axes(list(axes))
    views = [view_with(machine, np.ones(len(rows), bool) if moving is None else moving, f"run {k}") for k, rows in enumerate(runs)]
    channels = [
        Channel(k, axis, "velocity", np.asarray(rows, float), np.ones(len(rows)), 1.0) for k, rows in enumerate(runs) for axis in axes
    ]
    return Group(tuple(axes), views, channels, [{} for _ in runs], [{} for _ in runs], 0)


def no_tuning(rows: int) -> Tuning:
    """A tuning without nuisances of a group with so many rows."""
    return tuning_from((), Columns([], rows), 0.01)


def columns_of(matrix: np.ndarray) -> Columns:
    """The columns of a matrix (row, n)."""
    return Columns(matrix.T, len(matrix))


def found_of(group: Group, tuning: Tuning | None = None, fit: Fit | None = None) -> GroupState:
    """The state of a search that has found the effects of this fit; without one none."""
    tuning = tuning or (fit.about if fit else no_tuning(group.size))
    state = GroupState(group, group, tuning, fit or no_effect(group, tuning), 1.0)
    return state.with_accepted(1) if fit else state
