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
from typing import Annotated, Any

import msgspec
import numpy as np

from twin.documents import outer_file, read_toml
from twin.errors import InputError
from twin.limits import refuse_above
from twin.surface.height_rays import HeightRays, grid_rays
from twin.surface.shapes import TABLES, MeshFile, Plane, Profile, Sphere, limits
from twin.surface.tools import Tool, tool_from_table
from twin.tables import Number, Positive, Table, Text, asks, typed, typed_kind
from twin.units import rad_from_deg

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


class _StockTable(Table, frozen=True):
    allowance_mm: Positive = 0.05
    mesh: str | None = None
    unit: str | None = None


class _PlacementTable(Table, frozen=True):
    origin_mm: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
    rotation_deg: Number = 0.0


class _PartFile(Table, frozen=True):
    tool: Annotated[Any, asks("add [tool]")]
    surface: Annotated[tuple[Any, ...], asks("write [[surface]] and its keys below it, at least once", min_length=1)]
    name: Text | None = None
    stock: _StockTable = msgspec.field(default_factory=_StockTable)
    placement: _PlacementTable = msgspec.field(default_factory=_PlacementTable)
    notes: Annotated[tuple[str, ...], asks("write notes = [..], a list of texts")] = ()


def part_from_document(document: Mapping[str, Any], folder: Path, where: str) -> Part:
    """A checked Part from the tables of a part file."""
    given = typed(document, _PartFile, where)
    stock, angle = given.stock, rad_from_deg(given.placement.rotation_deg)
    part = Part(
        name=given.name or folder.name,
        tool=tool_from_table(given.tool, f"{where}: [tool]"),
        surfaces=tuple(_surface(table, i, folder, f"{where}: [[surface]] {i + 1}") for i, table in enumerate(given.surface)),
        allowance=stock.allowance_mm * 1e-3,
        origin=np.array(given.placement.origin_mm) * 1e-3,
        rotation=np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]),
        stock=None if stock.mesh is None else MeshFile(outer_file(stock.mesh, folder, f"{where}: [stock]: mesh"), stock.unit),
        notes=given.notes,
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
    given = typed_kind(table, TABLES, where)
    along, across = given.zone_along_mm, given.zone_across_mm
    return Surface(
        name=given.name or f"surface {index + 1}",
        shape=given.shape(folder, where),
        spacing=given.spacing_mm * 1e-3,
        depth=given.depth_mm * 1e-3,
        zone_spacing=(given.zone_um or 0.0) * 1e-6,
        zone_along=along and limits(along, "zone_along_mm", where),
        zone_across=across and limits(across, "zone_across_mm", where),
        zone_feed=given.zone_feed_m_per_min / 60.0,
    )


def _samples(ends: tuple[float, float], spacing: float) -> np.ndarray:
    """Equidistant values between two ends, both included, with about this spacing."""
    return np.linspace(*ends, max(2, round((ends[1] - ends[0]) / spacing) + 1))
