"""The compiled loop: advances cascade, terms and engine tick by tick and records them.

One tick of length h:
    measure    state of load and rotor at the tick, encoders, noise, quantisation. The engine integrates by semi-implicit Euler, so qpos
               leads by half a step: the position at the tick is qpos - h/2 qvel, exact under constant force
    control    position, speed and current controller, each at its own cycle
    winding    exact solution of the current over the tick; its mean gives the torque
    step       forces of the terms, then mj_step through its C address
    record     the state at the tick and the torque balance; optionally the load of the drives
The loop has no global state, so several loops may run in threads. Compiled code cannot raise an exception, so the loop returns tick and
axis of a divergence.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.control.current_controller import current_controller, winding
from twin.control.drive_position_loop import drive_position_loop
from twin.control.position_controller import position_controller
from twin.control.speed_controller import speed_controller, speed_seen
from twin.simulation import loop_record, loop_terms
from twin.simulation.axis_table import AxisTable
from twin.simulation.drive_load import count_tick, count_work
from twin.simulation.engine_calls import call_address_2, call_address_4
from twin.simulation.loop_terms import CURRENT, DRIVE, FORCE, MEASURE, RECORD, SETPOINT, SPEED, VOLTAGE, TermTable

CURRENT_LIMIT, VOLTAGE_LIMIT = 0, 1


class Engine(NamedTuple):
    """Addresses of mj_step, model and data, views of their arrays, and the places (axis,) in them."""

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
    places: AxisTable  # with the columns of `Places`


class Places(NamedTuple):
    """Columns of the places of all axes in the engine, each (axis,).

    The loop counts axes and indices by unsigned numbers: it would ask each signed index whether it counts from the end.
    """

    coulomb_level: np.ndarray  # frictionloss without effects where effects of friction act, restored after each call
    other_side_level: np.ndarray  # frictionloss on the other side of an elastic drive train
    load_position: np.ndarray  # this and all others: index, uint64
    load_dof: np.ndarray
    rotor_position: np.ndarray
    rotor_dof: np.ndarray
    friction_dof: np.ndarray  # where friction acts: of the load, or of the rotor
    actuator: np.ndarray


def friction_levels(loss: np.ndarray, load: np.ndarray, rotor: np.ndarray, friction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frictionloss (axis,) where effects of friction act, and on the other side of an elastic drive train, 0 on a rigid one, of those of all
    degrees of freedom; `load`, `rotor` and `friction` (axis,) are the places of each axis.
    """
    other = load + rotor - friction
    return loss[friction], np.where(other == friction, 0.0, loss[other])


class Schedule(NamedTuple):
    """Base tick [s], controller cycles and record period in ticks, divergence bounds and ends of the runs."""

    tick: float
    position_ticks: int
    speed_ticks: int
    current_ticks: int
    record_ticks: int
    speed_bound: np.ndarray  # (axis,) axis units/s
    end: np.ndarray  # (axis,) ticks of the run; cycles at the limits are not counted after it


class Sensors(NamedTuple):
    """Columns of the sensors of all axes, each (axis,). Standard deviations in axis units, A."""

    row: np.ndarray  # int64: where the random numbers of an axis stand
    closing: np.ndarray  # deviation of the encoder of the position loop
    speed: np.ndarray  # deviation of the speed
    current: np.ndarray  # deviation of the current
    other: np.ndarray  # deviation of the other encoder
    position_resolution: np.ndarray
    motor_resolution: np.ndarray


class Sensing(NamedTuple):
    """Noise and quantisation of the sensors. Axes with the same random numbers share them; `drawn` is empty for ideal sensors."""

    drawn: np.ndarray  # (tick, row, 3) standard normal: encoder of the position loop, speed, current
    beside: np.ndarray  # (tick, row) the same for the other encoder; empty if it is ideal
    sensors: AxisTable  # with the columns of `Sensors`


class Simulation(NamedTuple):
    """State of a run: mechanics, schedule, drives, terms, and the signals (axis, signal) that they exchange."""

    engine: Engine
    schedule: Schedule
    drives: AxisTable  # constants and state of the cascade, `cascade.Drives` and `cascade.DriveState`
    state: AxisTable
    sent: np.ndarray  # `cascade.nothing_sent`
    terms: TermTable
    signals: np.ndarray


@compiled
def advance(simulation, command, sensing, first_tick, ticks, record, limited, load_sums):  # type: ignore[no-untyped-def]
    """Advance by `ticks` ticks from `first_tick`; returns -1, or tick * axes + axis of a divergence.

    `first_tick` is a multiple of the position cycle and of the record period. `command` (a Command) covers the position cycles of this
    stretch. Every record_ticks-th tick fills a row of `record`. `limited` (axis, 2) counts cycles at the current and voltage
    limit. `load_sums` (a DriveSums) accumulates the load of the drives; it has no axes if the load is not counted.
    """
    engine, schedule, drives, state, sent, terms, signals = simulation
    axes = np.uint64(drives.size)
    has_measure = terms.start[MEASURE + 1] > terms.start[MEASURE]
    has_force = terms.start[FORCE + 1] > terms.start[FORCE] or len(command.external_force) > 0
    has_drive = terms.start[DRIVE + 1] > terms.start[DRIVE]
    has_record = terms.start[RECORD + 1] > terms.start[RECORD]
    counts_load = load_sums.sums.shape[0] > 0

    # count the ticks of each cycle: a modulo operation costs as much as a controller
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
                return k * len(drives) + np.int64(a)
        if has_measure:
            if sensing.drawn.size > 0:
                for a in range(axes):
                    signals[a, loop_terms.X_NOISE] = sensing.drawn[n, sensing.sensors.row[a], 0] * sensing.sensors.closing[a]
            call_terms(terms, MEASURE, signals)
        for a in range(axes):
            scale, motor_position, measured_speed, measured_current = seen_by_control(a, signals, drives, state, sensing, n)
            closed_on = motor_position if drives.on_motor_encoder[a] else scale
            if position_due:
                position_cycle(a, drives, state, terms, signals, command, cycle, closed_on)
            differentiated = drives.mean_cycles[a] > 0
            if speed_due:
                if drives.dsc[a]:
                    drive_position_loop(a, drives, state, sent, closed_on)
                if has_drive:
                    received_by_drive(a, drives, state, terms, signals)
                if differentiated or drives.speed_lag[a] < 1.0:
                    measured_speed = speed_seen(a, drives, state, measured_speed, motor_position)
                if speed_controller(a, drives, state, measured_speed * drives.per_ratio[a]) and k < schedule.end[a]:
                    limited[a, CURRENT_LIMIT] += 1
            elif differentiated:
                measured_speed = state.seen_speed[a]
            if current_due and current_cycle(a, drives, state, terms, signals, measured_current) and k < schedule.end[a]:
                limited[a, VOLTAGE_LIMIT] += 1
            current = state.current[a]
            if not drives.current_loop[a]:  # the command acts within the cycle and is recorded
                measured_current = current
            motor_speed = signals[a, loop_terms.X_MOTOR_SPEED]
            signals[a, loop_terms.X_CURRENT] = current
            signals[a, loop_terms.X_RECORDED_CURRENT] = current
            if has_record:
                call_axis_terms(terms, RECORD, signals, a)
            if recorded:
                loop_record.record_control(a, row, record, drives, state, signals)
                record[row, a, loop_record.VELOCITY] = measured_speed if differentiated else motor_speed
                record[row, a, loop_record.SEEN_POSITION] = scale
                record[row, a, loop_record.SEEN_MOTOR_POSITION] = motor_position
                record[row, a, loop_record.SEEN_VELOCITY] = measured_speed if sensing.drawn.size > 0 or differentiated else motor_speed
                record[row, a, loop_record.SEEN_CURRENT] = measured_current + (signals[a, loop_terms.X_RECORDED_CURRENT] - current)
            # winding: the back-EMF follows the speed of the motor encoder
            mean_current = winding(a, drives, state, motor_speed * drives.per_ratio[a])
            engine.ctrl[engine.places.actuator[a]] = drives.torque_constant[a] * mean_current
            if counts_load:
                cycle_ends = since_position == schedule.position_ticks - 1
                count_tick(
                    a, load_sums, drives, state, current, mean_current, motor_speed, cycle_ends, schedule.position_ticks, schedule.tick
                )

        if has_force:
            forces_of_terms(engine, terms, signals, command, cycle)
        call_address_2(engine.step, engine.model, engine.data)
        if counts_load:
            for a in range(axes):
                before, after = signals[a, loop_terms.X_ROTOR_SPEED], engine.qvel[engine.places.rotor_dof[a]]
                per_ratio = drives.per_ratio[a]
                count_work(a, load_sums, engine.ctrl[engine.places.actuator[a]], before * per_ratio, after * per_ratio, schedule.tick)
        if recorded:
            for a in range(axes):
                loop_record.record_forces(a, row, record, engine, drives, signals)

    if has_force:
        for a in range(axes):
            engine.frictionloss[engine.places.friction_dof[a]] = engine.places.coulomb_level[a]
    return -1


@compiled(inline=True)
def read_mechanics(a, engine, signals, k, h):  # type: ignore[no-untyped-def]
    """State of load and rotor of axis `a` at tick `k`, and the readings of ideal encoders."""
    x = signals[a]
    speed = engine.qvel[engine.places.load_dof[a]]
    middle = engine.qpos[engine.places.load_position[a]]
    rotor_speed = engine.qvel[engine.places.rotor_dof[a]]
    rotor_middle = engine.qpos[engine.places.rotor_position[a]]
    x[loop_terms.X_TIME] = k * h
    x[loop_terms.X_STEP] = h
    x[loop_terms.X_LOAD_ACCELERATION] = (speed - x[loop_terms.X_LOAD_SPEED]) / h
    x[loop_terms.X_LOAD_SPEED] = speed
    x[loop_terms.X_LOAD_MIDDLE] = middle
    x[loop_terms.X_LOAD_POSITION] = middle - 0.5 * h * speed
    x[loop_terms.X_ROTOR_SPEED] = rotor_speed
    x[loop_terms.X_ROTOR_MIDDLE] = rotor_middle
    x[loop_terms.X_ROTOR_POSITION] = rotor_middle - 0.5 * h * rotor_speed
    x[loop_terms.X_SCALE] = x[loop_terms.X_LOAD_POSITION]
    x[loop_terms.X_MOTOR_POSITION] = x[loop_terms.X_ROTOR_POSITION]
    x[loop_terms.X_MOTOR_SPEED] = rotor_speed


@compiled(inline=True)
def diverged(a, signals, schedule):  # type: ignore[no-untyped-def]
    """Whether the speed of axis `a` exceeds its bound or is not a number."""
    bound = schedule.speed_bound[a]
    return not abs(signals[a, loop_terms.X_ROTOR_SPEED]) < bound or not abs(signals[a, loop_terms.X_LOAD_SPEED]) < bound


@compiled(inline=True)
def seen_by_control(a, signals, drives, state, sensing, n):  # type: ignore[no-untyped-def]
    """Scale, motor position, motor speed [axis units] and current of axis `a` with noise and quantisation at tick `n` of the stretch."""
    scale = signals[a, loop_terms.X_SCALE]
    motor_position = signals[a, loop_terms.X_MOTOR_POSITION]
    speed = signals[a, loop_terms.X_MOTOR_SPEED]
    current = state.current[a]
    if sensing.drawn.size > 0:
        sensors = sensing.sensors
        row = sensors.row[a]
        closing = sensing.drawn[n, row, 0] * sensors.closing[a]
        other = sensing.beside[n, row] * sensors.other[a] if sensing.beside.size > 0 else 0.0
        if drives.on_motor_encoder[a]:
            closing, other = other, closing
        scale = rounded(scale + closing, sensors.position_resolution[a])
        motor_position = rounded(motor_position + other, sensors.motor_resolution[a])
        speed += sensing.drawn[n, row, 1] * sensors.speed[a]
        current += sensing.drawn[n, row, 2] * sensors.current[a]
    return scale, motor_position, speed, current


@compiled(inline=True)
def position_cycle(a, drives, state, terms, signals, command, cycle, closed_on):  # type: ignore[no-untyped-def]
    """The position controller of axis `a` in this position cycle, with the SETPOINT and SPEED terms; `closed_on` is its measured position."""
    setpoint = command.setpoint[cycle, a]
    if terms.start[SETPOINT + 1] > terms.start[SETPOINT]:
        signals[a, loop_terms.X_SETPOINT] = setpoint
        call_axis_terms(terms, SETPOINT, signals, a)
        setpoint = signals[a, loop_terms.X_SETPOINT]
    velocity, torque = command.velocity_feedforward[cycle, a], command.torque_feedforward[cycle, a]
    position_controller(a, drives, state, setpoint, velocity, torque, closed_on)
    if terms.start[SPEED + 1] > terms.start[SPEED]:
        signals[a, loop_terms.X_SETPOINT] = setpoint
        signals[a, loop_terms.X_FED_STEP] = command.fed_step[cycle, a]
        signals[a, loop_terms.X_FOLLOWING_ERROR] = setpoint - closed_on
        signals[a, loop_terms.X_SPEED_SETPOINT] = state.commanded_speed[a] * drives.ratio[a]
        call_axis_terms(terms, SPEED, signals, a)
        state.commanded_speed[a] = signals[a, loop_terms.X_SPEED_SETPOINT] / drives.ratio[a]
        if not drives.dsc[a]:
            state.speed_setpoint[a] = state.commanded_speed[a]
    signals[a, loop_terms.X_RECORDED_SPEED_SETPOINT] = state.commanded_speed[a] * drives.ratio[a]


@compiled(inline=True)
def received_by_drive(a, drives, state, terms, signals):  # type: ignore[no-untyped-def]
    """Apply the DRIVE terms to the speed set point of axis `a`."""
    sent = state.speed_setpoint[a] if drives.dsc[a] else state.commanded_speed[a]
    signals[a, loop_terms.X_SPEED_SETPOINT] = sent * drives.ratio[a]
    call_axis_terms(terms, DRIVE, signals, a)
    state.speed_setpoint[a] = signals[a, loop_terms.X_SPEED_SETPOINT] / drives.ratio[a]


@compiled(inline=True)
def current_cycle(a, drives, state, terms, signals, measured_current):  # type: ignore[no-untyped-def]
    """The current controller of axis `a` with the CURRENT and VOLTAGE terms; True at the voltage limit."""
    current_setpoint = state.current_setpoint[a]
    if terms.start[CURRENT + 1] > terms.start[CURRENT]:
        signals[a, loop_terms.X_CURRENT_SETPOINT] = current_setpoint
        call_axis_terms(terms, CURRENT, signals, a)
        current_setpoint = signals[a, loop_terms.X_CURRENT_SETPOINT]
    limited = current_controller(a, drives, state, current_setpoint, measured_current)
    if terms.start[VOLTAGE + 1] > terms.start[VOLTAGE]:
        signals[a, loop_terms.X_CURRENT] = state.current[a]
        signals[a, loop_terms.X_VOLTAGE] = state.voltage[a]
        call_axis_terms(terms, VOLTAGE, signals, a)
        state.voltage[a] = signals[a, loop_terms.X_VOLTAGE]
    return limited


@compiled(inline=True)
def forces_of_terms(engine, terms, signals, command, cycle):  # type: ignore[no-untyped-def]
    """Call the FORCE terms beside the external forces of this position cycle, and pass the resulting forces to the engine for its next step."""
    places = engine.places
    axes = np.uint64(len(signals))
    known = len(command.external_force) > 0
    for a in range(axes):
        x = signals[a]
        x[loop_terms.X_LOAD_FORCE] = command.external_force[cycle, a, 0] if known else 0.0
        x[loop_terms.X_ROTOR_FORCE] = command.external_force[cycle, a, 1] if known else 0.0
        x[loop_terms.X_MOTOR_TORQUE] = 0.0
        x[loop_terms.X_FRICTION_FORCE] = 0.0
        x[loop_terms.X_OTHER_SIDE_LEVEL] = places.other_side_level[a]
        x[loop_terms.X_FRICTION_LEVEL] = places.coulomb_level[a] + places.other_side_level[a]
    call_terms(terms, FORCE, signals)
    for a in range(axes):
        x = signals[a]
        load, rotor, rubbing = places.load_dof[a], places.rotor_dof[a], places.friction_dof[a]
        on_load, on_rotor, friction = x[loop_terms.X_LOAD_FORCE], x[loop_terms.X_ROTOR_FORCE], x[loop_terms.X_FRICTION_FORCE]
        engine.ctrl[places.actuator[a]] += x[loop_terms.X_MOTOR_TORQUE]
        engine.frictionloss[rubbing] = max(x[loop_terms.X_FRICTION_LEVEL] - places.other_side_level[a], 0.0)
        if rotor == load:
            engine.applied[load] = on_load + friction + on_rotor
        else:
            engine.applied[load] = on_load + friction if rubbing == load else on_load
            engine.applied[rotor] = on_rotor if rubbing == load else friction + on_rotor


@compiled(inline=True)
def call_term(terms, i, signals):  # type: ignore[no-untyped-def]
    """Call term number `i`."""
    call_address_4(
        terms.address[i],
        terms.parameters.ctypes.data + i * terms.parameters.strides[0],
        terms.state.ctypes.data + i * terms.state.strides[0],
        signals.ctypes.data + terms.first[i] * signals.strides[0],
        terms.axis[i],
    )


@compiled
def call_terms(terms, stage, signals):  # type: ignore[no-untyped-def]
    """Call all terms of a stage."""
    for i in range(terms.start[stage], terms.start[stage + 1]):
        call_term(terms, i, signals)


@compiled(inline=True)
def call_axis_terms(terms, stage, signals, axis):  # type: ignore[no-untyped-def]
    """Call the terms of a stage that act on one axis, a row of the signals."""
    for i in range(terms.of_axis[stage, axis], terms.of_axis[stage, axis + 1]):
        call_term(terms, i, signals)


@compiled(inline=True)
def rounded(value, resolution):  # type: ignore[no-untyped-def]
    """Value rounded to the nearest multiple of a resolution; unchanged for resolution 0."""
    return math.floor(value / resolution + 0.5) * resolution if resolution > 0.0 else value
