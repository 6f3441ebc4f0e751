"""Modes set by the words of an ISO block: G and M codes, feeds, tools, and M70 to M73 of LinuxCNC, which store modes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from twin.program.expressions import WordError
from twin.program.iso_frames import IsoFrames
from twin.program.iso_motion import IsoMotion
from twin.program.state import INCH, LINEAR, Item
from twin.program.tables import ACTS, ISO_G, ISO_M, NOTE, REFUSED, WORDS_OF_M

_NOT_IN_LINUXCNC: dict[float, str] = {
    76: "threading is not simulated",
    88: "boring with a halt for the hand is not simulated",
    87: "LinuxCNC itself does not carry it out",
    100: "LinuxCNC has no such code",
    101: "LinuxCNC has no such code",
}
_ONLY_IN_LINUXCNC: dict[float, str] = dict.fromkeys((33, 33.1), "threading is not simulated")
_WORDS_OF_NOTES = {5.1: "PQR", 8: "PQR", 61.2: "PQR", 187: "PQRE", 103: "P", 22: "XYZIJK", 60: ""}


F_WITH_UNIT = {
    True: "F beside G20 or G21: it is in the unit before them, since LinuxCNC carries F out first",
    False: "F beside G20 or G21: it is in the new unit; in .ngc files in the one before",
}


class IsoModes:
    """Modes of one block."""

    def __init__(self, moves: IsoMotion, frames: IsoFrames) -> None:
        self.moves, self.frames, self.state, self.flow = moves, frames, moves.state, moves.flow
        self.values, self.drilling = moves.values, moves.drilling
        self.with_m19 = False
        self.stored_modes: dict[int, Callable[[], None]] = {}

    def known_g(self, number: float, column: int) -> tuple[float, int]:
        entry = ISO_G.get(number)
        if number in (_NOT_IN_LINUXCNC if self.state.linuxcnc else _ONLY_IN_LINUXCNC):
            entry = (REFUSED, (_NOT_IN_LINUXCNC if self.state.linuxcnc else _ONLY_IN_LINUXCNC)[number])
        self.state.check_code("G", number, None if entry is None else (ACTS, "") if entry[0] == NOTE else entry, column)
        return number, column

    def known_m(self, number: float, column: int) -> int:
        if number != int(number) or not 0 <= number <= 99999:
            raise WordError(f"M{number:g} is not an M code", column)
        self.state.check_code(
            "M", number, ISO_M.get(int(number), (ACTS, "")) if ISO_M.get(int(number), (ACTS,))[0] == REFUSED else (ACTS, ""), column
        )
        return int(number)

    def feed_and_tool(self, codes: set[float], g: list, m: list[int], w: dict[str, Item]) -> None:
        for number in (93, 94, 95):
            if number in codes:
                self.state.set_feed_mode(number)
                self.state.settle_plain()
        units = [INCH if number in (20, 70) else 1e-3 for number in (20, 21, 70, 71) if number in codes]
        given = w.pop("F") if "F" in w and 65 not in codes else None
        if given and self.state.linuxcnc:
            self.state.set_feed(given.value, given.column)
        for unit in units:
            if given and unit != self.state.unit:
                self.state.note(F_WITH_UNIT[self.state.linuxcnc])
            self.state.set_unit(unit, feed=True)
        if given:
            if not self.state.linuxcnc:
                self.state.set_feed(given.value, given.column)
        elif (
            self.state.out.modes.feed_mode == 93
            and self.state.motion in (1, 2, 3)
            and not codes & {0, 4, 10, 92, 52}
            and w.keys() & set("XYZAC")
        ):
            raise WordError("under G93 every block needs its own F; add it", 1)
        if "S" in w:
            self.state.set_spindle(w.pop("S").value)
        tool: dict[str, tuple] = {}
        for name in ("T", "H"):
            if name in w and (name == "T" or codes & {43, 43.1, 43.4, 43.5, 44, 234}):
                item = w.pop(name)
                tool[name] = item.value, item.column
        if "H" in w and not codes & {10}:
            tool["H"] = w["H"].value, w.pop("H").column
        if 6 in m:
            tool["M6"] = 6.0, 1
        elif 61 in m and "Q" in w:
            tool["T"], tool["M6"] = (w["Q"].value, w.pop("Q").column), (6.0, 1)
        if 44 in codes:
            if self.state.out.modes.traori:
                raise WordError("G44 under G43.4 is not supported; use G43 with a negative length", 1)
            self.state.note("G44: treated as G43; without G43.4 X Y Z are positions of the axes for any length")
        if codes & {43, 43.4, 43.5, 44, 234}:
            tool["G43"] = 43.0, 1
        if 49 in codes:
            tool["G49"] = 49.0, 1
            if self.state.swivelled is None:
                self.state.transform(False)
        if tool:
            self.state.tools.block(tool)
        if codes & {43.4, 43.5, 234}:
            self.state.transform(True)
        if "E" in w and not codes & {187}:
            raise WordError("E has no use in this block; remove it", w["E"].column)

    def g_code(self, number: float, column: int, w: dict[str, Item], codes: set[float]) -> bool:
        """A G code without motion."""
        kind, meaning = ISO_G[number]
        if kind == NOTE:
            self.state.note(f"G{number:g}: {meaning}")
            for name in _WORDS_OF_NOTES.get(number, ""):
                w.pop(name, None)
        elif number == 5:
            if "P" not in w or w.keys() & set("XYZIJQ"):
                raise WordError("G5 is not supported: splines; let the CAM system output lines or arcs", column)
            w.pop("P")
            self.state.note("G5 P: high-speed mode of the control, understood, no effect on the motion")
        elif number in (17, 18, 19):
            self.state.plane = int(number)
        elif number in (90, 91):
            self.state.absolute = number == 90
            self.state.settle_plain()
        elif number in (90.1, 91.1):
            self.state.centre_absolute = number == 90.1
        elif number == 4:
            self.moves.dwell(w)
        elif number in (40, 41, 42, 41.1, 42.1):
            self.moves.compensation(number, w, column)
        elif 54 <= number <= 59.3 or number == 154 or 110 <= number < 130:
            self.frames.choose_system(number, w, column)
        elif number == 10:
            self.frames.g10(w, column)
        elif number == 11:
            pass
        elif number == 10.9:
            if "X" in w and w.pop("X").value:
                raise WordError("G10.9 X1 is not supported: diameters are programmed on lathes; this machine mills", column)
            self.state.note("G10.9 X0: lengths are radii, as here")
        elif number == 92:
            self.frames.g92(w, column)
        elif number in (92.1, 92.2, 92.3):
            if number == 92.1:
                self.frames.shift_kept = np.zeros(5)
            self.frames.shift_on = number == 92.3
            self.frames.shift = self.frames.shift_kept if self.frames.shift_on else np.zeros(5)
            self.state.set_frames()
        elif number == 52:
            self.frames.g52(w)
        elif number in (68, 69, 51, 51.1, 50, 50.1, 100, 101):
            if number == 69:
                self.state.unswivel()
            self.frames.map(number, w, column)
        elif number == 68.2:
            self.frames.tilt(w)
        elif number in (15, 16):
            self.moves.polar, self.moves.polar_place = number == 16, None
        elif number in (61, 61.1, 64):
            self.moves.path_mode(number, w, self.with_m19)
        elif number in (28.1, 30.1):
            self.values.home[int(number)] = np.array([*self.state.out.position[:3], *self.frames.place()[3:]])
        elif number == 80:
            self.drilling.cycle = None
            if self.state.linuxcnc:
                self.state.motion = None
        elif number in (98, 99):
            self.state.retract_to_start = number == 98
        elif number == 43.1:
            for name in LINEAR:
                w.pop(name, None)
            self.state.note("G43.1: its length is used as that of the tool in the spindle")
        return False

    def m_before(self, m: list[int], w: dict[str, Item]) -> float | None:
        """M codes before the move: notes and modes; the pause of one that stops behind it."""
        keeping = (70, 71, 72, 73) if self.state.linuxcnc else ()
        pause = self.state.note_m(m, ISO_M, {2, 30, *keeping})
        for number in m:
            if number in keeping:
                self._modes(number)
            for name in WORDS_OF_M if number in (19, 62, 63, 64, 65, 66, 67, 68) else "P" if 48 <= number <= 53 else ():
                w.pop(name, None)
        return pause

    def _modes(self, number: int) -> None:
        """M70 stores the modes, M71 discards them, M72 restores them; M73 restores them at the end of the subprogram."""
        frame = self.flow.frame
        if number in (70, 73):
            self.stored_modes[id(frame)] = self.state.kept((self.frames, ("system",)), with_feed=True)
        if number == 73:
            frame.on_return = self.stored_modes[id(frame)]
        elif number == 71:
            self.stored_modes.pop(id(frame), None)
        elif number == 72:
            if id(frame) not in self.stored_modes:
                raise WordError("M72 finds no modes that M70 has kept in this program or subprogram; add M70", 1)
            self.stored_modes[id(frame)]()
