"""Pictures of a cut surface: a lit relief, the deviation map with scale, and sections through the mark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from twin.files import beside
from twin.report.colours import AXIS_COLOURS, PROGRAM_COLOUR, SETPOINT_COLOUR, hexadecimal
from twin.report.figure import plain_text
from twin.surface.export import COLOUR_MAP
from twin.surface.height_rays import HeightRays
from twin.surface.machining import CutSurface, Machining
from twin.surface.measured import Comparison, HeightMap
from twin.surface.metrology import mark

INK, QUIET = "#1c2733", "#5c6b7a"
LIGHT = (-0.42, 0.5, 0.757)
"""Direction to the lamp in u, v and height, of length 1."""
MOST_PIXELS = 700
"""Rows and columns of a drawn relief at most."""
FONT: Any = {"font.family": "DejaVu Sans", "font.size": 10, "axes.edgecolor": "#9aa5b1", "axes.labelcolor": INK, "text.color": INK}


def draw_cut(machining: Machining, one: CutSurface, path: Path, *, end: float | None = None) -> None:
    """Write a PNG of one cut: relief in the light, deviation map with colour bar in um, sections along and across the mark."""
    import matplotlib
    from matplotlib.figure import Figure

    rays = one.finest
    if not rays.is_grid:
        _draw_scattered(machining, one, path)
        return
    reference = machining.reference(one)
    against = rays if reference is None or reference is one else reference.finest
    place = mark(rays, against)
    row, column = (int(np.argmin(np.abs(a - b))) for a, b in ((rays.v, place.v), (rays.u, place.u)))
    if against is rays:
        row, column = rays.shape[0] // 2, rays.shape[1] // 2
    height, u, v = rays.map() * 1e6, rays.u * 1e3, rays.v * 1e3
    end = end or colour_end(height)
    with matplotlib.rc_context(FONT):
        figure = Figure(figsize=(12.0, 8.6), dpi=130, facecolor="white", layout="constrained")
        grid = figure.add_gridspec(3, 2, height_ratios=[1.5, 1.15, 1.0], hspace=0.04)
        # v is drawn larger than u where the patch is long: the axes say so, and each has its bar
        relief, flat = figure.add_subplot(grid[0, :]), figure.add_subplot(grid[1, :])
        along, across = figure.add_subplot(grid[2, 0]), figure.add_subplot(grid[2, 1])
        _relief(relief, rays, end)
        drawn = flat.imshow(
            height,
            extent=(u[0], u[-1], v[0], v[-1]),
            origin="lower",
            cmap=COLOUR_MAP,
            vmin=-end,
            vmax=end,
            aspect="auto",
            interpolation="antialiased",
        )
        flat.axhline(v[row], color=INK, lw=0.8, ls=(0, (6, 4)))
        flat.axvline(u[column], color=INK, lw=0.8, ls=(0, (2, 3)))
        flat.set_xlabel("along the surface, u [mm]")
        flat.set_ylabel("across, v [mm]")
        _scale_bar(flat, u, v)
        _scale_bar(relief, u, v)
        bar = figure.colorbar(
            drawn, ax=[relief, flat], fraction=0.022, pad=0.012, extend="both" if np.abs(height).max() > end else "neither"
        )
        bar.set_label("deviation from nominal [um]   (below 0: cut too deep)")
        for axes, x, y, ref, text in (
            (along, u, height[row], against.map()[row] * 1e6, f"section along the mark, v = {v[row]:.3f} mm"),
            (across, v, height[:, column], against.map()[:, column] * 1e6, f"section across the passes, u = {u[column]:.3f} mm"),
        ):
            if against is not rays:
                axes.plot(x, ref, color=hexadecimal(SETPOINT_COLOUR), lw=1.2, label="programmed")
            axes.plot(x, y, color=hexadecimal(AXIS_COLOURS["Z"]), lw=1.4, label=one.level.label)
            axes.axhline(0.0, color=hexadecimal(PROGRAM_COLOUR), lw=0.5, alpha=0.5)
            axes.set_title(text, fontsize=10, color=QUIET, loc="left")
            axes.set_ylabel("deviation [um]")
            axes.set_xlabel("[mm]")
            axes.grid(color="#e6eaee", lw=0.7)
            axes.spines[["top", "right"]].set_visible(False)
            axes.margins(x=0)
        along.legend(frameon=False, fontsize=9, loc="best")
        subtitle = f"{machining.part.tool.name}, rays every {abs(u[1] - u[0]) * 1e3:.0f} um"
        if against is not rays:
            subtitle += f"; mark {place.depth * 1e6:.2f} um deep against the programmed cut, "
            subtitle += f"{place.width * 1e3:.2f} mm wide, {place.length * 1e3:.2f} mm long at half depth"
        figure.suptitle(f"{machining.part.name}, {one.surface.name}: {one.level.label}", fontsize=14, x=0.012, ha="left", fontweight="bold")
        relief.set_title(subtitle, fontsize=10, color=QUIET, loc="left")
        _save(figure, path)


def draw_levels(machining: Machining, surface: str, path: Path) -> None:
    """Write a PNG with all levels of one surface below each other, each on its own colour scale: which level makes the mark."""
    import matplotlib
    from matplotlib.figure import Figure

    cuts = [c for c in machining.cuts if c.surface.name == surface and c.finest.is_grid]
    if not cuts:
        return
    u, v = cuts[0].finest.u * 1e3, cuts[0].finest.v * 1e3
    with matplotlib.rc_context(FONT):
        figure = Figure(figsize=(12.0, 0.9 + 1.95 * len(cuts)), dpi=130, facecolor="white", layout="constrained")
        axes = figure.subplots(len(cuts), 1, sharex=True, squeeze=False)[:, 0]
        for one, ax in zip(cuts, axes):
            end = colour_end(one.finest.map() * 1e6)
            _relief(ax, one.finest, end)
            drawn = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(-end, end), COLOUR_MAP)
            figure.colorbar(drawn, ax=ax, fraction=0.03, pad=0.012).set_label("deviation [um]", fontsize=9)
            reference = machining.reference(one)
            text = one.level.label
            if reference is not None and reference is not one:
                found = mark(one.finest, reference.finest)
                text += f":  up to {found.depth * 1e6:.2f} um too deep, {found.height * 1e6:.2f} um left, against the programmed cut"
            ax.set_title(text, fontsize=10.5, loc="left")
            ax.set_ylabel("v [mm]")
            _scale_bar(ax, u, v)
        axes[-1].set_xlabel("along the surface, u [mm]")
        figure.suptitle(
            f"{machining.part.name}, {surface}: level by level (red: too deep; each level has its own scale)",
            fontsize=14,
            x=0.012,
            ha="left",
            fontweight="bold",
        )
        _save(figure, path)


def draw_measured(simulated: HeightMap, found: Comparison, label: str, path: Path) -> None:
    """Write a PNG: simulated and measured [um] on one colour scale, and their difference on its own."""
    from matplotlib.figure import Figure

    difference = found.measured - simulated.height
    end = colour_end(simulated.height * 1e6)
    depths = [f"deepest {depth * 1e6:.1f} um below the mean" for depth in found.depth(simulated.height)]
    maps = (
        (f"simulated: {label}; {depths[0]}", simulated.height, end),
        (f"measured, registered; {depths[1]}", found.measured, end),
        (f"measured - simulated: {found.rms * 1e6:.2f} um RMS", difference, colour_end(difference[np.isfinite(difference)] * 1e6)),
    )
    figure = Figure(figsize=(12.0, 7.0), dpi=130, facecolor="white", layout="constrained")
    panels = figure.subplots(3, 1, sharex=True)
    for ax, (title, height, end) in zip(panels, maps):
        extent = tuple(float(x) * 1e3 for x in (simulated.u[0], simulated.u[-1], simulated.v[0], simulated.v[-1]))
        drawn = ax.imshow(height * 1e6, extent=extent, origin="lower", cmap=COLOUR_MAP, vmin=-end, vmax=end, aspect="auto")
        figure.colorbar(drawn, ax=ax).set_label("deviation [um]")
        ax.set_title(title, loc="left")
        ax.set_ylabel("v [mm]")
    panels[-1].set_xlabel("along the surface, u [mm]")
    _save(figure, path)


def _save(figure: Any, path: Path) -> None:
    """Write a figure in the style in which it was drawn; the style of reports would draw its ticks anew."""
    with beside(path) as partial:
        plain_text(figure).savefig(partial)


def colour_end(height: np.ndarray) -> float:
    """A round end of the colour scale [um] that 99.8 % of the deviations keep."""
    size = max(float(np.quantile(np.abs(height), 0.998)), 0.05)
    step = 10.0 ** np.floor(np.log10(size))
    return float(step * min((f for f in (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0) if f * step >= size), default=10.0))


def _relief(axes: Any, rays: HeightRays, end: float) -> Any:
    """The surface as seen from above under a low light: colour by deviation, shade by slope."""
    import matplotlib

    step = max(1, -(-max(rays.shape) // (2 * MOST_PIXELS)))
    height = rays.map()[::step, ::step] * 1e6
    u, v = rays.u[::step] * 1e3, rays.v[::step] * 1e3
    # heights are stretched until the end of the scale over a tenth of a millimetre is a slope of one; flat is neither lit nor dark
    stretch = 0.1 / end
    dv, du = np.gradient(height * stretch, v, u)
    shade = (LIGHT[2] - LIGHT[0] * du - LIGHT[1] * dv) / np.sqrt(1.0 + du**2 + dv**2) / LIGHT[2]
    colour = matplotlib.colormaps[COLOUR_MAP](np.clip(0.5 + 0.5 * height / end, 0.0, 1.0))[..., :3]
    lit = np.clip(colour * (0.52 + 0.44 * np.clip(shade, 0.0, 1.5)[..., None]), 0.0, 1.0)
    axes.set_ylabel("v [mm]")
    return axes.imshow(lit, extent=(u[0], u[-1], v[0], v[-1]), origin="lower", aspect="auto", interpolation="bilinear")


def _scale_bar(axes: Any, u: np.ndarray, v: np.ndarray) -> None:
    """A bar of a round length in the lower right corner."""
    size = float(u[-1] - u[0]) * 0.15
    step = 10.0 ** np.floor(np.log10(size))
    length = float(step * max(f for f in (1.0, 2.0, 5.0) if f * step <= size))
    x, y = float(u[-1]) - 0.025 * float(np.ptp(u)) - length, float(v[0]) + 0.1 * float(np.ptp(v))
    axes.plot([x, x + length], [y, y], color="white", lw=5.5, solid_capstyle="butt")
    axes.plot([x, x + length], [y, y], color=INK, lw=3.0, solid_capstyle="butt")
    text = f"{length:g} mm" if length >= 1 else f"{length * 1e3:g} um"
    upright = float(np.ptp(v)) * 0.25
    step = 10.0 ** np.floor(np.log10(upright))
    rise = float(step * max(f for f in (1.0, 2.0, 5.0) if f * step <= upright))
    for colour, width in (("white", 5.5), (INK, 3.0)):
        axes.plot([x + length] * 2, [y, y + rise], color=colour, lw=width, solid_capstyle="butt")
    axes.text(
        x + length + 0.004 * float(np.ptp(u)),
        y + rise,
        f"{rise:g}",
        ha="left",
        va="top",
        fontsize=8,
        rotation=90,
        bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 0.6},
    )
    axes.text(
        x + length / 2,
        y + 0.045 * float(np.ptp(v)),
        text,
        ha="center",
        va="bottom",
        fontsize=9,
        bbox={"fc": "white", "ec": "none", "alpha": 0.75, "pad": 1.2},
    )


def _draw_scattered(machining: Machining, one: CutSurface, path: Path) -> None:
    """Rays on a mesh: points seen along their mean normal."""
    import matplotlib
    from matplotlib.figure import Figure

    rays = one.finest
    normal = rays.direction.mean(axis=0)
    across = np.linalg.svd(normal[None])[2][1:] if np.linalg.norm(normal) > 1e-6 else np.eye(3)[:2]
    x, y = (rays.point @ across.T).T * 1e3
    height = rays.height * 1e6
    touched = rays.cutter >= 0
    end = colour_end(height[touched])
    with matplotlib.rc_context(FONT):
        figure = Figure(figsize=(11.0, 7.0), dpi=130, facecolor="white", layout="constrained")
        axes = figure.add_subplot()
        axes.scatter(x[~touched], y[~touched], s=3, color="#d5dbe1", label="not touched")
        drawn = axes.scatter(x[touched], y[touched], c=height[touched], s=4, cmap=COLOUR_MAP, vmin=-end, vmax=end)
        axes.set_aspect("equal")
        axes.set_xlabel("[mm]")
        figure.colorbar(drawn, ax=axes).set_label("deviation from nominal [um]   (below 0: cut too deep)")
        axes.set_title(f"{machining.part.name}, {one.surface.name}: {one.level.label}", loc="left", fontweight="bold")
        _save(figure, path)
