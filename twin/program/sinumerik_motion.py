"""The motion blocks of SINUMERIK programs: lines, arcs, tool axes, polar coordinates, fixed points, dwell."""

from __future__ import annotations

from dataclasses import dataclass, field
import math

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.arcs import Arc
from twin.program.control import Vector
from twin.program.expressions import Value, WordError
from twin.program.frames import INDEX, LINEAR, ROTARY, rotation
from twin.program.sinumerik_frames import SinumerikFrames
from twin.program.state import Item
from twin.program.words import Word

_ARC_WORDS = {"CR", "AR", "TURN", "I1", "J1", "K1"}


@dataclass
class Block:
    """The words of one block by their use; each step removes the words that it used, so a remaining word is an error."""

    coordinates: dict[str, Item] = field(default_factory=dict)
    centre: dict[str, Item] = field(default_factory=dict)  # I J K
    extra: dict[str, Item] = field(default_factory=dict)  # other words with a number
    tool: dict[str, tuple[Value, int]] = field(default_factory=dict)  # T D H M6: value and column
    g: list[tuple[float, Word]] = field(default_factory=list)
    m: list[int] = field(default_factory=list)
    names: list[Word] = field(default_factory=list)  # words without a number
    calls: list[Word] = field(default_factory=list)  # subprograms

    @property
    def numbers(self) -> set[float]:
        """The G codes."""
        return {number for number, _ in self.g}


class SinumerikMotion:
    """Moves."""

    def __init__(self, frames: SinumerikFrames) -> None:
        self.frames, self.state, self.corners, self.control = frames, frames.state, frames.corners, frames.corners.control
        self.pole = np.zeros(3)
        self.angles_are_rpy: bool | None = None
        self.corners_meet = False  # G451

    def orientation(self, extra: dict[str, Item]) -> Vector | None:
        """The tool axis of a block, by a vector or by angles."""
        vector = [n for n in ("A3", "B3", "C3") if n in extra]
        angles = [n for n in ("A2", "B2", "C2") if n in extra]
        if not vector and not angles:
            return None
        if not self.state.out.modes.traori:
            raise WordError("A3= B3= C3= need TRAORI; switch it on before, or program A= and C=", 1)
        if vector:
            x, y, z = (extra.pop(n).value if n in extra else 0.0 for n in ("A3", "B3", "C3"))
            return x, y, z
        if self.angles_are_rpy is None:
            raise WordError("A2= B2= C2= count as the control is set; write ORIRPY or ORIEULER before", 1)
        a, b, c = (extra.pop(n).value if n in extra else 0.0 for n in ("A2", "B2", "C2"))
        matrix = (
            rotation(2, c) @ rotation(1, b) @ rotation(0, a) if self.angles_are_rpy else rotation(2, a) @ rotation(0, b) @ rotation(2, c)
        )
        return float(matrix[0, 2]), float(matrix[1, 2]), float(matrix[2, 2])

    def motion_block(self, block: Block, vector: Vector | None, suppress: bool, by_name: str | None) -> None:
        """One motion block: target, tool axis, arc, corner; `by_name` is CIP or CT."""
        numbers, coordinates, centre, extra = block.numbers, block.coordinates, block.centre, block.extra
        about_pole = bool(extra.keys() & {"AP", "RP"}) and not centre and "CR" not in extra
        self._polar(coordinates, extra)
        self._slanted(coordinates, extra)
        if vector and ("A" in coordinates or "C" in coordinates):
            raise WordError("the tool axis is given twice, by A3= B3= C3= and by A= C=; keep one", 1)
        if "RNDM" in extra:
            self.corners.every_corner = max(0.0, extra.pop("RNDM").value) * self.state.unit
        corner = next(((n, extra.pop(n).value * self.state.unit) for n in ("RND", "CHF", "CHR") if n in extra), None)
        by_words = extra.keys() & _ARC_WORDS
        programmed = bool(numbers & {2, 3}) or by_name
        kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[self.state.motion if self.state.motion is not None else 1]
        if numbers & {331, 332, 63}:
            kind = mv.LINE
            self._tap(numbers, centre)
        if extra.pop("POS", None) is not None and len(coordinates) == 1 and not numbers:
            kind = mv.RAPID
        moves = bool(coordinates or vector or (centre and kind == mv.ARC) or (programmed and by_words))
        if not moves:
            if centre or by_words:
                raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add the motion and its end point", 1)
            if corner:
                raise WordError(f"{corner[0]} belongs in the block of a move; write it there", 1)
            return
        if kind != mv.ARC and (centre or by_words):
            raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add it to the block", 1)
        start = np.array(self.state.out.position[:3]) if suppress else self.corners.start()
        if self.corners.held is not None and (suppress or any(n in coordinates for n in ROTARY) or vector):
            self.corners.release()
        self.frames.note_increments(coordinates)
        point, angles = self.control.target(coordinates, suppress, start)
        arc = None
        if kind == mv.ARC and about_pole and by_name is None and "AR" not in extra:
            for i in arcs.PLANES[self.state.plane][:2]:
                centre["IJK"[i]] = Item(self.pole[i] / self.state.unit, "AC")
        if kind == mv.ARC:
            arc = self._arc(start, point, centre, extra, by_name)
        self.corners.queue(self.control.move(kind, point, angles, vector, arc, suppress), corner)

    def _arc(self, start: np.ndarray, point: np.ndarray, centre: dict[str, Item], extra: dict[str, Item], by_name: str | None) -> Arc:
        """The arc of the block; AR= sets the end `point` (3,)."""
        turns = int(extra.pop("TURN").value) if "TURN" in extra else 0
        if not 0 <= turns <= 10_000:
            raise WordError(f"TURN={turns} is out of range; give 0 to 10000", 1)
        if by_name == "CIP":
            middle = start.copy()
            for i, name in enumerate(("I1", "J1", "K1")):
                if name in extra:
                    item = extra.pop(name)
                    relative = item.how == "IC" or (item.how == "" and not self.state.absolute)
                    middle[i] = item.value * self.state.unit + (start[i] if relative else 0.0)
            return arcs.through(start, middle, point)
        if by_name == "CT":
            if (direction := self.corners.direction()) is None:
                raise WordError("CT needs a move before it, whose direction it continues; use CIP or G2", 1)
            return arcs.tangential(start, direction, point, self.state.plane)
        clockwise = self.state.motion == 2
        if "AR" in extra:
            item = extra.pop("AR")
            if not 0.0 < item.value < 360.0:
                raise WordError(f"AR={item.value:g}: the angle of an arc lies between 0 and 360 degrees", item.column)
            a, b, _ = arcs.PLANES[self.state.plane]
            angle = math.radians(item.value) * (-1.0 if clockwise else 1.0)
            if centre:
                middle = self.control.arc_centre(start, point, centre, None)
                arm = start[[a, b]] - middle[[a, b]]
                c, s = math.cos(angle), math.sin(angle)
                point[[a, b]] = middle[[a, b]] + [c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]]
            else:
                middle = start.copy()
                chord = point[[a, b]] - start[[a, b]]
                side = 0.5 / math.tan(0.5 * angle)
                middle[[a, b]] = start[[a, b]] + 0.5 * chord + side * np.array([-chord[1], chord[0]])
            return self.control.arc_about(start, point, middle, clockwise, turns)
        radius = extra.pop("CR").value * self.state.unit if "CR" in extra else None
        if radius is None and not centre:
            raise WordError("a circle needs its centre (I J K) or radius (CR=, in .ngc files R); add it to the block", 1)
        return self.control.arc_about(start, point, self.control.arc_centre(start, point, centre, radius), clockwise, turns)

    def _tap(self, numbers: set[float], centre: dict[str, Item]) -> None:
        """G331, G332: along the thread; the feed is pitch times speed. G63 uses the active feed."""
        if 63 in numbers:
            return
        across = "IJK"[arcs.PLANES[self.state.plane][2]]
        if across not in centre:
            raise WordError(f"G331 and G332 need the pitch {across}; add it", 1)
        pitch = abs(centre.pop(across).value)
        if not self.state.out.modes.spindle:
            raise WordError("G331 and G332 need a spindle speed; give S before", 1)
        self.state.set_feed_mode(94)
        self.state.feed = pitch * self.state.out.modes.spindle * self.state.unit / self.state.out.modes.feed_unit

    def _polar(self, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """AP= and RP=: angle and radius about the pole."""
        if not extra.keys() & {"AP", "RP"}:
            return
        a, b, _ = arcs.PLANES[self.state.plane]
        here = self.corners.start()
        arm = here[[a, b]] - self.pole[[a, b]]
        angle, radius = math.degrees(math.atan2(arm[1], arm[0])), float(np.hypot(*arm))
        if "AP" in extra:
            item = extra.pop("AP")
            angle = angle + item.value if item.how == "IC" else item.value
        if "RP" in extra:
            item = extra.pop("RP")
            radius = radius + item.value * self.state.unit if item.how == "IC" else item.value * self.state.unit
        for i, part in ((a, math.cos), (b, math.sin)):
            if LINEAR[i] in coordinates:
                raise WordError(f"{LINEAR[i]} cannot be combined with AP= and RP=; keep one", coordinates[LINEAR[i]].column)
            coordinates[LINEAR[i]] = Item((self.pole[i] + radius * part(math.radians(angle))) / self.state.unit, "AC", 1)

    def _slanted(self, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """ANG=: a line at an angle to the first axis of the plane; one coordinate is given."""
        if "ANG" not in extra:
            return
        item = extra.pop("ANG")
        a, b, _ = arcs.PLANES[self.state.plane]
        first, second = LINEAR[a], LINEAR[b]
        if (first in coordinates) == (second in coordinates):
            raise WordError(f"ANG= needs one of {first} and {second} as the end of the line", item.column)
        here, tangent = self.corners.start(), math.tan(math.radians(item.value))
        given, other, i, j = (first, second, a, b) if first in coordinates else (second, first, b, a)
        value = coordinates[given]
        end = value.value * self.state.unit + (here[i] if value.how == "IC" or (value.how == "" and not self.state.absolute) else 0.0)
        slope = tangent if given == first else (1.0 / tangent if tangent else math.inf)
        if not math.isfinite(slope) or abs(slope) > 1e9:
            raise WordError("ANG= runs along the other axis; give that coordinate", item.column)
        coordinates[other] = Item((here[j] + (end - here[i]) * slope) / self.state.unit, "AC", item.column)

    def set_pole(self, number: int, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        base = {110: self.corners.start(), 111: np.zeros(3), 112: self.pole}[number].copy()
        if extra.keys() & {"AP", "RP"}:
            angle, radius = (extra.pop(n).value if n in extra else 0.0 for n in ("AP", "RP"))
            a, b, _ = arcs.PLANES[self.state.plane]
            base[a] += radius * self.state.unit * math.cos(math.radians(angle))
            base[b] += radius * self.state.unit * math.sin(math.radians(angle))
        for name, item in coordinates.items():
            if name not in LINEAR:
                raise WordError(f"{name} is no coordinate of a pole", item.column)
            base[INDEX[name]] += item.value * self.state.unit
        self.pole = base

    def fixed_point(self, number: int, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """G74, G75: rapid move of the named axes to their zero, or to [frame.G75]."""
        self.corners.release()
        extra.pop("FP", None)
        home = self.state.frame_table(f"G{number}")
        goal, angles = np.array(self.state.out.position[:3]), [math.nan, math.nan]
        for name in coordinates:
            if name in LINEAR:
                goal[INDEX[name]] = home[INDEX[name]]
            elif name in ROTARY:
                angles[INDEX[name] - 3] = home[INDEX[name]]
        self.state.note("G74, G75: the point is the zero of the axes, or [frame.G75] x_m .. of the machine file")
        traori = self.state.out.modes.traori
        self.state.transform(False)
        goal = np.where([n in coordinates for n in LINEAR], goal, self.state.out.position[:3])
        self.control.go(mv.RAPID, goal, (angles[0], angles[1]), machine=True)
        self.state.transform(traori)

    def dwell(self, numbers: set[float], extra: dict[str, Item], more: bool) -> None:
        if more or numbers - {4} or extra.keys() not in ({"F"}, {"S"}):
            raise WordError("G4 must be alone in its block with one time, e.g. G4 F<seconds>; write the rest in another block", 1)
        self.corners.release()
        if "S" in extra:
            if not self.state.out.modes.spindle:
                raise WordError("G4 S<turns> needs a spindle speed before; give S or use G4 F<seconds>", 1)
            self.control.dwell(extra["S"].value * 60.0 / self.state.out.modes.spindle)
        else:
            self.control.dwell(extra["F"].value)
