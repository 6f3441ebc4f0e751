"""SINUMERIK programs: the words of a block and what they do; variables, subprograms, frames, cycles."""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

from twin.machine.machine import Machine
from twin.program import moves as mv
from twin.program import sinumerik_cycles as cycles
from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE
from twin.program.control_state import INCH, INDEX, LINEAR, OTHER, Item
from twin.program.cycles import CycleError
from twin.program.expressions import WordError
from twin.program.flow import Flow
from twin.program.sinumerik_calls import SinumerikCalls
from twin.program.sinumerik_motion import Block
from twin.program.source import Unit, plain_name
from twin.program.tables import ACTS, NOTE, REFUSED, SINUMERIK_G, SINUMERIK_M, SINUMERIK_NAMES
from twin.program.words import NUMBER, Word, split_arguments, split_words
from twin.units import rad_from_deg

_PLAIN = (
    r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?"
    + rf"(?:X=?({NUMBER})\s*)?(?:Y=?({NUMBER})\s*)?(?:Z=?({NUMBER})\s*)?(?:A=?({NUMBER})\s*)?(?:C=?({NUMBER})\s*)?(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?(?:F({NUMBER})\s*)?$"
)
_INDEXED_AXES = {"POS", "POSA", "AX"}
_MACHINE_AXES = {"X1", "Y1", "Z1", "A1", "B1", "C1"}
_ALIKE: tuple[set[float], ...] = (
    {0, 1, 2, 3, 331, 332}, {17, 18, 19}, {90, 91}, {93, 94, 95}, {70, 71, 700, 710}, {40, 41, 42}, {60, 64, 641, 642, 643, 644, 645, 646},
    {54, 55, 56, 57, 500, *range(505, 600)}, {601, 602, 603}, {450, 451},
)  # fmt: skip
"""G codes of one group: a block takes one of them."""
_SWITCH_WORDS = {"TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS"}
_VALUE_WORDS = {SINUMERIK_NAMES[n][1] for n in ("CR", "A3", "I1", "OVR")} - {SINUMERIK_NAMES["CIP"][1]}


def _plain_block(*letters: str) -> re.Pattern[str]:
    """A block of coordinates alone with the letters of a machine; its groups are in the order of the places."""
    pattern = _PLAIN
    for place, letter in zip("XYZAC", letters):
        pattern = pattern.replace(f"(?:{place}=?(", f"(?:@{letter}=?(")
    return re.compile(pattern.replace("(?:@", "(?:"), re.A)


WITHOUT_VALUE = frozenset(
    [
        "TRAFOOF",
        "ORIWKS",
        "ORIVECT",
        "ORIPLANE",
        "ORIMKS",
        "ORIAXES",
        "ORIEULER",
        "ORIRPY",
        "ORIVIRT1",
        "ORIRPY2",
        "FFWON",
        "FFWOF",
        "SOFT",
        "BRISK",
    ]
)
"""Names of modes: a value behind one would change nothing."""


class Sinumerik(SinumerikCalls):
    """Reads the blocks of one SINUMERIK program."""

    def __init__(self, path: Path, machine: Machine, units: list[Unit]) -> None:
        super().__init__(path, machine, units)
        self.flow = Flow(units[0], self)
        self.corners_meet = False
        self.plain_block = _plain_block(*self.out.kinematics.letters)
        self.set_frames()

    def run(self) -> Any:
        """All blocks; the moves stand in `out`."""
        self.flow.run()
        self._release()
        if self.comp is not None:
            self.compensate(0, 0.0, along_next=True)
        return self.out

    def fast(self, text: str, line: int) -> bool:
        """Take a plain block of coordinates; False if it must be read word by word."""
        if not self.plain or self.mcall is not None or self.held is not None or self.every_corner or self.override != 1.0:
            return False
        match = self.plain_block.match(text)
        if not match:
            return False
        number, g, x, y, z, a, c, i, j, k, f = match.groups()
        motion = self.motion if g is None else int(g)
        if motion not in (0, 1):
            return False
        out = self.out
        if i is not None and not out.modes.traori:
            return False
        if f is not None:
            self.feed = float(f)
        self.motion = motion
        if x is None and y is None and z is None and a is None and c is None and i is None:
            return True
        self.line, self.block = line, int(number) if number else -1
        position = out.position
        tilt, turn = self.plain_place(x, y, z, a, c)
        axis = None
        if i is not None:
            axis = (float(i), float(j), float(k))
            position[3] = position[4] = math.nan
        self._feed_given(mv.LINE if motion else mv.RAPID)
        self.tangent = None
        out.add(
            mv.LINE if motion else mv.RAPID, (position[0], position[1], position[2], tilt, turn), axis,
            self.feed if motion else math.inf, line, self.block,
        )  # fmt: skip
        return True

    def words(self, text: str) -> None:
        """One block."""
        body, number = self._body(text)
        if number >= 0:
            self.block = number
        try:
            self._block(split_words(body))
        except CycleError as error:
            raise WordError(str(error), 1) from None

    def _block(self, words: list[Word]) -> None:
        """Everything that stands in one block: first the modes, then the move."""
        block = Block()
        for word in words:
            name = self.slot_of.get(word.name, word.name)
            if word.assigned and (
                name in self.flow.frame.variables or name in self.globals or re.fullmatch(r"R\d*", name) or name[0] == "$"
            ):
                self._assignment(word)
            elif name == "G" and (word.value is not None or word.assigned):
                block.g.append((self._value(word) if word.index is None else self._of_group(word), word))
            elif name in INDEX or name in OTHER or name in _MACHINE_AXES or (name in _INDEXED_AXES and word.index):
                if word.index and name not in _INDEXED_AXES:
                    raise WordError(f"{name}[..] is no axis; write {name} and its place, or AX[..]", word.column)
                axis = name[0] if name not in _INDEXED_AXES else self._axis_of(word)
                axis = self.slot_of.get(axis, axis) if axis != name else axis
                if axis not in INDEX and axis not in OTHER:
                    raise WordError(f"{name}[{axis}]: this machine has {self.out.own_axes}", word.column)
                if axis in block.coordinates:
                    raise WordError(f"{axis} stands twice in the block; keep one", word.column)
                block.coordinates[axis] = self._item(word)
                if name.startswith("POS"):
                    self.note("POS, POSA: the axis moves with the others of the block, at rapid where it stands alone")
                    block.extra["POS"] = Item(1.0, "", word.column)
            elif name in ("I", "J", "K"):
                block.centre[name] = self._item(word)
            elif name in ("F", "S", "P") or (name in SINUMERIK_NAMES and SINUMERIK_NAMES[name][1] in _VALUE_WORDS):
                if name in block.extra:
                    raise WordError(f"{name} stands twice in the block; keep one", word.column)
                block.extra[name] = self._item(word)
            elif name == "M" and (word.value is not None or word.assigned):
                block.m.append(int(self._value(word)))
            elif name in ("T", "D", "H") and (word.value is not None or word.assigned):
                block.tool[name] = self._tool_value(word), word.column
            elif name == "L" and word.value is not None:
                block.calls.append(word)
            elif name == "S1" and word.assigned and "S" not in block.extra:
                block.extra["S"] = self._item(word)
            elif re.fullmatch(r"[SMHTD]\d+", name) and word.assigned:
                self.note(f"{name}=: a word of another spindle or tool, understood, without effect on the motion")
            elif name == "R":
                raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
            elif len(name) == 1:
                raise WordError(
                    f"word '{name}' is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
                )
            elif name in SINUMERIK_NAMES and not self._own_program(name):
                block.names.append(word)
            elif word.assigned:
                self._assignment(word)
            else:
                block.calls.append(word)
        self._carry_out(block)

    def _carry_out(self, block: Block) -> None:
        """What the words of a block do, in the order in which the control takes them."""
        numbers, extra, names, calls = block.numbers, block.extra, block.names, block.calls
        for number, word in block.g:
            entry = SINUMERIK_G.get(number)
            if entry is None:
                raise WordError(
                    f"G{number:g} is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
                )
            if entry[0] == REFUSED:
                raise WordError(f"G{number:g} is not supported: {entry[1]}", word.column)
            if entry[0] == NOTE:
                self.note(f"G{number:g}: {entry[1]}")
        for alike in _ALIKE:
            if len(numbers & alike) > 1:
                raise WordError("G" + " and G".join(f"{n:g}" for n in sorted(numbers & alike)) + " stand in one block; keep one", 1)
        if numbers & {25, 26}:
            block.coordinates.clear()
            extra.pop("S", None)
        if block.tool or 6 in block.m:
            if 6 in block.m:
                block.tool["M6"] = 6.0, 1
            self.tools.block(block.tool)
        if 4 in numbers:
            self._dwell(numbers, extra, bool(block.coordinates or block.centre or names or calls))
            return
        frame_word = next((w for w in names if w.name in _SWITCH_WORDS), None)
        shift = next((n for n in (58, 59) if n in numbers), None)
        suppress = bool(numbers & {53, 153}) or any(w.name == "SUPA" for w in names)
        vector = self._orientation(extra)
        self._settings(extra, numbers)
        modal_before = self.mcall
        moved_by_name = None
        for number, word in block.g:
            self._g(number, word)
        cycle = next((w for w in names if w.name.startswith("CYCLE8") and SINUMERIK_NAMES[w.name][0] == ACTS), None)
        if cycle is not None and any(w.name == "MCALL" for w in names):
            names = [w for w in names if w is not cycle]
        for word in names:
            if word.name in ("CIP", "CT"):
                moved_by_name = word.name
                self.motion = 2
            elif word.name not in _SWITCH_WORDS and word.name != "SUPA":
                self._name(word, calls, cycle)
        pause = self._m(block.m)
        if frame_word is not None or shift is not None:
            self._frame_words(frame_word, shift, block.coordinates, extra)
        elif numbers & {74, 75}:
            self._fixed_point(75 if 75 in numbers else 74, block.coordinates, extra)
        elif numbers & {110, 111, 112}:
            self._set_pole(next(n for n in (110, 111, 112) if n in numbers), block.coordinates, extra)
        else:
            feed = self.feed
            if "FB" in extra:
                self.set_feed(extra.pop("FB").value)
            self._motion(block, vector, suppress, moved_by_name)
            self.feed = feed if numbers.isdisjoint({331, 332}) else self.feed
            if block.coordinates and self.mcall is not None and self.mcall is modal_before:
                self.mcall()
        if 9 in numbers:
            self._release()
            self.stop(0.0)
        if pause is not None:
            self._release()
            self.stop(pause)
        times = int(extra.pop("P").value) if "P" in extra and calls else 1
        if extra:
            name, item = next(iter(extra.items()))
            raise WordError(f"{name} has no use in this block; remove it, or add what it belongs to", item.column)
        if len(calls) > 1:
            raise WordError(f"'{calls[1].name}' is a second call in the block; write it in the next one", calls[1].column)
        for word in calls:
            self._call(word, times)
        if 17 in block.m or any(w.name in ("RET", "ENDPROC") for w in names):
            self.flow.back("return")
        elif 2 in block.m or 30 in block.m:
            self.flow.ended = True

    def _settings(self, extra: dict[str, Item], numbers: set[float]) -> None:
        """F, S and the tolerances of the block."""
        for number in (93, 94, 95):
            if number in numbers:
                self.set_feed_mode(number)
        for number in (70, 71, 700, 710):
            if number in numbers:
                self.set_unit(INCH if number in (70, 700) else 1e-3, feed=number in (700, 710))
        if "F" in extra:
            item = extra.pop("F")
            self.set_feed(item.value, item.column)
        if "OVR" in extra:
            self.override = extra.pop("OVR").value / 100.0
            if not 0.0 < self.override <= 2.0:
                raise WordError(f"OVR={100 * self.override:g} is out of range; give 1 to 200 percent", 1)
        if "S" in extra:
            self.set_spindle(extra.pop("S").value)
        changed = False
        if "CTOL" in extra:
            value = extra.pop("CTOL").value
            self.tolerance = value * self.unit if value > 0 else DEFAULT_TOLERANCE
            changed = True
        if "OTOL" in extra:
            value = extra.pop("OTOL").value
            self.angle_tolerance = rad_from_deg(value) if value > 0 else DEFAULT_ANGLE_TOLERANCE
            changed = True
        for name in ("ADIS", "ADISPOS"):
            if name in extra:
                setattr(self, name.lower(), max(0.0, extra.pop(name).value) * self.unit)
                changed = True
        if changed:
            self.round_corners()

    def _g(self, number: float, word: Word) -> None:
        out = self.out
        if number in (0, 1, 2, 3):
            self.motion = int(number)
        elif number in (17, 18, 19):
            if self.comp is not None and self.plane != number:
                raise WordError("the plane changes inside G41 or G42; write G40 before", word.column)
            self._release()
            self.plane = int(number)
        elif number in (90, 91):
            self.absolute = number == 90
            self.settle_plain()
        elif number in (60, 64, 641, 642, 643, 644, 645, 646):
            self.rounding = int(number) if number in (60, 64, 641) else 642
            self.round_corners()
        elif number in (601, 602, 603):
            out.set_modes(replace(out.modes, stop_window=f"G{int(number)}"))
        elif number in (40, 41, 42):
            self._compensation(int(number), word)
        elif number in (450, 451):
            self.corners_meet = number == 451
        elif number == 500 or 54 <= number <= 57 or 505 <= number <= 599:
            self._release()
            self.chosen = f"G{int(number)}"
            self.set_frames()

    def _compensation(self, number: int, word: Word) -> None:
        self._release()
        if number == 40:
            self.compensate(0, 0.0, along_next=True)
            return
        radius = self.tools.radius(self.tools.name, word.column)
        self.compensate(1 if number == 41 else -1, radius, along_next=True, corners_meet=self.corners_meet)

    def _m(self, numbers: list[int]) -> float | None:
        pause = None
        for number in numbers:
            entry = SINUMERIK_M.get(number)
            if number in (0, 1, 6):
                self.note(f"M{number}: the program goes on after an exact stop")
                pause = 0.0
            elif number not in (2, 17, 30):
                self.note(f"M{number}: {entry[1] if entry else 'a code of the machine builder, without effect on the motion'}")
        return pause

    def _name(self, word: Word, calls: list[Word], cycle: Word | None) -> None:
        """Words without a number: transformation, feedforward, acceleration, messages, cycles."""
        name, out = word.name, self.out
        kind, meaning = SINUMERIK_NAMES[name]
        given = (word.text or "").strip()
        if kind == REFUSED:
            raise WordError(f"{name} is not supported: {meaning}", word.column)
        if kind == NOTE:
            if name == "FGROUP" and {t for t, _ in split_arguments(word.text or "")} - set(LINEAR) - {""}:
                self.note("FGROUP: the feed is that of the tool tip all the same")
            self.note(f"{name}: {meaning}")
        elif name in WITHOUT_VALUE and given:
            raise WordError(f"{name} takes no value; remove '{given[:20]}'", word.column)
        elif name in ("TRAORI", "TRAFOOF"):
            if given:
                self.note("TRAORI: its number is passed over; the transformation is that of the model")
            self._release()
            self._unswivel()
            self.transform(name == "TRAORI")
        elif name in ("ORIWKS", "ORIVECT", "ORIPLANE", "ORIMKS", "ORIAXES"):
            out.set_modes(replace(out.modes, workpiece_orientation=name not in ("ORIMKS", "ORIAXES")))
        elif name in ("ORIEULER", "ORIRPY", "ORIVIRT1", "ORIRPY2"):
            self.angles_are_rpy = {"ORIRPY": True, "ORIEULER": False}.get(name)
        elif name in ("FFWON", "FFWOF"):
            if out.feedforward is None:
                out.feedforward = "velocity+torque" if name == "FFWON" else "off"
            out.set_modes(replace(out.modes, feedforward=name == "FFWON"))
        elif name in ("SOFT", "BRISK"):
            out.set_modes(replace(out.modes, brisk=name == "BRISK"))
        elif name == "MSG":
            text = (word.text or "").strip()
            out.messages.append(text.strip('"') if text.count('"') <= 2 else text)
        elif name == "MCALL":
            self._release()
            self._modal(calls, cycle)
        elif name in ("CALL", "PCALL", "EXTCALL"):
            text = (word.text or "").strip()
            if not text and calls:
                if isinstance(held := (self._store_of(calls[0].name) or {}).get(()), str):
                    calls[0] = Word(plain_name(held), word.column)
                return
            calls.append(Word(plain_name(str(self._value_of(text, word.text_column))), word.column))
        elif name in ("RET", "ENDPROC"):
            self._release()
        elif meaning == SINUMERIK_NAMES["OFFN"][1]:
            if self._value(word):
                raise WordError(f"{name}={self._value(word):g} is not supported: {meaning}", word.column)
            self.note(f"{name}: {meaning}")
        elif name.startswith(("CYCLE", "HOLES")):
            self._release()
            cycles.carry_out(self, word)
        else:
            raise WordError(f"{name} needs a value, e.g. {name}=1", word.column)

    def _modal(self, calls: list[Word], cycle: Word | None) -> None:
        """MCALL: a cycle or subprogram behind each block that moves; alone it ends."""
        if cycle is not None:
            self.mcall = cycles.drilling(self, cycle.name, cycles.values_of(self, cycle), cycle)
            return
        if not calls:
            self.mcall = None
            return
        word = calls.pop(0)
        unit = self._find(word.name if word.name != "L" else f"L{word.value:g}")
        if unit is None:
            raise WordError(f"MCALL: there is no cycle or subprogram '{word.name}'; add {word.name}.SPF", word.column)
        variables, first = self._arguments(unit, [(t, c + word.text_column) for t, c in split_arguments(word.text or "")], word)

        def call() -> None:
            if frame := self.flow.call(unit, first, name=unit.name, column=word.column):
                frame.variables = {k: dict(v) for k, v in variables.items()}

        self.mcall = call
