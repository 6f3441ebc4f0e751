"""The reader of HEIDENHAIN Klartext (.h): words of a block, what waits for the next block, and moves; `twin.program.klartext` has the words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
import math
from pathlib import Path
import re

import numpy as np

from twin.machine.machine import Machine
from twin.program.arcs import Arc
from twin.program.control import KEPT, Vector
from twin.program.expressions import NUMBER, WordError
from twin.program.flow import Frame as Call
from twin.program.klartext_lines import VALUE, KlartextLines, KlartextValues, joined, without_number
from twin.program.reader import ADD_CALL, NO_GROUP, Reader
from twin.program.source import Unit
from twin.program.state import Block as Words
from twin.program.state import Item
from twin.program.structures import Statement
from twin.program.tables import NOTE, REFUSED, UNKNOWN, Word

_WORD = re.compile(
    rf"\s*(?:(?P<side>R[0LR])(?![\w.])|DR\s*(?P<sense>[-+])(?![\d.Q])|F\s*(?P<feed>MAX|AUTO|{VALUE})|M\s*(?P<m>\d+)"
    rf"|(?P<arg>MB\s*MAX|(?:MB|LA|BT)\s*{VALUE})"
    rf"|(?P<inc>I?)(?P<name>PA|PR|CCA|CC[XYZ]|LEN|ABST|DIST|DR2|DR|DL|ROT|SCL|SP[ABC]|TA|[NT][XYZ]|[A-CLR-Z])\s*(?P<value>{VALUE}))",
    re.A,
)
_SIDES = {"R0": 0, "RL": 1, "RR": -1}

Element = tuple[np.ndarray, Arc | None]
"""One element of the contour: its end (3,), and its arc or none."""


@dataclass
class Block(Words):
    """The words of a block, and what stands beside them."""

    side: int | None = None
    sense: int = 0
    rapid: bool = False
    feed: str = ""
    arg: str = ""


Handler = Callable[["Klartext", str, str, int], None]
"""Carries out a block: its first word, the text behind it and the column of that text."""


class Klartext(Reader):
    """Reads the blocks of one Klartext program."""

    values: KlartextValues

    def __init__(self, path: Path, machine: Machine, unit: Unit, table: Mapping[str, Word[Handler]], m_table: Mapping[int, Word]) -> None:
        super().__init__(path, machine, "klartext", joined(unit), ("preset", "shift", "plane", "inner", "mirror", "turn", "scale"))
        state, self.table, self.m_table = self.state, table, m_table
        self.lines, self.values = KlartextLines(), KlartextValues(state, self.flow)
        self.pole: np.ndarray | None = None  # CC (3,)
        self.tool_feed, self.extra_radius = math.nan, 0.0  # F and DR of TOOL CALL
        self.shorter_way = False  # M126
        self.waiting: tuple[str, np.ndarray, Block, float] | None = None  # APPR until the first element; its feed
        self.tilt_angles: dict[str, float] = {}
        self.turn_to: tuple[float, float] | None = None  # A and C that the next move goes to (SEQ)
        self.cycle: int | None = None  # that a call carries out
        self.cycle_everywhere = False  # M89
        state.out.set_modes(replace(state.out.modes, workpiece_orientation=False, feed_of_all=True))
        state.out.mixed_feed = "F beside X Y Z with A B C: it counts all axes, a degree as a unit of length; M128 counts the tool tip"
        letters = "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        self.plain_block = re.compile(rf"\s*(\d*)\s+L\s+{NO_GROUP}{letters}{3 * NO_GROUP}(?:R0\s*)?(?:F\s*(MAX|{NUMBER})\s*)?$", re.A)

    # ------------------------------------------------------------------ blocks

    def plain_now(self) -> bool:
        return not (self.waiting or self.cycle_everywhere or self.shorter_way)

    def words(self, text: str) -> None:
        body, self.state.block = without_number(text)
        column = len(body) - len(body.lstrip()) + 1
        body = body.strip()
        match = re.match(r"(CYCL DEF)\s*(\d+)|([A-Z]+)(?:\s+[A-Z]+)?", body)
        if match is None:
            raise WordError(f"'{body[:20]}' starts no block of Klartext", column)
        names = [f"{match[1]} {match[2]}"] if match[1] else [" ".join(match[0].split()), match[3]]
        head = next((n for n in names if n in self.table), None)
        word = self.table.get(head or "")
        if head is None or word is None or word.handler is None:
            what = word.meaning if word else "let the CAM system output L, C or CR (docs/programs.md lists what is read)"
            shown = head or (names[0] if match[1] else names[-1] if len(names[-1]) > 1 else body[:20])
            raise WordError(f"{shown} is not {'supported' if word else 'known'}: {what}", column)
        begin = match.start(2) if match[1] else 0 if head in ("M", "Q", "QL", "QR", "FN") else len(head)
        word.handler(self, head, body[begin:], column + begin)

    def scan(self, text: str, column: int, where: str = "here; docs/programs.md lists the words") -> Block:
        """All words of a text; the feed counts once the M codes of the block are carried out."""
        block, at, text = Block(), 0, text.rstrip()
        while at < len(text):
            match = _WORD.match(text, at)
            if not match:
                raise WordError(f"'{text[at:].strip()[:20]}' is not read {where}", column + at)
            at, place = match.end(), column + match.start()
            if match["side"]:
                block.side = _SIDES[match["side"]]
            elif match["sense"]:
                block.sense = 1 if match["sense"] == "+" else -1
            elif match["m"]:
                block.m.append(int(match["m"]))
            elif match["arg"]:
                block.arg = match["arg"].replace(" ", "")
            elif match["feed"] and block.m and block.m[-1] in (128, 140):
                self.state.note("F behind M128 or M140 is that of its own motion") if block.m[-1] == 128 else None
            elif match["feed"] and block.feed:
                raise WordError("F occurs twice in the block; keep one", place)
            elif match["feed"]:
                block.rapid, block.feed = match["feed"] == "MAX", match["feed"]
            elif match["name"] in block.w:
                raise WordError(f"{match['name']} occurs twice in the block; keep one", place)
            else:
                name = self.state.slot_of.get(str(match["name"]), str(match["name"]))
                block.w[name] = Item(self.values.number_of(match["value"], place), "IC" if match["inc"] else "", place)
        return block

    def only_words(self, head: str, text: str, column: int, names: str, hint: str = "", added: bool = False) -> dict[str, Item]:
        """The words of a text that takes these names alone, and in addition (I) if `added`."""
        where = f"in {head}, which takes {names}{hint}"
        block = self.scan(text, column, where)
        words = block.pick(*names.split())
        if block.m or block.side is not None or block.sense or block.feed or block.arg or block.w:
            what = next(iter(block.w), "a word of a path block")
            raise WordError(f"{what} is not read {where}", column)
        if not added and (increments := [name for name, item in words.items() if item.how]):
            raise WordError(f"I{increments[0]} is not read {where}", column)
        return words

    def feed_word(self, value: float) -> float:
        """An inch program counts tenths of an inch a minute."""
        return value if self.state.unit == 1e-3 or self.out.modes.feed_mode != 94 else 0.1 * value

    def set_feed(self, text: str, column: int) -> None:
        """F AUTO, F with a value; FMAX is that of its block."""
        if text == "AUTO":
            self.state.set_feed(self.tool_feed, column)
        elif text not in ("", "MAX"):
            self.state.set_feed(self.feed_word(self.values.number_of(text, column)), column)

    def modes(self, block: Block, column: int) -> None:
        """The M codes that act before the move of their block, then its feed."""
        state = self.state
        for number in block.m:
            word = self.m_table.get(number, Word(NOTE, UNKNOWN))
            if word.kind == REFUSED:
                raise WordError(f"M{number} is not supported: {word.meaning}")
            if word.kind == NOTE:
                state.note(f"M{number}: {word.meaning}")
            elif number in (128, 129):
                self.settle()
                state.transform(number == 128)
            elif number in (126, 127):
                self.shorter_way = number == 126
            elif number in (136, 137):
                state.set_feed_mode(95 if number == 136 else 94)
            elif number == 89:
                self.cycle_everywhere = True
        if block.arg and not set(block.m) & {101, 120, 140}:
            raise WordError(f"{block.arg} belongs to an M code that is missing; remove it")
        self.set_feed(block.feed, column)

    # ------------------------------------------------------------------ moves

    def start(self) -> np.ndarray:
        """Start (3,) of the next element."""
        return self.corners.start() if self.waiting is None else self.waiting[1]

    def emit(
        self,
        kind: int,
        element: Element,
        angles: tuple[float, float] = KEPT,
        vector: Vector | None = None,
        machine: bool = False,
        corner: tuple[str, float] | None = None,
    ) -> None:
        """Make a move, or hold it until the next one defines its corner."""
        if self.turn_to is not None and vector is None and all(map(math.isnan, angles)):
            angles, self.turn_to = self.turn_to, None
        self.corners.queue(self.control.move(kind, element[0], angles, vector, element[1], machine), corner)

    def settle(self) -> None:
        """Emit what waits for the next element."""
        if self.waiting is not None:
            raise WordError("behind APPR there is no contour; add an element in the plane")
        self.corners.release()

    def radius(self, column: int) -> float:
        """Radius of the tool [m]."""
        return self.state.tools.radius(self.state.tools.name, column) + self.extra_radius

    def compensate(self, side: int, column: int) -> None:
        """R0, RL or RR from the next move on."""
        if side or self.state.comp is not None:
            self.corners.release()
            self.control.compensate(side, self.radius(column) if side else 0.0, along_next=True)

    # ------------------------------------------------------------------ calls

    def other(self, s: Statement, frame: Call) -> None:
        """Labels, calls, and the end of a program."""
        if s.kind != "lbl":
            self.settle()
        elif s.key == "0" and frame.style == "lbl":
            self.flow.back()
        if s.kind == "call_label":
            place = self.flow.place(frame, s.key, "", s.column)
            self.flow.call(frame.unit, place + 1, name=s.key, style="lbl", shared=True, column=s.column)
        elif s.kind == "call_program":
            name = s.key.replace("\\", "/").rsplit("/", 1)[-1].removesuffix(".H")
            unit = self.folder.find(name)
            if unit is not None:
                if not any("BEGIN PGM" in line for line in unit.lines[:50]):
                    raise WordError(f"CALL PGM {name}: {unit.path.name} is no Klartext program", s.column)
                self.flow.call(unit if unit.statements else joined(unit), 0, name=name, style="pgm", column=s.column)
            elif not self.moves_nothing(name):
                raise WordError(f"program {name} is not beside this one ({name}.h); {ADD_CALL}", s.column)
        elif s.kind == "end" and frame.style == "lbl":
            raise WordError("the subprogram runs on to END PGM; end it with LBL 0", s.column)
        elif s.kind == "end" and frame.style == "pgm":
            self.flow.back()
        elif s.kind == "end":
            self.flow.ended = True
