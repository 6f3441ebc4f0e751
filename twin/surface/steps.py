"""From a tool path to cutting steps: finer where the path curves, coarser where it is straight.

A chord between two samples is not accurate enough: at 10 m/min on a radius of 25 mm the chord of a millisecond is off by 0.14 um. The
axes are therefore interpolated by a cubic spline as finely as the curvature requires, and poses that linear motion between their
neighbours reproduces within the tolerance are dropped (slow passes: 50 to one).

Within a step the tip moves on a straight line and the tool axis on a great circle. Steps are short enough for every point of the tool
to deviate from a straight line by less than 5 nm.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from twin.geometry.kinematics import great_circle
from twin.geometry.tool_path import ToolPath, keep_shape

STEP_TOLERANCE = 5e-9
"""Largest deviation of any point of the tool from its recorded path [m]."""
LONGEST_STEP = 1.5e-3
"""Longer steps are divided to keep culling effective [m]."""
GAP_LENGTH = 0.05
"""Above this distance of the tip between two samples the recording has a gap [m]."""
LONGEST_PIECE = 512
"""Most poses in one search for the largest deviation."""


@dataclass(frozen=True)
class Steps:
    """Straight motions of a tool: tip (step, 3) and its displacement `way`, axis (step, 3) and its change `turn`; `sample` (step,) of the path.

    `rim` (step, 12) holds two directions perpendicular to the axis at the start, and the same two carried along to the end.
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


def steps_of(path: ToolPath, reach: float) -> Steps:
    """Steps between the poses of a tool path that reproduce the motion of the tip, and of the point `reach` [m] above it, within the tolerance."""
    keep = np.zeros(len(path.tip), bool)
    keep[::LONGEST_PIECE] = True
    keep_shape(np.hstack([path.tip, path.tip + reach * path.axis]), STEP_TOLERANCE, keep)
    return steps_between(path.tip[keep], path.axis[keep], reach, np.flatnonzero(keep))


def steps_between(
    tip: np.ndarray, axis: np.ndarray, reach: float, sample: np.ndarray | None = None, *, tolerance: float = STEP_TOLERANCE
) -> Steps:
    """Steps between poses, tip (pose, 3) and axis (pose, 3): the tip on a straight line, the axis on a great circle."""
    tip, axis = np.asarray(tip, float), np.asarray(axis, float)
    axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
    sample = np.arange(len(tip)) if sample is None else np.asarray(sample)
    # number of sub-steps: a point at height `reach` deviates by reach angle^2 / 8
    angle = np.arctan2(np.linalg.norm(np.cross(axis[:-1], axis[1:]), axis=1), np.einsum("ij,ij->i", axis[:-1], axis[1:]))
    # ignore rotations within rounding
    angle[angle * reach < 1e-12] = 0.0
    finest = np.sqrt(8.0 * tolerance / max(reach, 1e-6))
    parts = np.maximum(np.ceil(angle / finest), np.ceil(np.linalg.norm(np.diff(tip, axis=0), axis=1) / LONGEST_STEP))
    parts = np.maximum(parts, 1).astype(int)
    row, part = _divided(parts)
    begin, end = (part / parts[row])[:, None], ((part + 1) / parts[row])[:, None]
    way = np.diff(tip, axis=0)[row]
    start_axis, end_axis = (great_circle(axis[row], axis[row + 1], angle[row][:, None], share) for share in (begin, end))
    turn = end_axis - start_axis
    turn[angle[row] == 0.0] = 0.0
    # two unit directions across the axis
    f1 = np.cross(start_axis, np.where(np.abs(start_axis[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    f1 /= np.linalg.norm(f1, axis=1, keepdims=True)
    f2 = np.cross(start_axis, f1)
    rim = np.hstack([f1, f2, _carried(f1, start_axis, end_axis), _carried(f2, start_axis, end_axis)])
    return Steps(tip[row] + begin * way, (end - begin) * way, start_axis, turn, np.linalg.norm(turn, axis=1), rim, sample[row])


def refined_axes(axes: np.ndarray, path: ToolPath, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Axis positions (sample, axis) resampled by a cubic spline, as finely as the tip and the point `reach` [m] above it bend along their path.

    Returns the finer positions and their places in samples.
    """
    bend = np.zeros(len(axes))  # sagitta of the recorded steps [m]
    if len(axes) > 3:
        second = [np.linalg.norm(p[2:] - 2.0 * p[1:-1] + p[:-2], axis=1) / 8.0 for p in (path.tip, path.tip + reach * path.axis)]
        bend[1:-1] = np.maximum(*second)
    parts = np.maximum(np.ceil(np.sqrt(np.maximum(bend[:-1], bend[1:]) / STEP_TOLERANCE)), 1).astype(int)
    if parts.max(initial=1) == 1:
        return axes, np.arange(len(axes), dtype=float)
    row, part = _divided(parts)
    at = np.append(row + part / parts[row], len(axes) - 1.0)
    return CubicSpline(np.arange(len(axes)), axes, axis=0)(at), at


def _divided(parts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row and number within it of each part (part,), for rows that are divided into so many parts (row,)."""
    row = np.repeat(np.arange(len(parts)), parts)
    return row, np.arange(len(row)) - (np.cumsum(parts) - parts)[row]


def _carried(v: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Directions v rotated by the shortest rotation from a to b."""
    cross = np.cross(a, b)
    cos = np.einsum("ij,ij->i", a, b)[:, None]
    return v * cos + np.cross(cross, v) + cross * (np.einsum("ij,ij->i", cross, v)[:, None] / (1.0 + cos))
