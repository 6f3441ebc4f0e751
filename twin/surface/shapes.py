"""Shapes of nominal surfaces: points and outward normals (row, column, 3) over u (column,) along and v (row,) across [m].

    profile    a chain of lines, arcs and sharp corners in a plane, material on the right, extruded along the plane's normal
    plane      origin + u a + v b, normal a x b
    sphere     u along the azimuth at the middle polar angle, v along the polar angle (0 at the pole, +z)
    mesh       a file without u and v (twin.surface.mesh)

Tables give lengths in mm and angles in degrees; here they are in m and rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twin.documents import outer_file
from twin.errors import InputError
from twin.tables import known, limits, listed, number, numbers, positive, text
from twin.units import rad_from_deg

KEYS = {
    "profile": {"plane", "start_mm", "heading_deg", "segments", "across_mm"},
    "plane": {"origin_mm", "u_direction", "v_direction", "along_mm", "across_mm"},
    "sphere": {"centre_mm", "radius_mm", "azimuth_deg", "polar_deg"},
    "mesh": {"file", "unit"},
}
KINDS = tuple(KEYS)
EDGE_WIDTH = 0.5e-3
"""Width beside a sharp edge over which the rays tilt towards its bisector [m]; deviations there are up to 1 / cos(turn / 2) larger."""
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


def shape_of(table: Mapping[str, Any], kind: str, folder: Path, where: str) -> Profile | Plane | Sphere | MeshFile:
    """The checked shape of a table [[surface]]; file paths are relative to `folder`."""
    match kind:
        case "profile":
            return _profile(table, where)
        case "plane":
            return _plane(table, where)
        case "sphere":
            return _sphere(table, where)
    return mesh_file(table, "file", folder, where)


def mesh_file(table: Mapping[str, Any], key: str, folder: Path, where: str) -> MeshFile:
    """The mesh file under `key` of a table, with its unit."""
    path = outer_file(text(table, key, where), folder, f"{where}: {key}")
    return MeshFile(path, text(table, "unit", where) if "unit" in table else None)


def _profile(table: Mapping[str, Any], where: str) -> Profile:
    plane = text(table, "plane", where)
    if plane not in PLANES:
        raise InputError(f"{where}: plane = {plane!r}; use one of {', '.join(PLANES)}")
    segments = listed(table, "segments", where)
    profile = Profile(
        plane=plane,
        start=numbers(table, "start_mm", 2, where) * 1e-3,
        heading=rad_from_deg(number(table, "heading_deg", where, 0.0)),
        segments=tuple(_segment(segment, f"{where}: segment {i + 1}") for i, segment in enumerate(segments)),
        across=limits(table, "across_mm", where),
    )
    if profile.extent[0][1] == 0.0:
        raise InputError(f"{where}: segments = {segments}: none has a length; give lines or arcs, such as [{{ length_mm = 12 }}]")
    return profile


def _segment(table: Any, where: str) -> Segment:
    """A line, an arc, or a sharp corner (a turn without radius)."""
    known(table, ("length_mm", "radius_mm", "turn_deg"), where)
    if ("turn_deg" in table) == ("length_mm" in table) or ("radius_mm" in table and "turn_deg" not in table):
        raise InputError(f"{where}: {dict(table)}; give length_mm for a line, radius_mm and turn_deg for an arc, turn_deg for a corner")
    if "length_mm" in table:
        return Segment(positive(table, "length_mm", where) * 1e-3, 0.0, 0.0)
    turn, radius = rad_from_deg(number(table, "turn_deg", where)), number(table, "radius_mm", where, 0.0) * 1e-3
    if radius < 0.0:
        raise InputError(f"{where}: radius_mm = {table['radius_mm']}; give 0 or more, the sign of turn_deg sets the direction")
    return Segment(abs(turn) * radius, math.copysign(1.0 / radius, turn) if radius else 0.0, turn)


def _plane(table: Mapping[str, Any], where: str) -> Plane:
    a, b = (numbers(table, key, 3, where, default) for key, default in (("u_direction", (1, 0, 0)), ("v_direction", (0, 1, 0))))
    if np.linalg.norm(np.cross(a, b)) <= FLATTEST * np.linalg.norm(a) * np.linalg.norm(b):
        raise InputError(
            f"{where}: u_direction = {a.tolist()} and v_direction = {b.tolist()} span no plane; give two directions that are not parallel"
        )
    a = _unit(a)
    return Plane(
        origin=numbers(table, "origin_mm", 3, where, (0, 0, 0)) * 1e-3,
        a=a,
        b=_unit(b - (b @ a) * a),
        extent=(limits(table, "along_mm", where), limits(table, "across_mm", where)),
    )


def _sphere(table: Mapping[str, Any], where: str) -> Sphere:
    polar = limits(table, "polar_deg", where, "deg")
    if polar[0] < 0.0 or polar[1] > math.pi:
        raise InputError(f"{where}: polar_deg = {table['polar_deg']}; give angles from 0 (pole at +z) to 180")
    return Sphere(
        centre=numbers(table, "centre_mm", 3, where) * 1e-3,
        radius=positive(table, "radius_mm", where) * 1e-3,
        azimuth=limits(table, "azimuth_deg", where, "deg"),
        polar=polar,
    )


def _along(point: np.ndarray, heading: float, curvature: float, length: np.ndarray) -> np.ndarray:
    """Points (n, 2) on a line or arc at lengths (n,) from its start."""
    if curvature == 0.0:
        return point + length[:, None] * [math.cos(heading), math.sin(heading)]
    angle = heading + curvature * length
    return point + np.column_stack([np.sin(angle) - math.sin(heading), math.cos(heading) - np.cos(angle)]) / curvature


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
