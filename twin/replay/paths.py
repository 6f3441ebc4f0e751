"""Tool paths in the part frame: programmed, commanded and followed, the followed one coloured by contour error.

The followed path is logged in short pieces along the timeline, each with one colour, so that the tool draws it. Each magnification
of the deviation is a separate path. Paths keep only the points that define their shape.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from twin.geometry.body_poses import IDENTITY, Pose, body_poses, site_pose
from twin.geometry.polyline import keep_shape
from twin.replay.legends import log_colour_bar
from twin.replay.names import TIMELINE
from twin.replay.scene import Scene
from twin.report.colours import ERROR_BANDS, Colour
from twin.units import round_up

MAGNIFICATIONS = (10, 100, 1000)
LEAST_SHOWN = 5e-8
"""A smaller deviation is not magnified: it would show rounding [m]."""
VISIBLE = (0.01, 0.5)
"""Least and largest magnified deviation, as shares of the path's extent."""
PATH_TOLERANCE = 2e-6
"""Largest distance of a dropped point from the drawn path [m], also where the deviation is magnified."""
DRAW_STEP = 0.05
"""Step in which the followed path grows [s]; longer in runs with more than DRAW_STEPS steps."""
DRAW_STEPS = 3000
POINTS_PER_MINUTE = 6000
"""Most points of a path per minute; beyond it the tolerance grows."""
LEAST_POINTS = 2000
LEAST_SCALE = 8e-7
"""Smallest end of the scale [m]; finer bands would show rounding."""


@dataclass(frozen=True)
class ErrorScale:
    """Colour bands of the contour error: equal steps from 0 to `end` [m]; larger errors have the last colour."""

    end: float

    def band(self, error: np.ndarray) -> np.ndarray:
        """Index of the colour of each error (sample,) [m]."""
        return np.minimum((error / self.end * len(ERROR_BANDS)).astype(int), len(ERROR_BANDS) - 1)

    def edges_um(self) -> np.ndarray:
        """Limits of the bands [um]."""
        return np.linspace(0.0, self.end * 1e6, len(ERROR_BANDS) + 1)


def tool_point(scene: Scene, joints: Mapping[str, np.ndarray]) -> tuple[np.ndarray, Pose]:
    """Tool tip (sample, 3) in the part frame [m] and part_from_tool, for joint positions (sample,) by name."""
    bodies = body_poses(scene.model, joints)
    tip = site_pose(scene.model, bodies, scene.tool) if scene.tool >= 0 else bodies[scene.tip_body]
    part = site_pose(scene.model, bodies, scene.part) if scene.part >= 0 else IDENTITY
    pose = part.inverse() @ tip
    count = max((len(values) for values in joints.values()), default=1)
    return np.ascontiguousarray(np.broadcast_to(pose.position, (count, 3))), pose


def tip_in_world(scene: Scene, joints: Mapping[str, np.ndarray]) -> np.ndarray:
    """Tool tip (sample or 1, 3) in the world frame [m]."""
    bodies = body_poses(scene.model, joints)
    tip = site_pose(scene.model, bodies, scene.tool) if scene.tool >= 0 else bodies[scene.tip_body]
    return np.atleast_2d(tip.position)


def magnifications(largest: float, extent: float) -> tuple[int, ...]:
    """1, and those of MAGNIFICATIONS that suit a deviation of up to `largest` [m] on a path of that extent [m].

    The deviation must exceed LEAST_SHOWN and, magnified, lie within VISIBLE.
    """
    low, high = (share * extent for share in VISIBLE)
    return (1, *(f for f in MAGNIFICATIONS if largest >= LEAST_SHOWN and low <= f * largest <= high))


def error_scale(error: np.ndarray) -> ErrorScale:
    """A scale with round bands (1, 2 or 5 times a power of ten) that covers 99.9 % of the errors (sample,) [m]."""
    return ErrorScale(len(ERROR_BANDS) * round_up(max(float(np.quantile(error, 0.999)), LEAST_SCALE) / len(ERROR_BANDS)))


def log_whole_path(
    recording: rr.RecordingStream, path: str, points: np.ndarray, colour: Colour, width: float, duration: float, full: bool
) -> None:
    """Log a path (sample, 3) as a whole, for all times."""
    kept = points[kept_points(points, PATH_TOLERANCE, np.array([], int), duration, full)]
    recording.log(path, rr.LineStrips3D([kept], colors=[colour], radii=rr.Radius.ui_points(width)), static=True)


def log_growing_path(
    recording: rr.RecordingStream,
    path: str,
    time: np.ndarray,
    points: np.ndarray,
    bands: np.ndarray,
    palette: Sequence[Colour],
    **drawn: Any,
) -> None:
    """Log a path (sample, 3) piece by piece on the timeline; `bands` (sample,) are indices into the palette.

    `drawn` has width [points of the screen], full (all samples) and dashed (every other piece).
    """
    width, full = drawn["width"], drawn["full"]
    duration = float(time[-1] - time[0])
    step = max(DRAW_STEP, duration / DRAW_STEPS)
    edges = np.unique(np.searchsorted(time, np.arange(time[0], time[-1] + step, step)).clip(0, len(time) - 1))
    kept = kept_points(points, PATH_TOLERANCE, edges, duration, full)
    if len(kept) < 2:
        return
    # a segment has its worst colour; neighbours of equal colour within a step form one piece
    segment = np.maximum.reduceat(bands, kept[:-1] + 1)
    starts_piece = np.r_[True, (segment[1:] != segment[:-1]) | np.isin(kept[1:-1], edges)]
    first = np.flatnonzero(starts_piece)
    last = np.r_[first[1:], len(segment)]
    if drawn.get("dashed"):
        first, last = first[::2], last[::2]
    strips = [points[kept[a : b + 1]] for a, b in zip(first, last)]
    packed = np.array(palette, np.uint32) @ np.array([1 << 24, 1 << 16, 1 << 8], np.uint32) + np.uint32(0xFF)
    recording.send_columns(
        path, [rr.TimeColumn(TIMELINE, duration=time[kept[last]])], rr.LineStrips3D.columns(strips=strips, colors=packed[segment[first]])
    )
    recording.log(path, rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(width)), static=True)


def kept_points(points: np.ndarray, tolerance: float, fixed: np.ndarray, duration: float, full: bool) -> np.ndarray:
    """Indices of the points that define the shape of a path within a tolerance, and of the `fixed` ones.

    The tolerance doubles until the path has no more points than POINTS_PER_MINUTE allows; `full` keeps all points.
    """
    if full or len(points) < 3:
        return np.arange(len(points))
    most = max(LEAST_POINTS, int(POINTS_PER_MINUTE * duration / 60.0)) + len(fixed)
    while True:
        keep = np.zeros(len(points), bool)
        keep[fixed] = True
        keep_shape(points, tolerance, keep)
        if keep.sum() <= most:
            return np.flatnonzero(keep)
        tolerance *= 2.0


def log_legend(recording: rr.RecordingStream, path: str, scale: ErrorScale, of: str) -> None:
    """Log the colour bar of the contour error."""
    log_colour_bar(recording, path, np.array(ERROR_BANDS), scale.edges_um().tolist(), "um", f"contour error of {of}")
