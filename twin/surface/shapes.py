"""Nominal surfaces, the tables [[surface]] of a part file: points and outward normals (row, column, 3) over u (column,) along and v (row,) across.

    profile    a chain of lines, arcs and sharp corners in a plane, material on the right, extruded along the plane's normal
    plane      origin + u a + v b, normal a x b
    sphere     u along the azimuth at the middle polar angle, v along the polar angle (0 at the pole, +z)
    mesh       a file without u and v (twin.surface.mesh)

Keys hold lengths in mm and angles in degrees, as the file does; methods and properties give m and rad.
"""

from abc import abstractmethod
from collections.abc import Sequence
import math
from pathlib import Path
from typing import Annotated, Literal, Self

from msgspec.structs import replace
import numpy as np

from twin.documents import LARGEST_NUMBER, named_file
from twin.errors import InputError
from twin.limits import refuse_above
from twin.surface.height_rays import HeightRays, grid_rays
from twin.surface.mesh import Placed, mesh_rays
from twin.tables import Number, Positive, Table, Text, asks

MOST_RAYS = 4_000_000
"""Most rays of a surface or zone; pictures and files of more would not fit into memory."""

EDGE_WIDTH = 0.5e-3
"""The rays tilt towards the bisector of a sharp edge within this width beside it [m]; deviations there are up to 1 / cos(turn / 2) larger."""
PLANES = {"xz": (0, 2, 1), "xy": (0, 1, 2), "yz": (1, 2, 0)}
"""Axes of a profile's plane, and its normal axis."""
FLATTEST = 1e-6
"""Least sine of the angle between two directions that span a plane."""

Limits = tuple[float, float]
Ends = Annotated[tuple[Number, Number], asks("give a list of 2 numbers, the first less than the second")]
Vector = tuple[Number, Number, Number]


class Surface(Table, frozen=True, kw_only=True):
    """One nominal surface with its sampling.

    Without `zone_um` there is no finer zone. `zone_along_mm`, `zone_across_mm`: its range in u and v; None: the surface cut by motion faster than
    `zone_feed_m_per_min`, plus a margin.
    """

    kind: str
    name: Text = ""
    spacing_mm: Positive = 0.25
    depth_mm: Positive = 0.5
    zone_um: Positive | None = None
    zone_along_mm: Ends | None = None
    zone_across_mm: Ends | None = None
    zone_feed_m_per_min: Positive = 1.0

    def checked(self, folder: Path, where: str) -> Self:
        """The surface with its file, which is relative to `folder`. Raises InputError for an impossible shape."""
        for key in ("zone_along_mm", "zone_across_mm", "along_mm", "across_mm", "azimuth_deg", "polar_deg"):
            if (ends := getattr(self, key, None)) is not None and ends[0] >= ends[1]:
                raise InputError(f"{where}: {key} = {list(ends)}: the first number must be less than the second; correct them")
        self.check(where)
        return self

    def check(self, where: str) -> None:
        """Raise InputError for an impossible shape."""

    @property
    def zone_feed(self) -> float:
        """Feed above which the surface is in the zone [m/s]."""
        return self.zone_feed_m_per_min / 60.0

    @abstractmethod
    def rays(self, placed: Placed, allowance: float) -> HeightRays:
        """Uncut rays of the whole surface, `placed` in the part frame of the machine, with `allowance` [m] of material."""


class GridSurface(Surface, frozen=True, kw_only=True):
    """A surface with u and v, whose rays stand on a grid of them."""

    @property
    @abstractmethod
    def extent(self) -> tuple[Limits, Limits]:
        """Ranges of u and v."""

    @abstractmethod
    def normals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals."""

    @property
    def zone(self) -> tuple[Limits | None, Limits | None]:
        """Given ranges of the zone in u and v."""
        return self.zone_along_mm and metres(self.zone_along_mm), self.zone_across_mm and metres(self.zone_across_mm)

    def rays(
        self, placed: Placed, allowance: float, spacing: float | None = None, along: Limits | None = None, across: Limits | None = None
    ) -> HeightRays:
        """Uncut rays of the whole surface, or of a range of u and v."""
        spacing, (whole_u, whole_v) = spacing or self.spacing_mm * 1e-3, self.extent
        ranges = (along or whole_u, across or whole_v)
        self._check_number(spacing, [high - low for low, high in ranges])
        u, v = (np.linspace(low, high, max(2, round((high - low) / spacing) + 1)) for low, high in ranges)
        return grid_rays(self.name, *placed(*self.normals(u, v)), u, v, allowance, self.depth_mm * 1e-3)

    def check_rays(self, zone_spacing: float | None, zone_least: float) -> None:
        """Refuse spacings with too many rays before the simulation; an automatic zone has at least `zone_least` [m] of length and width."""
        whole = [high - low for low, high in self.extent]
        self._check_number(self.spacing_mm * 1e-3, whole)
        if self.zone_um:
            lengths = [r[1] - r[0] if r else min(zone_least, w) for r, w in zip(self.zone, whole, strict=True)]
            self._check_number(zone_spacing or self.zone_um * 1e-6, lengths)

    def _check_number(self, spacing: float, lengths: Sequence[float]) -> None:
        """Refuse a grid of more than `MOST_RAYS`."""
        rays = math.prod(max(2.0, length / spacing + 1.0) for length in lengths)
        where, remedy = f"surface '{self.name}'", "enlarge spacing_mm or zone_um, or make the zone smaller"
        refuse_above(rays, MOST_RAYS, f"rays at {spacing * 1e6:g} um", where, remedy)


class _SegmentTable(Table, frozen=True):
    length_mm: Positive | None = None
    radius_mm: Annotated[float, asks("give 0 or more, the sign of turn_deg sets the direction", ge=0.0, le=LARGEST_NUMBER)] | None = None
    turn_deg: Number | None = None

    @property
    def segment(self) -> tuple[float, float, float]:
        """Length, curvature (0: a line, above 0: an arc to the left) and change of heading; a sharp corner has no length."""
        if self.turn_deg is None:
            return (self.length_mm or 0.0) * 1e-3, 0.0, 0.0
        turn, radius = math.radians(self.turn_deg), (self.radius_mm or 0.0) * 1e-3
        return abs(turn) * radius, math.copysign(1.0 / radius, turn) if radius else 0.0, turn


class Profile(GridSurface, frozen=True, kw_only=True):
    """Segments in a plane of PLANES from a start in the direction of a heading."""

    plane: Literal["xz", "xy", "yz"]
    start_mm: tuple[Number, Number]
    segments: tuple[_SegmentTable, ...]
    across_mm: Ends
    heading_deg: Number = 0.0

    def check(self, where: str) -> None:
        for i, one in enumerate(self.segments):
            if (one.turn_deg is None) == (one.length_mm is None) or (one.radius_mm is not None and one.turn_deg is None):
                raise InputError(
                    f"{where}: segments {i + 1}: give length_mm for a line, radius_mm and turn_deg for an arc, turn_deg for a corner"
                )
        if self.extent[0][1] == 0.0:
            raise InputError(f"{where}: segments: none has a length; give lines or arcs, such as [{{ length_mm = 12 }}]")

    @property
    def extent(self) -> tuple[Limits, Limits]:
        return (0.0, sum(s.segment[0] for s in self.segments)), metres(self.across_mm)

    def normals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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
        points[..., [first, second]], directions[..., [first, second]] = flat, normal
        points[..., across] = v[:, None]
        return points, directions

    def _pieces(self) -> tuple[list[tuple[float, float, np.ndarray, float]], list[tuple[float, float]]]:
        """Start length, curvature, start point and heading of each line and arc; position and turn of each sharp corner."""
        at, point, heading = 0.0, np.array(self.start_mm) * 1e-3, math.radians(self.heading_deg)
        pieces: list[tuple[float, float, np.ndarray, float]] = []
        corners: list[tuple[float, float]] = []
        for length, curvature, turn in (one.segment for one in self.segments):
            if length == 0.0:
                corners.append((at, turn))
                heading += turn
                continue
            pieces.append((at, curvature, point, heading))
            point, heading = _along(point, heading, curvature, np.array([length]))[0], heading + curvature * length
            at += length
        return pieces, corners


class Plane(GridSurface, frozen=True, kw_only=True):
    """A rectangle with u along one direction and v along the other, as far as it is at right angles to it."""

    along_mm: Ends
    across_mm: Ends
    origin_mm: Vector = (0.0, 0.0, 0.0)
    u_direction: Vector = (1.0, 0.0, 0.0)
    v_direction: Vector = (0.0, 1.0, 0.0)

    def check(self, where: str) -> None:
        a, b = np.array(self.u_direction), np.array(self.v_direction)
        if np.linalg.norm(np.cross(a, b)) <= FLATTEST * np.linalg.norm(a) * np.linalg.norm(b):
            raise InputError(
                f"{where}: u_direction = {a.tolist()} and v_direction = {b.tolist()} span no plane; give two directions that are not parallel"
            )

    @property
    def extent(self) -> tuple[Limits, Limits]:
        return metres(self.along_mm), metres(self.across_mm)

    def normals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        a, b = _unit(np.array(self.u_direction)), np.array(self.v_direction)
        b = _unit(b - (b @ a) * a)
        points = np.array(self.origin_mm) * 1e-3 + u[None, :, None] * a + v[:, None, None] * b
        return points, np.broadcast_to(np.cross(a, b), points.shape).copy()


class Sphere(GridSurface, frozen=True, kw_only=True):
    """A part of a sphere between two azimuths and two polar angles."""

    centre_mm: Vector
    radius_mm: Positive
    azimuth_deg: Ends
    polar_deg: Ends

    def check(self, where: str) -> None:
        if self.polar_deg[0] < 0.0 or self.polar_deg[1] > 180.0:
            raise InputError(f"{where}: polar_deg = {list(self.polar_deg)}; give angles from 0 (pole at +z) to 180")

    @property
    def _radii(self) -> tuple[float, float]:
        """Radius of the circle of u, and that of v [m]."""
        radius = self.radius_mm * 1e-3
        return radius * math.sin(math.radians(sum(self.polar_deg) / 2.0)), radius

    @property
    def extent(self) -> tuple[Limits, Limits]:
        (around, radius), (a, b), (c, d) = self._radii, self.azimuth_deg, self.polar_deg
        return (around * math.radians(a), around * math.radians(b)), (radius * math.radians(c), radius * math.radians(d))

    def normals(self, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        around, radius = self._radii
        azimuth, polar = u[None, :] / around, v[:, None] / radius
        direction = np.stack(
            np.broadcast_arrays(np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0.0 * azimuth), axis=-1
        )
        return np.array(self.centre_mm) * 1e-3 + radius * direction, direction


class MeshSurface(Surface, frozen=True, kw_only=True):
    """A mesh file; without `unit` it is guessed from the size. The mesh is checked when it is read."""

    file: str
    unit: str | None = None

    def checked(self, folder: Path, where: str) -> Self:
        return replace(super().checked(folder, where), file=str(named_file(self.file, folder, f"{where}: file", outer=True)))

    def rays(self, placed: Placed, allowance: float) -> HeightRays:
        """Rays at the vertices, in the part frame of the machine."""
        return mesh_rays(self.name, Path(self.file), self.unit, self.spacing_mm * 1e-3, placed, allowance, self.depth_mm * 1e-3)


KINDS: dict[str, type[Surface]] = {"profile": Profile, "plane": Plane, "sphere": Sphere, "mesh": MeshSurface}
"""Tables [[surface]] by their kind."""


def metres(ends: Limits) -> Limits:
    """Two numbers in mm, in m."""
    return ends[0] * 1e-3, ends[1] * 1e-3


def _along(point: np.ndarray, heading: float, curvature: float, length: np.ndarray) -> np.ndarray:
    """Points (n, 2) on a line or arc at lengths (n,) from its start."""
    if curvature == 0.0:
        return point + length[:, None] * [math.cos(heading), math.sin(heading)]
    angle = heading + curvature * length
    return point + np.column_stack([np.sin(angle) - math.sin(heading), math.cos(heading) - np.cos(angle)]) / curvature


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
