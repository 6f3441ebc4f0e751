"""Write a recording: machine, motion, tool paths, curves and events of one run or of several overlaid runs."""

import atexit
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from twin.errors import InputError
from twin.files import beside
from twin.geometry.body_poses import local_poses
from twin.geometry.tool_path import Contour
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.replay.blueprint import layout
from twin.replay.curves import PlotLine, axis_curves, axis_of_largest, contour_curve, line_width, position_errors
from twin.replay.decimate import at_rate, decimate
from twin.replay.events import MOST_EVENTS, Event, find_events
from twin.replay.legends import log_keys
from twin.replay.marks import log_events
from twin.replay.names import APPLICATION, SUMMARY, TIMELINE
from twin.replay.scene import Scene, log_motion, log_scene, scene_bounds, scene_of
from twin.replay.source import check_recording
from twin.replay.text import summary_text
from twin.replay.toolpaths import followed_joints, log_tip_path, log_tool_paths, motion_curves, tool_paths_of, tool_point

POSES_PER_SECOND = 50.0
"""Logged poses of the bodies a second [1/s]."""
CURVE_POINTS_PER_MINUTE = 100_000
"""Points of all curves together; at 25 bytes each, half of the 5 MB allowed per minute."""
LEAST_CURVE_POINTS = 100_000
"""The same for a short recording: all samples of five axes for some seconds."""
STALLED_S = 5.0
"""A writer whose file does not grow for this time has stopped [s]."""


def write_recording(
    path: str | Path,
    machine: Machine,
    runs: Mapping[str, Trace],
    *,
    summary: str = "",
    full: bool = False,
    also: Sequence[Event] = (),
    steps: Sequence[PlotLine] = (),
) -> None:
    """Write the runs (label -> trace) of one machine as a recording for the viewer.

    The first run moves the machine; later ones are overlaid, with their difference from it. `summary` is plain text for the text
    panel. `full` keeps every sample; otherwise a minute takes at most 5 MB. `also` are further events; the viewer opens on the axis
    and the stretch of the first of them. `steps` are curves that the user shows or hides. Raises InputError for runs that cannot be shown.
    """
    check_runs(machine, runs)
    main, trace = next(iter(runs.items()))
    scene = scene_of(machine)
    paths = tool_paths_of(scene, machine, runs)
    found = [*also, *find_events(machine, trace, paths.contours[main].error if paths else None)]
    with recording_to(path, f"{machine.name}: {', '.join(runs)}") as recording:
        log_machine(recording, scene, trace.time, followed_joints(trace), full)
        views = log_tool_paths(recording, scene, paths, full) if paths else ()
        plots = log_plots(recording, machine, runs, paths.contours if paths else {}, full, steps)
        marks = log_events(recording, machine, trace, paths.contours[main].error if paths else None, found[:MOST_EVENTS]) if found else ()
        log_text(recording, summary_text(machine, runs, paths, found, summary))
        bounds = bounds_with_tip(scene, {label: followed_joints(t) for label, t in runs.items()})
        errors = {axis.name: own["error_without_delay"] for axis in machine.axes if (own := position_errors(trace, axis))}
        first = also[0].axis if also else axis_of_largest(machine, errors)
        stretch = (also[0].start, also[0].end) if also and also[0].end > also[0].start else None
        legend = f"Contour error of {main} [um]" if paths else ""
        more: dict[str, Any] = {"legend_title": legend, "has_events": bool(found), "states": marks, "steps": steps, "stretch": stretch}
        recording.send_blueprint(layout(scene, bounds, *plots, views, first_axis=first, **more))


def write_motion(
    path: str | Path, scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray], *, summary: str = "", full: bool = False
) -> None:
    """Write the motion of any scene: joint positions (sample,) by name [m, rad] at times (sample,) [s]."""
    with recording_to(path, scene.name) as recording:
        log_machine(recording, scene, time, joints, full)
        views = log_tip_path(recording, scene, time, joints, full)
        curves = motion_curves(scene, time, joints)
        log_curves(recording, curves, full)
        text = f"# {scene.name}\n\n{len(scene.joints)} joints, {len(scene.shapes)} shapes, {time[-1] - time[0]:.3f} s\n\n{summary}\n"
        log_text(recording, text)
        bounds, keys = bounds_with_tip(scene, {"motion": joints}), log_keys(recording, curves)
        recording.send_blueprint(layout(scene, bounds, curves, tuple(joints), keys, views))


@contextmanager
def recording_to(path: str | Path, name: str) -> Iterator[rr.RecordingStream]:
    """A recording to a file, complete when the block ends. Raises InputError if it cannot be written."""
    with beside(path) as partial:
        recording = rr.RecordingStream(APPLICATION)
        recording.set_log_time_enabled(False)
        try:
            recording.save(partial)
        except RuntimeError:
            _abandon(recording)
            raise InputError(f"{path}: cannot be written (is the disk full?); free disk space or choose another place") from None
        recording.send_recording_name(name)
        try:
            yield recording
        finally:
            if _flushed(recording, partial):
                recording.disconnect()
            else:
                _abandon(recording)
        try:
            check_recording(partial)
        except InputError:
            raise InputError(f"{path}: is incomplete (is the disk full?); free disk space or choose another place") from None


_STALLED: list[rr.RecordingStream] = []
"""Recordings whose writer has stopped; disconnecting or deleting one would wait forever."""


def _abandon(recording: rr.RecordingStream) -> None:
    """Keep a recording whose writer has stopped, and exit without waiting for it."""
    _STALLED.append(recording)
    atexit.unregister(rr.rerun_shutdown)


def _flushed(recording: rr.RecordingStream, partial: Path) -> bool:
    """Wait for the writer while the file grows; on a full disk the writer stops silently. True if all is written."""
    before = -1
    while True:
        try:
            recording.flush(timeout_sec=STALLED_S)
            return True
        except (RuntimeError, ValueError, TimeoutError, OSError):  # the check of the file reports what is missing
            size = partial.stat().st_size if partial.exists() else 0
            if size == before:
                return False
            before = size


def log_machine(
    recording: rr.RecordingStream, scene: Scene, time: np.ndarray, joints: Mapping[str, np.ndarray], full: bool = False, most: int = 0
) -> None:
    """Log a scene and its motion: joint positions (sample,) by name, at most about `most` of them."""
    log_scene(recording, scene)
    steps = np.arange(len(time)) if full else at_rate(time, POSES_PER_SECOND)
    steps = steps[:: max(1, len(steps) // most)] if most else steps
    log_motion(recording, scene, time[steps], local_poses(scene.model, {name: values[steps] for name, values in joints.items()}))


def log_text(recording: rr.RecordingStream, text: str) -> None:
    """Log the text panel (markdown)."""
    recording.log(SUMMARY, rr.TextDocument(text, media_type="text/markdown"), static=True)


def log_plots(
    recording: rr.RecordingStream,
    machine: Machine,
    runs: Mapping[str, Trace],
    contours: Mapping[str, Contour],
    full: bool = False,
    steps: Sequence[PlotLine] = (),
) -> tuple[list[PlotLine], tuple[str, ...], dict[str, str]]:
    """Log the curves of all runs with their contour errors, and the keys of their plots. Returns curves, axes and entities of the keys."""
    curves = axis_curves(machine, runs)
    for order, (label, contour) in enumerate(contours.items()):
        curves.append(contour_curve(label, runs[label].time, contour.error, order, alone=len(runs) == 1))
    log_curves(recording, [*curves, *steps], full)
    axes = tuple(axis.name for axis in machine.axes if any(axis.name in trace.axes for trace in runs.values()))
    return curves, axes, log_keys(recording, curves)


def log_curves(recording: rr.RecordingStream, curves: Sequence[PlotLine], full: bool) -> None:
    """Log curves with names and colours; thinned to the common budget unless `full`."""
    if not curves:
        return
    duration = max(float(curve.time[-1] - curve.time[0]) for curve in curves)
    budget = max(LEAST_CURVE_POINTS, int(CURVE_POINTS_PER_MINUTE * duration / 60.0))
    kept = [np.arange(len(c.time)) for c in curves] if full else decimate([(c.time, c.values) for c in curves], budget)
    # the viewer may aggregate evenly spaced samples; for thinned points that would draw ramps that are not in the data
    policy = rr.components.AggregationPolicy.MinMax if full else rr.components.AggregationPolicy.Off
    several = any(curve.run for curve in curves)
    for curve, steps in zip(curves, kept):
        width = line_width(curve.run, several)
        style = rr.SeriesLines(colors=[curve.colour], names=[curve.name], widths=[width], aggregation_policy=policy)
        recording.log(curve.path, style, static=True)
        columns = rr.Scalars.columns(scalars=curve.values[steps])
        recording.send_columns(curve.path, [rr.TimeColumn(TIMELINE, duration=curve.time[steps])], columns)


def bounds_with_tip(scene: Scene, runs: Mapping[str, Mapping[str, np.ndarray]]) -> np.ndarray:
    """Bounding box (2, 3) [m] of the machine in its reference pose and of the tool tip in all runs."""
    low, high = scene_bounds(scene)
    for joints in runs.values():
        tip = tool_point(scene, joints, frame=-1)
        low, high = np.minimum(low, tip.min(axis=0)), np.maximum(high, tip.max(axis=0))
    return np.array([low, high])


def check_runs(machine: Machine, runs: Mapping[str, Trace]) -> None:
    """Raise InputError for runs that cannot be shown on the machine."""
    if not runs:
        raise InputError("recording: no run given; give at least one trace")
    for label, trace in runs.items():
        if len(trace.time) < 2:
            raise InputError(f"recording: run '{label}' is empty; a run needs at least two samples")
        for axis in trace.axes:
            machine.axis(axis)
        if not any(trace.measured_position(axis) or trace.has(axis, "setpoint") for axis in trace.axes):
            raise InputError(f"recording: run '{label}' has no position of any axis; it needs columns such as 'X.position [mm]'")
