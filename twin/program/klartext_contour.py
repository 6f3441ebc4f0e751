"""The contour of HEIDENHAIN Klartext: arcs about CC, by radius and tangent, polar points, and approach and departure (APPR, DEP)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program.control import Arc
from twin.program.expressions import WordError
from twin.program.state import LINEAR, Item, State


class Element(NamedTuple):
    """One element of the contour: its end (3,), and its arc in the plane or none."""

    point: np.ndarray
    arc: Arc | None


class Contour:
    """Makes elements in the coordinates of the program; `pole` (3,) is that of CC."""

    def __init__(self, state: State) -> None:
        self.state = state
        self.pole: np.ndarray | None = None

    def of_pole(self, column: int) -> np.ndarray:
        if self.pole is None:
            raise WordError("no pole is defined; add CC before", column)
        return self.pole

    def set_pole(self, start: np.ndarray, words: dict[str, Item], column: int) -> None:
        """CC with its coordinates in the plane, or at the last position."""
        new = start.copy()
        for name, (value, how, _) in words.items():
            i = LINEAR.index(name) if name in LINEAR else arcs.PLANES[self.state.plane][2]
            if i == arcs.PLANES[self.state.plane][2]:
                raise WordError(f"{name} does not lie in the plane of CC", column)
            new[i] = value * self.state.unit + (start[i] if how == "IC" else 0.0)
        if len(words) == 1 and self.pole is not None:  # the other coordinate stays
            other = next(i for i in arcs.PLANES[self.state.plane][:2] if LINEAR[i] not in words)
            new[other] = self.pole[other]
        self.pole = new

    def polar(self, start: np.ndarray, words: dict[str, Item], column: int, *, on_circle: bool = False) -> tuple[np.ndarray, float]:
        """Point (3,) of PR and PA about the pole, and the programmed angle of travel [deg], 0 if it is not incremental."""
        pole = self.of_pole(column)
        a, b, _ = arcs.PLANES[self.state.plane]
        arm = start[[a, b]] - pole[[a, b]]
        radius, angle, way = float(np.hypot(*arm)), math.degrees(math.atan2(arm[1], arm[0])), 0.0
        if "PR" in words:
            item = words.pop("PR")
            if on_circle:
                raise WordError("PR has no use in CP, whose radius is that of the start; remove it", item.column)
            radius = item.value * self.state.unit + (radius if item.how == "IC" else 0.0)
        if "PA" in words:
            item = words.pop("PA")
            way = item.value if item.how == "IC" else 0.0
            angle = angle + way if item.how == "IC" else item.value
        elif on_circle:
            raise WordError("CP needs its angle PA or IPA; add it", column)
        point = start.copy()
        point[a] = pole[a] + radius * math.cos(math.radians(angle))
        point[b] = pole[b] + radius * math.sin(math.radians(angle))
        return point, way

    def circle(self, start: np.ndarray, point: np.ndarray, sense: int, way: float = 0.0, column: int = 1) -> Element:
        """C and CP: the arc about the pole; `way` [deg] of an incremental angle gives its turns."""
        if way and (way > 0) != (sense > 0):
            raise WordError("IPA and DR of CP must have the same sign; correct one", column)
        turns = max(0, math.ceil(abs(way) / 360.0 - 1e-9) - 1)
        return Element(point, (self.of_pole(column), sense < 0, turns))

    def direction(self, element: Element, start: np.ndarray) -> np.ndarray | None:
        """Unit vector (3,) in the plane of the motion at its start; None without motion there."""
        way = element.point - start
        if element.arc is not None:
            way = self._left(start - element.arc[0]) * (-1.0 if element.arc[1] else 1.0)
        way[arcs.PLANES[self.state.plane][2]] = 0.0
        length = float(np.linalg.norm(way))
        return way / length if length > 1e-12 else None

    def by_radius(self, start: np.ndarray, point: np.ndarray, radius: float, sense: int) -> Element:
        """CR: R above 0 gives less than half a circle, R below 0 more."""
        plane = self.state.plane
        centre = arcs.centre_from_radius(start, point, radius, plane, sense < 0)
        return Element(point, (centre, sense < 0, 0))

    def tangent(self, start: np.ndarray, point: np.ndarray, direction: np.ndarray | None) -> Element:
        """CT and CTP: the arc that goes on in the direction of the last element."""
        if direction is None:
            raise WordError("CT needs a contour element before it, whose direction it continues", 1)
        centre, normal, _ = arcs.tangential(start, direction, point, self.state.plane)
        return Element(point, (centre, bool(normal.sum() < 0.0), 0))

    # ------------------------------------------------------------------ approach and departure

    def _left(self, t: np.ndarray) -> np.ndarray:
        a, b, _ = arcs.PLANES[self.state.plane]
        left = np.zeros(3)
        left[a], left[b] = -t[b], t[a]
        return left

    def _turn(self, arm: np.ndarray, angle: float) -> np.ndarray:
        flat = arm.copy()
        flat[arcs.PLANES[self.state.plane][2]] = 0.0
        return math.cos(angle) * flat + math.sin(angle) * self._left(flat)

    def way_in(
        self, kind: str, start: np.ndarray, to: np.ndarray, t: np.ndarray, side: int, radius: float, words: dict[str, Item]
    ) -> tuple[np.ndarray, Arc | None]:
        """Auxiliary point (3,) from which the tool comes to the contour at `to` (3,) in the direction `t`, and the arc from it.

        `side` 1: the tool is to the left of the contour (RL), -1 to the right; `radius` of the tool [m].
        """
        unit = self.state.unit
        if kind in ("LT", "LN"):
            length = words.pop("LEN").value * unit
            return (to - length * t if kind == "LT" else to + side * self._left(t) * (length + radius)), None
        arc_radius = words.pop("R").value * unit
        sense = 1.0 if side * arc_radius > 0 else -1.0
        centre = to + sense * abs(arc_radius) * self._left(t)
        if kind == "CT":
            begin = centre + self._turn(to - centre, -sense * math.radians(words.pop("CCA").value))
        else:
            begin = self._from_line(start, centre, abs(arc_radius), sense)
        begin[arcs.PLANES[self.state.plane][2]] = to[arcs.PLANES[self.state.plane][2]]
        return begin, (centre, sense < 0.0, 0)

    def way_out(
        self, kind: str, at: np.ndarray, to: np.ndarray, t: np.ndarray, side: int, radius: float, words: dict[str, Item]
    ) -> tuple[np.ndarray, Arc | None]:
        """Point (3,) to which the tool leaves the contour from `at` (3,), and the arc to it; the mirror image of `way_in`."""
        begin, arc = self.way_in(kind, to, at, -t, -side, radius, words)
        return begin, None if arc is None else (arc[0], not arc[1], 0)

    def _from_line(self, start: np.ndarray, centre: np.ndarray, radius: float, sense: float) -> np.ndarray:
        """Where a line from `start` meets the circle as its tangent in the sense of the motion, 1 counter-clockwise."""
        a, b, _ = arcs.PLANES[self.state.plane]
        way = np.zeros(3)
        way[[a, b]] = (start - centre)[[a, b]]
        distance = float(np.linalg.norm(way))
        if distance <= radius:
            raise WordError("the start lies inside the circle of the approach or departure; give a smaller R or another point", 1)
        turn = math.acos(radius / distance)
        arms = [self._turn(way * (radius / distance), sign * turn) for sign in (1.0, -1.0)]
        return centre + max(arms, key=lambda arm: float((arm - way) @ (sense * self._left(arm))))
