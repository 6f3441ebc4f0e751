"""Layout of the viewer: machine, tool path, magnified deviation, a tab of plots per axis, summary and events.

    +--------------------------+-----------------------+---------------+
    | machine                  | at the part           | summary,      |
    |                          | deviation x100 ...    | events        |
    |                          | colours of the error  |               |
    +------------------+-------+-----------------------+---------------+
    | contour error    | X | Y | Z | A | C : following error, speed ... |
    |                  | key of the lines                              |
    +------------------+-----------------------------------------------+

`layout` refers only to the content of the recording that it is given.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.components import AbsoluteTimeRange
from rerun.encodings import Plane3D, TimeInt

from twin.replay.curves import PlotLine
from twin.replay.legends import GROUND, colour_bar_view
from twin.replay.names import CONTOUR_ERROR, EVENTS, STEPS, SUMMARY, TIMELINE, axis_entity
from twin.replay.scene import Scene, shapes_of_tool

LIGHT_GROUND = (226, 230, 235)
GRID_COLOUR = (150, 156, 165, 90)
VIEW_FROM = np.array([0.42, -0.80, 0.42])
"""Direction from the machine to the eye: front right, above."""
PATH_FROM = np.array([0.35, -0.75, 0.75])
"""Direction from a path to the eye: steeper, because most paths are flat."""
NEAR = 1.3
"""Size of the view at the part, relative to the path."""
LEAST_CONTOUR_UM = 0.1
"""Least range of the contour error plot [um]; a smaller one would show rounding."""
GROUP_TITLES = {
    "error_without_delay": "error", "following_error": "with delay", "position": "position", "speed": "speed", "current": "current",
    "torque": "motor torque", **{f"difference_{quantity}": f"Δ {quantity}" for quantity in ("position", "speed", "current")},
}  # fmt: skip
"""Titles of the plots in the tab of an axis; the viewer cuts longer ones off."""
_WIDE = 1.6
"""Width of a column with several plots as tabs, relative to one with a single plot."""
_COLUMNS = (
    ("difference_position", "difference_speed", "difference_current"), ("error_without_delay", "following_error", "position"),
    ("speed",), ("current",), ("torque",),
)  # fmt: skip
"""Plots of an axis by column, from left to right; plots of one column are tabs."""


@dataclass(frozen=True)
class PathView:
    """A tool path view: title, root of its entities, those that grow with time, their bounding box (2, 3) [m]."""

    title: str
    root: str
    growing: tuple[str, ...]
    bounds: np.ndarray


def layout(
    scene: Scene,
    scene_bounds: np.ndarray,
    curves: Sequence[PlotLine],
    axes: tuple[str, ...],
    keys: Mapping[str, str],
    paths: Sequence[PathView],
    *,
    first_axis: str = "",
    legend_title: str = "",
    has_events: bool = False,
    states: Sequence[str] = (),
    steps: Sequence[PlotLine] = (),
    stretch: tuple[float, float] | None = None,
) -> rrb.Blueprint:
    """The blueprint of a recording with this content; `stretch` is start and end [s] of a part to play in a loop."""
    top: list[rrb.View | rrb.Container] = [machine_view("Machine", scene, scene_bounds, paths)]
    shares = [5.0]
    if paths:
        views = [path_view(path, paths, scene) for path in paths]
        column: list[rrb.View | rrb.Container] = [views[0]]
        if len(views) > 1:
            column.append(rrb.Tabs(*views[1:], active_tab=len(views) - 2, name="Deviation"))
        heights = [3.0, 3.0][: len(column)]
        if legend_title:
            column.append(colour_bar_view(legend_title))
            heights.append(0.9)
        top.append(rrb.Vertical(*column, row_shares=heights) if len(column) > 1 else column[0])
        shares.append(4.0)
    texts: list[rrb.View] = [rrb.TextDocumentView(origin=SUMMARY, name="Summary")]
    if has_events:
        texts.append(rrb.TextLogView(origin=EVENTS, name="Events"))
    top.append(rrb.Tabs(*texts, active_tab=0))
    shares.append(3.0)
    below = [view for view in (contour_view(curves, states, keys), axis_tabs(curves, axes, keys, first_axis, steps)) if view is not None]
    rows: list[rrb.View | rrb.Container] = [rrb.Horizontal(*top, column_shares=shares)]
    if below:
        rows.append(rrb.Horizontal(*below, column_shares=[1.0, 3.2][-len(below) :]))
    return whole_window(rrb.Vertical(*rows, row_shares=[3.4, 2.0][: len(rows)]), stretch)


def whole_window(views: rrb.Container, stretch: tuple[float, float] | None = None) -> rrb.Blueprint:
    """The blueprint of these views without side panels; it plays the run, or a stretch of it [s], in a loop."""
    selected = stretch and AbsoluteTimeRange(*(TimeInt(seconds=at) for at in stretch))
    loop: Any = {"loop_mode": "selection", "time_selection": selected} if selected else {"loop_mode": "all"}
    panels = rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden")
    time = rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="playing", **loop)
    return rrb.Blueprint(views, *panels, time, auto_views=False, auto_layout=False)


def machine_view(name: str, scene: Scene, bounds: np.ndarray, paths: Sequence[PathView]) -> rrb.View:
    """The view of the whole machine with the first of `paths`."""
    inside = [f"+ {scene.body_paths[0]}/**", *_hidden(paths[1:])]
    return scene_view(name, scene.body_paths[0], inside, bounds, growing=paths[0].growing if paths else (), floor=True)


def path_view(path: PathView, paths: Sequence[PathView], scene: Scene) -> rrb.View:
    """The view of one of `paths`: the first with the bodies that carry the part, the magnified ones alone."""
    inside, bounds, distance = [f"+ {path.root}/**", *(f"+ {entity}" for entity in shapes_of_tool(scene))], path.bounds, 1.05
    if path is paths[0]:
        inside = [*around_the_part(scene), *_hidden(paths[1:])]
        bounds, distance = enlarged(path.bounds, NEAR), 1.0
    return scene_view(path.title, scene.part_path, inside, bounds, growing=path.growing, distance=distance, seen_from=PATH_FROM)


def _hidden(paths: Sequence[PathView]) -> list[str]:
    return [f"- {path.root}/**" for path in paths]


def enlarged(bounds: np.ndarray, factor: float) -> np.ndarray:
    """A box (2, 3) larger by a factor about its middle."""
    middle = bounds.mean(axis=0)
    return middle + factor * (bounds - middle)


def around_the_part(scene: Scene) -> list[str]:
    """Contents of a view at the part: the bodies that carry it, and the tool. Other bodies would hide the path."""
    scene_root, part_frame = scene.body_paths[0], scene.part_path
    carrier = "/".join(part_frame.split("/")[:3])
    if carrier in (scene_root, part_frame):  # no body carries the part
        return [f"+ {scene_root}/**", f"- {part_frame}/axes"]
    return [f"+ {carrier}/**", *(f"+ {entity}" for entity in shapes_of_tool(scene)), f"- {part_frame}/axes"]


def scene_view(
    name: str,
    origin: str,
    contents: Sequence[str],
    bounds: np.ndarray,
    *,
    growing: Sequence[str] = (),
    distance: float = 1.0,
    seen_from: np.ndarray = VIEW_FROM,
    floor: bool = False,
) -> rrb.View:
    """A 3D view of a box (2, 3) [m] in the frame of `origin`, from a distance in diagonals of the box.

    Entities in `growing` are drawn up to the current time; `floor` draws a grid at the bottom of the box.
    """
    start, now = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    until_now = rrb.VisibleTimeRanges(timeline=TIMELINE, start=start, end=now)
    overrides: dict[Any, Any] = dict.fromkeys(growing, until_now)
    centre = bounds.mean(axis=0)
    away = max(distance * float(np.linalg.norm(bounds[1] - bounds[0])), 1e-3)
    eye = centre + away * seen_from / np.linalg.norm(seen_from)
    grid = rrb.LineGrid3D(visible=True, spacing=0.1, plane=Plane3D((0, 0, 1), float(bounds[0, 2])), color=GRID_COLOUR)
    look = rrb.EyeControls3D(position=eye, look_target=centre, eye_up=(0, 0, 1), kind=rrb.Eye3DKind.Orbital)
    shown: dict[str, Any] = {"background": LIGHT_GROUND, "line_grid": grid if floor else False, "eye_controls": look}
    return rrb.Spatial3DView(origin=origin, contents=contents, name=name, overrides=overrides, **shown)


def contour_view(curves: Sequence[PlotLine], states: Sequence[str], keys: Mapping[str, str]) -> rrb.View | rrb.Container | None:
    """Tabs with the contour error of all runs and with the limits and sticking of the axes; None without either."""
    views: list[rrb.View | rrb.Container] = []
    errors = [float(curve.values.max()) for curve in curves if curve.path.startswith(CONTOUR_ERROR)]
    if errors:
        least = rrb.ScalarAxis(range=(0.0, LEAST_CONTOUR_UM)) if max(errors) < LEAST_CONTOUR_UM else None
        views.append(_with_key(_plot(CONTOUR_ERROR, "Contour error [um]", least), keys.get(""), "Contour error"))
    if states:
        views.append(rrb.StateTimelineView(origin="/states", name="Limits and sticking"))
    return rrb.Tabs(*views, active_tab=0) if views else None


def axis_tabs(
    curves: Sequence[PlotLine], axes: tuple[str, ...], keys: Mapping[str, str], first_axis: str, steps: Sequence[PlotLine] = ()
) -> rrb.Container | None:
    """A tab of plots for each axis, `first_axis` in front, and a tab of `steps`; None without curves."""
    tabs: list[rrb.View | rrb.Container] = []
    for axis in axes:
        plots, shares = [], []
        for column in _COLUMNS:
            views = [view for group in column if (view := _axis_plot(curves, axis, group)) is not None]
            if views:
                plots.append(rrb.Tabs(*views, active_tab=0) if len(views) > 1 else views[0])
                shares.append(_WIDE if len(views) > 1 else 1.0)
        if plots:
            tabs.append(_with_key(rrb.Horizontal(*plots, column_shares=shares), keys.get(axis), f"Axis {axis}"))
    if not tabs:
        return None
    if steps:  # overlaid; the first and last are visible, the legend toggles the others
        hidden: dict[Any, Any] = {curve.path: rr.SeriesLines.from_fields(visible_series=[False]) for curve in steps[1:-1]}
        legend = rrb.PlotLegend(visible=True, corner=rrb.Corner2D.RightTop)
        tabs.append(rrb.TimeSeriesView(origin=STEPS, name="Effect by effect", overrides=hidden, plot_legend=legend))
    first = axes.index(first_axis) if first_axis in axes else 0
    return rrb.Tabs(*tabs, active_tab=min(first, len(tabs) - 1))


def _plot(origin: str, name: str, axis_y: rrb.ScalarAxis | None = None) -> rrb.View:
    """A plot without legend (it would cover curves)."""
    return rrb.TimeSeriesView(origin=origin, name=name, plot_legend=rrb.PlotLegend(visible=False), axis_y=axis_y)


def _axis_plot(curves: Sequence[PlotLine], axis: str, group: str) -> rrb.View | None:
    """The plot of a group of curves, its title with their unit; None without curves."""
    root = axis_entity(axis, group)
    own = [curve for curve in curves if curve.path.startswith(f"{root}/")]
    return _plot(root, f"{GROUP_TITLES[group]} {own[0].name[own[0].name.rindex('[') :]}", _even_range(own)) if own else None


def _even_range(curves: Sequence[PlotLine]) -> rrb.ScalarAxis | None:
    """A range that ends at even numbers, so that the plot shows more than one of them beside its grid."""
    values = np.concatenate([curve.values for curve in curves])
    if not values.size or not (span := np.ptp(values)) > 0.0:
        return None
    step = 10.0 ** np.floor(np.log10(span))
    low, high = step * np.floor(values.min() / step), step * np.ceil(values.max() / step)
    return rrb.ScalarAxis(range=(low - MARGIN * (high - low), high + MARGIN * (high - low)))


MARGIN = 0.04
"""Free space above and below a plot, as a share of its range."""


def _with_key(above: rrb.View | rrb.Container, key: str | None, name: str) -> rrb.Container:
    """Plots with the key of their lines below, if there is one."""
    if key is None:
        return rrb.Vertical(above, name=name)
    strip = rrb.Spatial2DView(origin=key, name="Key", titlebar=False, background=GROUND)
    return rrb.Vertical(above, strip, row_shares=[11.0, 1.0], name=name)
