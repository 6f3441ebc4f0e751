"""Moves of the control, used by all languages: targets of blocks, arcs, stops, cycles, radius compensation.

Moves are passed to the collector in machine coordinates; `twin.program.state` has the modal state.
"""

from collections.abc import Container, Iterator
from contextlib import contextmanager
import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.arcs import Arc
from twin.program.compensation import GOUGE, Compensation, Element
from twin.program.cycles import ASIDE, BACK, DWELL, MOVE, RAPID, Drilling, Steps, drill
from twin.program.expressions import WordError
from twin.program.frames import INDEX, LINEAR, ROTARY
from twin.program.state import Item, State

LONGEST_DWELL = 3600.0
SAME_SCALE = 1e-9
KEPT = (math.nan, math.nan)
"""A and C that stay where they are."""

Vector = tuple[float, float, float]


class Move(NamedTuple):
    """One move to a point in program coordinates (machine coordinates if `machine`), by a line or an arc.

    Feed (with its override), place in the program and modes are those of its block; `mode` is the number of the modes.
    """

    kind: int
    point: np.ndarray
    angles: tuple[float, float]  # A and C, NaN if not programmed
    vector: Vector | None  # tool axis
    arc: Arc | None
    machine: bool
    feed: float
    line: int
    block: int
    mode: int


class Control:
    """Makes the moves of the blocks one after the other."""

    def __init__(self, state: State) -> None:
        self.state = state

    # ------------------------------------------------------------------ moves

    def target(
        self, words: dict[str, Item], machine: bool = False, start: np.ndarray | None = None
    ) -> tuple[np.ndarray, tuple[float, float]]:
        """Target of a block: program coordinates (3,), or machine coordinates if `machine`; A and C, NaN if not programmed.

        `start` (3,): start of the move; default: position of the tool.
        """
        s, out = self.state, self.state.out
        if any(n in words and (words[n].how not in ("", "AC") or not s.absolute) for n in ROTARY):
            out.position[3:] = [float(v) for v in out.settle()]
        if machine:
            s.outside_compensation("a block in machine coordinates is")
        if start is None:
            start = np.array(out.position[:3]) if machine else s.here()
        point, angles = start.copy(), [math.nan, math.nan]
        for name, (value, how, column) in words.items():
            goal, i, turns = s.si(name, value), INDEX.get(name), how in ("DC", "ACP", "ACN")
            relative = s.is_relative(how) and not (machine and how == "")
            if i is None:  # an axis that this machine lacks; a value other than zero is reported at the end
                s.other_axes[name] = s.other_axes[name] + goal if relative else goal
                if s.other_axes[name] and out.missing is None:
                    out.missing = s.line, s.block, next((n for n, slot in s.slot_of.items() if slot == name), name)
            elif name in LINEAR and turns:
                raise WordError(f"{how}() is for rotary axes; use AC() or IC()", column)
            elif name in LINEAR:
                point[i] = start[i] + goal if relative else goal
            else:
                now = out.position[i]
                way = goal if relative else goal + (0.0 if machine else s.offset[i]) - now
                if turns:
                    way %= 2.0 * math.pi
                    way -= 2.0 * math.pi if (how == "ACN" and way > 0.0) or (how == "DC" and way > math.pi) else 0.0
                angles[i - 3] = now + way if relative or turns else goal + (0.0 if machine else s.offset[i])
        return point, (angles[0], angles[1])

    def move(
        self,
        kind: int,
        point: np.ndarray,
        angles: tuple[float, float] = KEPT,
        vector: Vector | None = None,
        arc: Arc | None = None,
        machine: bool = False,
    ) -> Move:
        """A move with the feed, place and modes in force; one with an arc is an arc."""
        s, kind = self.state, kind if arc is None else mv.ARC
        return Move(kind, point, angles, vector, arc, machine, s.feed * s.override, s.line, s.block, len(s.out.all_modes) - 1)

    def go(self, kind: int, point: np.ndarray, angles: tuple[float, float] = KEPT, arc: Arc | None = None, machine: bool = False) -> None:
        """Make a move with the feed, place and modes in force."""
        self.make(self.move(kind, point, angles, None, arc, machine))

    def make(self, move: Move) -> None:
        """Make a move, or queue it for radius compensation."""
        s = self.state
        if move.kind != mv.RAPID and not move.feed > 0.0:
            self.feed_given(move.feed)
        if s.after_compensation and s.comp is None:
            if move.arc is not None:
                raise WordError("the move after G40 must be straight, not an arc; add a straight move")
            s.after_compensation = False
        if s.comp is not None and not move.machine:
            self._beside(move)
        else:
            self._put(move)

    def feed_given(self, feed: float) -> None:
        """Refuse a move without a feed; an ISO control refuses F0 in the block of the move."""
        if self.state.iso and feed == 0.0:
            raise WordError("the feed is 0; give F a number above 0")
        if math.isnan(feed):
            text = f"no feed is programmed yet; give {self.state.feed_word}, or feed_mm_min in [program] of the machine file"
            if self.state.path.suffix.lower() == ".spf":
                text = "no feed is programmed yet, which a call gives this subprogram; read the program that calls it"
            raise self.state.out.fail(self.state.line, self.state.block, text)

    def _put(self, move: Move) -> None:
        """Pass a move to the collector, in machine coordinates."""
        s, out, vector, angles = self.state, self.state.out, move.vector, move.angles
        goal = move.point if move.machine else s.to_machine(move.point)
        if move.arc is not None:
            out.arcs[len(out.kinds)] = move.arc if move.machine else self._turned(move.arc)
        if s.fixed_axis is not None and vector is None and math.isnan(angles[0]) and math.isnan(angles[1]):
            vector = _vector(s.fixed_axis)
        elif vector is not None and s.matrix is not None:
            vector = _vector(s.matrix @ np.array(vector))
        place = goal.tolist()
        out.add(move.kind, (*place, *angles), vector, math.inf if move.kind == mv.RAPID else move.feed, move.line, move.block)
        out.mode_of[-1] = move.mode
        out.position[:3] = place
        for i, angle in enumerate(angles):
            if not math.isnan(angle):
                out.position[3 + i] = angle
        if vector is not None:
            out.position[3:] = KEPT

    def arc_about(self, start: np.ndarray, end: np.ndarray, centre: np.ndarray, clockwise: bool, turns: int = 0) -> Arc:
        """The arc about a centre in the plane; equal start and end are a full circle."""
        a, b, c = arcs.PLANES[self.state.plane]
        middle, normal = start.copy(), np.zeros(3)
        middle[[a, b]], normal[c] = centre[[a, b]], -1.0 if clockwise else 1.0
        first, last = start - middle, end - middle
        last[c] = 0.0
        radius, radius_end = (float(np.linalg.norm(arm)) for arm in (first, last))
        if radius < 1e-9:
            raise arcs.ArcError("the arc has no radius; give the centre with I J K (from the start) or the radius")
        if abs(radius - radius_end) > self.state.closing(float(np.linalg.norm(start - centre))):
            raise arcs.ArcError(
                f"the arc does not close: the radius is {radius * 1e3:.4f} mm at its start and {radius_end * 1e3:.4f} mm at its end; "
                "correct the end point or I J K"
            )
        angle = 2.0 * math.pi if np.linalg.norm(last - first) < 1e-9 else arcs.angle_between(first, last, normal)
        return middle, normal, angle + 2.0 * math.pi * turns

    def _turned(self, circle: Arc) -> Arc:
        """An arc in machine coordinates; a mirror reverses its direction."""
        centre, normal, angle = circle
        if self.state.matrix is not None:
            gram = self.state.matrix.T @ self.state.matrix
            if not np.allclose(gram, np.eye(3) * gram[0, 0], atol=1e-9):
                raise WordError("an arc under a SCALE that differs between axes is no arc; scale all axes alike")
            normal = self.state.matrix @ normal / math.sqrt(gram[0, 0]) * math.copysign(1.0, np.linalg.det(self.state.matrix))
        return self.state.to_machine(centre), normal, angle

    def arc_centre(self, start: np.ndarray, point: np.ndarray, words: dict[str, Item], radius: float | None) -> np.ndarray:
        """Centre (3,) from I J K or the radius, program coordinates."""
        clockwise = self.state.motion == 2
        if radius is not None and words:
            raise WordError("the circle is given twice, by its centre (I J K) and by its radius; keep one")
        if radius is None and not words:
            raise WordError(
                f"a circle needs its centre (I J K) or radius {'R' if self.state.iso else '(CR=, in .ngc files R)'}; add it to the block"
            )
        if radius is not None:
            return arcs.centre_from_radius(start, point, radius, self.state.plane, clockwise)
        a, b, across = arcs.PLANES[self.state.plane]
        middle = start.copy()
        for name, (value, how, column) in words.items():
            i, absolute = "IJK".index(name), how == "AC" or (how == "" and self.state.centre_absolute)
            if i == across and (value or absolute):  # some posts write all three
                raise WordError(f"{name} does not lie in the plane G{self.state.plane}; select the plane with G17, G18 or G19", column)
            middle[i] = value * self.state.unit + (0.0 if absolute else start[i])
        gap = _gap(start, point, middle, a, b)
        if gap > self.state.closing(float(np.linalg.norm((start - middle)[[a, b]]))):
            raise arcs.ArcError(
                f"the arc does not close: its radius is {gap * 1e3:.4f} mm greater or smaller at its end; {self._as_meant(start, point, words)}"
            )
        return middle

    def _as_meant(self, start: np.ndarray, point: np.ndarray, words: dict[str, Item]) -> str:
        """What to do about an open arc: whether it closes with another meaning of I J K."""
        a, b, _ = arcs.PLANES[self.state.plane]
        given = np.array([words["IJK"[i]].value * self.state.unit if "IJK"[i] in words else 0.0 for i in range(3)])
        limit = self.state.closing(float(np.linalg.norm(given - start)))
        names = " ".join("IJK"[i] for i in sorted((a, b)))
        if not self.state.centre_absolute and _gap(start, point, given, a, b) <= limit:
            how = "write G90.1 before" if self.state.iso else f"write {'IJK'[a]}=AC(..) {'IJK'[b]}=AC(..)"
            return f"it closes if {names} are absolute: {how}, or post them from the start"
        if not self.state.centre_absolute and _gap(start, point, start - given, a, b) <= limit:
            return f"it closes with the signs of {names} turned, from the centre to the start: post them from the start to the centre"
        return f"correct the end point or {names} (from the start" + (")" if self.state.iso else "; absolute as I=AC(..))")

    def stop(self) -> None:
        """An exact stop at the end of the last move (G9, M0)."""
        self.state.outside_compensation("an exact stop or a halt is")
        if self.state.out.kinds:
            self.state.out.stops.add(len(self.state.out.kinds) - 1)

    def polar(self, pole: np.ndarray, start: np.ndarray, radius: Item | None, angle: Item | None) -> np.ndarray:
        """The point (3,) at a radius and an angle [deg] about a pole (3,) in the plane; a missing one is that of the start."""
        s, point = self.state, start.copy()
        a, b, _ = arcs.PLANES[s.plane]
        arm = start[[a, b]] - pole[[a, b]]
        size, turn = float(np.hypot(*arm)), math.degrees(math.atan2(arm[1], arm[0]))
        if radius is not None:
            size = radius.value * s.unit + (size if radius.how == "IC" else 0.0)
        if angle is not None:
            turn = angle.value + (turn if angle.how == "IC" else 0.0)
        point[a] = pole[a] + size * math.cos(math.radians(turn))
        point[b] = pole[b] + size * math.sin(math.radians(turn))
        return point

    def to_home(self, home: np.ndarray, names: Container[str], kind: int = mv.RAPID) -> None:
        """The axes named go to their places (5,) in machine coordinates; the others stay."""
        place = [home[INDEX[n]] if n in names else now for n, now in zip(INDEX, [*self.state.out.position[:3], *KEPT])]
        self.go(kind, np.array(place[:3]), (float(place[3]), float(place[4])), machine=True)

    def dwell(self, seconds: float) -> None:
        """A dwell at the current position."""
        if not 0.0 <= seconds <= LONGEST_DWELL:
            raise WordError(f"a dwell of {seconds:g} s is out of range; give 0 to 3600 s")
        out = self.state.out
        if self.state.comp is not None:
            self.state.note("G4 inside G41 or G42 is omitted: the tool does not dwell on the contour")
            return
        out.pauses[len(out.kinds)] = seconds
        out.add(mv.DWELL, (*out.position[:3], math.nan, math.nan), None, math.inf, self.state.line, self.state.block)

    def height(self, value: float) -> None:
        """Rapid to a height [program units] along the normal of the plane, where the tool is not there."""
        if abs(self.state.here()[arcs.PLANES[self.state.plane][2]] - value * self.state.unit) > 1e-12:
            self.steps([(MOVE, value, RAPID)])

    @contextmanager
    def own_feed(self, feed: float | None) -> Iterator[None]:
        """Moves at a feed per minute of their own; None: at that in force."""
        s, mode, kept = self.state, self.state.out.modes.feed_mode, self.state.feed
        if feed is not None:
            s.set_feed_mode(94)
            s.feed = feed
        yield
        s.set_feed_mode(mode)
        s.feed = kept

    def drill(self, cycle: Drilling) -> None:
        """A drilling cycle at this place."""
        self.height(cycle.safe)
        self.steps(drill(cycle), cycle.aside)

    def steps(self, steps: Steps, aside: tuple[float, float] = (0.0, 0.0)) -> None:
        """Steps of a cycle along the normal of the plane; ASIDE and BACK also move by `aside`."""
        across = arcs.PLANES[self.state.plane][2]
        feed = self.state.feed
        for what, value, share in steps:
            if what == DWELL:
                self.dwell(value)
                continue
            point = self.state.here()
            point[across] = value * self.state.unit
            if what in (ASIDE, BACK):
                for i, step in zip(arcs.PLANES[self.state.plane][:2], aside):
                    point[i] += step * self.state.unit * (1.0 if what == ASIDE else -1.0)
            self.state.feed = feed * share
            self.go(mv.RAPID if share == RAPID else mv.LINE, point)
        self.state.feed = feed

    # ------------------------------------------------------------------ cutter radius

    def compensate(self, side: int, radius: float) -> None:
        """G40 (0), G41 (1) or G42 (-1) from the next move on."""
        s = self.state
        if s.comp is not None:
            if side and (side > 0) == (s.comp.offset * radius > 0) and s.comp.tool_radius == abs(radius):
                return
            if side:
                raise WordError("G41 and G42 change sides or radius without G40; write G40 and a move between them")
            stands, s.comp = s.comp.finish(), None
            s.after_compensation = stands is not None
        if side and radius:
            if s.out.modes.traori and not self._stands_across():
                text = "G41 and G42 need a tool perpendicular to the plane G17, G18 or G19; let the CAM system output the tool centre"
                raise WordError(text)
            s.programmed, offset = s.here(), abs(radius) / self._scale() * (1.0 if (side > 0) == (radius > 0) else -1.0)
            s.comp = Compensation(offset, abs(radius), self._emit, along_next=not s.linuxcnc, corners_meet=s.corners_meet)

    def _scale(self) -> float:
        """Scale of the frame in the active plane (SCALE, G51); it scales the contour, not the radius of the tool."""
        if self.state.matrix is None:
            return 1.0
        first, second = (float(np.linalg.norm(self.state.matrix[:, i])) for i in arcs.PLANES[self.state.plane][:2])
        if abs(first - second) > SAME_SCALE * first:
            raise WordError("G41 and G42 need the same scale along both axes of the plane; scale them alike, or write G40")
        return first

    def _stands_across(self) -> bool:
        """Whether the tool is along the normal of the active plane; relevant under a transformation."""
        normal = np.eye(3)[arcs.PLANES[self.state.plane][2]]
        if self.state.matrix is not None:
            normal = self.state.matrix @ normal
        axis = self.state.fixed_axis
        if axis is None:
            axis = self.state.out.kinematics.direction(self.state.out.settle())[0]
        return abs(float(axis @ normal)) > (1.0 - 1e-9) * float(np.linalg.norm(axis) * np.linalg.norm(normal))

    def in_plane(self, move: Move) -> bool:
        """Whether a move is a line, or an arc in the plane, without rotary axes."""
        flat = move.arc is None or abs(move.arc[1][arcs.PLANES[self.state.plane][2]]) > 1.0 - 1e-9
        return flat and move.vector is None and all(map(math.isnan, move.angles))

    def element(self, move: Move, start: np.ndarray) -> Element:
        """A move from `start` (3,) as an element of a contour in the plane."""
        a, b, c = arcs.PLANES[self.state.plane]
        centre, sense, turns, point = None, 0, 0, move.point
        if move.arc is not None:
            middle, normal, angle = move.arc
            centre, sense, turns = middle[[a, b]], int(np.sign(normal[c])), math.ceil(angle / (2.0 * math.pi) - 1e-9) - 1
        whole = centre is not None and float(np.hypot(*(point - start)[[a, b]])) < 1e-9
        return Element(start[[a, b]], point[[a, b]], (start[c], point[c]), centre, sense, turns, move, whole=whole)

    def _beside(self, move: Move) -> None:
        """Queue a move of the contour for radius compensation."""
        s, start, point = self.state, self.state.here(), move.point
        assert s.comp is not None
        if not self.in_plane(move):
            raise WordError("only moves in X Y Z run inside G41 or G42; write G40 before")
        element, length = self.element(move, start), float(np.linalg.norm(point - start))
        if move.arc is not None:
            radius = float(np.hypot(*(element.a - element.centre)))
            length = math.hypot(move.arc[2] * radius, element.across[1] - element.across[0])
        mode = s.out.all_modes[move.mode]
        if mode.feed_mode == 93:  # G93 gives the time of the contour; the tool keeps the same speed
            now = s.out.modes.feed_mode
            s.out.change(feed_mode=94)
            move = move._replace(feed=move.feed * length / mode.feed_unit, mode=len(s.out.all_modes) - 1)
            s.out.change(feed_mode=now)
            element.move = move
        s.programmed = point.copy()
        s.comp.add(element)

    def _emit(self, e: Element) -> None:
        """Emit a finished element of the compensation."""
        s = self.state
        a, b, c = arcs.PLANES[s.plane]
        start, point = s.to_program(np.array(s.out.position[:3])), np.zeros(3)
        point[[a, b]], point[c] = e.b, e.across[1]
        arc, kind, whole = None, e.move.kind, e.whole and float(np.hypot(*(e.b - start[[a, b]]))) < GOUGE
        if whole:  # a corner that rounding made must not turn it into an arc of no length
            point[[a, b]] = start[[a, b]]
        moves = np.linalg.norm(point - start) > 1e-12 or e.turns or whole
        if moves and e.centre is not None:
            centre = start.copy()
            centre[[a, b]] = e.centre
            arc, kind = self.arc_about(start, point, centre, e.sense < 0, e.turns), mv.ARC
        if moves:
            self._put(e.move._replace(kind=kind, point=point, arc=arc))


def _gap(start: np.ndarray, end: np.ndarray, centre: np.ndarray, a: int, b: int) -> float:
    """Difference of the radii at both ends of an arc in the plane of the axes a and b [m]."""
    return float(abs(np.hypot(*(start - centre)[[a, b]]) - np.hypot(*(end - centre)[[a, b]])))


def _vector(v: np.ndarray) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])
