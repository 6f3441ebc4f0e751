"""The variables of SINUMERIK programs: R parameters, DEF, system variables, frames as values, expressions."""

from __future__ import annotations

from collections.abc import Callable, Collection
import itertools
import math
import re

import numpy as np

from twin.errors import nearest
from twin.program.corners import Corners
from twin.program.expressions import SINUMERIK, Expression, Value, WordError
from twin.program.flow import Flow
from twin.program.flow import Frame as Call
from twin.program.frames import INDEX, LINEAR, NO_FRAME, OTHER, Frame, mirrored, rotation_xyz, shifted
from twin.program.reader import Values, as_number
from twin.program.state import Item, State
from twin.program.structures import Statement
from twin.program.words import Word, split_arguments

_DEF = re.compile(
    r"\s*(?:DEF|REDEF)\s+(?:(?:NCK|CHAN|SYNR|SYNRW|SYNW|INTERN)\s+)*(REAL|INT|BOOL|CHAR|STRING\s*\[\s*\d+\s*\]|AXIS|FRAME)\s+(.+)\Z", re.A
)
_WRAPPED = re.compile(r"\s*(AC|IC|DC|ACP|ACN)\s*\((.*)\)\s*\Z", re.S)
_FRAME_PART = re.compile(r"\s*(?:C(TRANS|FINE|ROT|SCALE|MIRROR)\s*\(([^()]*)\)|([A-Z_$]\w*)(?:\[([^\]]*)\])?)\s*:?")
_FRAMES = ("$P_UIFR", "$P_PFRAME", "$P_UBFR", "$P_BFRAME", "$P_CHBFR", "$P_NCBFR", "$P_IFRAME", "$P_ACTBFRAME")
"""Frames of the control that a program may read and write."""
_ZERO = ("$P_SIM", "$P_ISTEST", "$P_SEARCH", "$P_SEARCHL", "$P_DRYRUN", "$AC_ALARM_STAT", "$P_SUBPAR", "$AC_MARKER", "$AC_PARAM")
"""Variables that are 0, or that a program finds so before it has set them."""
AXIS_NAMES = {*INDEX, *OTHER, "X1", "Y1", "Z1", "A1", "C1", "B1", "TR", "FI", "RT", "SC", "MI", "SPI", "SP1"}
MOST_ELEMENTS = 100_000

G_GROUPS = {
    1: (0, 1, 2, 3), 6: (17, 18, 19), 7: (40, 41, 42), 8: (500, 54, 55, 56, 57), 10: (60, 64, 641, 642, 643, 644, 645),
    12: (601, 602, 603), 13: (70, 71, 700, 710), 14: (90, 91), 15: (93, 94, 95),
}  # fmt: skip
"""G codes by group, in the order in which G[group]=number and $P_GG[group] count them."""


class SinumerikValues(Values):
    """Values of variables, words and expressions."""

    def __init__(self, state: State, flow: Flow, corners: Corners, names: Collection[str]) -> None:
        super().__init__(state, flow, SINUMERIK)
        self.corners, self.names = corners, names
        self.settable: dict[str, Frame] = {}
        self.chosen = "G500"  # settable frame in force
        self.unset: set[str] = set()  # values that a call would give, of a subprogram that is read as the program
        self.parameters: dict[int, float] = {}
        self.globals: dict[str, dict[tuple, Value]] = {}
        self.frame_variables: dict[str, Frame] = {}  # DEF FRAME

    def settable_frame(self, name: str) -> Frame:
        """A frame from the program or the machine file."""
        return self.settable.setdefault(name, shifted(self.state.frame_table(name)))

    def choose(self, name: str) -> None:
        """Select a settable frame."""
        self.corners.release()
        self.chosen = name
        self.state.set_frames(settable=self.settable_frame(name))

    def define(self, s: Statement, frame: Call) -> None:
        match = _DEF.match(s.text)
        if not match:
            raise WordError("DEF needs a type and names, e.g. DEF REAL LENGTH=10", s.column)
        start: Value = "" if match[1].startswith(("STRING", "CHAR", "AXIS")) else 0.0
        for part, _ in split_arguments(match[2]):
            name, _, value = part.partition("=")
            shape = re.match(r"\s*([A-Z_$][A-Z0-9_$]*)\s*(?:\[(.*)\])?\s*\Z", name, re.A)
            if not shape:
                raise WordError(f"'{part[:30]}' is not a definition; write a name, e.g. DEF REAL LENGTH=10", s.column)
            store: dict[tuple, Value] = {("default",): start}
            if shape[2]:
                sizes = [int(self.number_of(n, s.column)) for n, _ in split_arguments(shape[2])]
                if math.prod(sizes) > MOST_ELEMENTS:
                    raise WordError(f"an array of {math.prod(sizes)} elements is too large", s.column)
                store[("size",)] = float(len(sizes))
                places = list(itertools.product(*(map(float, range(n)) for n in sizes)))
            else:
                places = [()]
            if value.strip() and match[1] != "FRAME":
                values = re.match(r"\s*(SET|REP)?\s*\((.*)\)\s*\Z", value) if shape[2] else None
                items = [item for item, _ in split_arguments(values[2])] if values else [value]
                if values and values[1] == "REP" and items[:1]:  # one value for all elements
                    store[("default",)] = self.value_of(items[0], s.column)
                else:
                    store |= {place: self.value_of(item, s.column) for place, item in zip(places, items) if item}
            frame.variables[shape[1]] = store
            if match[1] == "FRAME":
                self.frame_variables[shape[1]] = self._frame_of(value, s.column)

    def number_of(self, text: str, column: int) -> float:
        if not text.strip():
            raise WordError("a condition or number is missing, e.g. IF R1<10", column)
        return super().number_of(text, column)

    def store_of(self, name: str) -> dict[tuple, Value] | None:
        return self.flow.frame.variables.get(name) or self.globals.get(name)

    def variable(self, e: Expression, name: str, at: int) -> Value:
        index: tuple = ()
        if e.peek() == "[":
            index = tuple(e.arguments())
        elif name == "ISVAR" and e.peek() == "(":
            asked = str(e.arguments()[0]).partition("[")[0].upper()
            return float(self.store_of(asked) is not None or bool(re.fullmatch(r"R\d+", asked)))
        elif e.peek() == "(" and name not in ("AC", "IC", "DC"):
            raise e.fail(f"'{name}' is not a function that is read here; write its value instead", at)
        if match := re.fullmatch(r"R(\d{1,4})", name):
            return self.parameters.get(int(match[1]), 0.0)
        if name == "R" and len(index) == 1 and not isinstance(index[0], str):
            return self.parameters.get(int(index[0]), 0.0)
        if (store := self.store_of(name)) is not None:
            if index in store:
                return store[index]
            if ("default",) in store:
                return store[("default",)]
        if (value := self._system(name, index)) is not None:
            return value
        key = name + (f"[{','.join(str(i) if isinstance(i, str) else f'{i:g}' for i in index)}]" if index else "")
        if (value := self.state.given(key, key.lower())) is not None:
            return value
        if name in AXIS_NAMES and not index:
            return name
        if name in self.unset:
            raise e.fail(f"'{name}' is a value that a call gives this subprogram; read the program that calls it", at)
        raise e.fail(f"variable '{key}' has no value here; define it (DEF), or give it in the table [variables] of the machine file", at)

    def _system(self, name: str, index: tuple) -> Value | None:
        """System variables with a meaning here."""
        s, tools, modes = self.state, self.state.tools, self.state.out.modes
        values: dict[str, Callable[[], Value]] = {
            **dict.fromkeys(_ZERO, lambda: 0.0), "$P_F": lambda: 0.0 if math.isnan(s.feed) else s.feed,
            "$P_S": lambda: modes.spindle, "$P_SDIR": lambda: modes.spindle, "$P_TOOLNO": lambda: float(tools.name) if tools.name.isdigit() else 0.0,
            "$P_TOOL": lambda: float(tools.name not in ("", "0")), "$P_TOOLR": lambda: tools.radius(tools.name, 1) / s.unit,
            "$P_UIFRNUM": lambda: float(frame_number(self.chosen)), "$P_PROG": lambda: self.flow.frame.unit.name,
            "$P_PROGPATH": lambda: self.flow.frame.unit.name, "$P_STACK": lambda: float(len(self.flow.frames) - 1),
        }  # fmt: skip
        if name in values:
            return values[name]()
        first = s.slot_of.get(str(index[0]), str(index[0])) if index else ""
        if name in ("$P_EP", "$AA_IW", "$AA_IM", "$AA_MW", "$P_EPM") and len(index) == 1 and first in INDEX:
            i, machine = INDEX[first], name == "$AA_IM"
            if i >= 3:
                return math.degrees(float(s.out.settle()[i - 3]) - (0.0 if machine else s.offset[i]))
            return float((np.array(s.out.position[:3]) if machine else s.here())[i]) / s.unit
        if name == "$TC_DP6" and index:
            return tools.radius(_tool_name(index[0]), 1) / s.unit
        if name == "$P_UIFR" and len(index) == 3 and index[1] in INDEX:
            i, offset = INDEX[index[1]], self.settable_frame(frame_name(index[0])).shift
            return {"TR": math.degrees(offset[i]) if i >= 3 else offset[i] / s.unit, "FI": 0.0}.get(str(index[2]))
        if name == "$P_GG" and len(index) == 1:
            groups = {
                1.0: 1 + (s.motion or 0), 6.0: s.plane - 16, 7.0: 1 if s.comp is None else 2 if s.comp.offset > 0 else 3,
                8.0: frame_number(self.chosen) + 1, 13.0: 1 if s.unit != 1e-3 else 2, 14.0: 1 + (not s.absolute),
            }  # fmt: skip
            return float(groups[index[0]]) if index[0] in groups else None
        if name in ("$P_AXN1", "$P_AXN2", "$P_AXN3"):
            slots = {slot: letter for letter, slot in s.slot_of.items()}
            return slots.get("XYZ"[int(name[-1]) - 1], "XYZ"[int(name[-1]) - 1])
        return None

    def assign(self, name: str, value: Value, column: int, index: tuple = ()) -> None:
        """Assign a value to a variable."""
        if "[" in name:
            name, _, inner = name.partition("[")
            index = tuple(self.value_of(t, column) for t, _ in split_arguments(inner.rstrip("]")))
        if match := re.fullmatch(r"R(\d{1,4})", name):
            self.parameters[int(match[1])] = as_number(value, column)
            return
        if name == "R" and len(index) == 1:
            self.parameters[int(as_number(index[0], column))] = as_number(value, column)
            return
        store = self.store_of(name)
        if store is None:
            if name[0] not in "_$" and self.state.given(name, name.lower()) is None:
                hint = nearest(name, self.names)
                hint = f"; {hint}" if hint.startswith("did you") else ""
                raise WordError(
                    f"word '{name}' is not known and no variable of this name is defined{hint}; define it (DEF), or give it in the table "
                    "[variables] of the machine file",
                    column,
                )
            self.state.note(f"{name}: a variable of the control, kept for the program")
            store = self.globals.setdefault(name, {})
        if len(store) > MOST_ELEMENTS:
            raise WordError(f"{name} has more than {MOST_ELEMENTS} elements", column)
        store[index] = value

    def value(self, word: Word) -> float:
        if word.assigned:
            return self.number_of(word.text or "", word.text_column)
        if word.value is None:
            raise WordError(f"'{word.name}' needs a number", word.column)
        return word.value

    def item(self, word: Word) -> Item:
        """A coordinate and its mode (absolute, incremental, ...)."""
        if word.assigned and (match := _WRAPPED.match(word.text or "")):
            return Item(self.number_of(match[2], word.text_column + match.start(2)), match[1], word.column)
        if word.text is not None and not word.assigned:
            raise WordError(f"'{word.name}({word.text})' is not a coordinate; write {word.name}=AC(..) or {word.name}=IC(..)", word.column)
        return Item(self.value(word), "", word.column)

    def axis_of(self, word: Word) -> str:
        """The axis of POS[X], AX[_AXIS] and the like: its name, or a variable of type AXIS."""
        text = (word.index or "").strip()
        if text not in AXIS_NAMES:
            text = str(self.value_of(text, word.column)).strip()
        return text.removesuffix("1")

    def of_group(self, word: Word) -> float:
        """The G code of G[6]=1: the first of group 6."""
        group = int(self.number_of(word.index or "", word.column))
        number = int(self.value(word))
        if group == 8 and number > 5:
            return 500.0 + number - 1
        codes = G_GROUPS.get(group, ())
        if not 1 <= number <= len(codes):
            raise WordError(f"G[{group}]={number} is not read; write the G code itself", word.column)
        return float(codes[number - 1])

    def assignment(self, word: Word) -> None:
        """A variable of any kind; frames are written whole or by component."""
        name = word.name
        index: tuple = ()
        if word.index is not None:
            index = tuple(self.value_of(t, word.column) for t, _ in split_arguments(word.index))
        if name in _FRAMES or name in self.frame_variables:
            self._write_frame(name, index, word)
            return
        value = self.value_of(word.text or "", word.text_column)
        if name == "$TC_DP6" and len(index) == 2:
            self.state.tools.set_value(_tool_name(index[0]), "radius", as_number(value, word.column) * self.state.unit)
            return
        if name.startswith("$TC_DP3"):
            self.state.note("$TC_DP3: tool lengths are those of the table [tool] of the machine file")
        self.assign(name, value, word.column, index)

    def _write_frame(self, name: str, index: tuple, word: Word) -> None:
        """A frame of the control or a variable of type FRAME: whole, CTRANS(..):CROT(..), or one component."""
        text, column = word.text or "", word.text_column
        old = self._frame_named(name, index)
        parts = [self.state.slot_of.get(i, i) for i in index if isinstance(i, str)]
        if len(parts) == 2 and parts[1] in ("TR", "FI") and parts[0] in INDEX:
            offset = old.shift.copy()
            value = self.state.si(parts[0], self.number_of(text, column))
            if parts[1] == "TR":
                offset[INDEX[parts[0]]] = value
            elif value:
                raise WordError("fine offsets of frames are not kept apart; add them to TR", word.column)
            new = Frame(old.matrix, offset)
        elif len(parts) == 2 and parts[1] == "RT" and not self.number_of(text, column):
            new = old
        elif parts:
            raise WordError(f"{name}[..,{','.join(parts)}] is not supported; write the frame as CTRANS(..):CROT(..)", word.column)
        else:
            new = self._frame_of(text, column)
        if name in self.frame_variables:
            self.frame_variables[name] = new
            return
        if name in ("$P_UIFR", "$P_IFRAME"):
            self.settable[self._settable_name(name, index)] = new
            self.choose(self.chosen)
        else:
            self.choose(self.chosen)
            self.state.set_frames(**{"program" if name == "$P_PFRAME" else "basic": new})

    def _settable_name(self, name: str, index: tuple) -> str:
        return self.chosen if name == "$P_IFRAME" else frame_name(index[0]) if index and not isinstance(index[0], str) else "G500"

    def _frame_named(self, name: str, index: tuple) -> Frame:
        """The frame of a variable or of the control."""
        if name in self.frame_variables:
            return self.frame_variables[name]
        if name in ("$P_UIFR", "$P_IFRAME"):
            return self.settable_frame(self._settable_name(name, index))
        return self.state.frames["program" if name == "$P_PFRAME" else "basic"]

    def _frame_of(self, text: str, column: int) -> Frame:
        """The frames of a chain CTRANS(..):CROT(..):F1 as one; an empty text changes nothing."""
        whole, at = NO_FRAME, 0
        while at < len(text.rstrip()):
            part = _FRAME_PART.match(text, at)
            if not part or (part[3] and part[3] not in _FRAMES and part[3] not in self.frame_variables):
                raise WordError(f"'{text[at:].strip()[:20]}' is not a frame; write CTRANS(X,10,Y,20):CROT(Z,45)", column + at)
            at = part.end()
            if part[3]:
                whole = whole @ self._frame_named(part[3], tuple(self.value_of(t, column) for t, _ in split_arguments(part[4] or "")))
                continue
            values = [self.state.slot_of.get(t, t) for t, _ in split_arguments(part[2])]
            if part[1] == "MIRROR":
                whole = whole @ Frame(mirrored(values), np.zeros(5))
                continue
            pairs = {values[i]: self.number_of(values[i + 1], column) for i in range(0, len(values) - 1, 2)}
            for axis in pairs:
                if axis not in INDEX and pairs[axis]:
                    raise WordError(f"'{axis}' is not an axis of this machine (X Y Z A C)", column)
            if part[1] in ("TRANS", "FINE"):
                whole = whole @ shifted({axis: self.state.si(axis, value) for axis, value in pairs.items() if axis in INDEX})
            else:
                matrix = rotation_xyz(pairs) if part[1] == "ROT" else np.diag([pairs.get(n, 1.0) for n in LINEAR])
                whole = whole @ Frame(matrix, np.zeros(5))
        return whole


def _tool_name(index: Value) -> str:
    return index if isinstance(index, str) else f"{index:g}"


def frame_name(number: Value) -> str:
    n = int(as_number(number, 1))
    return "G500" if n == 0 else f"G{53 + n}" if n <= 4 else f"G{500 + n}"


def frame_number(name: str) -> int:
    """The number of a settable frame: 0 for G500, 1 for G54."""
    number = int(name[1:])
    return 0 if number == 500 else number - 53 if number < 60 else number - 500
