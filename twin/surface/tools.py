"""Cutting tools as unions of convex elements around their axis, which points from the tip (z = 0) to the spindle.

    sphere     centre at height z, radius R
    frustum    from height z0 to z1, radius r0 growing by `slope` per height (0: a cylinder)
    rounded    a torus: spheres of radius r around a circle of radius Rm at height z

A ball-end is a sphere and a shaft, a flat end a shaft, a bull nose a torus with the disc inside it and a shaft, and any other tool of
revolution a stack of frustums along its profile. Lengths in m.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import itertools
import math
from typing import Annotated, Any

import numpy as np

from twin.errors import InputError
from twin.surface.sweep import FRUSTUM, ROUNDED, SPHERE
from twin.tables import Number, Positive, Table, Text, asks, typed_kind

DEFAULT_CUTTING_LENGTH = 0.04
ARC_CHORD = 2e-8
"""Largest distance between an arc of a profile and its chords [m]."""


@dataclass(frozen=True)
class Tool:
    """A tool of revolution.

    `elements` (element, 5): kind, height of the centre or lower end, height of the upper end, radius, slope (frustum) or
    radius of the rounding (rounded). `profile` (point, 2): radius and height of the outline, for plots and the size of the tool.
    `length`: spindle nose to tip, for the five-axis transformation.
    """

    name: str
    elements: np.ndarray
    profile: np.ndarray
    length: float

    @property
    def radius(self) -> float:
        """Largest radius [m]."""
        return float(self.profile[:, 0].max())

    @property
    def reach(self) -> float:
        """Height of the cutting part above the tip [m]."""
        return float(self.profile[:, 1].max())


def end_mill(diameter: float, corner: float, *, cutting_length: float = DEFAULT_CUTTING_LENGTH, length: float = 0.12) -> Tool:
    """A cylinder with an end of this corner radius: 0 for a flat end, the tool's radius for a ball end; the tip is the lowest point."""
    r = diameter / 2.0
    shaft = (FRUSTUM, corner, cutting_length, r, 0.0)
    if corner == 0.0:
        name, elements = f"flat end d{diameter * 1e3:g}", [shaft]
    elif corner == r:
        name, elements = f"ball-end d{diameter * 1e3:g}", [(SPHERE, r, r, r, 0.0), shaft]
    else:
        name, major = f"bull nose d{diameter * 1e3:g} r{corner * 1e3:g}", r - corner
        # the torus last: the other elements have then cut most of its region
        elements = [(FRUSTUM, 0.0, 2.0 * corner, major, 0.0), shaft, (ROUNDED, corner, corner, major, corner)]
    profile = _with_arcs([(0.0, 0.0), (r - corner, 0.0), (r, corner, corner), (r, cutting_length)])
    return Tool(name, np.array(elements), profile, length)


def revolution(profile: Sequence[Sequence[float]], *, name: str = "tool of revolution", length: float = 0.12, where: str = "tool") -> Tool:
    """Any tool by its outline: points (radius, height) from the tip upwards, with non-decreasing heights.

    A third number makes the segment to this point an arc of that radius: positive outwards, negative inwards.
    """
    points = _with_arcs(profile, where)
    if len(points) < 2 or np.any(points[:, 0] < 0.0) or np.any(np.diff(points[:, 1]) < 0.0) or points[:, 0].max() <= 0.0:
        raise InputError(
            f"{where}: the profile of '{name}' needs at least two points (radius, height) with radii of 0 or more and non-decreasing heights; reorder them"
        )
    points = points - [0.0, points[0, 1]]
    elements = []
    for (r0, z0), (r1, z1) in itertools.pairwise(points):
        if z1 - z0 > 1e-12:
            elements.append((FRUSTUM, z0, z1, r0, (r1 - r0) / (z1 - z0)))
    return Tool(name, np.array(elements), points, length)


class _ToolTable(Table, frozen=True, kw_only=True):
    kind: str
    name: Text | None = None
    length_mm: Positive = 120.0


class _EndMillTable(_ToolTable, frozen=True, kw_only=True):
    diameter_mm: Positive
    cutting_length_mm: Positive = DEFAULT_CUTTING_LENGTH * 1e3


class _BullTable(_EndMillTable, frozen=True, kw_only=True):
    corner_mm: Positive


class _RevolutionTable(_ToolTable, frozen=True, kw_only=True):
    profile_mm: Annotated[
        tuple[Annotated[tuple[Number, ...], asks(min_length=2, max_length=3)], ...],
        asks("give a list of [radius, height] or [radius, height, arc radius] in mm"),
    ]


TABLES: dict[str, type[_ToolTable]] = {"ball": _EndMillTable, "flat": _EndMillTable, "bull": _BullTable, "revolution": _RevolutionTable}
"""Models of the table [tool] by its kind."""


def tool_from_table(table: Any, where: str) -> Tool:
    """A tool from the table [tool] of a part file, with lengths in mm."""
    given = typed_kind(table, TABLES, where)
    length = given.length_mm * 1e-3
    if isinstance(given, _RevolutionTable):
        profile = [[v * 1e-3 for v in point] for point in given.profile_mm]
        return revolution(profile, name=given.name or "tool of revolution", length=length, where=where)
    assert isinstance(given, _EndMillTable)
    diameter, cutting = given.diameter_mm * 1e-3, given.cutting_length_mm * 1e-3
    if cutting < diameter / 2.0:
        raise InputError(f"{where}: cutting_length_mm = {cutting * 1e3:g} is below the tool's radius; make it longer")
    corner = diameter / 2.0 if given.kind == "ball" else 0.0
    if isinstance(given, _BullTable):
        corner = given.corner_mm * 1e-3
        if not corner < diameter / 2.0:
            raise InputError(
                f"{where}: corner_mm = {given.corner_mm:g} of a tool of diameter_mm = {given.diameter_mm:g}; give one between 0 and the tool's radius"
            )
    return end_mill(diameter, corner, cutting_length=cutting, length=length)


def _with_arcs(profile: Sequence[Sequence[float]], where: str = "tool") -> np.ndarray:
    """The profile (point, 2) with its arcs as chords."""
    points = [[float(profile[0][0]), float(profile[0][1])]] if len(profile) else []
    for point in profile[1:]:
        end = np.array(point[:2], float)
        if len(point) > 2 and point[2] != 0.0:
            start, radius = np.array(points[-1]), float(point[2])
            chord = end - start
            half = float(np.linalg.norm(chord)) / 2.0
            if not 0.0 < half <= abs(radius):
                raise InputError(
                    f"{where}: profile: an arc of radius {abs(radius) * 1e3:g} mm does not reach over {half * 2e3:g} mm; "
                    "give it two different ends, at most twice its radius apart"
                )
            # centre on the axis side for an outward arc, on the other side for an inward one
            across = np.array([-chord[1], chord[0]]) / (2.0 * half) * math.copysign(math.sqrt(radius**2 - half**2), radius)
            centre = (start + end) / 2.0 + across
            first, last = (math.atan2(*(p - centre)[::-1]) for p in (start, end))
            turn = (last - first + math.pi) % (2.0 * math.pi) - math.pi
            count = max(2, math.ceil(abs(turn) / math.sqrt(8.0 * ARC_CHORD / abs(radius))))
            angles = first + turn * np.arange(1, count) / count
            points += (centre + abs(radius) * np.column_stack([np.cos(angles), np.sin(angles)])).tolist()
        points.append(end.tolist())
    return np.array(points, float).reshape(-1, 2)
