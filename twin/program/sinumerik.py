"""SINUMERIK programs: the words of a block and what they do; variables, subprograms, frames, cycles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
from pathlib import Path
import re
from typing import Any

import numpy as np

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program import arcs
from twin.program import moves as mv
from twin.program import sinumerik_cycles as cycles
from twin.program.collect import DEFAULT_ANGLE_TOLERANCE, DEFAULT_TOLERANCE
from twin.program.control import INCH, INDEX, LINEAR, OTHER, ROTARY, Control, Item, rotation
from twin.program.cycles import CycleError
from twin.program.expressions import SINUMERIK, Expression, Value, WordError
from twin.program.flow import Flow, Frame, Statement
from twin.program.source import Folder, Unit, plain_name
from twin.program.tables import ACTS, NOTE, REFUSED, SINUMERIK_G, SINUMERIK_M, SINUMERIK_NAMES
from twin.program.words import NUMBER, Word, split_arguments, split_words
from twin.units import rad_from_deg

_PLAIN = re.compile(
    r"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?"
    + "".join(rf"(?:{axis}=?({NUMBER})\s*)?" for axis in "XYZ")
    + rf"(?:A=?({NUMBER})\s*)?(?:C=?({NUMBER})\s*)?(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?(?:F({NUMBER})\s*)?$",
    re.A,
)
_LABEL = re.compile(r"\s*(?:[N:]\d+\s*)?([A-Z_][A-Z_][A-Z0-9_]*)\s*:(?!=)", re.A)
_NUMBERED = re.compile(r"\s*[N:](\d+)", re.A)
_FLOW = re.compile(
    r"\s*(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|UNTIL|GOTO[FBCS]?|REPEATB?|CASE|ENDLABEL|PROC|DEF|REDEF|DEFINE|EXTERN)\b(?!\s*=[^=])",
    re.A,
)
_GOTO = re.compile(r"\s*GOTO([FBC]?)\s+([A-Z0-9_]+)\s*\Z", re.A)
_IF_GOTO = re.compile(r"\s*IF\b(.*?)\b(GOTO[FBCS]?\b.*)\Z", re.A)
_REPEAT = re.compile(
    r"\s*(REPEATB?)\s+([A-Z_N][A-Z0-9_]*)(?:\s+(?!P\s*=?\s*[\dR])([A-Z_][A-Z0-9_]*))?(?:\s+P\s*=?\s*(\d+|R\d+|[A-Z_]\w*))?\s*\Z", re.A
)
_FOR = re.compile(r"\s*FOR\s*([A-Z_][A-Z0-9_]*(?:\[[^\]]*\])?)\s*=\s*(.+?)\s+TO\s+(.+)\Z", re.A)
_CASE = re.compile(r"\s*CASE\s*(.+?)\s+OF\b(.*)\Z", re.A)
_CASE_PART = re.compile(r"\s*(DEFAULT|[^\s].*?)\s+(GOTO[FBC]?)\s+([A-Z0-9_]+)", re.A)
_PROC = re.compile(r"\s*PROC\s+([A-Z_][A-Z0-9_]*)\s*(?:\((.*?)\))?", re.A)
_DEF = re.compile(
    r"\s*(?:DEF|REDEF)\s+(?:(?:NCK|CHAN|SYNR|SYNRW|SYNW|INTERN)\s+)*(REAL|INT|BOOL|CHAR|STRING\s*\[\s*\d+\s*\]|AXIS|FRAME)\s+(.+)\Z", re.A
)
_WRAPPED = re.compile(r"\s*(AC|IC|DC|ACP|ACN)\s*\((.*)\)\s*\Z", re.S)
_FRAME_PART = re.compile(r"\s*C(TRANS|FINE|ROT|SCALE|MIRROR)\s*\(([^()]*)\)\s*:?")
_AXIS_NAMES = {*INDEX, *OTHER, "X1", "Y1", "Z1", "A1", "C1", "B1", "TR", "FI", "RT", "SC", "MI", "SPI", "SP1"}
_MACHINE_AXES = {"X1", "Y1", "Z1", "A1", "C1"}
_SWITCH_WORDS = {"TRANS", "ATRANS", "ROT", "AROT", "SCALE", "ASCALE", "MIRROR", "AMIRROR", "ROTS", "AROTS"}
_ARC_WORDS = {"CR", "AR", "TURN", "I1", "J1", "K1"}
MOST_ELEMENTS = 100_000


class Sinumerik(Control):
    """Reads the blocks of one SINUMERIK program."""

    def __init__(self, path: Path, machine: Machine, units: list[Unit]):
        super().__init__(path, machine)
        self.units = {plain_name(u.name): u for u in reversed(units)}
        self.folder = Folder(path)
        self.parameters: dict[int, float] = {}
        self.globals: dict[str, dict[tuple, Value]] = {}
        self.flow = Flow(units[0], self)
        self.settable: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        self.chosen = "G500"
        self.basic = np.eye(3), np.zeros(5)
        self.program_matrix, self.program_offset, self.fine = np.eye(3), np.zeros(5), np.zeros(5)
        self.mcall: Callable[[], None] | None = None
        self.pole = np.zeros(3)
        self.angles_are_rpy: bool | None = None
        self.corners_meet = False
        self.tangent: np.ndarray | None = None
        self.corner: tuple[str, float] | None = None  # RND, CHF or CHR that waits for the next move
        self.every_corner = 0.0  # RNDM [m]
        self.held: tuple | None = None
        self.set_frames()

    # ------------------------------------------------------------------ lines

    def run(self) -> Any:
        """All blocks; the moves stand in `out`."""
        self.flow.run()
        self._release()
        if self.comp is not None:
            self.compensate(0, 0.0, along_next=True)
        return self.out

    def clean(self, text: str) -> str:
        """The block in capitals without comment; texts in quotes keep their length."""
        semicolon = text.find(";")
        while semicolon >= 0 and text.count('"', 0, semicolon) % 2:
            semicolon = text.find(";", semicolon + 1)
        if semicolon >= 0:
            text = text[:semicolon]
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith("%"):
            return ""
        if stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        return text

    def _body(self, text: str) -> tuple[str, int]:
        """The block without label and number, which keep their length; the number, -1 if there is none."""
        number = _NUMBERED.match(text)
        start = number.end() if number else 0
        if (label := _LABEL.match(text)) and label[1] != "ENDLABEL":
            start = label.end()
            if again := re.compile(r"\s*N(\d+)").match(text, start):
                number, start = again, again.end()
        return " " * start + text[start:], int(number[1]) if number else -1

    def statement(self, text: str) -> Statement | None:
        """What the flow must know of a line."""
        body, _ = self._body(text)
        if not body.strip():
            return Statement("label")
        match = _FLOW.match(body)
        if not match:
            return None
        word, column = match[1], match.start(1) + 1
        rest = body[match.end(1) :]
        if word == "IF":
            if jump := _IF_GOTO.match(body):
                return self._jump(jump[2], jump[1], jump.start(1) + 1)
            return Statement("if", text=rest, column=match.end(1) + 1)
        if word.startswith("GOTO"):
            return self._jump(body, "", column)
        if word in ("WHILE", "UNTIL"):
            return Statement(word.lower(), text=rest, column=match.end(1) + 1)
        if word in ("ELSE", "ENDIF", "ENDWHILE", "ENDFOR", "LOOP", "ENDLOOP"):
            if rest.strip():
                raise WordError(f"{word} stands alone in its block; write the rest in the next one", column)
            return Statement(word.lower(), column=column)
        if word == "FOR":
            parts = _FOR.match(body)
            if not parts:
                raise WordError("FOR needs a variable and its ends, e.g. FOR I=1 TO 10", column)
            return Statement("for", column=column, rest=(parts[1], parts[2], parts[3]))
        if word in ("REPEAT", "REPEATB"):
            if not rest.strip():
                return Statement("repeat", column=column)
            parts = _REPEAT.match(body)
            if not parts:
                raise WordError("REPEAT needs a label, e.g. REPEAT PART1 P=3 or REPEAT FROM1 TO1", column)
            return Statement("repeat_label", column=column, rest=parts.groups())
        if word == "ENDLABEL":
            return Statement("label")
        return Statement(word.lower(), text=body, column=column)

    def _jump(self, text: str, condition: str, column: int) -> Statement:
        if text.strip().startswith("GOTOS"):
            return Statement("goto", column=column, rest=(condition, "S", ""))
        match = _GOTO.match(text)
        if not match:
            raise WordError("GOTO needs one label or block number, e.g. GOTOF END1", column)
        return Statement("goto", column=column, rest=(condition, match[1], match[2]))

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines by label and block number."""
        found: dict[str, list[int]] = {}
        for i, line in enumerate(unit.lines):
            text = line.upper()
            if match := _LABEL.match(text):
                found.setdefault(match[1], []).append(i)
            if match := _NUMBERED.match(text):
                found.setdefault(f"N{match[1]}", []).append(i)
        return found

    def other(self, s: Statement, frame: Frame) -> None:
        """CASE, DEF, PROC and the like."""
        if s.kind == "case":
            self._case(s, frame)
        elif s.kind in ("def", "redef"):
            self._define(s, frame)
        elif s.kind == "define":
            raise WordError("DEFINE .. AS is not supported: macros; write the words themselves", s.column)
        elif s.kind == "extern":
            self.note("EXTERN: a declaration, without effect on the motion")
        elif s.kind in ("endwhile", "endif"):
            raise WordError(f"{s.kind.upper()} ends nothing that was begun", s.column)

    def _case(self, s: Statement, frame: Frame) -> None:
        match = _CASE.match(s.text)
        if not match:
            raise WordError("CASE needs values, e.g. CASE (R1) OF 1 GOTOF A1 DEFAULT GOTOF B1", s.column)
        value = self._value_of(match[1], s.column)
        self.flow.decided(match[1], (value,))
        for part in _CASE_PART.finditer(match[2]):
            if part[1] == "DEFAULT" or self._value_of(part[1], s.column) == value:
                self.flow._goto(frame, frame.at, Statement("goto", column=s.column, rest=("", part[2][4:], part[3])))
                return

    def _define(self, s: Statement, frame: Frame) -> None:
        match = _DEF.match(s.text)
        if not match:
            raise WordError("DEF needs a type and names, e.g. DEF REAL LENGTH=10", s.column)
        start: Value = "" if match[1].startswith(("STRING", "CHAR", "AXIS")) else 0.0
        for part, _ in split_arguments(match[2]):
            name, _, value = part.partition("=")
            shape = re.match(r"\s*([A-Z_$][A-Z0-9_$]*)\s*(?:\[(.*)\])?\s*\Z", name, re.A)
            if not shape:
                raise WordError(f"'{part[:30]}' is no definition; write a name, e.g. DEF REAL LENGTH=10", s.column)
            store: dict[tuple, Value] = {("default",): start}
            if shape[2]:
                sizes = [int(self.number_of(n, s.column)) for n, _ in split_arguments(shape[2])]
                if math.prod(sizes) > MOST_ELEMENTS:
                    raise WordError(f"an array of {math.prod(sizes)} elements is too large", s.column)
                store[("size",)] = float(len(sizes))
            if value.strip():
                values = re.match(r"\s*(?:SET|REP)?\s*\((.*)\)\s*\Z", value) if shape[2] else None
                for k, (item, _) in enumerate(split_arguments(values[1]) if values else [(value, 0)]):
                    if item:
                        store[(float(k),) if shape[2] else ()] = self._value_of(item, s.column)
            frame.variables[shape[1]] = store

    # ------------------------------------------------------------------ values

    def _value_of(self, text: str, column: int) -> Value:
        variable = self._variable if self.reads is None else self._noted_variable
        value = Expression(text, SINUMERIK, variable, None, 0, column).whole()
        return value

    def _noted_variable(self, e: Expression, name: str, at: int) -> Value:
        value = self._variable(e, name, at)
        if self.reads is not None:
            self.reads.append(value)
        return value

    def number_of(self, text: str, column: int) -> float:
        """The value of an expression or condition (1 true, 0 false)."""
        if not text.strip():
            raise WordError("a condition or number is missing, e.g. IF R1<10", column)
        value = self._value_of(text, column)
        if isinstance(value, str):
            raise WordError(f'a number is needed here, not the text "{value[:20]}"', column)
        return value

    def _store_of(self, name: str) -> dict[tuple, Value] | None:
        return self.flow.frame.variables.get(name) or self.globals.get(name)

    def _variable(self, e: Expression, name: str, at: int) -> Value:
        index: tuple = ()
        if e.peek() == "[":
            index = tuple(e.arguments())
        elif e.peek() == "(" and name not in ("AC", "IC", "DC"):
            raise e.fail(f"'{name}' is no function that is read here", at)
        if match := re.fullmatch(r"R(\d{1,4})", name):
            return self.parameters.get(int(match[1]), 0.0)
        if name == "R" and len(index) == 1 and not isinstance(index[0], str):
            return self.parameters.get(int(index[0]), 0.0)
        if (store := self._store_of(name)) is not None:
            if index in store:
                return store[index]
            if ("default",) in store:
                return store[("default",)]
        if (value := self._system(name, index)) is not None:
            return value
        given = self.machine.document.get("variables", {})
        key = name + (f"[{','.join(str(i) if isinstance(i, str) else f'{i:g}' for i in index)}]" if index else "")
        for k in (key, key.lower()):
            if isinstance(given, dict) and k in given:
                return given[k] if isinstance(given[k], str) else float(given[k])
        if name in _AXIS_NAMES and not index:
            return name
        raise e.fail(f"variable '{key}' has no value here; define it (DEF), or give it in the table [variables] of the machine file", at)

    def _system(self, name: str, index: tuple) -> Value | None:
        """System variables with a meaning here."""
        if name in ("$P_SIM", "$P_ISTEST", "$P_SEARCH", "$P_SEARCHL", "$P_DRYRUN", "$AC_ALARM_STAT", "$P_SUBPAR"):
            return 0.0
        if name in ("$P_EP", "$AA_IW", "$AA_IM", "$AA_MW", "$P_EPM") and len(index) == 1 and index[0] in INDEX:
            i = INDEX[index[0]]
            machine = name == "$AA_IM"
            if i >= 3:
                angle = float(self.out.settle()[i - 3]) - (0.0 if machine else self.offset[i])
                return math.degrees(angle)
            return float((np.array(self.out.position[:3]) if machine else self.here())[i]) / self.unit
        if name == "$P_F":
            return 0.0 if math.isnan(self.feed) else self.feed
        if name in ("$P_S", "$P_SDIR"):
            return self.out.modes.spindle
        if name == "$P_TOOLNO":
            return float(self.tools.name) if self.tools.name.isdigit() else 0.0
        if name == "$P_TOOL":
            return 1.0 if self.tools.name not in ("", "0") else 0.0
        if name == "$P_TOOLR":
            return self.tools.radius(self.tools.name, 1) / self.unit
        if name == "$P_UIFRNUM":
            return float(self._frame_number(self.chosen))
        if name == "$P_UIFR" and len(index) == 3 and index[1] in INDEX:
            matrix, offset = self._settable(_frame_name(index[0]))
            if index[2] == "TR":
                i = INDEX[index[1]]
                return math.degrees(offset[i]) if i >= 3 else offset[i] / self.unit
            if index[2] == "FI":
                return 0.0
        if name == "$P_GG" and len(index) == 1:
            groups = {6.0: self.plane - 16, 14.0: 1 + (not self.absolute), 13.0: 1 if self.unit != 1e-3 else 2, 1.0: 1 + (self.motion or 0)}
            return float(groups[index[0]]) if index[0] in groups else None
        if name in ("$P_PROG", "$P_STACK", "$P_PROGPATH"):
            return self.flow.frame.unit.name if name != "$P_STACK" else float(len(self.flow.frames) - 1)
        return None

    def assign(self, name: str, value: Value, column: int, index: tuple = ()) -> None:
        """Give a variable a value."""
        if "[" in name:
            name, _, inner = name.partition("[")
            index = tuple(self._value_of(t, column) for t, _ in split_arguments(inner.rstrip("]")))
        if match := re.fullmatch(r"R(\d{1,4})", name):
            self.parameters[int(match[1])] = _as_number(value, column)
            return
        if name == "R" and len(index) == 1:
            self.parameters[int(_as_number(index[0], column))] = _as_number(value, column)
            return
        store = self._store_of(name)
        if store is None:
            given = self.machine.document.get("variables", {})
            if name[0] not in "_$" and not (isinstance(given, dict) and {name, name.lower()} & given.keys()):
                hint = nearest(name, SINUMERIK_NAMES)
                hint = f"; {hint}" if hint.startswith("did you") else ""
                raise WordError(
                    f"word '{name}' is not known and no variable of this name is defined{hint}; define it (DEF), or give it in the table "
                    "[variables] of the machine file",
                    column,
                )
            self.note(f"{name}: a variable of the control, kept for the program")
            store = self.globals.setdefault(name, {})
        if len(store) > MOST_ELEMENTS:
            raise WordError(f"{name} has more than {MOST_ELEMENTS} elements", column)
        store[index] = value

    def _value(self, word: Word) -> float:
        if word.assigned:
            return self.number_of(word.text or "", word.text_column)
        if word.value is None:
            raise WordError(f"'{word.name}' needs a number", word.column)
        return word.value

    def _item(self, word: Word) -> Item:
        """A coordinate and how it counts."""
        if word.assigned and (match := _WRAPPED.match(word.text or "")):
            return Item(self.number_of(match[2], word.text_column + match.start(2)), match[1], word.column)
        if word.text is not None and not word.assigned:
            raise WordError(f"'{word.name}({word.text})' is not a coordinate; write {word.name}=AC(..) or {word.name}=IC(..)", word.column)
        return Item(self._value(word), "", word.column)

    # ------------------------------------------------------------------ blocks

    def fast(self, text: str, line: int) -> bool:
        """Take a plain block of coordinates; False if it must be read word by word."""
        if not self.plain or self.mcall is not None or self.corner is not None or self.held is not None or self.every_corner:
            return False
        match = _PLAIN.match(text)
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
        position, frame, unit = out.position, self.offset, self.unit
        if x is not None:
            position[0] = float(x) * unit + frame[0]
        if y is not None:
            position[1] = float(y) * unit + frame[1]
        if z is not None:
            position[2] = float(z) * unit + frame[2]
        tilt = turn = math.nan
        if a is not None:
            position[3] = tilt = rad_from_deg(float(a)) + frame[3]
        if c is not None:
            position[4] = turn = rad_from_deg(float(c)) + frame[4]
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
        coordinates: dict[str, Item] = {}
        centre: dict[str, Item] = {}
        extra: dict[str, Item] = {}
        tool: dict[str, tuple[Value, int]] = {}
        g: list[tuple[float, Word]] = []
        m: list[int] = []
        calls: list[Word] = []
        names: list[Word] = []
        for word in words:
            name = word.name
            if word.assigned and (
                name in self.flow.frame.variables or name in self.globals or re.fullmatch(r"R\d*", name) or name[0] == "$"
            ):
                self._assignment(word)
            elif name == "G" and (word.value is not None or word.assigned):
                g.append((self._value(word), word))
            elif name in INDEX or name in OTHER or name in _MACHINE_AXES or (name in ("POS", "POSA") and word.index):
                axis = name[0] if not name.startswith("POS") else (word.index or "").strip().removesuffix("1")
                if axis not in INDEX and axis not in OTHER:
                    raise WordError(f"{name}[{axis}]: this machine has X Y Z A C", word.column)
                if axis in coordinates:
                    raise WordError(f"{axis} stands twice in the block; keep one", word.column)
                coordinates[axis] = self._item(word)
                if name.startswith("POS"):
                    self.note("POS, POSA: the axis moves with the others of the block, at rapid where it stands alone")
                    extra["POS"] = Item(1.0, "", word.column)
            elif name in ("I", "J", "K"):
                centre[name] = self._item(word)
            elif name in ("F", "S", "P") or (name in SINUMERIK_NAMES and SINUMERIK_NAMES[name][1] in _VALUE_WORDS):
                if name in extra:
                    raise WordError(f"{name} stands twice in the block; keep one", word.column)
                extra[name] = self._item(word)
            elif name == "M" and (word.value is not None or word.assigned):
                m.append(int(self._value(word)))
            elif name in ("T", "D", "H") and (word.value is not None or word.assigned):
                tool[name] = self._tool_value(word), word.column
            elif name == "L" and word.value is not None:
                calls.append(word)
            elif re.fullmatch(r"[SMHTD]\d+", name) and word.assigned:
                self.note(f"{name}=: a word of another spindle or tool, understood, without effect on the motion")
            elif name == "R":
                raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
            elif len(name) == 1:
                raise WordError(
                    f"word '{name}' is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
                )
            elif name in SINUMERIK_NAMES and not self._own_program(name):
                names.append(word)
            elif word.assigned:
                self._assignment(word)
            else:
                calls.append(word)
        self._carry_out(g, m, names, coordinates, centre, extra, tool, calls)

    def _tool_value(self, word: Word) -> Value:
        if word.assigned:
            return self._value_of(word.text or "", word.text_column)
        return self._value(word)

    def _assignment(self, word: Word) -> None:
        """A variable of any kind; frames are written whole or by component."""
        name = word.name
        index: tuple = ()
        if word.index is not None:
            index = tuple(self._value_of(t, word.column) for t, _ in split_arguments(word.index))
        if name in ("$P_UIFR", "$P_PFRAME", "$P_UBFR", "$P_BFRAME", "$P_CHBFR", "$P_NCBFR", "$P_IFRAME", "$P_ACTBFRAME"):
            self._write_frame(name, index, word)
            return
        value = self._value_of(word.text or "", word.text_column)
        if name == "$TC_DP6" and len(index) == 2:
            self.tools.radii[f"{index[0]:g}" if not isinstance(index[0], str) else index[0]] = _as_number(value, word.column) * self.unit
            return
        if name.startswith("$TC_DP3"):
            self.note("$TC_DP3: tool lengths are those of the table [tool] of the machine file")
        self.assign(name, value, word.column, index)

    def _carry_out(self, g, m, names, coordinates, centre, extra, tool, calls) -> None:  # type: ignore[no-untyped-def]
        numbers = {n for n, _ in g}
        for number, word in g:
            entry = SINUMERIK_G.get(number)
            if entry is None:
                raise WordError(
                    f"G{number:g} is not known; remove it or replace it by moves (docs/programs.md lists what is read)", word.column
                )
            if entry[0] == REFUSED:
                raise WordError(f"G{number:g} is not supported: {entry[1]}", word.column)
            if entry[0] == NOTE:
                self.note(f"G{number:g}: {entry[1]}")
        if tool or 6 in m:
            if 6 in m:
                tool["M6"] = 6.0, 1
            self.tools.block(tool)
        if 4 in numbers:
            self._dwell(numbers, extra, bool(coordinates or centre or names or calls))
            return
        frame_word = next((w for w in names if w.name in _SWITCH_WORDS), None)
        shift = next((n for n in (58, 59) if n in numbers), None)
        suppress = bool(numbers & {53, 153}) or any(w.name == "SUPA" for w in names)
        vector = self._orientation(extra)
        self._settings(extra, numbers)
        modal_before = self.mcall
        moved_by_name = None
        for number, word in g:
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
        pause = self._m(m)
        if frame_word is not None or shift is not None:
            self._frame_words(frame_word, shift, coordinates, extra)
        elif numbers & {74, 75}:
            self._fixed_point(75 if 75 in numbers else 74, coordinates, extra)
        elif numbers & {110, 111, 112}:
            self._set_pole(next(n for n in (110, 111, 112) if n in numbers), coordinates, extra)
        else:
            self._motion(numbers, coordinates, centre, extra, vector, suppress, moved_by_name, g)
            if coordinates and self.mcall is not None and self.mcall is modal_before:
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
        if 17 in m or any(w.name == "RET" for w in names):
            self.flow.back("return")
        elif 2 in m or 30 in m:
            self.flow.ended = True

    def runs_into(self, what: str, column: int) -> None:
        """The end of the file ends a program like M30."""

    def returned(self, frame: Frame) -> None:
        """The end of a subprogram; a last corner or compensation goes on in the caller."""

    # ------------------------------------------------------------------ subprograms

    def _own_program(self, name: str) -> bool:
        """Whether a subprogram beside the program has the name of a word of the control that is not simulated."""
        return SINUMERIK_NAMES[name][0] == REFUSED and name.startswith("CYCLE") and self._find(name) is not None

    def _find(self, name: str) -> Unit | None:
        return self.units.get(plain_name(name)) or self.folder.find(name)

    def _call(self, word: Word, times: int) -> None:
        name = word.name if word.name != "L" else f"L{word.value:g}"
        unit = self._find(name)
        arguments = [(t, word.text_column + c) for t, c in split_arguments(word.text or "")]
        if unit is None and name == "L":
            raise WordError("L needs a number", word.column)
        if unit is None:
            if word.index is not None or (word.value is not None and word.name != "L"):
                raise WordError(f"word '{name}' is not known; remove it or replace it by moves", word.column)
            still = self.machine.document.get("program", {})
            if isinstance(still, dict) and name in [str(n).upper() for n in still.get("calls_without_motion", [])]:
                self.note(f"{name}: moves no axis, says the machine file")
                return
            hint = nearest(name, SINUMERIK_NAMES) if len(name) > 2 else ""
            hint = f"{hint}; or " if hint.startswith("did you") else ""
            raise WordError(
                f"word '{name}' is not known and there is no subprogram {name}.SPF beside the program; {hint}add the file, or list it in "
                "[program] calls_without_motion of the machine file if it moves no axis",
                word.column,
            )
        self._release()
        variables, first = self._arguments(unit, arguments, word)
        if frame := self.flow.call(unit, first, times=times, name=name, column=word.column):
            frame.variables = variables

    def _arguments(self, unit: Unit, arguments: list[tuple[str, int]], word: Word) -> tuple[dict, int]:
        """Values of the parameters of a PROC, and the line it begins at."""
        for at, line in enumerate(unit.lines):
            body = self._body(self.clean(line))[0]
            if not body.strip() or body.strip().startswith("EXTERN"):
                continue
            match = _PROC.match(body)
            if not match:
                break
            variables: dict[str, dict] = {}
            for k, (part, _) in enumerate(split_arguments(match[2] or "")):
                declared, _, default = part.partition("=")
                words = re.sub(r"\[[^\]]*\]", " ", declared).split()
                if not words:
                    continue
                name = words[-1]
                start: Value = "" if any(w in declared for w in ("STRING", "CHAR", "AXIS")) else 0.0
                given = arguments[k] if k < len(arguments) and arguments[k][0] else (default, 1)
                if "AXIS" in declared and given[0]:
                    value: Value = given[0]
                else:
                    value = self._value_of(*given) if given[0].strip() else start
                variables[name] = {(): value, ("default",): start}
            if len(arguments) > len(split_arguments(match[2] or "")):
                raise WordError(f"{unit.name} takes {len(variables)} values; the call gives {len(arguments)}", word.column)
            return variables, at + 1
        if any(t for t, _ in arguments):
            raise WordError(f"{unit.name} takes no values (it has no PROC line); remove the brackets", word.column)
        return {}, 0

    # ------------------------------------------------------------------ settings

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
        if kind == REFUSED:
            raise WordError(f"{name} is not supported: {meaning}", word.column)
        if kind == NOTE:
            if name == "FGROUP" and {t for t, _ in split_arguments(word.text or "")} - set(LINEAR) - {""}:
                self.note("FGROUP: the feed is that of the tool tip all the same")
            self.note(f"{name}: {meaning}")
        elif name in ("TRAORI", "TRAFOOF"):
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
        elif name in ("CALL", "PCALL"):
            text = (word.text or "").strip()
            if not text and calls:
                return
            calls.append(Word(plain_name(str(self._value_of(text, word.text_column))), word.column))
        elif name == "RET":
            self._release()
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

    def _dwell(self, numbers: set[float], extra: dict[str, Item], more: bool) -> None:
        if more or numbers - {4} or extra.keys() not in ({"F"}, {"S"}):
            raise WordError("G4 stands alone in its block with one time, e.g. G4 F<seconds>; give the rest a block of its own", 1)
        self._release()
        if "S" in extra:
            if not self.out.modes.spindle:
                raise WordError("G4 S<turns> needs a spindle speed before; give S or use G4 F<seconds>", 1)
            self.dwell(extra["S"].value * 60.0 / self.out.modes.spindle)
        else:
            self.dwell(extra["F"].value)

    # ------------------------------------------------------------------ motion

    def _orientation(self, extra: dict[str, Item]) -> tuple[float, float, float] | None:
        """The tool axis of a block, by a vector or by angles."""
        vector = [n for n in ("A3", "B3", "C3") if n in extra]
        angles = [n for n in ("A2", "B2", "C2") if n in extra]
        if not vector and not angles:
            return None
        if not self.out.modes.traori:
            raise WordError("A3= B3= C3= need TRAORI; switch it on before, or program A= and C=", 1)
        if vector:
            return tuple(extra.pop(n).value if n in extra else 0.0 for n in ("A3", "B3", "C3"))  # type: ignore[return-value]
        if self.angles_are_rpy is None:
            raise WordError("A2= B2= C2= count as the control is set; write ORIRPY or ORIEULER before", 1)
        a, b, c = (extra.pop(n).value if n in extra else 0.0 for n in ("A2", "B2", "C2"))
        matrix = (
            rotation(2, c) @ rotation(1, b) @ rotation(0, a) if self.angles_are_rpy else rotation(2, a) @ rotation(0, b) @ rotation(2, c)
        )
        return tuple(map(float, matrix[:, 2]))  # type: ignore[return-value]

    def _motion(self, numbers, coordinates, centre, extra, vector, suppress, by_name, g) -> None:  # type: ignore[no-untyped-def]
        """One motion block: target, tool axis, arc, corner."""
        self._polar(coordinates, extra)
        self._slanted(coordinates, extra)
        if vector and ("A" in coordinates or "C" in coordinates):
            raise WordError("the tool axis is given twice, by A3= B3= C3= and by A= C=; keep one", 1)
        if "RNDM" in extra:
            self.every_corner = max(0.0, extra.pop("RNDM").value) * self.unit
        corner = next(((n, extra.pop(n).value * self.unit) for n in ("RND", "CHF", "CHR") if n in extra), None)
        by_words = extra.keys() & _ARC_WORDS
        programmed = any(n in (2, 3) for n, _ in g) or by_name
        kind = (mv.RAPID, mv.LINE, mv.ARC, mv.ARC)[self.motion if self.motion is not None else 1]
        if numbers & {331, 332, 63}:
            kind, coordinates = self._tap(numbers, coordinates, centre, extra)
        if extra.pop("POS", None) is not None and len(coordinates) == 1 and not numbers:
            kind = mv.RAPID
        moves = bool(coordinates or vector or (centre and kind == mv.ARC) or (programmed and by_words))
        if not moves:
            if centre or by_words:
                raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add the motion and its end point", 1)
            if corner:
                raise WordError(f"{corner[0]} stands in the block of a move; write it there", 1)
            return
        if kind != mv.ARC and (centre or by_words):
            raise WordError("I J K, CR= (in .ngc files R) and TURN= belong to G2 or G3; add it to the block", 1)
        start = np.array(self.out.position[:3]) if suppress else self._from()
        if self.held is not None and (suppress or any(n in coordinates for n in ROTARY) or vector):
            self._release()
        point, angles = self._target(coordinates, suppress)
        arc, space = None, None
        if kind == mv.ARC:
            arc, space = self._arc(start, point, centre, extra, by_name)
        self._queue(kind, point, angles, vector, arc, space, suppress, corner)

    def _from(self) -> np.ndarray:
        return self.held[1].copy() if self.held is not None else self.here()

    def _target(self, coordinates: dict[str, Item], suppress: bool) -> tuple[np.ndarray, list[float]]:
        if self.held is None:
            return self.target(coordinates, suppress)
        kept, self.comp_hold = self.here, None
        held = self.held[1].copy()
        self.here = lambda: held.copy()  # type: ignore[method-assign]
        try:
            return self.target(coordinates, suppress)
        finally:
            self.here = kept  # type: ignore[method-assign]

    def _queue(self, kind, point, angles, vector, arc, space, suppress, corner) -> None:  # type: ignore[no-untyped-def]
        """Put a move out, or hold it back until its corner with the next one is known."""
        if self.every_corner and corner is None and kind == mv.LINE:
            corner = "RNDM", self.every_corner
        row = (kind, point, angles, vector, arc, space, suppress, self.feed, self.line, self.block)
        if self.held is not None:
            row = self._cut_corner(row)
        if corner is not None and corner[1] > 0.0:
            self.held = (corner, point.copy(), row, self._start_of(row))
            return
        self._go(row)

    def _start_of(self, row) -> np.ndarray:  # type: ignore[no-untyped-def]
        return self.here()

    def _go(self, row) -> None:  # type: ignore[no-untyped-def]
        kind, point, angles, vector, arc, space, suppress, feed, line, block = row
        now = self.feed, self.line, self.block
        self.feed, self.line, self.block = feed, line, block
        start = self.here() if not suppress else None
        self.go(kind, point, angles, vector, arc, suppress=suppress, space_arc=space)
        self.tangent = None
        if start is not None and arc is None and space is None and np.linalg.norm(point - start) > 0:
            self.tangent = (point - start) / np.linalg.norm(point - start)
        elif arc is not None and start is not None:
            _, normal, _ = arcs.from_centre(start, point, arc[0], self.plane, arc[1], arc[2])
            way = np.cross(normal, point - arc[0])
            self.tangent = way / np.linalg.norm(way)
        self.feed, self.line, self.block = now

    def _release(self) -> None:
        """A move that was held back for its corner goes out in full."""
        if self.held is not None:
            corner, _, row, _ = self.held
            self.held = None
            if corner[0] != "RNDM":
                raise WordError(f"behind {corner[0]} a move in the plane must follow; add it or remove {corner[0]}", 1)
            self._go(row)

    def _cut_corner(self, row) -> tuple:  # type: ignore[no-untyped-def, type-arg]
        """The held move, then the chamfer or rounding between it and the next."""
        assert self.held is not None
        (what, size), corner, before, start = self.held
        self.held = None
        after = row[1]
        u, v = corner - start, after - corner
        lengths = float(np.linalg.norm(u)), float(np.linalg.norm(v))
        straight = before[4] is None and row[4] is None and before[5] is None and row[5] is None and row[0] != mv.RAPID
        if not straight or min(lengths) < 1e-9:
            if what == "RNDM":
                self._go(before)
                return row
            raise WordError(f"{what} between moves that are not both lines is not supported; write the corner as blocks", 1)
        u, v = u / lengths[0], v / lengths[1]
        angle = math.acos(max(-1.0, min(1.0, float(u @ v))))
        if angle < 1e-6:
            self._go(before)
            return row
        cut = (
            size
            if what == "CHR"
            else size / (2.0 * math.cos(0.5 * angle))
            if what == "CHF" and angle < math.pi - 1e-6
            else size * math.tan(0.5 * angle)
        )
        if angle > math.pi - 1e-6 or cut > min(lengths) + 1e-9:
            raise WordError(f"{what} {size * 1e3:g} mm does not fit into the corner; make it smaller", 1)
        first, last = corner - cut * u, corner + cut * v
        self._go((before[0], first, *before[2:]))
        none = [math.nan, math.nan]
        if what in ("CHF", "CHR"):
            self._go((before[0], last, none, None, None, None, False, *before[7:]))
        else:
            normal = np.cross(u, v)
            normal = normal / np.linalg.norm(normal)
            centre = first + size * np.cross(normal, u)
            axis = arcs.PLANES[self.plane][2]
            if abs(abs(normal[axis]) - 1.0) > 1e-9:
                raise WordError(f"{what} does not lie in the plane G{self.plane}; select the plane", 1)
            self._go((mv.ARC, last, none, None, (centre, bool(normal[axis] < 0), 0), None, False, *before[7:]))
        return row

    def _arc(self, start, point, centre, extra, by_name) -> tuple:  # type: ignore[no-untyped-def, type-arg]
        """Centre, sense and turns of an arc in the plane, or an arc in space."""
        turns = int(extra.pop("TURN").value) if "TURN" in extra else 0
        if not 0 <= turns <= 10_000:
            raise WordError(f"TURN={turns} is out of range; give 0 to 10000", 1)
        if by_name == "CIP":
            middle = start.copy()
            for i, name in enumerate(("I1", "J1", "K1")):
                if name in extra:
                    item = extra.pop(name)
                    relative = item.how == "IC" or (item.how == "" and not self.absolute)
                    middle[i] = item.value * self.unit + (start[i] if relative else 0.0)
            return None, arcs.through(start, middle, point)
        if by_name == "CT":
            if self.tangent is None:
                raise WordError("CT goes on from the direction of the move before; there is none, use CIP or G2", 1)
            return None, arcs.tangential(start, self.tangent, point, self.plane)
        clockwise = self.motion == 2
        if "AR" in extra:
            item = extra.pop("AR")
            if not 0.0 < item.value < 360.0:
                raise WordError(f"AR={item.value:g}: the angle of an arc lies between 0 and 360 degrees", item.column)
            a, b, _ = arcs.PLANES[self.plane]
            angle = math.radians(item.value) * (-1.0 if clockwise else 1.0)
            if centre:
                middle = self.arc_centre(start, point, centre, None)
                arm = start[[a, b]] - middle[[a, b]]
                c, s = math.cos(angle), math.sin(angle)
                point[[a, b]] = middle[[a, b]] + [c * arm[0] - s * arm[1], s * arm[0] + c * arm[1]]
            else:
                middle = start.copy()
                chord = point[[a, b]] - start[[a, b]]
                side = 0.5 / math.tan(0.5 * angle)
                middle[[a, b]] = start[[a, b]] + 0.5 * chord + side * np.array([-chord[1], chord[0]])
            return (middle, clockwise, turns), None
        radius = extra.pop("CR").value * self.unit if "CR" in extra else None
        if radius is None and not centre:
            raise WordError("a circle needs its centre (I J K) or radius (CR=, in .ngc files R); add it to the block", 1)
        return (self.arc_centre(start, point, centre, radius), clockwise, turns), None

    def _tap(self, numbers, coordinates, centre, extra) -> tuple:  # type: ignore[no-untyped-def, type-arg]
        """G331, G332: along the thread; the feed is pitch times speed. G63 takes the feed in force."""
        if 63 in numbers:
            return mv.LINE, coordinates
        across = "IJK"[arcs.PLANES[self.plane][2]]
        if across not in centre:
            raise WordError(f"G331 and G332 need the pitch {across}; add it", 1)
        pitch = abs(centre.pop(across).value)
        if not self.out.modes.spindle:
            raise WordError("G331 and G332 need a spindle speed; give S before", 1)
        self.set_feed_mode(94)
        self.feed = pitch * self.out.modes.spindle * self.unit / self.out.modes.feed_unit
        return mv.LINE, coordinates

    def _polar(self, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """AP= and RP=: angle and radius about the pole."""
        if not extra.keys() & {"AP", "RP"}:
            return
        a, b, _ = arcs.PLANES[self.plane]
        here = self._from()
        arm = here[[a, b]] - self.pole[[a, b]]
        angle, radius = math.degrees(math.atan2(arm[1], arm[0])), float(np.hypot(*arm))
        if "AP" in extra:
            item = extra.pop("AP")
            angle = angle + item.value if item.how == "IC" else item.value
        if "RP" in extra:
            item = extra.pop("RP")
            radius = radius + item.value * self.unit if item.how == "IC" else item.value * self.unit
        for i, part in ((a, math.cos), (b, math.sin)):
            if LINEAR[i] in coordinates:
                raise WordError(f"{LINEAR[i]} stands beside AP= and RP=; keep one", coordinates[LINEAR[i]].column)
            coordinates[LINEAR[i]] = Item((self.pole[i] + radius * part(math.radians(angle))) / self.unit, "AC", 1)

    def _slanted(self, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """ANG=: a line at an angle to the first axis of the plane; one coordinate is given."""
        if "ANG" not in extra:
            return
        item = extra.pop("ANG")
        a, b, _ = arcs.PLANES[self.plane]
        first, second = LINEAR[a], LINEAR[b]
        if (first in coordinates) == (second in coordinates):
            raise WordError(f"ANG= needs one of {first} and {second} as the end of the line", item.column)
        here, tangent = self._from(), math.tan(math.radians(item.value))
        given, other, i, j = (first, second, a, b) if first in coordinates else (second, first, b, a)
        value = coordinates[given]
        end = value.value * self.unit + (here[i] if value.how == "IC" or (value.how == "" and not self.absolute) else 0.0)
        slope = tangent if given == first else (1.0 / tangent if tangent else math.inf)
        if not math.isfinite(slope) or abs(slope) > 1e9:
            raise WordError("ANG= runs along the other axis; give that coordinate", item.column)
        coordinates[other] = Item((here[j] + (end - here[i]) * slope) / self.unit, "AC", item.column)

    def _set_pole(self, number: int, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        base = {110: self._from(), 111: np.zeros(3), 112: self.pole}[number].copy()
        if extra.keys() & {"AP", "RP"}:
            angle, radius = (extra.pop(n).value if n in extra else 0.0 for n in ("AP", "RP"))
            a, b, _ = arcs.PLANES[self.plane]
            base[a] += radius * self.unit * math.cos(math.radians(angle))
            base[b] += radius * self.unit * math.sin(math.radians(angle))
        for name, item in coordinates.items():
            if name not in LINEAR:
                raise WordError(f"{name} is no coordinate of a pole", item.column)
            base[INDEX[name]] += item.value * self.unit
        self.pole = base

    def _fixed_point(self, number: int, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """G74, G75: the axes named go to their zero, or to [frame.G75], at rapid."""
        self._release()
        extra.pop("FP", None)
        home = self.frame_table(f"G{number}")
        goal, angles = np.array(self.out.position[:3]), [math.nan, math.nan]
        for name in coordinates:
            if name in LINEAR:
                goal[INDEX[name]] = home[INDEX[name]]
            elif name in ROTARY:
                angles[INDEX[name] - 3] = home[INDEX[name]]
        self.note("G74, G75: the point is the zero of the axes, or [frame.G75] x_m .. of the machine file")
        traori = self.out.modes.traori
        self.transform(False)
        goal = np.where([n in coordinates for n in LINEAR], goal, self.out.position[:3])
        self.go(mv.RAPID, goal, angles, suppress=True)
        self.transform(traori)

    # ------------------------------------------------------------------ frames

    def _settable(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        if name not in self.settable:
            self.settable[name] = np.eye(3), self.frame_table(name)
        return self.settable[name]

    @staticmethod
    def _frame_number(name: str) -> int:
        number = int(name[1:])
        return 0 if number == 500 else number - 53 if number < 60 else number - 500

    def set_frames(self) -> None:
        """Basic frame, settable frame, programmable frame, tilted plane: in this order."""
        matrix, offset = self.basic
        for inner, shift in (self._settable(self.chosen), (self.program_matrix, self.program_offset + self.fine)):
            offset = np.concatenate([offset[:3] + matrix @ shift[:3], offset[3:] + shift[3:]])
            matrix = matrix @ inner
        self.fixed_axis = None
        if self.swivelled is not None:
            inner, origin, _ = self.swivelled
            offset = np.concatenate([offset[:3] + matrix @ origin + self.to_part(), offset[3:]])
            matrix = matrix @ inner
            self.fixed_axis = matrix[:, arcs.PLANES[self.plane][2]].copy()
        self.set_frame(matrix, offset)

    def swivel(self, matrix: np.ndarray, origin: np.ndarray) -> None:
        """CYCLE800: the plane from here on; the tool stands across it."""
        self._swivel(matrix, origin)
        self.note("CYCLE800: the tool stands across the plane at once; A and C turn with the next move")

    def unswivel(self) -> None:
        """CYCLE800(): back to the plane before."""
        self._unswivel()

    def _frame_words(self, word: Word | None, shift: int | None, coordinates: dict[str, Item], extra: dict[str, Item]) -> None:
        """TRANS, ROT, SCALE, MIRROR and their additions; G58, G59."""
        self._release()
        values = {n: i.value for n, i in coordinates.items()}
        for name in OTHER:
            if values.pop(name, 0.0):
                raise WordError(f"a shift of {name} cannot be set on this machine", 1)
        name = word.name if word else ""
        if word is not None and word.text is not None and word.text.strip():
            raise WordError(f"{name} takes its axes as words, e.g. {name} X10", word.column)
        if word is not None and not name.startswith("A"):
            self.program_matrix, self.program_offset, self.fine = np.eye(3), np.zeros(5), np.zeros(5)
        shifted = np.zeros(5)
        inner = np.eye(3)
        if shift is not None:
            target = self.program_offset if shift == 58 else self.fine
            target = target.copy()
            for axis, value in values.items():
                target[INDEX[axis]] = self.si(axis, value)
            if shift == 58:
                self.program_offset = target
            else:
                self.fine = target
        elif name.endswith("TRANS"):
            for axis, value in values.items():
                shifted[INDEX[axis]] = self.si(axis, value)
        elif name in ("ROT", "AROT"):
            if "RPL" in extra:
                inner = rotation(arcs.PLANES[self.plane][2], extra.pop("RPL").value)
            else:
                inner = rotation(2, values.get("Z", 0.0)) @ rotation(1, values.get("Y", 0.0)) @ rotation(0, values.get("X", 0.0))
        elif name.endswith("SCALE"):
            if not all(values.values()):
                raise WordError(f"{name} by 0 leaves nothing; give factors other than 0", 1)
            inner = np.diag([values.get(n, 1.0) for n in LINEAR])
        elif name.endswith("MIRROR"):
            inner = np.diag([-1.0 if n in values else 1.0 for n in LINEAR])
        elif values:
            raise WordError(f"{name} is not supported: a turn by angles in space; use ROT with X Y Z", 1)
        if not name.endswith("TRANS") and shift is None and set(values) & set(ROTARY):
            raise WordError(f"{name} of A or C is not supported; let the CAM system put out the final coordinates", 1)
        self.program_offset = np.concatenate(
            [self.program_offset[:3] + self.program_matrix @ shifted[:3], self.program_offset[3:] + shifted[3:]]
        )
        self.program_matrix = self.program_matrix @ inner
        self.set_frames()

    def _write_frame(self, name: str, index: tuple, word: Word) -> None:
        """$P_UIFR and its kin: a whole frame CTRANS(..):CROT(..), or one component."""
        text, column = word.text or "", word.text_column
        target = "G500" if not index else _frame_name(index[0])
        if name in ("$P_UIFR", "$P_IFRAME"):
            target = self.chosen if name == "$P_IFRAME" else target
            old = self._settable(target)
        elif name == "$P_PFRAME":
            old = self.program_matrix, self.program_offset
        else:
            old = self.basic
        parts = [str(i) for i in index if isinstance(i, str)]
        if len(parts) == 2 and parts[1] in ("TR", "FI") and parts[0] in INDEX:
            offset = old[1].copy()
            value = self.si(parts[0], self.number_of(text, column))
            if parts[1] == "TR":
                offset[INDEX[parts[0]]] = value
            elif value:
                raise WordError("fine offsets of frames are not kept apart; add them to TR", word.column)
            new = old[0], offset
        elif len(parts) == 2 and parts[1] == "RT" and not self.number_of(text, column):
            new = old
        elif parts:
            raise WordError(f"{name}[..,{','.join(parts)}] is not supported; write the frame as CTRANS(..):CROT(..)", word.column)
        else:
            new = self._frame_of(text, column)
        if name in ("$P_UIFR", "$P_IFRAME"):
            self.settable[target] = new
        elif name == "$P_PFRAME":
            self.program_matrix, self.program_offset = new
        else:
            self.basic = new
        self._release()
        self.set_frames()

    def _frame_of(self, text: str, column: int) -> tuple[np.ndarray, np.ndarray]:
        matrix, offset = np.eye(3), np.zeros(5)
        at = 0
        while at < len(text.rstrip()):
            part = _FRAME_PART.match(text, at)
            if not part:
                raise WordError(f"'{text[at:].strip()[:20]}' is no frame; write CTRANS(X,10,Y,20):CROT(Z,45)", column + at)
            values = [t for t, _ in split_arguments(part[2])]
            inner, shift = np.eye(3), np.zeros(5)
            if part[1] == "MIRROR":
                inner = np.diag([-1.0 if n in values else 1.0 for n in LINEAR])
                pairs: dict[str, float] = {}
            else:
                pairs = {values[i]: self.number_of(values[i + 1], column) for i in range(0, len(values) - 1, 2)}
            for axis in pairs:
                if axis not in INDEX and pairs[axis]:
                    raise WordError(f"'{axis}' is no axis of this machine (X Y Z A C)", column)
            if part[1] in ("TRANS", "FINE"):
                for axis, value in pairs.items():
                    if axis in INDEX:
                        shift[INDEX[axis]] = self.si(axis, value)
            elif part[1] == "ROT":
                inner = rotation(2, pairs.get("Z", 0.0)) @ rotation(1, pairs.get("Y", 0.0)) @ rotation(0, pairs.get("X", 0.0))
            elif part[1] == "SCALE":
                inner = np.diag([pairs.get(n, 1.0) for n in LINEAR])
            offset = np.concatenate([offset[:3] + matrix @ shift[:3], offset[3:] + shift[3:]])
            matrix = matrix @ inner
            at = part.end()
        return matrix, offset


_VALUE_WORDS = {SINUMERIK_NAMES[n][1] for n in ("CR", "A3", "I1")} - {SINUMERIK_NAMES["CIP"][1]}


def _frame_name(number: Value) -> str:
    n = int(_as_number(number, 1))
    return "G500" if n == 0 else f"G{53 + n}" if n <= 4 else f"G{500 + n}"


def _as_number(value: Value, column: int) -> float:
    if isinstance(value, str):
        raise WordError(f'a number is needed here, not the text "{value[:20]}"', column)
    return float(value)
