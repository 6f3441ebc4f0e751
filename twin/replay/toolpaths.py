"""The tool paths of runs and their views, true to scale and with magnified deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import rerun as rr

from twin.geometry.tool_path import Contour, contour_of, search_window
from twin.machine.machine import Machine
from twin.recordings.trace import POSITIONS, Trace
from twin.replay.blueprint import PathView
from twin.replay.curves import Curve
from twin.replay.names import LEGEND, TIMELINE, axis_entity, entity
from twin.replay.paths import ErrorScale, error_scale, log_growing_path, log_legend, log_whole_path, magnifications, tool_point
from twin.replay.scene import Scene
from twin.report.colours import ERROR_BANDS, PROGRAM_COLOUR, SETPOINT_COLOUR, axis_colour, lighter
from twin.units import AXIS_UNITS

SECOND_RUN_COLOUR = (190, 70, 190)
MARKS_PER_SECOND = 25.0
SHORTEST_PATH = 1e-4
"""A shorter tool path is not drawn [m]."""
SAME_SETPOINT = 1e-6
"""Set points that differ by less count as equal [m, rad]; covers rounding of a recording."""


@dataclass(frozen=True)
class ToolPaths:
    """Tool points in the part frame (sample, 3) [m]: programmed (None if unknown), commanded, and followed by each run."""

    reference_time: np.ndarray
    programmed: np.ndarray | None
    commanded: np.ndarray
    followed: Mapping[str, np.ndarray]
    times: Mapping[str, np.ndarray]
    contours: Mapping[str, Contour]
    scale: ErrorScale
    magnifications: tuple[int, ...] = (1,)
    """1 and the factors at which the deviation is visible."""


def followed_joints(trace: Trace) -> dict[str, np.ndarray]:
    """Position of each axis (sample,): position, else motor position, else set point."""
    joints = {}
    for axis in trace.axes:
        signal = next((s for s in ("position", "motor_position", "setpoint") if trace.has(axis, s)), None)
        if signal:
            joints[axis] = trace.get(axis, signal)
    return joints


def commanded_joints(trace: Trace) -> dict[str, np.ndarray]:
    """Set point of each axis (sample,), else its position."""
    return {axis: trace.get(axis, "setpoint") if trace.has(axis, "setpoint") else values for axis, values in followed_joints(trace).items()}


def tool_paths_of(scene: Scene, machine: Machine, runs: Mapping[str, Trace], programmed: Trace | None) -> ToolPaths | None:
    """Tool paths and contour errors of the runs; None if the tool does not move.

    The tool is the site `tool` of the model, else the end of its longest chain of joints. Without a site `workpiece` the paths are drawn
    in the world.
    """
    main = next(iter(runs.values()))
    if not any(main.has(axis, s) for axis in main.axes for s in POSITIONS):
        return None
    commanded, _ = tool_point(scene, commanded_joints(main))
    if np.linalg.norm(np.ptp(commanded, axis=0)) < SHORTEST_PATH:
        return None
    ideal = tool_point(scene, commanded_joints(programmed))[0] if programmed is not None else None
    reference, reference_time = (commanded, main.time) if ideal is None or programmed is None else (ideal, programmed.time)
    window = search_window(machine)
    followed = {label: tool_point(scene, followed_joints(trace))[0] for label, trace in runs.items()}
    contours = {}
    for label, points in followed.items():
        # a run with other set points is compared with its own
        own = programmed is None and not _same_setpoints(runs[label], main)
        asked = tool_point(scene, commanded_joints(runs[label]))[0] if own else reference
        contours[label] = contour_of(runs[label].time, points, runs[label].time if own else reference_time, asked, window)
    times = {label: trace.time for label, trace in runs.items()}
    found = ToolPaths(reference_time, ideal, commanded, followed, times, contours, error_scale(next(iter(contours.values())).error))
    return replace(found, magnifications=magnifications(largest_error(found), path_extent(found)))


def alike(first: ToolPaths, second: ToolPaths) -> tuple[ToolPaths, ToolPaths]:
    """Both with the scale of the larger error and common magnifications."""
    worse = max((first, second), key=lambda paths: paths.scale.end)
    factors = magnifications(max(map(largest_error, (first, second))), max(map(path_extent, (first, second))))
    return replace(first, scale=worse.scale, magnifications=factors), replace(second, scale=worse.scale, magnifications=factors)


def largest_error(paths: ToolPaths) -> float:
    """Largest contour error of all runs [m]."""
    return max(float(contour.error.max()) for contour in paths.contours.values())


def _same_setpoints(trace: Trace, other: Trace) -> bool:
    """Whether both have the same set points, on the axes where the first has any."""
    return all(
        other.has(axis, "setpoint")
        and len(other.time) == len(trace.time)
        and np.allclose(trace.get(axis, "setpoint"), other.get(axis, "setpoint"), rtol=0.0, atol=SAME_SETPOINT)
        for axis in trace.axes
        if trace.has(axis, "setpoint")
    )


def path_extent(paths: ToolPaths) -> float:
    """Diagonal of the bounding box of the commanded path [m]."""
    return float(np.linalg.norm(np.ptp(paths.commanded, axis=0)))


def log_tool_paths(
    recording: rr.RecordingStream, scene: Scene, paths: ToolPaths, shapes: Sequence[str], full: bool
) -> tuple[PathView, ...]:
    """Log all paths below the part frame, one branch per magnification, and the colour bar. Returns their views."""
    reference = paths.commanded if paths.programmed is None else paths.programmed
    views = []
    for factor in paths.magnifications:
        root = entity(scene.part_path, f"path_x{factor}")
        duration = float(paths.reference_time[-1] - paths.reference_time[0])
        low, high = reference.min(axis=0), reference.max(axis=0)
        log_whole_path(recording, entity(root, "programmed"), reference, PROGRAM_COLOUR, 1.0, duration, full)
        growing = []
        for order, (label, followed) in enumerate(paths.followed.items()):
            contour = paths.contours[label]
            drawn = followed if factor == 1 else contour.magnified(followed, factor)
            low, high = np.minimum(low, drawn.min(axis=0)), np.maximum(high, drawn.max(axis=0))
            bands = paths.scale.band(contour.error) if order == 0 else np.zeros(len(drawn), int)
            palette = ERROR_BANDS if order == 0 else (SECOND_RUN_COLOUR,)
            growing.append(entity(root, "followed", label))
            width = 2.5 if order == 0 else 1.5
            log_growing_path(recording, growing[-1], paths.times[label], drawn, bands, palette, width=width, full=full, dashed=order > 0)
            if order == 0:
                log_tool_point(recording, entity(root, "tool_point"), paths.times[label], drawn)
        if paths.programmed is not None:
            log_commanded(recording, entity(root, "commanded"), paths, factor, full)
        also = tuple(shapes_of_tool(scene, shapes))
        title = f"Tool path, deviation x{factor}" if factor > 1 else "At the part"
        views.append(PathView(title, root, tuple(growing), np.array([low, high]), also))
    log_legend(recording, LEGEND, paths.scale, next(iter(paths.followed)))
    return tuple(views)


def log_commanded(recording: rr.RecordingStream, path: str, paths: ToolPaths, factor: int, full: bool) -> None:
    """Log the commanded path; its deviation from the programmed one is magnified, too."""
    main = next(iter(paths.times.values()))
    points = paths.commanded
    if factor > 1 and paths.programmed is not None:
        points = contour_of(main, points, paths.reference_time, paths.programmed).magnified(points, factor)
    log_whole_path(recording, path, points, SETPOINT_COLOUR, 1.5, float(main[-1] - main[0]), full)


def log_tip_path(
    recording: rr.RecordingStream, scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray], shapes: Sequence[str], full: bool
) -> tuple[PathView, ...]:
    """Log the path of the tip of any scene in the part frame or the world. Returns its view."""
    points, _ = tool_point(scene, joints)
    root = entity(scene.part_path, "path_x1")
    path = entity(root, "followed", "motion")
    log_growing_path(recording, path, time, points, np.zeros(len(time), int), (ERROR_BANDS[0],), width=2.5, full=full)
    log_tool_point(recording, entity(root, "tool_point"), time, points)
    return (PathView("At the tip: machine and path", root, (path,), np.array([points.min(axis=0), points.max(axis=0)]), ()),)


def motion_curves(scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray]) -> list[Curve]:
    """Position and speed of each joint, in the units of slides and hinges."""
    curves = []
    for order, (name, values) in enumerate(joints.items()):
        slide = scene.model.jnt_type[scene.model.joint(name).id] == mujoco.mjtJoint.mjJNT_SLIDE
        units = AXIS_UNITS["linear" if slide else "rotary"]
        colour = axis_colour(name, order)
        curves.append(
            Curve(
                axis_entity(name, "position", "motion"), f"{name} position [{units.position[0]}]", colour, time, values * units.position[1]
            )
        )
        speed = np.gradient(values, time) * units.speed[1]
        curves.append(Curve(axis_entity(name, "speed", "motion"), f"{name} speed [{units.speed[0]}]", colour, time, speed))
    return curves


def shapes_of_tool(scene: Scene, shapes: Sequence[str]) -> list[str]:
    """Entities of the tool: shapes of its body with names that start with 'tool'."""
    return [path for shape, path in zip(scene.shapes, shapes) if shape.body == scene.tip_body and shape.name.startswith("tool")]


def log_tool_point(recording: rr.RecordingStream, path: str, time: np.ndarray, points: np.ndarray) -> None:
    """Log the tool point as a moving dot."""
    stride = max(1, round((len(time) - 1) / max(1.0, (time[-1] - time[0]) * MARKS_PER_SECOND)))
    steps = np.unique(np.r_[np.arange(0, len(time), stride), len(time) - 1])
    recording.log(path, rr.Points3D.from_fields(radii=rr.Radius.ui_points(6.0), colors=[lighter((0, 0, 0), 0.1)]), static=True)
    recording.send_columns(path, [rr.TimeColumn(TIMELINE, duration=time[steps])], rr.Points3D.columns(positions=points[steps]))
