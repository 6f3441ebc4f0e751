"""ISO programs: Fanuc and the many controls like it, LinuxCNC. The words of a block and what they do; expressions, O-words, macros.

LinuxCNC and Fanuc write the same letters and mean some of them differently; `linuxcnc` says which is read (a file .ngc, or
one with O-words or named parameters). Where they differ the note says what was taken.
"""

from __future__ import annotations

from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program.control import INCH, INDEX, LINEAR, OTHER, ROTARY, Control, Item, rotation
from twin.program.cycles import FEED, RAPID, CycleError, Drilling
from twin.program.expressions import ISO, Expression, Null, WordError
from twin.program.flow import Flow, Frame, Statement
from twin.program.source import Folder, Unit
from twin.program.tables import ISO_G, ISO_M, NOTE, REFUSED

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_PLAIN = re.compile(
    r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?" + "".join(rf"(?:{axis}({NUMBER})\s*)?" for axis in "XYZAC") + rf"(?:F({NUMBER})\s*)?;?\s*$",
    re.A,
)
_OWORD = re.compile(
    r"\s*(?:N[\d.]+\s*)?O\s*(<[^>]*>|\d+|\[.*?\]|#\d+|#<[^>]*>)\s*"
    r"(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|CONTINUE)\b\s*(.*)$",
    re.A,
)
_PROGRAM = re.compile(r"\s*[O:]\s*(\d+|<[^>]*>)\s*$", re.A)
_NUMBERED = re.compile(r"\s*N\s*(\d+)(?:\.\d*)?", re.A)
_IF = re.compile(r"\s*IF\s*(\[.*\])\s*(?:GOTO\s*(.+?)|THEN\s*(.+?))\s*$", re.A)
_WHILE = re.compile(r"\s*WHILE\s*(\[.*\])\s*DO\s*(\d+)\s*$", re.A)
_DO = re.compile(r"\s*(DO|END)\s*(\d+)\s*$", re.A)
_GOTO = re.compile(r"\s*GOTO\s*(.+?)\s*$", re.A)
_COMMENT = re.compile(r"\(([^()]*(?:\([^()]*\)[^()]*)*)\)?")
_ACTIVE = re.compile(r"\s*(DEBUG|PRINT|MSG)\s*,(.*)$", re.S | re.I)
_LOG = re.compile(r"\s*(LOGOPEN|LOGAPPEND|LOGCLOSE|LOG|PROBEOPEN|PROBECLOSE|PY|ABORT)\b\s*,?", re.I)
_IN_MESSAGE = re.compile(r"%[df]|%\.(\d)f|#(<[^>]*>|\d+)")
LINUXCNC = re.compile(r"^\s*(?:N\d+\s*)?O\s*(?:<[^>]*>|\d+\s*(?:SUB|IF|WHILE|DO|REPEAT|CALL)\b)|#\s*<", re.I | re.M)
MACRO = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26)))
"""Letter of G65 -> variable that it sets."""
_CYCLES = {73, 74, 81, 82, 83, 84, 85, 86, 89}
_SEPARATOR = "\x01"
MOST_REPEATS = 10_000


class Iso(Control):
    """Reads the blocks of one ISO program."""

    iso = True

    def __init__(self, path: Path, machine: Machine, unit: Unit, *, linuxcnc: bool):
        super().__init__(path, machine)
        self.linuxcnc = linuxcnc
        self.unit_read = _between_percents(unit)
        self.folder = Folder(path)
        self.motion = None if linuxcnc else 1
        self.numbers: dict[int, float] = {}
        self.names: dict[str, float] = {}
        self.flow = Flow(self.unit_read, self)
        self.systems = {n: self.frame_table(_system_name(n)) for n in range(1, 10)}
        self.turned = dict.fromkeys(range(1, 10), 0.0)  # deg, by system
        self.system = 1
        self.shift = np.zeros(5)  # G92 (LinuxCNC: also G52)
        self.shift_kept, self.shift_on = np.zeros(5), False
        self.local = np.zeros(5)  # G52 of Fanuc
        self.plane_matrix, self.plane_offset = np.eye(3), np.zeros(3)  # G68, G51, G51.1
        self.cycle: dict[str, Any] | None = None
        self.sticky: dict[str, float] = {}
        self.initial = 0.0  # height at which the cycles began [m]
        self.retract_to_start = True  # G98
        self.polar = self.with_m19 = False
        self.home = {28: self.frame_table("G28"), 30: self.frame_table("G30")}
        self.modal_macro: tuple[Unit, int, dict] | None = None
        self.stored_modes: list[tuple] = []
        self.returned_value = (0.0, 0.0)
        self.main_seen = False
        self.set_frames()

    # ------------------------------------------------------------------ lines

    def run(self) -> Any:
        """All blocks; the moves stand in `out`."""
        self.flow.run()
        if self.comp is not None:
            self.compensate(0, 0.0, along_next=False)
        return self.out

    def clean(self, text: str) -> str:
        """The block in capitals without comments; what a comment prints stands behind a separator."""
        messages: list[str] = []

        def comment(match: re.Match[str]) -> str:
            inner = match[1]
            if active := _ACTIVE.match(inner):
                messages.append(f"{active[1].upper()},{active[2]}")
            elif (log := _LOG.match(inner)) and log[1].upper() not in ("PY", "ABORT"):
                self.note(f"({log[1].upper()}): understood, without effect on the motion")
            elif log and "," in inner:
                raise WordError(f"({log[1].lower()},..) runs code of the control, which is not simulated; remove it", match.start() + 1)
            return " " * len(match[0])

        if "(" in text or ";" in text:
            head, semicolon, tail = text.partition(";")
            text = _COMMENT.sub(comment, head)
            if semicolon and (log := _LOG.match(tail)) and log[1].upper() in ("PY",) and "," in tail[:6]:
                raise WordError(";py,.. runs code of the control, which is not simulated; remove it", len(head) + 1)
            if semicolon and (active := _ACTIVE.match(tail)):
                messages.append(f"{active[1].upper()},{active[2]}")
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith("%"):
            text = ""
        elif stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        return text + "".join(_SEPARATOR + m for m in messages)

    def statement(self, text: str) -> Statement | None:
        """What the flow must know of a line."""
        body = text.split(_SEPARATOR)[0]
        if match := _OWORD.match(body):
            return _oword(match)
        if match := _PROGRAM.match(body):
            return Statement("program", match[1].lstrip("0") or "0")
        if _SEPARATOR in text:
            return None
        number = _NUMBERED.match(body)
        start = number.end() if number and re.match(r"\s*(IF|WHILE|DO|END|GOTO)\b|\s*(DO|END|GOTO)\s*\d", body[number.end() :]) else 0
        rest = " " * start + body[start:]
        if match := _IF.match(rest):
            if match[2]:
                return Statement("goto", column=match.start(1) + 1, rest=(match[1], "", self._target(match[2])))
            return Statement("then", match[3], match[1], match.start(1) + 1, (match.start(3),))
        if match := _WHILE.match(rest):
            return Statement("while", f"DO{match[2]}", match[1], match.start(1) + 1)
        if match := _DO.match(rest):
            return Statement("loop" if match[1] == "DO" else "endwhile", f"DO{match[2]}")
        if match := _GOTO.match(rest):
            return Statement("goto", column=match.start(1) + 1, rest=("", "", self._target(match[1])))
        return None

    @staticmethod
    def _target(text: str) -> str:
        return f"N{int(text)}" if text.isdigit() else f"={text}"

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines by block number, N100."""
        found: dict[str, list[int]] = {}
        for i, line in enumerate(unit.lines):
            if match := _NUMBERED.match(line.upper().lstrip("/ ")):
                found.setdefault(f"N{int(match[1])}", []).append(i)
        return found

    def other(self, s: Statement, frame: Frame) -> None:
        """O-words of calls, program numbers, IF .. THEN."""
        if s.kind == "then":
            if self.number_of(s.text, s.column):
                self.words(" " * s.rest[0] + s.key)
        elif s.kind == "program":
            self._program(s, frame)
        elif s.kind == "call":
            self._call_oword(s)
        elif s.kind in ("return", "endsub"):
            if s.kind == "return" and len(self.flow.frames) == 1:
                raise WordError("RETURN stands in no subprogram; remove it", s.column)
            self._back(s)
        else:
            raise WordError(f"O.. {s.kind} does not fit here; correct the O-words", s.column)

    def _program(self, s: Statement, frame: Frame) -> None:
        """A line O1234: the name of the program, or the start of the next one."""
        if frame.style == "m98" or (self.main_seen and len(self.flow.frames) == 1):
            raise WordError(f"the program runs on into O{s.key}; end it with M30 or M99 before", 1)
        if len(self.flow.frames) == 1:
            self.main_seen = True

    def words(self, text: str) -> None:
        """One block."""
        body, *messages = text.split(_SEPARATOR)
        if body.strip():
            try:
                self.execute(*self.parse(body))
            except CycleError as error:
                raise WordError(str(error), 1) from None
        for message in messages:
            self._message(message)

    def _message(self, text: str) -> None:
        kind, _, rest = text.partition(",")

        def value(match: re.Match[str]) -> str:
            if not match[2]:
                self.places = {"%d": 0, "%f": 4}.get(match[0], int(match[1] or 6))
                return ""
            try:
                number = self.number_of("#" + match[2].upper(), 1)
            except WordError:
                return "######"
            return f"{number:.{self.places}f}"

        self.places = 6
        self.out.messages.append(rest if kind == "MSG" else _IN_MESSAGE.sub(value, rest))

    # ------------------------------------------------------------------ expressions

    def number_of(self, text: str, column: int) -> float:
        """The value of an expression."""
        expression = self._expression(text, 0, column)
        value = expression.whole()
        if isinstance(value, str):
            raise WordError("a number is needed here", column)
        return value

    def _expression(self, text: str, at: int, column: int = 1) -> Expression:
        return Expression(text, ISO, self._named, self._hash, at, column)

    def _named(self, expression: Expression, name: str, at: int) -> float:
        if name.startswith("EXISTS") and expression.peek() == "[":
            expression.at += 1
            if expression.peek() != "#":
                raise expression.fail("EXISTS[..] needs a parameter, e.g. EXISTS[#<depth>]")
            expression.at += 1
            key = self._key(expression)
            if expression.peek() != "]":
                raise expression.fail("bracket of EXISTS is not closed")
            expression.at += 1
            try:
                value = self._read(key, at)
                return float(self.linuxcnc or not isinstance(value, Null))
            except WordError:
                return 0.0
        raise expression.fail(f"'{name}' is no value; a number, #variable or [expression] is needed", at)

    def _key(self, expression: Expression) -> int | str:
        """The parameter behind a #: its number or name."""
        if expression.peek() == "<":
            end = expression.text.find(">", expression.at)
            if end < 0:
                raise expression.fail("the name of a parameter is not closed with '>'")
            name = expression.text[expression.at + 1 : end].replace(" ", "")
            expression.at = end + 1
            return name
        at = expression.at
        number = expression.atom()
        if isinstance(number, str) or number != int(number) or number < 0:
            raise expression.fail("the number of a variable is a whole number from 0", at)
        return int(number)

    def _hash(self, expression: Expression, at: int) -> float:
        value = self._read(self._key(expression), expression.column + at)
        if self.reads is not None:
            self.reads.append(value)
        return value

    def _read(self, key: int | str, column: int) -> float:
        frame = self.flow.frame
        if isinstance(key, str):
            if key in frame.variables:
                return frame.variables[key]
            if key in self.names:
                return self.names[key]
            if (value := self._predefined(key)) is not None:
                return value
            raise WordError(f"parameter #<{key.lower()}> has no value; set it before, or pass it to the program", column)
        if key == 0:
            return Null(0.0)
        if key <= 33:
            return frame.variables.get(key, Null(0.0))
        if (value := self._system_value(key)) is not None:
            return value
        if key in self.numbers:
            return self.numbers[key]
        if self.linuxcnc and key > 5602:
            raise WordError(f"parameter #{key} is out of range, 5602 is the last", column)
        if not self.linuxcnc and key >= 1000:
            raise WordError(f"system variable #{key} has no value here; set it in the program or remove it", column)
        return Null(0.0)

    def assign(self, name: str, value: float, column: int) -> None:
        """Not needed: ISO has no FOR."""
        raise NotImplementedError

    def _write(self, key: int | str, value: float, column: int) -> None:
        frame = self.flow.frame
        if isinstance(key, str):
            if key.startswith(("_INI[", "_HAL[")) or (self._predefined(key) is not None and key not in frame.variables):
                raise WordError(f"#<{key.lower()}> belongs to the control; choose another name", column)
            (self.names if key.startswith("_") else frame.variables)[key] = value
        elif key == 0 or (self.linuxcnc and key > 5602):
            raise WordError(f"#{key} cannot be set", column)
        elif key == 3000 and not self.linuxcnc:
            raise WordError("the program stops itself with an alarm (#3000); correct what it asks for", column)
        elif key <= 33 if not self.linuxcnc else key <= 30:
            frame.variables[key] = value
        elif self.linuxcnc and (5420 <= key <= 5428 or 5400 <= key <= 5413):
            raise WordError(f"#{key} belongs to the control and cannot be set", column)
        elif 5221 <= key <= 5390 and (n := (key - 5201) // 20) in self.systems and (k := (key - 5201) % 20) <= 10:
            self._write_system(n, k, value)
        else:
            self.numbers[key] = value

    def _write_system(self, n: int, k: int, value: float) -> None:
        """A zero offset by its parameter, #5221 and on."""
        if k == 10:
            self.turned[n] = value
        elif 1 <= k <= 6 and "XYZABC"[k - 1] in INDEX:
            name = "XYZABC"[k - 1]
            self.systems[n] = self.systems[n].copy()
            self.systems[n][INDEX[name]] = math.radians(value) if name in ROTARY else value * 1e-3
        elif value:
            raise WordError("an offset of B U V W cannot be set on this machine", 1)
        if n == self.system:
            self.set_frames()

    def _own(self, values: np.ndarray, k: int) -> float:
        """Component k (1 to 9: X Y Z A B C U V W) in the unit of the program."""
        if not 1 <= k <= 9 or "XYZABCUVW"[k - 1] not in INDEX:
            return 0.0
        name = "XYZABCUVW"[k - 1]
        value = float(values[INDEX[name]])
        return math.degrees(value) if name in ROTARY else value / self.unit

    def _place(self) -> np.ndarray:
        """Program coordinates (5,)."""
        angles = self.out.settle() if any(map(math.isnan, self.out.position[3:])) else np.array(self.out.position[3:])
        return np.concatenate([self.here(), angles - np.array(self.offset[3:])])

    def _system_value(self, key: int) -> float | None:
        fanuc = not self.linuxcnc
        if 5420 <= key < 5429 or (fanuc and (5001 <= key <= 5006 or 5041 <= key <= 5046)):
            k = key - 5419 if key >= 5420 else key - (5000 if key < 5040 else 5040)
            name = "XYZABCUVW"[k - 1]
            if name in OTHER:
                return math.degrees(self.other_axes[name]) if name == "B" else self.other_axes[name] / self.unit
            return self._own(self._place(), k)
        if self.linuxcnc and 5440 <= key < 5449:
            return self._own(np.array([*self.out.position[:3], *self.out.settle()]), key - 5439)
        if 5021 <= key <= 5029:
            return self._own(np.array(self.out.position), key - 5020)
        if key == 5210:
            return float(self.shift_on)
        if 5211 <= key <= 5219:
            factor = self.unit / 1e-3 if key - 5210 not in (4, 5, 6) else 1.0  # stored in mm
            return self._own(self.shift if self.shift_on else self.shift_kept, key - 5210) * factor + 0.0
        if key == 5220:
            return float(self.system)
        if 5221 <= key <= 5390 and (n := (key - 5201) // 20) in self.systems and (k := (key - 5201) % 20) <= 10:
            if k == 10:
                return self.turned[n]
            return self._own(self.systems[n], k) * (self.unit / 1e-3 if k not in (4, 5, 6) else 1.0)
        if 5161 <= key <= 5169 or 5181 <= key <= 5189:
            base = 28 if key < 5180 else 30
            return self._own(self.home[base], key - (5160 if base == 28 else 5180)) * (self.unit / 1e-3)
        if key == 5400 and self.linuxcnc:
            return float(self.tools.name) if self.tools.name.isdigit() else 0.0
        return None

    def _predefined(self, name: str) -> float | None:
        place = {"_X": 1, "_Y": 2, "_Z": 3, "_A": 4, "_B": 5, "_C": 6, "_U": 7, "_V": 8, "_W": 9}
        if name in place:
            return self._system_value(5419 + place[name])
        if name in ("_ABS_X", "_ABS_Y", "_ABS_Z", "_ABS_A", "_ABS_C"):
            return self._own(np.array(self.out.position), place[name[4:]])
        values = {
            "_VALUE": lambda: self.returned_value[0], "_VALUE_RETURNED": lambda: self.returned_value[1],
            "_LINE": lambda: float(self.line), "_METRIC": lambda: float(self.unit == 1e-3), "_IMPERIAL": lambda: float(self.unit != 1e-3),
            "_ABSOLUTE": lambda: float(self.absolute), "_INCREMENTAL": lambda: float(not self.absolute),
            "_FEED": lambda: 0.0 if math.isnan(self.feed) else self.feed, "_RPM": lambda: self.out.modes.spindle,
            "_CCOMP": lambda: float(self.comp is not None), "_PLANE": lambda: self.plane * 10.0, "_COORD_SYSTEM": lambda: _system_number(self.system),
            "_TASK": lambda: 0.0, "_CURRENT_TOOL": lambda: float(self.tools.name) if self.tools.name.isdigit() else 0.0,
            "_CALL_LEVEL": lambda: float(len(self.flow.frames) - 1), "_REMAP_LEVEL": lambda: 0.0,
        }  # fmt: skip
        return values[name]() if name in values else None

    # ------------------------------------------------------------------ words of a block

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
            elif name in words:
                raise WordError(f"{name} stands twice in the block; keep one", column)
            else:
                words[name] = Item(float(value), "", column)
        for key, value, column in later:
            self._write(key, value, column)
        return g, m, words

    def fast(self, text: str, line: int) -> bool:
        """Take a plain block of coordinates; False if it must be read word by word."""
        if not self.plain or self.cycle is not None or self.polar or self.modal_macro is not None:
            return False
        match = _PLAIN.match(text)
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
        position, frame, unit = out.position, self.offset, self.unit
        if x is not None:
            position[0] = float(x) * unit + frame[0]
        if y is not None:
            position[1] = float(y) * unit + frame[1]
        if z is not None:
            position[2] = float(z) * unit + frame[2]
        tilt = turn = math.nan
        if a is not None:
            position[3] = tilt = math.radians(float(a)) + frame[3]
        if c is not None:
            position[4] = turn = math.radians(float(c)) + frame[4]
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

    def _no_feed(self) -> None:
        raise WordError("the feed is 0; give F a number above 0", 1)

    def execute(self, g: list[tuple[float, int]], m: list[tuple[float, int]], words: dict[str, Item]) -> None:
        """The words of a block in the order in which the control takes them; what nothing has used is an error."""
        g = [self._known_g(number, column) for number, column in g]
        m_codes = [self._known_m(number, column) for number, column in m]
        self.with_m19 = 19 in m_codes
        w = dict(words)
        codes = {number for number, _ in g}
        if self._calls(codes, m_codes, w):
            return
        self._feed_and_tool(codes, g, m_codes, w)
        motion = next((n for n, _ in g if n in (0, 1, 2, 3) or n in _CYCLES), None)
        plane_before = self.plane
        modal = False
        for number, column in g:
            if number not in (0, 1, 2, 3, 53, 28, 30) and number not in _CYCLES:
                modal = self._g(number, column, w, codes) or modal
        if self.plane != plane_before and self.comp is not None:
            raise WordError("the plane changes inside G41 or G42; write G40 before", 1)
        if motion is not None and motion in _CYCLES:
            if self.cycle is None:
                self.sticky = {}
                self.initial = float(self.here()[arcs.PLANES[self.plane][2]])
            self.cycle = {"g": int(motion)}
        elif motion is not None:
            self.cycle, self.motion = None, int(motion)
        pause = self._m_before(m_codes, w)
        self._move_words(codes, w)
        if 9 in codes:
            self.stop(0.0)
        if pause is not None:
            self.stop(pause)
        if w:
            name, item = next(iter(w.items()))
            raise WordError(f"{name} has no use in this block; remove it, or add the G or M code that it belongs to", item.column)
        self._m_after(m_codes)

    def _known_g(self, number: float, column: int) -> tuple[float, int]:
        entry = ISO_G.get(number)
        if number == 76 and self.linuxcnc:
            entry = (REFUSED, "threading is not simulated")
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

    # ------------------------------------------------------------------ calls

    def _calls(self, codes: set[float], m: list[int], w: dict[str, Item]) -> bool:
        """M98, M99, G65 and G66; True if the block is done."""
        if 65 in codes or 66 in codes:
            self._macro(w, modal=66 in codes)
            return True
        if 67 in codes:
            self.modal_macro = None
        if 98 in m:
            if "P" not in w:
                raise WordError("M98 needs P, the number of the subprogram", 1)
            p, times = w.pop("P"), 1
            number = int(p.value)
            if "L" in w or "K" in w:
                times = int(w.pop("L" if "L" in w else "K").value)
            elif not self.linuxcnc and number > 9999:
                times, number = divmod(number, 10000)
            if w or codes:
                self.execute([(c, 1) for c in sorted(codes)], [(float(n), 1) for n in m if n != 98], w)
            if times > MOST_REPEATS:
                raise WordError(f"M98 repeats more than {MOST_REPEATS} times", p.column)
            unit, at = self._program_place(number, p.column)
            self.flow.call(unit, at, times=times, name=f"O{number}", style="m98", shared=True, column=p.column)
            return True
        if 99 in m:
            frame = self.flow.frame
            if len(self.flow.frames) == 1:
                self.note("M99 ends the main program here, which the control would run again without end")
                self.flow.ended = True
                return True
            if frame.style not in ("m98", "macro"):
                raise WordError("M99 ends a subprogram that O.. sub began; end it with endsub", 1)
            target = f"N{int(w.pop('P').value)}" if "P" in w else ""
            if w:
                self.execute([(c, 1) for c in sorted(codes)], [(float(n), 1) for n in m if n != 99], w)
            self.flow.back("return", target)
            return True
        return False

    def _program_place(self, number: int, column: int) -> tuple[Unit, int]:
        """Where program O.. begins: in this file, or in a file of the folder."""
        wrong = False
        for unit in dict.fromkeys((self.flow.frame.unit, self.unit_read)):
            for at, line in enumerate(unit.lines):
                body = _COMMENT.sub("", line.split(";")[0]).upper()
                if "O" not in body and ":" not in body:
                    continue
                match = _PROGRAM.match(body)
                if match and match[1].isdigit() and int(match[1]) == number:
                    return unit, at + 1
                oword = _OWORD.match(body)
                wrong = wrong or bool(oword and oword[2] == "SUB" and oword[1].isdigit() and int(oword[1]) == number)
        if wrong:
            raise WordError(f"O{number} is a subprogram 'O{number} sub' and is called by 'O{number} call', not by M98", column)
        unit = self.folder.find(f"O{number:04d}", f"O{number}", f"{number:04d}", str(number))  # type: ignore[assignment]
        if unit is None:
            raise WordError(f"subprogram O{number} is neither in this file nor beside it (O{number:04d}.nc); add it", column)
        unit = _between_percents(unit)
        at = next((i + 1 for i, line in enumerate(unit.lines) if _PROGRAM.match(_COMMENT.sub("", line).upper())), 0)
        return unit, at

    def _macro(self, w: dict[str, Item], *, modal: bool) -> None:
        if "P" not in w:
            raise WordError("G65 and G66 need P, the number of the macro", 1)
        p = w.pop("P")
        times = int(w.pop("L").value) if "L" in w else 1
        variables: dict[Any, float] = {}
        for name, item in w.items():
            if name not in MACRO:
                raise WordError(f"{name} passes nothing to a macro", item.column)
            variables[MACRO[name]] = item.value
        unit, at = self._program_place(int(p.value), p.column)
        if modal:
            self.modal_macro = unit, at, variables
            return
        if frame := self.flow.call(unit, at, times=min(times, MOST_REPEATS), name=f"O{p.value:g}", style="macro", column=p.column):
            frame.variables = dict(variables)

    def _call_oword(self, s: Statement) -> None:
        name = self._oword_name(s.key, s.column)
        arguments = {}
        e = self._expression(s.text, 0, s.column)
        k = 0
        while e.peek():
            k += 1
            if e.peek() != "[" or k > 30:
                raise e.fail("a call takes up to 30 arguments in brackets, e.g. O100 call [1] [2]")
            arguments[k] = float(e.atom())
        calling = self.flow.frame
        for unit in dict.fromkeys((calling.unit, self.unit_read)):
            at = _subs(unit).get(name)
            if at is not None and name.isdigit() and unit is not self.unit_read and at > calling.at:
                at = None  # a numbered subprogram of another file must stand before its call
            if at is not None:
                break
        else:
            unit = self.folder.find(name.strip("<>"))  # type: ignore[assignment]
            at = None if unit is None else _subs(unit).get(name)
        if unit is None or at is None:
            fanuc = any((p := _PROGRAM.match(_COMMENT.sub("", line).upper())) and p[1] == name for line in self.unit_read.lines)
            text = (
                f"O{name} is called by M98 P{name}"
                if fanuc
                else f"subprogram O{name.lower()} is neither in this file nor beside it; add it"
            )
            raise WordError(text, s.column)
        partners = self.flow._table(unit).get(at, (at,))
        if partners[0] < 0:
            raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
        self.returned_value = (0.0, 0.0)
        if frame := self.flow.call(unit, at + 1, name=name, style="oword", column=s.column):
            frame.variables = arguments

    def _oword_name(self, key: str, column: int) -> str:
        if key.startswith(("[", "#")):
            return str(int(self.number_of(key, column)))
        return key

    def _back(self, s: Statement) -> None:
        frame = self.flow.frame
        if frame.style == "m98":
            raise WordError("a subprogram called by M98 ends with M99, not with endsub", s.column)
        self.returned_value = (self.number_of(s.text, s.column), 1.0) if s.text.strip() else (0.0, 0.0)
        self.flow.back("return")

    def returned(self, frame: Frame) -> None:
        """The end of a subprogram: values stay, modes too."""

    def runs_into(self, what: str, column: int) -> None:
        """The main program reaches a subprogram or the end of the file; one with a name O.. must have ended before."""
        if self.main_seen and len(self.flow.frames) == 1 and self.linuxcnc:
            raise WordError(f"the program O.. runs on into {what}; end it with M2, M30 or %", column)

    # ------------------------------------------------------------------ frames

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

    def _named_offsets(self, w: dict[str, Item]) -> dict[int, float]:
        found = {}
        for name in (*LINEAR, *ROTARY):
            if name in w:
                found[INDEX[name]] = self.si(name, w.pop(name).value)
        for name in OTHER:
            if name in w and w.pop(name).value:
                raise WordError(f"an offset of {name} cannot be set on this machine", 1)
        return found

    def _g10(self, w: dict[str, Item], column: int) -> None:
        what = int(w.pop("L").value) if "L" in w else 2
        if what not in (2, 20):
            raise WordError(f"G10 L{what} is not supported: it writes the tool table; give [tool] in the machine file", column)
        number = int(w.pop("P").value) if "P" in w else 0
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
                new[i] = value
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

    # ------------------------------------------------------------------ modes

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
            if name in w and (name == "T" or codes & {43, 43.1, 43.4, 43.5, 44}):
                item = w.pop(name)
                tool[name] = item.value, item.column
        if "H" in w and not codes & {10}:
            tool["H"] = w["H"].value, w.pop("H").column
        if 6 in m:
            tool["M6"] = 6.0, 1
        if codes & {43, 43.4, 43.5}:
            tool["G43"] = 43.0, 1
        if 49 in codes:
            tool["G49"] = 49.0, 1
            if self.swivelled is None:
                self.transform(False)
        if tool:
            self.tools.block(tool)
        if codes & {43.4, 43.5}:
            self.transform(True)
        if "E" in w and not codes & {76, 33}:
            raise WordError("E has no use in this block; remove it", w["E"].column)

    def _g(self, number: float, column: int, w: dict[str, Item], codes: set[float]) -> bool:
        """A G code that is no motion."""
        kind, meaning = ISO_G[number]
        if kind == NOTE:
            self.note(f"G{number:g}: {meaning}")
            for name in ("P", "Q", "R") if number in (5.1, 8, 5, 61.2, 187) else ():
                w.pop(name, None)
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
        elif number in (54, 55, 56, 57, 58, 59, 59.1, 59.2, 59.3, 54.1):
            self._choose_system(number, w, column)
        elif number == 10:
            self._g10(w, column)
        elif number == 11:
            pass
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
        elif number in (68, 51, 51.1, 50, 50.1):
            self._turn_plane(number, w, column)
        elif number == 69:
            self._unswivel()
            self._turn_plane(69, w, column)
        elif number == 68.2:
            self._tilt(w)
        elif number in (15, 16):
            self.polar = number == 16
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

    def _path_mode(self, number: float, w: dict[str, Item], with_m19: bool) -> None:
        if "R" in w and number == 64 and with_m19:
            raise WordError("R may belong to G64 or to M19 here; write two blocks", w["R"].column)
        if "R" in w and number == 64:
            w.pop("R")
            self.note("G64 R: a setting of the planner of LinuxCNC, without effect on the path")
        if number == 64:
            p = w.pop("P").value if "P" in w else 0.0
            self.tolerance = p * self.unit if p > 0.0 else type(self)._default_tolerance()
            if "Q" in w:
                w.pop("Q")
                self.note("G64 Q: merging of collinear blocks; the rounding here does that by itself")
        self.rounding = 60 if number == 61.1 or (number == 61 and not self.linuxcnc) else 64
        if number == 61 and self.linuxcnc:
            self.tolerance = 1e-6
            self.note("G61: exact path, a rounding of 1 um")
        self.round_corners()

    @staticmethod
    def _default_tolerance() -> float:
        from twin.program.collect import DEFAULT_TOLERANCE

        return DEFAULT_TOLERANCE

    def _choose_system(self, number: float, w: dict[str, Item], column: int) -> None:
        if number == 54.1 or (number == 54 and "P" in w and not self.linuxcnc):
            if "P" not in w:
                raise WordError("G54.1 needs P, the number of the offset", column)
            extra = 100 + int(w.pop("P").value)
            if extra not in self.systems:
                self.systems[extra], self.turned[extra] = self.frame_table(f"G54.1P{extra - 100}"), 0.0
            self.system = extra
        else:
            self.system = {54: 1, 55: 2, 56: 3, 57: 4, 58: 5, 59: 6, 59.1: 7, 59.2: 8, 59.3: 9}[number]
        self.set_frames()

    def _compensation(self, number: float, w: dict[str, Item], column: int) -> None:
        if number == 40:
            w.pop("D", None)
            self.compensate(0, 0.0, along_next=False)
            return
        if "D" in w:
            item = w.pop("D")
            radius = 0.5 * item.value * self.unit if number in (41.1, 42.1) else None
            if radius is None:
                radius = 0.0 if item.value == 0 else self.tools.radius(f"{item.value:g}", item.column)
        elif number in (41.1, 42.1):
            raise WordError("G41.1 and G42.1 need D, the diameter of the tool", column)
        else:
            radius = self.tools.radius(self.tools.name, column)
        if not radius:
            self.note("G41, G42 with radius 0: the contour is the path")
        self.compensate(1 if number < 42 else -1, radius, along_next=not self.linuxcnc)

    def _dwell(self, w: dict[str, Item]) -> None:
        name = next((n for n in ("P", "X", "U") if n in w), None)
        if name is None:
            raise WordError("G4 needs its time, e.g. G4 P1.5", 1)
        item = w.pop(name)
        seconds = item.value
        if name == "P" and not self.linuxcnc and self._written_whole(item):
            seconds /= 1000.0
            self.note("G4 P without a decimal point counts in ms, as on a Fanuc; write P1.5 or a .ngc file for seconds")
        self.dwell(seconds)

    def _written_whole(self, item: Item) -> bool:
        text = self.flow.frame.unit.lines[self.flow.frame.at]
        return "." not in re.split(r"[^\d.+\-]", text[item.column :].lstrip())[0]

    # ------------------------------------------------------------------ motion

    def _move_words(self, codes: set[float], w: dict[str, Item]) -> None:
        coordinates = {n: w.pop(n) for n in (*LINEAR, *ROTARY, *OTHER) if n in w}
        if codes & {28, 30}:
            self._reference(28 if 28 in codes else 30, coordinates, w)
            return
        if 43.5 in codes or (self.out.modes.traori and self.motion in (0, 1) and w.keys() & set("IJK") and not codes & {2, 3}):
            vector = tuple(w.pop(n).value if n in w else 0.0 for n in "IJK") if w.keys() & set("IJK") else None
        else:
            vector = None
        if self.cycle is not None:
            self._drill(codes, coordinates, w)
            return
        in_plane = {n: w.pop(n) for n in "IJK" if n in w and self.motion in (2, 3)}
        moves = bool(coordinates or vector or (self.motion in (2, 3) and (in_plane or "R" in w)))
        if codes & {2, 3} and not moves:
            raise WordError("a circle needs its centre (I J K) or radius R, and an end point; add them", 1)
        if not moves:
            return
        if self.motion is None:
            raise WordError("coordinates without a motion: G80 is in force; give G0 or G1", 1)
        if self.motion == 5:
            raise WordError("G5 is not supported: splines; let the CAM system put out lines or arcs", 1)
        kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[self.motion]
        if kind != mv.RAPID and self.feed == 0.0:
            self._no_feed()
        suppress = 53 in codes
        if self.polar:
            self._polar(coordinates)
        if suppress and kind == mv.ARC:
            raise WordError("G53 goes with G0 or G1; give the arc in the work coordinates", 1)
        start = self.here()
        point, angles = self.target(coordinates, suppress)
        arc = None
        if kind == mv.ARC:
            radius = w.pop("R").value * self.unit if "R" in w else None
            turns = 0
            if "P" in w:
                item = w.pop("P")
                if item.value != int(item.value) or not 1 <= item.value <= 10_000:
                    raise WordError(f"P{item.value:g}: the number of turns of an arc is a whole number from 1", item.column)
                turns = int(item.value) - 1
            if radius is None and not in_plane:
                raise WordError("a circle needs its centre (I J K) or radius R; add it to the block", 1)
            if self.centre_absolute and len([n for n in in_plane if "IJK".index(n) in arcs.PLANES[self.plane][:2]]) < 2 and in_plane:
                raise WordError("under G90.1 a circle needs both words of its centre; add the other", 1)
            arc = self.arc_centre(start, point, in_plane, radius), self.motion == 2, turns
        self._corner_words(w)
        self.go(kind, point, angles, vector, arc, suppress=suppress, tolerance=arcs.iso_tolerance(self.unit))  # type: ignore[arg-type]
        if self.modal_macro is not None:
            unit, at, variables = self.modal_macro
            if frame := self.flow.call(unit, at, name="G66", style="macro"):
                frame.variables = dict(variables)

    def _corner_words(self, w: dict[str, Item]) -> None:
        for name in (",R", ",C"):
            if name in w:
                raise WordError(f"{name} is not supported: roundings and chamfers between blocks; write them as blocks", w[name].column)

    def _polar(self, coordinates: dict[str, Item]) -> None:
        """G16: the first axis of the plane is a radius, the second an angle, about the zero of the program."""
        a, b = (LINEAR[i] for i in arcs.PLANES[self.plane][:2])
        here = self.here()
        first, second = (here[arcs.PLANES[self.plane][k]] for k in (0, 1))
        radius, angle = math.hypot(first, second) / self.unit, math.degrees(math.atan2(second, first))
        if not self.absolute:
            raise WordError("G16 with G91 is not supported; use G90", 1)
        if a in coordinates:
            radius = coordinates[a].value
        if b in coordinates:
            angle = coordinates[b].value
        if a in coordinates or b in coordinates:
            column = next(iter(coordinates.values())).column
            coordinates[a] = Item(radius * math.cos(math.radians(angle)), "", column)
            coordinates[b] = Item(radius * math.sin(math.radians(angle)), "", column)

    def _reference(self, number: int, coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """G28, G30: through the point of the block to the reference point, rapid."""
        if number == 30:
            w.pop("P", None)
        self.note("G28, G30: the reference point is the zero of the axes, or [frame.G28] x_m .. of the machine file")
        point, angles = self.target(coordinates, False)
        none = [math.nan, math.nan]
        if coordinates:
            self.go(mv.RAPID, point, angles)
        named = coordinates or {n: Item(0.0) for n in (*LINEAR, *ROTARY)}
        goal = np.array(self.out.position[:3])
        for n in named:
            if n in LINEAR:
                goal[INDEX[n]] = self.home[number][INDEX[n]]
            elif n in ROTARY:
                none[INDEX[n] - 3] = self.home[number][INDEX[n]]
            else:
                self.other_axes[n] = 0.0
        self.go(mv.RAPID, goal, none, suppress=True)

    def _drill(self, codes: set[float], coordinates: dict[str, Item], w: dict[str, Item]) -> None:
        """A drilling cycle at the holes of the block."""
        assert self.cycle is not None
        number = self.cycle["g"]
        for name in (*ROTARY, *OTHER):
            if name in coordinates:
                raise WordError(f"Cannot put {name} in a canned cycle; move {name} in a block before", coordinates[name].column)
        a, b, across = arcs.PLANES[self.plane]
        named = {n: coordinates[n].value for n in coordinates}
        for name in "RPQIJ":
            if name in w:
                self.sticky[name] = w.pop(name).value
        depth_axis = LINEAR[across]
        if depth_axis in named:
            self.sticky["Z"] = named.pop(depth_axis)
        repeats = 1
        for name in ("L", "K"):
            if name in w:
                repeats = int(w.pop(name).value)
        if not (coordinates or codes & _CYCLES or repeats != 1):
            return
        if "Z" not in self.sticky or "R" not in self.sticky:
            missing = depth_axis if "Z" not in self.sticky else "R"
            raise WordError(f"G{number} needs {missing}; add it", 1)
        if number in (73, 83) and not self.sticky.get("Q", 0.0) > 0.0:
            raise WordError(f"G{number} needs Q, the depth of one peck, above 0; add it", 1)
        if math.isnan(self.feed) or self.feed == 0.0:
            self._no_feed()
        if self.comp is not None:
            raise WordError("a drilling cycle stands inside G41 or G42; write G40 before", 1)
        if repeats > MOST_REPEATS:
            raise WordError(f"the cycle repeats more than {MOST_REPEATS} times", 1)
        here = self.here() / self.unit
        start_height, initial = float(here[across]), self.initial / self.unit
        if self.absolute:
            safe, depth = self.sticky["R"], self.sticky["Z"]
        else:
            safe = initial + self.sticky["R"]
            depth = safe + self.sticky["Z"]
        if self.linuxcnc and self.plane != 17 and number in (74, 84):
            raise WordError(f"G{number} outside G17 is not read: LinuxCNC itself moves other axes there; write the moves", 1)
        if depth > safe:
            raise WordError(f"G{number}: {depth_axis} {depth:g} lies above R {safe:g}; correct one", 1)
        clear = max(safe, initial) if self.retract_to_start else safe
        pause = self.sticky.get("P", 0.0) if number in (74, 82, 84, 86, 89, 73, 83, 88) else 0.0
        if not self.linuxcnc:
            pause /= 1000.0
        if number in (73, 83, 85, 81) and self.linuxcnc:
            pause = 0.0
        cycle = Drilling(
            safe, depth, clear, dwell=pause, peck=self.sticky.get("Q", 0.0) if number in (73, 83) else 0.0, break_chip=number == 73,
            back=0.254e-3 / self.unit, out=FEED if number in (74, 84, 85, 89) else RAPID, feed_all_the_way=self.linuxcnc,
        )  # fmt: skip
        if number in (73, 83):
            self.note("G73, G83: the tool backs off by 0.254 mm, a parameter on the control")
        nothing = [math.nan, math.nan]
        if start_height < safe:
            self._height(across, safe)
        for _ in range(repeats):
            point = self.here()
            for name, value in named.items():
                i = INDEX[name]
                point[i] = value * self.unit if self.absolute else point[i] + value * self.unit
            self.go(mv.RAPID, point, nothing)
            if abs(self.here()[across] / self.unit - safe) > 1e-12:
                self._height(across, safe)
            self.drill(cycle)

    def _height(self, across: int, value: float) -> None:
        point = self.here()
        point[across] = value * self.unit
        self.go(mv.RAPID, point, [math.nan, math.nan])

    # ------------------------------------------------------------------ M

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
        """M70 stores the modes, M72 brings them back."""
        if number in (70, 73):
            self.stored_modes.append((self.motion, self.plane, self.absolute, self.unit, self.out.modes.feed_mode, self.feed))
        elif number == 72 and self.stored_modes:
            self.motion, self.plane, self.absolute, unit, mode, feed = self.stored_modes[-1]
            self.set_unit(unit, feed=True)
            self.set_feed_mode(mode)
            self.feed = feed
            self.settle_plain()

    def _m_after(self, m: list[int]) -> None:
        if 2 in m or 30 in m:
            self.flow.ended = True


def _system_name(number: int) -> str:
    return f"G{53 + number}" if number <= 6 else f"G59.{number - 6}"


def _system_number(number: int) -> float:
    return 10.0 * (53 + number) if number <= 6 else 590.0 + number - 6


def _between_percents(unit: Unit) -> Unit:
    """A program between two lines % ends at the second."""
    marks = [i for i, line in enumerate(unit.lines) if line.strip().startswith("%")]
    first = next((i for i, line in enumerate(unit.lines) if line.strip()), 0)
    if len(marks) >= 2 and marks[0] == first:
        return replace(unit, lines=[*unit.lines[: marks[1]], "M2"])
    return unit


def _subs(unit: Unit) -> dict[str, int]:
    """Subprograms of O-words in a program: name -> line."""
    if unit.subs is None:
        unit.subs = {}
        for at, line in enumerate(unit.lines):
            if "O" in line.upper() and (m := _OWORD.match(_COMMENT.sub("", line.split(";")[0]).upper())) and m[2] == "SUB":
                unit.subs.setdefault(_plain_key(m[1]), at)
    return unit.subs


def _plain_key(key: str) -> str:
    return str(int(key)) if key.isdigit() else key.replace(" ", "")


def _oword(match: re.Match[str]) -> Statement:
    key, word, text = _plain_key(match[1]), match[2].lower(), match[3]
    column = match.start(3) + 1
    kind = {"repeat": "times", "endrepeat": "endtimes"}.get(word, word)
    return Statement(kind, key, text, column)
