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
from typing import NamedTuple

import numpy as np

from .compensation import Compensation, compensated_position, friction_pulse
from .compiled import compiled
from .parameters import Settings


class Control(NamedTuple):
    """Arrays [axis]; gains include their cycle times."""

    ratio: np.ndarray  # m/rad, rad/rad
    kv: np.ndarray  # 1/s
    velocity_gain: np.ndarray  # a_v / Tp
    torque_gain: np.ndarray  # a_t J_ff / Tp^2 / r
    kp: np.ndarray  # Nm s/rad
    ki: np.ndarray  # Kp Ts / Tn
    kt: np.ndarray  # Nm/A, the control's own
    limit: np.ndarray  # A
    kpi: np.ndarray  # V/A
    kii: np.ndarray  # Kpi Ts / Tni
    bus: np.ndarray  # V
    set_point_share: np.ndarray  # 1 - exp(-Tp / tau), 1 = no lag
    current_share: np.ndarray  # 1 - exp(-Ts / tau)
    dead_band: np.ndarray  # axis units
    speed_share: np.ndarray  # 1 - exp(-Ts / tau)
    speed_clip: np.ndarray  # rad/s, positive direction only
    notch: np.ndarray  # [axis, 5]: b0 b1 b2 a1 a2
    transport: np.ndarray  # delay of the telegram in ticks, 0 = the control closes the position loop


def control_of(s: Settings) -> Control:
    """Control arrays from settings (parameters.settings_of, after effects)."""
    cycle = s.tick * s.cycle_ticks

    def share(period: float, tau: np.ndarray) -> np.ndarray:
        return np.where(tau > 0.0, 1.0 - np.exp(-period / np.where(tau > 0.0, tau, 1.0)), 1.0)

    notch = np.zeros((len(s.kv), 5))
    notch[:, 0] = 1.0
    for k in np.flatnonzero(s.notch_hz):
        notch[k] = _notch(s.notch_hz[k], s.notch_width[k], s.tick)
    return Control(
        s.ratio,
        s.kv,
        s.velocity_weight / cycle,
        s.torque_weight * s.inertia_control / cycle**2 / s.ratio,
        s.kp,
        s.kp * s.tick / s.tn,
        s.kt_control,
        s.current_limit,
        s.kpi,
        s.kpi * s.tick / s.tni,
        s.bus,
        share(cycle, s.set_point_lag),
        share(s.tick, s.current_lag),
        s.dead_band,
        share(s.tick, s.speed_lag),
        s.speed_clip / s.ratio,
        notch,
        s.dsc_delay / s.tick,
    )


def _notch(hz: float, width: float, tick: float) -> np.ndarray:
    """Biquad of (s^2 + w^2) / (s^2 + width w s + w^2), by the bilinear transform with prewarping."""
    t = math.tan(math.pi * hz * tick)
    a0 = 1.0 + width * t + t * t
    return np.array([1.0 + t * t, 2.0 * (t * t - 1.0), 1.0 + t * t, 2.0 * (t * t - 1.0), 1.0 - width * t + t * t]) / a0


# State of the control, one row per axis
W_SET, T_FF, I_SPEED, I_CURRENT, LAG_S, LAG_I, LAG_W, N1, N2, S_F1, S_F2, W_SENT, T_SENT = range(13)
CONTROL_STATES = 13


@compiled(inline=True)
def position_cycle(
    c: Control,
    on: Compensation,
    state: np.ndarray,
    own: np.ndarray,
    k: int,
    s_position: float,
    s_feedforward: float,
    scale: float,
) -> None:
    """Update speed set point and torque feedforward of axis k; `own` is the state of its compensations."""
    state[k, LAG_S] += (s_position - state[k, LAG_S]) * c.set_point_share[k]
    error = state[k, LAG_S] - compensated_position(on, own, k, state[k, LAG_S], scale)
    band = c.dead_band[k]
    if band > 0.0:
        error = math.copysign(max(abs(error) - band, 0.0), error)
    s1, s2 = state[k, S_F1], state[k, S_F2]
    speed = c.kv[k] * error + c.velocity_gain[k] * (s_feedforward - s1)
    speed = (speed + friction_pulse(on, own, k, speed)) / c.ratio[k]
    state[k, W_SENT] = speed
    state[k, T_SENT] = c.torque_gain[k] * (s_feedforward - 2.0 * s1 + s2)
    if c.transport[k] == 0.0:
        state[k, W_SET] = state[k, W_SENT] = min(speed, c.speed_clip[k])
        state[k, T_FF] = state[k, T_SENT]
    state[k, S_F2] = s1
    state[k, S_F1] = s_feedforward


@compiled(inline=True)
def drive_cycle(c: Control, state: np.ndarray, k: int, n: int, scale: float, past: np.ndarray) -> None:
    """Position loop of axis k in its drive at tick n; past [axis, tick, 3] is a ring of speed, torque and scale."""
    length = past.shape[1]
    for i in range(length if n == 0 else 1):
        slot = (n + i) % length
        past[k, slot, 0], past[k, slot, 1], past[k, slot, 2] = state[k, W_SENT], state[k, T_SENT], scale
    back = math.floor(c.transport[k])
    weight = c.transport[k] - back
    a, b = (n - back) % length, (n - back - 1) % length
    speed = (1.0 - weight) * past[k, a, 0] + weight * past[k, b, 0]
    way = scale - (1.0 - weight) * past[k, a, 2] - weight * past[k, b, 2]
    state[k, W_SET] = min(speed - c.kv[k] * way / c.ratio[k], c.speed_clip[k])
    state[k, T_FF] = (1.0 - weight) * past[k, a, 1] + weight * past[k, b, 1]


@compiled(inline=True)
def current_cycle(c: Control, state: np.ndarray, k: int, speed: float, current: float) -> float:
    """Speed and current controller of axis k at one tick; returns the voltage held until the next tick."""
    state[k, LAG_W] += (state[k, W_SET] - state[k, LAG_W]) * c.speed_share[k]
    error = state[k, LAG_W] - speed
    torque = c.kp[k] * error + state[k, I_SPEED] + state[k, T_FF]
    if c.notch[k, 0] != 1.0:  # transposed direct form
        filtered = c.notch[k, 0] * torque + state[k, N1]
        state[k, N1] = c.notch[k, 1] * torque - c.notch[k, 3] * filtered + state[k, N2]
        state[k, N2] = c.notch[k, 2] * torque - c.notch[k, 4] * filtered
        torque = filtered
    wanted = torque / c.kt[k]
    limit = c.limit[k]
    if wanted > limit:
        wanted = limit
    elif wanted < -limit:
        wanted = -limit
    else:
        state[k, I_SPEED] += c.ki[k] * error
    state[k, LAG_I] += (wanted - state[k, LAG_I]) * c.current_share[k]
    error = state[k, LAG_I] - current
    voltage = c.kpi[k] * error + state[k, I_CURRENT]
    bus = c.bus[k]
    if voltage > bus:
        voltage = bus
    elif voltage < -bus:
        voltage = -bus
    else:
        state[k, I_CURRENT] += c.kii[k] * error
    return voltage


def control_at_rest(c: Control, set_point: np.ndarray, current: np.ndarray, voltage: np.ndarray) -> np.ndarray:
    """State of a control at rest with `current` [A] and `voltage` [V], which the integrators hold."""
    state = np.zeros((len(set_point), CONTROL_STATES))
    state[:, I_SPEED] = c.kt * current
    state[:, I_CURRENT] = voltage
    state[:, LAG_S] = state[:, S_F1] = state[:, S_F2] = set_point
    state[:, LAG_I] = current
    # steady state of the notch filter for the constant torque
    torque = c.kt * current
    state[:, N2] = (c.notch[:, 2] - c.notch[:, 4]) * torque
    state[:, N1] = (c.notch[:, 1] - c.notch[:, 3]) * torque + state[:, N2]
    return state
