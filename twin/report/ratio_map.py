"""Gap over noise by run and axis as a heat map, one panel per signal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from twin.report.figure import new_figure
from twin.units import in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LARGEST = 100.0
"""End of the colour scale; larger ratios have the last colour."""

SMALLEST = 1e-3
"""Smaller ratios are drawn like this one."""
PALE = 3.0
"""Fields above this multiple of `expected` are dark and get white numbers."""


def ratio_figure(
    signals: Sequence[str], runs: Sequence[str], axes: Sequence[str], ratios: Mapping[tuple[str, str, str], float], expected: float
) -> Figure:
    """A heat map of ratios by (signal, run, axis); ratios up to `expected` are grey. The colours (cividis) suit colour-blind readers."""
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    figure, grid = new_figure(1, len(signals), width=2.2 + 2.1 * len(signals), height=1.2 + 0.3 * len(runs), sharey=True)
    colours = colormaps["cividis_r"].with_extremes(under="#eceff3", bad="white")
    image = None
    for panel, signal in zip(grid[0], signals):
        values = np.array([[ratios.get((signal, run, axis), np.nan) for axis in axes] for run in runs])
        # the scale is logarithmic, so a zero gap is drawn as SMALLEST
        image = panel.imshow(np.maximum(values, SMALLEST), aspect="auto", cmap=colours, norm=LogNorm(expected, LARGEST))
        panel.set_title(in_words(signal))
        panel.set_xticks(range(len(axes)), axes)
        panel.set_yticks(range(len(runs)), runs)
        panel.grid(False)
        for (i, j), value in np.ndenumerate(values):
            if value == value:
                colour = "white" if value > PALE * expected else "#1c2430"
                panel.text(j, i, f"{value:.{int(value < 10)}f}", ha="center", va="center", fontsize=8, color=colour)
    if image is not None and max(ratios.values(), default=0.0) > expected:
        ticks = [tick for tick in (1.5, 3.0, 10.0, 30.0, 100.0) if tick >= expected]
        bar = figure.colorbar(image, ax=list(grid[0]), label="gap, times noise alone", extend="both", ticks=ticks, format="%g")
        bar.minorticks_off()
    return figure
