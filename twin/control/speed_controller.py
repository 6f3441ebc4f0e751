"""P or PI speed controller, the speed that it sees, and the torque feedforward of a drive.

    every speed cycle:  e = w* - w;  T* = Kp e + I + T_ff;  i* = clip(T* / Kt, +-i_peak);  I += Kp Ts/Tn e unless clipped
                        with a reference model of time Tr:  I += Kp Ts/Tn (w_r - w),  w_r += (1 - exp(-Ts/Tr)) (w* - w_r)

"Unless clipped" is the anti-windup: the integrator holds while the command is limited. P: 1/Tn = 0. Kt is the commissioned torque constant. The speed
w is measured, or differentiated from the motor encoder, (q(k) - q(k-n)) / (n Ts), and may pass a first-order filter. Over recorded signals the law
is linear in e, its integral and T_ff: `law_weights`.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np
from scipy.linalg import block_diag

from twin.compiled_functions import compiled
from twin.control.linear import padded, with_past
from twin.control.number import Key, Search, held, number, numbers_of, positive

MOST_MEAN_CYCLES = 16
"""A position may be differentiated over at most this many speed cycles."""

DRIVE_FEEDFORWARD = "drive_torque_feedforward"
MEAN_CYCLES = "speed_mean_cycles"


@dataclass(frozen=True, kw_only=True)
class SpeedNumbers:
    """Gain, integral time (inf: P), weight of the NC's torque feedforward (0 switches off), and what the controller sees.

    speed_mean_cycles         n > 0: the speed is the motor encoder's difference (q(k) - q(k-n)) / (n Ts) instead of a measurement
    speed_filter_time_s       first-order lag of the speed that the controller sees (0: none)
    speed_reference_time_s    first-order lag of the speed set point at the integrator (reference model; 0: none)
    drive_torque_feedforward  weight of a torque feedforward made in the drive, independent of the NC's (0: none)
    """

    speed_gain_nm_s_per_rad: float = number(
        positive(), held(sinumerik=("MD1407 SPEEDCTRL_GAIN_1", "Nms/rad", 1.0), heidenhain=("MP2500", "file unit", 1.0)),
        direct="speed_gain_n_s_per_m", shown=("speed gain", "Nm s/rad (N s/m)", 1.0), search=Search(softer=-0.7),
        seen_in="runs that stay below the current limit", after=("position_gain_per_s", "inertia"),
    )  # fmt: skip
    speed_integral_time_s: float = number(
        positive(), held(sinumerik=("MD1409 SPEEDCTRL_INTEGRATOR_TIME_1", "ms", 1e-3), heidenhain=("MP2510", "file unit", 1.0)),
        absent=math.inf, shown=("speed integral time", "ms", 1e3), search=Search(softer=0.7),
    )  # fmt: skip
    speed_mean_cycles: int = number(
        Key(0.0, MOST_MEAN_CYCLES, required=False, whole=True), absent=0,
        shown=("speed from", "", lambda n: f"position, {n.speed_mean_cycles} cycles" if n.speed_mean_cycles else "encoder"),
    )  # fmt: skip
    speed_filter_time_s: float = number(Key(0.0, 1.0, required=False), absent=0.0, shown=("speed filter", "ms", 1e3))
    speed_reference_time_s: float = number(
        Key(0.0, 1.0, required=False), absent=0.0, shown=("speed reference model", "ms", 1e3), search=Search(unit=1e-3, step=0.1)
    )
    drive_torque_feedforward: float = number(
        Key(0.0, 5.0, required=False), absent=0.0, shown=("torque feedforward of the drive", "", 1.0), search=Search()
    )
    torque_feedforward: float = number(
        Key(-5.0, 5.0), absent=0.0, search=Search(), seen_in="accelerations with torque feedforward on", after=("speed_gain_nm_s_per_rad",)
    )


PARAMETERS = numbers_of(SpeedNumbers)


def sees_motor_speed(numbers: SpeedNumbers) -> bool:
    """Whether the controller sees the measured speed as it is, neither differentiated nor filtered."""
    return numbers.speed_mean_cycles == 0 and numbers.speed_filter_time_s == 0.0


def lateness_of_speed(numbers: SpeedNumbers, cycle: float) -> float:
    """How late [s] the speed is that the controller sees: half of the speed cycles [s] over which it is differentiated, and its filter."""
    return 0.5 * numbers.speed_mean_cycles * cycle + numbers.speed_filter_time_s


def differentiation(numbers: SpeedNumbers, cycle: float) -> tuple[int, float]:
    """Speed cycles [s] over which the controller differentiates the position (0: it sees a measured speed), and the 1/s that multiply the difference."""
    n = numbers.speed_mean_cycles
    return n, 1.0 / (max(n, 1) * cycle)


def law_weights(numbers: SpeedNumbers) -> tuple[float, float, float]:
    """Kp, Kp / Tn and the weight of the torque feedforward: T* = Kp e + Kp / Tn int e + a_t T_ff."""
    gain = numbers.speed_gain_nm_s_per_rad
    return gain, gain / numbers.speed_integral_time_s, numbers.torque_feedforward


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
    wanted = (drives.speed_gain[a] * error + state.speed_integral[a] + state.torque_feedforward[a]) * drives.per_control_torque_constant[a]
    limit = drives.peak_current[a]
    if wanted > limit or wanted < -limit:
        state.current_setpoint[a] = math.copysign(limit, wanted)
        return True
    state.current_setpoint[a] = wanted
    state.speed_integral[a] += drives.speed_integral_gain[a] * integrated
    return False


def symmetrical_optimum(inertia: float, a: float, small_times: float) -> dict[str, float]:
    """Kp = J / (a T) and Tn = a^2 T for an inertia at the motor [kg m2] and the sum T [s] of the small times of the loop."""
    return {"speed_gain_nm_s_per_rad": inertia / (a * small_times), "speed_integral_time_s": a**2 * small_times}


def with_seen_speed(
    numbers: SpeedNumbers, cycle: float, a: np.ndarray, b: np.ndarray, speed: np.ndarray, motor: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The plant and the row of the speed that the controller sees: measured, or differentiated from the motor angle, then filtered; speed cycle [s]."""
    row = speed
    n, rate = differentiation(numbers, cycle)
    if n:
        a, b = with_past(a, b, motor, n)
        row = (padded(motor, len(a)) - np.eye(len(a))[-1]) * rate
    if numbers.speed_filter_time_s > 0.0:
        share = -math.expm1(-cycle / numbers.speed_filter_time_s)
        size = len(a)
        a = block_diag(a, 1.0 - share)
        a[size, :size] = share * row
        b = np.vstack([b, [[0.0]]])
        row = np.append(share * row, 1.0 - share)
    return a, b, row


def with_reference_model(a: np.ndarray, b: np.ndarray, integral: float, share: float) -> tuple[np.ndarray, np.ndarray]:
    """A closed speed loop whose integrator (the last state) sees the set point through a lag w_r += share (w* - w_r)."""
    into = np.zeros((len(a), 1))
    into[-1] = integral
    wide = block_diag(a, 1.0 - share)
    wide[: len(a), len(a) :] = into * (1.0 - share)
    return wide, np.vstack([b + into * (share - 1.0), [[share]]])
