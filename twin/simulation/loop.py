"""The compiled loop: cascade, terms and engine advance together, tick by tick, and are recorded.

One tick of length h:
    measure    load and rotor at the tick: the engine's semi-implicit steps leave qpos half a step of speed ahead, so the
               position at the tick is qpos - h/2 qvel (exact under constant force); encoders, noise, rounding
    control    position, speed and current controller, each at its own cycle
    winding    exact current over the tick; its mean makes the torque
    step       forces of the terms, then mj_step through its C address
    record     the state at the tick, and how the torque splits; where asked for, what the drives give is counted
Nothing here is global: two loops may run in two threads. An exception cannot leave compiled code, so the loop returns
the tick and axis at which an axis left all bounds.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.simulation.cascade import (
    Drives,
    DriveState,
    current_controller,
    drive_position_loop,
    position_controller,
    speed_controller,
    speed_seen,
    winding,
)
from twin.simulation.drive_load import count_tick, count_work
from twin.simulation.engine_calls import call_address_2, call_address_4
from twin.simulation.loop_record import record_control, record_forces
from twin.simulation.loop_terms import (
    CURRENT,
    DRIVE,
    FORCE,
    MEASURE,
    RECORD,
    SETPOINT,
    SPEED,
    VOLTAGE,
    X_CURRENT,
    X_CURRENT_SETPOINT,
    X_FOLLOWING_ERROR,
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
    X_RECORDED_CURRENT,
    X_ROTOR_FORCE,
    X_ROTOR_MIDDLE,
    X_ROTOR_POSITION,
    X_ROTOR_SPEED,
    X_SCALE,
    X_SETPOINT,
    X_SPEED_SETPOINT,
    X_STEP,
    X_TIME,
    X_VOLTAGE,
    TermTable,
)

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
    """Base tick [s] and the cycles of the controllers and the record in ticks; bounds beyond which a run has diverged, and its ends."""

    tick: float
    position_ticks: int
    speed_ticks: int
    current_ticks: int
    record_ticks: int
    speed_bound: np.ndarray  # (axis,) axis units a second
    end: np.ndarray  # (axis,) ticks of the run; a machine beside longer runs stands behind its end, and nothing is counted there


class Sensing(NamedTuple):
    """Noise and rounding of what the control sees; `noise` (tick, axis, 3) is empty where measuring is ideal."""

    noise: np.ndarray  # already scaled: position, speed (axis units), current
    position_resolution: np.ndarray
    motor_resolution: np.ndarray


class Simulation(NamedTuple):
    """All that a run advances: mechanics, cycles, drives with their state, terms with theirs, and the signals (axis, signal) between them."""

    engine: Engine
    schedule: Schedule
    drives: Drives
    state: DriveState
    terms: TermTable
    signals: np.ndarray


@compiled
def advance(simulation, command, sensing, first_tick, ticks, record, limited, counted):  # type: ignore[no-untyped-def]
    """Advance by `ticks` ticks from `first_tick` on; returns -1, or tick * axes + axis where a run diverged.

    `command` is that of the position cycles of this stretch (`twin.simulation.setpoints.Command`); each record_ticks-th tick fills a
    row of `record` (a Record); limited (axis, 2) counts cycles at the current and voltage limit, `counted` (a DriveSums, without axes
    where nothing is to be counted) what the drives give at every tick. `first_tick` is a multiple of the position cycle and of the record's.
    """
    engine, schedule, drives, state, terms, signals = simulation
    axes = drives.ratio.size
    has_measure = terms.start[MEASURE + 1] > terms.start[MEASURE]
    has_force = terms.start[FORCE + 1] > terms.start[FORCE] or len(command.outside) > 0
    has_drive = terms.start[DRIVE + 1] > terms.start[DRIVE]
    has_record = terms.start[RECORD + 1] > terms.start[RECORD]
    counts = counted.sums.shape[0] > 0

    # cycles are counted, not divided for: a division costs as much as a controller
    row, since_recorded = -1, schedule.record_ticks - 1
    cycle, since_position = -1, schedule.position_ticks - 1
    since_speed, since_current = (first_tick - 1) % schedule.speed_ticks, (first_tick - 1) % schedule.current_ticks
    for n in range(ticks):
        k = first_tick + n
        since_recorded += 1
        since_position += 1
        since_speed += 1
        since_current += 1
        recorded, position_due = since_recorded == schedule.record_ticks, since_position == schedule.position_ticks
        speed_due, current_due = since_speed == schedule.speed_ticks, since_current == schedule.current_ticks
        if recorded:
            since_recorded, row = 0, row + 1
        if position_due:
            since_position, cycle = 0, cycle + 1
        if speed_due:
            since_speed = 0
        if current_due:
            since_current = 0

        for a in range(axes):
            read_mechanics(a, engine, signals, k, schedule.tick)
            if diverged(a, signals, schedule):
                return k * axes + a
        if has_measure:
            call_terms(terms, MEASURE, signals)
        for a in range(axes):
            scale, motor_position, measured_speed, measured_current = seen_by_control(a, signals, drives, state, sensing, n)
            closed_on = motor_position if drives.on_motor_encoder[a] else scale
            if position_due:
                position_cycle(a, drives, state, terms, signals, command, cycle, closed_on)
            differentiated = drives.mean_cycles[a] > 0
            if speed_due:
                if drives.dsc[a]:
                    drive_position_loop(a, drives, state, closed_on)
                if has_drive:
                    received_by_drive(a, drives, state, terms, signals)
                if differentiated or drives.speed_lag[a] < 1.0:
                    measured_speed = speed_seen(a, drives, state, measured_speed, motor_position)
                # what is constant is divided by first, for nothing waits for that
                if speed_controller(a, drives, state, measured_speed * (1.0 / drives.ratio[a])) and k < schedule.end[a]:
                    limited[a, CURRENT_LIMIT] += 1
            elif differentiated:
                measured_speed = state.seen_speed[a]
            if current_due and current_cycle(a, drives, state, terms, signals, measured_current) and k < schedule.end[a]:
                limited[a, VOLTAGE_LIMIT] += 1
            current = state.current[a]
            if not drives.current_loop[a]:  # the command of this cycle acts, and is what the record shows
                measured_current = current
            motor_speed = signals[a, X_MOTOR_SPEED]
            signals[a, X_CURRENT] = current
            signals[a, X_RECORDED_CURRENT] = current
            if has_record:
                call_axis_terms(terms, RECORD, signals, a)
            if recorded:
                record_control(a, row, record, drives, state, signals)
                record.velocity[row, a] = measured_speed if differentiated else motor_speed
                record.seen_position[row, a] = scale
                record.seen_motor_position[row, a] = motor_position
                record.seen_velocity[row, a] = measured_speed if sensing.noise.size > 0 or differentiated else motor_speed
                record.seen_current[row, a] = measured_current + (signals[a, X_RECORDED_CURRENT] - current)
            # winding: the motor turns as fast as its encoder shows
            mean_current = winding(a, drives, state, motor_speed * (1.0 / drives.ratio[a]))
            engine.ctrl[engine.actuator[a]] = drives.torque_constant[a] * mean_current
            if counts:
                cycle_ends = since_position == schedule.position_ticks - 1
                count_tick(
                    a, counted, drives, state, current, mean_current, motor_speed, cycle_ends, schedule.position_ticks, schedule.tick
                )

        if has_force:
            outside_forces(signals, command, cycle)
            forces_of_terms(engine, terms, signals)
        call_address_2(engine.step, engine.model, engine.data)
        if counts:
            for a in range(axes):
                before, after = signals[a, X_ROTOR_SPEED], engine.qvel[engine.rotor_dof[a]]
                turn = 1.0 / drives.ratio[a]
                count_work(a, counted, engine.ctrl[engine.actuator[a]], before * turn, after * turn, schedule.tick)
        if recorded:
            for a in range(axes):
                record_forces(a, row, record, engine, drives, signals)

    if has_force:
        for a in range(axes):
            engine.frictionloss[engine.load_dof[a]] = engine.coulomb_level[a]
    return -1


@compiled(inline=True)
def read_mechanics(a, engine, signals, k, h):  # type: ignore[no-untyped-def]
    """Load and rotor of axis `a` at tick `k`, and what ideal encoders make of them."""
    # measure: mechanics at the tick, half a step of speed behind the engine's positions
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


@compiled(inline=True)
def diverged(a, signals, schedule):  # type: ignore[no-untyped-def]
    """Is axis `a` faster than it could ever be, or its speed no number?"""
    bound = schedule.speed_bound[a]
    return not abs(signals[a, X_ROTOR_SPEED]) < bound or not abs(signals[a, X_LOAD_SPEED]) < bound


@compiled(inline=True)
def seen_by_control(a, signals, drives, state, sensing, n):  # type: ignore[no-untyped-def]
    """Scale, motor position, motor speed [axis units] and current of axis `a` with the noise and rounding of tick `n` of the stretch."""
    scale = signals[a, X_SCALE]
    motor_position = signals[a, X_MOTOR_POSITION]
    speed = signals[a, X_MOTOR_SPEED]
    current = state.current[a]
    if sensing.noise.size > 0:
        noise = sensing.noise[n, a]
        if drives.on_motor_encoder[a]:  # the one encoder that the control has
            motor_position += noise[0]
        else:
            scale = rounded(scale + noise[0], sensing.position_resolution[a])
        motor_position = rounded(motor_position, sensing.motor_resolution[a])
        speed += noise[1]
        current += noise[2]
    return scale, motor_position, speed, current


@compiled(inline=True)
def position_cycle(a, drives, state, terms, signals, command, cycle, closed_on):  # type: ignore[no-untyped-def]
    """The position controller of axis `a`: command of this position cycle, through the terms, against the measured position."""
    setpoint = command.setpoint[cycle, a]
    if terms.start[SETPOINT + 1] > terms.start[SETPOINT]:
        signals[a, X_SETPOINT] = setpoint
        call_axis_terms(terms, SETPOINT, signals, a)
        setpoint = signals[a, X_SETPOINT]
    fed_speed, fed_torque = command.velocity_feedforward[cycle, a], command.torque_feedforward[cycle, a]
    position_controller(a, drives, state, setpoint, fed_speed, fed_torque, closed_on)
    if terms.start[SPEED + 1] > terms.start[SPEED]:
        signals[a, X_SETPOINT] = setpoint
        signals[a, X_FOLLOWING_ERROR] = setpoint - closed_on
        signals[a, X_SPEED_SETPOINT] = state.commanded_speed[a] * drives.ratio[a]
        call_axis_terms(terms, SPEED, signals, a)
        state.commanded_speed[a] = signals[a, X_SPEED_SETPOINT] / drives.ratio[a]
        if not drives.dsc[a]:
            state.speed_setpoint[a] = state.commanded_speed[a]


@compiled(inline=True)
def received_by_drive(a, drives, state, terms, signals):  # type: ignore[no-untyped-def]
    """The speed set point of axis `a` through the terms that lie between the position controller and the speed controller."""
    sent = state.speed_setpoint[a] if drives.dsc[a] else state.commanded_speed[a]
    signals[a, X_SPEED_SETPOINT] = sent * drives.ratio[a]
    call_axis_terms(terms, DRIVE, signals, a)
    state.speed_setpoint[a] = signals[a, X_SPEED_SETPOINT] / drives.ratio[a]


@compiled(inline=True)
def current_cycle(a, drives, state, terms, signals, measured_current):  # type: ignore[no-untyped-def]
    """The current controller of axis `a`, its set point and voltage through the terms; True where the voltage limit is met."""
    current_setpoint = state.current_setpoint[a]
    if terms.start[CURRENT + 1] > terms.start[CURRENT]:
        signals[a, X_CURRENT_SETPOINT] = current_setpoint
        call_axis_terms(terms, CURRENT, signals, a)
        current_setpoint = signals[a, X_CURRENT_SETPOINT]
    limited = current_controller(a, drives, state, current_setpoint, measured_current)
    if terms.start[VOLTAGE + 1] > terms.start[VOLTAGE]:
        signals[a, X_CURRENT] = state.current[a]
        signals[a, X_VOLTAGE] = state.voltage[a]
        call_axis_terms(terms, VOLTAGE, signals, a)
        state.voltage[a] = signals[a, X_VOLTAGE]
    return limited


@compiled(inline=True)
def outside_forces(signals, command, cycle):  # type: ignore[no-untyped-def]
    """Known forces on load and motor from outside in this position cycle; the terms add theirs."""
    for a in range(len(signals)):
        known = len(command.outside) > 0
        signals[a, X_LOAD_FORCE] = command.outside[cycle, a, 0] if known else 0.0
        signals[a, X_ROTOR_FORCE] = command.outside[cycle, a, 1] if known else 0.0


@compiled(inline=True)
def forces_of_terms(engine, terms, signals):  # type: ignore[no-untyped-def]
    """Forces beyond the model's own and those from outside, given to the engine for its next step."""
    for a in range(len(engine.load_dof)):
        x = signals[a]
        x[X_MOTOR_TORQUE] = 0.0
        x[X_FRICTION_FORCE] = 0.0
        x[X_FRICTION_LEVEL] = engine.coulomb_level[a]
    call_terms(terms, FORCE, signals)
    for a in range(len(engine.load_dof)):
        x = signals[a]
        engine.ctrl[engine.actuator[a]] += x[X_MOTOR_TORQUE]
        engine.frictionloss[engine.load_dof[a]] = max(x[X_FRICTION_LEVEL], 0.0)
        on_load = x[X_LOAD_FORCE] + x[X_FRICTION_FORCE]
        if engine.rotor_dof[a] == engine.load_dof[a]:
            engine.applied[engine.load_dof[a]] = on_load + x[X_ROTOR_FORCE]
        else:
            engine.applied[engine.load_dof[a]] = on_load
            engine.applied[engine.rotor_dof[a]] = x[X_ROTOR_FORCE]


@compiled(inline=True)
def call_term(terms, i, signals):  # type: ignore[no-untyped-def]
    """Call term number `i` on its axis."""
    call_address_4(
        terms.address[i],
        terms.parameters.ctypes.data + i * terms.parameters.strides[0],
        terms.state.ctypes.data + i * terms.state.strides[0],
        signals.ctypes.data + terms.first[i] * signals.strides[0],
        terms.axis[i],
    )


@compiled
def call_terms(terms, stage, signals):  # type: ignore[no-untyped-def]
    """Call the terms of one stage, in their order."""
    for i in range(terms.start[stage], terms.start[stage + 1]):
        call_term(terms, i, signals)


@compiled
def call_axis_terms(terms, stage, signals, axis):  # type: ignore[no-untyped-def]
    """Call the terms of one stage that belong to one row of the signals."""
    for i in range(terms.of_axis[stage, axis], terms.of_axis[stage, axis + 1]):
        call_term(terms, i, signals)


@compiled(inline=True)
def rounded(value, resolution):  # type: ignore[no-untyped-def]
    """The nearest multiple of a resolution; the value itself where the resolution is 0."""
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
