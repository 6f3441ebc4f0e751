"""Tool paths: tool poses in the part frame from axis positions, and the deviation of one path from another.

followed axes    -> workpiece_from_tool (twin.geometry.kinematics) -> followed path
set points       -> workpiece_from_tool                            -> commanded path (output of the interpolator)
program          -> block by block                                 -> programmed path

Most of the following error is a delay; the part is affected by the distance between the curves. For each point p(t) of a path, n is
the nearest point on the reference path among its segments from t - W to t + W. The window avoids false matches on paths that cross or
repeat themselves.

contour error = |p - n|,   orientation error = angle between the tool axis and the reference's at the nearest pose

Points are (sample, 3) in the part frame [m], tool axes (sample, 3) unit vectors from tip to spindle, angles in rad.
"""

from dataclasses import dataclass
import math

import numpy as np

from twin.compiled_functions import compiled
from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.machine.machine import Machine
from twin.recordings.trace import Trace

SHORTEST_WINDOW = 0.1
"""Least search window before and after a sample [s]."""
ARM = 0.1
"""Lever arm that converts an angle into a length when poses are compared [m]."""
COARSE = 4
"""Vertices of a window that are tried first, to bound the distance."""
LAGS = 4.0
"""Search window as a multiple of the lag 1 / Kv of the slowest position controller."""


@dataclass(frozen=True)
class ToolPath:
    """Tool poses in the part frame: time (sample,) [s], tip (sample, 3) [m], axis (sample, 3)."""

    time: np.ndarray
    tip: np.ndarray
    axis: np.ndarray

    def __len__(self) -> int:
        return len(self.time)

    @property
    def length(self) -> np.ndarray:
        """Length of the path up to each sample (sample,) [m]."""
        return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.tip, axis=0), axis=1))])

    @property
    def feed(self) -> np.ndarray:
        """Speed of the tip (sample,) [m/s]."""
        if len(self.time) < 2:
            return np.zeros(len(self.time))
        return np.linalg.norm(np.gradient(self.tip, self.time, axis=0), axis=1)


@dataclass(frozen=True)
class Contour:
    """Distance of points from a reference (sample,) [m], and the nearest reference points (sample, 3) [m]."""

    error: np.ndarray
    nearest: np.ndarray

    def magnified(self, followed: np.ndarray, factor: float) -> np.ndarray:
        """The path (sample, 3) with its deviation from the reference multiplied by a factor."""
        return self.nearest + factor * (followed - self.nearest)


@dataclass(frozen=True)
class ContourError(Contour):
    """Contour error, with the angle (sample,) [rad] between the tool axes."""

    orientation: np.ndarray


def path_of_axes(kinematics: Kinematics, axes: np.ndarray, time: np.ndarray) -> ToolPath:
    """Tool path of axis positions (sample, 5) in the order X Y Z A C [m, rad], computed in parts to limit the memory."""
    tips, directions = [], []
    for part in np.array_split(axes, max(1, len(axes) // 50_000)):
        tip, direction = kinematics.forward(part)
        tips.append(tip)
        directions.append(direction)
    return ToolPath(np.asarray(time, float), np.concatenate(tips), np.concatenate(directions))


def axes_of_trace(trace: Trace, signal: str, machine: Machine) -> np.ndarray:
    """Axis positions (sample, 5) of a trace. A missing axis is at 0, or at the nearest end of its travel."""
    columns = []
    for name in kinematics_of(machine).names:
        if trace.has(name, signal):
            columns.append(trace.get(name, signal))
        elif name in trace.axes:
            raise InputError(f"trace: axis {name} has no {signal}; record it, or cut the set points (--level commanded)")
        else:
            low, high = machine.axis(name).travel if name in machine.axis_names else (-np.inf, np.inf)
            columns.append(np.full(len(trace.time), np.clip(0.0, low, high)))
    return np.column_stack(columns)


def tool_path_of(trace: Trace, signal: str, machine: Machine, *, kinematics: Kinematics | None = None) -> ToolPath:
    """Tool path of one signal of a trace: `setpoint` gives the commanded path, `position` the followed one."""
    return path_of_axes(kinematics or kinematics_of(machine), axes_of_trace(trace, signal, machine), trace.time)


def search_window(machine: Machine) -> float:
    """The nearest reference point of a sample is searched within this time [s] around it."""
    gains = [axis.loops.position_gain_per_s for axis in machine.axes if axis.loops.position_gain_per_s > 0]
    return max(SHORTEST_WINDOW, LAGS / min(gains)) if gains else SHORTEST_WINDOW


def contour_of(
    time: np.ndarray, followed: np.ndarray, reference_time: np.ndarray, reference: np.ndarray, window: float = SHORTEST_WINDOW
) -> Contour:
    """Contour error of points (sample, 3) relative to a path (point, 3) with its own times."""
    return _nearest(followed, reference, *_searched(time, reference_time, window))[0]


def contour_error(path: ToolPath, reference: ToolPath, window: float | None = SHORTEST_WINDOW) -> ContourError:
    """Contour and orientation error of a path relative to a reference with its own times.

    `window` [s] limits the search in time. None searches the whole reference, for a program without times; the cost grows with the
    product of both lengths.
    """
    last = len(reference) - 1
    if not len(path) or not len(reference):
        raise InputError("tool path: no sample to compare; give a path and a reference with at least one pose each")
    low, high = _searched(path.time, reference.time, math.inf if window is None else window)
    contour, _ = _nearest(path.tip, reference.tip, low, high)
    # where the tool turns about its tip, only the tool axis moves along the path: it counts as a point at height ARM
    poses = [np.hstack([p.tip, ARM * p.axis]) for p in (path, reference)]
    _, where = _nearest(poses[0], poses[1], low, high)
    row = np.minimum(where.astype(int), max(last - 1, 0))
    part = (where - row)[:, None]
    there = (1.0 - part) * reference.axis[row] + part * reference.axis[np.minimum(row + 1, last)]
    there /= np.linalg.norm(there, axis=1, keepdims=True)
    angle = np.arctan2(np.linalg.norm(np.cross(path.axis, there), axis=1), np.einsum("ij,ij->i", path.axis, there))
    return ContourError(contour.error, contour.nearest, angle)


def nearest_along(
    points: np.ndarray, path: np.ndarray, length: np.ndarray, place: np.ndarray | None, back: float, ahead: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distance of points (n, 3) to a path (m, 3) and the length (n,) of the path up to the nearest places; `length` (m,) is that of its points.

    Each is searched between place - back and place + ahead along the path; without `place` (n,) about the nearest place of the point before.
    """
    low, high = np.full(len(points), -1), np.zeros(len(points), int)
    if place is not None:
        low = np.clip(np.searchsorted(length, place - back, side="right") - 1, 0, len(path) - 2)
        high = np.clip(np.searchsorted(length, place + ahead), 1, len(path) - 1)
    contour, where = _nearest(points, path, low, high, back, ahead)
    return contour.error, np.interp(where, np.arange(len(path)), length)


def _searched(time: np.ndarray, reference_time: np.ndarray, window: float) -> tuple[np.ndarray, np.ndarray]:
    """First and last reference point (sample,) within a window [s] around each sample."""
    last = len(reference_time) - 1
    low = np.clip(np.searchsorted(reference_time, time - window, side="left"), 0, max(last - 1, 0))
    return low, np.clip(np.searchsorted(reference_time, time + window, side="right") - 1, min(1, last), last)


def _nearest(
    points: np.ndarray, path: np.ndarray, low: np.ndarray, high: np.ndarray, back: float = 0.0, ahead: float = 0.0
) -> tuple[Contour, np.ndarray]:
    """Contour of points (n, k) relative to a path (m, k), and the places along it (n,) in samples."""
    nearest, distance, where = np.empty_like(points), np.empty(len(points)), np.empty(len(points))
    find_nearest(np.ascontiguousarray(points), np.ascontiguousarray(path), low, high, back, ahead, nearest, distance, where)
    return Contour(distance, nearest), where


@compiled(allocates=True)
def find_nearest(points, path, low, high, back, ahead, nearest, distance, where):  # type: ignore[no-untyped-def]
    """Nearest point on segments low[i] to high[i] of the path (m, k), for each point i of (n, k).

    Where low[i] < 0: on those from `back` before to `ahead` behind the nearest point of the point before.
    Fills nearest (n, k), distance (n,) and where (n,), the place along the path in samples.
    """
    way = np.zeros(len(path) + 1)
    for j in range(len(path) - 1):
        square = 0.0
        for c in range(path.shape[1]):
            square += (path[j + 1, c] - path[j, c]) ** 2
        way[j + 1] = way[j] + math.sqrt(square)
    way[len(path)] = way[len(path) - 1]
    guess = 0
    for i in range(len(points)):
        first, last = low[i], max(high[i], low[i] + 1)
        if first < 0:
            at = way[guess] + (where[i - 1] - guess) * (way[guess + 1] - way[guess]) if i else 0.0
            first = last = guess
            while first > 0 and way[first] > at - back:
                first -= 1
            while last < len(path) - 1 and (way[last] < at + ahead or last == first):
                last += 1
        # bound the distance by a few vertices of the window and by the last result
        reach = np.inf
        for m in range(COARSE + 1):
            j = min(max(guess, first), last) if m == COARSE else first + m * (last - first) // COARSE
            j = min(j, len(path) - 1)
            square = 0.0
            for c in range(points.shape[1]):
                square += (points[i, c] - path[j, c]) ** 2
            reach = min(reach, square)
        reach = math.sqrt(reach) * (1.0 + 1e-9) + 1e-12
        best = np.inf
        j = first - 1
        while j + 1 < last:
            j += 1
            k = min(j + 1, len(path) - 1)
            length = 0.0
            along = 0.0
            square = 0.0
            for c in range(points.shape[1]):
                a = points[i, c] - path[j, c]
                b = path[k, c] - path[j, c]
                square += a * a
                length += b * b
                along += a * b
            # the path approaches by at most its own length: skip segments that cannot come within the bound
            if square > reach * reach:
                free = way[j] + math.sqrt(square) - reach
                if way[k] < free:
                    while j < last and way[j + 1] < free:
                        j += 1
                    j -= 1
                    continue
            part = min(1.0, max(0.0, along / length)) if length > 0.0 else 0.0
            square = 0.0
            for c in range(points.shape[1]):
                square += (points[i, c] - path[j, c] - part * (path[k, c] - path[j, c])) ** 2
            if square < best:
                best = square
                where[i] = j + part
        guess = int(where[i])
        j = min(int(where[i]), len(path) - 1)
        k = min(j + 1, len(path) - 1)
        for c in range(points.shape[1]):
            nearest[i, c] = path[j, c] + (where[i] - j) * (path[k, c] - path[j, c])
        distance[i] = np.sqrt(best)


@compiled(allocates=True)
def keep_shape(points, tolerance, keep):  # type: ignore[no-untyped-def]
    """Mark in `keep` (n,) the rows of `points` (n, 3 k) that represent the paths of k points within a tolerance.

    A row may be dropped if one common fraction of the straight move between the neighbouring kept rows brings all k points within the
    tolerance. Rows already marked stay and split the problem, which bounds the search.
    """
    n, columns = points.shape
    keep[0] = True
    keep[n - 1] = True
    stack = [(0, 0)]
    stack.pop()
    before = 0
    for i in range(1, n):
        if keep[i]:
            stack.append((before, i))
            before = i
    while len(stack) > 0:
        first, last = stack.pop()
        length = 0.0
        for c in range(columns):
            length += (points[last, c] - points[first, c]) ** 2
        worst = tolerance * tolerance
        at = -1
        for i in range(first + 1, last):
            part = 0.0
            if length > 0.0:
                for c in range(columns):
                    part += (points[i, c] - points[first, c]) * (points[last, c] - points[first, c])
                part = min(1.0, max(0.0, part / length))
            for start in range(0, columns, 3):
                square = 0.0
                for c in range(start, start + 3):
                    square += (points[i, c] - points[first, c] - part * (points[last, c] - points[first, c])) ** 2
                if square > worst:
                    worst = square
                    at = i
        if at >= 0:
            keep[at] = True
            stack.append((first, at))
            stack.append((at, last))
