"""Gap over noise of runs and axes as coloured fields, one panel a signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from twin.report.figure import new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST = 100.0
"""End of the colour scale: larger ratios have its last colour, their number says how large they are."""

PALE = 3.0
"""Below this share of the scale's end, in decades from 1, the field is dark and its number white."""


def ratio_figure(
    signals: Sequence[str], runs: Sequence[str], axes: Sequence[str], ratios: Mapping[tuple[str, str, str], float], expected: float
) -> Figure:
    """Fields by (signal, run, axis); fields up to `expected` stay grey. The colours also part for colour-blind readers (cividis)."""
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    figure, grid = new_figure(1, len(signals), width=2.2 + 2.1 * len(signals), height=1.4 + 0.28 * len(runs), sharey=True)
    colours = colormaps["cividis_r"].with_extremes(under="#eceff3", bad="white")
    image = None
    for panel, signal in zip(grid[0], signals):
        values = np.array([[ratios.get((signal, run, axis), np.nan) for axis in axes] for run in runs])
        image = panel.imshow(values, aspect="auto", cmap=colours, norm=LogNorm(expected, LARGEST))
        panel.set_title(signal.replace("_", " "))
        panel.set_xticks(range(len(axes)), axes)
        panel.set_yticks(range(len(runs)), runs)
        panel.grid(False)
        for (i, j), value in np.ndenumerate(values):
            if value == value:
                dark = value > PALE * expected
                panel.text(
                    j,
                    i,
                    f"{value:.2g}" if value < 100 else f"{value:.0f}",
                    ha="center",
                    va="center",
                    fontsize=7,
                    color="white" if dark else "#1c2430",
                )
    if image is not None:
        figure.colorbar(image, ax=list(grid[0]), label="gap / noise alone", extend="both", shrink=0.8)
    return figure
