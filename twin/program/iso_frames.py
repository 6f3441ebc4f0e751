"""The frames of ISO programs: zero offsets (G54 to G59, G10), shifts (G92, G52), turned and scaled planes (G68, G51), tilted planes (G68.2)."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from twin.machine.machine import Machine
from twin.program import arcs
from twin.program.control_state import INDEX, LINEAR, OTHER, ROTARY, Item, rotation
from twin.program.expressions import WordError
from twin.program.iso_lines import IsoLines


class IsoFrames(IsoLines):
    """Frames and what changes them."""

    def __init__(self, path: Path, machine: Machine, *, linuxcnc: bool) -> None:
        super().__init__(path, machine)
        self.linuxcnc = linuxcnc
        self.systems = {n: self.frame_table(_system_name(n)) for n in range(1, 10)}
        self.turned = dict.fromkeys(range(1, 10), 0.0)  # deg, by system
        self.parameter_lines = False  # behind G10 L50, up to G11
        self.system = 1
        self.shift = np.zeros(5)  # G92 (LinuxCNC: also G52)
        self.shift_kept, self.shift_on = np.zeros(5), False
        self.local = np.zeros(5)  # G52 of Fanuc
        self.plane_matrix, self.plane_offset = np.eye(3), np.zeros(3)  # G68, G51, G51.1

    def set_frames(self) -> None:
        """The frame in force: system and its turn, G92, then the local frames."""
        turn = rotation(2, self.turned[self.system])
        matrix = turn @ self.plane_matrix
        base, shift = self.systems[self.system], self.shift if self.shift_on else np.zeros(5)
        offset = base + self.local + shift
        offset[:3] = base[:3] + turn @ (self.plane_offset + shift[:3] + self.local[:3])
        if self.swivelled is not None:
            inner, origin, _ = self.swivelled
            offset[:3] = offset[:3] + matrix @ origin + self.to_part()
            matrix = matrix @ inner
            self.fixed_axis = matrix[:, 2].copy()
        else:
            self.fixed_axis = None
        self.set_frame(matrix, offset)

    def _place(self) -> np.ndarray:
        """Program coordinates (5,)."""
        angles = self.out.settle() if any(map(math.isnan, self.out.position[3:])) else np.array(self.out.position[3:])
        return np.concatenate([self.here(), angles - np.array(self.offset[3:])])

    def _named_offsets(self, w: dict[str, Item]) -> dict[int, float]:
        found = {}
        for name in (*LINEAR, *ROTARY):
            if name in w:
                found[INDEX[name]] = self.si(name, w.pop(name).value)
        for name in OTHER:
            if name in w and w.pop(name).value:
                raise WordError(f"an offset of {name} cannot be set on this machine", 1)
        return found

    def _choose_system(self, number: float, w: dict[str, Item], column: int) -> None:
        if 110 <= number < 130:  # Haas
            self.system = self._additional(number - 109)
        elif number in (54.1, 154) or (number == 54 and "P" in w and not self.linuxcnc):
            if "P" not in w:
                raise WordError(f"G{number:g} needs P, the number of the offset", column)
            self.system = self._additional(w.pop("P").value)
        else:
            self.system = {54: 1, 55: 2, 56: 3, 57: 4, 58: 5, 59: 6, 59.1: 7, 59.2: 8, 59.3: 9}[number]
        self.set_frames()

    def _additional(self, number: float) -> int:
        """The number here of an additional zero offset, G54.1 P1 and on."""
        extra = 100 + int(number)
        if extra not in self.systems:
            self.systems[extra], self.turned[extra] = self.frame_table(f"G54.1P{extra - 100}"), 0.0
        return extra

    def _g10_tool(self, what: int, w: dict[str, Item], column: int) -> None:
        """G10 L10 to L13 of Fanuc (length, its wear, radius, its wear), L1 of LinuxCNC (Z, R)."""
        if what in (50, 51, 52) and not self.linuxcnc:
            self.note("G10 L50 .. G11: parameters of the control, understood, without effect on the motion")
            self.parameter_lines = True
            return
        given = {10: "R", 11: "R", 12: "R", 13: "R"} if not self.linuxcnc else {1: "ZR"}
        if what not in given or "P" not in w:
            raise WordError(f"G10 L{what} is not supported: it writes what is not simulated; give [tool] in the machine file", column)
        name = f"{w.pop('P').value:g}"
        for letter in given[what]:
            if letter in w:
                value, wear = w.pop(letter).value * self.unit, what in (11, 13)
                quantity = "radius" if what in (12, 13) or (what == 1 and letter == "R") else "length"
                if not self.absolute and not self.linuxcnc:  # G91 adds on a Fanuc
                    value += self.tools.value(name, quantity, wear=wear) or 0.0
                self.tools.set_value(name, quantity, value, wear=wear)

    def _g10(self, w: dict[str, Item], column: int) -> None:
        what = int(w.pop("L").value) if "L" in w else 2
        if what not in (2, 20):
            self._g10_tool(what, w, column)
            return
        number = int(w.pop("P").value) if "P" in w else 0
        if what == 20 and not self.linuxcnc:
            number, what = self._additional(number), 2
        number = number or self.system
        if number not in self.systems:
            raise WordError(f"G10 P{number}: there is no such zero offset; use P1 to P9", column)
        if "R" in w:
            self.turned[number] = w.pop("R").value
        place = np.array([*self.out.position[:3], *self._place()[3:]])
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
                    new[i] = self.out.position[i] - named[i]
        else:
            for i, value in named.items():
                new[i] = value if self.absolute or self.linuxcnc else new[i] + value  # G91 adds on a Fanuc
        self.systems[number] = new
        if number == self.system:
            self.set_frames()

    def _g92(self, w: dict[str, Item], column: int) -> None:
        named = self._named_offsets(w)
        if not named:
            raise WordError("G92 needs a coordinate, e.g. G92 X0", column)
        if not self.shift_on:
            self.shift, self.shift_on = np.zeros(5), True
            self.set_frames()
        turn = rotation(2, self.turned[self.system])
        place = turn.T @ (np.array(self.out.position[:3]) - self.systems[self.system][:3]) - self.local[:3]
        angles = self._place()[3:] + np.array(self.offset[3:])
        shift = self.shift.copy()
        for i, value in named.items():
            shift[i] = place[i] - value if i < 3 else angles[i - 3] - self.systems[self.system][i] - value
        self.shift = shift
        self.shift_kept = shift
        self.set_frames()

    def _g52(self, w: dict[str, Item]) -> None:
        for i, value in self._named_offsets(w).items():
            if self.linuxcnc:
                self.shift = self.shift.copy()
                self.shift[i] = value
                self.shift_on, self.shift_kept = True, self.shift
            else:
                self.local[i] = value
        self.set_frames()

    def _turn_plane(self, number: float, w: dict[str, Item], column: int) -> None:
        """G68 (turn), G51 (scale), G51.1 (mirror) and their ends."""
        if self.shift_on and np.any(self.shift):
            self.note("G68, G51: the point they are about counts before G92")
        matrix, centre = np.eye(3), np.zeros(3)
        axis = arcs.PLANES[self.plane][2]
        if number == 68:
            angle = w.pop("R").value if "R" in w else 0.0
            matrix = rotation(axis, angle)
            here = self.here()
            centre = np.array([w.pop(n).value * self.unit if n in w else here[i] for i, n in enumerate(LINEAR)])
        elif number == 51:
            factors = [w.pop(n).value for n in "IJK" if n in w]
            if "P" in w:
                factors = [w.pop("P").value] * 3
                factors = [f / 1000.0 if f > 100 else f for f in factors]
            if len(factors) != 3 or not all(factors):
                raise WordError("G51 needs one factor P, or I J K, other than 0", column)
            matrix = np.diag(factors)
            centre = np.array([w.pop(n).value * self.unit if n in w else 0.0 for n in LINEAR])
        elif number == 51.1:
            for i, n in enumerate(LINEAR):
                if n in w:
                    centre[i], matrix[i, i] = w.pop(n).value * self.unit, -1.0
        elif number == 50.1:
            for n in LINEAR:
                w.pop(n, None)
        self.plane_matrix, self.plane_offset = matrix, centre - matrix @ centre
        self.set_frames()

    def _tilt(self, w: dict[str, Item]) -> None:
        """G68.2: a plane by its origin and the Euler angles I (about z), J (about x), K (about z)."""
        origin = np.array([w.pop(n).value * self.unit if n in w else 0.0 for n in LINEAR])
        i, j, k = (w.pop(n).value if n in w else 0.0 for n in "IJK")
        matrix = rotation(2, i) @ rotation(0, j) @ rotation(2, k)
        self._swivel(matrix, origin)
        self.note("G68.2: the tool stands across the plane at once; A and C turn with the next move")


def _system_name(number: int) -> str:
    return f"G{53 + number}" if number <= 6 else f"G59.{number - 6}"
