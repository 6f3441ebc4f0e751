"""PI current controller with the motor winding behind it; an ideal actuator in their place applies the command directly.

every current cycle:   e = i* - i;  u = clip(Kpi e + Ii, +-u_bus);  Ii += Kpi Ti/Tni e unless clipped
between two ticks:     L di/dt = u - R i - Ke w   under held u and w, solved exactly
ideal actuator:        i = i*, the command in A, V or Nm
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from twin.compiled_functions import compiled
from twin.control.number import positive, same_key

PARAMETERS = (
    same_key("loops.current_gain_v_per_a", positive(), (1120, "CURRCTRL_GAIN", "V/A", 1.0)),
    same_key("loops.current_integral_time_s", positive(), (1121, "CURRCTRL_INTEGRATOR_TIME", "us", 1e-6)),
)


class Winding(Protocol):
    """Data of a motor with a winding, SI."""

    @property
    def resistance_ohm(self) -> float: ...
    @property
    def inductance_h(self) -> float: ...
    @property
    def back_emf_v_s_per_rad(self) -> float: ...
    @property
    def torque_constant_nm_per_a(self) -> float: ...


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
    final = (state.voltage[a] - drives.back_emf[a] * motor_speed) * drives.per_resistance[a]
    away = state.current[a] - final
    state.current[a] = final + away * drives.decay[a]
    return final + away * drives.mean_decay[a]


def winding_model(motor: Winding, a: np.ndarray, b: np.ndarray, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The mechanics with the winding in front, from voltage to current. The current is the first state."""
    n = len(a) + 1
    wide = np.zeros((n, n))
    wide[0, 0] = -motor.resistance_ohm / motor.inductance_h
    wide[0, 1:] = -motor.back_emf_v_s_per_rad / motor.inductance_h * speed
    wide[1:, 1:] = a
    wide[1:, :1] = b * motor.torque_constant_nm_per_a
    voltage = np.zeros((n, 1))
    voltage[0] = 1.0 / motor.inductance_h
    return wide, voltage, np.eye(n)[:1]
