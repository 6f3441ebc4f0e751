"""The geometry of a test part as its part file has it, with the programmed path of the tool tip."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin.report.figure import BLUE, INK, SOFT, new_figure, save_png
from twin.surface.part import Part
from twin.surface.shapes import PLANES, Profile

MOST_POINTS = 20_000


def draw_geometry(part: Part, path: np.ndarray, file: Path) -> None:
    """A profile in its plane, any other surface from above; `path` (pose, 3) is the programmed tip [m]."""
    figure, axes = new_figure(1, 1, width=8.0, height=5.0)
    ax = axes[0, 0]
    path = path[:: max(1, len(path) // MOST_POINTS)] * 1e3
    first, second = 0, 1
    for surface in part.surfaces:
        rays = surface.rays(part, spacing=max(surface.spacing, 2e-4))
        if isinstance(surface.shape, Profile):
            first, second, _ = PLANES[surface.shape.plane]
            outline = rays.point.reshape(*rays.shape, 3)[0] * 1e3
            ax.plot(outline[:, first], outline[:, second], color=INK, lw=2.0, label=f"{surface.name}, nominal")
        else:
            ax.plot(*(rays.point[:, [first, second]].T * 1e3), ",", color=INK, label=f"{surface.name}, nominal")
    low, high = ax.get_xlim(), ax.get_ylim()
    ax.plot(path[:, first], path[:, second], color=BLUE, lw=0.7, label="programmed tip")
    tip = part.tool.profile * 1e3
    edge = np.vstack([tip * [-1.0, 1.0], tip[::-1]][::-1])
    if second == 2:  # the tool stands upright in this plane
        at = path[np.argmax(path[:, second] * (np.abs(path[:, first]) < 1.0))] if len(path) else np.zeros(3)
        ax.plot(edge[:, 0] + at[first], edge[:, 1] + at[second], color=SOFT, lw=0.8, label=part.tool.name)
    margin = 6.0
    ax.set_xlim(low[0] - margin, low[1] + margin)
    ax.set_ylim(high[0] - margin, high[1] + margin)
    ax.set_aspect("equal")
    ax.set_xlabel(f"{'xyz'[first]} [mm]")
    ax.set_ylabel(f"{'xyz'[second]} [mm]")
    ax.set_title(part.name)
    ax.legend(loc="best")
    save_png(figure, file)
