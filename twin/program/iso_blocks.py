"""The reader of ISO programs (Fanuc and similar controls, LinuxCNC): the words of a block, and what the dialect keeps from block to block.

Some words mean different things on LinuxCNC and Fanuc. `linuxcnc` selects the dialect: a file .ngc, or one with O-words or named
parameters. Where the dialects differ, a note gives the chosen meaning.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import re

import numpy as np

from twin.machine.machine import Machine
from twin.program.expressions import NUMBER, Null, WordError, as_number
from twin.program.flow import Frame as Call
from twin.program.frames import AXES
from twin.program.iso_lines import SEPARATOR, IsoLines, between_percents, message_text
from twin.program.iso_values import IsoValues
from twin.program.reader import NO_GROUP, Reader
from twin.program.source import Unit
from twin.program.state import Block, Item
from twin.program.structures import Statement

ISO_FRAMES = ("system", "shift", "local", "mirror", "scale", "turn", "plane")
"""Zero offset, G92, G52, then G51.1, G51 and G68 in the order in which a Fanuc nests them, and G68.2."""
POLAR = ("@", "^")
"""Words of a radius and an angle (LinuxCNC)."""


class Iso(Reader):
    """Reads the blocks of one ISO program."""

    carry_out: Callable[[Block], None]
    lines: IsoLines
    values: IsoValues
    other_statement: Callable[[Statement, Call], None]

    def __init__(self, path: Path, machine: Machine, unit: Unit, linuxcnc: bool) -> None:
        super().__init__(path, machine, "linuxcnc" if linuxcnc else "iso", between_percents(unit), ISO_FRAMES)
        self.unit_read, self.linuxcnc, state = self.flow.frame.unit, linuxcnc, self.state
        state.motion, state.tools.modal_h = None, not linuxcnc
        self.mirrors: dict[int, float] = {}  # axis of G51.1 -> place of the mirror [m]
        self.cycle: int | None = None  # G73 to G89 in force
        self.sticky: dict[str, float] = {}  # words of the cycles
        self.given_absolute: dict[str, bool] = {}  # of the words in `sticky`: under G90
        self.initial = 0.0  # height at which the cycles began [m]
        self.polar = False  # G16
        self.polar_place: tuple[float, float] | None = None  # radius and angle [deg] that G16 keeps
        self.any_motion = False  # a Fanuc takes coordinates before any G0 or G1 as rapid
        self.modal_macro: tuple[Unit, int, dict] | None = None  # G66
        self.edge: Item | None = None  # D, which a Fanuc keeps
        self.spline_arm = 0.0, 0.0  # P and Q of the last G5 [m]
        self.between: tuple[np.ndarray, tuple[float, float]] | None = None  # the point of G28 or G30, through which G29 returns
        self.parameter_lines = False  # behind G10 L50, up to G11
        self.stored_modes: dict[int, Callable[[], None]] = {}
        self.main_seen = False
        self.lines, self.values = IsoLines(state), IsoValues(state, self.flow)
        self.offsets = self.values.offsets
        letters = "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        self.plain_block = re.compile(rf"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?{letters}{3 * NO_GROUP}(?:F({NUMBER})\s*)?;?\s*$", re.A)
        self.out.set_modes(replace(self.out.modes, feed_of_all=not linuxcnc))
        self.out.mixed_feed = (
            "F beside X Y Z with A or C: it counts X Y Z alone, as on LinuxCNC"
            if linuxcnc
            else "F beside X Y Z with A or C: it counts all axes, a degree as a unit of length, as on a Fanuc; in .ngc files X Y Z alone"
        )

    def other(self, s: Statement, frame: Call) -> None:
        self.other_statement(s, frame)

    def runs_into(self, what: str, column: int) -> None:
        if self.main_seen and len(self.flow.frames) == 1 and self.linuxcnc:
            raise WordError(f"the program O.. runs on into {what}; end it with M2, M30 or %", column)

    def plain_now(self) -> bool:
        return self.cycle is None and not self.polar and self.modal_macro is None

    def words(self, text: str) -> None:
        body, *messages = text.split(SEPARATOR)
        if self.parameter_lines:
            self.parameter_lines = "G11" not in body
            return
        if body.strip():
            self.carry_out(self.words_of(body))
        for message in messages:
            self.out.messages.append(message_text(message, self.values.number_of))

    def words_of(self, text: str) -> Block:
        """The words of a block; assigned variables are set after the block is read."""
        block, later = Block(), []
        g, m, words, e, fanuc = block.g, block.m, block.w, self.values.expression(text), not self.linuxcnc
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
            if not (name[-1].isalpha() or (self.linuxcnc and name in POLAR)) or not name.isascii():
                raise WordError(f"'{char}' starts no word", column)
            e.at += 1
            if fanuc and name in AXES and (not e.peek() or e.peek() in AXES) and any(number in (28, 30) for number, _ in g):
                self.state.note("G28, G30: an axis without a value goes to its reference point at once")
                words[name] = Item(0.0, "IC", column)
                continue
            if not e.peek():
                raise WordError(f"'{name}' needs a number", column)
            try:
                value = as_number(e.atom(), column)
            except WordError as error:
                raise WordError(f"'{name}' needs a number: {error}", error.column) from None
            if name == "N":
                self.state.block = int(value)
            elif name == "G":
                g.append((round(value, 4), column))
            elif name == "M":
                if value != int(value) or not 0 <= value <= 99999:
                    raise WordError(f"M{value:g} is not an M code", column)
                m.append(int(value))
            elif isinstance(value, Null) and fanuc:
                self.state.note(f"{name}: a word whose variable was never set is ignored")
            elif name == "T" and name in words and fanuc:
                self.state.note("T twice in a block: the second prepares the tool of the next change")
            elif name in words:
                raise WordError(f"{name} occurs twice in the block; keep one", column)
            else:
                words[name] = Item(float(value), "", column)
        for key, number, column in later:
            self.values.write(key, number, column)
        return block
