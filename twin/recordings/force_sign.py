"""Sign of a recorded force: along the motion, against it, or only the magnitude. Estimated from the recording alone.

f = m a + d sign(v) + b v + c          (plus cos, sin of the position on a rotary axis, for gravity)

For a signed force m, d and b have the same sign: positive along the motion, negative if the control counts in the opposite direction. A
magnitude is never negative and fits |m a + d sign(v)| better, in both directions of motion.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.signal at first use: it is slow to import

from twin.estimate.regression import solved
from twin.recordings.campaign import MeasuredRun

BAND_HZ = 30.0
CLEAR = 0.25
"""Share of the force's variance that the balance must explain; below, the sign is not judged."""
BETTER = 1.2
"""A force is unsigned if the residual of |balance| is smaller than that of the signed balance by this factor."""

MOST = 0.5
"""A sign is reversed if negative parts of the balance outweigh positive ones by this share: they are three times as large."""
LEAST = 20
"""Fewest samples for the fit of a balance."""


@dataclass(frozen=True)
class ForceSign:
    """`sign` -1: reverse it. `unsigned`: only the magnitude is recorded. `remark` for the map."""

    sign: int = 1
    unsigned: bool = False
    remark: str = ""


@dataclass(frozen=True)
class Balance:
    """Fit of the balance: unexplained share of the variance, the same for |balance| (NaN in one direction only), and `direction`: 1 if all parts
    of the force are along the motion, -1 if all are against it."""

    left: float
    left_magnitude: float
    direction: float


def force_balance(force: np.ndarray, position: np.ndarray, period: float, kind: str) -> Balance:
    """Balance of a force (sample,) in any unit on the motion of a position (sample,) [m or rad; a linear axis: any unit]."""
    if len(force) < LEAST or not np.ptp(force) > 0.0 or not np.ptp(position) > 0.0:
        return Balance(1.0, np.nan, 0.0)
    motion, f = low_passed(position, period, BAND_HZ), low_passed(force, period, BAND_HZ)
    speed = np.gradient(motion, period)
    acceleration = np.gradient(speed, period)
    moving = np.abs(speed) > 0.02 * np.abs(speed).max()
    direction = np.sign(speed) * moving
    inner = slice(len(f) // 50, len(f) - len(f) // 50)
    place = [np.cos(position), np.sin(position)] if kind == "rotary" else []
    left, coefficients = _fit(np.column_stack([acceleration, direction, speed, *place, np.ones_like(f)])[inner], f[inner])
    # few samples, fewer of them independent after the low-pass, explain anything
    independent = len(f[inner]) * min(1.0, 2.0 * min(BAND_HZ * period, 0.15))
    left = min(left * max(independent - 1.0, 1.0) / max(independent - len(coefficients), 0.1), 1.0)
    left_magnitude = np.nan
    both_ways = min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0)) > 0.1 * np.count_nonzero(moving)
    if both_ways and (force.min() >= 0.0 or force.max() <= 0.0):
        along = np.sign(acceleration * speed) * np.abs(acceleration)
        left_magnitude, _ = _fit(np.column_stack([along, np.abs(direction), np.abs(speed), np.ones_like(f)])[inner], f[inner])
    # inertia, Coulomb and viscous friction weighted by their part of the force
    parts = coefficients[:3] * np.column_stack([acceleration, direction, speed])[inner].std(axis=0)
    return Balance(left, left_magnitude, float(parts.sum() / max(np.abs(parts).sum(), 1e-300)))


def force_sign(force: np.ndarray, position: np.ndarray, period: float, kind: str) -> ForceSign:
    """Sign of a current, torque or voltage (sample,) in any unit, relative to a position (sample,) [m or rad]."""
    found = force_balance(force, position, period, kind)
    if found.left_magnitude * BETTER < found.left:
        return ForceSign(unsigned=True, remark="only the magnitude is recorded, without a sign")
    if found.left <= 1.0 - CLEAR and found.direction < -MOST:
        return ForceSign(sign=-1, remark="sign reversed: as recorded it pushes against the motion")
    return ForceSign()


def recorded_sign(run: MeasuredRun, axis: str, signal: str) -> ForceSign:
    """Sign of a force of a run: from the import if it noted one, else from its own motion."""
    trace = run.trace
    if run.fact(axis, signal).unsigned:
        return ForceSign(unsigned=True, remark="only the magnitude is recorded, without a sign")
    where = next((s for s in ("position", "motor_position") if trace.has(axis, s)), None)
    if where is None or not trace.has(axis, signal):
        return ForceSign()
    return force_sign(trace.get(axis, signal), trace.get(axis, where), trace.period, trace.kinds[axis])


def low_passed(values: np.ndarray, period: float, band_hz: float) -> np.ndarray:
    """Zero-phase low-pass of second order, at most at 0.15 of the sampling rate."""
    return np.asarray(scipy.signal.sosfiltfilt(scipy.signal.butter(2, min(band_hz, 0.15 / period), fs=1.0 / period, output="sos"), values))


def _fit(columns: np.ndarray, y: np.ndarray) -> tuple[float, np.ndarray]:
    """(unexplained share of the variance, coefficients)."""
    b = solved(columns, y)
    return float(np.var(y - columns @ b) / max(float(np.var(y)), 1e-300)), b
