"""What the compiled loop records of each axis: encoders and drive at a tick, and how the torque splits in the step after it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.simulation.loop_terms import X_FRICTION_FORCE, X_LOAD_POSITION, X_MOTOR_POSITION, X_RECORDED_CURRENT, X_SCALE


class Record(NamedTuple):
    """What is recorded, each (row, axis) in SI; torques in Nm at the motor. The last four are as the control saw them, with noise and rounding."""

    position: np.ndarray  # measuring system at the load
    motor_position: np.ndarray  # motor encoder, axis units
    load_position: np.ndarray  # where the load truly is: no encoder shows it
    velocity: np.ndarray  # of the motor, axis units
    velocity_setpoint: np.ndarray  # as the position controller of the NC computes it
    current: np.ndarray  # A, or the command of an axis without current loop
    current_setpoint: np.ndarray
    torque: np.ndarray  # the motor's
    torque_feedforward: np.ndarray  # in force in the drive
    torque_friction: np.ndarray  # what friction takes
    torque_gravity: np.ndarray  # what gravity takes
    drive_velocity_setpoint: np.ndarray  # in force in the drive
    seen_position: np.ndarray
    seen_motor_position: np.ndarray
    seen_velocity: np.ndarray
    seen_current: np.ndarray

    def rows(self, first: int) -> Record:
        """The record from a row on."""
        return Record(*(values[first:] for values in self))


SEEN = "seen_"
RECORDED = tuple(name for name in Record._fields if not name.startswith(SEEN))
"""Channels of the record."""

MEASURED = tuple(name.removeprefix(SEEN) for name in Record._fields if name.startswith(SEEN))
"""Channels that the record has once more, as the control saw them."""


def empty_record(rows: int, axes: int) -> Record:
    """A record to be filled; all channels of a row lie side by side in memory."""
    return Record(*np.moveaxis(np.empty((rows, axes, len(Record._fields))), -1, 0))


@compiled(inline=True)
def record_control(a, row, record, drives, state, signals):  # type: ignore[no-untyped-def]
    """Encoders and drive of axis `a` at the tick, after its controllers."""
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
    """How the torque of axis `a` splits in the step after the tick."""
    dof = engine.load_dof[a]
    record.torque_friction[row, a] = -(engine.passive[dof] + engine.constraint[dof] + signals[a, X_FRICTION_FORCE]) * drives.ratio[a]
    record.torque_gravity[row, a] = engine.bias[dof] * drives.ratio[a]
