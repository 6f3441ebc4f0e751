"""Measuring systems: noise and resolution of the machine file's [measurement] table, and errors between load and reading.

    scale = q + frame + drift (started_at + t) + eccentricity (sin(q + phase) - sin(q0 + phase))
    reading = round((scale + noise) / step) step, and the same for the motor encoder
Noise is white and Gaussian with the table's standard deviation, in SI. As in the recorded campaigns, noise is added before
rounding and the position controller uses the rounded sample of the encoder that closes its loop; the speed and current controllers see their noise at every tick.
Outside the library: play of the scale's coupling, error within a scale period, cross-talk of another axis, late recording of current.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from .parameters import Settings


def sensor_values(s: Settings) -> dict[str, Any]:
    """Fields of the axis records, from settings (after effects) and the machine file."""
    t = s.machine["measurement"]
    rad = math.pi / 180.0

    def by_kind(linear: float, rotary: float) -> np.ndarray:
        return np.where(s.linear, linear, rotary)

    return {
        "scale_noise": by_kind(t["linear_scale_noise_m"], t["rotary_encoder_noise_deg"] * rad),
        "scale_step": by_kind(t["linear_scale_resolution_m"], t["rotary_encoder_resolution_deg"] * rad),
        "motor_noise": by_kind(t.get("motor_encoder_noise_m", 0.0), t.get("motor_encoder_noise_rad", 0.0)),
        "motor_step": by_kind(t["motor_encoder_resolution_m"], t["motor_encoder_resolution_rad"]),
        "speed_noise": by_kind(t["speed_noise_m_per_s"], t["speed_noise_deg_per_s"] * rad),  # axis units per s
        "current_noise": t["current_noise_a"],
        "subperiod_number": 2 * math.pi / np.where(s.subperiod_length > 0, s.subperiod_length, 1.0),
        "skew": np.round(s.skew_s / s.tick),  # ticks
    }
