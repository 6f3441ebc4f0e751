"""Moves of the control, used by all languages: targets of blocks, arcs, stops, cycles, radius compensation.

Moves are passed to the collector in machine coordinates; `twin.program.state` has the modal state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.compensation import GOUGE, Compensation, CompensationError, Element
from twin.program.cycles import ASIDE, BACK, DWELL, FEED, RAPID, Drilling, drill
from twin.program.expressions import WordError
from twin.program.state import INDEX, LINEAR, ROTARY, Item, State

LONGEST_DWELL = 3600.0
SAME_SCALE = 1e-9

Vector = tuple[float, float, float]
Arc = tuple[np.ndarray, bool, int]
"""Centre (3,), whether clockwise, full turns more."""
SpaceArc = tuple[np.ndarray, np.ndarray, float]
"""Centre (3,), normal (3,), angle [rad]."""


class Programmed(NamedTuple):
    """Data of a block's move besides X Y Z; `mode` is the number of the active modes."""

    kind: int
    angles: list[float]
    vector: Vector | None
    feed: float
    line: int
    block: int
    mode: int
    tolerance: Callable[[float], float]


class Control:
    """Makes the moves of the blocks one after the other."""

    def __init__(self, state: State) -> None:
        self.state = state

    # ------------------------------------------------------------------ moves

    def target(self, words: dict[str, Item], suppress: bool, start: np.ndarray | None = None) -> tuple[np.ndarray, list[float]]:
        """Target of a block: program coordinates (3,), or machine coordinates if `suppress`; A and C, NaN if not programmed.

        `start` (3,): start of the move; default: position of the tool.
        """
        out = self.state.out
        if any(n in words and (words[n].how not in ("", "AC") or not self.state.absolute) for n in ROTARY):
            out.position[3:] = [float(v) for v in out.settle()]
        if suppress and self.state.comp is not None:
            raise WordError("a block in machine coordinates is inside G41 or G42; write G40 and a move before", 1)
        if start is None:
            start = np.array(out.position[:3]) if suppress else self.state.here()
        point = start.copy()
        angles = [math.nan, math.nan]
        for name, (value, how, column) in words.items():
            si = self.state.si(name, value)
            relative = how == "IC" or (how == "" and not self.state.absolute and not suppress)
            if name in LINEAR:
                if how in ("DC", "ACP", "ACN"):
                    raise WordError(f"{how}() is for rotary axes; use AC() or IC()", column)
                i = INDEX[name]
                point[i] = start[i] + si if relative else si
            elif name in ROTARY:
                i = INDEX[name]
                offset, now = (0.0 if suppress else self.state.offset[i]), out.position[i]
                if relative:
                    goal = now + si
                elif how in ("DC", "ACP", "ACN"):
                    way = (si + offset - now) % (2.0 * math.pi)
                    if (how == "ACN" and way > 0.0) or (how == "DC" and way > math.pi):
                        way -= 2.0 * math.pi
                    goal = now + way
                else:
                    goal = si + offset
                angles[i - 3] = goal
            else:
                self.move_other(name, self.state.other_axes[name] + si if relative else si)
        return point, angles

    def move_other(self, name: str, value: float) -> None:
        """Record an axis that this machine lacks; a value other than zero is reported at the end."""
        self.state.other_axes[name] = value
        if value and "other" not in self.state.out.missing:
            self.state.out.missing["other"] = (
                self.state.line,
                self.state.block,
                next((n for n, slot in self.state.slot_of.items() if slot == name), name),
            )

    def go(
        self,
        kind: int,
        point: np.ndarray,
        angles: list[float],
        vector: Vector | None = None,
        arc: Arc | None = None,
        *,
        suppress: bool = False,
        space_arc: SpaceArc | None = None,
    ) -> None:
        """One move to a point in program coordinates (machine coordinates if `suppress`); `arc`: centre, clockwise, turns more."""
        self.feed_given(kind)
        if self.state.after_compensation and self.state.comp is None:
            if arc is not None or space_arc is not None:
                raise WordError("the move after G40 must be straight, not an arc; add a straight move", 1)
            self.state.after_compensation = False
            self.state.settle_plain()
        said = Programmed(
            kind,
            angles,
            vector,
            self.state.feed * self.state.override,
            self.state.line,
            self.state.block,
            len(self.state.out.all_modes) - 1,
            self.state.closing(),
        )
        if self.state.comp is not None and not suppress:
            self._beside(said, self.state.here(), point, arc, space_arc)
            return
        self._put(said, self.state.here() if not suppress else np.array(self.state.out.position[:3]), point, arc, suppress, space_arc)

    def feed_given(self, kind: int) -> None:
        if kind != mv.RAPID and math.isnan(self.state.feed):
            text = "no feed is programmed yet; give F (mm/min, deg/min for A and C alone) in or before this block, or feed_mm_min in [program] of the machine file"
            if self.state.path.suffix.lower() == ".spf":
                text = "no feed is programmed yet, which a call gives this subprogram; read the program that calls it"
            raise self.state.out.fail(self.state.line, self.state.block, text)

    def _put(
        self,
        said: Programmed,
        start: np.ndarray,
        point: np.ndarray,
        arc: Arc | None,
        suppress: bool = False,
        space_arc: SpaceArc | None = None,
    ) -> None:
        """Pass a move to the collector, in machine coordinates."""
        kind, angles, vector, feed, line, block, mode, tolerance = said
        out = self.state.out
        goal = point if suppress else self.state.to_machine(point)
        circle = space_arc
        if arc is not None:
            centre, clockwise, turns = arc
            radius = float(np.linalg.norm(start - centre))
            circle = arcs.from_centre(start, point, centre, self.state.plane, clockwise, turns, tolerance(radius))
        if circle is not None:
            out.arcs[len(out.kinds)] = circle if suppress else self._turned(circle)
        if self.state.fixed_axis is not None and vector is None and math.isnan(angles[0]) and math.isnan(angles[1]):
            vector = _vector(self.state.fixed_axis)
        elif vector is not None and self.state.matrix is not None:
            vector = _vector(self.state.matrix @ np.array(vector))
        out.add(kind, (*map(float, goal), *angles), vector, math.inf if kind == mv.RAPID else feed, line, block)
        out.mode_of[-1] = mode
        out.position[:3] = [float(v) for v in goal]
        for i, angle in enumerate(angles):
            if not math.isnan(angle):
                out.position[3 + i] = angle
        if vector is not None:
            out.position[3:] = [math.nan, math.nan]

    def _turned(self, circle: SpaceArc) -> SpaceArc:
        """An arc in machine coordinates; a mirror reverses its direction."""
        centre, normal, angle = circle
        if self.state.matrix is not None:
            gram = self.state.matrix.T @ self.state.matrix
            if not np.allclose(gram, np.eye(3) * gram[0, 0], atol=1e-9):
                raise WordError("an arc under a SCALE that differs between axes is no arc; scale all axes alike", 1)
            normal = self.state.matrix @ normal / math.sqrt(gram[0, 0]) * math.copysign(1.0, np.linalg.det(self.state.matrix))
        return self.state.to_machine(centre), normal, angle

    def arc_centre(self, start: np.ndarray, point: np.ndarray, words: dict[str, Item], radius: float | None) -> np.ndarray:
        """Centre (3,) from I J K or the radius, program coordinates."""
        clockwise = self.state.motion == 2
        if radius is not None and words:
            raise WordError("the circle is given twice, by its centre (I J K) and by its radius; keep one", 1)
        if radius is not None:
            return arcs.centre_from_radius(start, point, radius, self.state.plane, clockwise)
        a, b, _ = arcs.PLANES[self.state.plane]
        middle = start.copy()
        for name, (value, how, column) in words.items():
            i = "IJK".index(name)
            if i not in (a, b) and value == 0.0 and not (how == "AC" or self.state.centre_absolute):
                continue  # some posts write all three
            if i not in (a, b):
                raise WordError(f"{name} does not lie in the plane G{self.state.plane}; select the plane with G17, G18 or G19", column)
            absolute = how == "AC" or (how == "" and self.state.centre_absolute)
            middle[i] = value * self.state.unit + (0.0 if absolute else start[i])
        gap = _gap(start, point, middle, a, b)
        if gap > self.state.closing()(float(np.linalg.norm((start - middle)[[a, b]]))):
            raise arcs.ArcError(
                f"the arc does not close: its radius is {gap * 1e3:.4f} mm greater or smaller at its end; {self._as_meant(start, point, words)}"
            )
        return middle

    def _as_meant(self, start: np.ndarray, point: np.ndarray, words: dict[str, Item]) -> str:
        """What to do about an open arc: whether it closes with another meaning of I J K."""
        a, b, _ = arcs.PLANES[self.state.plane]
        given = np.array([words["IJK"[i]].value * self.state.unit if "IJK"[i] in words else 0.0 for i in range(3)])
        limit = self.state.closing()(float(np.linalg.norm(given - start)))
        names = " ".join("IJK"[i] for i in sorted((a, b)))
        if not self.state.centre_absolute and _gap(start, point, given, a, b) <= limit:
            how = "write G90.1 before" if self.state.iso else f"write {'IJK'[a]}=AC(..) {'IJK'[b]}=AC(..)"
            return f"it closes if {names} are absolute: {how}, or post them from the start"
        if not self.state.centre_absolute and _gap(start, point, start - given, a, b) <= limit:
            return f"it closes with the signs of {names} turned, from the centre to the start: post them from the start to the centre"
        return f"correct the end point or {names} (from the start" + (")" if self.state.iso else "; absolute as I=AC(..))")

    def stop(self, pause: float) -> None:
        """An exact stop at the end of the last move, then a pause [s] (G9, M0)."""
        if self.state.comp is not None:
            raise WordError("an exact stop or a halt inside G41 or G42 is not simulated; write it after G40", 1)
        if self.state.out.kinds:
            self.state.out.stops[len(self.state.out.kinds) - 1] = pause

    def dwell(self, seconds: float) -> None:
        """A dwell at the current position."""
        if not 0.0 <= seconds <= LONGEST_DWELL:
            raise WordError(f"a dwell of {seconds:g} s is out of range; give 0 to 3600 s", 1)
        out = self.state.out
        if self.state.comp is not None:
            out.notes["G4 inside G41 or G42 is omitted: the tool does not dwell on the contour"] = None
            return
        out.pauses[len(out.kinds)] = seconds
        out.add(mv.DWELL, (*out.position[:3], math.nan, math.nan), None, math.inf, self.state.line, self.state.block)

    def height(self, value: float) -> None:
        """Rapid to a height [program units] along the normal of the plane."""
        self.steps([(RAPID, value, 1.0)])

    def drill(self, cycle: Drilling) -> None:
        """The steps of a drilling cycle at this place."""
        self.steps(drill(cycle), cycle.aside)

    def steps(self, steps: list[tuple[str, float, float]], aside: tuple[float, float] = (0.0, 0.0)) -> None:
        """Steps (kind, height or time, share of the feed) along the normal of the plane; ASIDE and BACK also move by `aside`."""
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
            self.go(mv.LINE if what == FEED else mv.RAPID, point, [math.nan, math.nan])
        self.state.feed = feed

    # ------------------------------------------------------------------ cutter radius

    def compensate(self, side: int, radius: float, *, along_next: bool, corners_meet: bool = False) -> None:
        """G40 (0), G41 (1) or G42 (-1) from the next move on."""
        if self.state.comp is not None:
            if side and (side > 0) == (self.state.comp.offset * radius > 0) and self.state.comp.tool_radius == abs(radius):
                return
            if side:
                raise WordError("G41 and G42 change sides or radius without G40; write G40 and a move between them", 1)
            self._end_compensation()
        if side and radius:
            if self.state.out.modes.traori and not self._stands_across():
                raise WordError(
                    "G41 and G42 need a tool perpendicular to the plane G17, G18 or G19; let the CAM system output the tool centre", 1
                )
            self.state.programmed = self.state.here()
            self.state.comp = Compensation(
                abs(radius) / self._scale(),
                (side > 0) == (radius > 0),
                along_next=along_next,
                corners_meet=corners_meet,
                emit=self._emit,
                tool_radius=abs(radius),
            )
        self.state.settle_plain()

    def _scale(self) -> float:
        """Scale of the frame in the active plane (SCALE, G51); it scales the contour, not the radius of the tool."""
        if self.state.matrix is None:
            return 1.0
        first, second = (float(np.linalg.norm(self.state.matrix[:, i])) for i in arcs.PLANES[self.state.plane][:2])
        if abs(first - second) > SAME_SCALE * first:
            raise WordError("G41 and G42 need the same scale along both axes of the plane; scale them alike, or write G40", 1)
        return first

    def _stands_across(self) -> bool:
        """Whether the tool is along the normal of the active plane; relevant under a transformation."""
        normal = np.eye(3)[arcs.PLANES[self.state.plane][2]]
        if self.state.matrix is not None:
            normal = self.state.matrix @ normal
        axis = self.state.fixed_axis
        if axis is None:
            machine = np.concatenate([np.zeros(3), self.state.out.settle()])
            axis = self.state.out.kinematics.forward(machine)[1][0]
        return abs(float(axis @ normal)) > (1.0 - 1e-9) * float(np.linalg.norm(axis) * np.linalg.norm(normal))

    def _end_compensation(self) -> None:
        assert self.state.comp is not None
        comp = self.state.comp
        try:
            stands = comp.finish()
        except CompensationError as error:
            raise WordError(str(error), 1) from None
        self.state.comp = None
        self.state.after_compensation = stands is not None
        self.state.settle_plain()

    def _beside(self, said: Programmed, start: np.ndarray, point: np.ndarray, arc: Arc | None, space_arc: SpaceArc | None) -> None:
        """Queue a move of the contour for radius compensation."""
        assert self.state.comp is not None
        if space_arc is not None or said.vector is not None or not all(math.isnan(v) for v in said.angles):
            raise WordError("only moves in X Y Z run inside G41 or G42; write G40 before", 1)
        a, b, c = arcs.PLANES[self.state.plane]
        mode = self.state.out.all_modes[said.mode]
        centre, sense, turns, length = None, 0, 0, float(np.linalg.norm(point - start))
        if arc is not None:
            circle = arcs.from_centre(
                start, point, arc[0], self.state.plane, arc[1], arc[2], said.tolerance(float(np.linalg.norm(start - arc[0])))
            )
            centre, sense, turns = circle[0][[a, b]], (-1 if arc[1] else 1), arc[2]
            length = math.hypot(circle[2] * float(np.hypot(*(start[[a, b]] - centre))), point[c] - start[c])
        if mode.feed_mode == 93:  # G93 gives the time of the contour; the tool keeps the same speed
            self.state.out.set_modes(replace(self.state.out.modes, feed_mode=94))
            said = said._replace(feed=said.feed * length / mode.feed_unit, mode=len(self.state.out.all_modes) - 1)
            self.state.out.set_modes(mode)
        element = Element(start[[a, b]], point[[a, b]], (start[c], point[c]), centre, sense, turns, said)
        element.whole = centre is not None and float(np.hypot(*(element.b - element.a))) < 1e-9
        self.state.programmed = point.copy()
        try:
            self.state.comp.add(element)
        except CompensationError as error:
            raise WordError(str(error), 1) from None

    def _emit(self, e: Element) -> None:
        """Emit a finished element of the compensation."""
        a, b, c = arcs.PLANES[self.state.plane]
        comp, self.state.comp = self.state.comp, None
        after, self.state.after_compensation = self.state.after_compensation, False
        start, point = self.state.here(), np.zeros(3)
        point[[a, b]], point[c] = e.b, e.across[1]
        said: Programmed = e.move
        arc, whole = None, e.whole and float(np.hypot(*(e.b - start[[a, b]]))) < GOUGE
        if whole:  # a corner that rounding made must not turn it into an arc of no length
            point[[a, b]] = start[[a, b]]
        if e.centre is not None:
            centre = start.copy()
            centre[[a, b]] = e.centre
            arc = centre, e.sense < 0, e.turns
            said = said._replace(kind=mv.ARC)
        elif said.kind == mv.ARC:
            said = said._replace(kind=mv.LINE)
        if np.linalg.norm(point - start) > 1e-12 or e.turns or whole:
            self._put(said, start, point, arc)
        self.state.comp, self.state.after_compensation = comp, after


def _gap(start: np.ndarray, end: np.ndarray, centre: np.ndarray, a: int, b: int) -> float:
    """Difference of the radii at both ends of an arc in the plane of the axes a and b [m]."""
    return float(abs(np.hypot(*(start - centre)[[a, b]]) - np.hypot(*(end - centre)[[a, b]])))


def _vector(v: np.ndarray) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])
