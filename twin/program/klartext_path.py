"""The contour of HEIDENHAIN Klartext: lines and arcs by points, pole, radius or tangent, corners, approach and departure."""

from collections.abc import Sequence
from functools import partial
import math
import re

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.arcs import Arc
from twin.program.control import Move, Vector
from twin.program.expressions import WordError, needed
from twin.program.frames import AXES, INDEX, LINEAR, ROTARY, rotation
from twin.program.klartext_blocks import SENSE, VALUE, Block, Klartext, all_parts
from twin.program.klartext_cycles import cycle_here
from twin.program.state import Item

NO_POLE = "no pole is defined; add CC before"


def move(m: Klartext, block: Block) -> None:
    """L, C, CR and so on, and M codes alone."""
    block.text, *corners = all_parts(block.text)
    m.scan(block)
    m.modes(block)
    head, column, words, machine, vector = block.head, block.column, block.w, 91 in block.m, None
    side, rapid = (block.side(), bool(block.pick("F"))) if head != "M" else (None, False)
    if 118 in block.m and head == "M":
        block.w = {}
    if head == "LN":
        x, y, z = (words.pop(n).value if n in words else 0.0 for n in ("TX", "TY", "TZ"))
        block.pick("NX", "NY", "NZ")
        m.state.note("LN: the surface normal NX NY NZ is not used; the compensation in space is taken as 0")
        vector = (x, y, z) if x or y or z else None
        if vector and not m.out.modes.traori:
            raise WordError("TX TY TZ need M128 or FUNCTION TCPM; switch it on before", column)
    if side is not None:
        m.compensate(side, column)
    kind, plane = mv.RAPID if rapid else mv.LINE, m.state.plane
    m.state.plane = m.pole_plane if head in ("LP", "C", "CP", "CTP") else plane
    element = None if head == "M" else element_of(m, block, kind, vector, machine)
    m.state.plane = plane
    if element is not None:
        corner = corner_of(m, corners, column)
        if m.waiting is not None:
            begin, m.waiting = m.waiting[1], None
            begin(element)
        m.emit(element, corner)
        if m.cycle_everywhere and 99 not in block.m:
            cycle_here(m)
    afterwards(m, block)


def element_of(m: Klartext, block: Block, kind: int, vector: Vector | None, machine: bool) -> Move | None:
    """The move of a block, which takes its words away; None without a target."""
    head, column, words, way, arc = block.head, block.column, block.w, 0.0, None
    start = np.array(m.out.position[:3]) if machine else m.start()
    begin, line = start, head in ("L", "LN")
    if head in ("LP", "CP", "CTP"):
        begin, way = polar(m, start, words, column, on_circle=head == "CP")
    places = block.pick(*(AXES if line else LINEAR))
    if not places and line:
        return None
    if not places and head in ("C", "CR", "CT"):
        raise WordError(f"{head} needs its end point; add it", column)
    if m.shorter_way:
        places = {n: i._replace(how="DC") if n in ROTARY and i.how == "" else i for n, i in places.items()}
    point, angles = m.control.target(places, machine, begin)
    if head in ("C", "CP", "CR"):
        clockwise = block.need(SENSE, f"{head} needs DR+ or DR-; add it", column).value < 0.0
        if way and (way < 0) != clockwise:
            raise WordError("IPA and DR of CP must have the same sign; correct one", column)
        if head == "CR":
            radius = block.need("R", "CR needs its radius R; add it", column).value * m.state.unit
            centre = arcs.centre_from_radius(start, point, radius, m.state.plane, clockwise)
        else:
            centre = needed(m.pole, NO_POLE, column)
        arc = m.control.arc_about(start, point, centre, clockwise, max(0, math.ceil(abs(way) / 360.0 - 1e-9) - 1))
    elif head in ("CT", "CTP"):
        direction = needed(m.corners.direction(), "CT needs a contour element before it, whose direction it continues")
        arc = arcs.tangential(start, direction, point, m.state.plane)
    if arc is not None and kind == mv.RAPID:
        raise WordError("FMAX on an arc is not supported; give its feed", column)
    return m.control.move(kind, point, angles, vector, arc, machine)


def corner_of(m: Klartext, parts: list[str], column: int) -> tuple[str, float] | None:
    """RND or CHF behind the move; a size of 0 is none."""
    if not parts:
        return None
    match = re.fullmatch(rf"(?:RND\s*R|(CHF)\s*)\s*({VALUE})", parts[0])
    match = needed(match, f"'{parts[0][:20]}' is not read; write RND R5 or CHF 5 without a feed", column)
    return "CHR" if match[1] else "RND", m.number_of(match[2], column) * m.state.unit


def afterwards(m: Klartext, block: Block) -> None:
    """The M codes that act behind the move of their block."""
    for number in block.m:
        if number in (0, 1, 6):
            m.state.note(f"M{number}: the program continues after an exact stop")
            m.settle()
            m.control.stop()
        elif number == 99:
            cycle_here(m)
            m.cycle_everywhere = False
        elif number in (2, 30):
            m.flow.ended = True
        elif number == 140:
            retract(m, block)
    block.all_used()


def retract(m: Klartext, block: Block) -> None:
    """M140 MB: along the tool axis by a distance, or to the end of the travel of the machine axis."""
    way = block.need("MB", "M140 needs MB MAX, or MB and a distance", block.column).value
    feed = block.w.pop("F140", Item(math.inf))
    m.settle()
    state, across, traori = m.state, arcs.PLANES[m.state.plane][2], m.out.modes.traori
    kind = mv.RAPID if math.isinf(feed.value) else mv.LINE
    with m.control.own_feed(None if kind == mv.RAPID else m.feed_of(feed)):
        if math.isfinite(way):
            point = state.here()
            point[across] += way * state.unit
            m.control.go(kind, point)
            return
        state.transform(False)
        m.control.to_home(np.array(m.out.kinematics.travel[:, 1]), LINEAR[across], kind)
        state.transform(traori)
    state.note("M140 MB MAX: to the end of the travel of the linear axis")


# ------------------------------------------------------------------ pole


AXES_OF_PLANE = {plane: {LINEAR[a], LINEAR[b]} for plane, (a, b, _) in arcs.PLANES.items()}


def set_pole(m: Klartext, block: Block) -> None:
    """CC with its coordinates, or at the last position; two coordinates give the plane of the arcs about it, which is XY, YZ or ZX.

    Beside one coordinate the other one of the plane stays that of the pole before.
    """
    words, start = m.only_words(block, "X Y Z", added=True), m.start()
    planes = (m.state.plane, m.pole_plane) if len(words) < 2 else arcs.PLANES
    found = (plane for plane in (m.state.plane, *planes) if words.keys() <= AXES_OF_PLANE[plane])
    m.pole_plane = needed(next(found, None), "CC takes the two coordinates of a plane; give them", block.column)
    new = (start if m.pole is None or len(words) != 1 else m.pole).copy()
    for name, (value, how, _column) in words.items():
        new[INDEX[name]] = value * m.state.unit + (start[INDEX[name]] if how == "IC" else 0.0)
    m.pole = new


def polar(m: Klartext, start: np.ndarray, words: dict[str, Item], column: int, *, on_circle: bool) -> tuple[np.ndarray, float]:
    """Point (3,) of PR and PA about the pole, and the programmed angle of travel [deg], 0 if it is not incremental."""
    pole, radius, angle = needed(m.pole, NO_POLE, column), words.pop("PR", None), words.pop("PA", None)
    if on_circle and radius is not None:
        raise WordError("PR has no use in CP, whose radius is that of the start; remove it", radius.column)
    if on_circle and angle is None:
        raise WordError("CP needs its angle PA or IPA; add it", column)
    return m.control.polar(pole, start, radius, angle), angle.value if angle is not None and angle.how == "IC" else 0.0


# ------------------------------------------------------------------ approach and departure


def approach(m: Klartext, block: Block) -> None:
    """APPR: it waits for the first element of the contour, whose direction it needs."""
    m.settle()
    rapid, feed = next((k for k in reversed(m.out.kinds) if k != mv.DWELL), mv.LINE) == mv.RAPID, m.state.feed
    point, sizes = _soft(m, block, LINEAR)
    kind, side = block.head.split()[1], block.side() or 0
    if not side and kind != "LT":
        raise WordError(f"{block.head} needs RL or RR, which gives its side; add it", block.column)
    block.all_used()
    m.waiting = point, partial(_approach, m, kind, point, side, sizes, math.inf if rapid else feed)


def _soft(m: Klartext, block: Block, axes: Sequence[str]) -> tuple[np.ndarray, dict[str, float]]:
    """The point (3,) of APPR or DEP, which moves these axes, and its sizes: LEN, R and CCA."""
    m.scan(block)
    m.modes(block)
    needed = {"LT": ("LEN",), "LN": ("LEN",), "CT": ("R", "CCA"), "LCT": ("R",)}[block.head.split()[1]]
    sizes = {name: block.need(name, f"{block.head} needs {name}; add it", block.column).value for name in needed}
    return m.control.target(block.pick(*axes), start=m.corners.start())[0], sizes


def _approach(m: Klartext, kind: str, to: np.ndarray, side: int, sizes: dict[str, float], before: float, element: Move) -> None:
    """The moves to the first point `to` (3,) of the contour: in the plane at the feed `before` (infinite: rapid), to its depth, on the approach."""
    across = arcs.PLANES[m.state.plane][2]
    t = element.point - to if element.arc is None else np.cross(element.arc[1], to - element.arc[0])
    t[across] = 0.0
    if not np.linalg.norm(t) > 1e-12:
        raise WordError("the element behind APPR does not move in the plane; write L, C or CR")
    start = m.corners.start()
    begin, arc = _way(m, kind, start, to, t / np.linalg.norm(t), side or 1, m.radius(1) if side else 0.0, sizes)
    first = begin.copy()
    first[across] = start[across]
    if kind != "LN":
        m.compensate(side, 1)
    m.emit(m.control.move(mv.RAPID if math.isinf(before) else mv.LINE, first)._replace(feed=before))
    if first[across] != begin[across]:
        m.emit(m.control.move(mv.LINE, begin))
    if kind == "LN":
        m.compensate(side, 1)
    m.emit(m.control.move(mv.LINE, to, arc=arc))


def depart(m: Klartext, block: Block) -> None:
    """DEP: away from the last element, the mirror image of APPR, then without compensation."""
    head, column, kind, across = block.head, block.column, block.head.split()[1], arcs.PLANES[m.state.plane][2]
    t = m.corners.direction()
    point, sizes = _soft(m, block, LINEAR if kind == "LCT" else LINEAR[across])
    comp, at = m.state.comp, m.corners.start()
    if block.side():
        raise WordError(f"{head} is read without RL, RR; correct it", column)
    if t is None or (comp is None and kind != "LT"):
        raise WordError(f"{head} needs a contour element with RL or RR before it", column)
    t[across] = 0.0
    side, radius = (1, 0.0) if comp is None else (1 if comp.offset > 0 else -1, comp.tool_radius)
    end, arc = _way(m, kind, point, at, -t / np.linalg.norm(t), -side, radius, sizes)
    end[across] = at[across]
    if kind == "LN":
        m.compensate(0, column)
    m.emit(m.control.move(mv.LINE, end, arc=arc and m.control.arc_about(at, end, arc[0], arc[1].sum() > 0.0)))
    m.compensate(0, column)
    last = point if kind == "LCT" else np.where(np.arange(3) == across, point, m.state.here())
    if np.any(last != m.state.here()) and (kind == "LCT" or point[across] != at[across]):
        m.emit(m.control.move(mv.LINE, last))
    afterwards(m, block)


def _way(
    m: Klartext, kind: str, start: np.ndarray, to: np.ndarray, t: np.ndarray, side: int, radius: float, sizes: dict[str, float]
) -> tuple[np.ndarray, Arc | None]:
    """Auxiliary point (3,) beside the contour, which begins at `to` (3,) in the direction `t`, and the arc between them.

    `side` 1: the tool is to the left of the contour (RL), -1 to the right; `radius` of the tool [m].
    """
    a, b, across = arcs.PLANES[m.state.plane]
    normal = np.eye(3)[across]
    if kind in ("LT", "LN"):
        length = sizes["LEN"] * m.state.unit
        return (to - length * t if kind == "LT" else to + side * np.cross(normal, t) * (length + radius)), None
    arc_radius = sizes["R"] * m.state.unit
    sense, size = 1.0 if side * arc_radius > 0 else -1.0, abs(arc_radius)
    centre = to + sense * size * np.cross(normal, t)
    if kind == "CT":
        begin = centre + rotation(across, -sense * sizes["CCA"]) @ (to - centre)
    else:  # where a line from the start meets the circle as its tangent
        way = start - centre
        way[across] = 0.0
        distance = float(np.linalg.norm(way))
        if distance <= size:
            raise WordError("the start lies inside the circle of the approach or departure; give a smaller R or another point")
        angle = math.degrees(math.acos(size / distance))
        arms = [rotation(across, sign * angle) @ way * (size / distance) for sign in (1.0, -1.0)]
        begin = centre + max(arms, key=lambda arm: float((arm - way) @ (sense * np.cross(normal, arm))))
    begin[across] = to[across]
    return begin, m.control.arc_about(begin, to, centre, sense < 0.0)
