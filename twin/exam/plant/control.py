"""The sampled cascade of one axis, implemented from the control law of docs/theory.md alone.

    every position cycle Tp:  w* = (Kv (s_d - x) + a_v (s_f - s_f1) / Tp) / r
                              T_ff = a_t J_ff (s_f - 2 s_f1 + s_f2) / Tp^2 / r
    every tick Ts:  e = w* - w;   T* = Kp e + I + T_ff;   i* = clip(T* / Kt);    I += Kp Ts / Tn e      unless clipped
                    e_i = i* - i; u = clip(Kpi e_i + I_i);                       I_i += Kpi Ts / Tni e_i unless clipped
s_d, s_f: set point after the position and the feedforward delay; s_f1, s_f2 one and two cycles earlier; x scale position, w motor
speed, i current as measured at that tick. First-order lags are exact: y += (s - y)(1 - exp(-T / tau)).
An axis with `dsc_delay` closes its position loop in the drive: a telegram (w*, T_ff) of the control takes effect Td after it was
computed, and at every tick the drive subtracts Kv / r times the motion of the scale since then. Telegram and scale are interpolated
linearly between ticks. Outside the library (neutral by default): dead band on s_d - x, lag and one-sided clip on w*, notch on T*.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .compensation import compensated_position, friction_pulse
from .compiled import compiled
from .parameters import Settings


def control_values(s: Settings) -> dict[str, Any]:
    """Fields of the axis records, from settings after effects; gains include their cycle times."""
    cycle = s.tick * s.cycle_ticks

    def share(period: float, tau: np.ndarray) -> np.ndarray:
        """1 - exp(-period / tau) of a lag, 1 without one."""
        return np.where(tau > 0.0, 1.0 - np.exp(-period / np.where(tau > 0.0, tau, 1.0)), 1.0)

    # biquad of (s^2 + w^2) / (s^2 + width w s + w^2), by the bilinear transform with prewarping; b2 = b0, a1 = b1, and b0 = 1 without one
    t = np.array([math.tan(math.pi * hz * s.tick) for hz in s.notch_hz])
    a0 = 1.0 + s.notch_width * t + t * t
    return {
        "velocity_gain": s.velocity_weight / cycle,
        "torque_gain": s.torque_weight * s.inertia_control / cycle**2 / s.ratio,
        "ki": s.kp * s.tick / s.tn,
        "kii": s.kpi * s.tick / s.tni,
        "set_point_share": share(cycle, s.set_point_lag),
        "current_share": share(s.tick, s.current_lag),
        "speed_share": share(s.tick, s.speed_lag),
        "speed_clip": s.speed_clip / s.ratio,  # rad/s, positive direction only
        "transport": s.dsc_delay / s.tick,  # delay of the telegram in ticks, 0: the control closes the position loop
        "notch_b0": (1.0 + t * t) / a0,
        "notch_b1": 2.0 * (t * t - 1.0) / a0,
        "notch_a2": (1.0 - s.notch_width * t + t * t) / a0,
    }


# State of the control, one row per axis
W_SET, T_FF, I_SPEED, I_CURRENT, LAG_S, LAG_I, LAG_W, N1, N2, S_F1, S_F2, W_SENT, T_SENT = range(13)
CONTROL_STATES = 13


@compiled(inline=True)
def position_cycle(axis, on, state, own, k, s_position, s_feedforward, scale):  # type: ignore[no-untyped-def]
    """Update speed set point and torque feedforward of axis k; `own` is the state of its compensations."""
    state[k, LAG_S] += (s_position - state[k, LAG_S]) * axis.set_point_share
    error = state[k, LAG_S] - compensated_position(on, own, k, state[k, LAG_S], scale)
    band = axis.dead_band
    if band > 0.0:
        error = math.copysign(max(abs(error) - band, 0.0), error)
    s1, s2 = state[k, S_F1], state[k, S_F2]
    speed = axis.kv * error + axis.velocity_gain * (s_feedforward - s1)
    speed = (speed + friction_pulse(on, own, k, speed, s_feedforward - s1, s1 - s2)) / axis.ratio
    state[k, W_SENT] = speed
    state[k, T_SENT] = axis.torque_gain * (s_feedforward - 2.0 * s1 + s2)
    if axis.transport == 0.0:
        state[k, W_SET] = state[k, W_SENT] = min(speed, axis.speed_clip)
        state[k, T_FF] = state[k, T_SENT]
    state[k, S_F2] = s1
    state[k, S_F1] = s_feedforward


@compiled(inline=True)
def drive_cycle(axis: Any, state: np.ndarray, k: int, n: int, scale: float, past: np.ndarray) -> None:
    """Position loop of axis k in its drive at tick n; past [axis, tick, 3] is a ring of speed, torque and scale."""
    length = past.shape[1]
    for i in range(length if n == 0 else 1):
        slot = (n + i) % length
        past[k, slot, 0], past[k, slot, 1], past[k, slot, 2] = state[k, W_SENT], state[k, T_SENT], scale
    back = math.floor(axis.transport)
    weight = axis.transport - back
    a, b = (n - back) % length, (n - back - 1) % length
    speed = (1.0 - weight) * past[k, a, 0] + weight * past[k, b, 0]
    way = scale - (1.0 - weight) * past[k, a, 2] - weight * past[k, b, 2]
    state[k, W_SET] = min(speed - axis.kv * way / axis.ratio, axis.speed_clip)
    state[k, T_FF] = (1.0 - weight) * past[k, a, 1] + weight * past[k, b, 1]


@compiled(inline=True)
def current_cycle(axis: Any, state: np.ndarray, k: int, speed: float, current: float) -> float:
    """Speed and current controller of axis k at one tick; returns the voltage held until the next tick."""
    state[k, LAG_W] += (state[k, W_SET] - state[k, LAG_W]) * axis.speed_share
    error = state[k, LAG_W] - speed
    torque = axis.kp * error + state[k, I_SPEED] + state[k, T_FF]
    if axis.notch_b0 != 1.0:  # transposed direct form
        filtered = axis.notch_b0 * torque + state[k, N1]
        state[k, N1] = axis.notch_b1 * torque - axis.notch_b1 * filtered + state[k, N2]
        state[k, N2] = axis.notch_b0 * torque - axis.notch_a2 * filtered
        torque = filtered
    wanted = torque / axis.kt_control
    held = min(max(wanted, -axis.current_limit), axis.current_limit)
    if held == wanted:
        state[k, I_SPEED] += axis.ki * error
    state[k, LAG_I] += (held - state[k, LAG_I]) * axis.current_share
    error = state[k, LAG_I] - current
    voltage = axis.kpi * error + state[k, I_CURRENT]
    held = min(max(voltage, -axis.bus), axis.bus)
    if held == voltage:
        state[k, I_CURRENT] += axis.kii * error
    return held


def control_at_rest(m: np.ndarray, set_point: np.ndarray, current: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """State of a control at rest with `current` [A] and `voltage` [V], which the integrators hold."""
    state = np.zeros((len(set_point), CONTROL_STATES))
    state[:, I_SPEED] = m["kt_control"] * current
    state[:, I_CURRENT] = voltage
    state[:, LAG_S] = state[:, S_F1] = state[:, S_F2] = set_point
    state[:, LAG_I] = current
    # steady state of the notch filter for the constant torque
    torque = m["kt_control"] * current
    state[:, N1] = state[:, N2] = (m["notch_b0"] - m["notch_a2"]) * torque
    return state
