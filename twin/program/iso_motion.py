"""The motion blocks of ISO programs: lines, arcs, polar coordinates, reference points, dwell, cutter radius."""

from __future__ import annotations

import math
import re

import numpy as np

from twin.program import arcs
from twin.program import moves as mv
from twin.program.collect import DEFAULT_TOLERANCE
from twin.program.corners import Corners, Move
from twin.program.expressions import WordError
from twin.program.flow import Flow
from twin.program.iso_drilling import IsoDrilling
from twin.program.iso_variables import IsoVariables
from twin.program.source import Unit
from twin.program.state import INDEX, LINEAR, OTHER, ROTARY, Item

POLAR = ("@", "^")
"""Words of a radius and an angle (LinuxCNC)."""

REFERENCES = {27, 28, 29, 30}
"""G codes of the reference point."""


class IsoMotion:
    """Moves."""

    def __init__(self, corners: Corners, flow: Flow, values: IsoVariables, drilling: IsoDrilling) -> None:
        self.corners, self.control, self.state = corners, corners.control, corners.state
        self.flow, self.values, self.drilling = flow, values, drilling
        self.state.motion = None
        self.any_motion = False  # a Fanuc takes coordinates before any G0 or G1 as rapid
        self.polar = False
        self.polar_place: tuple[float, float] | None = None  # radius and angle [deg] that G16 keeps
        self.modal_macro: tuple[Unit, int, dict] | None = None
        self.edge: Item | None = None  # D, which a Fanuc keeps
        self.splines = dict.fromkeys((5, 5.1), "spline") if self.state.linuxcnc else {}
        self.spline_arm = 0.0, 0.0  # P and Q of the last G5 [m]
        self.between: tuple[np.ndarray, list[float]] | None = None  # the point of G28 or G30, through which G29 returns

    def move_words(self, codes: set[float], w: dict[str, Item]) -> None:
        coordinates = {n: w.pop(n) for n in (*LINEAR, *ROTARY, *OTHER) if n in w}
        if w.keys() & set(POLAR):
            self._radius_and_angle(coordinates, w)
        if reference := codes & REFERENCES:
            self._reference(int(min(reference)), coordinates, w)
            return
        if self.splines and (codes & self.splines.keys() or (self.state.motion == 5 and coordinates and not codes & {0, 1, 2, 3})):
            self._spline(5.1 if 5.1 in codes else 5, coordinates, w)
            return
        if threading := codes & {33, 33.1}:
            self._thread(min(threading), coordinates, w)
            return
        vector, given = None, w.keys() & set("IJK")
        if 43.5 in codes or (self.state.out.modes.traori and self.state.motion in (0, 1) and given and not codes & {2, 3}):
            i, j, k = (w.pop(n).value if n in w else 0.0 for n in "IJK")
            vector = (i, j, k) if given else None
        if self.drilling.cycle is not None:
            if self.polar:
                self._polar(coordinates)
            self.drilling.drill_holes(codes, coordinates, w)
            return
        in_plane = {n: w.pop(n) for n in "IJK" if n in w and self.state.motion in (2, 3)}
        if self.state.motion is None and coordinates and not self.state.linuxcnc and not self.any_motion:
            self.state.motion = 0
            self.state.note("coordinates before any G0 or G1 are rapid moves; a parameter of the control decides this")
        self.any_motion = self.any_motion or self.state.motion is not None
        moves = bool(coordinates or vector or (self.state.motion in (2, 3) and (in_plane or "R" in w)))
        if codes & {2, 3} and not moves:
            raise WordError("a circle needs its centre (I J K) or radius R, and an end point; add them", 1)
        if not moves:
            return
        if self.state.motion is None:
            raise WordError("coordinates without a motion: G80 is in force; give G0 or G1", 1)
        kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[self.state.motion]
        if kind != mv.RAPID and self.state.feed == 0.0:
            self.drilling.no_feed()
        suppress = 53 in codes
        if self.polar:
            self._polar(coordinates)
        if suppress and kind == mv.ARC:
            raise WordError("G53 goes with G0 or G1; give the arc in the work coordinates", 1)
        start = self.corners.start()
        point, angles = self.control.target(coordinates, suppress, None if suppress else start)
        arc = None
        if kind == mv.ARC:
            radius = w.pop("R").value * self.state.unit if "R" in w else None
            turns = 0
            if "P" in w:
                item = w.pop("P")
                if item.value != int(item.value) or not 1 <= item.value <= 10_000:
                    raise WordError(f"P{item.value:g}: the number of turns of an arc is a whole number from 1", item.column)
                turns = int(item.value) - 1
            if radius is None and not in_plane:
                raise WordError("a circle needs its centre (I J K) or radius R; add it to the block", 1)
            if (
                self.state.centre_absolute
                and len([n for n in in_plane if "IJK".index(n) in arcs.PLANES[self.state.plane][:2]]) < 2
                and in_plane
            ):
                raise WordError("under G90.1 a circle needs both words of its centre; add the other", 1)
            arc = self.control.arc_centre(start, point, in_plane, radius), self.state.motion == 2, turns
        corner = next(((n, w.pop(n)) for n in (",R", ",C") if n in w), None)
        if corner is not None and (kind != mv.LINE or suppress or vector):
            raise WordError(f"{corner[0]} belongs in a block with G1 that another G1 follows; move it there", corner[1].column)
        if corner is not None or self.corners.held is not None:
            move = Move(kind, point, angles, vector, arc, None, suppress, self.state.feed, self.state.line, self.state.block)
            self.corners.queue(move, None if corner is None else (corner[0], corner[1].value * self.state.unit))
        else:
            self.control.go(kind, point, angles, vector, arc, suppress=suppress)
        if self.modal_macro is not None and all(frame.name != "G66" for frame in self.flow.frames):  # not after moves of the macro itself
            unit, at, variables = self.modal_macro
            if frame := self.flow.call(unit, at, name="G66", style="macro"):
                frame.variables = dict(variables)

    def _radius_and_angle(self, coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """@ and ^ of LinuxCNC: radius and angle about the program zero; a missing one is kept, with G91 they are added."""
        a, b = (LINEAR[i] for i in arcs.PLANES[self.state.plane][:2])
        item = next(iter(w[n] for n in POLAR if n in w))
        if self.state.plane != 17 or a in coordinates or b in coordinates:
            raise WordError("@ and ^ stand for X and Y under G17; remove the other words", item.column)
        here = self.corners.start()[:2] / self.state.unit
        radius, angle = math.hypot(*here), math.degrees(math.atan2(here[1], here[0]))
        if "@" in w:
            radius = w.pop("@").value + (0.0 if self.state.absolute else radius)
        if "^" in w:
            angle = w.pop("^").value + (0.0 if self.state.absolute else angle)
        for name, part in ((a, math.cos(math.radians(angle))), (b, math.sin(math.radians(angle)))):
            coordinates[name] = Item(radius * part, "AC", item.column)

    def _polar(self, coordinates: dict[str, Item]) -> None:
        """G16: the first axis of the plane is a radius, the second an angle, about the zero of the program; both are kept.

        With G91 the angle counts from the last one. A radius with G91 would be about the place of the tool, which is refused.
        """
        a, b = (LINEAR[i] for i in arcs.PLANES[self.state.plane][:2])
        if a not in coordinates and b not in coordinates:
            return
        if self.polar_place is None:
            here = self.corners.start()
            first, second = (here[arcs.PLANES[self.state.plane][k]] for k in (0, 1))
            self.polar_place = math.hypot(first, second) / self.state.unit, math.degrees(math.atan2(second, first))
        radius, angle = self.polar_place
        if a in coordinates:
            if not self.state.absolute:
                raise WordError(
                    f"{a} under G16 and G91 is a radius about the place of the tool, which is not read; use G90", coordinates[a].column
                )
            radius = coordinates[a].value
        if b in coordinates:
            angle = coordinates[b].value + (0.0 if self.state.absolute else angle)
        self.polar_place = radius, angle
        column = next(iter(coordinates.values())).column
        coordinates[a] = Item(radius * math.cos(math.radians(angle)), "AC", column)
        coordinates[b] = Item(radius * math.sin(math.radians(angle)), "AC", column)

    def _reference(self, number: int, coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """G28, G30: through the point of the block to the reference point; G29: back through that point; G27: to the point alone. Rapid."""
        if number == 29 and self.between is not None:
            self.control.go(mv.RAPID, *self.between)
        if number in (27, 29):
            self.state.note("G27: a rapid move; that it ends at the reference point is not checked") if number == 27 else None
            self.control.go(mv.RAPID, *self.control.target(coordinates, False))
            return
        home = self.values.home[number]
        if number == 30 and "P" in w and (which := int(w.pop("P").value)) != 2:
            home = self.state.frame_table(f"G30P{which}")
        self.state.note("G28, G30: the reference point is the zero of the axes, or [frame.G28] x_m .. of the machine file")
        point, angles = self.control.target(coordinates, False)
        none = [math.nan, math.nan]
        if coordinates:
            self.control.go(mv.RAPID, point, angles)
            self.between = point, angles
        named = coordinates or {n: Item(0.0) for n in (*LINEAR, *ROTARY)}
        goal = np.array(self.state.out.position[:3])
        for n in named:
            if n in LINEAR:
                goal[INDEX[n]] = home[INDEX[n]]
            elif n in ROTARY:
                none[INDEX[n] - 3] = home[INDEX[n]]
            else:
                self.state.other_axes[n] = 0.0
        self.control.go(mv.RAPID, goal, none, suppress=True)

    def _spline(self, number: float, coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """G5 and G5.1 of LinuxCNC: a cubic or quadratic Bezier curve in the XY plane, as chords."""
        if (
            self.state.plane != 17
            or coordinates.keys() - {"X", "Y"}
            or self.state.comp is not None
            or math.isnan(self.state.feed)
            or not self.state.feed
        ):
            raise WordError(f"G{number:g} moves X and Y under G17 with a feed, outside G41 and G42; correct the block", 1)
        needed = "IJPQ" if number == 5 else "IJ"
        given = {n: w.pop(n).value * self.state.unit for n in needed if n in w}
        if number == 5 and self.state.motion == 5 and not given.keys() & {"I", "J"}:
            given["I"], given["J"] = (-v for v in self.spline_arm)  # the next curve goes on smoothly
        if set(needed) - given.keys():
            raise WordError(f"G{number:g} needs {' '.join(needed)}; add them", 1)
        start = self.state.here()
        point, _ = self.control.target(coordinates, False)
        near = start + np.array([given["I"], given["J"], 0.0])
        far = point + np.array([given["P"], given["Q"], 0.0]) if number == 5 else near
        if number == 5.1:
            near, far = start + (near - start) * 2.0 / 3.0, point + (far - point) * 2.0 / 3.0
        for end in arcs.bezier_chords(np.array([start, near, far, point])):
            self.control.go(mv.LINE, end, [math.nan, math.nan])
        self.state.note("G5, G5.1: the curve as chords within 0.5 um")
        self.state.motion, self.spline_arm = (5, (given["P"], given["Q"])) if number == 5 else (None, (0.0, 0.0))

    def _thread(self, number: float, coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """G33 and G33.1 of LinuxCNC: a line with K per turn of the spindle; G33.1 (tapping) returns along it."""
        speed = self.state.out.modes.spindle
        if "K" not in w or not speed > 0.0:
            raise WordError(f"G{number:g} needs K, the pitch, and a spindle speed S; add them", 1)
        start, feed = self.state.here(), self.state.feed
        self.state.feed = abs(w.pop("K").value) * speed
        self.state.note("G33, G33.1: a line at K times S; the angle of the spindle is not simulated")
        self.control.go(mv.LINE, *self.control.target(coordinates, False))
        if number == 33.1:
            self.control.go(mv.LINE, start, [math.nan, math.nan])
        self.state.feed, self.state.motion = feed, None

    def dwell(self, w: dict[str, Item]) -> None:
        name = next((n for n in (("P",) if self.state.linuxcnc else ("P", "X", "U")) if n in w), None)
        if name is None:
            raise WordError("G4 needs its time, e.g. G4 P1.5", 1)
        item = w.pop(name)
        seconds = item.value
        if name == "P" and not self.state.linuxcnc and self._written_whole(item):
            seconds /= 1000.0
            self.state.note("G4 P without a decimal point is in ms, as on a Fanuc; write P1.5 or a .ngc file for seconds")
        self.control.dwell(seconds)

    def _written_whole(self, item: Item) -> bool:
        text = self.flow.frame.unit.lines[self.flow.frame.at]
        return "." not in re.split(r"[^\d.+\-]", text[item.column :].lstrip())[0]

    def path_mode(self, number: float, w: dict[str, Item], with_m19: bool) -> None:
        if "R" in w and number == 64 and with_m19:
            raise WordError("R may belong to G64 or to M19 here; write two blocks", w["R"].column)
        if "R" in w and number == 64:
            w.pop("R")
            self.state.note("G64 R: a setting of the planner of LinuxCNC, without effect on the path")
        if number == 64:
            p = w.pop("P").value if "P" in w else 0.0
            self.state.tolerance = p * self.state.unit if p > 0.0 else DEFAULT_TOLERANCE
            if "Q" in w:
                w.pop("Q")
                self.state.note("G64 Q: merging of collinear blocks, which the rounding here always does")
        if number == 61.1 and not self.state.linuxcnc:
            self.state.note("G61.1: high accuracy of Mazak and Mitsubishi, corners are rounded as under G64; in .ngc files an exact stop")
        if number == 61 and not self.state.linuxcnc:
            self.state.note("G61: exact stop; in .ngc files exact path, without a stop")
        self.state.rounding = 60 if number == (61.1 if self.state.linuxcnc else 61) else 64
        if number == 61 and self.state.linuxcnc:
            self.state.tolerance = 1e-6
            self.state.note("G61: exact path, a rounding of 1 um")
        self.state.round_corners()

    def _radius_of(self, d: Item) -> float:
        """Radius [m] selected by a D word of a Fanuc; D0 selects none."""
        return 0.0 if d.value == 0 else self.state.tools.radius(f"{d.value:g}", d.column)

    def other_radius(self, d: Item) -> None:
        """D without G41 or G42 on a Fanuc: the radius of the next G41 or G42; inside one it must not change the radius."""
        self.edge = d
        if self.state.comp is not None and abs(self._radius_of(d)) != self.state.comp.tool_radius:
            raise WordError("D changes the radius inside G41 or G42; write G40 and a move before", d.column)

    def compensation(self, number: float, w: dict[str, Item], column: int) -> None:
        if number == 40:
            w.pop("D", None)
            self.control.compensate(0, 0.0, along_next=False)
            return
        if "D" in w:
            item = w.pop("D")
            radius = 0.5 * item.value * self.state.unit if number in (41.1, 42.1) else None
            if radius is None:
                self.edge = item
                radius = self._radius_of(item)
        elif number in (41.1, 42.1):
            raise WordError("G41.1 and G42.1 need D, the diameter of the tool", column)
        else:
            radius = (
                self._radius_of(self.edge._replace(column=column))
                if self.edge is not None
                else self.state.tools.radius(self.state.tools.name, column)
            )
        if not radius:
            self.state.note("G41, G42 with radius 0: the contour is the path")
        if radius and not self.state.linuxcnc:
            self.state.note(
                "G41, G42: the tool comes to the contour at a right angle to it, as on a Fanuc; in .ngc files beside its first corner"
            )
        self.control.compensate(1 if number < 42 else -1, radius, along_next=not self.state.linuxcnc)
