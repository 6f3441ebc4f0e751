"""Thin curves out without a visible change.

Each bin keeps the samples of its minimum and maximum at their own times, so no peak is lost or moved. Both samples of a jump are kept,
so a step stays a step. Of the others, points on a line between their neighbours are dropped (within SAME_LINE of the curve's range). If all
curves together still exceed the budget, those with the most points get longer bins.
"""

from __future__ import annotations

from collections.abc import Sequence
import heapq

import numpy as np

from twin.compiled_functions import compiled

FINEST_BIN = 4
"""Length of the shortest bin [samples]."""
JUMP = 0.02
"""A larger change between two samples, as a share of the curve's range, is a jump (unless there are many: then it is noise)."""
SAME_LINE = 1e-4
"""Largest distance of a dropped point from the line, as a share of the curve's range."""


def decimate(curves: Sequence[tuple[np.ndarray, np.ndarray]], budget: int) -> list[np.ndarray]:
    """Indices to keep of each curve (time, values), at most about `budget` points in total.

    All points are kept if they fit. Otherwise each curve keeps its two ends and its smallest and largest value.
    """
    if sum(len(time) for time, _ in curves) <= budget:
        return [np.arange(len(time)) for time, _ in curves]
    bins = [FINEST_BIN] * len(curves)
    kept = [thinned(time, values, FINEST_BIN) for time, values in curves]
    total = sum(map(len, kept))
    fullest = [(-len(k), i) for i, k in enumerate(kept)]
    heapq.heapify(fullest)
    while total > budget and fullest:
        _, i = heapq.heappop(fullest)
        time, values = curves[i]
        if bins[i] >= len(values):
            continue
        bins[i] *= 2
        total -= len(kept[i])
        kept[i] = thinned(time, values, bins[i])
        total += len(kept[i])
        heapq.heappush(fullest, (-len(kept[i]), i))
    return kept


def thinned(time: np.ndarray, values: np.ndarray, bin_samples: int) -> np.ndarray:
    """Indices to keep of one curve: extremes of each bin, without those on a straight line."""
    if len(values) < 3:
        return np.arange(len(values))
    extremes = bin_extremes(values, bin_samples)
    jumps = np.flatnonzero(np.abs(np.diff(values)) > JUMP * float(np.ptp(values)))
    if 4 * len(jumps) > len(extremes):
        jumps = jumps[:0]  # noise
    sides = np.concatenate([jumps, jumps + 1])
    extremes = np.union1d(extremes, sides)
    keep = np.isin(extremes, sides)
    # the ends, the smallest and the largest value always stay
    keep[[0, -1, int(np.argmin(values[extremes])), int(np.argmax(values[extremes]))]] = True
    mark_corners(time[extremes], values[extremes], SAME_LINE * float(np.ptp(values)), keep)
    return extremes[keep]


def bin_extremes(values: np.ndarray, bin_samples: int) -> np.ndarray:
    """Sorted indices of the smallest and largest value of each bin, and of the first and last sample."""
    whole = len(values) // bin_samples * bin_samples
    table = values[:whole].reshape(-1, bin_samples)
    start = np.arange(len(table)) * bin_samples
    found = np.zeros(len(values), bool)
    found[start + table.argmin(axis=1)] = True
    found[start + table.argmax(axis=1)] = True
    if whole < len(values):
        rest = values[whole:]
        found[[whole + int(rest.argmin()), whole + int(rest.argmax())]] = True
    found[[0, -1]] = True
    return np.flatnonzero(found)


@compiled(allocates=True)
def mark_corners(time, values, tolerance, keep):  # type: ignore[no-untyped-def]
    """Mark in `keep` (n,) points whose polyline stays within a tolerance of all others, in one pass.

    Each point narrows a cone of slopes from the last kept point; when the cone closes, the previous point is kept.
    """
    last = 0
    low, high = -np.inf, np.inf
    for i in range(1, len(values)):
        step = time[i] - time[last]
        slope = (values[i] - values[last]) / step
        if (slope < low or slope > high) and i - 1 > last:
            last = i - 1
            keep[last] = True
            low, high = -np.inf, np.inf
            step = time[i] - time[last]
        low = max(low, (values[i] - tolerance - values[last]) / step)
        high = min(high, (values[i] + tolerance - values[last]) / step)
        if keep[i]:
            last = i
            low, high = -np.inf, np.inf
