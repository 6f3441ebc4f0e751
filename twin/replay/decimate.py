"""Thin curves out without a visible change.

Each bin keeps the samples of its minimum and maximum at their own times, so no peak is lost or moved. Both samples of a jump are kept,
so a step stays a step. Of the others, points on a line between their neighbours are dropped (within SAME_LINE of the curve's range). Bins get longer
until all curves together fit the budget.
"""

from collections.abc import Sequence

import numpy as np

from twin.geometry.tool_path import keep_shape

FINEST_BIN = 4
"""Length of the shortest bin [samples]."""
JUMP = 0.02
"""A larger change between two samples, as a share of the curve's range, is a jump (unless there are many: then it is noise)."""
LONG = 1e6
"""Length of a curve in multiples of its range, when points are dropped."""
SAME_LINE = 1e-4
"""Largest distance of a dropped point from the line, as a share of the curve's range."""


def decimate(curves: Sequence[tuple[np.ndarray, np.ndarray]], budget: int) -> list[np.ndarray]:
    """Indices to keep of each curve (time, values), at most about `budget` points in total.

    All points are kept if they fit. Otherwise each curve keeps its two ends and its smallest and largest value.
    """
    kept, bin_samples = [np.arange(len(time)) for time, _ in curves], FINEST_BIN
    while sum(map(len, kept)) > budget and bin_samples < 2 * max(len(time) for time, _ in curves):
        kept = [thinned(time, values, bin_samples) for time, values in curves]
        bin_samples *= 2
    return kept


def at_rate(time: np.ndarray, per_second: float) -> np.ndarray:
    """Indices of so many samples a second of times (sample,) [s], and of the last one."""
    stride = max(1, round((len(time) - 1) / max(float(time[-1] - time[0]) * per_second, 1.0)))
    return np.unique(np.r_[np.arange(0, len(time), stride), len(time) - 1])


def thinned(time: np.ndarray, values: np.ndarray, bin_samples: int) -> np.ndarray:
    """Indices to keep of one curve: extremes of each bin, without those on a straight line."""
    if len(values) < 3:
        return np.arange(len(values))
    found = bin_extremes(values, bin_samples)
    jumps = np.flatnonzero(np.abs(np.diff(values)) > JUMP * float(np.ptp(values)))
    sides = np.zeros(len(values), bool)
    if 4 * len(jumps) <= np.count_nonzero(found):  # more are noise
        sides[jumps] = sides[jumps + 1] = True
    extremes = np.flatnonzero(found | sides)
    keep = sides[extremes]
    # the ends, the smallest and the largest value always stay
    keep[[0, -1, int(np.argmin(values[extremes])), int(np.argmax(values[extremes]))]] = True
    # a time scale so long that the distance from a line is the vertical one
    height = float(np.ptp(values)) or 1.0
    flat = (time[extremes] - time[0]) * (LONG * height / float(time[-1] - time[0]))
    keep_shape(np.column_stack([flat, values[extremes], np.zeros(len(extremes))]), SAME_LINE * height, keep)
    return extremes[keep]


def bin_extremes(values: np.ndarray, bin_samples: int) -> np.ndarray:
    """Mask (sample,) of the smallest and largest value of each bin, and of the first and last sample."""
    table = np.pad(values, (0, -len(values) % bin_samples), mode="edge").reshape(-1, bin_samples)
    start = np.arange(len(table)) * bin_samples
    found = np.zeros(len(values), bool)
    for place in (start + table.argmin(axis=1), start + table.argmax(axis=1), [0, -1]):
        found[place] = True
    return found
