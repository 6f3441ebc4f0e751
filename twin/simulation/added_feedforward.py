"""The part of a recorded velocity feedforward that the set points do not explain.

A control may add signals to its velocity feedforward that do not follow from the set points, for example friction compensation pulses
after a reversal (SINUMERIK MD32500). If the feedforward f is recorded, this part of it is known:

    f(t) = a v(t - d) + rest(t),    v(t) = (s(t) - s(t - Tp)) / Tp

Weight a and delay d are fitted, so that `rest` does not hide a wrong weight or delay in the machine file.
"""

from collections.abc import Callable

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace

MOST_DELAY_CYCLES = 8
"""Longest fitted delay of the feedforward, in position cycles."""

EXPLAINED = 0.1
"""Largest rest, as a fraction of the feedforward (RMS). A signal with a larger rest is another quantity and is not used."""

ROUNDING = 1e-5
"""Largest rest, as a fraction of the maximum feedforward, that counts as rounding."""

EXACT = 1e-9
"""Rest, as a fraction of the maximum feedforward, that is rounding of the calculation."""

PART = 0.1
"""Tolerance of the fitted fraction of a cycle, which lies between 0 and 1."""

ROUNDS = 4
IN_LINE = 0.8
OUT_OF_LINE = 4.0
"""Outlier rejection of the fit: number of rounds, fraction of the smallest residuals that gives the RMS, and multiple of that RMS that rejects a sample."""


def added_feedforward(trace: Trace, machine: Machine, set_points: Callable[[np.ndarray], np.ndarray]) -> np.ndarray | None:
    """Speed (sample, axis) [m/s, rad/s] in the recorded feedforward of each axis beyond the slope of its set points, or None.

    `set_points` gives positions (time, axis) at times [s] since the first sample.
    """
    if trace.period > machine.position_cycle * 1.001:
        return None
    # not where a block of the control makes the added signals itself
    fed = [a for a in machine.axes if trace.has(a.name, "velocity_feedforward") and a.loops.velocity_feedforward != 0.0]
    recorded = [a for a in fed if not any("velocity_feedforward" in listed.block.replaces for listed in a.blocks)]
    out = np.zeros((len(trace.time), len(machine.axes)))
    for axis in recorded:
        a = machine.axis_names.index(axis.name)
        out[:, a] = _rest(trace, axis, lambda times, a=a: set_points(times)[:, a], machine.position_cycle)  # type: ignore[misc]
    return out if out.any() else None


def _rest(trace: Trace, axis: Axis, set_point: Callable[[np.ndarray], np.ndarray], cycle: float) -> np.ndarray:
    """The rest (sample,) of one axis; zeros if there is none or if the signal is another quantity."""
    fed = trace.get(axis.name, "velocity_feedforward")
    largest = float(np.abs(fed).max())
    none = np.zeros(len(fed))
    if not largest > 0.0 or len(fed) < 20:
        return none
    times = trace.time - trace.time[0]
    delays = axis.loops.feedforward_delay_s % cycle + cycle * np.arange(MOST_DELAY_CYCLES + 1)
    back = np.append(delays, [delays[-1] + cycle, delays[-1] + 2.0 * cycle])
    speeds = -np.diff(np.column_stack([set_point(times - d) for d in back]), axis=1) / cycle
    moving = (times > back[-1]) & ((fed != 0.0) | speeds.any(axis=1))
    speeds, seen = speeds[moving], fed[moving]
    if len(seen) < 20:
        return none
    changing = np.ptp(speeds, axis=1) > ROUNDING * largest

    def size(rest: np.ndarray) -> float:
        """Of a rest (sample,); where the speed is changing, if the others fit exactly: constant speed does with any delay."""
        whole = _size(rest)
        return whole if whole > EXACT * largest or not changing.any() else _size(rest[changing])

    fits = [_fitted(speeds[:, k], speeds[:, k + 1], seen, size) for k in range(len(delays))]
    # for an oscillating axis, any delay fits with a fraction outside of 0 to 1
    rests = [rest for rest, weight, part in fits if weight > 0.0 and -PART <= part <= 1.0 + PART]
    if not rests:
        return none
    left = min(rests, key=size)
    if np.mean(left**2) > EXPLAINED**2 * np.mean(seen**2) or np.abs(left).max() < ROUNDING * largest:
        return none
    none[moving] = left
    return none


def _fitted(speed: np.ndarray, before: np.ndarray, fed: np.ndarray, size: Callable[[np.ndarray], float]) -> tuple[np.ndarray, float, float]:
    """(rest (sample,), weight, further delay as a fraction of a cycle) by robust least squares of the feedforward on speed and its change."""
    columns = np.column_stack([speed, speed - before])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    keep = np.ones(len(fed), bool)
    rest, values = fed, np.zeros(2)
    for _ in range(ROUNDS):
        values = np.linalg.lstsq(columns[keep] / scale, fed[keep], rcond=None)[0] / scale
        rest = fed - columns @ values
        keep = np.abs(rest) <= max(OUT_OF_LINE * size(rest), 1e-15)
    return rest, float(values[0]), float(-values[1] / values[0]) if values[0] else 0.0


def _size(values: np.ndarray) -> float:
    """RMS of the smallest IN_LINE fraction of the values."""
    squares = np.sort(values**2)[: max(int(IN_LINE * len(values)), 1)]
    return float(np.sqrt(np.mean(squares)))
