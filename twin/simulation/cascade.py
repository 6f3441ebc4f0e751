"""The control cascade of a drive: P position loop, P or PI speed loop, PI current loop, and the motor winding.

Law per axis (Prevost, Lavernhe, Lartigue; times are cycles of the control, `r` axis units per motor radian):

    every position cycle:  w* = (Kv (s(t - d_pos) - x) + a_v ds/dt(t - d_ff)) / r
                           T_ff = a_t J_ff d2s/dt2(t - d_ff) / r
    every speed cycle:     e = w* - w;  T* = Kp e + I + T_ff;  i* = clip(T* / Kt, +-i_peak);  I += Kp Ts/Tn e unless clipped
                           (with a reference model of time Tr:  I += Kp Ts/Tn (w_r - w),  w_r += (1 - exp(-Ts/Tr)) (w* - w_r))
    every current cycle:   e = i* - i;  u = clip(Kpi e + Ii, +-u_bus);  Ii += Kpi Ti/Tni e unless clipped
    between two ticks:     L di/dt = u - R i - Ke w   under held u and w, solved exactly

"Unless clipped" is the anti-windup: the integrator holds while its output is limited.

With `dsc_delay_s` Td > 0 the drive closes the position loop (dynamic servo control, DSC). The NC sends w*_NC and T_ff,NC of the first two
lines. The drive receives them with the delay Td and corrects w* for the motion since then, at every speed cycle:

    w*(T) = w*_NC(T - Td) - Kv (x(T) - x(T - Td)) / r,    T_ff(T) = T_ff,NC(T - Td)

The controllers use the commissioned Kt and J_ff; the torque follows from the Kt of the motor. Without a current loop i* is the command
(A, V, Nm) of an ideal actuator and i = i*. A P speed loop has 1/Tn = 0. The speed w is measured, or differentiated from the motor encoder,
(q(k) - q(k-n)) / (n Ts), and may pass a first-order filter. `tests.reference.cascade_reference` implements the same law in plain numpy;
a test compares both.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import MOST_MEAN_CYCLES

WHOLE_CYCLE = 1e-9
"""A delay this close to a whole number of speed cycles counts as whole."""


class Drives(NamedTuple):
    """Constants of all drives, each (axis,) float64 unless noted."""

    ratio: np.ndarray  # axis units per motor rad
    position_gain: np.ndarray  # 1/s
    speed_gain: np.ndarray  # Nm s/rad
    speed_integral_gain: np.ndarray  # Kp Ts / Tn, Nm s/rad per speed cycle
    control_torque_constant: np.ndarray  # commissioned Kt, Nm/A
    peak_current: np.ndarray  # A
    current_gain: np.ndarray  # V/A
    current_integral_gain: np.ndarray  # Kpi Ti / Tni, V/A per current cycle
    bus_limit: np.ndarray  # V
    torque_constant: np.ndarray  # Kt of the motor, Nm/A
    back_emf: np.ndarray  # V s/rad
    resistance: np.ndarray  # ohm
    decay: np.ndarray  # exp(-R h / L) over one base tick h
    mean_decay: np.ndarray  # mean of exp(-R t / L) over the tick
    current_loop: np.ndarray  # bool: a current controller and a winding; otherwise an ideal actuator
    on_motor_encoder: np.ndarray  # bool: the position loop is closed on the motor encoder
    mean_cycles: np.ndarray  # int64: n of the differentiated position, 0 for a measured speed
    differentiation_rate: np.ndarray  # 1 / (n Ts), 1/s
    speed_lag: np.ndarray  # 1 - exp(-Ts / T) of the speed filter, 1 without filter
    reference_lag: np.ndarray  # 1 - exp(-Ts / Tr) of the integrator's reference model, 1 without model
    dsc: np.ndarray  # bool: the drive closes the position loop
    dsc_cycles: np.ndarray  # int64: whole speed cycles of Td
    dsc_part: np.ndarray  # fraction of a speed cycle that remains of Td


class DriveState(NamedTuple):
    """State of all drives, each (axis,) float64 unless noted."""

    commanded_speed: np.ndarray  # w*_NC, output of the NC's position controller, rad/s at the motor
    commanded_torque: np.ndarray  # T_ff,NC, Nm
    speed_setpoint: np.ndarray  # w* active in the drive, rad/s at the motor
    torque_feedforward: np.ndarray  # T_ff active in the drive, Nm
    speed_integral: np.ndarray  # I, Nm
    current_setpoint: np.ndarray  # A
    current_integral: np.ndarray  # V
    voltage: np.ndarray  # V
    current: np.ndarray  # A, or the command
    reference_speed: np.ndarray  # w_r, rad/s at the motor
    seen_speed: np.ndarray  # input of the speed controller, axis units/s
    seen_positions: np.ndarray  # (axis, MOST_MEAN_CYCLES + 1) motor encoder at the last speed cycles, newest first
    sent: np.ndarray  # (axis, cycle, 2) ring buffer of w*_NC + Kv x / r and T_ff,NC at the last speed cycles
    newest: np.ndarray  # int64: index of the newest entry of `sent`, -1 before the first cycle


def drives_of(machine: Machine) -> Drives:
    """Constants of the cascade, computed from the machine file."""
    h = machine.base_tick

    def column(value: Callable[[Axis], float]) -> np.ndarray:
        return np.array([value(axis) for axis in machine.axes], float)

    def flag(value: Callable[[Axis], bool]) -> np.ndarray:
        return np.array([value(axis) for axis in machine.axes], bool)

    ts = machine.speed_cycle
    mean_cycles = np.array([axis.loops.speed_mean_cycles for axis in machine.axes], np.int64)
    dsc_delay = column(lambda a: a.loops.dsc_delay_s) / ts
    dsc_cycles = np.floor(dsc_delay + WHOLE_CYCLE).astype(np.int64)
    electrical_rate = column(lambda a: a.motor.resistance_ohm / a.motor.inductance_h)
    return Drives(
        ratio=column(lambda a: a.ratio),
        position_gain=column(lambda a: a.loops.position_gain_per_s),
        speed_gain=column(lambda a: a.loops.speed_gain_nm_s_per_rad),
        speed_integral_gain=column(lambda a: a.loops.speed_gain_nm_s_per_rad * machine.speed_cycle / a.loops.speed_integral_time_s),
        control_torque_constant=column(lambda a: a.commissioned_torque_constant),
        peak_current=column(lambda a: a.motor.peak_current_a),
        current_gain=column(lambda a: a.loops.current_gain_v_per_a),
        current_integral_gain=column(lambda a: a.loops.current_gain_v_per_a * machine.current_cycle / a.loops.current_integral_time_s),
        bus_limit=column(lambda a: a.motor.bus_limit_v),
        torque_constant=column(lambda a: a.motor.torque_constant_nm_per_a),
        back_emf=column(lambda a: a.motor.back_emf_v_s_per_rad),
        resistance=column(lambda a: a.motor.resistance_ohm),
        decay=np.exp(-electrical_rate * h),
        mean_decay=-np.expm1(-electrical_rate * h) / (electrical_rate * h),
        current_loop=flag(lambda a: a.has_current_loop),
        on_motor_encoder=flag(lambda a: a.encoder == "motor"),
        mean_cycles=mean_cycles,
        differentiation_rate=1.0 / (np.maximum(mean_cycles, 1) * ts),
        speed_lag=column(lambda a: -math.expm1(-ts / a.loops.speed_filter_time_s) if a.loops.speed_filter_time_s > 0.0 else 1.0),
        reference_lag=column(lambda a: -math.expm1(-ts / a.loops.speed_reference_time_s) if a.loops.speed_reference_time_s > 0.0 else 1.0),
        dsc=dsc_delay > 0.0,
        dsc_cycles=dsc_cycles,
        dsc_part=np.maximum(dsc_delay - dsc_cycles, 0.0),
    )


def drives_at_rest(drives: Drives, held_torque: np.ndarray) -> DriveState:
    """State at standstill: integrators and windings carry the holding torque `held_torque` (axis,) [Nm at the motor].

    A P speed controller has no integrator and holds by a following error.
    """
    current = held_torque / drives.torque_constant
    zero = np.zeros_like(current)
    return DriveState(
        commanded_speed=zero.copy(),
        commanded_torque=zero.copy(),
        speed_setpoint=zero.copy(),
        torque_feedforward=zero.copy(),
        speed_integral=np.where(drives.speed_integral_gain > 0.0, current * drives.control_torque_constant, 0.0),
        current_setpoint=current.copy(),
        current_integral=drives.resistance * current,
        voltage=drives.resistance * current,
        current=current.copy(),
        reference_speed=zero.copy(),
        seen_speed=zero.copy(),
        seen_positions=np.full((len(zero), MOST_MEAN_CYCLES + 1), np.nan),
        sent=np.zeros((len(zero), int(drives.dsc_cycles.max(initial=0)) + 2, 2)),
        newest=np.full(len(zero), -1, np.int64),
    )


@compiled(inline=True)
def position_controller(a, drives, state, setpoint, velocity_feedforward, torque_feedforward, position):  # type: ignore[no-untyped-def]
    """w* of axis `a` from the delayed set point, the feedforward (axis units/s; Nm) and the measured position."""
    speed = (drives.position_gain[a] * (setpoint - position) + velocity_feedforward) / drives.ratio[a]
    state.commanded_speed[a] = speed
    state.commanded_torque[a] = torque_feedforward
    if not drives.dsc[a]:
        state.speed_setpoint[a] = speed
        state.torque_feedforward[a] = torque_feedforward


@compiled(inline=True)
def drive_position_loop(a, drives, state, position):  # type: ignore[no-untyped-def]
    """w* of axis `a` whose drive closes the position loop (DSC): the delayed w* of the NC, corrected for the motion since then."""
    moved = drives.position_gain[a] * position / drives.ratio[a]
    ring = state.sent[a]
    if state.newest[a] < 0:  # first cycle: the axis was at rest here
        ring[:, 0] = state.commanded_speed[a] + moved
        ring[:, 1] = state.commanded_torque[a]
    at = state.newest[a] + 1
    if at >= len(ring):
        at = 0
    state.newest[a] = at
    ring[at, 0] = state.commanded_speed[a] + moved
    ring[at, 1] = state.commanded_torque[a]
    late = at - drives.dsc_cycles[a]
    if late < 0:
        late += len(ring)
    later = late - 1 if late > 0 else len(ring) - 1
    part = drives.dsc_part[a]
    state.speed_setpoint[a] = ring[late, 0] + part * (ring[later, 0] - ring[late, 0]) - moved
    state.torque_feedforward[a] = ring[late, 1] + part * (ring[later, 1] - ring[late, 1])


@compiled(inline=True)
def speed_seen(a, drives, state, speed, position):  # type: ignore[no-untyped-def]
    """Input of the speed controller of axis `a` [axis units/s]: the measured `speed` or the differentiated `position`, filtered."""
    n = drives.mean_cycles[a]
    if n > 0:
        seen = state.seen_positions[a]
        if math.isnan(seen[0]):  # first cycle: the axis was at rest here
            seen[:] = position
        for i in range(n, 0, -1):
            seen[i] = seen[i - 1]
        seen[0] = position
        speed = (seen[0] - seen[n]) * drives.differentiation_rate[a]
    if drives.speed_lag[a] < 1.0:
        speed = state.seen_speed[a] + drives.speed_lag[a] * (speed - state.seen_speed[a])
    state.seen_speed[a] = speed
    return speed


@compiled(inline=True)
def speed_controller(a, drives, state, motor_speed):  # type: ignore[no-untyped-def]
    """i* of axis `a` from the motor speed [rad/s]; True at the current limit."""
    error = state.speed_setpoint[a] - motor_speed
    integrated = error
    if drives.reference_lag[a] < 1.0:
        state.reference_speed[a] += drives.reference_lag[a] * (state.speed_setpoint[a] - state.reference_speed[a])
        integrated = state.reference_speed[a] - motor_speed
    wanted = (drives.speed_gain[a] * error + state.speed_integral[a] + state.torque_feedforward[a]) * (
        1.0 / drives.control_torque_constant[a]
    )
    limit = drives.peak_current[a]
    if wanted > limit or wanted < -limit:
        state.current_setpoint[a] = math.copysign(limit, wanted)
        return True
    state.current_setpoint[a] = wanted
    state.speed_integral[a] += drives.speed_integral_gain[a] * integrated
    return False


@compiled(inline=True)
def current_controller(a, drives, state, current_setpoint, current):  # type: ignore[no-untyped-def]
    """Voltage of axis `a` from set point and measured current [A]; True at the bus limit. An ideal actuator applies the command directly."""
    if not drives.current_loop[a]:
        state.current[a] = current_setpoint
        return False
    error = current_setpoint - current
    wanted = drives.current_gain[a] * error + state.current_integral[a]
    limit = drives.bus_limit[a]
    if wanted > limit or wanted < -limit:
        state.voltage[a] = math.copysign(limit, wanted)
        return True
    state.voltage[a] = wanted
    state.current_integral[a] += drives.current_integral_gain[a] * error
    return False


@compiled(inline=True)
def winding(a, drives, state, motor_speed):  # type: ignore[no-untyped-def]
    """Advance the current of axis `a` by one tick at constant voltage and speed; returns its mean over the tick [A]."""
    if not drives.current_loop[a]:
        return state.current[a]
    final = (state.voltage[a] - drives.back_emf[a] * motor_speed) * (1.0 / drives.resistance[a])
    away = state.current[a] - final
    state.current[a] = final + away * drives.decay[a]
    return final + away * drives.mean_decay[a]
