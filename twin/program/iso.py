"""ISO programs: Fanuc and the many controls like it, LinuxCNC. The words of a block and what they do; expressions, O-words, macros.

LinuxCNC and Fanuc write the same letters and mean some of them differently; `linuxcnc` says which is read (a file .ngc, or
one with O-words or named parameters). Where they differ the note says what was taken.
"""

from __future__ import annotations

import math
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.control_state import INCH, LINEAR, OTHER, ROTARY, Item
from twin.program.cycles import CycleError
from twin.program.expressions import Null, WordError
from twin.program.flow import Flow
from twin.program.iso_calls import IsoCalls
from twin.program.iso_drilling import CYCLES
from twin.program.iso_lines import SEPARATOR, message_text
from twin.program.iso_motion import REFERENCES
from twin.program.source import Unit
from twin.program.tables import ISO_G, ISO_M, NOTE, REFUSED
from twin.program.words import NUMBER

_NOT_IN_LINUXCNC: dict[float, str] = {
    76: "threading is not simulated",
    88: "boring with a halt for the hand is not simulated",
    87: "LinuxCNC itself does not carry it out",
    100: "LinuxCNC has no such code",
    101: "LinuxCNC has no such code",
}
_ONLY_IN_LINUXCNC: dict[float, str] = dict.fromkeys((33, 33.1), "threading is not simulated")
_ALIKE: tuple[set[float], ...] = (
    {0, 1, 2, 3, *CYCLES}, {17, 18, 19}, {90, 91}, {93, 94, 95}, {20, 21, 70, 71}, {40, 41, 42, 41.1, 42.1}, {61, 61.1, 64}, {98, 99},
    {54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3},
)  # fmt: skip
"""Codes of which a block takes one: LinuxCNC refuses two, on a Fanuc the last counts."""
_WORDS_OF_NOTES = {5.1: "PQR", 8: "PQR", 61.2: "PQR", 187: "PQRE", 103: "P", 22: "XYZIJK", 60: ""}


_AXES = (*LINEAR, *ROTARY, *OTHER)
_MODES = ("motion", "plane", "absolute", "centre_absolute", "system", "rounding", "tolerance", "retract_to_start")
"""What M70 and M73 of LinuxCNC keep, beside unit and feed."""


class Iso(IsoCalls):
    """Reads the blocks of one ISO program."""

    def __init__(self, path: Path, machine: Machine, unit: Unit, *, linuxcnc: bool) -> None:
        super().__init__(path, machine, unit, linuxcnc=linuxcnc)
        self.flow = Flow(self.unit_read, self)
        self.plain_block = re.compile(
            r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?"
            + "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
            + rf"(?:F({NUMBER})\s*)?;?\s*$",
            re.A,
        )
        self.with_m19 = False
        self.stored_modes: dict[int, tuple[list, float, int, float]] = {}
        self.set_frames()

    def run(self) -> Any:
        """All blocks; the moves stand in `out`."""
        self.flow.run()
        self._release()
        if self.comp is not None:
            self.compensate(0, 0.0, along_next=False)
        return self.out

    def words(self, text: str) -> None:
        """One block."""
        body, *messages = text.split(SEPARATOR)
        if self.parameter_lines:
            self.parameter_lines = "G11" not in body
            return
        if body.strip():
            try:
                self.execute(*self.parse(body))
            except CycleError as error:
                raise WordError(str(error), 1) from None
        for message in messages:
            self.out.messages.append(message_text(message, self.number_of))

    def parse(self, text: str) -> tuple[list[tuple[float, int]], list[tuple[float, int]], dict[str, Item]]:
        """G codes, M codes and the other words of a block; variables that it sets are set behind it."""
        g: list[tuple[float, int]] = []
        m: list[tuple[float, int]] = []
        words: dict[str, Item] = {}
        later: list[tuple[int | str, float, int]] = []
        e = self._expression(text, 0)
        while char := e.peek():
            column = e.at + 1
            if char == "#":
                e.at += 1
                key = self._key(e)
                if e.peek() != "=":
                    raise e.fail("a variable stands alone; give it a value with '='")
                e.at += 1
                later.append((key, e.number(), column))
                continue
            name = char
            if char == ",":
                e.at += 1
                name = "," + e.peek()
            if not name[-1].isalpha() or not name.isascii():
                raise WordError(f"'{char}' starts no word", column)
            e.at += 1
            if not self.linuxcnc and name in _AXES and (not e.peek() or e.peek() in _AXES) and {28, 30} & {n for n, _ in g}:
                self.note("G28, G30: an axis without a value goes to its reference point at once")
                words[name] = Item(0.0, "IC", column)
                continue
            if not e.peek():
                raise WordError(f"'{name}' needs a number", column)
            try:
                value = e.atom()
            except WordError as error:
                raise WordError(f"'{name}' needs a number: {error}", error.column) from None
            if isinstance(value, str):
                raise WordError(f"'{name}' needs a number", column)
            if name == "N":
                self.block = int(value)
            elif name == "G":
                g.append((round(value, 4), column))
            elif name == "M":
                m.append((value, column))
            elif isinstance(value, Null) and not self.linuxcnc:
                self.note(f"{name}: a word whose variable was never set counts as not written")
            elif name == "T" and name in words and not self.linuxcnc:
                self.note("T twice in a block: the second prepares the tool of the next change")
            elif name in words:
                raise WordError(f"{name} stands twice in the block; keep one", column)
            else:
                words[name] = Item(float(value), "", column)
        for key, value, column in later:
            self._write(key, value, column)
        return g, m, words

    def fast(self, text: str, line: int) -> bool:
        """Take a plain block of coordinates; False if it must be read word by word."""
        if not self.plain or self.cycle is not None or self.polar or self.modal_macro is not None or self.held is not None:
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, g, x, y, z, a, c, f = match.groups()
        motion = self.motion if g is None else int(g)
        if motion not in (0, 1):
            return False
        out = self.out
        if f is not None:
            self.feed = float(f)
        self.motion = motion
        if x is None and y is None and z is None and a is None and c is None:
            return True
        self.line, self.block = line, int(number) if number else -1
        position = out.position
        tilt, turn = self.plain_place(x, y, z, a, c)
        self._feed_given(mv.LINE if motion else mv.RAPID)
        if motion and not self.feed:
            self._no_feed()
        out.add(
            mv.LINE if motion else mv.RAPID, (position[0], position[1], position[2], tilt, turn), None,
            self.feed if motion else math.inf, line, self.block,
        )  # fmt: skip
        return True

    def settle_plain(self) -> None:
        super().settle_plain()
        self.plain = self.plain and self.out.modes.feed_mode != 93

    def execute(self, g: list[tuple[float, int]], m: list[tuple[float, int]], words: dict[str, Item]) -> None:
        """The words of a block in the order in which the control takes them; what nothing has used is an error."""
        g = [self._known_g(number, column) for number, column in g]
        m_codes = [self._known_m(number, column) for number, column in m]
        self.with_m19 = 19 in m_codes
        w = dict(words)
        codes = {number for number, _ in g}
        if self.held is not None and (not words.keys() & set("XYZ") or codes - {1} or m_codes):
            self._release()
        if self._calls(codes, m_codes, w):
            return
        if 100 in codes and "T" in w:
            self._change_and_move(g, m, w)
            return
        w = {self.slot_of.get(name, name): item for name, item in w.items()}
        if not self.linuxcnc and codes & {41, 42} and not codes & {43, 43.4, 43.5, 44} and "H" in w and "D" not in w:
            self.note("G41 H, G42 H: H is the number of the radius, as on older controls")
            w["D"] = w.pop("H")
        self._feed_and_tool(codes, g, m_codes, w)
        if self.linuxcnc:
            for alike in _ALIKE:
                if len(both := [n for n, _ in g if n in alike]) > 1:
                    raise WordError(f"G{both[0]:g} and G{both[1]:g} stand in one block; keep one", 1)
        motion = next((n for n, _ in reversed(g) if n in _ALIKE[0]), None)
        plane_before = self.plane
        modal = False
        for number, column in g:
            if number not in (0, 1, 2, 3, 53, *REFERENCES, 33, 33.1, *self.splines) and number not in CYCLES:
                modal = self._g(number, column, w, codes) or modal
        if self.plane != plane_before and self.comp is not None:
            raise WordError("the plane changes inside G41 or G42; write G40 before", 1)
        if motion is not None and motion in CYCLES:
            if self.cycle is None:
                self.sticky = {}
                self.initial = float(self.here()[arcs.PLANES[self.plane][2]])
            self.cycle = {"g": int(motion)}
        elif motion is not None:
            self.cycle, self.motion = None, int(motion)
        pause = self._m_before(m_codes, w)
        if "D" in w and not self.linuxcnc:
            self._other_radius(w.pop("D"))
        self._move_words(codes, w)
        if 9 in codes:
            self.stop(0.0)
        if pause is not None:
            self.stop(pause)
        if w:
            name, item = next(iter(w.items()))
            raise WordError(f"{name} has no use in this block; remove it, or add the G or M code that it belongs to", item.column)
        self._m_after(m_codes)

    def _change_and_move(self, g: list[tuple[float, int]], m: list[tuple[float, int]], w: dict[str, Item]) -> None:
        """G100 T of a Brother: a tool change, then rapid, Z last."""
        self.note("G100 T: a tool change, then the other axes at rapid, then Z")
        motion = self.motion
        places = {name: w.pop(name) for name in (*LINEAR, *ROTARY, *OTHER) if name in w}
        self.execute([entry for entry in g if entry[0] != 100], [*m, (6.0, 1)], w)
        height = {"Z": places.pop("Z")} if "Z" in places else {}
        for part in (places, height):
            if part:
                self.execute([(0, 1)], [], part)
        self.motion = motion

    def _known_g(self, number: float, column: int) -> tuple[float, int]:
        entry = ISO_G.get(number)
        if number in (_NOT_IN_LINUXCNC if self.linuxcnc else _ONLY_IN_LINUXCNC):
            entry = (REFUSED, (_NOT_IN_LINUXCNC if self.linuxcnc else _ONLY_IN_LINUXCNC)[number])
        if entry is None:
            raise WordError(f"G{number:g} is not known; remove it or replace it by moves (docs/programs.md lists what is read)", column)
        if entry[0] == REFUSED:
            raise WordError(f"G{number:g} is not supported: {entry[1]}", column)
        return number, column

    def _known_m(self, number: float, column: int) -> int:
        if number != int(number) or not 0 <= number <= 99999:
            raise WordError(f"M{number:g} is no M code", column)
        entry = ISO_M.get(int(number))
        if entry is not None and entry[0] == REFUSED:
            raise WordError(f"M{number:g} is not supported: {entry[1]}", column)
        return int(number)

    def _feed_and_tool(self, codes: set[float], g: list, m: list[int], w: dict[str, Item]) -> None:
        for number in (93, 94, 95):
            if number in codes:
                self.set_feed_mode(number)
        for number in (20, 21, 70, 71):
            if number in codes:
                self.set_unit(INCH if number in (20, 70) else 1e-3, feed=True)
        if "F" in w and 65 not in codes:
            item = w.pop("F")
            self.set_feed(item.value, item.column)
        elif self.out.modes.feed_mode == 93 and self.motion in (1, 2, 3) and not codes & {0, 4, 10, 92, 52} and w.keys() & set("XYZAC"):
            raise WordError("under G93 every block needs its own F; add it", 1)
        if "S" in w:
            self.set_spindle(w.pop("S").value)
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
            if self.out.modes.traori:
                raise WordError("G44 under G43.4 is not supported; use G43 with a negative length", 1)
            self.note("G44: taken as G43; without G43.4 X Y Z are positions of the axes whatever the length")
        if codes & {43, 43.4, 43.5, 44, 234}:
            tool["G43"] = 43.0, 1
        if 49 in codes:
            tool["G49"] = 49.0, 1
            if self.swivelled is None:
                self.transform(False)
        if tool:
            self.tools.block(tool)
        if codes & {43.4, 43.5, 234}:
            self.transform(True)
        if "E" in w and not codes & {187}:
            raise WordError("E has no use in this block; remove it", w["E"].column)

    def _g(self, number: float, column: int, w: dict[str, Item], codes: set[float]) -> bool:
        """A G code that is no motion."""
        kind, meaning = ISO_G[number]
        if kind == NOTE:
            self.note(f"G{number:g}: {meaning}")
            for name in _WORDS_OF_NOTES.get(number, ""):
                w.pop(name, None)
        elif number == 5:
            if "P" not in w or w.keys() & set("XYZIJQ"):
                raise WordError("G5 is not supported: splines; let the CAM system put out lines or arcs", column)
            w.pop("P")
            self.note("G5 P: high-speed mode of the control, understood, without effect on the motion")
        elif number in (17, 18, 19):
            self.plane = int(number)
        elif number in (90, 91):
            self.absolute = number == 90
            self.settle_plain()
        elif number in (90.1, 91.1):
            self.centre_absolute = number == 90.1
        elif number == 4:
            self._dwell(w)
        elif number in (40, 41, 42, 41.1, 42.1):
            self._compensation(number, w, column)
        elif 54 <= number <= 59.3 or number == 154 or 110 <= number < 130:
            self._choose_system(number, w, column)
        elif number == 10:
            self._g10(w, column)
        elif number == 11:
            pass
        elif number == 10.9:
            if "X" in w and w.pop("X").value:
                raise WordError("G10.9 X1 is not supported: diameters are programmed on lathes; this machine mills", column)
            self.note("G10.9 X0: lengths are radii, as here")
        elif number == 92:
            self._g92(w, column)
        elif number in (92.1, 92.2, 92.3):
            if number == 92.1:
                self.shift_kept = np.zeros(5)
            self.shift_on = number == 92.3
            self.shift = self.shift_kept if self.shift_on else np.zeros(5)
            self.set_frames()
        elif number == 52:
            self._g52(w)
        elif number in (68, 69, 51, 51.1, 50, 50.1, 100, 101):
            if number == 69:
                self._unswivel()
            self._map(number, w, column)
        elif number == 68.2:
            self._tilt(w)
        elif number in (15, 16):
            self.polar, self.polar_place = number == 16, None
        elif number in (61, 61.1, 64):
            self._path_mode(number, w, self.with_m19)
        elif number in (28.1, 30.1):
            self.home[int(number)] = np.array([*self.out.position[:3], *self._place()[3:]])
        elif number == 80:
            self.cycle = None
            if self.linuxcnc:
                self.motion = None
        elif number in (98, 99):
            self.retract_to_start = number == 98
        elif number == 43.1:
            for name in LINEAR:
                w.pop(name, None)
            self.note("G43.1: its length counts as that of the tool in the spindle")
        return False

    def _m_before(self, m: list[int], w: dict[str, Item]) -> float | None:
        pause = None
        for number in m:
            entry = ISO_M.get(number)
            if number in (0, 1, 6, 60):
                self.note(f"M{number}: the program goes on after an exact stop")
                pause = 0.0
            elif number in (2, 30):
                continue
            elif number in (70, 71, 72, 73) and self.linuxcnc:
                self._modes(number)
            else:
                self.note(f"M{number}: {entry[1] if entry else 'a code of the machine builder, without effect on the motion'}")
                for name in ("P", "Q", "R", "E", "L", "D", "K") if entry is None or number in (19, 62, 63, 64, 65, 66, 67, 68, 29) else ():
                    w.pop(name, None)
            if number in (48, 49, 50, 51, 52, 53):
                w.pop("P", None)
        return pause

    def _modes(self, number: int) -> None:
        """M70 stores the modes, M71 forgets them, M72 brings them back; M73 does so at the end of the subprogram."""
        frame = self.flow.frame
        stored = [getattr(self, n) for n in _MODES], self.unit, self.out.modes.feed_mode, self.feed

        def restore(kept: tuple[list, float, int, float]) -> None:
            values, unit, mode, feed = kept
            for name, value in zip(_MODES, values):
                setattr(self, name, value)
            self.set_unit(unit, feed=True)
            self.set_feed_mode(mode)
            self.feed = feed
            self.round_corners()
            self.set_frames()

        if number in (70, 73):
            self.stored_modes[id(frame)] = stored
        if number == 73:
            frame.on_return = lambda: restore(stored)
        elif number == 71:
            self.stored_modes.pop(id(frame), None)
        elif number == 72:
            if id(frame) not in self.stored_modes:
                raise WordError("M72 finds no modes that M70 has kept in this program or subprogram; add M70", 1)
            restore(self.stored_modes[id(frame)])

    def _m_after(self, m: list[int]) -> None:
        if 2 in m or 30 in m:
            self.flow.ended = True
