"""Two designs side by side: a pane for each, with its machine and tool path; clock, colour scale and magnification are shared.

    +--------------------------+--------------------------+
    | variant 3: machine       | variant 17: machine      |
    +--------------------------+--------------------------+
    | its deviation x100       | its deviation x100       |
    +--------------------------+--------------------------+
    | colours of the contour error, the same in both panes |
    +-----------------+------------------------+----------+
    | contour errors  | X | Y | Z : both runs  | summary  |
    +-----------------+------------------------+----------+

Equal colours mean equal errors in both panes.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.replay.blueprint import PathView, axis_tabs, contour_view, machine_view, path_view, whole_window
from twin.replay.curves import axis_of_largest, position_errors
from twin.replay.legends import colour_bar_view
from twin.replay.names import SUMMARY
from twin.replay.recording import bounds_with_tip, check_runs, log_machine, log_plots, log_text, recording_to
from twin.replay.scene import Scene, placed_at, scene_of
from twin.replay.text import design_text
from twin.replay.toolpaths import alike, followed_joints, log_tool_paths, tool_paths_of

ROOTS = ("/design_1", "/design_2")


_Pane = tuple[str, Scene, np.ndarray, tuple[PathView, ...]]
"""One design for the layout: label, scene, bounding box (2, 3) [m], views of its paths."""


def write_side_by_side(path: str | Path, designs: Mapping[str, tuple[Machine, Trace]], *, summary: str = "") -> None:
    """Write two designs (label -> machine and its run) as one recording with a pane for each.

    Both need the same axes. Set points may differ; each run is compared with its own. `summary` is plain text for the text panel.
    Raises InputError for designs that cannot be shown side by side.
    """
    _check(designs)
    machine = next(iter(designs.values()))[0]
    runs = {label: trace for label, (_, trace) in designs.items()}
    scenes = [placed_at(scene_of(one), root) for (one, _), root in zip(designs.values(), ROOTS)]
    first, second = (tool_paths_of(scene, one, {label: trace}) for (label, (one, trace)), scene in zip(designs.items(), scenes))
    paths = alike(first, second) if first is not None and second is not None else None  # with common scale and magnifications
    with recording_to(path, f"{machine.name}: {' beside '.join(designs)}") as recording:
        panes: list[_Pane] = []
        for i, ((label, (_, trace)), scene) in enumerate(zip(designs.items(), scenes)):
            log_machine(recording, scene, trace.time, followed_joints(trace))
            views = log_tool_paths(recording, scene, paths[i]) if paths else ()
            panes.append((label, scene, bounds_with_tip(scene, {label: followed_joints(trace)}), views))
        contours = {label: contour for one in paths or () for label, contour in one.contours.items()}
        curves, axes, keys = log_plots(recording, machine, runs, contours)
        log_text(recording, design_text(designs, paths, summary))
        below = [contour_view(curves, (), keys), axis_tabs(curves, axes, keys, most_different_axis(machine, *runs.values()))]
        recording.send_blueprint(_layout(panes, [view for view in below if view is not None]))


def most_different_axis(machine: Machine, first: Trace, second: Trace) -> str:
    """The axis whose following errors differ most, relative to its highest speed."""
    apart = {}
    for axis in machine.axes:
        a, b = (position_errors(trace, axis).get("following_error") for trace in (first, second))
        if a is not None and b is not None:
            both = min(len(a), len(b))
            apart[axis.name] = a[:both] - b[:both]
    return axis_of_largest(machine, apart)


def _layout(panes: Sequence[_Pane], below: Sequence[rrb.View | rrb.Container]) -> rrb.Blueprint:
    columns = []
    # both panes have the same eye, at the distance that suits the larger scene
    whole_box = _around([bounds for _, _, bounds, _ in panes])
    boxes = [_around([view.bounds for view in views]) for views in zip(*(views for *_, views in panes))]
    for label, scene, _, own in panes:
        views = [replace(v, bounds=box, title=f"{label}: {v.title[0].lower()}{v.title[1:]}") for v, box in zip(own, boxes)]
        column: list[rrb.View | rrb.Container] = [machine_view(f"{label}: machine", scene, whole_box, views)]
        if views:  # open on the largest magnification, as for a single run
            near = [path_view(view, views, scene) for view in views]
            column.append(rrb.Tabs(*near, active_tab=len(near) - 1, name=f"{label}: path"))
        columns.append(rrb.Vertical(*column))
    rows: list[rrb.View | rrb.Container] = [rrb.Horizontal(*columns)]
    shares = [5.0]
    if boxes:
        rows.append(colour_bar_view("contour error of both [um]"))
        shares.append(0.7)
    bottom = [*below, rrb.TextDocumentView(origin=SUMMARY, name="Summary")]
    rows.append(rrb.Horizontal(*bottom, column_shares=[1.0, 2.2, 1.3][-len(bottom) :]))
    shares.append(2.6)
    return whole_window(rrb.Vertical(*rows, row_shares=shares))


def _around(boxes: Sequence[np.ndarray]) -> np.ndarray:
    """Bounding box (2, 3) of boxes."""
    return np.array([np.min([box[0] for box in boxes], axis=0), np.max([box[1] for box in boxes], axis=0)])


def _check(designs: Mapping[str, tuple[Machine, Trace]]) -> None:
    if len(designs) != 2:
        raise InputError(f"recording: {len(designs)} designs given; give two")
    for label, (machine, trace) in designs.items():
        check_runs(machine, {label: trace})
    (first, _), (second, _) = designs.values()
    if first.axis_names != second.axis_names:
        raise InputError(
            f"recording: the designs have the axes {' '.join(first.axis_names)} and {' '.join(second.axis_names)}; give two with the same"
        )
