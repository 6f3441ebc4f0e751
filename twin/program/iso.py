"""Reader of ISO programs (Fanuc and similar controls, LinuxCNC): words of a block, expressions, O-words, macros.

Some words mean different things on LinuxCNC and Fanuc. `linuxcnc` selects the dialect: a file .ngc, or one with O-words or named
parameters. Where the dialects differ, a note gives the chosen meaning.
"""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import Control
from twin.program.corners import Corners
from twin.program.cycles import CycleError
from twin.program.expressions import Null, WordError
from twin.program.flow import Flow
from twin.program.iso_calls import IsoCalls
from twin.program.iso_drilling import CYCLES, IsoDrilling
from twin.program.iso_frames import IsoFrames
from twin.program.iso_lines import SEPARATOR, IsoLines, between_percents, message_text
from twin.program.iso_modes import IsoModes
from twin.program.iso_motion import POLAR, REFERENCES, IsoMotion
from twin.program.iso_variables import IsoVariables
from twin.program.source import Unit
from twin.program.state import LINEAR, OTHER, ROTARY, Item, State
from twin.program.tables import ISO_M, WORDS_OF_M
from twin.program.words import NUMBER

_ALIKE: tuple[set[float], ...] = (
    {0, 1, 2, 3, *CYCLES}, {17, 18, 19}, {90, 91}, {93, 94, 95}, {20, 21, 70, 71}, {40, 41, 42, 41.1, 42.1}, {61, 61.1, 64}, {98, 99},
    {54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3},
)  # fmt: skip
"""Groups of codes of which a block may have one: LinuxCNC refuses two, a Fanuc uses the last."""
_AXES = (*LINEAR, *ROTARY, *OTHER)


class Iso:
    """Reads the blocks of one ISO program: a state with its frames, variables, cycles, moves, calls and modes."""

    def __init__(self, path: Path, machine: Machine, unit: Unit, *, linuxcnc: bool) -> None:
        unit = between_percents(unit)
        self.state = State(path, machine, "linuxcnc" if linuxcnc else "iso")
        self.corners = Corners(Control(self.state))
        self.control, self.out = self.corners.control, self.state.out
        self.flow = Flow(unit, self.state, IsoLines(self.state))
        self.frames = IsoFrames(self.state)
        self.values = IsoVariables(self.state, self.flow, self.frames)
        self.drilling = IsoDrilling(self.control)
        self.moves = IsoMotion(self.corners, self.flow, self.values, self.drilling)
        self.calls = IsoCalls(self.moves, self, unit)
        self.modes = IsoModes(self.moves, self.frames)
        self.plain_block = re.compile(
            r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?"
            + "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.state.out.kinematics.letters)
            + rf"(?:F({NUMBER})\s*)?;?\s*$",
            re.A,
        )
        self.state.out.set_modes(replace(self.state.out.modes, feed_of_all=not linuxcnc))
        self.state.out.mixed_feed = (
            "F beside X Y Z with A or C: it counts X Y Z alone, as on LinuxCNC"
            if linuxcnc
            else "F beside X Y Z with A or C: it counts all axes, a degree as a unit of length, as on a Fanuc; in .ngc files X Y Z alone"
        )
        self.state.set_frames()

    def run(self) -> Any:
        """Read all blocks; `out` holds the moves."""
        self.flow.run(self, self.values, self.calls)
        self.corners.release()
        if self.state.comp is not None:
            self.control.compensate(0, 0.0, along_next=False)
        return self.state.out

    def words(self, text: str) -> None:
        """One block."""
        body, *messages = text.split(SEPARATOR)
        if self.frames.parameter_lines:
            self.frames.parameter_lines = "G11" not in body
            return
        if body.strip():
            try:
                self.execute(*self.parse(body))
            except CycleError as error:
                raise WordError(str(error), 1) from None
        for message in messages:
            self.state.out.messages.append(message_text(message, self.values.number_of))

    def parse(self, text: str) -> tuple[list[tuple[float, int]], list[tuple[float, int]], dict[str, Item]]:
        """G codes, M codes and the other words of a block; assigned variables are set after the block is read."""
        g: list[tuple[float, int]] = []
        m: list[tuple[float, int]] = []
        words: dict[str, Item] = {}
        later: list[tuple[int | str, float, int]] = []
        e = self.values.expression(text, 0)
        while char := e.peek():
            column = e.at + 1
            if char == "#":
                e.at += 1
                key = self.values.key(e)
                if e.peek() != "=":
                    raise e.fail("a variable without an assignment; give it a value with '='")
                e.at += 1
                later.append((key, e.number(), column))
                continue
            name = char
            if char == ",":
                e.at += 1
                name = "," + e.peek()
            if not (name[-1].isalpha() or (self.state.linuxcnc and name in POLAR)) or not name.isascii():
                raise WordError(f"'{char}' starts no word", column)
            e.at += 1
            if not self.state.linuxcnc and name in _AXES and (not e.peek() or e.peek() in _AXES) and {28, 30} & {n for n, _ in g}:
                self.state.note("G28, G30: an axis without a value goes to its reference point at once")
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
                self.state.block = int(value)
            elif name == "G":
                g.append((round(value, 4), column))
            elif name == "M":
                m.append((value, column))
            elif isinstance(value, Null) and not self.state.linuxcnc:
                self.state.note(f"{name}: a word whose variable was never set is ignored")
            elif name == "T" and name in words and not self.state.linuxcnc:
                self.state.note("T twice in a block: the second prepares the tool of the next change")
            elif name in words:
                raise WordError(f"{name} occurs twice in the block; keep one", column)
            else:
                words[name] = Item(float(value), "", column)
        for key, value, column in later:
            self.values.write(key, value, column)
        return g, m, words

    def fast(self, text: str, line: int) -> bool:
        """Execute a plain block of coordinates; False if it must be read word by word."""
        state = self.state
        if (
            not state.plain
            or self.drilling.cycle is not None
            or self.moves.polar
            or self.moves.modal_macro is not None
            or self.corners.held is not None
        ):
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, g, x, y, z, a, c, f = match.groups()
        motion = state.motion if g is None else int(g)
        if motion not in (0, 1):
            return False
        out = state.out
        if f is not None:
            state.feed = float(f)
        state.motion = motion
        if x is None and y is None and z is None and a is None and c is None:
            return True
        state.line, state.block = line, int(number) if number else -1
        position = out.position
        tilt, turn = state.plain_place(x, y, z, a, c)
        if motion and math.isnan(state.feed):
            self.control.feed_given(mv.LINE)
        if motion and not state.feed:
            self.drilling.no_feed()
        out.add(
            mv.LINE if motion else mv.RAPID, (position[0], position[1], position[2], tilt, turn), None,
            state.feed if motion else math.inf, line, state.block,
        )  # fmt: skip
        return True

    def execute(self, g: list[tuple[float, int]], m: list[tuple[float, int]], words: dict[str, Item]) -> None:
        """Execute the words of a block in the order of the control; an unused word is an error."""
        g = [self.modes.known_g(number, column) for number, column in g]
        m_codes = [self.modes.known_m(number, column) for number, column in m]
        self.modes.with_m19 = 19 in m_codes
        w = dict(words)
        codes = {number for number, _ in g}
        if self.corners.held is not None and (not words.keys() & set("XYZ") or codes - {1} or m_codes):
            self.corners.release()
        if self.calls.block(codes, m_codes, w):
            return
        if 100 in codes and "T" in w:
            self._change_and_move(g, m, w)
            return
        w = {self.state.slot_of.get(name, name): item for name, item in w.items()}
        if not self.state.linuxcnc and codes & {41, 42} and not codes & {43, 43.4, 43.5, 44} and "H" in w and "D" not in w:
            self.state.note("G41 H, G42 H: H is the number of the radius, as on older controls")
            w["D"] = w.pop("H")
        self.modes.feed_and_tool(codes, g, m_codes, w)
        if self.state.linuxcnc:
            self.state.one_of_each([n for n, _ in g], _ALIKE)
        motion = next((n for n, _ in reversed(g) if n in _ALIKE[0]), None)
        plane_before = self.state.plane
        modal = False
        for number, column in g:
            if number not in (0, 1, 2, 3, 53, *REFERENCES, 33, 33.1, *self.moves.splines) and number not in CYCLES:
                modal = self.modes.g_code(number, column, w, codes) or modal
        if self.state.plane != plane_before and self.state.comp is not None:
            raise WordError("the plane changes inside G41 or G42; write G40 before", 1)
        if motion is not None and motion in CYCLES:
            if self.drilling.cycle is None:
                self.drilling.sticky = {}
                self.drilling.initial = float(self.state.here()[arcs.PLANES[self.state.plane][2]])
            self.drilling.cycle = {"g": int(motion)}
        elif motion is not None:
            self.drilling.cycle, self.state.motion = None, int(motion)
        pause = self.modes.m_before(m_codes, w)
        if "D" in w and not self.state.linuxcnc:
            self.moves.other_radius(w.pop("D"))
        self.moves.move_words(codes, w)
        if any(number == 29 or number not in ISO_M for number in m_codes):  # codes of the machine builder have what no move used
            for name in WORDS_OF_M:
                w.pop(name, None)
        if 9 in codes:
            self.control.stop(0.0)
        if pause is not None:
            self.control.stop(pause)
        self.state.all_used(w)
        if 2 in m_codes or 30 in m_codes:
            self.flow.ended = True

    def _change_and_move(self, g: list[tuple[float, int]], m: list[tuple[float, int]], w: dict[str, Item]) -> None:
        """G100 T of a Brother: a tool change, then rapid, Z last."""
        self.state.note("G100 T: a tool change, then the other axes at rapid, then Z")
        motion = self.state.motion
        places = {name: w.pop(name) for name in (*LINEAR, *ROTARY, *OTHER) if name in w}
        self.execute([entry for entry in g if entry[0] != 100], [*m, (6.0, 1)], w)
        height = {"Z": places.pop("Z")} if "Z" in places else {}
        for part in (places, height):
            if part:
                self.execute([(0, 1)], [], part)
        self.state.motion = motion
