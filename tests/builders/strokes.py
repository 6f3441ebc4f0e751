"""Recorded strokes of one axis with planted facts: lag, friction, inertia, lost motion, noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace


@dataclass(frozen=True)
class Planted:
    """What the axis does, SI and A."""

    speeds: Sequence[float] = (0.02, 0.05, 0.1)
    lag: float = 0.011
    coulomb: float = 1.5
    viscous: float = 4.0
    inertia: float = 0.8
    constant: float = 0.3
    lost: float = 6e-6
    position_noise: float = 1e-7
    current_noise: float = 0.05
    line: tuple[float, float] = (0.0, 0.0)
    """Vibration of the position: frequency [Hz], amplitude [m]."""
    odd_stroke: tuple[int, float] = (-1, 0.0)
    """A stroke with more current [A]."""
    both_ways: bool = True


def strokes(planted: Planted, seed: int, period: float = 1e-3, travel: float = 0.06) -> MeasuredRun:
    """A run of strokes at each speed, twice, with smooth starts and rests of 0.3 s."""
    random = np.random.default_rng(seed)
    speed = [np.zeros(300)]
    extra = [np.zeros(300)]
    number = 0
    for v in [*planted.speeds, *planted.speeds]:
        for sign in (1.0, -1.0) if planted.both_ways else (1.0,):
            lasts = round(travel / v / period)
            ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(60) / 60)
            part = sign * v * np.concatenate([ramp, np.ones(max(lasts - 60, 60)), ramp[::-1]])
            speed += [part, np.zeros(300)]
            extra += [np.full(len(part), sign * planted.odd_stroke[1] * (number == planted.odd_stroke[0])), np.zeros(300)]
            number += 1
    v, more = np.concatenate(speed), np.concatenate(extra)
    time = period * np.arange(len(v))
    setpoint = period * np.cumsum(v)
    actual = np.interp(time - planted.lag, time, setpoint)
    u = np.interp(time - planted.lag, time, v)
    force = np.sign(u) * planted.coulomb + planted.viscous * u + planted.inertia * np.gradient(u, period) + planted.constant
    frequency, amplitude = planted.line
    position = actual + amplitude * np.sin(2.0 * np.pi * frequency * time) + planted.position_noise * random.standard_normal(len(v))
    signals = {
        ("X", "setpoint"): setpoint,
        ("X", "position"): position,
        ("X", "motor_position"): actual + 0.5 * planted.lost * np.sign(u) + planted.position_noise * random.standard_normal(len(v)),
        ("X", "current"): force + more + planted.current_noise * random.standard_normal(len(v)),
    }
    return MeasuredRun("strokes", Trace(time, signals, {"X": "linear"}), "off", 0.0)
