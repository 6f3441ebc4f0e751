"""The compiled loop: cascade, terms and engine advance together, tick by tick, and are recorded.

One tick of length h:
    measure    load and rotor at the tick: the engine's semi-implicit steps leave qpos half a step of speed ahead, so the
               position at the tick is qpos - h/2 qvel (exact under constant force); encoders, noise, rounding
    control    position, speed and current controller, each at its own cycle
    winding    exact current over the tick; its mean makes the torque
    step       forces of the terms, then mj_step through its C address
    record     the state at the tick, and how the torque splits
Nothing here is global: two loops may run in two threads. An exception cannot leave compiled code, so the loop returns
the tick and axis at which an axis left all bounds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.simulation.cascade import current_controller, drive_position_loop, position_controller, speed_controller, speed_seen, winding
from twin.simulation.engine_calls import call_address_2, call_address_4
from twin.simulation.loop_terms import (
    CURRENT,
    FORCE,
    MEASURE,
    SETPOINT,
    X_CURRENT_SETPOINT,
    X_FRICTION_FORCE,
    X_FRICTION_LEVEL,
    X_LOAD_ACCELERATION,
    X_LOAD_FORCE,
    X_LOAD_MIDDLE,
    X_LOAD_POSITION,
    X_LOAD_SPEED,
    X_MOTOR_POSITION,
    X_MOTOR_SPEED,
    X_MOTOR_TORQUE,
    X_ROTOR_FORCE,
    X_ROTOR_MIDDLE,
    X_ROTOR_POSITION,
    X_ROTOR_SPEED,
    X_SCALE,
    X_SETPOINT,
    X_STEP,
    X_TIME,
)

RECORDED = (
    "position",
    "motor_position",
    "velocity",
    "velocity_setpoint",
    "current",
    "current_setpoint",
    "torque",
    "torque_feedforward",
    "torque_friction",
    "torque_gravity",
    "drive_velocity_setpoint",
)
"""Channels of the record, in SI; torques in Nm at the motor: the motor's, the feedforward's, and what friction and gravity take."""

MEASURED = ("position", "motor_position", "velocity", "current")
"""Channels that follow in each row of the record: these once more, as the control saw them, with noise and rounding."""

CURRENT_LIMIT, VOLTAGE_LIMIT = 0, 1


class Engine(NamedTuple):
    """Addresses of mj_step, model and data, and views of their arrays."""

    step: int
    model: int
    data: int
    qpos: np.ndarray
    qvel: np.ndarray
    ctrl: np.ndarray
    applied: np.ndarray  # qfrc_applied
    bias: np.ndarray  # qfrc_bias: gravity and Coriolis
    passive: np.ndarray  # qfrc_passive: viscous
    constraint: np.ndarray  # qfrc_constraint: Coulomb
    frictionloss: np.ndarray
    coulomb_level: np.ndarray  # (axis,) what frictionloss is without effects, restored after each call
    load_position: np.ndarray
    load_dof: np.ndarray
    rotor_position: np.ndarray
    rotor_dof: np.ndarray
    actuator: np.ndarray


class Schedule(NamedTuple):
    """Base tick [s] and the cycles of the controllers and the record in ticks; bounds beyond which a run has diverged."""

    tick: float
    position_ticks: int
    speed_ticks: int
    current_ticks: int
    record_ticks: int
    speed_bound: np.ndarray  # (axis,) axis units a second


class Sensing(NamedTuple):
    """Noise and rounding of what the control sees; `noise` (tick, axis, 3) is empty where measuring is ideal."""

    noise: np.ndarray  # already scaled: position, speed (axis units), current
    position_resolution: np.ndarray
    motor_resolution: np.ndarray


@compiled
def advance(engine, schedule, drives, state, terms, signals, command, sensing, first_tick, ticks, record, limited):  # type: ignore[no-untyped-def]
    """Advance by `ticks` ticks from `first_tick` on; returns -1, or tick * axes + axis where a run diverged.

    `command` is that of the position cycles of this stretch (`twin.simulation.setpoints.Command`);
    record (row, axis, channel) gets each record_ticks-th tick; limited (axis, 2) counts ticks at the current and voltage limit.
    `first_tick` is a multiple of the position cycle and of the record's.
    """
    axes = drives.ratio.size
    h = schedule.tick
    noisy = sensing.noise.size > 0
    has_measure = terms.start[MEASURE + 1] > terms.start[MEASURE]
    has_setpoint = terms.start[SETPOINT + 1] > terms.start[SETPOINT]
    has_current = terms.start[CURRENT + 1] > terms.start[CURRENT]
    has_force = terms.start[FORCE + 1] > terms.start[FORCE]

    for n in range(ticks):
        k = first_tick + n

        # measure: mechanics at the tick, then what the encoders make of it
        for a in range(axes):
            x = signals[a]
            speed = engine.qvel[engine.load_dof[a]]
            middle = engine.qpos[engine.load_position[a]]
            rotor_speed = engine.qvel[engine.rotor_dof[a]]
            rotor_middle = engine.qpos[engine.rotor_position[a]]
            x[X_TIME] = k * h
            x[X_STEP] = h
            x[X_LOAD_ACCELERATION] = (speed - x[X_LOAD_SPEED]) / h
            x[X_LOAD_SPEED] = speed
            x[X_LOAD_MIDDLE] = middle
            x[X_LOAD_POSITION] = middle - 0.5 * h * speed
            x[X_ROTOR_SPEED] = rotor_speed
            x[X_ROTOR_MIDDLE] = rotor_middle
            x[X_ROTOR_POSITION] = rotor_middle - 0.5 * h * rotor_speed
            x[X_SCALE] = x[X_LOAD_POSITION]
            x[X_MOTOR_POSITION] = x[X_ROTOR_POSITION]
            x[X_MOTOR_SPEED] = rotor_speed
            if not abs(rotor_speed) < schedule.speed_bound[a] or not abs(speed) < schedule.speed_bound[a]:
                return k * axes + a
        if has_measure:
            call_terms(terms, MEASURE, signals)
        for a in range(axes):
            x = signals[a]
            scale = x[X_SCALE]
            motor_position = x[X_MOTOR_POSITION]
            motor_speed = measured_speed = x[X_MOTOR_SPEED]
            current = state.current[a]
            measured_current = current
            if noisy:
                noise = sensing.noise[n, a]
                if drives.on_motor_encoder[a]:  # the one encoder that the control has
                    motor_position += noise[0]
                else:
                    scale = rounded(scale + noise[0], sensing.position_resolution[a])
                motor_position = rounded(motor_position, sensing.motor_resolution[a])
                measured_speed += noise[1]
                measured_current += noise[2]

            closed_on = motor_position if drives.on_motor_encoder[a] else scale

            # control: each loop at its own cycle; what is constant is divided by first, for nothing waits for that
            if k % schedule.position_ticks == 0:
                cycle = n // schedule.position_ticks
                setpoint = command.setpoint[cycle, a]
                if has_setpoint:
                    x[X_SETPOINT] = setpoint
                    call_axis_terms(terms, SETPOINT, signals, a)
                    setpoint = x[X_SETPOINT]
                fed_speed, fed_torque = command.velocity_feedforward[cycle, a], command.torque_feedforward[cycle, a]
                position_controller(a, drives, state, setpoint, fed_speed, fed_torque, closed_on)
            differentiated = drives.mean_cycles[a] > 0
            if k % schedule.speed_ticks == 0:
                if drives.dsc[a]:
                    drive_position_loop(a, drives, state, closed_on)
                if differentiated or drives.speed_lag[a] < 1.0:
                    measured_speed = speed_seen(a, drives, state, measured_speed, motor_position)
                if speed_controller(a, drives, state, measured_speed * (1.0 / drives.ratio[a])):
                    limited[a, CURRENT_LIMIT] += 1
            elif differentiated:
                measured_speed = state.seen_speed[a]
            if k % schedule.current_ticks == 0:
                current_setpoint = state.current_setpoint[a]
                if has_current:
                    x[X_CURRENT_SETPOINT] = current_setpoint
                    call_axis_terms(terms, CURRENT, signals, a)
                    current_setpoint = x[X_CURRENT_SETPOINT]
                if current_controller(a, drives, state, current_setpoint, measured_current):
                    limited[a, VOLTAGE_LIMIT] += 1
                if not drives.current_loop[a]:  # the command of this cycle acts, and is what the record shows
                    current = measured_current = state.current[a]

            if n % schedule.record_ticks == 0:
                row = record[n // schedule.record_ticks, a]
                row[0] = x[X_SCALE]
                row[1] = x[X_MOTOR_POSITION]
                row[2] = measured_speed if differentiated else motor_speed
                row[3] = state.commanded_speed[a] * drives.ratio[a]
                row[4] = current
                row[5] = state.current_setpoint[a]
                row[6] = drives.torque_constant[a] * current
                row[7] = state.torque_feedforward[a]
                row[10] = state.speed_setpoint[a] * drives.ratio[a]
                row[11] = scale
                row[12] = motor_position
                row[13] = measured_speed if noisy or differentiated else motor_speed
                row[14] = measured_current

            # winding: the motor turns as fast as its encoder shows
            torque = drives.torque_constant[a] * winding(a, drives, state, motor_speed * (1.0 / drives.ratio[a]))
            engine.ctrl[engine.actuator[a]] = torque

        # step: forces beyond the model's own, then the engine
        if has_force:
            for a in range(axes):
                x = signals[a]
                x[X_LOAD_FORCE] = 0.0
                x[X_ROTOR_FORCE] = 0.0
                x[X_MOTOR_TORQUE] = 0.0
                x[X_FRICTION_FORCE] = 0.0
                x[X_FRICTION_LEVEL] = engine.coulomb_level[a]
            call_terms(terms, FORCE, signals)
            for a in range(axes):
                x = signals[a]
                engine.ctrl[engine.actuator[a]] += x[X_MOTOR_TORQUE]
                engine.frictionloss[engine.load_dof[a]] = max(x[X_FRICTION_LEVEL], 0.0)
                on_load = x[X_LOAD_FORCE] + x[X_FRICTION_FORCE]
                if engine.rotor_dof[a] == engine.load_dof[a]:
                    engine.applied[engine.load_dof[a]] = on_load + x[X_ROTOR_FORCE]
                else:
                    engine.applied[engine.load_dof[a]] = on_load
                    engine.applied[engine.rotor_dof[a]] = x[X_ROTOR_FORCE]
        call_address_2(engine.step, engine.model, engine.data)

        if n % schedule.record_ticks == 0:
            for a in range(axes):
                row = record[n // schedule.record_ticks, a]
                dof = engine.load_dof[a]
                row[8] = -(engine.passive[dof] + engine.constraint[dof] + signals[a, X_FRICTION_FORCE]) * drives.ratio[a]
                row[9] = engine.bias[dof] * drives.ratio[a]

    if has_force:
        for a in range(axes):
            engine.frictionloss[engine.load_dof[a]] = engine.coulomb_level[a]
    return -1


@compiled
def call_terms(terms, stage, signals):  # type: ignore[no-untyped-def]
    """Call the terms of one stage, in their order."""
    for i in range(terms.start[stage], terms.start[stage + 1]):
        call_address_4(
            terms.address[i],
            terms.parameters.ctypes.data + i * terms.parameters.strides[0],
            terms.state.ctypes.data + i * terms.state.strides[0],
            signals.ctypes.data,
            terms.axis[i],
        )


@compiled
def call_axis_terms(terms, stage, signals, axis):  # type: ignore[no-untyped-def]
    """Call the terms of one stage that belong to one axis."""
    for i in range(terms.start[stage], terms.start[stage + 1]):
        if terms.axis[i] == axis:
            call_address_4(
                terms.address[i],
                terms.parameters.ctypes.data + i * terms.parameters.strides[0],
                terms.state.ctypes.data + i * terms.state.strides[0],
                signals.ctypes.data,
                axis,
            )


@compiled(inline=True)
def rounded(value, resolution):  # type: ignore[no-untyped-def]
    """The nearest multiple of a resolution; the value itself where the resolution is 0."""
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
