"""Channels that the compiled loop records for each axis: encoders and drive at a tick, and the torque balance of the following step.

A record is one array (row, axis, channel) in SI, torques in Nm at the motor. An array for each channel costs the loop as
much time for their addresses, at every tick, as all its laws.
"""

from __future__ import annotations

import numpy as np

from twin.compiled_functions import compiled
from twin.simulation.loop_terms import (
    X_FRICTION_FORCE,
    X_LOAD_POSITION,
    X_MOTOR_POSITION,
    X_RECORDED_CURRENT,
    X_RECORDED_SPEED_SETPOINT,
    X_SCALE,
)

RECORDED = (
    "position",  # direct measuring system
    "motor_position",  # motor encoder, axis units
    "load_position",  # true position of the load
    "velocity",  # motor speed, axis units
    "velocity_setpoint",  # output of the NC's position controller, as it is recorded
    "current",  # A, or the command of an axis without current loop
    "current_setpoint",
    "torque",  # motor torque
    "torque_feedforward",  # active in the drive
    "torque_friction",  # torque against friction
    "torque_gravity",  # torque against gravity and Coriolis forces
    "drive_velocity_setpoint",  # active in the drive
)
"""Channels without measuring noise."""

MEASURED = ("position", "motor_position", "velocity", "current")
"""Channels that are also recorded as the control sees them, with noise and quantisation; they follow the others."""

(
    POSITION, MOTOR_POSITION, LOAD_POSITION, VELOCITY, VELOCITY_SETPOINT, CURRENT, CURRENT_SETPOINT, TORQUE, TORQUE_FEEDFORWARD,
    TORQUE_FRICTION, TORQUE_GRAVITY, DRIVE_VELOCITY_SETPOINT, SEEN_POSITION, SEEN_MOTOR_POSITION, SEEN_VELOCITY, SEEN_CURRENT,
) = range(len(RECORDED) + len(MEASURED))  # fmt: skip


def empty_record(rows: int, axes: int) -> np.ndarray:
    """An uninitialised record."""
    return np.empty((rows, axes, len(RECORDED) + len(MEASURED)))


@compiled(inline=True)
def record_control(a, row, record, drives, state, signals):  # type: ignore[no-untyped-def]
    """Record encoders and drive of axis `a` at the tick, after its controllers."""
    record[row, a, POSITION] = signals[a, X_SCALE]
    record[row, a, MOTOR_POSITION] = signals[a, X_MOTOR_POSITION]
    record[row, a, LOAD_POSITION] = signals[a, X_LOAD_POSITION]
    record[row, a, VELOCITY_SETPOINT] = signals[a, X_RECORDED_SPEED_SETPOINT]
    record[row, a, DRIVE_VELOCITY_SETPOINT] = state.speed_setpoint[a] * drives.ratio[a]
    record[row, a, CURRENT] = signals[a, X_RECORDED_CURRENT]
    record[row, a, CURRENT_SETPOINT] = state.current_setpoint[a]
    record[row, a, TORQUE] = drives.torque_constant[a] * state.current[a]
    record[row, a, TORQUE_FEEDFORWARD] = state.torque_feedforward[a]


@compiled(inline=True)
def record_forces(a, row, record, engine, drives, signals):  # type: ignore[no-untyped-def]
    """Record the torque balance of axis `a` in the step after the tick."""
    places = engine.places
    dof = places.friction_dof[a]
    friction = engine.passive[dof] + engine.constraint[dof] + signals[a, X_FRICTION_FORCE]
    if places.other_side_level[a] > 0.0:
        other = places.load_dof[a] + places.rotor_dof[a] - dof
        friction += engine.passive[other] + engine.constraint[other]
    record[row, a, TORQUE_FRICTION] = -friction * drives.ratio[a]
    record[row, a, TORQUE_GRAVITY] = engine.bias[engine.places.load_dof[a]] * drives.ratio[a]
