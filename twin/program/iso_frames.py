"""The frames of ISO programs: zero offsets (G54 to G59, G10), shifts (G92, G52), turned and scaled planes (G68, G51), tilted planes (G68.2)."""

from __future__ import annotations

import math

import numpy as np

from twin.program import arcs
from twin.program.expressions import WordError
from twin.program.state import INDEX, LINEAR, OTHER, ROTARY, Item, State, rotation

Map = tuple[np.ndarray, np.ndarray]
"""Matrix (3, 3) and shift (3,) [m]: from the inner coordinates x to the outer ones, matrix x + shift."""

NESTING = ("mirror", "scale", "turn")
"""G51.1, G51 and G68 in the order in which a Fanuc nests them, the outermost first."""


class IsoFrames:
    """Frames and the words that change them."""

    def __init__(self, state: State) -> None:
        self.state = state
        state.set_frames = self.set_frames
        self.state.tools.modal_h = not state.linuxcnc
        self.systems = {n: self.state.frame_table(_system_name(n)) for n in range(1, 10)}
        self.turned = dict.fromkeys(range(1, 10), 0.0)  # deg, by system
        self.parameter_lines = False  # behind G10 L50, up to G11
        self.system = 1
        self.shift = np.zeros(5)  # G92 (LinuxCNC: also G52)
        self.shift_kept, self.shift_on = np.zeros(5), False
        self.local = np.zeros(5)  # G52 of Fanuc
        self.maps: dict[str, Map] = {}
        self.mirrors: dict[int, float] = {}  # axis of G51.1 -> place of the mirror [m]
        self.plane_matrix, self.plane_offset = np.eye(3), np.zeros(3)  # all of `maps`

    def set_frames(self) -> None:
        """The active frame: zero offset and its rotation, G92, then the local frames."""
        turn = rotation(2, self.turned[self.system])
        matrix = turn @ self.plane_matrix
        base, shift = self.systems[self.system], self.shift if self.shift_on else np.zeros(5)
        offset = base + self.local + shift
        offset[:3] = base[:3] + turn @ (self.plane_offset + shift[:3] + self.local[:3])
        if self.state.swivelled is not None:
            inner, origin, _ = self.state.swivelled
            offset[:3] = offset[:3] + matrix @ origin + self.state.to_part()
            matrix = matrix @ inner
            self.state.fixed_axis = matrix[:, 2].copy()
        else:
            self.state.fixed_axis = None
        self.state.set_frame(matrix, offset)

    def place(self) -> np.ndarray:
        """Program coordinates (5,)."""
        angles = self.state.out.settle() if any(map(math.isnan, self.state.out.position[3:])) else np.array(self.state.out.position[3:])
        return np.concatenate([self.state.here(), angles - np.array(self.state.offset[3:])])

    def _named_offsets(self, w: dict[str, Item]) -> dict[int, float]:
        found = {}
        for name in (*LINEAR, *ROTARY):
            if name in w:
                found[INDEX[name]] = self.state.si(name, w.pop(name).value)
        for name in OTHER:
            if name in w and w.pop(name).value:
                raise WordError(f"an offset of {name} cannot be set on this machine", 1)
        return found

    def choose_system(self, number: float, w: dict[str, Item], column: int) -> None:
        if 110 <= number < 130:  # Haas
            self.system = self._additional(number - 109)
        elif number in (54.1, 154) or (number == 54 and "P" in w and not self.state.linuxcnc):
            if "P" not in w:
                raise WordError(f"G{number:g} needs P, the number of the offset", column)
            self.system = self._additional(w.pop("P").value)
        else:
            self.system = {54: 1, 55: 2, 56: 3, 57: 4, 58: 5, 59: 6, 59.1: 7, 59.2: 8, 59.3: 9}[number]
        self.state.set_frames()

    def _additional(self, number: float) -> int:
        """The number here of an additional zero offset, G54.1 P1 and on."""
        extra = 100 + int(number)
        if extra not in self.systems:
            self.systems[extra], self.turned[extra] = self.state.frame_table(f"G54.1P{extra - 100}"), 0.0
        return extra

    def _g10_tool(self, what: int, w: dict[str, Item], column: int) -> None:
        """G10 L10 to L13 of Fanuc (length, its wear, radius, its wear), L1 of LinuxCNC (Z, R)."""
        if what in (50, 51, 52) and not self.state.linuxcnc:
            self.state.note("G10 L50 .. G11: parameters of the control, understood, no effect on the motion")
            self.parameter_lines = True
            return
        given = {10: "R", 11: "R", 12: "R", 13: "R"} if not self.state.linuxcnc else {1: "ZR"}
        if what not in given or "P" not in w:
            raise WordError(f"G10 L{what} is not supported: it writes what is not simulated; give [tool] in the machine file", column)
        name = f"{w.pop('P').value:g}"
        for letter in given[what]:
            if letter in w:
                value, wear = w.pop(letter).value * self.state.unit, what in (11, 13)
                quantity = "radius" if what in (12, 13) or (what == 1 and letter == "R") else "length"
                if not self.state.absolute and not self.state.linuxcnc:  # G91 adds on a Fanuc
                    value += self.state.tools.value(name, quantity, wear=wear) or 0.0
                self.state.tools.set_value(name, quantity, value, wear=wear)

    def _one_offset(self, w: dict[str, Item]) -> None:
        """G10 P R of a Fanuc whose offsets are one list: the same number serves as length and as radius."""
        if "P" not in w:
            raise WordError("G10 R needs P, the number of the offset; add it", w["R"].column)
        name, value = f"{w.pop('P').value:g}", w.pop("R").value * self.state.unit
        for quantity in ("length", "radius"):
            old = 0.0 if self.state.absolute else self.state.tools.value(name, quantity) or 0.0
            self.state.tools.set_value(name, quantity, old + value)

    def g10(self, w: dict[str, Item], column: int) -> None:
        if "L" not in w and not self.state.linuxcnc and "R" in w and not w.keys() & {*LINEAR, *ROTARY, *OTHER}:
            self._one_offset(w)
            return
        what = int(w.pop("L").value) if "L" in w else 2
        if what not in (2, 20):
            self._g10_tool(what, w, column)
            return
        number = int(w.pop("P").value) if "P" in w else 0
        if what == 20 and not self.state.linuxcnc:
            self.state.note(
                f"G10 L20: it sets the additional offset G54.1 P{number}, as on a Fanuc; on LinuxCNC (.ngc), grbl and Mach this place gets the coordinates"
            )
            number, what = self._additional(number), 2
        number = number or self.system
        if number not in self.systems:
            raise WordError(f"G10 P{number}: there is no such zero offset; use P1 to P9", column)
        if "R" in w:
            self.turned[number] = w.pop("R").value
        place = np.array([*self.state.out.position[:3], *self.place()[3:]])
        new = self.systems[number].copy()
        turn = rotation(2, self.turned[number])
        named = self._named_offsets(w)
        shift = self.shift if self.shift_on else np.zeros(5)
        if what == 20:
            wanted = turn.T @ (place[:3] - new[:3]) - shift[:3]
            for i in range(3):
                wanted[i] = named.get(i, wanted[i])
            new[:3] = place[:3] - turn @ (wanted + shift[:3])
            for i in (3, 4):
                if i in named:
                    new[i] = self.state.out.position[i] - named[i]
        else:
            for i, value in named.items():
                new[i] = value if self.state.absolute or self.state.linuxcnc else new[i] + value  # G91 adds on a Fanuc
        self.systems[number] = new
        if number == self.system:
            self.state.set_frames()

    def g92(self, w: dict[str, Item], column: int) -> None:
        named = self._named_offsets(w)
        if not named:
            raise WordError("G92 needs a coordinate, e.g. G92 X0", column)
        if not self.shift_on:
            self.shift, self.shift_on = np.zeros(5), True
            self.state.set_frames()
        turn = rotation(2, self.turned[self.system])
        place = turn.T @ (np.array(self.state.out.position[:3]) - self.systems[self.system][:3]) - self.local[:3]
        angles = self.place()[3:] + np.array(self.state.offset[3:])
        shift = self.shift.copy()
        for i, value in named.items():
            shift[i] = place[i] - value if i < 3 else angles[i - 3] - self.systems[self.system][i] - value
        self.shift = shift
        self.shift_kept = shift
        self.state.set_frames()

    def g52(self, w: dict[str, Item]) -> None:
        if not self.state.linuxcnc:
            self.state.note("G52: a local shift beside that of G92, as on a Fanuc; in .ngc files the same as G92")
        for i, value in self._named_offsets(w).items():
            if self.state.linuxcnc:
                self.shift = self.shift.copy()
                self.shift[i] = value
                self.shift_on, self.shift_kept = True, self.shift
            else:
                self.local[i] = value
        self.state.set_frames()

    def map(self, number: float, w: dict[str, Item], column: int) -> None:
        """G51.1 and G101 (mirror), G51 (scale), G68 (turn) and the codes that end them."""
        if self.shift_on and np.any(self.shift):
            self.state.note("G68, G51: their centre is in the coordinates before G92")
        places = {i: w.pop(n).value * self.state.unit for i, n in enumerate(LINEAR) if n in w}
        if number in (51.1, 101):
            if number == 101 and any(places.values()):
                raise WordError("G101 mirrors about the zero of the program; write 0 behind its axes, or use G51.1", column)
            self.mirrors |= places
        elif number in (50.1, 100):
            self.mirrors = {i: at for i, at in self.mirrors.items() if places and i not in places}
        elif number == 51:
            self._scale_about(places, w, column)
        elif number == 68:
            matrix = rotation(arcs.PLANES[self.state.plane][2], w.pop("R").value if "R" in w else 0.0)
            self.maps["turn"] = _about(matrix, self._centre("turn", places))
        elif number in (50, 69):
            self.maps.pop("scale" if number == 50 else "turn", None)
        mirror = np.diag([-1.0 if i in self.mirrors else 1.0 for i in range(3)])
        self.maps["mirror"] = _about(mirror, np.array([self.mirrors.get(i, 0.0) for i in range(3)]))
        self.plane_matrix, self.plane_offset = self._inside("mirror")
        self.state.set_frames()

    def _inside(self, outermost: str) -> Map:
        """The map from the inner to the outer coordinates of one of the maps."""
        matrix, offset = np.eye(3), np.zeros(3)
        for name in reversed(NESTING[NESTING.index(outermost) :]):
            outer, shift = self.maps.get(name, (np.eye(3), np.zeros(3)))
            matrix, offset = outer @ matrix, outer @ offset + shift
        return matrix, offset

    def _centre(self, name: str, places: dict[int, float]) -> np.ndarray:
        """The centre (3,) of a map in its outer coordinates: as programmed, else the position of the tool."""
        matrix, offset = self._inside(name)
        here = matrix @ self.state.here() + offset
        return np.array([places.get(i, here[i]) for i in range(3)])

    def _scale_about(self, places: dict[int, float], w: dict[str, Item], column: int) -> None:
        """G51: one factor P, or one for each axis by I J K; a whole number above 100 counts in thousandths."""
        factors = [w.pop(n).value if n in w else 1.0 for n in "IJK"] if w.keys() & set("IJK") else []
        if "P" in w:
            factors = [w.pop("P").value] * 3
        factors = [f / 1000.0 if abs(f) > 100 else f for f in factors]
        if not factors or not all(factors):
            raise WordError("G51 needs one factor P, or I J K, other than 0", column)
        self.maps["scale"] = _about(np.diag(factors), self._centre("scale", places))

    def tilt(self, w: dict[str, Item]) -> None:
        """G68.2: a plane by its origin and the Euler angles I (about z), J (about x), K (about z)."""
        origin = np.array([w.pop(n).value * self.state.unit if n in w else 0.0 for n in LINEAR])
        i, j, k = (w.pop(n).value if n in w else 0.0 for n in "IJK")
        matrix = rotation(2, i) @ rotation(0, j) @ rotation(2, k)
        self.state.swivel(matrix, origin)
        self.state.note("G68.2: the tool is perpendicular to the plane at once; A and C turn with the next move")


def _about(matrix: np.ndarray, centre: np.ndarray) -> Map:
    """The map with a fixed centre (3,)."""
    return matrix, centre - matrix @ centre


def _system_name(number: int) -> str:
    return f"G{53 + number}" if number <= 6 else f"G59.{number - 6}"
