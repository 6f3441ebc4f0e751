"""Virtual machining of a part: cuts every surface (coarse as a whole, fine in its zone) with every level of the path.

Deviations from the programmed cut contain no scallops, only the errors of interpolator and drives.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import time
from typing import Any

import numpy as np
import scipy

from twin.errors import InputError
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace
from twin.simulation.result import Run
from twin.surface.height_rays import HeightRays
from twin.surface.levels import LEVELS, PROGRAMMED, Level, levels_of_program, levels_of_trace
from twin.surface.mesh import stock_heights
from twin.surface.metrology import areal, mark, scallop_height
from twin.surface.part import Part, read_part
from twin.surface.removal import cut as removed
from twin.surface.shapes import GridSurface, Surface
from twin.surface.steps import steps_of

FAST_MARGIN = 1e-3
"""Margin of an automatic zone around the surface cut by fast motion [m]."""


@dataclass(frozen=True)
class CutSurface:
    """One surface cut by one level: rays of the whole, the finest (those of the zone if there is one, else of the whole), and the feed at each of these."""

    level: Level
    surface: Surface
    whole: HeightRays
    finest: HeightRays
    feed: np.ndarray


@dataclass(frozen=True)
class Machining:
    """All cut surfaces in the order of surfaces and levels, the work of all cuts as `removal.cut` counts it, and their duration."""

    part: Part
    cuts: tuple[CutSurface, ...]
    work: np.ndarray
    seconds: float

    def reference(self, one: CutSurface) -> CutSurface | None:
        """The programmed cut of the same surface; None if there is none, or for itself."""
        same = (c for c in self.cuts if c.surface.name == one.surface.name and c.level.level == PROGRAMMED)
        return next((c for c in same if c is not one), None)


def check_rays(part: Part, zone_spacing: float | None = None) -> None:
    """Refuse spacings with too many rays before the paths are computed."""
    for surface in part.surfaces:
        if isinstance(surface, GridSurface):
            surface.check_rays(zone_spacing, FAST_MARGIN)


def machine_part(
    part: Part,
    levels: Sequence[Level],
    *,
    threads: int | None = None,
    zone_spacing: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> Machining:
    """Cut every surface of the part with every level. Raises InputError if a path never touches a surface."""
    began = time.perf_counter()
    done, total = 0, 2 * len(part.surfaces) * len(levels)
    total_work, cuts = np.zeros(2, int), []
    steps = {id(level): steps_of(level.path, part.tool.reach) for level in levels}

    def report(share: float) -> None:
        if progress:
            progress((done + share) / total)

    for surface in part.surfaces:
        whole = _with_stock(surface.rays(part.placed, part.allowance), part)
        zone: HeightRays | None = None
        for level in levels:
            after, work = removed(whole, steps[id(level)], part.tool, threads=threads, progress=report)
            if not np.any(after.cutter >= 0):
                raise InputError(_untouched(level, surface, whole, part))
            total_work, done, finest = total_work + work, done + 1, after
            if surface.zone_um and zone is None and isinstance(surface, GridSurface):
                zone = _with_stock(_zone(surface, part, after, level, zone_spacing or surface.zone_um * 1e-6), part)
            if zone is not None:
                finest, work = removed(zone, steps[id(level)], part.tool, threads=threads, progress=report)
                total_work = total_work + work
            done += 1
            feed = np.where(finest.cutter >= 0, level.path.feed[np.maximum(finest.cutter, 0)], np.nan)
            cuts.append(CutSurface(level, surface, after, finest, feed))
    return Machining(part, tuple(cuts), total_work, time.perf_counter() - began)


def report_of(machining: Machining, one: CutSurface) -> dict[str, Any]:
    """Deviations, areal parameters and mark of one cut, in um, mm and degrees."""
    rays = one.finest
    height = rays.height * 1e6
    touched = rays.cutter >= 0
    out: dict[str, Any] = {
        "surface": one.surface.name,
        "level": one.level.level,
        "feedforward": one.level.feedforward,
        "rays": len(rays),
        "untouched": int((~touched).sum()),
        "deviation_um": {"min": float(height.min()), "max": float(height.max()), "mean": float(height.mean())},
        "errors": dict(one.level.errors),
    }
    if rays.is_grid:
        numbers = areal(rays.map(), rays.u, rays.v)
        out["areal_um"] = {k: v * (1e6 if k not in ("ssk", "sku") else 1.0) for k, v in numbers.items()}
        # a section across the passes at an eighth of the length, away from the border and from a mark in the middle
        flank = rays.map()[:, rays.shape[1] // 8]
        out["scallop_um"] = scallop_height(flank) * 1e6
    reference = machining.reference(one)
    if reference is not None:
        out["mark"] = mark(rays, reference.finest)
        difference = (rays.height - reference.finest.height) * 1e6
        # fast or slow by the feed during the cut
        fast = one.feed > one.surface.zone_feed
        for name, rows in (("slow", ~fast & touched), ("fast", fast & touched)):
            if rows.any():
                out[f"against_programmed_{name}_um"] = {"min": float(difference[rows].min()), "max": float(difference[rows].max())}
    return out


def _with_stock(rays: HeightRays, part: Part) -> HeightRays:
    """Uncut rays with the height of the stock (mesh or allowance)."""
    if part.stock is None:
        return rays
    return replace(rays, height=stock_heights(rays, part.stock, part.placed))


def _zone(surface: GridSurface, part: Part, after: HeightRays, level: Level, spacing: float) -> HeightRays:
    """Fine rays in the zone of the part file, or where the surface was cut above the zone's feed."""
    along, across = surface.zone
    if along is None or across is None:
        feed = np.where(after.cutter >= 0, level.path.feed[np.maximum(after.cutter, 0)], 0.0)
        rows, columns = np.nonzero(after.map(feed) > surface.zone_feed)
        if len(rows) == 0:
            raise InputError(
                f"surface '{surface.name}': nothing was cut above {surface.zone_feed * 60:g} m/min, so there is no zone; "
                "give zone_along_mm and zone_across_mm, or lower zone_feed_m_per_min"
            )
        clipped = [
            (max(float(x[i.min()]) - FAST_MARGIN, float(x[0])), min(float(x[i.max()]) + FAST_MARGIN, float(x[-1])))
            for x, i in ((after.u, columns), (after.v, rows))
        ]
        along, across = along or clipped[0], across or clipped[1]
    return surface.rays(part.placed, part.allowance, spacing, along, across)


def _untouched(level: Level, surface: Surface, rays: HeightRays, part: Part) -> str:
    """Message for a path that never touches a surface, with its distance."""
    centre = level.path.tip + part.tool.radius * level.path.axis
    gap, _ = scipy.spatial.cKDTree(rays.surface[:: max(1, len(rays) // 5000)]).query(centre[:: max(1, len(centre) // 20_000)])
    return (
        f"surface '{surface.name}': the {level.label} path never touches it, the tool stays "
        f"{(gap.min() - part.tool.radius) * 1e3:.3g} mm away; "
        "check [placement] origin_mm and the tool length of the part file"
    )


def cut(
    moved: Run | Trace | str | Path, part: str | Path | Part, machine: Machine | None = None, *, levels: Sequence[str] = LEVELS
) -> Machining:
    """Remove material along the tool path of a run, a trace, or a part program, which is simulated first with the
    feedforward of the machine.

    `part` is a part file (tool, stock, surfaces; see examples/parts). `levels` are the paths to cut: 'programmed' (programs only),
    'commanded' (set points), 'followed' (positions). The result holds the heights of every cut surface [m]; `report_of` in
    twin.surface.machining evaluates marks and roughness. Raises InputError if a path never touches the part.
    """
    unknown = set(levels) - set(LEVELS)
    if unknown:
        raise InputError(f"cut: no level '{sorted(unknown)[0]}'; use {', '.join(LEVELS)}")
    machine = machine or (moved.machine if isinstance(moved, Run) else load_machine())
    known = part if isinstance(part, Part) else read_part(part)
    if isinstance(moved, str | Path):
        return machine_part(known, levels_of_program(Path(moved), machine, known.tool, levels, [None]))
    trace = moved.trace if isinstance(moved, Run) else moved
    return machine_part(known, levels_of_trace(trace, machine, known.tool, levels, "cut"))
