"""From a tool path to the steps that cut: finer where the path bends between samples, coarser where it is straight.

Between two samples of the recorded axes lies a piece of curve, not a chord: at 10 m/min on a radius of 25 mm the chord of a
millisecond is 0.14 um off. The axes are therefore read from a cubic spline at as many times as the bend asks for, and poses that
the straight motion between their neighbours replaces within the tolerance are left out (slow passes: 50 to one).

Within a step the tip moves on a straight line and the tool axis on the great circle, in sub-steps so small that every point
of the tool moves straight within 5 nm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin.geometry.tool_path import ToolPath

STEP_TOLERANCE = 5e-9
"""How far any point of the tool may be from its recorded way [m]."""
LONGEST_STEP = 1.5e-3
"""Longer steps are divided, so that culling stays tight [m]."""
GAP_LENGTH = 0.05
"""A jump of the tip between two samples above this is a gap in the recording, not a motion [m]."""
LONGEST_PIECE = 512
"""Poses among which the one furthest off is searched for at most."""


@dataclass(frozen=True)
class Steps:
    """Straight motions of a tool: tip (step, 3) and its way, axis (step, 3) and its change; `sample` (step,) is where each comes from.

    `rim` (step, 12) holds two directions across the axis at the start and the same two, carried along, at the end.
    """

    tip: np.ndarray
    way: np.ndarray
    axis: np.ndarray
    turn: np.ndarray
    angle: np.ndarray
    rim: np.ndarray
    sample: np.ndarray

    def __len__(self) -> int:
        return len(self.tip)


def steps_of(path: ToolPath, reach: float, *, tolerance: float = STEP_TOLERANCE, merge: bool = True) -> Steps:
    """Steps of a tool path for a tool whose cutting part reaches `reach` [m] above its tip."""
    keep = np.arange(len(path.tip)) if not merge else kept_poses(path, reach, tolerance)
    return steps_between(path.tip[keep], path.axis[keep], reach, keep, tolerance=tolerance)


def steps_between(
    tip: np.ndarray, axis: np.ndarray, reach: float, sample: np.ndarray | None = None, *, tolerance: float = STEP_TOLERANCE
) -> Steps:
    """Steps between given poses, tip (pose, 3) and unit axis (pose, 3): straight, and on the great circle."""
    tip, axis = np.asarray(tip, float), np.asarray(axis, float)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    sample = np.arange(len(tip)) if sample is None else np.asarray(sample)
    # how many sub-steps: a point at height `reach` bulges by reach angle^2 / 8
    angle = np.arctan2(np.linalg.norm(np.cross(axis[:-1], axis[1:]), axis=1), np.einsum("ij,ij->i", axis[:-1], axis[1:]))
    # rounding alone is no turn
    angle[angle * reach < 1e-12] = 0.0
    finest = np.sqrt(8.0 * tolerance / max(reach, 1e-6))
    parts = np.maximum(np.ceil(angle / finest), np.ceil(np.linalg.norm(np.diff(tip, axis=0), axis=1) / LONGEST_STEP))
    parts = np.maximum(parts, 1).astype(int)
    row = np.repeat(np.arange(len(parts)), parts)
    first = np.concatenate([[0], np.cumsum(parts)[:-1]])
    part = np.arange(len(row)) - first[row]
    begin, end = (part / parts[row])[:, None], ((part + 1) / parts[row])[:, None]
    way = np.diff(tip, axis=0)[row]
    start_axis, end_axis = _slerp(axis, angle, row, begin), _slerp(axis, angle, row, end)
    turn = end_axis - start_axis
    turn[angle[row] == 0.0] = 0.0
    f1, f2 = _across(start_axis)
    rim = np.hstack([f1, f2, _carried(f1, start_axis, end_axis), _carried(f2, start_axis, end_axis)])
    return Steps(tip[row] + begin * way, (end - begin) * way, start_axis, turn, np.linalg.norm(turn, axis=1), rim, sample[row])


def refined_axes(axes: np.ndarray, bend: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Axis positions (sample, axis) read more finely from a cubic spline: `bend` (sample,) [m] is the sagitta of a recorded step.

    Returns the finer positions and where they lie, in samples.
    """
    from scipy.interpolate import CubicSpline

    worst = np.maximum(bend[:-1], bend[1:])
    parts = np.maximum(np.ceil(np.sqrt(worst / tolerance)), 1).astype(int)
    if len(axes) < 4 or parts.max() == 1:
        return axes, np.arange(len(axes), dtype=float)
    row = np.repeat(np.arange(len(parts)), parts)
    first = np.concatenate([[0], np.cumsum(parts)[:-1]])
    at = np.append(row + (np.arange(len(row)) - first[row]) / parts[row], len(axes) - 1.0)
    return CubicSpline(np.arange(len(axes)), axes, axis=0)(at), at


def bend_of(tip: np.ndarray, axis: np.ndarray, reach: float) -> np.ndarray:
    """Sagitta (sample,) of the recorded steps [m], of the tip and of the point `reach` above it."""
    bend = np.zeros(len(tip))
    if len(tip) > 2:
        top = tip + reach * axis
        second = [np.linalg.norm(p[2:] - 2.0 * p[1:-1] + p[:-2], axis=1) / 8.0 for p in (tip, top)]
        bend[1:-1] = np.maximum(*second)
    return bend


def kept_poses(path: ToolPath, reach: float, tolerance: float = STEP_TOLERANCE) -> np.ndarray:
    """Indices of the poses that hold the motion within a tolerance, of the tip and of the point `reach` above it."""
    from twin.geometry.polyline import keep_shape

    keep = np.zeros(len(path.tip), bool)
    keep[::LONGEST_PIECE] = True
    keep_shape(np.hstack([path.tip, path.tip + reach * path.axis]), tolerance, keep)
    return np.flatnonzero(keep)


def _slerp(axis: np.ndarray, angle: np.ndarray, row: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Axes at part s of the great circle from pose `row` to the next one."""
    a, b, turn = axis[row], axis[row + 1], angle[row][:, None]
    sine = np.sin(turn)
    small = turn < 1e-9
    safe = np.where(small, 1.0, sine)
    mixed = np.where(small, a, (np.sin((1.0 - s) * turn) * a + np.sin(s * turn) * b) / safe)
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


def _across(axis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit directions across each axis."""
    other = np.where(np.abs(axis[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    f1 = np.cross(axis, other)
    f1 /= np.linalg.norm(f1, axis=1, keepdims=True)
    return f1, np.cross(axis, f1)


def _carried(v: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Directions v turned by the shortest rotation from a to b."""
    cross = np.cross(a, b)
    cos = np.einsum("ij,ij->i", a, b)[:, None]
    return v * cos + np.cross(cross, v) + cross * (np.einsum("ij,ij->i", cross, v)[:, None] / (1.0 + cos))
