"""Rounded and chamfered corners between two lines: RND, RNDM, CHF, CHR (SINUMERIK), ,R and ,C (ISO). A move waits until the next is known."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import KEPT, Control, Move
from twin.program.expressions import WordError


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
        if self.held is not None:
            if self.held.move.arc is not None:
                raise WordError("a tangent behind RND or CHF on an arc is not supported; write the corner as blocks", 1)
            way = self.held.move.point - self.held.start
        elif self.last is not None:
            move, start = self.last
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
        before = np.array(out.targets[rows[0]][:3]) if len(rows) == 2 else out.home
        return self.state.to_program(np.array(out.targets[rows[-1]][:3])) - self.state.to_program(before)

    def queue(self, move: Move, corner: tuple[str, float] | None) -> None:
        """Emit a move, or hold it until the next move defines its corner; `corner`: word and size [m]."""
        if self.every_corner and corner is None and move.kind == mv.LINE:
            corner = "RNDM", self.every_corner
        if self.held is not None:
            self._cut_corner(self.held, move)
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
                raise WordError(f"a move in the plane must follow {what}; add it or remove {what}", 1)
            self._go(move)

    def _cut_corner(self, held: Held, following: Move) -> None:
        """Emit the waiting move, then the chamfer or rounding before the following one."""
        what, size, before, start = held
        self.held = None
        corner = before.point
        u, v = corner - start, following.point - corner
        lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
        straight = before.arc is None and following.arc is None and following.kind != mv.RAPID
        if not straight or min(lengths) < 1e-9:
            if what == "RNDM":
                if following.kind != mv.RAPID and following.arc is not None:
                    self.state.note("RNDM: a corner between a line and an arc is not rounded; write it as blocks where it is no tangent")
                self._go(before)
                return
            raise WordError(f"{what} between moves that are not both lines is not supported; write the corner as blocks", 1)
        u, v = u / lengths[0], v / lengths[1]
        angle = math.acos(max(-1.0, min(1.0, float(u @ v))))
        if angle < 1e-6:
            self._go(before)
            return
        cut = (
            size
            if what in CUT_OFF
            else size / (2.0 * math.cos(0.5 * angle))
            if what == "CHF" and angle < math.pi - 1e-6
            else size * math.tan(0.5 * angle)
        )
        if angle > math.pi - 1e-6 or cut > min(lengths) + 1e-9:
            raise WordError(f"{what} {size * 1e3:g} mm does not fit into the corner; make it smaller", 1)
        first, last = corner - cut * u, corner + cut * v
        self._go(before._replace(point=first))
        cut_off = before._replace(point=last, angles=KEPT, vector=None, machine=False)
        if what == "CHF" or what in CUT_OFF:
            self._go(cut_off)
        else:
            normal = np.cross(u, v)
            normal = normal / np.linalg.norm(normal)
            centre = first + size * np.cross(normal, u)
            axis = arcs.PLANES[self.state.plane][2]
            if abs(abs(normal[axis]) - 1.0) > 1e-9:
                raise WordError(f"{what} does not lie in the plane G{self.state.plane}; select the plane", 1)
            self._go(cut_off._replace(kind=mv.ARC, arc=self.control.arc_about(first, last, centre, bool(normal[axis] < 0))))
