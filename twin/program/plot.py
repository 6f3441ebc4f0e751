"""Pictures of a program: programmed and reached feed over the path, error budget over the path (needs matplotlib)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import TwinError
from twin.program.budget import QUANTITIES, ErrorBudget
from twin.recordings.trace import PROGRAM, Trace
from twin.report.figure import plain_text

MM_PER_MIN = 60e3


def _pyplot() -> Any:
    try:
        import matplotlib
    except ImportError:
        raise TwinError("pictures need matplotlib; install it with pip install matplotlib") from None
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def plot_feed(setpoints: Trace, path: str | Path, title: str = "") -> None:
    """Programmed and reached feed [mm/min] over path length [mm] into a picture file; rapid moves have no programmed feed."""
    plt = _pyplot()
    length = setpoints.get(PROGRAM, "path_length") * 1e3
    feed, reached = setpoints.get(PROGRAM, "feed") * MM_PER_MIN, setpoints.get(PROGRAM, "path_speed") * MM_PER_MIN
    figure, axes = plt.subplots(figsize=(9.0, 4.0), layout="constrained")
    axes.plot(length, np.where(feed > 0.0, feed, np.nan), color="0.55", linewidth=1.6, label="programmed")
    axes.plot(length, reached, color="tab:blue", linewidth=1.2, label="reached")
    axes.set(xlabel="path length in mm", ylabel="feed in mm/min", title=title)
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper right")
    plain_text(figure).savefig(path, dpi=120)
    plt.close(figure)


def plot_budget(budget: ErrorBudget, path: str | Path, title: str = "") -> None:
    """The errors of both levels [um] over path length [mm], side by side."""
    plt = _pyplot()
    figure, axes = plt.subplots(2, 1, sharex=True, figsize=(9.0, 6.0), layout="constrained")
    length = budget.path_length * 1e3
    groups = (("level 1: interpolator", ("rounding", "chord")), ("level 2: drives; and what the part sees", ("drives", "contour")))
    for ax, (name, quantities) in zip(axes, groups):
        for quantity in quantities:
            ax.plot(length, getattr(budget, quantity) * 1e6, linewidth=1.1, label=f"{quantity}: {QUANTITIES[quantity][1]}")
        ax.set(ylabel="error in um", title=name)
        ax.set_ylim(bottom=0.0)
        ax.grid(alpha=0.3)
        ax.legend(loc="upper right", fontsize="small")
    axes[1].set_xlabel("programmed path length in mm")
    if title:
        figure.suptitle(title)
    plain_text(figure).savefig(path, dpi=120)
    plt.close(figure)
