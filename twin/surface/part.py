"""Part files: nominal surfaces, stock, tool, and placement of the part in the part frame of the machine.

    [tool]       kind, diameter_mm, ...              (twin.surface.tools)
    [stock]      allowance_mm above the nominal surface, or mesh = "stock.stl"
    [placement]  origin_mm, rotation_deg about z     of the part in the machine's part frame (table centre, table top)
    [[surface]]  kind = "profile" | "plane" | "sphere" | "mesh", its shape, spacing_mm and a zone with finer rays

u runs along the surface, v across it; shapes: twin.surface.shapes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
import math
from pathlib import Path
from typing import Annotated, Any, Self

import msgspec
import msgspec.structs
import numpy as np

from twin.documents import named_file, read_toml
from twin.errors import InputError
from twin.surface.shapes import KINDS, GridSurface, MeshSurface, Surface
from twin.surface.tools import Tool, tool_from_table
from twin.tables import Number, Positive, Table, Text, asks, typed, typed_kind


@dataclass(frozen=True)
class Part:
    """A checked part file; lengths in m. `stock` is a mesh and its unit; None: an allowance on the nominal surface."""

    name: str
    tool: Tool
    surfaces: tuple[Surface, ...]
    allowance: float
    origin: np.ndarray
    rotation: np.ndarray
    stock: tuple[Path, str | None] | None
    notes: tuple[str, ...] = field(default=())

    def placed(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and directions of the part in the machine's part frame."""
        return points @ self.rotation.T + self.origin, directions @ self.rotation.T

    @property
    def files(self) -> tuple[Path, ...]:
        """The mesh files of the part."""
        meshes = [Path(s.file) for s in self.surfaces if isinstance(s, MeshSurface)]
        return tuple(dict.fromkeys([*meshes, *([self.stock[0]] if self.stock else [])]))

    def with_files(self, places: Mapping[Path, Path]) -> Self:
        """The same part with its meshes at other paths."""
        moved = (msgspec.structs.replace(s, file=str(places[Path(s.file)])) if isinstance(s, MeshSurface) else s for s in self.surfaces)
        return replace(self, surfaces=tuple(moved), stock=self.stock and (places[self.stock[0]], self.stock[1]))


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


class PartFile(Table, frozen=True):
    tool: Annotated[Any, asks("add [tool]")]
    surface: Annotated[tuple[Any, ...], asks("write [[surface]] and its keys below it, at least once", min_length=1)]
    name: Text | None = None
    stock: _StockTable = msgspec.field(default_factory=_StockTable)
    placement: _PlacementTable = msgspec.field(default_factory=_PlacementTable)
    notes: Annotated[tuple[str, ...], asks("write notes = [..], a list of texts")] = ()


def part_from_document(document: Mapping[str, Any], folder: Path, where: str) -> Part:
    """A checked Part from the tables of a part file."""
    given = typed(document, PartFile, where)
    stock, angle = given.stock, math.radians(given.placement.rotation_deg)
    part = Part(
        name=given.name or folder.name,
        tool=tool_from_table(given.tool, f"{where}: [tool]"),
        surfaces=tuple(_surface(table, i, folder, f"{where}: [[surface]] {i + 1}") for i, table in enumerate(given.surface)),
        allowance=stock.allowance_mm * 1e-3,
        origin=np.array(given.placement.origin_mm) * 1e-3,
        rotation=np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]]),
        stock=None if stock.mesh is None else (named_file(stock.mesh, folder, f"{where}: [stock]: mesh", outer=True), stock.unit),
        notes=given.notes,
    )
    names = [surface.name for surface in part.surfaces]
    if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
        raise InputError(f"{where}: two of [[surface]] have the name '{twice}'; give each its own")
    # a tool larger than every surface: the units of one of them are wrong
    longest = max((high - low for s in part.surfaces if isinstance(s, GridSurface) for low, high in s.extent), default=math.inf)
    if 2.0 * part.tool.radius > longest:
        raise InputError(
            f"{where}: the tool ({part.tool.radius * 2e3:g} mm) is larger than the part "
            f"(longest side {longest * 1e3:g} mm); check the units of both"
        )
    return part


def _surface(table: Any, index: int, folder: Path, where: str) -> Surface:
    given = typed_kind(table, KINDS, where)
    return msgspec.structs.replace(given, name=given.name or f"surface {index + 1}").checked(folder, where)
