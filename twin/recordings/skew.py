"""Skew of a channel: how much later than the position it was recorded, estimated from the recording alone.

A channel is y(t) = m(t - d) with a model m = X b of the position: the speed for a velocity; position, direction and acceleration for a
motor encoder (so that backlash and windup do not count as skew); the torque balance for a current. Columns and channel pass the same
zero-phase low-pass. A coarse search is followed by Gauss-Newton, with the interval of the regression by strokes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy
from scipy.interpolate import CubicSpline
from scipy.ndimage import binary_dilation, binary_opening

from twin.estimate.regression import NORMAL_95, regress
from twin.recordings.trace import FORCES, measured_position_in

BAND_HZ = 40.0
SEARCH_S = 0.25
CLEAR = 0.5
CLEAR_FORCE = 0.9
"""Share of the variance of a channel (of a force) that the model must explain; below, no skew is estimated."""
INERTIA = 0.1
"""Share of a force's variance that only the acceleration explains; friction alone gives no timing."""
LATE_S = {"motor_position": 1e-4, "velocity": 1e-4}
"""Smallest skew that is reported [s]; an elastic drive train causes smaller ones."""
LATE_CURRENT_S = 1.5e-3
"""The same for current, torque and voltage: friction at reversals and masses moved by other axes cause up to 0.8 ms on healthy machines."""
CREEP, STANDSTILL = 0.02, 12
"""An axis slower than this share of its largest speed for so many rows rests. What friction holds there, and builds up beside it, has no time of its own."""
CERTAIN = 4.0
"""Standard deviations by which a skew is sure to differ from another one."""
LEAST_ROWS = 200
"""Fewest samples for an estimate of a skew: fewer have too few strokes for an interval."""
PER_BAND = 6.0
"""Samples kept per period of the band limit."""


@dataclass(frozen=True)
class Skew:
    """A channel recorded `seconds` later than its reference (negative: earlier), with the standard deviation [s]."""

    axis: str
    signal: str
    seconds: float
    deviation: float
    reference: str = "position"

    @property
    def clear(self) -> bool:
        """True if the skew exceeds what noise, an elastic drive train and a current loop cause."""
        return abs(self.seconds) > max(LATE_S.get(self.signal, LATE_CURRENT_S), CERTAIN * self.deviation)

    @property
    def half(self) -> float:
        """Half width of the 95 % interval [s]."""
        return NORMAL_95 * self.deviation

    def differenced(self, period: float) -> int:
        """A speed is a difference of positions over this many samples if it is late by half of them; else 0."""
        samples = 2.0 * self.seconds / period
        whole = round(samples)
        off = max(HALF_OFF, 2.0 * CERTAIN * self.deviation / period)  # a less certain lateness may be this one as well
        return whole if self.signal == "velocity" and 0 < whole <= MOST_DIFFERENCE and abs(samples - whole) < off else 0


MOST_DIFFERENCE, HALF_OFF = 16, 0.05
"""Most samples of such a difference, and how far the lateness may be off [samples]."""


def skews_of(signals: Mapping[tuple[str, str], np.ndarray], period: float, kinds: Mapping[str, str]) -> list[Skew]:
    """Skew of each channel of each axis that can be compared with a position. `signals` (sample,) [SI] on one even grid."""
    out = []
    for axis in dict.fromkeys(a for a, _ in signals):
        own = {s: v for (a, s), v in signals.items() if a == axis and np.ptp(v) > 0.0}
        reference = measured_position_in(own)
        if not reference:
            continue
        # the speed is the motor's, so it is compared with the motor position if that is recorded; a force moves the load
        motor = "motor_position" if "motor_position" in own else reference
        behind = 0.0
        for signal in ("motor_position", "velocity", *FORCES):
            if signal in own and signal != reference:
                base = motor if signal == "velocity" else reference
                found = _of_channel(own[signal], own[base], signal, period, kinds[axis])
                if found is not None:
                    late = Skew(axis, signal, found[0] + (behind if base != reference else 0.0), found[1])
                    behind = late.seconds if signal == "motor_position" and late.clear else behind
                    out.append(late)
    return out


def relative_to_first_encoder(late: Sequence[Skew]) -> list[Skew]:
    """The skews relative to the earlier encoder: motion reaches the motor before the load, so the later of two encoders is late."""
    out: list[Skew] = []
    for axis in dict.fromkeys(item.axis for item in late):
        own = [item for item in late if item.axis == axis]
        motor = next((item for item in own if item.signal == "motor_position" and item.clear and item.seconds < 0.0), None)
        if motor is None:
            out += own
            continue
        out.append(replace(motor, signal="position", seconds=-motor.seconds, reference="motor_position"))
        out += [replace(i, seconds=i.seconds - motor.seconds, reference="motor_position") for i in own if i is not motor]
    return out


def _of_channel(values: np.ndarray, reference: np.ndarray, signal: str, period: float, kind: str) -> tuple[float, float] | None:
    """Skew of one channel relative to a position: (seconds, deviation)."""
    band = min(BAND_HZ, 0.1 / period)
    every = max(1, int(1.0 / (PER_BAND * band * period)))
    if len(values) < max(40 * every, LEAST_ROWS):
        return None
    place = _smooth(reference, period, band)
    speed = np.gradient(place, period)
    acceleration, ones = np.gradient(speed, period), np.ones_like(speed)
    if signal == "motor_position":
        columns = [place, speed, _direction(speed, period, band), acceleration, ones]
    elif signal == "velocity":
        columns = [speed, ones]
    else:
        columns = [acceleration, speed, _direction(speed, period, band), ones]
        if kind == "rotary":  # gravity turns with the axis
            columns += [np.cos(place), np.sin(place)]
    y = _smooth(values, period, band)[::every]
    return _late(y, np.column_stack([c[::every] for c in columns]), speed[::every], period * every, signal)


def _smooth(values: np.ndarray, period: float, band: float) -> np.ndarray:
    """Fourth-order Butterworth, forwards and backwards."""
    return scipy.signal.sosfiltfilt(scipy.signal.butter(4, band, fs=1.0 / period, output="sos"), values)


def _direction(speed: np.ndarray, period: float, band: float) -> np.ndarray:
    """Sign of the speed, filtered in the same way; zero at rest."""
    moving = np.abs(speed) > 1e-3 * np.abs(speed).max()
    return _smooth(np.sign(speed) * moving, period, band)


def _late(y: np.ndarray, columns: np.ndarray, speed: np.ndarray, period: float, signal: str) -> tuple[float, float] | None:
    """(seconds late, deviation) of y relative to the model columns; None if not clear."""
    rows = np.arange(len(y))
    reach = min(int(SEARCH_S / period), len(y) // 4)
    inner = rows[reach + 2 : len(y) - reach - 2]
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    variance = float(np.var(y[inner]))
    if variance == 0.0 or len(inner) < 40:
        return None
    # coarse: the whole shift that explains most
    left = {shift: _unexplained(columns[inner - shift], y[inner]) for shift in range(-reach, reach + 1)}
    best = min(left, key=left.__getitem__)
    if left[best] > (1.0 - (CLEAR_FORCE if signal in FORCES else CLEAR)) * variance or abs(best) == reach:
        return None
    if signal in FORCES:
        if _unexplained(columns[inner - best][:, 1:], y[inner]) - left[best] < INERTIA * variance:
            return None  # only friction, which leads the motion at slow reversals
        resting = binary_opening(np.abs(speed) < CREEP * np.abs(speed).max(), np.ones(STANDSTILL))
        inner = inner[~binary_dilation(resting, np.ones(2 * STANDSTILL + 1))[inner - best]]
        if len(inner) < 40:
            return None
    # fine: y - m(t - d), linear in the remaining d
    spline = CubicSpline(rows * period, columns)
    clusters = np.cumsum(np.diff(np.sign(speed[inner]), prepend=0.0) != 0) + rows[inner] // max(int(0.5 / period), 1) * 1000
    d, deviation = best * period, np.inf
    for _ in range(6):
        at = inner * period - d
        x = spline(at)
        slope = spline(at, 1) @ np.linalg.lstsq(x, y[inner], rcond=None)[0]
        if signal == "motor_position":
            # the speed column equals a small shift, so it is left out; direction and acceleration stay
            x = np.delete(x, 1, axis=1)
        fit = regress(np.column_stack([x, -slope]), y[inner], clusters)
        d, deviation = d + float(fit.values[-1]), float(fit.deviations[-1])
        if abs(fit.values[-1]) < 1e-8:
            break
        if abs(d) > reach * period:
            return None
    return d, deviation


def _unexplained(x: np.ndarray, y: np.ndarray) -> float:
    """Mean square of y that the columns of x do not explain, by normal equations; accurate enough to compare shifts."""
    return float(np.mean((y - x @ np.linalg.lstsq(x.T @ x, x.T @ y, rcond=None)[0]) ** 2))
