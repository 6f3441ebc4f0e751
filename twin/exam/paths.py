"""Rest-to-rest moves and smooth contours at 1 kHz, inside the limits of a machine file. SI: m, rad, s.

A move convolves a pulse of speed v with two boxes of length T1 = v/a and T2 = a/j, as a moving-average interpolator does, so that
speed, acceleration and jerk stay below v, a and j. A contour is a curve over u in 0..1; du/dt starts and stops as a raised cosine,
and the whole contour is slowed down until every axis keeps its limits of speed and acceleration.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from .plant.parameters import AXES

PERIOD = 1e-3  # sample period of recorded set points [s]
MARGIN = 0.97  # used share of every limit, so that rounded set points stay inside
DEG = math.pi / 180.0


@dataclass(frozen=True)
class Limits:
    """Per axis, SI: low and high travel, speed, acceleration, jerk."""

    low: np.ndarray
    high: np.ndarray
    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray


def limits_of(machine: dict) -> Limits:
    """Limits from the axis tables of a machine file."""
    rows = []
    for name in AXES:
        a = machine["axis"][name]
        if a["kind"] == "linear":
            rows.append((*a["travel_m"], a["max_velocity_m_per_min"] / 60, a["max_acceleration_m_per_s2"], a["max_jerk_m_per_s3"]))
        else:
            turn = 2 * math.pi
            low, high = (-1e3, 1e3) if a["travel_deg"] == "endless" else (x * DEG for x in a["travel_deg"])
            per_s = (a["max_velocity_rev_per_min"] / 60, a["max_acceleration_rev_per_s2"], a["max_jerk_rev_per_s3"])
            rows.append((low, high, *(turn * value for value in per_s)))
    return Limits(*(np.array(column) for column in zip(*rows)))


def move(distance: float, speed: float, acceleration: float, jerk: float) -> np.ndarray:
    """Positions of a rest-to-rest move from 0, at PERIOD; durations are rounded up to samples, so it never exceeds the limits."""
    length = abs(distance)
    if length == 0.0:
        return np.zeros(1)
    # a short move does not reach full speed: reduce speed, then acceleration, until the ramps fit into the distance
    for _ in range(200):
        t2 = acceleration / jerk
        t1 = max(speed / acceleration, t2)
        if speed * (t1 + t2) <= length or speed < 1e-9:
            break
        speed *= 0.96
        if speed / acceleration < t2:
            acceleration = math.sqrt(speed * jerk)
    n0, n1, n2 = (max(1, math.ceil(t / PERIOD)) for t in (length / speed, t1, t2))
    pulse = np.convolve(np.convolve(np.full(n0, 1.0 / n0), np.full(n1, 1.0 / n1)), np.full(n2, 1.0 / n2))
    return math.copysign(1.0, distance) * length * np.concatenate([[0.0], np.cumsum(pulse)])


def hold(seconds: float) -> int:
    """Samples of a time."""
    return round(seconds / PERIOD)


def path_of(
    start: float, targets: list[float], speeds: list[float], acceleration: float, jerk: float, dwell: float, lead_in: float = 0.1
) -> np.ndarray:
    """Rest-to-rest moves of one axis, each followed by a dwell."""
    parts, at = [np.full(hold(lead_in), start)], start
    for target, speed in zip(targets, speeds):
        parts += [at + move(target - at, speed, acceleration, jerk), np.full(hold(dwell), target)]
        at = target
    return np.concatenate(parts)


def together(columns: list[np.ndarray], tail: float = 0.15) -> np.ndarray:
    """Set points [sample, axis] from columns, each padded to one length with its last value."""
    n = max(len(c) for c in columns) + hold(tail)
    return np.column_stack([np.concatenate([c, np.full(n - len(c), c[-1])]) for c in columns])


def eased(duration: float, ramp: float) -> np.ndarray:
    """u(t) from 0 to 1 over `duration` s; its speed rises and falls as a raised cosine over `ramp` s."""
    t = np.arange(hold(duration) + 1) * PERIOD
    speed = np.where(t < ramp, 0.5 - 0.5 * np.cos(math.pi * t / ramp), 1.0)
    left = t[-1] - t
    speed = np.minimum(speed, np.where(left < ramp, 0.5 - 0.5 * np.cos(math.pi * left / ramp), 1.0))
    u = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))])
    return u / u[-1]


def within_limits(points: np.ndarray, limits: Limits) -> np.ndarray:
    """Used share of the speed and acceleration limits [speed or acceleration, axis]."""
    v, a = np.diff(points, axis=0) / PERIOD, np.diff(points, 2, axis=0) / PERIOD**2
    return np.array([np.abs(v).max(axis=0) / limits.speed, np.abs(a).max(axis=0) / limits.acceleration])


def contour(curve: Callable[[np.ndarray], np.ndarray], duration: float, limits: Limits, ramp: float = 0.6) -> np.ndarray:
    """curve(u) [sample, axis] for u in 0..1, slowed down until every axis keeps its limits of speed and acceleration; the jerk is not checked."""
    for _ in range(40):
        points = curve(eased(duration, ramp))
        use = within_limits(points, limits)
        if use.max() <= MARGIN:
            return points
        duration *= 1.08
    raise ValueError("no duration keeps this contour within the machine's limits")
