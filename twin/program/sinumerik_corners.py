"""Corners of SINUMERIK programs: RND, RNDM, CHF and CHR hold a move back until the next one is known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import Item
from twin.program.expressions import WordError
from twin.program.sinumerik_lines import SinumerikLines


class SinumerikCorners(SinumerikLines):
    """Moves that go out at once, or wait for their corner."""

    def __init__(self, path: Path, machine: Machine):
        super().__init__(path, machine)
        self.tangent: np.ndarray | None = None
        self.corner: tuple[str, float] | None = None  # RND, CHF or CHR that waits for the next move
        self.every_corner = 0.0  # RNDM [m]
        self.held: tuple | None = None

    def _from(self) -> np.ndarray:
        return self.held[1].copy() if self.held is not None else self.here()

    def _target(self, coordinates: dict[str, Item], suppress: bool) -> tuple[np.ndarray, list[float]]:
        if self.held is None:
            return self.target(coordinates, suppress)
        kept, self.comp_hold = self.here, None
        held = self.held[1].copy()
        self.here = lambda: held.copy()  # type: ignore[method-assign]
        try:
            return self.target(coordinates, suppress)
        finally:
            self.here = kept  # type: ignore[method-assign]

    def _queue(self, kind, point, angles, vector, arc, space, suppress, corner) -> None:  # type: ignore[no-untyped-def]
        """Put a move out, or hold it back until its corner with the next one is known."""
        if self.every_corner and corner is None and kind == mv.LINE:
            corner = "RNDM", self.every_corner
        row = (kind, point, angles, vector, arc, space, suppress, self.feed, self.line, self.block)
        if self.held is not None:
            row = self._cut_corner(row)
        if corner is not None and corner[1] > 0.0:
            self.held = (corner, point.copy(), row, self._start_of(row))
            return
        self._go(row)

    def _start_of(self, row) -> np.ndarray:  # type: ignore[no-untyped-def]
        return self.here()

    def _go(self, row) -> None:  # type: ignore[no-untyped-def]
        kind, point, angles, vector, arc, space, suppress, feed, line, block = row
        now = self.feed, self.line, self.block
        self.feed, self.line, self.block = feed, line, block
        start = self.here() if not suppress else None
        self.go(kind, point, angles, vector, arc, suppress=suppress, space_arc=space)
        self.tangent = None
        if start is not None and arc is None and space is None and np.linalg.norm(point - start) > 0:
            self.tangent = (point - start) / np.linalg.norm(point - start)
        elif arc is not None and start is not None:
            _, normal, _ = arcs.from_centre(start, point, arc[0], self.plane, arc[1], arc[2])
            way = np.cross(normal, point - arc[0])
            self.tangent = way / np.linalg.norm(way)
        self.feed, self.line, self.block = now

    def _release(self) -> None:
        """A move that was held back for its corner goes out in full."""
        if self.held is not None:
            corner, _, row, _ = self.held
            self.held = None
            if corner[0] != "RNDM":
                raise WordError(f"behind {corner[0]} a move in the plane must follow; add it or remove {corner[0]}", 1)
            self._go(row)

    def _cut_corner(self, row) -> tuple:  # type: ignore[no-untyped-def, type-arg]
        """The held move, then the chamfer or rounding between it and the next."""
        assert self.held is not None
        (what, size), corner, before, start = self.held
        self.held = None
        after = row[1]
        u, v = corner - start, after - corner
        lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
        straight = before[4] is None and row[4] is None and before[5] is None and row[5] is None and row[0] != mv.RAPID
        if not straight or min(lengths) < 1e-9:
            if what == "RNDM":
                self._go(before)
                return row
            raise WordError(f"{what} between moves that are not both lines is not supported; write the corner as blocks", 1)
        u, v = u / lengths[0], v / lengths[1]
        angle = math.acos(max(-1.0, min(1.0, float(u @ v))))
        if angle < 1e-6:
            self._go(before)
            return row
        cut = (
            size
            if what == "CHR"
            else size / (2.0 * math.cos(0.5 * angle))
            if what == "CHF" and angle < math.pi - 1e-6
            else size * math.tan(0.5 * angle)
        )
        if angle > math.pi - 1e-6 or cut > min(lengths) + 1e-9:
            raise WordError(f"{what} {size * 1e3:g} mm does not fit into the corner; make it smaller", 1)
        first, last = corner - cut * u, corner + cut * v
        self._go((before[0], first, *before[2:]))
        none = [math.nan, math.nan]
        if what in ("CHF", "CHR"):
            self._go((before[0], last, none, None, None, None, False, *before[7:]))
        else:
            normal = np.cross(u, v)
            normal = normal / np.linalg.norm(normal)
            centre = first + size * np.cross(normal, u)
            axis = arcs.PLANES[self.plane][2]
            if abs(abs(normal[axis]) - 1.0) > 1e-9:
                raise WordError(f"{what} does not lie in the plane G{self.plane}; select the plane", 1)
            self._go((mv.ARC, last, none, None, (centre, bool(normal[axis] < 0), 0), None, False, *before[7:]))
        return row
