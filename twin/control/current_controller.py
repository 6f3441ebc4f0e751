"""PI current controller with the motor winding behind it; an ideal actuator in their place follows its command with a lag T, or directly.

every current cycle:   e = i* - i;  u = clip(Kpi e + Ii, +-u_bus);  Ii += Kpi Ti/Tni e unless clipped
between two ticks:     L di/dt = u - R i - Ke w   under held u and w, solved exactly
ideal actuator:        T di/dt = i* - i, solved exactly; i = i* without a lag; in A, V or Nm
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from twin.compiled_functions import compiled
from twin.control.number import Key, Search, held, not_negative, number, numbers_of, positive


@dataclass(frozen=True, kw_only=True)
class CurrentNumbers:
    """Gain and integral time of a current controller; lag of an ideal actuator, as far as a first-order lag stands for a current loop (0: none)."""

    current_gain_v_per_a: float = number(
        positive(), held(sinumerik=("MD1120 CURRCTRL_GAIN", "V/A", 1.0)), absent=0.0, shown=("current gain", "V/A", 1.0)
    )
    current_integral_time_s: float = number(
        positive(),
        held(sinumerik=("MD1121 CURRCTRL_INTEGRATOR_TIME", "us", 1e-6)),
        absent=math.inf,
        shown=("current integral time", "ms", 1e3),
    )
    actuator_lag_s: float = number(
        Key(0.0, 0.1, required=False), absent=0.0, shown=("lag of the actuator", "ms", 1e3), search=Search(unit=1e-3, step=0.05)
    )


ACTUATOR_LAG = "actuator_lag_s"
PARAMETERS = numbers_of(CurrentNumbers)


@dataclass(frozen=True, kw_only=True)
class Motor:
    """Synchronous servo motor as the control sees it: torque = torque_constant * current [Nm, A], one-phase equivalent.

    An axis without a current loop uses only torque constant and peak, per unit of its command (`Axis.effort`). Ratings come from the
    data sheet, speeds in rad/s at the motor; None if the file omits them. They are not used in simulation; studies compare the load with them.
    """

    torque_constant_nm_per_a: float = number(
        positive(), held(sinumerik=("MD1113 TORQUE_CURRENT_RATIO", "Nm/A", 1.0)), direct="force_constant_n_per_a"
    )
    back_emf_v_s_per_rad: float = number(not_negative(), absent=0.0, direct="back_emf_v_s_per_m")
    resistance_ohm: float = number(positive(), absent=1.0)
    inductance_h: float = number(positive(), absent=1.0)
    peak_current_a: float = number(positive(), held(sinumerik=("MD1104 MOTOR_MAX_CURRENT", "A", 1.0)), absent=math.inf)
    bus_limit_v: float = number(positive(), absent=math.inf)
    rated_torque_nm: float | None = number(positive(required=False), absent=None, direct="rated_force_n")
    rated_speed: float | None = number(positive(required=False), absent=None, key="rated_speed_rev_per_min", direct="rated_speed_m_per_min")
    max_speed: float | None = number(positive(required=False), absent=None, key="max_speed_rev_per_min", direct="max_speed_m_per_min")
    thermal_time_constant_s: float | None = number(positive(required=False), absent=None)

    def torque_at(self, speed: np.ndarray) -> np.ndarray:
        """Largest steady torque [Nm] at these speeds [rad/s], limited by the peak current and by bus voltage minus back EMF."""
        reached = (self.bus_limit_v - self.back_emf_v_s_per_rad * np.abs(speed)) / self.resistance_ohm
        return self.torque_constant_nm_per_a * np.clip(reached, 0.0, self.peak_current_a)

    @property
    def phases(self) -> float:
        """Power of the motor over the power of its one-phase equivalent, Kt / Ke; 1 if the back EMF is unknown."""
        return self.torque_constant_nm_per_a / self.back_emf_v_s_per_rad if self.back_emf_v_s_per_rad > 0.0 else 1.0


MOTOR = numbers_of(Motor, "motor")


@compiled(inline=True)
def current_controller(a, drives, state, current_setpoint, current):  # type: ignore[no-untyped-def]
    """Voltage of axis `a` from set point and measured current [A], or the command that an ideal actuator follows; True at the bus limit."""
    if not drives.current_loop[a]:
        state.voltage[a] = current_setpoint
        if drives.decay[a] == 0.0:
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
    """Advance the current of axis `a` by one tick at constant voltage, or command, and speed; returns its mean over the tick [A]."""
    final = (state.voltage[a] - drives.back_emf[a] * motor_speed) * drives.per_resistance[a]
    away = state.current[a] - final
    state.current[a] = final + away * drives.decay[a]
    return final + away * drives.mean_decay[a]


def lag_model(lag: float, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mechanics, from what an ideal actuator gives, with its lag [s] in front. What it gives is the first state."""
    n = len(a) + 1
    wide = np.zeros((n, n))
    wide[0, 0] = -1.0 / lag
    wide[1:, :1] = b
    wide[1:, 1:] = a
    return wide, np.insert(np.zeros((n - 1, 1)), 0, 1.0 / lag, axis=0)


def winding_model(motor: Motor, a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mechanics with the winding in front, from voltage to current. The current is the first state."""
    wide, voltage = lag_model(motor.inductance_h / motor.resistance_ohm, a, b * motor.torque_constant_nm_per_a)
    wide[0, 1:] = -motor.back_emf_v_s_per_rad / motor.inductance_h * speed
    return wide, voltage / motor.resistance_ohm, np.eye(len(wide))[:1]
