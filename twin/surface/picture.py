"""Plots of a cut surface: shaded relief, deviation map, and sections through the mark."""

from pathlib import Path
from typing import Any

import numpy as np

from twin.report.colours import AXIS_COLOURS, PROGRAM_COLOUR, SETPOINT_COLOUR, hexadecimal
from twin.report.figure import INK, new_figure, save_png
from twin.surface.export import COLOUR_MAP, deviation_colours
from twin.surface.height_rays import HeightRays
from twin.surface.machining import CutSurface, Machining
from twin.surface.measured import Comparison, HeightMap
from twin.surface.metrology import mark
from twin.units import round_up

LIGHT = (-0.42, 0.5, 0.757)
"""Unit vector to the light source in u, v and height."""
MOST_PIXELS = 700
"""Most rows and columns of a drawn relief."""


def draw_cut(machining: Machining, one: CutSurface, path: Path) -> None:
    """Write a PNG of one cut: shaded relief, deviation map with colour bar in um, sections along and across the mark."""
    rays = one.finest
    if not rays.is_grid:
        _draw_scattered(machining, one, path)
        return
    reference = machining.reference(one)
    against = None if reference is None else reference.finest
    place = mark(rays, against or rays)
    height, u, v = rays.map() * 1e6, rays.u * 1e3, rays.v * 1e3
    row, column = (int(np.argmin(np.abs(x - place[name]))) for x, name in ((v, "v_mm"), (u, "u_mm")))
    if against is None:
        row, column = rays.shape[0] // 2, rays.shape[1] // 2
    end = colour_end(height)
    figure, panels = new_figure(4, 1, width=12.0, height=2.3)
    relief, flat, along, across = panels[:, 0]
    _relief(relief, rays, end)
    drawn = _deviation_map(flat, height, u, v, end)
    flat.axhline(v[row], color=INK, lw=0.8, ls=(0, (6, 4)))
    flat.axvline(u[column], color=INK, lw=0.8, ls=(0, (2, 3)))
    flat.set(xlabel="along the surface, u [mm]", ylabel="across, v [mm]")
    beyond = "both" if np.abs(height).max() > end else "neither"
    bar = figure.colorbar(drawn, ax=[relief, flat], fraction=0.022, pad=0.012, extend=beyond)
    bar.set_label("deviation from nominal [um]   (below 0: cut too deep)")
    lines = {one.level.label: height} if against is None else {"programmed": against.map() * 1e6, one.level.label: height}
    _section(along, "u", u, {label: z[row] for label, z in lines.items()}, f"section along the mark, v = {v[row]:.3f} mm")
    _section(across, "v", v, {label: z[:, column] for label, z in lines.items()}, f"section across the passes, u = {u[column]:.3f} mm")
    along.legend(loc="best")
    text = f"{machining.part.name}, {one.surface.name}: {one.level.label}; {machining.part.tool.name}, rays every {abs(u[1] - u[0]) * 1e3:.0f} um"
    if against is not None:
        text += f"\nmark {place['depth_um']:.2f} um deep against the programmed cut, "
        text += f"{place['width_mm']:.2f} mm wide, {place['length_mm']:.2f} mm long at half depth"
    relief.set_title(text)
    save_png(figure, path)


def _deviation_map(axes: Any, height: np.ndarray, u: np.ndarray, v: np.ndarray, end: float) -> Any:
    """Draw heights (row, column) [um] over u and v [mm] on the colour scale from -end to end."""
    axes.grid(False)
    extent = (float(u[0]), float(u[-1]), float(v[0]), float(v[-1]))
    return axes.imshow(
        height, extent=extent, origin="lower", cmap=COLOUR_MAP, vmin=-end, vmax=end, aspect="auto", interpolation="antialiased"
    )


def _section(axes: Any, name: str, x: np.ndarray, lines: dict[str, np.ndarray], title: str) -> None:
    """Draw sections [um] by their labels over u or v [mm]; the last is that of the cut."""
    for label, y in lines.items():
        colour, width = (SETPOINT_COLOUR, 1.2) if label == "programmed" and len(lines) > 1 else (AXIS_COLOURS["Z"], 1.4)
        axes.plot(x, y, color=hexadecimal(colour), lw=width, label=label)
    axes.axhline(0.0, color=hexadecimal(PROGRAM_COLOUR), lw=0.5, alpha=0.5)
    axes.set(xlabel=f"{name} [mm]", ylabel="deviation [um]", title=title)
    axes.margins(x=0)


def draw_levels(machining: Machining, surface: str, path: Path) -> None:
    """Write a PNG with all levels of one surface with u and v, each on its own colour scale, to show which level makes the mark."""
    import matplotlib

    cuts = [c for c in machining.cuts if c.surface.name == surface]
    figure, panels = new_figure(len(cuts), 1, width=12.0, height=2.2, sharex=True)
    for one, ax in zip(cuts, panels[:, 0]):
        end = colour_end(one.finest.map() * 1e6)
        _relief(ax, one.finest, end)
        drawn = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(-end, end), COLOUR_MAP)
        figure.colorbar(drawn, ax=ax, fraction=0.03, pad=0.012).set_label("deviation [um]")
        reference = machining.reference(one)
        text = one.level.label
        if reference is not None:
            found = mark(one.finest, reference.finest)
            text += f":  up to {found['depth_um']:.2f} um too deep, {found['left_um']:.2f} um left, against the programmed cut"
        ax.set_title(text)
    panels[-1, 0].set_xlabel("along the surface, u [mm]")
    figure.suptitle(f"{machining.part.name}, {surface}: level by level (red: too deep; each level has its own scale)", weight="bold")
    save_png(figure, path)


def draw_measured(simulated: HeightMap, found: Comparison, label: str, path: Path) -> None:
    """Write a PNG of the simulated and measured map [um] on one colour scale, and their difference on another."""
    difference = found.measured - simulated.height
    end = colour_end(simulated.height * 1e6)
    depths = [f"deepest {depth * 1e6:.1f} um below the mean" for depth in found.depth(simulated.height)]
    maps = (
        (f"simulated: {label}; {depths[0]}", simulated.height, end),
        (f"measured, registered; {depths[1]}", found.measured, end),
        (f"measured - simulated: {found.rms * 1e6:.2f} um RMS", difference, colour_end(difference[np.isfinite(difference)] * 1e6)),
    )
    figure, panels = new_figure(3, 1, width=12.0, height=2.3, sharex=True)
    for ax, (title, height, end) in zip(panels[:, 0], maps):
        drawn = _deviation_map(ax, height * 1e6, simulated.u * 1e3, simulated.v * 1e3, end)
        figure.colorbar(drawn, ax=ax).set_label("deviation [um]")
        ax.set_title(title)
        ax.set_ylabel("v [mm]")
    panels[-1, 0].set_xlabel("along the surface, u [mm]")
    save_png(figure, path)


def colour_end(height: np.ndarray) -> float:
    """A round end of the colour scale [um] that includes 99.8 % of the deviations."""
    return round_up(max(float(np.quantile(np.abs(height), 0.998)), 0.05), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0))


def _relief(axes: Any, rays: HeightRays, end: float) -> None:
    """The surface from above in a low light: colour by deviation, shading by slope."""
    step = max(1, -(-max(rays.shape) // (2 * MOST_PIXELS)))
    height = rays.map()[::step, ::step] * 1e6
    u, v = rays.u[::step] * 1e3, rays.v[::step] * 1e3
    # scale heights so that the end of the colour scale over 0.1 mm is a slope of 1; flat areas keep their colour
    stretch = 0.1 / end
    dv, du = np.gradient(height * stretch, v, u)
    shade = (LIGHT[2] - LIGHT[0] * du - LIGHT[1] * dv) / np.sqrt(1.0 + du**2 + dv**2) / LIGHT[2]
    colour = deviation_colours(height, end)[..., :3] / 255.0
    lit = np.clip(colour * (0.52 + 0.44 * np.clip(shade, 0.0, 1.5)[..., None]), 0.0, 1.0)
    axes.grid(False)
    axes.set_ylabel("v [mm]")
    axes.imshow(lit, extent=(u[0], u[-1], v[0], v[-1]), origin="lower", aspect="auto", interpolation="bilinear")


def _draw_scattered(machining: Machining, one: CutSurface, path: Path) -> None:
    """Rays on a mesh, projected along their mean normal."""
    rays = one.finest
    normal = rays.direction.mean(axis=0)
    across = np.linalg.svd(normal[None])[2][1:] if np.linalg.norm(normal) > 1e-6 else np.eye(3)[:2]
    x, y = (rays.point @ across.T).T * 1e3
    height = rays.height * 1e6
    touched = rays.cutter >= 0
    end = colour_end(height[touched])
    figure, ((axes,),) = new_figure(1, 1, height=7.0)
    axes.scatter(x[~touched], y[~touched], s=3, color="#d5dbe1", label="not touched")
    drawn = axes.scatter(x[touched], y[touched], c=height[touched], s=4, cmap=COLOUR_MAP, vmin=-end, vmax=end)
    axes.set_aspect("equal")
    axes.set_xlabel("[mm]")
    figure.colorbar(drawn, ax=axes).set_label("deviation from nominal [um]   (below 0: cut too deep)")
    axes.set_title(f"{machining.part.name}, {one.surface.name}: {one.level.label}")
    save_png(figure, path)
