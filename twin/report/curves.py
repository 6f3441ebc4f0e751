"""Curves over time in stacked panels: the plot of a trace, a run or a comparison."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import uniform_filter1d

from twin.report.colours import AXIS_COLOURS, SETPOINT_COLOUR, axis_colour, hexadecimal
from twin.report.figure import SOFT, new_figure
from twin.units import plain

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SETPOINT = "setpoint"
WIDE = 2.6
THIN = 1.2
"""Line widths [points]: wide for set points, thin for signals, which lie above."""

LABEL_WIDTH, LABEL_HEIGHT = 0.1, 0.12
"""Share of a panel that a peak label takes; labels of closer peaks are moved apart."""

PLATEAU, SHOULDER = 0.995, 0.7
"""Shares of a peak: the label stands at the middle of what lies above the first, and under it where what lies above the second is as wide as a label."""

COLUMNS, MEAN = 700, 4
"""A line is not resolved within one of so many columns of a panel. The mean of a band is that of so many columns, or its ripple would beat with them."""

LEAST_IN_COLUMN, LEAST_BAND, LEAST_BANDS = 3, 0.03, 0.1
"""A curve is drawn as a band if so many samples fall into a column, and so large a share of its columns swings by this share of its range."""


@dataclass(frozen=True)
class Curve:
    """One line: legend entry ('' for none), values (sample,), colour (name of an axis, or 'setpoint') and dash style."""

    label: str
    values: np.ndarray
    colour: str
    dashes: str = "-"


@dataclass(frozen=True)
class Panel:
    """Curves on one scale, or none if nothing is recorded; `label` names quantity and unit. With a unit in `peaks`, the peak of each curve is labelled."""

    label: str
    curves: Sequence[Curve]
    peaks: str = ""


def curves_figure(time: np.ndarray, panels: Sequence[Panel], title: str, columns: int = 1) -> Figure:
    """A figure of panels over time (sample,) [s], row by row; legends stand beside the panels, or above them in several columns."""
    own = list(dict.fromkeys(curve.colour for panel in panels for curve in panel.curves if curve.colour.upper() not in AXIS_COLOURS))
    rows = len(panels) // columns
    figure, grid = new_figure(rows, columns, width=9.0 + 2.0 * columns, height=1.7 if rows > 1 else 2.6, sharex=True)
    legend: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)}
    if columns > 1:
        legend = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.95), "ncols": 3, "borderaxespad": 0.0, "handlelength": 1.2}
    for axes, panel in zip(grid.flat, panels):
        if not panel.curves:
            axes.text(0.5, 0.5, f"{panel.label.strip()}: not recorded", ha="center", va="center", transform=axes.transAxes, color=SOFT)
        labelled: list[tuple[float, float, str]] = []  # in shares of the panel's width and height, and what is said there
        reach = 2.0 * max((float(np.max(np.abs(curve.values), initial=0.0)) for curve in panel.curves), default=0.0) or 1.0
        for curve in panel.curves:
            asked = curve.colour == SETPOINT
            order = own.index(curve.colour) if curve.colour in own else 0
            colour = hexadecimal(SETPOINT_COLOUR if asked else axis_colour(curve.colour, order))
            _draw(axes, time, curve, colour, WIDE if asked else THIN)
            if panel.peaks and len(curve.values) and np.ptp(curve.values) > 0.0:  # a limit has no peak
                worst = sum(_around_peak(np.abs(curve.values), PLATEAU)) // 2
                left, right = _around_peak(np.abs(curve.values), SHOULDER)
                at, value = float(time[worst]), float(curve.values[worst])
                side = 0 if right - left > LABEL_WIDTH * len(time) else -1 if at > 0.85 * float(time[-1]) else 1
                place = (at / (float(time[-1]) or 1.0), value / reach)
                near = [text for x, y, text in labelled if abs(place[0] - x) < LABEL_WIDTH and abs(place[1] - y) < LABEL_HEIGHT]
                said, beside = f"{plain(float(np.abs(curve.values).max()))} {panel.peaks}", len(near)
                if said in near:
                    continue
                labelled.append((*place, said))
                axes.annotate(
                    said,
                    (at, value),
                    (8 * side, (beside + (side == 0) / 3) * (11 if value < 0 else -11)),  # moved away from labels already there
                    textcoords="offset points",
                    ha=("center", "left", "right")[side],
                    va="bottom" if value < 0 else "top",
                    fontsize=8.5,
                    weight="bold",
                    color="#6b7280" if asked else colour,
                )
        axes.set_ylabel(panel.label, fontsize=9)
        axes.margins(x=0.0)
        if axes.get_legend_handles_labels()[1]:
            axes.legend(**legend, frameon=False, fontsize=8.5)
    if columns == 1:
        grid[0, 0].set_title(title, loc="left", fontsize=10.5, weight="bold")
    else:
        figure.suptitle(title, x=0.01, ha="left", fontsize=11, weight="bold")
    for axes in grid[-1]:
        axes.set_xlabel("time in s")
    figure.align_ylabels(grid)
    return figure


def _around_peak(sizes: np.ndarray, share: float) -> tuple[int, int]:
    """First and last sample of the stretch around the largest of sizes (sample,) that lies above a share of it."""
    worst = int(np.argmax(sizes))
    below = np.flatnonzero(sizes < share * sizes[worst])
    before, after = below[below < worst], below[below > worst]
    return int(before[-1]) + 1 if len(before) else 0, (int(after[0]) if len(after) else len(sizes)) - 1


def _draw(axes: Axes, time: np.ndarray, curve: Curve, colour: str, width: float) -> None:
    """A curve. If it swings many times within the width of a line: its moving mean, in the band that it fills."""
    values, each = curve.values, -(-len(curve.values) // COLUMNS)
    if each >= LEAST_IN_COLUMN:
        whole = len(values) // each * each
        columns = values[:whole].reshape(-1, each)
        low, high, middle = columns.min(axis=1), columns.max(axis=1), time[:whole].reshape(-1, each).mean(axis=1)
        if float(np.mean(high - low > LEAST_BAND * np.ptp(values))) > LEAST_BANDS:
            name = None if axes.collections else "line: mean; band: range"
            axes.fill_between(middle, low, high, color=colour, alpha=0.3, linewidth=0, label=name)
            time, values = middle, uniform_filter1d(columns.mean(axis=1), MEAN, mode="nearest")
    axes.plot(time, values, curve.dashes, color=colour, linewidth=width, label=curve.label or None)
