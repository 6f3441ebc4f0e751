"""Pictures of a program: programmed and reached feed over the path, error budget over the path."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twin.program.budget import QUANTITIES, ErrorBudget
from twin.recordings.trace import PROGRAM, Trace
from twin.report.figure import AMBER, BLUE, SOFT, new_figure, save_png

MM_PER_MIN = 60e3
BESIDE: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "frameon": False, "fontsize": 8.5}
"""A legend beside its panel, never on the curves."""


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
    axes.legend(**BESIDE)
    save_png(figure, path)


def plot_budget(budget: ErrorBudget, path: str | Path, title: str = "") -> None:
    """The errors of both levels [um] over path length [mm], one panel below the other."""
    figure, grid = new_figure(2, 1, height=2.8, sharex=True)
    length = budget.path_length * 1e3
    groups = (("level 1: interpolator", ("rounding", "chord")), ("level 2: drives; and what the part sees", ("drives", "contour")))
    for axes, (name, quantities) in zip(grid[:, 0], groups):
        for quantity, colour in zip(quantities, (BLUE, AMBER)):
            words = QUANTITIES[quantity][1].replace(", ", ",\n")
            axes.plot(length, getattr(budget, quantity) * 1e6, color=colour, linewidth=1.1, label=f"{quantity}:\n{words}")
        axes.set_ylabel("error in um")
        axes.set_title(name, loc="left", weight="bold")
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        axes.legend(**BESIDE)
    grid[1, 0].set_xlabel("programmed path length in mm")
    if title:
        figure.suptitle(title)
    save_png(figure, path)
