"""Shapes of nominal surfaces: points and outward normals (row, column, 3) over u (column,) along and v (row,) across [m].

    profile    a chain of lines, arcs and sharp corners in a plane, material on the right, extruded along the plane's normal
    plane      origin + u a + v b, normal a x b
    sphere     u along the azimuth at the middle polar angle, v along the polar angle (0 at the pole, +z)
    mesh       a file without u and v (twin.surface.mesh)

Tables give lengths in mm and angles in degrees; here they are in m and rad.
"""

from __future__ import annotations

from dataclasses import dataclass
import math
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np

from twin.documents import outer_file
from twin.errors import InputError
from twin.tables import LARGEST, Number, Positive, Table, Text, asks
from twin.units import UNITS, rad_from_deg

EDGE_WIDTH = 0.5e-3
"""The rays tilt towards the bisector of a sharp edge within this width beside it [m]; deviations there are up to 1 / cos(turn / 2) larger."""
PLANES = {"xz": (0, 2, 1), "xy": (0, 1, 2), "yz": (1, 2, 0)}
"""Axes of a profile's plane, and its normal axis."""
FLATTEST = 1e-6
"""Least sine of the angle between two directions that span a plane."""

Limits = tuple[float, float]


class Segment(NamedTuple):
    """A line (curvature 0), an arc (curvature > 0: left) or, without length, a sharp corner; `turn` is the change of heading."""

    length: float
    curvature: float
    turn: float


@dataclass(frozen=True)
class Profile:
    """Segments in a plane of PLANES from `start` (2,) in direction `heading`; `across` is the range of v."""

    plane: str
    start: np.ndarray
    heading: float
    segments: tuple[Segment, ...]
    across: Limits

    @property
    def extent(self) -> tuple[Limits, Limits]:
        """Ranges of u and v."""
        return (0.0, sum(s.length for s in self.segments)), self.across

    def rays(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals; the point between two segments belongs to the second one."""
        pieces, corners = self._pieces()
        starts = np.array([at for at, *_ in pieces])
        index = np.clip(np.searchsorted(starts, u, side="right") - 1, 0, len(starts) - 1)
        flat, normal = np.empty((len(u), 2)), np.empty((len(u), 2))
        for i, (at, curvature, point, heading) in enumerate(pieces):
            mine = index == i
            flat[mine] = _along(point, heading, curvature, u[mine] - at)
            angle = heading + curvature * (u[mine] - at)
            for place, turn in corners:
                # tilt towards the bisector beside an edge, so that rays do not leave the part sideways
                near = np.clip(1.0 - np.abs(u[mine] - place) / EDGE_WIDTH, 0.0, 1.0)
                angle = angle + 0.5 * turn * near * np.where(at < place - 1e-12, 1.0, -1.0)
            normal[mine] = np.column_stack([-np.sin(angle), np.cos(angle)])
        first, second, across = PLANES[self.plane]
        points, directions = np.zeros((len(v), len(u), 3)), np.zeros((len(v), len(u), 3))
        for axis, column in ((first, 0), (second, 1)):
            points[..., axis], directions[..., axis] = flat[:, column], normal[:, column]
        points[..., across] = v[:, None]
        return points, directions

    def _pieces(self) -> tuple[list[tuple[float, float, np.ndarray, float]], list[tuple[float, float]]]:
        """Start length, curvature, start point and heading of each line and arc; position and turn of each sharp corner."""
        at, point, heading = 0.0, self.start, self.heading
        pieces: list[tuple[float, float, np.ndarray, float]] = []
        corners: list[tuple[float, float]] = []
        for length, curvature, turn in self.segments:
            if length == 0.0:
                corners.append((at, turn))
                heading += turn
                continue
            pieces.append((at, curvature, point, heading))
            point, heading = _along(point, heading, curvature, np.array([length]))[0], heading + curvature * length
            at += length
        return pieces, corners


@dataclass(frozen=True)
class Plane:
    """A rectangle: `origin` (3,), unit directions `a`, `b` (3,) at right angles, ranges of u along a and v along b."""

    origin: np.ndarray
    a: np.ndarray
    b: np.ndarray
    extent: tuple[Limits, Limits]

    def rays(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals."""
        points = self.origin + u[None, :, None] * self.a + v[:, None, None] * self.b
        return points, np.broadcast_to(np.cross(self.a, self.b), points.shape).copy()


@dataclass(frozen=True)
class Sphere:
    """A part of a sphere between two azimuths and two polar angles."""

    centre: np.ndarray
    radius: float
    azimuth: Limits
    polar: Limits

    @property
    def _around(self) -> float:
        """Radius of the circle of u."""
        return self.radius * math.sin(sum(self.polar) / 2.0)

    @property
    def extent(self) -> tuple[Limits, Limits]:
        """Ranges of u and v."""
        (first, last), (low, high) = self.azimuth, self.polar
        return (first * self._around, last * self._around), (low * self.radius, high * self.radius)

    def rays(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals."""
        azimuth, polar = u[None, :] / self._around, v[:, None] / self.radius
        direction = np.stack(
            np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth), axis=-1
        )
        return self.centre + self.radius * direction, direction


@dataclass(frozen=True)
class MeshFile:
    """A mesh file; `unit` None: guessed from the size."""

    path: Path
    unit: str | None


Ends = Annotated[tuple[Number, Number], asks("give a list of 2 numbers, the first less than the second")]
Vector = tuple[Number, Number, Number]


class SurfaceTable(Table, frozen=True, kw_only=True):
    """The keys that every table [[surface]] has. Each kind makes its checked shape of a folder, which its file paths are relative to."""

    kind: str
    name: Text | None = None
    spacing_mm: Positive = 0.25
    depth_mm: Positive = 0.5
    zone_um: Positive | None = None
    zone_along_mm: Ends | None = None
    zone_across_mm: Ends | None = None
    zone_feed_m_per_min: Positive = 1.0


class _SegmentTable(Table, frozen=True):
    length_mm: Positive | None = None
    radius_mm: Annotated[float, asks("give 0 or more, the sign of turn_deg sets the direction", ge=0.0, le=LARGEST)] | None = None
    turn_deg: Number | None = None

    def segment(self, where: str) -> Segment:
        """A line, an arc, or a sharp corner (a turn without radius)."""
        if (self.turn_deg is None) == (self.length_mm is None) or (self.radius_mm is not None and self.turn_deg is None):
            raise InputError(f"{where}: give length_mm for a line, radius_mm and turn_deg for an arc, turn_deg for a corner")
        if self.turn_deg is None:
            return Segment((self.length_mm or 0.0) * 1e-3, 0.0, 0.0)
        turn, radius = rad_from_deg(self.turn_deg), (self.radius_mm or 0.0) * 1e-3
        return Segment(abs(turn) * radius, math.copysign(1.0 / radius, turn) if radius else 0.0, turn)


class _ProfileTable(SurfaceTable, frozen=True, kw_only=True):
    plane: Literal["xz", "xy", "yz"]
    start_mm: tuple[Number, Number]
    segments: tuple[_SegmentTable, ...]
    across_mm: Ends
    heading_deg: Number = 0.0

    def shape(self, folder: Path, where: str) -> Profile:
        segments = tuple(table.segment(f"{where}: segments {i + 1}") for i, table in enumerate(self.segments))
        start, across = np.array(self.start_mm) * 1e-3, limits(self.across_mm, "across_mm", where)
        profile = Profile(self.plane, start, rad_from_deg(self.heading_deg), segments, across)
        if profile.extent[0][1] == 0.0:
            raise InputError(f"{where}: segments: none has a length; give lines or arcs, such as [{{ length_mm = 12 }}]")
        return profile


class _PlaneTable(SurfaceTable, frozen=True, kw_only=True):
    along_mm: Ends
    across_mm: Ends
    origin_mm: Vector = (0.0, 0.0, 0.0)
    u_direction: Vector = (1.0, 0.0, 0.0)
    v_direction: Vector = (0.0, 1.0, 0.0)

    def shape(self, folder: Path, where: str) -> Plane:
        a, b = np.array(self.u_direction), np.array(self.v_direction)
        if np.linalg.norm(np.cross(a, b)) <= FLATTEST * np.linalg.norm(a) * np.linalg.norm(b):
            raise InputError(
                f"{where}: u_direction = {a.tolist()} and v_direction = {b.tolist()} span no plane; give two directions that are not parallel"
            )
        a = _unit(a)
        extent = limits(self.along_mm, "along_mm", where), limits(self.across_mm, "across_mm", where)
        return Plane(np.array(self.origin_mm) * 1e-3, a, _unit(b - (b @ a) * a), extent)


class _SphereTable(SurfaceTable, frozen=True, kw_only=True):
    centre_mm: Vector
    radius_mm: Positive
    azimuth_deg: Ends
    polar_deg: Ends

    def shape(self, folder: Path, where: str) -> Sphere:
        polar, azimuth = limits(self.polar_deg, "polar_deg", where, "deg"), limits(self.azimuth_deg, "azimuth_deg", where, "deg")
        if polar[0] < 0.0 or polar[1] > math.pi:
            raise InputError(f"{where}: polar_deg = {list(self.polar_deg)}; give angles from 0 (pole at +z) to 180")
        return Sphere(np.array(self.centre_mm) * 1e-3, self.radius_mm * 1e-3, azimuth, polar)


class _MeshTable(SurfaceTable, frozen=True, kw_only=True):
    file: str
    unit: str | None = None

    def shape(self, folder: Path, where: str) -> MeshFile:
        return MeshFile(outer_file(self.file, folder, f"{where}: file"), self.unit)


_AnyTable = _ProfileTable | _PlaneTable | _SphereTable | _MeshTable
TABLES: dict[str, type[_AnyTable]] = {"profile": _ProfileTable, "plane": _PlaneTable, "sphere": _SphereTable, "mesh": _MeshTable}
"""Models of the tables [[surface]] by their kind."""


def limits(ends: tuple[float, float], key: str, where: str, unit: str = "mm") -> Limits:
    """Two increasing numbers in `unit`, in SI."""
    low, high = ends
    if low >= high:
        raise InputError(f"{where}: {key} = {list(ends)}: the first number must be less than the second; correct them")
    return low * UNITS[unit][1], high * UNITS[unit][1]


def _along(point: np.ndarray, heading: float, curvature: float, length: np.ndarray) -> np.ndarray:
    """Points (n, 2) on a line or arc at lengths (n,) from its start."""
    if curvature == 0.0:
        return point + length[:, None] * [math.cos(heading), math.sin(heading)]
    angle = heading + curvature * length
    return point + np.column_stack([np.sin(angle) - math.sin(heading), math.cos(heading) - np.cos(angle)]) / curvature


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
