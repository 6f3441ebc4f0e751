"""The moves of HEIDENHAIN Klartext: words of a path block, its element, corner, tool radius, approach and departure, and M codes."""

from __future__ import annotations

from dataclasses import dataclass, field
import math
import re
from typing import Any

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.corners import Corners, Move
from twin.program.expressions import WordError
from twin.program.flow import Flow
from twin.program.klartext_contour import Contour, Element
from twin.program.klartext_cycles import KlartextCycles
from twin.program.klartext_frames import KlartextFrames
from twin.program.klartext_lines import VALUE, KlartextValues, all_parts
from twin.program.state import LINEAR, ROTARY, Item
from twin.program.tables import KLARTEXT_M, NOTE, REFUSED, UNKNOWN_M

_WORD = re.compile(
    rf"\s*(?:(?P<side>R[0LR])(?![\w.])|DR\s*(?P<sense>[-+])(?![\d.Q])|F\s*(?P<feed>MAX|AUTO|{VALUE})|M\s*(?P<m>\d+)"
    rf"|(?P<arg>MB\s*MAX|(?:MB|LA|BT)\s*{VALUE})|(?P<inc>I?)(?P<name>PA|PR|CCA|LEN|[NT][XYZ]|[A-CR-Z])\s*(?P<value>{VALUE}))",
    re.A,
)
_SIDES = {"R0": 0, "RL": 1, "RR": -1}


@dataclass
class Block:
    """The words of a block: coordinates and values by name, and what stands beside them."""

    words: dict[str, Item] = field(default_factory=dict)
    side: int | None = None
    sense: int = 0
    rapid: bool = False
    m: list[int] = field(default_factory=list)
    arg: str = ""


class KlartextMoves:
    """Moves."""

    def __init__(self, corners: Corners, flow: Flow, values: KlartextValues, frames: KlartextFrames, cycles: KlartextCycles) -> None:
        self.corners, self.control, self.state, self.out = corners, corners.control, corners.state, corners.state.out
        self.flow, self.values, self.frames, self.cycles = flow, values, frames, cycles
        self.contour = Contour(self.state)
        self.tool_feed, self.extra_radius = math.nan, 0.0  # F and DR of TOOL CALL
        self.shorter_way = self.was_rapid = False  # M126; the last move
        self.before: list[float] | None = None  # x y z before the last move that was read as a plain line
        self.waiting: tuple[str, np.ndarray, Block] | None = None  # APPR until the first element

    def scan(self, text: str, column: int) -> Block:
        """All words of a block; F and FMAX are carried out."""
        block, at, text = Block(), 0, text.rstrip()
        while at < len(text):
            match = _WORD.match(text, at)
            if not match:
                raise WordError(f"'{text[at:].strip()[:20]}' is not read here; docs/programs.md lists the words", column + at)
            at, where = match.end(), column + match.start()
            if match["side"]:
                block.side = _SIDES[match["side"]]
            elif match["sense"]:
                block.sense = 1 if match["sense"] == "+" else -1
            elif match["m"]:
                block.m.append(int(match["m"]))
            elif match["arg"]:
                block.arg = match["arg"].replace(" ", "")
            elif match["feed"] and block.m and block.m[-1] in (128, 140):
                self.state.note("F behind M128 or M140 is that of its own motion") if block.m[-1] == 128 else None
            elif match["feed"]:
                block.rapid = match["feed"] == "MAX"
                if not block.rapid:
                    self.state.set_feed(
                        self.tool_feed if match["feed"] == "AUTO" else self.feed(self.values.number_of(match["feed"], where)), where
                    )
            elif match["name"] in block.words:
                raise WordError(f"{match['name']} occurs twice in the block; keep one", where)
            else:
                name = self.state.slot_of.get(str(match["name"]), str(match["name"]))
                block.words[name] = Item(self.values.number_of(match["value"], where), "IC" if match["inc"] else "", where)
        return block

    def only_words(self, text: str, column: int) -> Block:
        """The words of a block that takes coordinates alone."""
        block = self.scan(text, column)
        if block.m or block.side is not None or block.sense or block.rapid or block.arg:
            raise WordError("only coordinates are read here; write the rest in another block", column)
        return block

    def feed(self, value: float) -> float:
        """A feed in units of the program: an inch program counts tenths of an inch a minute."""
        return value if self.state.unit == 1e-3 or self.out.modes.feed_mode != 94 else 0.1 * value

    def start(self) -> np.ndarray:
        """Start (3,) of the next element."""
        return self.corners.start() if self.waiting is None else self.waiting[1]

    def direction(self) -> np.ndarray | None:
        """Unit vector (3,) of the motion at the end of the last element."""
        if self.corners.held is not None:
            move, start = self.corners.held.move, self.corners.held.start
            if move.arc is None:
                return (move.point - start) / np.linalg.norm(move.point - start)
            raise WordError("a tangent behind RND or CHF on an arc is not supported; write the corner as blocks", 1)
        if self.corners.tangent is None and self.before is not None:
            way = self.state.here() - self.state.to_program(np.array(self.before))
            return way / np.linalg.norm(way) if np.linalg.norm(way) > 1e-12 else None
        return self.corners.tangent

    def move(self, head: str, text: str, column: int) -> None:
        """L, C, CR and so on, and M codes alone."""
        parts = all_parts(text)
        block = self.scan(parts[0], column)
        self.modes(block.m, block)
        words = {} if 118 in block.m and head == "M" else block.words
        if head == "M" and (block.side is not None or block.rapid or block.sense):
            raise WordError("R0, RL, RR, FMAX and DR belong to a path word, e.g. L; write it", column)
        start, vector = self.start(), None
        suppress = 91 in block.m
        if head == "LN":
            axis = [words.pop(n).value if n in words else 0.0 for n in ("TX", "TY", "TZ")]
            for name in ("NX", "NY", "NZ"):
                words.pop(name, None)
            self.state.note("LN: the surface normal NX NY NZ is not used; the compensation in space is taken as 0")
            vector = (axis[0], axis[1], axis[2]) if any(axis) else None
            if vector and not self.out.modes.traori:
                raise WordError("TX TY TZ need M128 or FUNCTION TCPM; switch it on before", column)
        if block.side is not None or (self.waiting is None and self.state.comp is None):
            self.compensate(block.side or 0, column)
        element, angles = self.element(head, block, words, np.array(self.out.position[:3]) if suppress else start, suppress, column)
        for name, item in words.items():
            raise WordError(f"{name} has no use in this block; remove it", item.column)
        if element is not None:
            corner = self.corner(parts[1:], column)
            kind = mv.RAPID if block.rapid else mv.LINE if element.arc is None else mv.ARC
            if block.rapid and element.arc is not None:
                raise WordError("FMAX on an arc is not supported; give its feed", column)
            if self.waiting is not None:
                self.carry_out_approach(element)
            self.emit(kind, element, angles, vector, suppress, corner)
            if self.cycles.modal and 99 not in block.m:
                self.cycle_here()
        self.afterwards(block.m, column)

    def element(
        self, head: str, block: Block, words: dict[str, Item], start: np.ndarray, suppress: bool, column: int
    ) -> tuple[Element | None, list[float]]:
        """The element of a block from `start` (3,), which takes its words away, and A and C."""
        none = [math.nan, math.nan]
        way, radius, about = 0.0, 0.0, self.contour
        if (head in ("C", "CP", "CR")) != bool(block.sense):
            raise WordError(f"{head} {'has no use for' if block.sense else 'needs'} its sense DR+ or DR-; correct it", column)
        if head == "CR":
            if "R" not in words:
                raise WordError("CR needs its radius R; add it", column)
            radius = words.pop("R").value * self.state.unit
        begin = start
        if head in ("LP", "CP", "CTP"):
            begin, way = about.polar(start, words, column, on_circle=head == "CP")
        places = {n: words.pop(n) for n in list(words) if n in (*LINEAR, *ROTARY, "B", "U", "V", "W")}
        if head == "M" and places:
            raise WordError("axes need a path word, e.g. L X+10", column)
        if not places and head in ("L", "LN", "M", "C", "CR", "CT"):
            if head in ("L", "LN", "M"):
                return None, none
            raise WordError(f"{head} needs its end point; add it", column)
        if head != "L" and head != "LN" and any(n not in LINEAR for n in places):
            raise WordError(f"{head} moves X Y Z only; write rotary axes in L", column)
        if self.shorter_way:
            places = {n: i._replace(how="DC") if n in ROTARY and i.how == "" else i for n, i in places.items()}
        point, angles = self.control.target(places, suppress, begin)
        if head == "C":
            return about.circle(start, point, block.sense), angles
        if head == "CP":
            return about.circle(start, point, block.sense, way, column), angles
        if head == "CR":
            return about.by_radius(start, point, radius, block.sense), angles
        if head in ("CT", "CTP"):
            return about.tangent(start, point, self.direction()), angles
        return Element(point, None), angles

    def emit(
        self, kind: int, element: Element, angles: list[float], vector: Any = None, suppress: bool = False, corner: Any = None
    ) -> None:
        state = self.state
        if self.frames.turn_to is not None and vector is None and all(map(math.isnan, angles)):
            angles, self.frames.turn_to = self.frames.turn_to, None
        move = Move(kind, element.point, angles, vector, element.arc, None, suppress, state.feed, state.line, state.block)
        self.corners.queue(move, corner)
        self.before, self.was_rapid = None, kind == mv.RAPID

    def corner(self, parts: list[str], column: int) -> tuple[str, float] | None:
        """RND or CHF behind the move; a size of 0 is none."""
        if not parts:
            return None
        match = re.fullmatch(rf"(?:RND\s*R|(CHF)\s*)\s*({VALUE})", parts[0])
        if match is None:
            raise WordError(f"'{parts[0][:20]}' is not read; write RND R5 or CHF 5 without a feed", column)
        return "CHR" if match[1] else "RND", self.values.number_of(match[2], column) * self.state.unit

    def pole(self, _: str, text: str, column: int) -> None:
        block = self.only_words(text, column)
        self.contour.set_pole(self.start(), block.words, column)

    def radius(self, column: int) -> float:
        return self.state.tools.radius(self.state.tools.name, column) + self.extra_radius

    def compensate(self, side: int, column: int) -> None:
        """R0, RL or RR from the next move on."""
        if side == 0 and self.state.comp is None:
            return
        self.corners.release()
        self.control.compensate(side, self.radius(column) if side else 0.0, along_next=True)

    def begin_approach(self, head: str, text: str, column: int) -> None:
        """APPR: it waits for the first element of the contour, whose direction it needs."""
        self.settle()
        rapid, feed = self.was_rapid, self.state.feed
        block = self.scan(text, column)
        self.modes(block.m, block)
        words, kind = block.words, head.split()[1]
        places = {n: words.pop(n) for n in LINEAR if n in words}
        needed = {"LT": {"LEN"}, "LN": {"LEN"}, "CT": {"R", "CCA"}, "LCT": {"R"}}[kind]
        if words.keys() != needed:
            raise WordError(f"{head} needs {' and '.join(sorted(needed))}, no more; correct the block", column)
        if block.rapid:
            raise WordError(f"{head} is read with a feed, not with FMAX; correct it", column)
        if not block.side and kind != "LT":
            raise WordError(f"{head} needs RL or RR, which gives its side; add it", column)
        point, _ = self.control.target(places, False, self.corners.start())
        block.words["from"] = Item(math.inf if rapid else feed)
        self.waiting = kind, point, block

    def carry_out_approach(self, element: Element) -> None:
        """The moves to the first point of the contour: in the plane, then to its depth, then on the approach."""
        assert self.waiting is not None
        kind, to, block = self.waiting
        self.waiting = None
        t = self.contour.direction(element, to)
        if t is None:
            raise WordError("the element behind APPR does not move in the plane; write L, C or CR", 1)
        side, words, none = block.side or 0, dict(block.words), [math.nan, math.nan]
        before, feed = words.pop("from").value, self.state.feed
        radius = self.radius(1) if side else 0.0
        begin, arc = self.contour.way_in(kind, self.corners.start(), to, t, side or 1, radius, words)
        across = arcs.PLANES[self.state.plane][2]
        first = begin.copy()
        first[across] = self.corners.start()[across]
        if kind != "LN":
            self.compensate(side, 1)
        self.state.feed = feed if math.isinf(before) else before
        self.emit(mv.RAPID if math.isinf(before) else mv.LINE, Element(first, None), none)
        self.state.feed = feed
        if first[across] != begin[across]:
            self.emit(mv.LINE, Element(begin, None), none)
        if kind == "LN":
            self.compensate(side, 1)
        self.emit(mv.ARC if arc else mv.LINE, Element(to, arc), none)

    def depart(self, head: str, text: str, column: int) -> None:
        """DEP: away from the last element, then without compensation."""
        t = self.direction()
        block = self.scan(text, column)
        self.modes(block.m, block)
        words, kind, comp = block.words, head.split()[1], self.state.comp
        at, across = self.corners.start(), arcs.PLANES[self.state.plane][2]
        places = {n: words.pop(n) for n in LINEAR if n in words}
        needed = {"LT": {"LEN"}, "LN": {"LEN"}, "CT": {"R", "CCA"}, "LCT": {"R"}}[kind]
        if words.keys() != needed or (places.keys() and kind != "LCT" and places.keys() != {LINEAR[across]}):
            raise WordError(f"{head} needs {' and '.join(sorted(needed))}, no more; correct the block", column)
        if block.side or block.sense or block.rapid:
            raise WordError(f"{head} is read with a feed and without RL, RR, DR; correct it", column)
        if t is None or (comp is None and kind != "LT"):
            raise WordError(f"{head} needs a contour element with RL or RR before it", column)
        point, none = self.control.target(places, False, at)[0], [math.nan, math.nan]
        side, radius = (0, 0.0) if comp is None else (1 if comp.offset > 0 else -1, comp.tool_radius)
        flat = t.copy()
        flat[across] = 0.0
        end, arc = self.contour.way_out(kind, at, point, flat / np.linalg.norm(flat), side or 1, radius, words)
        end[across] = at[across]
        if kind == "LN":
            self.compensate(0, column)
        self.emit(mv.ARC if arc else mv.LINE, Element(end, arc), none)
        self.compensate(0, column)
        last = point if kind == "LCT" else np.where(np.arange(3) == across, point, self.state.here())
        if np.any(last != self.state.here()) and (kind == "LCT" or point[across] != at[across]):
            self.emit(mv.LINE, Element(last, None), none)
        self.afterwards(block.m, column)

    def settle(self) -> None:
        """Emit what waits for the next element."""
        if self.waiting is not None:
            raise WordError("behind APPR there is no contour; add an element in the plane", 1)
        self.corners.release()

    def modes(self, codes: list[int], block: Block) -> None:
        """M codes that act before the move of their block."""
        state = self.state
        for number in codes:
            entry = KLARTEXT_M.get(number)
            if entry is not None and entry[0] == REFUSED:
                raise WordError(f"M{number} is not supported: {entry[1]}", 1)
            if entry is None or entry[0] == NOTE:
                state.note(f"M{number}: {UNKNOWN_M if entry is None else entry[1]}")
            elif number in (128, 129):
                self.settle()
                state.transform(number == 128)
            elif number in (126, 127):
                self.shorter_way = number == 126
            elif number in (136, 137):
                state.set_feed_mode(95 if number == 136 else 94)
            elif number == 89:
                self.cycles.modal = True
        if block.arg and not set(codes) & {101, 120, 140}:
            raise WordError(f"{block.arg} belongs to an M code that is missing; remove it", 1)

    def afterwards(self, codes: list[int], column: int) -> None:
        """M codes that act behind the move of their block."""
        for number in codes:
            if number in (0, 1, 6):
                self.state.note(f"M{number}: the program continues after an exact stop")
                self.settle()
                self.control.stop(0.0)
            elif number == 99:
                self.cycle_here()
                self.cycles.modal = False
            elif number in (2, 30):
                self.flow.ended = True
            elif number == 140:
                self.retract(column)

    def retract(self, column: int) -> None:
        """M140 MB: along the tool axis by a distance, or to the end of the travel of the machine axis."""
        text = self.flow.frame.unit.lines[self.flow.frame.at]
        match = re.search(rf"MB\s*(MAX|{VALUE})(?:\s*F\s*(MAX|AUTO|{VALUE}))?", text)
        if match is None:
            raise WordError("M140 needs MB MAX, or MB and a distance", column)
        self.settle()
        state, across = self.state, arcs.PLANES[self.state.plane][2]
        none, rapid = [math.nan, math.nan], match[2] in (None, "MAX")
        if match[1] != "MAX":
            point = state.here()
            point[across] += self.values.number_of(match[1], column) * state.unit
            self.control.go(mv.RAPID if rapid else mv.LINE, point, none)
            return
        traori = self.out.modes.traori
        state.transform(False)
        goal = np.array(self.out.position[:3])
        goal[across] = self.out.kinematics.travel[across, 1]
        self.control.go(mv.RAPID if rapid else mv.LINE, goal, none, suppress=True)
        state.transform(traori)
        state.note("M140 MB MAX: to the end of the travel of the linear axis")

    def cycle_here(self) -> None:
        self.settle()
        if self.state.comp is not None:
            raise WordError("a cycle is called inside RL or RR; write R0 and a move before", 1)
        if self.cycles.number is not None:
            self.cycles.define(self.cycles.number)
        self.cycles.call()
