"""How much later than the position a channel was recorded, from the record alone.

A channel y(t) = m(t - d) of a model m = X b in what the position tells: speed for a velocity, place, direction and acceleration for a
motor encoder (a gap and a wind-up are no skew), torque balance for a current. Columns and channel pass the same zero-phase low-pass;
d is found on a coarse scale first, then by Gauss-Newton, with the interval of the regression by strokes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from twin.identify.axis_run import low_passed
from twin.identify.findings import LATE_S
from twin.identify.least_squares import regress

BAND_HZ = 40.0
SEARCH_S = 0.25
CLEAR = 0.5
"""Share of the channel's variance that the model must explain; below, nothing is said."""
LATE_CURRENT_S = 1.5e-3
"""Without a machine file: friction at reversals and masses moved by other axes make up to 0.8 ms on healthy runs."""
PER_BAND = 6.0
"""Samples kept for a period of the band's edge."""


@dataclass(frozen=True)
class Late:
    """A channel recorded `seconds` later than the position (earlier where negative), with the deviation of that [s]."""

    axis: str
    signal: str
    seconds: float
    deviation: float
    against: bool = False  # a current that pushes against the motion: its sign is wrong

    @property
    def clear(self) -> bool:
        """Beyond what noise, an elastic drive train and a current loop make."""
        return abs(self.seconds) > max(
            LATE_S[self.signal] if self.signal in ("motor_position", "velocity") else LATE_CURRENT_S, 4.0 * self.deviation
        )


def late_channels(signals: Mapping[tuple[str, str], np.ndarray], period: float, kinds: Mapping[str, str]) -> list[Late]:
    """Skew of each channel of each axis that the position can judge; `signals` (sample,) [SI] on one even grid."""
    out = []
    for axis in dict.fromkeys(a for a, _ in signals):
        own = {s: v for (a, s), v in signals.items() if a == axis}
        reference = next((s for s in ("position", "motor_position") if s in own and np.ptp(own[s]) > 0.0), None)
        if reference is None:
            continue
        band = min(BAND_HZ, 0.1 / period)
        every = max(1, int(1.0 / (PER_BAND * band * period)))
        coarse = period * every
        smooth = low_passed(own[reference], period, band)
        speed = np.gradient(smooth, period)
        columns = {
            "motor_position": [smooth, speed, _direction(speed, period, band), np.gradient(speed, period), np.ones_like(speed)],
            "velocity": [speed, np.ones_like(speed)],
            "current": [np.gradient(speed, period), speed, _direction(speed, period, band), np.ones_like(speed)],
        }
        if kinds[axis] == "rotary":  # gravity turns with the axis
            columns["current"] += [np.cos(smooth), np.sin(smooth)]
        columns["torque"] = columns["voltage"] = columns["current"]
        for signal, parts in columns.items():
            if signal not in own or signal == reference or np.ptp(own[signal]) == 0.0 or len(smooth) < 40 * every:
                continue
            y = low_passed(own[signal], period, band)[::every]
            late = _late(y, np.column_stack([p[::every] for p in parts]), speed[::every], coarse, signal)
            if late is not None:
                out.append(Late(axis, signal, late[0], late[1], late[2]))
    return out


def _direction(speed: np.ndarray, period: float, band: float) -> np.ndarray:
    """Sign of the speed through the same filter; zero at rest."""
    moving = np.abs(speed) > 1e-3 * np.abs(speed).max()
    return low_passed(np.sign(speed) * moving, period, band)


def _late(y: np.ndarray, columns: np.ndarray, speed: np.ndarray, period: float, signal: str) -> tuple[float, float, bool] | None:
    """(seconds late, deviation, pushes the wrong way) of y against the model in the columns, or None where nothing is clear."""
    rows = np.arange(len(y))
    reach = min(int(SEARCH_S / period), len(y) // 4)
    inner = rows[reach + 2 : len(y) - reach - 2]
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    variance = float(np.var(y[inner]))
    if variance == 0.0 or len(inner) < 40:
        return None
    # coarse: which whole shift explains most
    left = {}
    for shift in range(-reach, reach + 1):
        x = columns[inner - shift]
        left[shift] = float(np.mean((y[inner] - x @ np.linalg.lstsq(x, y[inner], rcond=None)[0]) ** 2))
    best = min(left, key=lambda s: left[s])
    if left[best] > (1.0 - CLEAR) * variance or abs(best) == reach:
        return None
    # fine: y - m(t - d), linear in what is left of d
    spline = CubicSpline(rows * period, columns)
    clusters = np.cumsum(np.diff(np.sign(speed[inner]), prepend=0.0) != 0) + rows[inner] // max(int(0.5 / period), 1) * 1000
    d, deviation, wrong = best * period, np.inf, False
    for _ in range(6):
        at = inner * period - d
        x = spline(at)
        b = np.linalg.lstsq(x, y[inner], rcond=None)[0]
        slope = spline(at, 1) @ b
        if signal == "motor_position":
            # the speed column is what a shift looks like: it goes out, direction and acceleration stay
            x = np.delete(x, 1, axis=1)
        fit = regress(np.column_stack([x, -slope]), y[inner], clusters)
        d, deviation = d + float(fit.values[-1]), float(fit.deviations[-1])
        wrong = signal in ("current", "torque") and float(b[0]) < 0.0 and float(b[2]) < 0.0
        if abs(fit.values[-1]) < 1e-8:
            break
        if abs(d) > reach * period:
            return None
    return d, deviation, wrong
