"""Rounded and chamfered corners between two moves: RND, RNDM, CHF, CHR (SINUMERIK), ,R and ,C (ISO). A move waits until the next is known."""

import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.compensation import Element, holds, meet, moved
from twin.program.control import KEPT, Control, Move
from twin.program.expressions import WordError, needed


class Held(NamedTuple):
    """A move from `start` (3,) that waits for the next one, with the word of its corner and its size [m]."""

    word: str
    size: float
    move: Move
    start: np.ndarray


CUT_OFF = ("CHR", ",C")
"""Words that give the distance of the chamfer from the corner; CHF gives the length of the chamfer."""


class Corners:
    """Moves that are emitted at once, or wait for their corner."""

    def __init__(self, control: Control) -> None:
        self.control, self.state = control, control.state
        self.last: tuple[Move, np.ndarray] | None = None  # the last move and its start; None if it was read as a plain block
        self.every_corner = 0.0  # RNDM [m]
        self.held: Held | None = None  # RND, CHF or CHR that waits for the next move

    def start(self) -> np.ndarray:
        """Start of the next move (3,): position of the tool after the waiting move."""
        return self.held.move.point.copy() if self.held is not None else self.state.here()

    def direction(self) -> np.ndarray | None:
        """Unit vector (3,) of the motion at the end of the last move, which a tangent arc continues."""
        last = (self.held.move, self.held.start) if self.held is not None else self.last
        if last is not None:
            move, start = last
            way = move.point - start if move.arc is None else np.cross(move.arc[1], move.point - move.arc[0])
        else:
            way = self._of_last_row()
        return way / np.linalg.norm(way) if np.linalg.norm(way) > 1e-12 else None

    def _of_last_row(self) -> np.ndarray:
        """Way (3,) of the last move, which was read as a plain block or in machine coordinates; zero if it is not known."""
        out = self.state.out
        rows = [row for row in range(max(0, len(out.kinds) - 20), len(out.kinds)) if out.kinds[row] != mv.DWELL][-2:]
        traori = {out.all_modes[out.mode_of[row]].traori for row in rows}
        if not rows or out.kinds[rows[-1]] == mv.ARC or self.state.comp is not None or len(traori) > 1:
            return np.zeros(3)
        before = np.array(out.targets[rows[0]][:3]) if len(rows) == 2 else out.home[:3]
        return self.state.to_program(np.array(out.targets[rows[-1]][:3])) - self.state.to_program(before)

    def queue(self, move: Move, corner: tuple[str, float] | None) -> None:
        """Emit a move, or hold it until the next move defines its corner; `corner`: word and size [m]."""
        if self.every_corner and corner is None and move.kind != mv.RAPID:
            corner = "RNDM", self.every_corner
        if self.held is not None:
            *earlier, move = self._cut_corner(self.held, move)
            self.held = None
            for one in earlier:
                self._go(one)
        if corner is not None and corner[1] > 0.0:
            self.held = Held(*corner, move._replace(point=move.point.copy()), self.state.here())
            return
        self._go(move)

    def _go(self, move: Move) -> None:
        """Emit a move."""
        start = None if move.machine else self.state.here()
        self.control.make(move)
        self.last = None if start is None else (move, start)

    def release(self) -> None:
        """Emit a waiting move at full length."""
        if self.held is not None:
            what, _, move, _ = self.held
            self.held = None
            if what != "RNDM":
                raise WordError(f"a move in the plane must follow {what}; add it or remove {what}")
            self._go(move)

    def _cut_corner(self, held: Held, following: Move) -> list[Move]:
        """The waiting move, the chamfer or rounding if there is one, and the following move from its new start on."""
        what, size, before, start = held
        if following.kind == mv.RAPID and what == "RNDM":
            return [before, following]
        lines = before.arc is None and following.arc is None and following.kind != mv.RAPID
        if lines and what not in ("RND", "RNDM", ",R"):
            return self._chamfer(held, following)
        axis = arcs.PLANES[self.state.plane][2]
        one, two = self.control.element(before, start), self.control.element(following, before.point)
        ways = [float(np.hypot(*(e.b - e.a))) if e.centre is None else 1.0 for e in (one, two)]
        if following.kind == mv.RAPID or min(ways) < 1e-9 or not (self.control.in_plane(before) and self.control.in_plane(following)):
            if what == "RNDM":
                self.state.note("RNDM: corners outside the plane and beside rotary axes are not rounded")
                return [before, following]
            raise WordError(f"{what} needs a move in the plane G{self.state.plane} on both sides; select the plane, or write the corner")
        t, u = one.direction(True), two.direction(False)
        turn = math.atan2(t[0] * u[1] - t[1] * u[0], float(t @ u))
        if abs(turn) < 1e-6:
            return [before, following]
        if max(abs(before.point[axis] - start[axis]), abs(following.point[axis] - before.point[axis])) > 1e-9:
            raise WordError(f"{what} does not lie in the plane G{self.state.plane}; select the plane")
        if what not in ("RND", "RNDM", ",R"):
            raise WordError(f"{what} between moves that are not both lines is not supported; write the corner as blocks")
        cut = needed(
            _fillet(one, two, math.copysign(size, turn)), f"{what} {size * 1e3:g} mm does not fit into the corner; make it smaller"
        )
        first, last, centre = (before.point.copy() for _ in cut)
        for place, p in zip((first, last, centre), cut):
            place[list(arcs.PLANES[self.state.plane][:2])] = p
        rounding = self.control.arc_about(first, last, centre, turn < 0.0)
        corner = before._replace(kind=mv.ARC, point=last, angles=KEPT, vector=None, arc=rounding, machine=False)
        return [self._from(before, start, first), corner, self._from(following, last, following.point)]

    def _chamfer(self, held: Held, following: Move) -> list[Move]:
        """The waiting line, the chamfer, and the following line."""
        what, size, before, start = held
        ways = before.point - start, following.point - before.point
        lengths = [float(np.linalg.norm(way)) for way in ways]
        if min(lengths) < 1e-9:
            raise WordError(f"{what} between moves that are not both lines is not supported; write the corner as blocks")
        t, u = (way / length for way, length in zip(ways, lengths))
        turn = math.acos(max(-1.0, min(1.0, float(t @ u))))
        cut = size if what in CUT_OFF else size / max(2.0 * math.cos(0.5 * turn), 1e-9)
        if turn > 1e-6 and (turn > math.pi - 1e-6 or cut > min(lengths) + 1e-9):
            raise WordError(f"{what} {size * 1e3:g} mm does not fit into the corner; make it smaller")
        if turn < 1e-6:
            return [before, following]
        corner = before._replace(point=before.point + cut * u, angles=KEPT, vector=None, machine=False)
        return [before._replace(point=before.point - cut * t), corner, following]

    def _from(self, move: Move, start: np.ndarray, end: np.ndarray) -> Move:
        """The move with other ends on the same line or circle."""
        if move.arc is None:
            return move._replace(point=end)
        clockwise = move.arc[1][arcs.PLANES[self.state.plane][2]] < 0.0
        return move._replace(point=end, arc=self.control.arc_about(start, end, move.arc[0], clockwise))


def _fillet(one: Element, two: Element, offset: float) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """A rounding that is a tangent to both elements: its centre is where they meet, shifted by the radius to its side.

    Ends (2,) on both elements, and centre. None if the elements are too short, or a circle is smaller than the rounding inside it.
    """
    try:
        shifted = moved(one, offset), moved(two, offset)
    except WordError:
        return None
    for centre in meet(*shifted, one.b):
        if holds(shifted[0], centre) and holds(shifted[1], centre):
            first, last = (_foot(e, centre) for e in (one, two))
            return first, last, centre
    return None


def _foot(e: Element, p: np.ndarray) -> np.ndarray:
    """The point (2,) of an element, or of its extension, next to another."""
    if e.centre is None:
        t = e.direction(False)
        return e.a + t * float((p - e.a) @ t)
    arm = p - e.centre
    return e.centre + arm * float(np.hypot(*(e.b - e.centre)) / np.hypot(*arm))
