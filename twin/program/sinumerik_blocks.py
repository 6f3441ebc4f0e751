"""The reader of SINUMERIK programs: the words of a block by their use, and what the dialect keeps from block to block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
import re

import numpy as np

from twin.machine.machine import Machine
from twin.program.expressions import NUMBER, Value, WordError
from twin.program.flow import Frame as Call
from twin.program.frames import INDEX, OTHER
from twin.program.reader import Reader
from twin.program.sinumerik_lines import SinumerikLines
from twin.program.sinumerik_values import SinumerikValues
from twin.program.source import Unit, plain_name
from twin.program.state import Block as Words
from twin.program.state import Item
from twin.program.structures import Statement
from twin.program.tables import REFUSED
from twin.program.tables import Word as Meaning
from twin.program.words import Word, split_words

SINUMERIK_FRAMES = ("basic", "settable", "fine", "program", "plane")
"""Outermost first; `fine` is G59."""
_INDEXED_AXES = {"POS", "POSA", "AX"}
_MACHINE_AXES = {"X1", "Y1", "Z1", "A1", "B1", "C1"}


@dataclass
class Block(Words):
    """The words of one block by their use."""

    tool: dict[str, tuple[Value, int]] = field(default_factory=dict)  # T D H M6: value and column
    names: list[Word] = field(default_factory=list)  # words without a number
    calls: list[Word] = field(default_factory=list)  # subprograms
    curve: str = ""  # CIP or CT

    def has(self, *names: str) -> bool:
        """Whether one of these names stands in the block."""
        return any(word.name in names for word in self.names)


class Sinumerik(Reader):
    """Reads the blocks of one SINUMERIK program."""

    carry_out: Callable[[Block], None]
    lines: SinumerikLines
    values: SinumerikValues
    other_statement: Callable[[Statement, Call], None]

    def __init__(self, path: Path, machine: Machine, units: list[Unit], names: Mapping[str, Meaning]) -> None:
        super().__init__(path, machine, "sinumerik", units[0], SINUMERIK_FRAMES)
        self.known = names
        self.units = {plain_name(u.name): u for u in reversed(units)}
        self.lines = SinumerikLines(self.state)
        self.pole = np.zeros(3)
        self.angles_are_rpy: bool | None = None  # ORIRPY, ORIEULER
        self.corners_meet = False  # G451
        self.modal: Callable[[], None] | None = None  # MCALL
        self.written_back: list[tuple[str, dict, int]] = []  # target, store and column of VAR values of the call in hand
        self.values = SinumerikValues(self.state, self.flow, self.corners, names)
        letters = "".join(rf"(?:{letter}=?({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        vector = rf"(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?"
        self.plain_block = re.compile(rf"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?{letters}{vector}(?:F({NUMBER})\s*)?$", re.A)
        self.out.mixed_feed = "F beside X Y Z with A or C: it counts X Y Z alone, the setting as delivered (FGROUP changes it)"
        self.values.choose("G500")

    def find(self, name: str) -> Unit | None:
        """A subprogram in this file or beside it."""
        return self.units.get(plain_name(name)) or self.folder.find(name)

    def other(self, s: Statement, frame: Call) -> None:
        self.other_statement(s, frame)

    def plain_now(self) -> bool:
        return self.modal is None and not self.corners.every_corner and self.state.override == 1.0

    def words(self, text: str) -> None:
        body, number = self.lines.body(text)
        if number >= 0:
            self.state.block = number
        block = Block()
        for word in split_words(body):
            self._sort(block, word, self.state.slot_of.get(word.name, word.name))
        self.carry_out(block)

    def _sort(self, block: Block, word: Word, name: str) -> None:
        """Put a word where it is used; a variable gets its value at once."""
        values, with_number = self.values, word.value is not None or word.assigned
        meaning = self.known.get(name)
        if word.assigned and (name in self.flow.frame.variables or name in values.globals or re.fullmatch(r"R\d*", name) or name[0] == "$"):
            values.assignment(word)
        elif name == "G" and with_number:
            block.g.append((values.value(word) if word.index is None else values.of_group(word), word.column))
        elif name in INDEX or name in OTHER or name in _MACHINE_AXES or (name in _INDEXED_AXES and word.index):
            self._axis(block, word, name)
        elif name in ("I", "J", "K", "F", "S", "P") or (meaning is not None and meaning.group == "value"):
            self._once(block, name, word)
        elif name == "M" and with_number:
            block.m.append(int(values.value(word)))
        elif name in ("T", "D", "H") and with_number:
            block.tool[name] = values.value_of(word.text or "", word.text_column) if word.assigned else values.value(word), word.column
        elif name == "L" and word.value is not None:
            block.calls.append(word)
        elif name == "S1" and word.assigned and "S" not in block.w:
            self._once(block, "S", word)
        elif re.fullmatch(r"[SMHTD]\d+", name) and word.assigned:
            self.state.note(f"{name}=: a word of another spindle or tool, understood, no effect on the motion")
        elif name == "R":
            raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
        elif len(name) == 1:
            raise WordError(
                f"word '{name}' is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
            )
        elif meaning is not None and not (meaning.kind == REFUSED and name.startswith("CYCLE") and self.find(name) is not None):
            block.names.append(word)
        elif word.assigned:
            values.assignment(word)
        else:
            block.calls.append(word)

    def _once(self, block: Block, name: str, word: Word) -> None:
        """Put a word with a number into the block."""
        if name in block.w:
            raise WordError(f"{name} occurs twice in the block; keep one", word.column)
        block.w[name] = self.values.item(word)

    def _axis(self, block: Block, word: Word, name: str) -> None:
        """A coordinate: X, X1, AX[..], POS[..]."""
        if word.index and name not in _INDEXED_AXES:
            raise WordError(f"{name}[..] is not an axis; write {name} and its place, or AX[..]", word.column)
        axis = name[0] if name not in _INDEXED_AXES else self.values.axis_of(word)
        axis = self.state.slot_of.get(axis, axis) if axis != name else axis
        if axis not in INDEX and axis not in OTHER:
            raise WordError(f"{name}[{axis}]: this machine has {self.out.own_axes}", word.column)
        self._once(block, axis, word)
        if name.startswith("POS"):
            self.state.note("POS, POSA: the axis moves with the others of the block, and at rapid if it is alone")
            block.w["POS"] = Item(1.0, "", word.column)
