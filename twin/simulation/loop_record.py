"""Channels that the compiled loop records for each axis: encoders and drive at a tick, and the torque balance of the following step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.simulation.loop_terms import X_FRICTION_FORCE, X_LOAD_POSITION, X_MOTOR_POSITION, X_RECORDED_CURRENT, X_SCALE


class Record(NamedTuple):
    """Recorded channels, each (row, axis) in SI; torques in Nm at the motor. The `seen_` channels include noise and quantisation."""

    position: np.ndarray  # direct measuring system
    motor_position: np.ndarray  # motor encoder, axis units
    load_position: np.ndarray  # true position of the load
    velocity: np.ndarray  # motor speed, axis units
    velocity_setpoint: np.ndarray  # output of the NC's position controller
    current: np.ndarray  # A, or the command of an axis without current loop
    current_setpoint: np.ndarray
    torque: np.ndarray  # motor torque
    torque_feedforward: np.ndarray  # active in the drive
    torque_friction: np.ndarray  # torque against friction
    torque_gravity: np.ndarray  # torque against gravity and Coriolis forces
    drive_velocity_setpoint: np.ndarray  # active in the drive
    seen_position: np.ndarray
    seen_motor_position: np.ndarray
    seen_velocity: np.ndarray
    seen_current: np.ndarray

    def rows(self, first: int) -> Record:
        """The record from row `first`."""
        return Record(*(values[first:] for values in self))


SEEN = "seen_"
RECORDED = tuple(name for name in Record._fields if not name.startswith(SEEN))
"""Channels without measuring noise."""

MEASURED = tuple(name.removeprefix(SEEN) for name in Record._fields if name.startswith(SEEN))
"""Channels that are also recorded as the control sees them."""


def empty_record(rows: int, axes: int) -> Record:
    """An uninitialised record; the channels of a row are contiguous in memory."""
    return Record(*np.moveaxis(np.empty((rows, axes, len(Record._fields))), -1, 0))


@compiled(inline=True)
def record_control(a, row, record, drives, state, signals):  # type: ignore[no-untyped-def]
    """Record encoders and drive of axis `a` at the tick, after its controllers."""
    record.position[row, a] = signals[a, X_SCALE]
    record.motor_position[row, a] = signals[a, X_MOTOR_POSITION]
    record.load_position[row, a] = signals[a, X_LOAD_POSITION]
    record.velocity_setpoint[row, a] = state.commanded_speed[a] * drives.ratio[a]
    record.drive_velocity_setpoint[row, a] = state.speed_setpoint[a] * drives.ratio[a]
    record.current[row, a] = signals[a, X_RECORDED_CURRENT]
    record.current_setpoint[row, a] = state.current_setpoint[a]
    record.torque[row, a] = drives.torque_constant[a] * state.current[a]
    record.torque_feedforward[row, a] = state.torque_feedforward[a]


@compiled(inline=True)
def record_forces(a, row, record, engine, drives, signals):  # type: ignore[no-untyped-def]
    """Record the torque balance of axis `a` in the step after the tick."""
    dof = engine.friction_dof[a]
    record.torque_friction[row, a] = -(engine.passive[dof] + engine.constraint[dof] + signals[a, X_FRICTION_FORCE]) * drives.ratio[a]
    record.torque_gravity[row, a] = engine.bias[engine.load_dof[a]] * drives.ratio[a]
