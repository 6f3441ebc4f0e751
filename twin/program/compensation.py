"""Cutter radius compensation (G41, G42): the path of the tool centre at a distance from the programmed contour.

Each element is moved sideways by the radius. At an outside corner the tool goes round the corner on an arc (G450, and
ISO) or to the point where the moved elements meet (G451); at an inside corner both are cut where they meet. An inside corner
that the tool cannot reach is an error, so nothing is gouged. Moves without motion in the plane are made where the tool stands.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
import math
from typing import Any

import numpy as np

from twin.program.expressions import WordError

TINY = 1e-9
"""Shorter lengths count as zero [m]."""
SMOOTH = 1e-6
"""Elements whose directions differ by less than this join smoothly [rad]."""
GOUGE = 1e-6
"""Tolerance for corners that are due to rounded numbers in the program [m]: largest cut into an inside corner, and shortest arc about an
outside corner."""
BACK = 0.05
"""At a corner closer than this to a full reversal, the second element may cross the first and change sides [rad]."""


@dataclass
class Element:
    """One move in program coordinates: `a`, `b` in the plane [m], `low`, `high` across it; `centre` and `sense` (1 ccw) of an arc.

    `move`: data that the reader needs to emit the move; `behind`: following moves without motion in the plane; `whole`: a full circle,
    which ends at its start.
    """

    a: np.ndarray
    b: np.ndarray
    across: tuple[float, float]
    centre: np.ndarray | None
    sense: int
    turns: int
    move: Any
    behind: list[Any] = field(default_factory=list)
    whole: bool = False

    def direction(self, at_end: bool) -> np.ndarray:
        """Unit vector of the motion at an end."""
        if self.centre is None:
            way = self.b - self.a
        else:
            arm = (self.b if at_end else self.a) - self.centre
            way = self.sense * np.array([-arm[1], arm[0]])
        return way / np.hypot(*way)


def _left(t: np.ndarray) -> np.ndarray:
    return np.array([-t[1], t[0]])


def moved(e: Element, offset: float) -> Element:
    """The element shifted by `offset` to its left."""
    a, b = (p + offset * _left(e.direction(end)) for p, end in ((e.a, False), (e.b, True)))
    if e.centre is not None and np.hypot(*(e.a - e.centre)) - e.sense * offset < TINY:
        raise WordError("the radius of the arc is smaller than that of the tool on its inside; use a smaller tool")
    return replace(e, a=a, b=b)


class Compensation:
    """The elements between G41 or G42 and G40; `emit` is called with each finished element."""

    def __init__(self, offset: float, tool_radius: float, emit: Callable[[Element], None], *, along_next: bool, corners_meet: bool) -> None:
        self.offset, self.tool_radius = offset, tool_radius  # to the left in program coordinates, which a frame may scale; as it is
        self.along_next, self.corners_meet, self.emit = along_next, corners_meet, emit
        self.last: Element | None = None  # programmed
        self.shifted: Element | None = None  # beside it, its start is final
        self.entry = True

    def add(self, e: Element) -> None:
        """Add the next element of the contour; the first one is the approach."""
        if np.hypot(*(e.b - e.a)) < TINY and e.centre is None:
            self.emit(e) if self.last is None else self.last.behind.append(e)
            return
        if self.last is None:
            if e.centre is not None:
                raise WordError("G41 and G42 begin with a straight move in the plane, not with an arc; add one")
            self.last, self.shifted = e, moved(e, self.offset)
            return
        new = moved(e, self.offset)
        assert self.shifted is not None
        if self.entry and self.along_next:
            self._end(self.last, self.shifted, new.a)
        else:
            new = self._join(self.last, self.shifted, e, new)
        self.entry = False
        self.last, self.shifted = e, new

    def finish(self) -> np.ndarray | None:
        """Emit the last element at full length; returns the position of the tool in the plane."""
        if self.shifted is None:
            return None
        if self.entry and self.along_next:
            raise WordError("between G41 or G42 and G40 there is no contour; add a move in the plane")
        assert self.last is not None
        self._end(self.last, self.shifted, self.shifted.b)
        return self.shifted.b

    def _end(self, last: Element, shifted: Element, at: np.ndarray) -> None:
        """Emit an element to a place (2,), where the moves behind it are made."""
        shifted.b = at.copy()
        self.emit(shifted)
        for other in last.behind:
            self.emit(replace(other, a=at.copy(), b=at.copy()))

    def _join(self, last: Element, shifted: Element, e: Element, new: Element) -> Element:
        """The corner between two elements; returns the second with its start."""
        t1, t2 = last.direction(True), e.direction(False)
        turn = math.atan2(t1[0] * t2[1] - t1[1] * t2[0], float(t1 @ t2))
        short = turn * self.offset < 0.0 and abs(turn * self.offset) < GOUGE  # an arc about this outside corner would have no length
        if abs(turn) < SMOOTH or short:
            new.a = shifted.b.copy()
            self._end(last, shifted, shifted.b)
            return new
        turn, back = _reversal(last, e, turn)
        outside = turn * self.offset < 0.0 or back
        if outside and self.corners_meet and last.centre is None and e.centre is None and abs(turn) < 0.56 * math.pi:
            new.a = meet(shifted, new, last.b)[0]
            self._end(last, shifted, new.a)
        elif outside:  # an arc about the corner
            self._end(last, shifted, shifted.b)
            self.emit(Element(shifted.b, new.a, (last.across[1],) * 2, last.b.copy(), -1 if self.offset > 0 else 1, 0, new.move))
        else:
            self._inside(last, shifted, new, abs(turn))
        return new

    def _inside(self, last: Element, shifted: Element, new: Element, turn: float) -> None:
        """An inside corner of `turn` [rad]: both elements end at their intersection, which must lie on both.

        Rounded numbers turn tangent elements into inside corners. If these do not intersect, or only beyond their ends, the second
        begins at the end of the first, at most `GOUGE` inside the contour.
        """
        for point in meet(shifted, new, last.b):
            if holds(shifted, point) and holds(new, point):
                break
        else:
            point = shifted.b
            if 0.5 * abs(self.offset) * turn * turn >= GOUGE:
                raise WordError("the tool cannot reach an inside corner without gouging; use a smaller tool or correct the contour")
        new.a = point.copy()
        self._end(last, shifted, point)


def holds(e: Element, p: np.ndarray) -> bool:
    """Whether a point of the curve of an element lies between its ends."""
    if e.centre is None:
        way = e.b - e.a
        length = float(np.hypot(*way))
        along = float((p - e.a) @ way) / max(length, TINY)
        return -1e-7 <= along <= length + 1e-7
    arms = [math.atan2(*(q - e.centre)[::-1]) for q in (e.a, p, e.b)]
    whole = (e.sense * (arms[2] - arms[0])) % (2.0 * math.pi) or 2.0 * math.pi
    part = (e.sense * (arms[1] - arms[0])) % (2.0 * math.pi)
    return part <= whole + 1e-9 or part > 2.0 * math.pi - 1e-9


def _reversal(last: Element, e: Element, turn: float) -> tuple[float, bool]:
    """The turn [rad] at a corner, and True if the second element leads back on the first.

    If the second element is tangent to the first or crosses it right after the corner, its curvature determines the side.
    """
    from_full = math.pi - abs(turn)
    bend = sum(k.sense / float(np.hypot(*(k.b - k.centre))) for k in (last, e) if k.centre is not None)  # > 0: to the right of the first
    if from_full > BACK:
        return turn, False
    if abs(bend) < TINY:
        return turn, from_full < SMOOTH
    others = [p for p in meet(last, e, last.b) if float(np.hypot(*(p - last.b))) > SMOOTH]
    if from_full < SMOOTH or any(holds(last, p) and holds(e, p) for p in others):
        return -math.copysign(math.pi - from_full, bend), False
    return turn, False


def meet(one: Element, two: Element, near: np.ndarray) -> list[np.ndarray]:
    """Intersections of two shifted and extended elements, nearest to the corner first."""
    if one.centre is None and two.centre is None:
        u, v = one.b - one.a, two.b - two.a
        cross = u[0] * v[1] - u[1] * v[0]
        points = [] if abs(cross) < 1e-30 else [one.a + u * (((two.a - one.a)[0] * v[1] - (two.a - one.a)[1] * v[0]) / cross)]
    elif one.centre is not None and two.centre is not None:
        points = _circles(one.centre, _radius(one), two.centre, _radius(two))
    else:
        line, arc = (two, one) if two.centre is None else (one, two)
        assert arc.centre is not None
        points = _line_circle(line.a, line.direction(False), arc.centre, _radius(arc))
    return sorted(points, key=lambda p: float(np.hypot(*(p - near))))


def _radius(arc: Element) -> float:
    """Radius [m] of the circle of an arc, taken from its end point, as LinuxCNC does.

    Centre and end points of a program are rounded, so the start may be some micrometres off this circle.
    """
    assert arc.centre is not None
    return float(np.hypot(*(arc.b - arc.centre)))


def _line_circle(a: np.ndarray, t: np.ndarray, centre: np.ndarray, radius: float) -> list[np.ndarray]:
    foot = a + t * float((centre - a) @ t)
    square = radius * radius - float((foot - centre) @ (foot - centre))
    if square < -1e-12:
        return []
    half = math.sqrt(max(0.0, square))
    return [foot + half * t, foot - half * t]


def _circles(c1: np.ndarray, r1: float, c2: np.ndarray, r2: float) -> list[np.ndarray]:
    way = c2 - c1
    distance = float(np.hypot(*way))
    if distance < TINY:
        return []
    along = (distance * distance + r1 * r1 - r2 * r2) / (2.0 * distance)
    return _line_circle(c1 + along * way / distance, _left(way / distance), c1, r1)
