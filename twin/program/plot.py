"""Picture of a program: programmed and reached feed over the path."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.recordings.trace import PROGRAM, Trace
from twin.report.figure import BLUE, SOFT, new_figure, save_png

MM_PER_MIN = 60e3


def plot_feed(setpoints: Trace, path: str | Path, title: str = "") -> None:
    """Programmed and reached feed [mm/min] over path length [mm] into a picture file; rapid moves have no programmed feed."""
    length = setpoints.get(PROGRAM, "path_length") * 1e3
    feed, reached = setpoints.get(PROGRAM, "feed") * MM_PER_MIN, setpoints.get(PROGRAM, "path_speed") * MM_PER_MIN
    figure, grid = new_figure(1, 1, height=3.6)
    axes = grid[0, 0]
    axes.plot(length, np.where(feed > 0.0, feed, np.nan), color=SOFT, linewidth=2.4, label="programmed")
    axes.plot(length, reached, color=BLUE, linewidth=1.2, label="reached")
    axes.set(xlabel="path length in mm", ylabel="feed in mm/min")
    axes.set_title(f"{title}: programmed and reached feed" if title else "", loc="left", weight="bold")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize=8.5)  # beside the panel, never on the curves
    save_png(figure, path)
