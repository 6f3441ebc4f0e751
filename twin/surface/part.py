"""Part files: the nominal surface, the stock, the tool and where the part lies in the part frame of the machine.

    [tool]       kind, diameter_mm, ...              (twin.surface.tools)
    [stock]      allowance_mm above the nominal surface, or mesh = "stock.stl"
    [placement]  origin_mm, rotation_deg about z     of the part in the machine's part frame (table centre, table top)
    [[surface]]  kind = "profile" | "plane" | "sphere" | "mesh", its shape, spacing_mm and a zone with finer nails

A profile is a chain of lines and arcs in a plane, drawn with the material on its right, and extruded along the plane's normal: so
planes, cylinders and sharp corners come from one kind. u runs along the surface as it is first named, v across; both in mm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
import math
from pathlib import Path
import tomllib
from typing import Any

import numpy as np

from twin.errors import InputError, nearest
from twin.surface.nails import Nails, grid_nails
from twin.surface.tools import Tool, positive, tool_from_table
from twin.units import rad_from_deg

KINDS = ("profile", "plane", "sphere", "mesh")
KEYS = {
    "profile": {"plane", "start_mm", "heading_deg", "segments", "across_mm"},
    "plane": {"origin_mm", "u_direction", "v_direction", "along_mm", "across_mm"},
    "sphere": {"centre_mm", "radius_mm", "azimuth_deg", "polar_deg"},
    "mesh": {"file", "unit"},
}
COMMON = {"name", "kind", "spacing_mm", "depth_mm", "zone_um", "zone_along_mm", "zone_across_mm", "zone_feed_m_per_min", "sections_mm"}
MOST_NAILS = 4_000_000
"""A zone with more nails than this is refused: it would not fit into memory in pictures and files."""
EDGE_WIDTH = 0.5e-3
"""Beside a sharp edge the nails lean over this width, up to the bisector at the edge [m]; there they read up to 1 / cos(turn / 2) more."""
PLANES = {"xz": (0, 2, 1), "xy": (0, 1, 2), "yz": (1, 2, 0)}


@dataclass(frozen=True)
class Surface:
    """One nominal surface with its sampling; lengths in m.

    `zone_spacing` 0: no finer zone. `zone_along`, `zone_across`: its range in u and v, or None where it is found by the feed:
    all that was made by motion faster than `zone_feed` [m/s], and a margin.
    """

    name: str
    kind: str
    table: Mapping[str, Any]
    spacing: float
    depth: float
    zone_spacing: float
    zone_along: tuple[float, float] | None
    zone_across: tuple[float, float] | None
    zone_feed: float

    def nails(
        self,
        part: Part,
        *,
        spacing: float | None = None,
        along: tuple[float, float] | None = None,
        across: tuple[float, float] | None = None,
    ) -> Nails:
        """Uncut nails of the whole surface or of a range of u and v, in the part frame of the machine."""
        spacing = spacing or self.spacing
        if self.kind == "mesh":
            from twin.surface.mesh import mesh_nails

            return mesh_nails(self, part, spacing)
        whole_u, whole_v = self.extent()
        u, v = _samples(along or whole_u, spacing), _samples(across or whole_v, spacing)
        if len(u) * len(v) > MOST_NAILS:
            raise InputError(
                f"surface '{self.name}': {len(u) * len(v)} nails at {spacing * 1e6:g} um; "
                "enlarge spacing_mm or zone_um, or make the zone smaller"
            )
        point, direction = _EVALUATE[self.kind](self.table, u, v)
        shape = point.shape
        point, direction = part.placed(point.reshape(-1, 3), direction.reshape(-1, 3))
        return grid_nails(self.name, point.reshape(shape), direction.reshape(shape), u, v, part.allowance, self.depth)

    def extent(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Ranges of u and v [m]."""
        return _EXTENT[self.kind](self.table)


@dataclass(frozen=True)
class Part:
    """A checked part file; lengths in m. `stock_mesh` is None where the stock is an allowance on the nominal surface."""

    name: str
    tool: Tool
    surfaces: tuple[Surface, ...]
    allowance: float
    origin: np.ndarray
    rotation: np.ndarray
    stock_mesh: Path | None
    stock_unit: str | None
    folder: Path
    notes: tuple[str, ...] = field(default=())

    def placed(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and directions of the part in the machine's part frame."""
        return points @ self.rotation.T + self.origin, directions @ self.rotation.T


def read_part(path: str | Path) -> Part:
    """Read a part file; every fault is an InputError with table, key and remedy."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such part file; give a .toml (see examples/parts)")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a valid TOML file: {error}; correct it there") from None
    return part_from_document(document, path.parent, str(path))


def part_from_document(document: Mapping[str, Any], folder: Path, where: str) -> Part:
    """A checked Part from the tables of a part file."""
    _known(document, {"name", "tool", "stock", "placement", "surface", "notes"}, where)
    for table in ("tool", "surface"):
        if table not in document:
            raise InputError(f"{where}: {'[[surface]]' if table == 'surface' else '[tool]'} is missing; add it")
    if not isinstance(document["surface"], list):
        raise InputError(f"{where}: 'surface' must be a list of tables; write [[surface]]")
    stock = document.get("stock", {})
    _known(stock, {"allowance_mm", "mesh", "unit"}, f"{where}: [stock]")
    placement = document.get("placement", {})
    _known(placement, {"origin_mm", "rotation_deg"}, f"{where}: [placement]")
    angle = rad_from_deg(float(placement.get("rotation_deg", 0.0)))
    rotation = np.array([[math.cos(angle), -math.sin(angle), 0.0], [math.sin(angle), math.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    surfaces = tuple(_surface(table, i, f"{where}: [[surface]] {i + 1}") for i, table in enumerate(document["surface"]))
    tool = tool_from_table(document["tool"], f"{where}: [tool]")
    part = Part(
        name=str(document.get("name", folder.name)),
        tool=tool,
        surfaces=surfaces,
        allowance=positive(stock, "allowance_mm", f"{where}: [stock]", 0.05) * 1e-3,
        origin=_vector(placement, "origin_mm", 3, f"{where}: [placement]", (0.0, 0.0, 0.0)) * 1e-3,
        rotation=rotation,
        stock_mesh=folder / str(stock["mesh"]) if "mesh" in stock else None,
        stock_unit=stock.get("unit"),
        folder=folder,
        notes=tuple(map(str, document.get("notes", ()))),
    )
    _check_tool(part, where)
    return part


def _check_tool(part: Part, where: str) -> None:
    """A tool wider than every surface is long is a slip of units."""
    sizes = [max(b - a for a, b in s.extent()) for s in part.surfaces if s.kind != "mesh"]
    if sizes and 2.0 * part.tool.radius > max(sizes):
        raise InputError(
            f"{where}: the tool ({part.tool.radius * 2e3:g} mm) is larger than the part "
            f"(longest side {max(sizes) * 1e3:g} mm); check the units of both"
        )


def _surface(table: Any, index: int, where: str) -> Surface:
    kind = table.get("kind") if isinstance(table, dict) else None
    if kind not in KINDS:
        raise InputError(f"{where}: kind = {kind!r}; {nearest(str(kind), KINDS)}")
    _known(table, COMMON | KEYS[kind], where)
    ranges = {}
    for key in ("zone_along_mm", "zone_across_mm"):
        ranges[key] = tuple(_vector(table, key, 2, where) * 1e-3) if key in table else None
        limits = ranges[key]
        if limits is not None and limits[0] >= limits[1]:
            raise InputError(f"{where}: {key} = {table[key]}: the first number must lie below the second")
    surface = Surface(
        name=str(table.get("name", f"surface {index + 1}")),
        kind=kind,
        table=table,
        spacing=positive(table, "spacing_mm", where, 0.25) * 1e-3,
        depth=positive(table, "depth_mm", where, 0.5) * 1e-3,
        zone_spacing=positive(table, "zone_um", where) * 1e-6 if "zone_um" in table else 0.0,
        zone_along=ranges["zone_along_mm"],
        zone_across=ranges["zone_across_mm"],
        zone_feed=positive(table, "zone_feed_m_per_min", where, 1.0) / 60.0,
    )
    if kind != "mesh":
        try:
            surface.extent()
        except KeyError as error:
            raise InputError(f"{where}: {error.args[0]} is missing; add it") from None
    return surface


def _samples(limits: tuple[float, float], spacing: float) -> np.ndarray:
    """Values between two limits with about this spacing, both limits included."""
    return np.linspace(*limits, max(2, round((limits[1] - limits[0]) / spacing) + 1))


def _profile_ends(table: Mapping[str, Any]) -> list[tuple[float, float, np.ndarray, float]]:
    """Start length, curvature (positive turns left), start point and start heading of each segment, and the end.

    A sharp corner has infinite curvature, and its turn in place of the heading.
    """
    at, point = 0.0, np.array(table["start_mm"], float) * 1e-3
    heading = rad_from_deg(float(table.get("heading_deg", 0.0)))
    out = []
    for segment in table["segments"]:
        turn = rad_from_deg(float(segment.get("turn_deg", 0.0)))
        radius = float(segment.get("radius_mm", 0.0)) * 1e-3
        length = abs(turn) * radius if "turn_deg" in segment else float(segment["length_mm"]) * 1e-3
        if length <= 0.0:
            # a sharp corner: remembered as a piece without length
            out.append((at, math.inf, point, turn))
            heading += turn
            continue
        curvature = math.copysign(1.0 / radius, turn) if "turn_deg" in segment else 0.0
        out.append((at, curvature, point, heading))
        point, heading = _along(point, heading, curvature, np.array([length])), heading + curvature * length
        point, at = point[0], at + length
    return [*out, (at, 0.0, point, heading)]


def _along(point: np.ndarray, heading: float, curvature: float, length: np.ndarray) -> np.ndarray:
    """Points (n, 2) on a line or arc at lengths (n,) from its start."""
    if curvature == 0.0:
        return point + length[:, None] * [math.cos(heading), math.sin(heading)]
    angle = heading + curvature * length
    return point + np.column_stack([np.sin(angle) - math.sin(heading), math.cos(heading) - np.cos(angle)]) / curvature


def _profile(table: Mapping[str, Any], u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward normals (row, column, 3): the material lies on the right of the profile."""
    ends = _profile_ends(table)
    corners = [e for e in ends if e[1] == math.inf]
    ends = [e for e in ends if e[1] != math.inf]
    starts = np.array([e[0] for e in ends[:-1]])
    index = np.clip(np.searchsorted(starts, u, side="right") - 1, 0, len(starts) - 1)
    flat, normal = np.empty((len(u), 2)), np.empty((len(u), 2))
    for i, (at, curvature, point, heading) in enumerate(ends[:-1]):
        mine = index == i
        flat[mine] = _along(point, heading, curvature, u[mine] - at)
        angle = heading + curvature * (u[mine] - at)
        for place, _, _, turn in corners:
            # beside an edge the nails lean towards its bisector: along the wall they would leave the part sideways
            near = np.clip(1.0 - np.abs(u[mine] - place) / EDGE_WIDTH, 0.0, 1.0)
            angle = angle + 0.5 * turn * near * np.where(at < place - 1e-12, 1.0, -1.0)
        normal[mine] = np.column_stack([-np.sin(angle), np.cos(angle)])
    first, second, across = PLANES[table["plane"]]
    points, directions = np.zeros((len(v), len(u), 3)), np.zeros((len(v), len(u), 3))
    for axis, column in ((first, 0), (second, 1)):
        points[..., axis], directions[..., axis] = flat[:, column], normal[:, column]
    points[..., across] = v[:, None]
    return points, directions


def _plane(table: Mapping[str, Any], u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a = _unit(table.get("u_direction", (1, 0, 0)))
    b = np.array(table.get("v_direction", (0, 1, 0)), float)
    b = _unit(b - (b @ a) * a)
    points = np.array(table.get("origin_mm", (0, 0, 0)), float) * 1e-3 + u[None, :, None] * a + v[:, None, None] * b
    return points, np.broadcast_to(np.cross(a, b), points.shape).copy()


def _sphere(table: Mapping[str, Any], u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """u along the azimuth at the middle polar angle, v along the polar angle (0 at the pole, +z), from the pole."""
    radius, middle = float(table["radius_mm"]) * 1e-3, rad_from_deg(sum(map(float, table["polar_deg"])) / 2.0)
    azimuth, polar = u[None, :] / (radius * math.sin(middle)), v[:, None] / radius
    direction = np.stack(
        np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth), axis=-1
    )
    return np.array(table["centre_mm"], float) * 1e-3 + radius * direction, direction


def _sphere_extent(table: Mapping[str, Any]) -> tuple[tuple[float, float], tuple[float, float]]:
    radius = float(table["radius_mm"]) * 1e-3
    polar, azimuth = ([rad_from_deg(float(a)) for a in table[key]] for key in ("polar_deg", "azimuth_deg"))
    around = radius * math.sin((polar[0] + polar[1]) / 2.0)
    return (azimuth[0] * around, azimuth[1] * around), (polar[0] * radius, polar[1] * radius)


def _pair(table: Mapping[str, Any], key: str) -> tuple[float, float]:
    low, high = (float(v) * 1e-3 for v in table[key])
    return low, high


_EVALUATE = {"profile": _profile, "plane": _plane, "sphere": _sphere}
_EXTENT = {
    "profile": lambda t: ((0.0, _profile_ends(t)[-1][0]), _pair(t, "across_mm")),
    "plane": lambda t: (_pair(t, "along_mm"), _pair(t, "across_mm")),
    "sphere": _sphere_extent,
}


def _unit(v: Sequence[float]) -> np.ndarray:
    direction = np.asarray(v, float)
    return direction / np.linalg.norm(direction)


def _vector(table: Mapping[str, Any], key: str, count: int, where: str, default: Sequence[float] | None = None) -> np.ndarray:
    try:
        value = np.array(table.get(key, default), float)
    except (TypeError, ValueError):
        value = np.zeros(0)
    if value.shape != (count,) or not np.all(np.isfinite(value)):
        raise InputError(f"{where}: {key} = {table.get(key)!r}; give {count} numbers")
    return value


def _known(table: Any, keys: set[str], where: str) -> None:
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: must be a table")
    for key in table:
        if key not in keys:
            raise InputError(f"{where}: unknown key '{key}'; {nearest(key, keys)}")
