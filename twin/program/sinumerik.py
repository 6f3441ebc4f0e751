"""Reader of SINUMERIK programs: words of a block, variables, subprograms, frames, cycles."""

from __future__ import annotations

from pathlib import Path
import re

from twin.machine.machine import Machine
from twin.program.expressions import WordError
from twin.program.frames import INDEX, OTHER
from twin.program.reader import Reader
from twin.program.sinumerik_calls import SinumerikCalls
from twin.program.sinumerik_cycles import SinumerikCycles
from twin.program.sinumerik_frames import SINUMERIK_FRAMES, SinumerikFrames
from twin.program.sinumerik_lines import SinumerikLines
from twin.program.sinumerik_modes import SinumerikModes
from twin.program.sinumerik_motion import Block, SinumerikMotion
from twin.program.sinumerik_variables import SinumerikVariables
from twin.program.source import Unit
from twin.program.state import Item
from twin.program.tables import ACTS, SINUMERIK_G, SINUMERIK_M, SINUMERIK_NAMES
from twin.program.words import NUMBER, Word, split_words

_INDEXED_AXES = {"POS", "POSA", "AX"}
_MACHINE_AXES = {"X1", "Y1", "Z1", "A1", "B1", "C1"}
_ALIKE: tuple[set[float], ...] = (
    {0, 1, 2, 3, 331, 332}, {17, 18, 19}, {90, 91}, {93, 94, 95}, {70, 71, 700, 710}, {40, 41, 42}, {60, 64, 641, 642, 643, 644, 645, 646},
    {54, 55, 56, 57, 500, *range(505, 600)}, {601, 602, 603}, {450, 451},
)  # fmt: skip
"""G codes of one group: a block takes one of them."""
_SWITCH_WORDS = {"TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS"}
_VALUE_WORDS = {SINUMERIK_NAMES[n][1] for n in ("CR", "A3", "I1", "OVR")} - {SINUMERIK_NAMES["CIP"][1]}


class Sinumerik(Reader):
    """Reads the blocks of one SINUMERIK program."""

    def __init__(self, path: Path, machine: Machine, units: list[Unit]) -> None:
        super().__init__(path, machine, "sinumerik", units[0], SINUMERIK_FRAMES)
        self.lines = SinumerikLines(self.state)
        self.frames = SinumerikFrames(self.corners)
        self.values = SinumerikVariables(self.flow, self.frames)
        self.moves = SinumerikMotion(self.frames)
        self.cycles = SinumerikCycles(self.control, self.values)
        self.calls = SinumerikCalls(self, self.lines, self.values, self.moves, units)
        self.modes = SinumerikModes(self.calls, self.cycles)
        self.flow.speak(self.lines, self.values, self.calls, self)
        letters = "".join(rf"(?:{letter}=?({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        vector = rf"(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?"
        self.plain_block = re.compile(rf"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?{letters}{vector}(?:F({NUMBER})\s*)?$", re.A)
        self.out.mixed_feed = "F beside X Y Z with A or C: it counts X Y Z alone, the setting as delivered (FGROUP changes it)"
        self.frames.choose("G500")

    def plain_now(self) -> bool:
        return self.cycles.modal is None and not self.corners.every_corner and self.state.override == 1.0

    def block(self, text: str) -> None:
        body, number = self.lines.body(text)
        if number >= 0:
            self.state.block = number
        self._block(split_words(body))

    def _block(self, words: list[Word]) -> None:
        """All words of one block: first the modes, then the move."""
        block = Block()
        for word in words:
            name = self.state.slot_of.get(word.name, word.name)
            if word.assigned and (
                name in self.flow.frame.variables or name in self.values.globals or re.fullmatch(r"R\d*", name) or name[0] == "$"
            ):
                self.values.assignment(word)
            elif name == "G" and (word.value is not None or word.assigned):
                block.g.append((self.values.value(word) if word.index is None else self.values.of_group(word), word))
            elif name in INDEX or name in OTHER or name in _MACHINE_AXES or (name in _INDEXED_AXES and word.index):
                if word.index and name not in _INDEXED_AXES:
                    raise WordError(f"{name}[..] is not an axis; write {name} and its place, or AX[..]", word.column)
                axis = name[0] if name not in _INDEXED_AXES else self.values.axis_of(word)
                axis = self.state.slot_of.get(axis, axis) if axis != name else axis
                if axis not in INDEX and axis not in OTHER:
                    raise WordError(f"{name}[{axis}]: this machine has {self.state.out.own_axes}", word.column)
                if axis in block.coordinates:
                    raise WordError(f"{axis} occurs twice in the block; keep one", word.column)
                block.coordinates[axis] = self.values.item(word)
                if name.startswith("POS"):
                    self.state.note("POS, POSA: the axis moves with the others of the block, and at rapid if it is alone")
                    block.extra["POS"] = Item(1.0, "", word.column)
            elif name in ("I", "J", "K"):
                block.centre[name] = self.values.item(word)
            elif name in ("F", "S", "P") or (name in SINUMERIK_NAMES and SINUMERIK_NAMES[name][1] in _VALUE_WORDS):
                if name in block.extra:
                    raise WordError(f"{name} occurs twice in the block; keep one", word.column)
                block.extra[name] = self.values.item(word)
            elif name == "M" and (word.value is not None or word.assigned):
                block.m.append(int(self.values.value(word)))
            elif name in ("T", "D", "H") and (word.value is not None or word.assigned):
                block.tool[name] = self.values.tool_value(word), word.column
            elif name == "L" and word.value is not None:
                block.calls.append(word)
            elif name == "S1" and word.assigned and "S" not in block.extra:
                block.extra["S"] = self.values.item(word)
            elif re.fullmatch(r"[SMHTD]\d+", name) and word.assigned:
                self.state.note(f"{name}=: a word of another spindle or tool, understood, no effect on the motion")
            elif name == "R":
                raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
            elif len(name) == 1:
                raise WordError(
                    f"word '{name}' is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
                )
            elif name in SINUMERIK_NAMES and not self.calls.own_program(name):
                block.names.append(word)
            elif word.assigned:
                self.values.assignment(word)
            else:
                block.calls.append(word)
        self._carry_out(block)

    def _carry_out(self, block: Block) -> None:
        """Execute the words of a block in the order of the control."""
        numbers, extra, names, calls = block.numbers, block.extra, block.names, block.calls
        for number, word in block.g:
            self.state.check_code("G", number, SINUMERIK_G.get(number), word.column)
        self.state.one_of_each(sorted(numbers), {n: str(k) for k, group in enumerate(_ALIKE) for n in group})
        if numbers & {25, 26}:
            block.coordinates.clear()
            extra.pop("S", None)
        if block.tool or 6 in block.m:
            if 6 in block.m:
                block.tool["M6"] = 6.0, 1
            self.state.tools.block(block.tool)
        if 4 in numbers:
            self.moves.dwell(numbers, extra, bool(block.coordinates or block.centre or names or calls))
            return
        frame_word = next((w for w in names if w.name in _SWITCH_WORDS), None)
        shift = next((n for n in (58, 59) if n in numbers), None)
        suppress = bool(numbers & {53, 153}) or any(w.name == "SUPA" for w in names)
        vector = self.moves.orientation(extra)
        self.modes.settings(extra, numbers)
        modal_before = self.cycles.modal
        moved_by_name = None
        for number, word in block.g:
            self.modes.g_code(number, word)
        cycle = next((w for w in names if w.name.startswith("CYCLE8") and SINUMERIK_NAMES[w.name][0] == ACTS), None)
        if cycle is not None and any(w.name == "MCALL" for w in names):
            names = [w for w in names if w is not cycle]
        for word in names:
            if word.name in ("CIP", "CT"):
                moved_by_name = word.name
                self.state.motion = 2
            elif word.name not in _SWITCH_WORDS and word.name != "SUPA":
                self.modes.name(word, calls, cycle)
        pause = self.state.note_m(block.m, SINUMERIK_M, (2, 17, 30))
        if frame_word is not None or shift is not None:
            self.frames.frame_words(frame_word, shift, block.coordinates, extra)
        elif numbers & {74, 75}:
            self.moves.fixed_point(75 if 75 in numbers else 74, block.coordinates, extra)
        elif numbers & {110, 111, 112}:
            self.moves.set_pole(next(n for n in (110, 111, 112) if n in numbers), block.coordinates, extra)
        else:
            feed = self.state.feed
            if "FB" in extra:
                self.state.set_feed(extra.pop("FB").value)
            self.moves.motion_block(block, vector, suppress, moved_by_name)
            self.state.feed = feed if numbers.isdisjoint({331, 332}) else self.state.feed
            if block.coordinates and self.cycles.modal is not None and self.cycles.modal is modal_before:
                self.cycles.modal()
        if 9 in numbers:
            self.corners.release()
            self.control.stop(0.0)
        if pause is not None:
            self.corners.release()
            self.control.stop(pause)
        times = int(extra.pop("P").value) if "P" in extra and calls else 1
        self.state.all_used(extra)
        if len(calls) > 1:
            raise WordError(f"'{calls[1].name}' is a second call in the block; write it in the next one", calls[1].column)
        for word in calls:
            self.calls.call(word, times)
        if 17 in block.m or any(w.name in ("RET", "ENDPROC") for w in names):
            self.flow.back()
        elif 2 in block.m or 30 in block.m:
            self.flow.ended = True
