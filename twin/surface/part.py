"""Part files: nominal surfaces, stock, tool, and placement of the part in the part frame of the machine.

    [tool]       kind, diameter_mm, ...              (twin.surface.tools)
    [stock]      allowance_mm above the nominal surface, or mesh = "stock.stl"
    [placement]  origin_mm, rotation_deg about z     of the part in the machine's part frame (table centre, table top)
    [[surface]]  kind = "profile" | "plane" | "sphere" | "mesh", its shape, spacing_mm and a zone with finer rays

u runs along the surface, v across it; shapes: twin.surface.shapes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Any

import numpy as np

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.limits import refuse_above
from twin.surface.height_rays import HeightRays, grid_rays
from twin.surface.shapes import KEYS, KINDS, MeshFile, Plane, Profile, Sphere, mesh_file, shape_of
from twin.surface.tools import Tool, tool_from_table
from twin.tables import known, limits, listed, number, numbers, positive
from twin.units import rad_from_deg

COMMON = {"name", "kind", "spacing_mm", "depth_mm", "zone_um", "zone_along_mm", "zone_across_mm", "zone_feed_m_per_min"}
MOST_RAYS = 4_000_000
"""Most rays of a surface or zone; pictures and files of more would not fit into memory."""


@dataclass(frozen=True)
class Surface:
    """One nominal surface with its sampling; lengths in m.

    `zone_spacing` 0: no finer zone. `zone_along`, `zone_across`: its range in u and v; None: the surface cut by motion faster than
    `zone_feed` [m/s], plus a margin.
    """

    name: str
    shape: Profile | Plane | Sphere | MeshFile
    spacing: float
    depth: float
    zone_spacing: float
    zone_along: tuple[float, float] | None
    zone_across: tuple[float, float] | None
    zone_feed: float

    def rays(
        self,
        part: Part,
        *,
        spacing: float | None = None,
        along: tuple[float, float] | None = None,
        across: tuple[float, float] | None = None,
    ) -> HeightRays:
        """Uncut rays of the whole surface, or of a range of u and v, in the part frame of the machine."""
        spacing = spacing or self.spacing
        if isinstance(self.shape, MeshFile):
            from twin.surface.mesh import mesh_rays

            return mesh_rays(self.name, self.shape, spacing, part.placed, part.allowance, self.depth)
        whole_u, whole_v = self.shape.extent
        ranges = (along or whole_u, across or whole_v)
        self._check_number(spacing, [high - low for low, high in ranges])
        u, v = (_samples(ends, spacing) for ends in ranges)
        point, direction = self.shape.rays(u, v)
        grid = point.shape
        point, direction = part.placed(point.reshape(-1, 3), direction.reshape(-1, 3))
        return grid_rays(self.name, point.reshape(grid), direction.reshape(grid), u, v, part.allowance, self.depth)

    def check_rays(self, zone_spacing: float, zone_least: float) -> None:
        """Refuse spacings with too many rays before the simulation; an automatic zone has at least `zone_least` [m] of length and width."""
        if isinstance(self.shape, MeshFile):
            return  # checked when the mesh is read
        whole = [high - low for low, high in self.shape.extent]
        self._check_number(self.spacing, whole)
        if self.zone_spacing:
            ranges = (self.zone_along, self.zone_across)
            self._check_number(zone_spacing, [r[1] - r[0] if r else min(zone_least, w) for r, w in zip(ranges, whole, strict=True)])

    def _check_number(self, spacing: float, lengths: Sequence[float]) -> None:
        """Refuse a grid of more than `MOST_RAYS`."""
        rays = math.prod(max(2.0, length / spacing + 1.0) for length in lengths)
        where, remedy = f"surface '{self.name}'", "enlarge spacing_mm or zone_um, or make the zone smaller"
        refuse_above(rays, MOST_RAYS, f"rays at {spacing * 1e6:g} um", where, remedy)


@dataclass(frozen=True)
class Part:
    """A checked part file; lengths in m. `stock` None: an allowance on the nominal surface."""

    name: str
    tool: Tool
    surfaces: tuple[Surface, ...]
    allowance: float
    origin: np.ndarray
    rotation: np.ndarray
    stock: MeshFile | None
    notes: tuple[str, ...] = field(default=())

    def placed(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and directions of the part in the machine's part frame."""
        return points @ self.rotation.T + self.origin, directions @ self.rotation.T

    @property
    def files(self) -> tuple[Path, ...]:
        """The mesh files of the part."""
        shapes = (*(s.shape for s in self.surfaces), self.stock)
        return tuple(dict.fromkeys(shape.path for shape in shapes if isinstance(shape, MeshFile)))

    def with_files(self, places: Mapping[Path, Path]) -> Part:
        """The same part with its meshes at other paths."""

        def moved(shape: Any) -> Any:
            return replace(shape, path=places[shape.path]) if isinstance(shape, MeshFile) else shape

        return replace(self, surfaces=tuple(replace(s, shape=moved(s.shape)) for s in self.surfaces), stock=moved(self.stock))


def read_part(path: str | Path) -> Part:
    """Read a part file; every error is an InputError with table, key and remedy."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such part file; give a .toml (see examples/parts)")
    return part_from_document(read_toml(path), path.parent, str(path))


def part_from_document(document: Mapping[str, Any], folder: Path, where: str) -> Part:
    """A checked Part from the tables of a part file."""
    known(document, {"name", "tool", "stock", "placement", "surface", "notes"}, where)
    if "tool" not in document:
        raise InputError(f"{where}: [tool] is missing; add it")
    surfaces = document.get("surface", [])
    if not isinstance(surfaces, list):
        raise InputError(f"{where}: 'surface' must be a list of tables; write [[surface]]")
    if not surfaces:
        raise InputError(f"{where}: [[surface]] is missing; add it")
    stock, in_stock = document.get("stock", {}), f"{where}: [stock]"
    known(stock, {"allowance_mm", "mesh", "unit"}, in_stock)
    placement, in_placement = document.get("placement", {}), f"{where}: [placement]"
    known(placement, {"origin_mm", "rotation_deg"}, in_placement)
    angle = rad_from_deg(number(placement, "rotation_deg", in_placement, 0.0))
    part = Part(
        name=str(document.get("name", folder.name)),
        tool=tool_from_table(document["tool"], f"{where}: [tool]"),
        surfaces=tuple(_surface(table, i, folder, f"{where}: [[surface]] {i + 1}") for i, table in enumerate(surfaces)),
        allowance=positive(stock, "allowance_mm", in_stock, 0.05) * 1e-3,
        origin=numbers(placement, "origin_mm", 3, in_placement, (0.0, 0.0, 0.0)) * 1e-3,
        rotation=np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]),
        stock=mesh_file(stock, "mesh", folder, in_stock) if "mesh" in stock else None,
        notes=tuple(map(str, listed(document, "notes", where, []))),
    )
    names = [surface.name for surface in part.surfaces]
    if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
        raise InputError(f"{where}: two of [[surface]] have the name '{twice}'; give each its own")
    _check_tool(part, where)
    return part


def _check_tool(part: Part, where: str) -> None:
    """Refuse a tool larger than every surface: the units of one of them are wrong."""
    sizes = [max(b - a for a, b in s.shape.extent) for s in part.surfaces if not isinstance(s.shape, MeshFile)]
    if sizes and 2.0 * part.tool.radius > max(sizes):
        raise InputError(
            f"{where}: the tool ({part.tool.radius * 2e3:g} mm) is larger than the part "
            f"(longest side {max(sizes) * 1e3:g} mm); check the units of both"
        )


def _surface(table: Any, index: int, folder: Path, where: str) -> Surface:
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if kind not in KINDS:
        raise InputError(f"{where}: kind = {kind!r}; {nearest(str(kind), KINDS)}")
    known(table, COMMON | KEYS[kind], where)
    return Surface(
        name=str(table.get("name", f"surface {index + 1}")),
        shape=shape_of(table, kind, folder, where),
        spacing=positive(table, "spacing_mm", where, 0.25) * 1e-3,
        depth=positive(table, "depth_mm", where, 0.5) * 1e-3,
        zone_spacing=positive(table, "zone_um", where) * 1e-6 if "zone_um" in table else 0.0,
        zone_along=limits(table, "zone_along_mm", where) if "zone_along_mm" in table else None,
        zone_across=limits(table, "zone_across_mm", where) if "zone_across_mm" in table else None,
        zone_feed=positive(table, "zone_feed_m_per_min", where, 1.0) / 60.0,
    )


def _samples(ends: tuple[float, float], spacing: float) -> np.ndarray:
    """Equidistant values between two ends, both included, with about this spacing."""
    return np.linspace(*ends, max(2, round((ends[1] - ends[0]) / spacing) + 1))
