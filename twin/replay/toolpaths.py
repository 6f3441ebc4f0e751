"""The tool paths of runs and their views in the part frame, true to scale and with magnified deviation.

The followed path is coloured by contour error and logged in short pieces along the timeline, so that the tool draws it. Each magnification
of the deviation is a separate path. Paths keep only the points that define their shape.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr

from twin.geometry.body_poses import IDENTITY, body_poses, site_pose
from twin.geometry.tool_path import Contour, contour_of, keep_shape, search_window
from twin.machine.machine import Machine
from twin.recordings.trace import POSITIONS, Trace
from twin.replay.blueprint import PathView
from twin.replay.curves import PlotLine
from twin.replay.decimate import at_rate
from twin.replay.legends import log_colour_bar
from twin.replay.names import TIMELINE, axis_entity, entity
from twin.replay.scene import Scene
from twin.report.colours import ERROR_BANDS, PROGRAM_COLOUR, Colour, axis_colour, mixed
from twin.units import AXIS_UNITS, round_up

SECOND_RUN_COLOUR = (190, 70, 190)
MARKS_PER_SECOND = 25.0
SHORTEST_PATH = 1e-4
"""A shorter tool path is not drawn [m]."""
MAGNIFICATIONS = (10, 100, 1000)
LEAST_SHOWN = 5e-8
"""A smaller deviation is not magnified: it would show rounding [m]."""
VISIBLE = (0.01, 0.5)
"""Least and largest magnified deviation, as shares of the path's extent."""
PATH_TOLERANCE = 2e-6
"""Largest distance of a dropped point from the drawn path [m], also where the deviation is magnified."""
DRAW_STEP = 0.05
"""Growth step of the followed path [s]; longer in runs with more than DRAW_STEPS steps."""
DRAW_STEPS = 3000
POINTS_PER_MINUTE = 6000
"""Most points of a path per minute; beyond it the tolerance grows."""
LEAST_POINTS = 2000
LEAST_SCALE = 8e-7
"""Smallest end of the scale [m]; finer bands would show rounding."""


def tool_point(scene: Scene, joints: Mapping[str, np.ndarray], frame: int | None = None) -> np.ndarray:
    """Tool tip (sample, 3) [m] in the part frame, or that of another site (-1: the world), for joint positions (sample,) by name."""
    bodies = body_poses(scene.model, joints)
    site = scene.part if frame is None else frame
    tip = site_pose(scene.model, bodies, scene.tool) if scene.tool >= 0 else bodies[scene.tip_body]
    pose = (site_pose(scene.model, bodies, site) if site >= 0 else IDENTITY).inverse() @ tip
    count = max((len(values) for values in joints.values()), default=1)
    return np.ascontiguousarray(np.broadcast_to(pose.position, (count, 3)))


def magnifications(largest: float, extent: float) -> tuple[int, ...]:
    """1, and those of MAGNIFICATIONS that suit a deviation of up to `largest` [m] on a path of that extent [m].

    The deviation must exceed LEAST_SHOWN and, magnified, lie within VISIBLE.
    """
    low, high = (share * extent for share in VISIBLE)
    return (1, *(f for f in MAGNIFICATIONS if largest >= LEAST_SHOWN and low <= f * largest <= high))


def end_of_scale(error: np.ndarray) -> float:
    """End [m] of a scale with round bands (1, 2 or 5 times a power of ten) that covers 99.9 % of the errors (sample,) [m]."""
    return len(ERROR_BANDS) * round_up(max(float(np.quantile(error, 0.999)), LEAST_SCALE) / len(ERROR_BANDS))


def bands_of(error: np.ndarray, end: float) -> np.ndarray:
    """Index of the colour of each error (sample,) [m]: equal bands from 0 to `end` [m]; larger errors have the last colour."""
    return np.minimum((error / end * len(ERROR_BANDS)).astype(int), len(ERROR_BANDS) - 1)


def log_whole_path(
    recording: rr.RecordingStream, path: str, points: np.ndarray, colour: Colour, width: float, duration: float, full: bool
) -> None:
    """Log a path (sample, 3) as a whole, for all times."""
    kept = points[kept_points(points, PATH_TOLERANCE, np.array([], int), duration, full)]
    recording.log(path, rr.LineStrips3D([kept], colors=[colour], radii=rr.Radius.ui_points(width)), static=True)


def log_growing_path(
    recording: rr.RecordingStream, path: str, time: np.ndarray, points: np.ndarray, bands: np.ndarray | None, full: bool
) -> None:
    """Log a path (sample, 3) piece by piece on the timeline, in the colours of its `bands` (sample,); None: a second run, thin and dashed."""
    palette, width = (ERROR_BANDS, 2.5) if bands is not None else ((SECOND_RUN_COLOUR,), 1.5)
    duration = float(time[-1] - time[0])
    step = max(DRAW_STEP, duration / DRAW_STEPS)
    edges = np.unique(np.searchsorted(time, np.arange(time[0], time[-1] + step, step)).clip(0, len(time) - 1))
    kept = kept_points(points, PATH_TOLERANCE, edges, duration, full)
    if len(kept) < 2:
        return
    # a segment has its worst colour; neighbours of equal colour within a step form one piece
    segment = np.zeros(len(kept) - 1, int) if bands is None else np.maximum.reduceat(bands, kept[:-1] + 1)
    starts_piece = np.r_[True, (segment[1:] != segment[:-1]) | np.isin(kept[1:-1], edges)]
    first = np.flatnonzero(starts_piece)
    last = np.r_[first[1:], len(segment)]
    if bands is None:
        first, last = first[::2], last[::2]
    strips = [points[kept[a : b + 1]] for a, b in zip(first, last)]
    drawn = rr.LineStrips3D.columns(strips=strips, colors=np.array(palette, np.uint8)[segment[first]])
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=time[kept[last]])], drawn)
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


@dataclass(frozen=True)
class ToolPaths:
    """Tool points in the part frame (sample, 3) [m]: commanded, and followed by each run; `end` [m] of the scale of the contour error."""

    commanded: np.ndarray
    followed: Mapping[str, np.ndarray]
    times: Mapping[str, np.ndarray]
    contours: Mapping[str, Contour]
    end: float = 0.0
    magnifications: tuple[int, ...] = (1,)
    """1 and the factors that make the deviation visible."""


def followed_joints(trace: Trace) -> dict[str, np.ndarray]:
    """Position of each axis (sample,): position, else motor position, else set point."""
    joints = {}
    for axis in trace.axes:
        signal = trace.measured_position(axis) or "setpoint"
        if trace.has(axis, signal):
            joints[axis] = trace.get(axis, signal)
    return joints


def commanded_joints(trace: Trace) -> dict[str, np.ndarray]:
    """Set point of each axis (sample,), else its position."""
    return {axis: trace.get(axis, "setpoint") if trace.has(axis, "setpoint") else values for axis, values in followed_joints(trace).items()}


def tool_paths_of(scene: Scene, machine: Machine, runs: Mapping[str, Trace]) -> ToolPaths | None:
    """Tool paths and contour errors of the runs; None if the tool does not move.

    The tool is the site `tool` of the model, else the end of its longest chain of joints. Without a site `workpiece` the paths are drawn
    in the world.
    """
    main = next(iter(runs.values()))
    if not any(main.has(axis, s) for axis in main.axes for s in POSITIONS):
        return None
    commanded = tool_point(scene, commanded_joints(main))
    if np.linalg.norm(np.ptp(commanded, axis=0)) < SHORTEST_PATH:
        return None
    window = search_window(machine)
    followed = {label: tool_point(scene, followed_joints(trace)) for label, trace in runs.items()}
    contours = {}
    for label, points in followed.items():
        # a run without set points is compared with those of the first
        trace = runs[label] if any(signal == "setpoint" for _, signal in runs[label].signals) else main
        asked = commanded if trace is main else tool_point(scene, commanded_joints(trace))
        contours[label] = contour_of(runs[label].time, points, trace.time, asked, window)
    return alike(ToolPaths(commanded, followed, {label: trace.time for label, trace in runs.items()}, contours))[0]


def alike(*several: ToolPaths) -> list[ToolPaths]:
    """The paths with one scale, that of the largest error of a first run, and the magnifications that suit all of them."""
    end = max(end_of_scale(next(iter(paths.contours.values())).error) for paths in several)
    largest = max(float(contour.error.max()) for paths in several for contour in paths.contours.values())
    extent = max(float(np.linalg.norm(np.ptp(paths.commanded, axis=0))) for paths in several)
    return [replace(paths, end=end, magnifications=magnifications(largest, extent)) for paths in several]


def log_tool_paths(recording: rr.RecordingStream, scene: Scene, paths: ToolPaths, full: bool = False) -> tuple[PathView, ...]:
    """Log all paths below the part frame, one branch per magnification, and the colour bar. Returns their views."""
    views = []
    reference, main = paths.commanded, next(iter(paths.times.values()))
    for factor in paths.magnifications:
        root = entity(scene.part_path, f"path_x{factor}")
        low, high = reference.min(axis=0), reference.max(axis=0)
        log_whole_path(recording, entity(root, "programmed"), reference, PROGRAM_COLOUR, 1.0, float(main[-1] - main[0]), full)
        growing = []
        for order, (label, followed) in enumerate(paths.followed.items()):
            contour = paths.contours[label]
            drawn = followed if factor == 1 else contour.magnified(followed, factor)
            low, high = np.minimum(low, drawn.min(axis=0)), np.maximum(high, drawn.max(axis=0))
            growing.append(entity(root, "followed", label))
            bands = bands_of(contour.error, paths.end) if order == 0 else None
            log_growing_path(recording, growing[-1], paths.times[label], drawn, bands, full)
            if order == 0:
                log_tool_point(recording, entity(root, "tool_point"), paths.times[label], drawn)
        title = f"Tool path, deviation x{factor}" if factor > 1 else "At the part"
        views.append(PathView(title, root, tuple(growing), np.array([low, high])))
    edges = np.linspace(0.0, paths.end * 1e6, len(ERROR_BANDS) + 1)
    log_colour_bar(recording, np.array(ERROR_BANDS), edges.tolist(), f"contour error of {next(iter(paths.followed))}")
    return tuple(views)


def log_tip_path(
    recording: rr.RecordingStream, scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray], full: bool
) -> tuple[PathView, ...]:
    """Log the path of the tip of any scene in the part frame or the world. Returns its view."""
    points = tool_point(scene, joints)
    root = entity(scene.part_path, "path_x1")
    path = entity(root, "followed", "motion")
    log_growing_path(recording, path, time, points, np.zeros(len(time), int), full)
    log_tool_point(recording, entity(root, "tool_point"), time, points)
    return (PathView("At the tip: machine and path", root, (path,), np.array([points.min(axis=0), points.max(axis=0)])),)


def motion_curves(scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray]) -> list[PlotLine]:
    """Position and speed of each joint, in the units of slides and hinges."""
    curves = []
    for order, (name, values) in enumerate(joints.items()):
        units = AXIS_UNITS[scene.joints[name]]
        for group, own, (unit, factor) in (("position", values, units.position), ("speed", np.gradient(values, time), units.speed)):
            path = axis_entity(name, group, "motion")
            curves.append(PlotLine(path, f"{name} {group} [{unit}]", axis_colour(name, order), time, own * factor))
    return curves


def log_tool_point(recording: rr.RecordingStream, path: str, time: np.ndarray, points: np.ndarray) -> None:
    """Log the tool point as a moving dot."""
    steps = at_rate(time, MARKS_PER_SECOND)
    recording.log(path, rr.Points3D.from_fields(radii=rr.Radius.ui_points(6.0), colors=[mixed((0, 0, 0), 0.1)]), static=True)
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=time[steps])], rr.Points3D.columns(positions=points[steps]))
