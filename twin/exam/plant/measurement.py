"""Measuring systems: noise and resolution of the machine file's [measurement] table, and errors between load and reading.

    scale = q + frame + drift (started_at + t) + eccentricity (sin(q + phase) - sin(q0 + phase))
    reading = round((scale + noise) / step) step, and the same for the motor encoder
Noise is white and Gaussian with the table's standard deviation, in SI. As in the recorded campaigns, noise is added before
rounding and the position controller uses the rounded sample of the encoder that closes its loop; the speed and current controllers see their noise at every tick.
Outside the library: play of the scale's coupling, error within a scale period, cross-talk of another axis, late recording of current.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .parameters import Settings


class Sensors(NamedTuple):
    """Arrays [axis], SI."""

    scale_noise: np.ndarray
    scale_step: np.ndarray
    motor_noise: np.ndarray
    motor_step: np.ndarray
    on_motor: np.ndarray  # bool: the position loop is closed on the motor encoder
    speed_noise: np.ndarray  # axis units per s
    current_noise: np.ndarray
    drift: np.ndarray
    eccentricity: np.ndarray
    eccentricity_phase: np.ndarray
    play: np.ndarray
    subperiod: np.ndarray
    subperiod_number: np.ndarray
    crosstalk: np.ndarray  # [this, from]
    skew: np.ndarray  # ticks, int


def sensors_of(s: Settings) -> Sensors:
    """Sensors from settings (after effects) and the machine file."""
    t = s.machine["measurement"]
    rad = math.pi / 180.0

    def by_kind(linear: float, rotary: float) -> np.ndarray:
        return np.where(s.linear, linear, rotary)

    length = np.where(s.subperiod_length > 0, s.subperiod_length, 1.0)
    return Sensors(
        by_kind(t["linear_scale_noise_m"], t["rotary_encoder_noise_deg"] * rad),
        by_kind(t["linear_scale_resolution_m"], t["rotary_encoder_resolution_deg"] * rad),
        by_kind(t.get("motor_encoder_noise_m", 0.0), t.get("motor_encoder_noise_rad", 0.0)),
        by_kind(t["motor_encoder_resolution_m"], t["motor_encoder_resolution_rad"]),
        s.on_motor,
        by_kind(t["speed_noise_m_per_s"], t["speed_noise_deg_per_s"] * rad),
        np.full(len(s.linear), t["current_noise_a"]),
        s.drift,
        s.eccentricity,
        s.eccentricity_phase,
        s.scale_play,
        s.subperiod,
        2 * math.pi / length,
        s.crosstalk,
        np.round(s.skew_s / s.tick).astype(np.int64),
    )
