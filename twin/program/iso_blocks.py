"""The reader of ISO programs (Fanuc and similar controls, LinuxCNC): lines, words, subprograms, and what it keeps from block to block.

Some words mean different things on LinuxCNC and Fanuc. `linuxcnc` selects the dialect: a file .ngc, or one with O-words or named
parameters. Where the dialects differ, a note gives the chosen meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.machine.machine import Machine
from twin.program.expressions import FANUC, ISO, NUMBER, Expression, Null, WordError, as_number, needed
from twin.program.flow import Call, Forms, Statement, statement_of
from twin.program.frames import AXES
from twin.program.iso_values import IsoValues
from twin.program.reader import ADD_CALL, NO_GROUP, Reader
from twin.program.source import Unit
from twin.program.state import Block, Item

ISO_FRAMES = ("system", "shift", "local", "mirror", "scale", "turn", "plane")
"""Zero offset, G92, G52, then G51.1, G51 and G68 in the order of a Fanuc, and G68.2."""
POLAR = ("@", "^")
"""Words of a radius and an angle (LinuxCNC)."""


_O = r"\s*(?:N[\d.]+\s*)?O\s*(?P<key><[^>]*>|\d+|\[.*?\]|#\d+|#<[^>]*>)\s*"
PROGRAM = re.compile(r"\s*[O:]\s*(?P<key>\d+|<[^>]*>)\s*$", re.A)
OWORD = re.compile(rf"{_O}(?P<kind>SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|BREAK|CONTINUE)\b\s*(?P<text>.*)$", re.A)
OWORDS: Forms = (
    ("", OWORD),
    ("times", re.compile(rf"{_O}REPEAT\b\s*(?P<text>.*)$", re.A)),
    ("endtimes", re.compile(rf"{_O}ENDREPEAT\b\s*(?P<text>.*)$", re.A)),
    ("program", PROGRAM),
)
_NUMBERED = re.compile(r"\s*N\s*(\d+)(?:\.\d*)?", re.A)
_N = r"\s*(?:N\s*\d+(?:\.\d*)?\s*)?"
FORMS: Forms = (
    ("goto", re.compile(rf"{_N}IF\s*(?P<text>\[.*\])\s*GO(?:TO)?\s*(?P<target>.+?)\s*$", re.A)),
    ("then", re.compile(rf"{_N}IF\s*(?P<text>\[.*\])\s*TH(?:EN)?\s*(?P<key>.+?)\s*$", re.A)),
    ("while", re.compile(rf"{_N}WH(?:ILE)?\s*(?P<text>\[.*\])\s*DO\s*(?P<key>\d+)\s*$", re.A)),
    ("loop", re.compile(rf"{_N}DO\s*(?P<key>\d+)\s*$", re.A)),
    ("endwhile", re.compile(rf"{_N}END?\s*(?P<key>\d+)\s*$", re.A)),
    ("goto", re.compile(rf"{_N}GO(?:TO)?\s*(?P<target>.+?)\s*$", re.A)),
    ("words_goto", re.compile(r"(?P<key>\s*(?:N\d+\s*)?#.*?=.*?[\d\]\s.])GO(?:TO)?\s*(?P<target>\d+|#.+|\[.+\])\s*$", re.A)),
)
_MAIN_BLOCK = re.compile(r"(\s*):(\d+)(?=\s*[A-Z])", re.A)
COMMENT = re.compile(r"\(([^()]*(?:\([^()]*\)[^()]*)*)\)?")
_LOG = re.compile(r"\s*(LOGOPEN|LOGAPPEND|LOGCLOSE|LOG|PROBEOPEN|PROBECLOSE|PY|ABORT)\b\s*,?", re.I)
LINUXCNC = re.compile(r"^\s*(?:N\d+\s*)?O[ \t]*(?:<[^>]*>|\d+[ \t]*(?:SUB|IF|WHILE|DO|REPEAT|CALL)\b)|#[ \t]*<", re.I | re.M)
_OUTPUT = re.compile(r"(?:N\d+\s*)?(?:[BD]P(?:RNT)?\s*\[|PO(?:PEN)?\b\s*$|PC(?:LOS)?\b\s*$)", re.A)
"""Commands of a macro that print to a file or an interface."""
MACRO = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26)))
"""Letter of G65 -> variable that it sets."""
MOST_REPEATS = 10_000


class Iso(Reader):
    """Reads the blocks of one ISO program."""

    values: IsoValues

    def __init__(self, path: Path, machine: Machine, unit: Unit, carry_out: Callable[[Iso, Block], None], *, linuxcnc: bool) -> None:
        super().__init__(path, machine, "linuxcnc" if linuxcnc else "iso", between_percents(unit), ISO_FRAMES)
        self.unit_read, self.linuxcnc, state, self.carry_out = self.flow.frame.unit, linuxcnc, self.state, partial(carry_out, self)
        state.motion, state.tools.modal_h = None, not linuxcnc
        self.mirrors: dict[int, float] = {}  # axis of G51.1 -> place of the mirror [m]
        self.cycle: int | None = None  # G73 to G89 in force
        self.sticky: dict[str, float] = {}  # words of the cycles
        self.given_absolute: dict[str, bool] = {}  # of the words in `sticky`: under G90
        self.initial = 0.0  # height where the cycles began [m]
        self.polar = False  # G16
        self.polar_place: tuple[float, float] | None = None  # radius and angle [deg] that G16 keeps
        self.any_motion = False  # a Fanuc takes coordinates before any G0 or G1 as rapid
        self.modal_macro: tuple[Unit, int, dict] | None = None  # G66
        self.edge: Item | None = None  # D, which a Fanuc keeps
        self.spline_arm = 0.0, 0.0  # P and Q of the last G5 [m]
        self.between: tuple[np.ndarray, tuple[float, float]] | None = None  # the point of G28 or G30; G29 returns through it
        self.parameter_lines = False  # behind G10 L50, up to G11
        self.main_seen = False
        self.grammar, self.values = ISO if linuxcnc else FANUC, IsoValues(state, self.flow)
        self.variable, self.hashed = self.values.variable, self.values.hashed
        self.offsets = self.values.offsets
        letters = "".join(rf"(?:{letter}({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        self.plain_block = re.compile(rf"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?{letters}{3 * NO_GROUP}(?:F({NUMBER})\s*)?;?\s*$", re.A)
        self.out.change(feed_of_all=not linuxcnc)
        counts = "all axes, a degree as a unit of length, as on a Fanuc; in .ngc files X Y Z alone"
        counts = "X Y Z alone, as on LinuxCNC" if linuxcnc else counts
        self.out.mixed_feed = f"F beside X Y Z with A or C: it counts {counts}"

    def expression(self, text: str, column: int = 1) -> Expression:
        if not self.linuxcnc and ("AND" in text or "OR" in text):
            self.state.note("AND, OR, XOR work on the bits of whole numbers, as on a Fanuc; in .ngc files they are logical")
        return super().expression(text, column)

    def runs_into(self, what: str, column: int) -> None:
        if self.main_seen and len(self.flow.frames) == 1 and self.linuxcnc:
            raise WordError(f"the program O.. runs on into {what}; end it with M2, M30 or %", column)

    def plain_now(self) -> bool:
        return self.cycle is None and not self.polar and self.modal_macro is None

    # ------------------------------------------------------------------ lines

    def clean(self, text: str) -> str:
        """The block in capitals without comments."""

        def comment(match: re.Match[str]) -> str:
            inner = match[1]
            if (log := _LOG.match(inner)) and log[1].upper() not in ("PY", "ABORT"):
                self.state.note(f"({log[1].upper()}): understood, no effect on the motion")
            elif log and "," in inner:
                raise WordError(f"({log[1].lower()},..) runs code of the control, which is not simulated; remove it", match.start() + 1)
            return " " * len(match[0])

        if "(" in text or ";" in text:
            head, semicolon, tail = text.partition(";")
            text = COMMENT.sub(comment, head)
            if semicolon and (log := _LOG.match(tail)) and log[1].upper() in ("PY",) and "," in tail[:6]:
                raise WordError(";py,.. runs code of the control, which is not simulated; remove it", len(head) + 1)
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith(":") and (main := _MAIN_BLOCK.match(text)):
            text = f"{main[1]}N{main[2]}{text[main.end() :]}"
        if stripped.startswith("%") or _OUTPUT.match(stripped):
            text = ""
        elif stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        return text

    def statement(self, text: str) -> Statement | None:
        """The statement of the flow in a line."""
        found = statement_of((*OWORDS, *FORMS), text)
        if found is None:
            return None
        target = found.target and (f"N{int(found.target)}" if found.target.isdigit() else f"={found.target}")
        key = {"then": found.key.rjust(len(text.rstrip())), "words_goto": found.key}.get(found.kind, plain_key(found.key))
        return replace(found, key=key, target=target)

    def labels_of(self, line: str) -> Iterator[str]:
        """Block number (N100), number of a program (O100) and name of a subprogram of O-words (SUB 100, SUB <name>) of a line."""
        text = line.upper()
        if match := _NUMBERED.match(text.lstrip("/ ")):
            yield f"N{int(match[1])}"
        if "O" in text or ":" in text:
            body = COMMENT.sub("", text.split(";")[0])
            if match := PROGRAM.match(body):
                yield f"O{plain_key(match['key'])}"
            elif (match := OWORD.match(body)) and match["kind"] == "SUB":
                yield f"SUB {plain_key(match['key'])}"

    # ------------------------------------------------------------------ words of a block

    def words(self, text: str) -> None:
        if self.parameter_lines:
            self.parameter_lines = "G11" not in text
        else:
            self.carry_out(self.words_of(text))

    def words_of(self, text: str) -> Block:
        """The words of a block; assigned variables are set after the block is read."""
        block, later = Block(), []
        g, m, words, e, fanuc = block.g, block.m, block.w, self.expression(text), not self.linuxcnc
        while char := e.peek():
            column = e.at + 1
            if char == "#":
                e.at += 1
                key = self.values.key(e)
                if e.peek() != "=":
                    raise e.fail("a variable without an assignment; give it a value with '='")
                e.at += 1
                later.append((key, as_number(e.value(), column), column))
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
            else:
                block.put(name, Item(float(value), "", column))
        for key, number, column in later:
            self.values.write(key, number, column)
        return block

    # ------------------------------------------------------------------ subprograms

    def other(self, s: Statement, frame: Call) -> None:
        """O-words of calls, program numbers, IF .. THEN."""
        if s.kind == "then":
            if self.number_of(s.text, s.column):
                self.words(s.key)
        elif s.kind == "words_goto":
            self.words(s.key)
            self.flow.jump_to(frame, s)
        elif s.kind == "program":  # the name of the program, or the start of the next one
            if frame.style == "m98" or (self.main_seen and len(self.flow.frames) == 1):
                raise WordError(f"the program runs on into O{s.key}; end it with M30 or M99 before")
            self.main_seen = self.main_seen or len(self.flow.frames) == 1
        elif s.kind == "call":
            self._call_oword(s)
        elif s.kind in ("return", "endsub"):
            if s.kind == "return" and len(self.flow.frames) == 1:
                raise WordError("RETURN is outside a subprogram; remove it", s.column)
            if frame.style == "m98":
                raise WordError("a subprogram called by M98 ends with M99, not with endsub", s.column)
            self.values.returned_value = (self.number_of(s.text, s.column), 1.0) if s.text.strip() else (0.0, 0.0)
            self.flow.back()
        else:
            raise WordError(f"O.. {s.kind} does not fit here; correct the O-words", s.column)

    def call_block(self, b: Block) -> bool:
        """M97 to M99, G65 and G66; True if the block is done."""
        codes = b.codes
        if codes & {65, 66}:
            p = b.need("P", "G65 and G66 need P, the number of the macro")
            times, variables = int(b.take("L", 1.0)), dict[Any, float]()
            for name, item in b.w.items():
                variables[needed(MACRO.get(name), f"{name} passes nothing to a macro", item.column)] = item.value
            place = self._program_place(int(p.value), p.column)
            if place is not None and 66 in codes:
                self.modal_macro = *place, variables
            elif place is not None:
                self.flow.call(*place, variables, f"O{p.value:g}", times=times, style="macro", column=p.column)
            return True
        if 67 in codes:
            self.modal_macro = None
        own = 97 in b.m
        if own or 98 in b.m or (198 in b.m and not self.linuxcnc):
            if own and self.linuxcnc:
                raise WordError("M97 is no word of LinuxCNC; use M98 and O")
            p, times = b.need("P", f"M{97 if own else 98} needs P, the number of the {'block' if own else 'subprogram'}"), 1
            number = int(p.value)
            if "L" in b.w or "K" in b.w:
                word = b.w.pop("L" if "L" in b.w else "K")
                times = int(word.value)
                if times != word.value:
                    raise WordError(f"M98 repeats {word.value:g} times; give a whole number", word.column)
            elif not self.linuxcnc and not own and number > 9999:
                times, number = divmod(number, 10000)
            if b.w or b.g:
                self.carry_out(Block(b.g, [n for n in b.m if n not in (97, 98, 198)], b.w))
            frame, missing = self.flow.frame, f"M97 P{number}: this program has no block N{number}; add it"
            if own:
                place = frame.unit, needed(self.flow.labels(frame.unit).get(f"N{number}"), missing, p.column)[0]
            else:
                place = self._program_place(number, p.column)
            if place is not None:
                self.flow.call(*place, frame.variables, f"{'N' if own else 'O'}{number}", times=times, style="m98", column=p.column)
            return True
        if 99 not in b.m:
            return False
        if len(self.flow.frames) == 1:
            self.state.note("M99 ends the main program here, which the control would run again without end")
            self.flow.ended = True
            return True
        if self.flow.frame.style not in ("m98", "macro"):
            raise WordError("M99 ends a subprogram that O.. sub began; end it with endsub")
        target = f"N{int(b.take('P'))}" if "P" in b.w else ""
        if b.w:
            self.carry_out(Block(b.g, [n for n in b.m if n != 99], b.w))
        self.flow.back(target)
        return True

    def _program_place(self, number: int, column: int) -> tuple[Unit, int] | None:
        """Unit and line of program O.., in this file or in the folder; None if the machine file lists it as a call without motion."""
        units = dict.fromkeys((self.flow.frame.unit, self.unit_read))
        for unit in units:
            if lines := self.flow.labels(unit).get(f"O{number}"):
                return unit, lines[0] + 1
        if any(f"SUB {number}" in self.flow.labels(unit) for unit in units):
            raise WordError(f"O{number} is a subprogram 'O{number} sub' and is called by 'O{number} call', not by M98", column)
        beside = self.folder.find(f"O{number:04d}", f"O{number}", f"{number:04d}", str(number))
        if beside is None:
            if self.moves_nothing(f"O{number}", f"O{number:04d}"):
                return None
            raise WordError(f"subprogram O{number} is neither in this file nor beside it (O{number:04d}.nc); {ADD_CALL}", column)
        beside = between_percents(beside)
        return beside, next((lines[0] + 1 for name, lines in self.flow.labels(beside).items() if name.startswith("O")), 0)

    def _call_oword(self, s: Statement) -> None:
        """O.. call with its arguments in brackets."""
        name = str(int(self.number_of(s.key, s.column))) if s.key.startswith(("[", "#")) else s.key
        e, arguments = self.expression(s.text, s.column), dict[int, float]()
        while e.peek():
            if e.peek() != "[" or len(arguments) == 30:
                raise e.fail("a call takes up to 30 arguments in brackets, e.g. O100 call [1] [2]")
            arguments[len(arguments) + 1] = as_number(e.atom(), e.column + e.at)
        calling, found, at = self.flow.frame, None, None
        for unit in dict.fromkeys((calling.unit, self.unit_read)):
            at = self.flow.labels(unit).get(f"SUB {name}", [None])[0]
            if at is not None and not (name.isdigit() and unit is not self.unit_read and at > calling.at):
                found = unit  # a numbered subprogram of another file must stand before its call
                break
        else:
            found = self.folder.find(name.strip("<>"))
            at = None if found is None else self.flow.labels(found).get(f"SUB {name}", [None])[0]
        if found is None or at is None:
            fanuc = f"O{name}" in self.flow.labels(self.unit_read)
            where = f"subprogram O{name.lower()} is neither in this file nor beside it; add it"
            raise WordError(f"O{name} is called by M98 P{name}" if fanuc else where, s.column)
        if self.flow.table(found).get(at, (at,))[0] < 0:
            raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
        self.values.returned_value = (0.0, 0.0)
        self.flow.call(found, at + 1, arguments, name, style="oword", column=s.column)


def between_percents(unit: Unit) -> Unit:
    """A program between two lines % ends at the second."""
    marks = [i for i, line in enumerate(unit.lines) if line.strip().startswith("%")]
    first = next((i for i, line in enumerate(unit.lines) if line.strip()), 0)
    if len(marks) >= 2 and marks[0] == first:
        return replace(unit, lines=[*unit.lines[: marks[1]], "M2"])
    return unit


def plain_key(key: str) -> str:
    return str(int(key)) if key.isdigit() else key.replace(" ", "")
