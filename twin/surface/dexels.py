"""Dexels: parallel rays through a solid, each with a list of material intervals, for parts that height rays cannot describe.

Per element and step a swept tool covers one interval [t_in, t_out] of a ray (the lowest entry from each side). It is subtracted from
the ray's list, which may split. Undercuts, through holes and volumes are therefore correct. Lengths in m.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
import math
import os

import numpy as np

from twin.compiled_functions import compiled
from twin.errors import InputError
from twin.surface.removal import CutStatistics, element_entry
from twin.surface.steps import Steps
from twin.surface.sweep import FRUSTUM
from twin.surface.tools import Tool

MOST_INTERVALS = 8
"""Most intervals of one ray."""


@dataclass(frozen=True)
class Dexels:
    """Rays point + t direction: point (ray, 3), direction (3,); intervals (ray, MOST_INTERVALS, 2), the first `count` (ray,) valid.

    `shape` (rows, columns) of the grid, `spacing` [m] of the rays.
    """

    point: np.ndarray
    direction: np.ndarray
    intervals: np.ndarray
    count: np.ndarray
    shape: tuple[int, int]
    spacing: float

    @property
    def volume(self) -> float:
        """Volume [m3]: sum of interval lengths times the area per ray."""
        held = np.arange(self.intervals.shape[1]) < self.count[:, None]
        return float((np.where(held, self.intervals[..., 1] - self.intervals[..., 0], 0.0)).sum()) * self.spacing**2

    @property
    def top(self) -> np.ndarray:
        """Upper end of the material (row, column) [m]; NaN for empty rays."""
        top = np.where(self.count > 0, self.intervals[np.arange(len(self.count)), np.maximum(self.count - 1, 0), 1], np.nan)
        return top.reshape(self.shape)


def box_dexels(low: np.ndarray, high: np.ndarray, spacing: float, *, direction: int = 2) -> Dexels:
    """A block between two corners (3,) [m], with rays along the axis `direction` through the cell centres."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    if np.any(high <= low):
        raise InputError("stock: the upper corner must lie above the lower one in every direction; correct the block")
    a, b = [i for i in range(3) if i != direction]
    counts = [max(1, round((high[i] - low[i]) / spacing)) for i in (a, b)]
    first, second = (low[i] + (np.arange(n) + 0.5) * (high[i] - low[i]) / n for i, n in zip((a, b), counts))
    point = np.zeros((counts[1] * counts[0], 3))
    point[:, a], point[:, b] = np.tile(first, counts[1]), np.repeat(second, counts[0])
    intervals = np.zeros((len(point), MOST_INTERVALS, 2))
    intervals[:, 0] = low[direction], high[direction]
    return Dexels(point, np.eye(3)[direction], intervals, np.ones(len(point), np.int64), (counts[1], counts[0]), spacing)


def mesh_dexels(mesh: object, spacing: float, *, direction: int = 2) -> Dexels:
    """A closed mesh (trimesh, in m) as dexels; material lies between the odd and even crossings of a ray."""
    low, high = np.asarray(mesh.bounds)  # type: ignore[attr-defined]
    dexels = box_dexels(low, high, spacing, direction=direction)
    origin = dexels.point.copy()
    origin[:, direction] = low[direction] - spacing
    where, ray, _ = mesh.ray.intersects_location(origin, np.tile(dexels.direction, (len(origin), 1)), multiple_hits=True)  # type: ignore[attr-defined]
    intervals, count = np.zeros_like(dexels.intervals), np.zeros_like(dexels.count)
    order = np.lexsort((where[:, direction], ray))
    for i, crossings in zip(*_split(ray[order], where[order, direction])):
        # a ray through an edge intersects both of its triangles
        t = crossings[np.concatenate([[True], np.diff(crossings) > 1e-9])]
        pairs = min(len(t) // 2, MOST_INTERVALS)
        intervals[i, :pairs] = t[: 2 * pairs].reshape(pairs, 2)
        count[i] = pairs
    return replace(dexels, intervals=intervals, count=count)


def _split(key: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Sorted unique keys, and the values of each."""
    keys, first = np.unique(key, return_index=True)
    return keys, np.split(value, first[1:])


def cut_dexels(dexels: Dexels, steps: Steps, tool: Tool, *, threads: int | None = None) -> tuple[Dexels, CutStatistics]:
    """The dexels after all steps of the tool. Raises InputError if a ray splits into too many intervals."""
    intervals, count = dexels.intervals.copy(), dexels.count.copy()
    moves = np.ascontiguousarray(np.hstack([steps.tip, steps.way, steps.axis, steps.turn, steps.angle[:, None], steps.rim]))
    tests, full = np.zeros(len(count), np.int64), np.zeros(len(count), np.int64)

    def work(part: np.ndarray) -> None:
        cut_rays(part[0], part[-1] + 1, dexels.point, tuple(dexels.direction), intervals, count, moves, tool.elements, tests, full)

    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        list(pool.map(work, [p for p in np.array_split(np.arange(len(count)), 64) if len(p)]))
    if full.any():
        raise InputError(f"dexels: a ray splits into more than {MOST_INTERVALS} pieces of material; turn the rays (another direction)")
    pairs = len(count) * len(steps) * len(tool.elements)
    return replace(dexels, intervals=intervals, count=count), CutStatistics(pairs, int(tests.sum()))


@compiled(ieee_division=True, allocates=True)
def cut_rays(first, last, point, n, intervals, count, moves, elements, tests, full):  # type: ignore[no-untyped-def]
    """Cut the rays first .. last; updates intervals, count and tests, and sets `full` if a list overflows."""
    back = (-n[0], -n[1], -n[2])
    for i in range(first, last):
        p = (point[i, 0], point[i, 1], point[i, 2])
        for k in range(len(moves)):
            m = moves[k]
            for e in range(len(elements)):
                kind, z0, z1, r, slope = int(elements[e, 0]), elements[e, 1], elements[e, 2], elements[e, 3], elements[e, 4]
                # cull by the distance between the ray and the middle of the element's path
                h = 0.5 * (z0 + z1)
                q = (p[0] - m[0] - 0.5 * m[3] - h * m[6], p[1] - m[1] - 0.5 * m[4] - h * m[7], p[2] - m[2] - 0.5 * m[5] - h * m[8])
                along = q[0] * n[0] + q[1] * n[1] + q[2] * n[2]
                wide = max(r, r + slope * (z1 - z0)) if kind == FRUSTUM else r + slope
                wide = (
                    math.sqrt(wide * wide + 0.25 * (z1 - z0) ** 2)
                    + 0.5 * math.sqrt(m[3] * m[3] + m[4] * m[4] + m[5] * m[5])
                    + abs(z1) * m[12]
                )
                if q[0] * q[0] + q[1] * q[1] + q[2] * q[2] - along * along > wide * wide:
                    continue
                tests[i] += 1
                low = element_entry(kind, p, n, m, z0, z1, r, slope, math.inf)
                if low == math.inf:
                    continue
                high = -element_entry(kind, p, back, m, z0, z1, r, slope, math.inf)
                j = 0
                while j < count[i]:
                    a, b = intervals[i, j, 0], intervals[i, j, 1]
                    if high <= a or low >= b:
                        j += 1
                    elif low <= a and high >= b:
                        for other in range(j, count[i] - 1):
                            intervals[i, other, 0], intervals[i, other, 1] = intervals[i, other + 1, 0], intervals[i, other + 1, 1]
                        count[i] -= 1
                    elif low <= a:
                        intervals[i, j, 0] = high
                        j += 1
                    elif high >= b:
                        intervals[i, j, 1] = low
                        j += 1
                    else:
                        if count[i] == intervals.shape[1]:
                            full[i] = 1
                            return
                        for other in range(count[i], j, -1):
                            intervals[i, other, 0], intervals[i, other, 1] = intervals[i, other - 1, 0], intervals[i, other - 1, 1]
                        intervals[i, j, 1] = low
                        intervals[i, j + 1, 0] = high
                        count[i] += 1
                        j += 2
