"""The control cascade of all drives: constants and state of its blocks, which `twin.control` states and compiles one by one.

    position_controller   every position cycle      P with speed and torque feedforward, in the NC
    drive_position_loop   every speed cycle         corrects the NC's command if the drive closes the position loop
    speed_controller      every speed cycle         P or PI, on the measured or differentiated speed
    current_controller    every current cycle       PI and the winding, or an ideal actuator

(Prevost, Lavernhe, Lartigue; times are cycles of the control.) The controllers use the commissioned Kt and J_ff; the torque follows from the Kt of
the motor. `tests.reference.cascade_reference` implements the same laws in plain numpy; a test compares both.
"""

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from twin.control.speed_controller import MOST_MEAN_CYCLES, differentiation
from twin.machine.machine import Axis, Machine
from twin.simulation.axis_table import AxisTable, axis_table

WHOLE_CYCLE = 1e-9
"""A delay this close to a whole number of speed cycles counts as whole."""


class Drives(NamedTuple):
    """Columns of the constants of all drives, each (axis,) float64 unless noted. Reciprocals, because a division takes as long as ten multiplications."""

    ratio: np.ndarray  # axis units per motor rad
    per_ratio: np.ndarray  # 1 / ratio
    position_gain: np.ndarray  # 1/s
    speed_gain: np.ndarray  # Nm s/rad
    speed_integral_gain: np.ndarray  # Kp Ts / Tn, Nm s/rad per speed cycle
    control_torque_constant: np.ndarray  # commissioned Kt, Nm/A
    per_control_torque_constant: np.ndarray  # 1 / commissioned Kt
    peak_current: np.ndarray  # A
    current_gain: np.ndarray  # V/A
    current_integral_gain: np.ndarray  # Kpi Ti / Tni, V/A per current cycle
    bus_limit: np.ndarray  # V
    torque_constant: np.ndarray  # Kt of the motor, Nm/A
    back_emf: np.ndarray  # V s/rad
    resistance: np.ndarray  # ohm
    per_resistance: np.ndarray  # 1 / resistance
    decay: np.ndarray  # exp(-h R / L) over one base tick h, of an ideal actuator exp(-h / T), 0 without a lag
    mean_decay: np.ndarray  # mean of it over the tick
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
    """Columns of the state of all drives, each (axis,) float64 unless noted."""

    commanded_speed: np.ndarray  # w*_NC, output of the NC's position controller, rad/s at the motor
    commanded_torque: np.ndarray  # T_ff,NC, Nm
    speed_setpoint: np.ndarray  # w* active in the drive, rad/s at the motor
    torque_feedforward: np.ndarray  # T_ff active in the drive, Nm
    speed_integral: np.ndarray  # I, Nm
    current_setpoint: np.ndarray  # A
    current_integral: np.ndarray  # V
    voltage: np.ndarray  # V, or the command that an ideal actuator follows
    current: np.ndarray  # A, or what an ideal actuator makes of its command
    reference_speed: np.ndarray  # w_r, rad/s at the motor
    seen_speed: np.ndarray  # input of the speed controller, axis units/s
    seen_positions: np.ndarray  # (axis, MOST_MEAN_CYCLES + 1) motor encoder at the last speed cycles, newest first
    newest: np.ndarray  # int64: index of the newest entry of `nothing_sent`, -1 before the first cycle


def drives_of(machine: Machine) -> AxisTable:
    """Table of the constants of the cascade (`Drives`), computed from the machine file."""
    h = machine.base_tick

    def column(value: Callable[[Axis], float]) -> np.ndarray:
        return np.array([value(axis) for axis in machine.axes], float)

    def flag(value: Callable[[Axis], bool]) -> np.ndarray:
        return np.array([value(axis) for axis in machine.axes], bool)

    ts = machine.speed_cycle
    mean_cycles, rates = zip(*(differentiation(axis.loops, ts) for axis in machine.axes))
    dsc_delay = column(lambda a: a.loops.dsc_delay_s) / ts
    dsc_cycles = np.floor(dsc_delay + WHOLE_CYCLE).astype(np.int64)
    electrical_lag = column(lambda a: a.motor.inductance_h / a.motor.resistance_ohm if a.actuator.winding else a.loops.actuator_lag_s)
    with np.errstate(divide="ignore"):
        ticks_per_lag = h / electrical_lag
    columns = Drives(
        ratio=column(lambda a: a.ratio),
        per_ratio=1.0 / column(lambda a: a.ratio),
        position_gain=column(lambda a: a.loops.position_gain_per_s),
        speed_gain=column(lambda a: a.loops.speed_gain_nm_s_per_rad),
        speed_integral_gain=column(lambda a: a.loops.speed_gain_nm_s_per_rad * machine.speed_cycle / a.loops.speed_integral_time_s),
        control_torque_constant=column(lambda a: a.commissioned_torque_constant),
        per_control_torque_constant=1.0 / column(lambda a: a.commissioned_torque_constant),
        peak_current=column(lambda a: a.motor.peak_current_a),
        current_gain=column(lambda a: a.loops.current_gain_v_per_a),
        current_integral_gain=column(lambda a: a.loops.current_gain_v_per_a * machine.current_cycle / a.loops.current_integral_time_s),
        bus_limit=column(lambda a: a.motor.bus_limit_v),
        torque_constant=column(lambda a: a.motor.torque_constant_nm_per_a),
        back_emf=column(lambda a: a.motor.back_emf_v_s_per_rad),
        resistance=column(lambda a: a.motor.resistance_ohm),
        per_resistance=1.0 / column(lambda a: a.motor.resistance_ohm),
        decay=np.exp(-ticks_per_lag),
        mean_decay=-np.expm1(-ticks_per_lag) / ticks_per_lag,
        current_loop=flag(lambda a: a.actuator.winding),
        on_motor_encoder=flag(lambda a: a.encoder == "motor"),
        mean_cycles=np.array(mean_cycles, np.int64),
        differentiation_rate=np.array(rates),
        speed_lag=column(lambda a: -math.expm1(-ts / a.loops.speed_filter_time_s) if a.loops.speed_filter_time_s > 0.0 else 1.0),
        reference_lag=column(lambda a: -math.expm1(-ts / a.loops.speed_reference_time_s) if a.loops.speed_reference_time_s > 0.0 else 1.0),
        dsc=dsc_delay > 0.0,
        dsc_cycles=dsc_cycles,
        dsc_part=np.maximum(dsc_delay - dsc_cycles, 0.0),
    )
    return axis_table(columns)


def drives_at_rest(drives: AxisTable, held_torque: np.ndarray) -> AxisTable:
    """Table of the state at standstill (`DriveState`): integrators and windings carry the holding torque `held_torque` (axis,) [Nm at the motor].

    A P speed controller has no integrator and holds by a following error.
    """
    current = held_torque / drives.torque_constant
    rest = {name: np.zeros_like(current) for name in DriveState._fields}
    carried = {
        "speed_integral": np.where(drives.speed_integral_gain > 0.0, current * drives.control_torque_constant, 0.0),
        "current_setpoint": current.copy(),
        "current_integral": drives.resistance * current,
        "voltage": drives.resistance * current,
        "current": current.copy(),
        "seen_positions": np.full((len(current), MOST_MEAN_CYCLES + 1), np.nan),
        "newest": np.full(len(current), -1, np.int64),
    }
    return axis_table(DriveState(**rest | carried))


def nothing_sent(drives: AxisTable) -> np.ndarray:
    """(axis, cycle, 2) Ring buffer of w*_NC + Kv x / r and T_ff,NC at the last speed cycles, for drives that close the position loop."""
    return np.zeros((len(drives), int(drives.dsc_cycles.max(initial=0)) + 2, 2))
