"""Does a force push along the motion, against it, or is only its size recorded? Found from the record before anything is fitted.

    f = m a + d sign(v) + b v + c          (plus cos, sin of the place on a rotary axis: gravity turns with it)

A signed force has m, d, b of one sign: positive along the motion, negative where the control counts the other way round. A record of the
size alone is never below zero and goes better with |m a + d sign(v)|, whichever way the axis moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from twin.recordings.campaign import MeasuredRun

BAND_HZ = 30.0
CLEAR = 0.25
"""Share of the force's variance that the balance must explain; below, nothing is said of its sign."""
BETTER = 1.2
"""Unsigned: what |balance| leaves must be smaller by this factor than what the signed balance leaves."""

MOST = 3.0
"""Parts of the balance that push backwards must outweigh those that push forwards by this factor, before a sign is turned."""


@dataclass(frozen=True)
class ForceSign:
    """`sign` -1: turn it round; `unsigned`: only the size is recorded; `remark` for the map, `doubt` where it cannot be used."""

    sign: int = 1
    unsigned: bool = False
    remark: str = ""
    doubt: str = ""


def force_sign(force: np.ndarray, position: np.ndarray, period: float, kind: str) -> ForceSign:
    """Sign of a current, torque or voltage (sample,) against a position (sample,) in any units."""
    if len(force) < 60 or not np.ptp(force) > 0.0 or not np.ptp(position) > 0.0:
        return ForceSign()
    motion, f = _smooth(position, period), _smooth(force, period)
    speed = np.gradient(motion, period)
    acceleration = np.gradient(speed, period)
    moving = np.abs(speed) > 0.02 * np.abs(speed).max()
    direction = np.sign(speed) * moving
    inner = slice(len(f) // 50, len(f) - len(f) // 50)
    place = [np.cos(position), np.sin(position)] if kind == "rotary" else []
    signed, coefficients = _fit(np.column_stack([acceleration, direction, speed, *place, np.ones_like(f)])[inner], f[inner])
    both_ways = min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0)) > 0.1 * np.count_nonzero(moving)
    if both_ways and (force.min() >= 0.0 or force.max() <= 0.0):
        ahead = np.sign(acceleration * speed) * np.abs(acceleration)
        size, _ = _fit(np.column_stack([ahead, np.abs(direction), np.abs(speed), np.ones_like(f)])[inner], f[inner])
        if size * BETTER < signed:
            return ForceSign(unsigned=True, remark="only its size is recorded, without a sign")
    if signed > 1.0 - CLEAR:
        return ForceSign()
    # inertia, Coulomb and viscous friction, each by its part of the force: where most of it pushes backwards, the sign is
    parts = coefficients[:3] * np.column_stack([acceleration, direction, speed])[inner].std(axis=0)
    if -parts[parts < 0.0].sum() > MOST * parts[parts > 0.0].sum():
        return ForceSign(sign=-1, remark="turned round: as recorded it pushes against the motion")
    return ForceSign()


def recorded_sign(run: MeasuredRun, axis: str, signal: str) -> ForceSign:
    """Sign of a force of an imported or given run: what the import noted of it, else what its own motion says."""
    trace = run.trace
    if run.fact(axis, signal).unsigned:
        return ForceSign(unsigned=True, remark="only its size is recorded, without a sign")
    where = next((s for s in ("position", "motor_position") if trace.has(axis, s)), None)
    if where is None or not trace.has(axis, signal):
        return ForceSign()
    return force_sign(trace.get(axis, signal), trace.get(axis, where), trace.period, trace.kinds[axis])


def _smooth(values: np.ndarray, period: float) -> np.ndarray:
    band = min(BAND_HZ, 0.15 / period)
    return np.asarray(sosfiltfilt(butter(2, band, fs=1.0 / period, output="sos"), values))


def _fit(columns: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """(share of the variance that is left, coefficients)."""
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    b = np.linalg.lstsq(columns / scale, y, rcond=None)[0] / scale
    return float(np.var(y - columns @ b) / max(float(np.var(y)), 1e-300)), b
