"""The contour of HEIDENHAIN Klartext: lines and arcs by points, pole, radius or tangent, corners, approach and departure."""

from __future__ import annotations

import math
import re

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.arcs import Arc
from twin.program.control import KEPT
from twin.program.expressions import WordError, needed
from twin.program.frames import LINEAR, OTHER, ROTARY, rotation
from twin.program.klartext_blocks import VALUE, Block, Element, Klartext, all_parts
from twin.program.klartext_cycles import cycle_here
from twin.program.state import Item

NO_POLE = "no pole is defined; add CC before"


def move(m: Klartext, block: Block) -> None:
    """L, C, CR and so on, and M codes alone."""
    block.text, *corners = all_parts(block.text)
    m.scan(block)
    m.modes(block)
    head, column, words, machine, vector = block.head, block.column, block.w, 91 in block.m, None
    if head == "M" and (block.side is not None or block.rapid or block.sense):
        raise WordError("R0, RL, RR, FMAX and DR belong to a path word, e.g. L; write it", column)
    if 118 in block.m and head == "M":
        words = block.w = {}
    if head == "LN":
        x, y, z = (words.pop(n).value if n in words else 0.0 for n in ("TX", "TY", "TZ"))
        block.pick("NX", "NY", "NZ")
        m.state.note("LN: the surface normal NX NY NZ is not used; the compensation in space is taken as 0")
        vector = (x, y, z) if x or y or z else None
        if vector and not m.out.modes.traori:
            raise WordError("TX TY TZ need M128 or FUNCTION TCPM; switch it on before", column)
    if block.side is not None or (m.waiting is None and m.state.comp is None):
        m.compensate(block.side or 0, column)
    element, angles = element_of(m, block, np.array(m.out.position[:3]) if machine else m.start(), machine)
    block.all_used()
    if element is not None:
        if block.rapid and element[1] is not None:
            raise WordError("FMAX on an arc is not supported; give its feed", column)
        corner = corner_of(m, corners, column)
        if m.waiting is not None:
            carry_out_approach(m, element)
        m.emit(mv.RAPID if block.rapid else mv.ARC if element[1] else mv.LINE, element, angles, vector, machine, corner)
        if m.cycle_everywhere and 99 not in block.m:
            cycle_here(m)
    afterwards(m, block)


def element_of(m: Klartext, block: Block, start: np.ndarray, machine: bool) -> tuple[Element | None, tuple[float, float]]:
    """The element of a block from `start` (3,), which takes its words away, and A and C."""
    head, column, words, way = block.head, block.column, block.w, 0.0
    if (head in ("C", "CP", "CR")) != bool(block.sense):
        raise WordError(f"{head} {'has no use for' if block.sense else 'needs'} its sense DR+ or DR-; correct it", column)
    if head == "CR" and "R" not in words:
        raise WordError("CR needs its radius R; add it", column)
    radius = words.pop("R").value * m.state.unit if head == "CR" else 0.0
    begin = start
    if head in ("LP", "CP", "CTP"):
        begin, way = polar(m, start, words, column, on_circle=head == "CP")
    places = block.pick(*LINEAR, *ROTARY, *OTHER)
    if not places and head in ("L", "LN", "M"):
        return None, KEPT
    if head == "M":
        raise WordError("axes need a path word, e.g. L X+10", column)
    if not places and head in ("C", "CR", "CT"):
        raise WordError(f"{head} needs its end point; add it", column)
    if head not in ("L", "LN") and places.keys() - set(LINEAR):
        raise WordError(f"{head} moves X Y Z only; write rotary axes in L", column)
    if m.shorter_way:
        places = {n: i._replace(how="DC") if n in ROTARY and i.how == "" else i for n, i in places.items()}
    point, angles = m.control.target(places, machine, begin)
    clockwise, arc = block.sense < 0, None
    if head in ("C", "CP"):
        if way and (way < 0) != clockwise:
            raise WordError("IPA and DR of CP must have the same sign; correct one", column)
        turns = max(0, math.ceil(abs(way) / 360.0 - 1e-9) - 1)
        arc = m.control.arc_about(start, point, needed(m.pole, NO_POLE, column), clockwise, turns)
    elif head == "CR":
        centre = arcs.centre_from_radius(start, point, radius, m.state.plane, clockwise)
        arc = m.control.arc_about(start, point, centre, clockwise)
    elif head in ("CT", "CTP"):
        direction = needed(m.corners.direction(), "CT needs a contour element before it, whose direction it continues")
        arc = arcs.tangential(start, direction, point, m.state.plane)
    return (point, arc), angles


def corner_of(m: Klartext, parts: list[str], column: int) -> tuple[str, float] | None:
    """RND or CHF behind the move; a size of 0 is none."""
    if not parts:
        return None
    match = re.fullmatch(rf"(?:RND\s*R|(CHF)\s*)\s*({VALUE})", parts[0])
    if match is None:
        raise WordError(f"'{parts[0][:20]}' is not read; write RND R5 or CHF 5 without a feed", column)
    return "CHR" if match[1] else "RND", m.number_of(match[2], column) * m.state.unit


def afterwards(m: Klartext, block: Block) -> None:
    """The M codes that act behind the move of their block."""
    for number in block.m:
        if number in (0, 1, 6):
            m.state.note(f"M{number}: the program continues after an exact stop")
            m.settle()
            m.control.stop(0.0)
        elif number == 99:
            cycle_here(m)
            m.cycle_everywhere = False
        elif number in (2, 30):
            m.flow.ended = True
        elif number == 140:
            retract(m, block)


def retract(m: Klartext, block: Block) -> None:
    """M140 MB: along the tool axis by a distance, or to the end of the travel of the machine axis."""
    if not block.arg.startswith("MB"):
        raise WordError("M140 needs MB MAX, or MB and a distance", block.column)
    m.settle()
    state, across = m.state, arcs.PLANES[m.state.plane][2]
    kind = mv.RAPID if block.arg_feed in ("", "MAX") else mv.LINE
    if block.arg != "MBMAX":
        point = state.here()
        point[across] += m.number_of(block.arg[2:], block.column) * state.unit
        m.control.go(kind, point)
        return
    traori, goal = m.out.modes.traori, np.array(m.out.kinematics.travel[:, 1])
    state.transform(False)
    m.control.to_home(goal, LINEAR[across], kind)
    state.transform(traori)
    state.note("M140 MB MAX: to the end of the travel of the linear axis")


# ------------------------------------------------------------------ pole


def set_pole(m: Klartext, block: Block) -> None:
    """CC with its coordinates in the plane, or at the last position."""
    words = m.only_words(block, "X Y Z", added=True)
    a, b, across = arcs.PLANES[m.state.plane]
    if LINEAR[across] in words:
        raise WordError(f"{LINEAR[across]} does not lie in the plane of CC", block.column)
    new, start = m.start().copy(), m.start()
    for name, (value, how, _column) in words.items():
        new[LINEAR.index(name)] = value * m.state.unit + (start[LINEAR.index(name)] if how == "IC" else 0.0)
    if len(words) == 1 and m.pole is not None:  # the other coordinate stays
        other = a if LINEAR[b] in words else b
        new[other] = m.pole[other]
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
    point = _soft(m, block)
    if not block.side and not block.head.endswith(" LT"):
        raise WordError(f"{block.head} needs RL or RR, which gives its side; add it", block.column)
    m.waiting = block.head.split()[1], point, block, math.inf if rapid else feed


def _soft(m: Klartext, block: Block) -> np.ndarray:
    """The point (3,) of APPR or DEP, whose words are read."""
    head, column = block.head, block.column
    m.scan(block)
    m.modes(block)
    places = block.pick(*LINEAR)
    needed = {"LT": {"LEN"}, "LN": {"LEN"}, "CT": {"R", "CCA"}, "LCT": {"R"}}[head.split()[1]]
    along = {LINEAR[arcs.PLANES[m.state.plane][2]]}
    if block.w.keys() != needed or (head.startswith("DEP") and "LCT" not in head and places.keys() - along):
        raise WordError(f"{head} needs {' and '.join(sorted(needed))}, no more; correct the block", column)
    if block.rapid or block.sense:
        raise WordError(f"{head} is read with a feed, not with FMAX or DR; correct it", column)
    return m.control.target(places, start=m.corners.start())[0]


def carry_out_approach(m: Klartext, element: Element) -> None:
    """The moves to the first point of the contour: in the plane, then to its depth, then on the approach."""
    assert m.waiting is not None
    kind, to, block, before = m.waiting
    m.waiting, across, side = None, arcs.PLANES[m.state.plane][2], block.side or 0
    t = element[0] - to if element[1] is None else np.cross(element[1][1], to - element[1][0])
    t[across] = 0.0
    if not np.linalg.norm(t) > 1e-12:
        raise WordError("the element behind APPR does not move in the plane; write L, C or CR")
    start, feed = m.corners.start(), m.state.feed
    begin, arc = _way(m, kind, start, to, t / np.linalg.norm(t), side or 1, m.radius(1) if side else 0.0, block.w)
    first = begin.copy()
    first[across] = start[across]
    if kind != "LN":
        m.compensate(side, 1)
    m.state.feed = feed if math.isinf(before) else before
    m.emit(mv.RAPID if math.isinf(before) else mv.LINE, (first, None))
    m.state.feed = feed
    if first[across] != begin[across]:
        m.emit(mv.LINE, (begin, None))
    if kind == "LN":
        m.compensate(side, 1)
    m.emit(mv.ARC if arc else mv.LINE, (to, arc))


def depart(m: Klartext, block: Block) -> None:
    """DEP: away from the last element, the mirror image of APPR, then without compensation."""
    t, point, head, column = m.corners.direction(), _soft(m, block), block.head, block.column
    kind, comp, at, across = head.split()[1], m.state.comp, m.corners.start(), arcs.PLANES[m.state.plane][2]
    if block.side is not None and block.side:
        raise WordError(f"{head} is read without RL, RR; correct it", column)
    if t is None or (comp is None and kind != "LT"):
        raise WordError(f"{head} needs a contour element with RL or RR before it", column)
    t[across] = 0.0
    side, radius = (1, 0.0) if comp is None else (1 if comp.offset > 0 else -1, comp.tool_radius)
    end, arc = _way(m, kind, point, at, -t / np.linalg.norm(t), -side, radius, block.w)
    end[across] = at[across]
    if kind == "LN":
        m.compensate(0, column)
    m.emit(mv.ARC if arc else mv.LINE, (end, None if arc is None else m.control.arc_about(at, end, arc[0], arc[1].sum() > 0.0)))
    m.compensate(0, column)
    last = point if kind == "LCT" else np.where(np.arange(3) == across, point, m.state.here())
    if np.any(last != m.state.here()) and (kind == "LCT" or point[across] != at[across]):
        m.emit(mv.LINE, (last, None))
    afterwards(m, block)


def _way(
    m: Klartext, kind: str, start: np.ndarray, to: np.ndarray, t: np.ndarray, side: int, radius: float, words: dict[str, Item]
) -> tuple[np.ndarray, Arc | None]:
    """Auxiliary point (3,) beside the contour, which begins at `to` (3,) in the direction `t`, and the arc between them.

    `side` 1: the tool is to the left of the contour (RL), -1 to the right; `radius` of the tool [m].
    """
    a, b, across = arcs.PLANES[m.state.plane]
    normal = np.eye(3)[across]
    if kind in ("LT", "LN"):
        length = words["LEN"].value * m.state.unit
        return (to - length * t if kind == "LT" else to + side * np.cross(normal, t) * (length + radius)), None
    arc_radius = words["R"].value * m.state.unit
    sense, size = 1.0 if side * arc_radius > 0 else -1.0, abs(arc_radius)
    centre = to + sense * size * np.cross(normal, t)
    if kind == "CT":
        begin = centre + rotation(across, -sense * words["CCA"].value) @ (to - centre)
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
