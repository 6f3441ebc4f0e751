"""Contour error: how far the followed tool point lies from the path that it should follow, whatever its delay.

For each followed point p(t) the nearest point n on the reference path is sought among the segments of the times t - W .. t + W,
so that a path that crosses itself does not confuse neighbours:

    contour error = |p - n|,    magnified path = n + M (p - n)

Points are (sample, 3) in the part frame [m]. A compiled loop, since a minute has 60 000 points with 200 segments each.
"""

from __future__ import annotations

from dataclasses import dataclass

from numba import njit
import numpy as np

from twin.machine import Machine

SHORTEST_WINDOW = 0.1
"""Seconds before and after that are searched at least."""
LAGS = 4.0
"""The window is this many times the lag 1 / Kv of the slowest position controller: beyond it an axis is not following."""


@dataclass(frozen=True)
class Contour:
    """Contour error (sample,) [m] and the nearest points of the reference path (sample, 3) [m]."""

    error: np.ndarray
    nearest: np.ndarray

    def magnified(self, followed: np.ndarray, factor: float) -> np.ndarray:
        """The followed path (sample, 3) with its deviation from the reference magnified."""
        return self.nearest + factor * (followed - self.nearest)


def contour_of(
    time: np.ndarray, followed: np.ndarray, reference_time: np.ndarray, reference: np.ndarray, window: float = SHORTEST_WINDOW
) -> Contour:
    """Contour error of a followed path (sample, 3) against a reference path (point, 3) with times of their own."""
    low = np.searchsorted(reference_time, time - window, side="left")
    high = np.searchsorted(reference_time, time + window, side="right") - 1
    last = len(reference) - 1
    low, high = np.clip(low, 0, max(last - 1, 0)), np.clip(high, min(1, last), last)
    nearest = np.empty_like(followed)
    distance = np.empty(len(followed))
    find_nearest(np.ascontiguousarray(followed), np.ascontiguousarray(reference), low, high, nearest, distance)
    return Contour(distance, nearest)


def search_window(machine: Machine) -> float:
    """Seconds around a sample in which its nearest reference point is sought."""
    gains = [axis.loops.position_gain_per_s for axis in machine.axes if axis.loops.position_gain_per_s > 0]
    return max(SHORTEST_WINDOW, LAGS / min(gains)) if gains else SHORTEST_WINDOW


@njit(cache=True, nogil=True)
def find_nearest(points, path, low, high, nearest, distance):  # type: ignore[no-untyped-def]
    """Nearest point on segments low[i] .. high[i] of the path, for each point i; fills nearest (n, 3) and distance (n,)."""
    for i in range(len(points)):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        best = np.inf
        for j in range(low[i], max(high[i], low[i] + 1)):
            ax, ay, az = path[j, 0], path[j, 1], path[j, 2]
            k = min(j + 1, len(path) - 1)
            bx, by, bz = path[k, 0] - ax, path[k, 1] - ay, path[k, 2] - az
            length = bx * bx + by * by + bz * bz
            part = 0.0
            if length > 0.0:
                part = min(1.0, max(0.0, ((px - ax) * bx + (py - ay) * by + (pz - az) * bz) / length))
            qx, qy, qz = ax + part * bx, ay + part * by, az + part * bz
            square = (px - qx) ** 2 + (py - qy) ** 2 + (pz - qz) ** 2
            if square < best:
                best = square
                nearest[i, 0], nearest[i, 1], nearest[i, 2] = qx, qy, qz
        distance[i] = np.sqrt(best)


@njit(cache=True, nogil=True)
def keep_shape(points, tolerance, keep):  # type: ignore[no-untyped-def]
    """Mark in `keep` (n,) the points of a path (n, 3) that hold its shape within a tolerance (Douglas and Peucker).

    Points already marked stay and split the work.
    """
    stack = [(0, 0)]
    stack.pop()
    n = len(points)
    keep[0] = True
    keep[n - 1] = True
    before = 0
    for i in range(1, n):
        if keep[i]:
            stack.append((before, i))
            before = i
    while len(stack) > 0:
        first, last = stack.pop()
        ax, ay, az = points[first, 0], points[first, 1], points[first, 2]
        bx, by, bz = points[last, 0] - ax, points[last, 1] - ay, points[last, 2] - az
        length = bx * bx + by * by + bz * bz
        worst = tolerance * tolerance
        at = -1
        for i in range(first + 1, last):
            x, y, z = points[i, 0] - ax, points[i, 1] - ay, points[i, 2] - az
            part = 0.0
            if length > 0.0:
                part = min(1.0, max(0.0, (x * bx + y * by + z * bz) / length))
            square = (x - part * bx) ** 2 + (y - part * by) ** 2 + (z - part * bz) ** 2
            if square > worst:
                worst = square
                at = i
        if at >= 0:
            keep[at] = True
            stack.append((first, at))
            stack.append((at, last))
