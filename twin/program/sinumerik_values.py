"""Words and values of SINUMERIK programs: R parameters, DEF, system variables, frames as values, expressions.

A block is split into words: an address with a number (`X10.5`, `G641`), an assignment (`X=R1+5`, `A3=0.1`, `FL[X]=500`,
`R3=SIN(30)`), a name with arguments (`CYCLE832(0.01,3)`, `MSG("text")`) or a bare name (`TRAORI`).
"""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
import itertools
import math
import re
from typing import Any

import numpy as np

from twin.errors import nearest
from twin.program.expressions import NUMBER, SINUMERIK, Expression, Value, WordError, as_number, as_text, closing, needed, outside_quotes
from twin.program.flow import Call, Statement
from twin.program.frames import INDEX, LINEAR, NO_FRAME, OTHER, Frame, mirrored, rotation_xyz, shifted
from twin.program.reader import Reader
from twin.program.state import Item

_ASSIGN = re.compile(r"([A-Z_$][A-Z_$][A-Z0-9_$]*|[A-Z]\d*)[ \t]*(?==(?!=)|\[)", re.A)
_OTHER = re.compile(rf"([A-Z])[ \t]*({NUMBER})|([A-Z_$][A-Z0-9_$]*)", re.A)
_DEF = re.compile(
    r"\s*(?:DEF|REDEF)\s+(?:(?:NCK|CHAN|SYNR|SYNRW|SYNW|INTERN)\s+)*(REAL|INT|BOOL|CHAR|STRING\s*\[\s*\d+\s*\]|AXIS|FRAME)\s+(.+)\Z", re.A
)
_WRAPPED = re.compile(r"\s*(AC|IC|DC|ACP|ACN)\s*\((.*)\)\s*\Z", re.S)
_FRAMES = ("$P_UIFR", "$P_PFRAME", "$P_UBFR", "$P_BFRAME", "$P_CHBFR", "$P_NCBFR", "$P_IFRAME", "$P_ACTBFRAME")
"""Frames of the control that a program may read and write."""
_FRAME_FUNCTIONS = ("CTRANS", "CFINE", "CROT", "CSCALE", "CMIRROR")
_ZERO = ("$P_SIM", "$P_ISTEST", "$P_SEARCH", "$P_SEARCHL", "$P_DRYRUN", "$AC_ALARM_STAT", "$P_SUBPAR", "$AC_MARKER", "$AC_PARAM")
"""Variables that are 0, or that a program finds so before it has set them."""
AXIS_NAMES = {*INDEX, *OTHER, "X1", "Y1", "Z1", "A1", "C1", "B1", "TR", "FI", "RT", "SC", "MI", "SPI", "SP1"}
MOST_ELEMENTS = 100_000

G_GROUPS = {
    1: (0, 1, 2, 3), 6: (17, 18, 19), 7: (40, 41, 42), 8: (500, 54, 55, 56, 57), 10: (60, 64, 641, 642, 643, 644, 645),
    12: (601, 602, 603), 13: (70, 71, 700, 710), 14: (90, 91), 15: (93, 94, 95),
}  # fmt: skip
"""G codes by group, in the order of G[group]=number and $P_GG[group]."""

Store = dict[tuple, Value]
"""The elements of a variable by their index, () of a plain one; ("default",) is that of the others."""


@dataclass(frozen=True)
class Written:
    """One word: `value` of an address, `text` right of an assignment or between brackets (None if there is none)."""

    name: str
    column: int
    value: float | None = None
    text: str | None = None
    assigned: bool = False
    text_column: int = 0
    index: str | None = None


def split_words(line: str) -> list[Written]:
    """The words of a line in capitals, without comment."""
    words, e = [], Expression(line, SINUMERIK, None)
    while e.peek():
        words.append(_word(e))
    return words


def _word(e: Expression) -> Written:
    """The word at the place of the expression, which goes behind it."""
    at, line, text, column, index = e.at, e.text, None, 0, None
    if match := _ASSIGN.match(line, at):
        e.at = match.end()
        if line[e.at] == "[":
            index = _inside(e)
            if e.peek() != "=" or line.startswith("==", e.at):
                raise WordError(f"'{match[1]}[{index}]' is not given a value; add '='", at + 1)
        begin = e.at = e.at + 1
        e.value()
        return Written(match[1], at + 1, None, line[begin : e.at].rstrip(), True, begin + 1, index)
    match = needed(_OTHER.match(line, at), f"'{line[at]}' starts no word", at + 1)
    e.at, value = match.end(), float(match[2]) if match[2] else None
    if value is not None and not math.isfinite(value):
        raise WordError("the number is too large", at + 1)
    behind = e.peek() if match[3] else line[e.at : e.at + 1] if match[1] == "L" else ""
    if behind == "(":
        column = e.at + 2
        text = _inside(e)
    elif behind == '"' and match[3] in ("CALL", "PCALL", "EXTCALL"):
        column = e.at + 1
        text = f'"{e.atom()}"'
    return Written(match[1] or match[3], at + 1, value, text, False, column)


def _inside(e: Expression) -> str:
    """The text between the brackets at the place of the expression, which goes behind them."""
    begin, e.at = e.at + 1, closing(e.text, e.at) + 1
    return e.text[begin : e.at - 1]


def split_arguments(text: str) -> list[tuple[str, int]]:
    """Arguments between commas, each with its start; an empty text has none."""
    commas = [i for i, char, depth in outside_quotes(text) if char == "," and depth == 0]
    starts = [0, *(i + 1 for i in commas)]
    return [(text[a:b].strip(), a) for a, b in zip(starts, [*commas, len(text)])] if text.strip() else []


class SinumerikValues:
    """Values of variables, words and expressions."""

    def __init__(self, m: Reader, names: Collection[str]) -> None:
        self.m, self.state, self.flow, self.corners, self.names = m, m.state, m.flow, m.corners, names
        self.settable: dict[str, Frame] = {}
        self.chosen = "G500"  # settable frame in force
        self.unset: set[str] = set()  # values that a call would give, of a subprogram that is read as the program
        self.globals: dict[str, Store] = {"R[]": {("default",): 0.0}}

    def settable_frame(self, name: str) -> Frame:
        """A frame from the program or the machine file."""
        return self.settable.setdefault(name, shifted(self.state.frame_table(name)))

    def choose(self, name: str) -> None:
        """Select a settable frame."""
        self.corners.release()
        self.chosen = name
        self.state.set_frames(settable=self.settable_frame(name))

    def define(self, s: Statement, frame: Call) -> None:
        """DEF: variables of a program or subprogram, with the values that they start with."""
        match = needed(_DEF.match(s.text), "DEF needs a type and names, e.g. DEF REAL LENGTH=10", s.column)
        start: Value = "" if match[1].startswith(("STRING", "CHAR", "AXIS")) else NO_FRAME if match[1] == "FRAME" else 0.0
        for part, _ in split_arguments(match[2]):
            name, _, value = part.partition("=")
            shape = re.match(r"\s*([A-Z_$][A-Z0-9_$]*)\s*(?:\[(.*)\])?\s*\Z", name, re.A)
            if not shape:
                raise WordError(f"'{part[:30]}' is not a definition; write a name, e.g. DEF REAL LENGTH=10", s.column)
            store: Store = {("default",): start}
            places: list[tuple] = [()]
            items = [value]
            if shape[2]:
                sizes = [int(self.m.number_of(n, s.column)) for n, _ in split_arguments(shape[2])]
                if math.prod(sizes) > MOST_ELEMENTS:
                    raise WordError(f"an array of {math.prod(sizes)} elements is too large", s.column)
                places = list(itertools.product(*(map(float, range(n)) for n in sizes)))
                if values := re.match(r"\s*(SET|REP)?\s*\((.*)\)\s*\Z", value):
                    items = [item for item, _ in split_arguments(values[2])]
                    if values[1] == "REP":  # one value for all elements
                        places = [("default",)]
            store |= {place: self.m.value_of(item, s.column) for place, item in zip(places, items) if item.strip()}
            frame.variables[shape[1]] = store

    def indices(self, text: str | None, column: int) -> tuple:
        """The values of an index."""
        return tuple(self.m.value_of(part, column) for part, _ in split_arguments(text or ""))

    def store_of(self, name: str) -> Store | None:
        """The elements of a variable that is defined."""
        return self.flow.frame.variables.get(name) or self.globals.get(name)

    def variable(self, e: Expression, name: str, at: int) -> Value:
        """The value of a name at a column of an expression."""
        index: tuple = ()
        if e.peek() == "[":
            index = tuple(e.arguments())
        elif name in _FRAME_FUNCTIONS and e.peek() == "(":
            return self._frame(name, e.arguments(), e.column + at)
        elif name == "ISVAR" and e.peek() == "(":
            named = needed(next(iter(e.arguments()), None), 'ISVAR needs a name, e.g. ISVAR("R5")', e.column + at)
            asked = str(named).partition("[")[0].upper()
            return float(self.store_of(asked) is not None or bool(re.fullmatch(r"R\d+", asked)))
        elif e.peek() == "(" and name not in ("AC", "IC", "DC"):
            raise e.fail(f"'{name}' is not a function that is read here; write its value instead", at)
        kept, place = _element(name, index)
        if (store := self.store_of(kept)) is not None and (value := store.get(place, store.get(("default",)))) is not None:
            return value
        if (value := self._system(name, index)) is not None:
            return value
        key = name + (f"[{','.join(map(as_text, index))}]" if index else "")
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
        if name in _FRAMES and len(index) < 2:
            return self._frame_named(name, index)
        first = s.slot_of.get(str(index[0]), str(index[0])) if index else ""
        if name in ("$P_EP", "$AA_IW", "$AA_IM", "$AA_MW", "$P_EPM") and len(index) == 1 and first in INDEX:
            i, machine = INDEX[first], name == "$AA_IM"
            if i >= 3:
                return math.degrees(float(s.out.settle()[i - 3]) - (0.0 if machine else s.offset[i]))
            return float((np.array(s.out.position[:3]) if machine else s.here())[i]) / s.unit
        if name == "$TC_DP6" and index:
            return tools.radius(as_text(index[0]), 1) / s.unit
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
            index = self.indices(inner.rstrip("]"), column)
        name, index = _element(name, index)
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
        store[index] = as_number(value, column) if name == "R[]" else value

    def value(self, word: Written) -> float:
        if word.assigned:
            return self.m.number_of(word.text or "", word.text_column)
        return needed(word.value, f"'{word.name}' needs a number", word.column)

    def item(self, word: Written) -> Item:
        """A coordinate and its mode (absolute, incremental, ...)."""
        if word.assigned and (match := _WRAPPED.match(word.text or "")):
            return Item(self.m.number_of(match[2], word.text_column + match.start(2)), match[1], word.column)
        if word.text is not None and not word.assigned:
            raise WordError(f"'{word.name}({word.text})' is not a coordinate; write {word.name}=AC(..) or {word.name}=IC(..)", word.column)
        return Item(self.value(word), "", word.column)

    def axis_of(self, word: Written) -> str:
        """The axis of POS[X], AX[_AXIS] and the like: its name, or a variable of type AXIS."""
        text = (word.index or "").strip()
        if text not in AXIS_NAMES:
            text = as_text(self.m.value_of(text, word.column)).strip()
        return text.removesuffix("1")

    def of_group(self, word: Written) -> float:
        """The G code of G[6]=1: the first of group 6."""
        group = int(self.m.number_of(word.index or "", word.column))
        number = int(self.value(word))
        if group == 8 and number > 5:
            return 500.0 + number - 1
        codes = G_GROUPS.get(group, ())
        if not 1 <= number <= len(codes):
            raise WordError(f"G[{group}]={number} is not read; write the G code itself", word.column)
        return float(codes[number - 1])

    def assignment(self, word: Written) -> None:
        """A variable of any kind; frames are written whole or by component."""
        name, index = word.name, self.indices(word.index, word.column)
        value = self.m.value_of(word.text or "", word.text_column)
        if name in _FRAMES or isinstance((self.store_of(name) or {}).get(("default",)), Frame):
            self._write_frame(word, index, value)
        elif name == "$TC_DP6" and len(index) == 2:
            self.state.tools.set_value(as_text(index[0]), "radius", as_number(value, word.column) * self.state.unit)
        else:
            if name.startswith("$TC_DP3"):
                self.state.note("$TC_DP3: tool lengths are those of the table [tool] of the machine file")
            self.assign(name, value, word.column, index)

    def _write_frame(self, word: Written, index: tuple, value: Value) -> None:
        """A frame of the control or a variable of type FRAME: whole, CTRANS(..):CROT(..), or one component."""
        name, new = word.name, value
        if parts := [self.state.slot_of.get(i, i) for i in index if isinstance(i, str)]:
            new = self._frame_named(name, index)
            if len(parts) != 2 or parts[1] not in ("TR", "FI", "RT") or parts[0] not in INDEX or (parts[1] == "RT" and value):
                raise WordError(f"{name}[..,{','.join(parts)}] is not supported; write the frame as CTRANS(..):CROT(..)", word.column)
            if parts[1] == "FI" and value:
                raise WordError("fine offsets of frames are not kept apart; add them to TR", word.column)
            if parts[1] == "TR":
                shift = new.shift.copy()
                shift[INDEX[parts[0]]] = self.state.si(parts[0], as_number(value, word.text_column))
                new = Frame(new.matrix, shift)
        if not isinstance(new, Frame):
            raise WordError(f"'{(word.text or '').strip()[:20]}' is not a frame; write CTRANS(X,10,Y,20):CROT(Z,45)", word.text_column)
        place, key = self._place_of(name, index)
        place[key] = new
        if self.store_of(name) is None:
            self.choose(self.chosen)

    def _place_of(self, name: str, index: tuple) -> tuple[dict, Any]:
        """Where a frame stands: a variable, a settable frame, or a frame of the state; and its key there."""
        if (store := self.store_of(name)) is not None:
            return store, ()
        if name not in ("$P_UIFR", "$P_IFRAME"):
            return self.state.frames, "program" if name == "$P_PFRAME" else "basic"
        numbered = frame_name(index[0]) if index and not isinstance(index[0], str) else "G500"
        return self.settable, self.chosen if name == "$P_IFRAME" else numbered

    def _frame_named(self, name: str, index: tuple) -> Frame:
        """The frame of a variable or of the control."""
        place, key = self._place_of(name, index)
        found = self.settable_frame(key) if place is self.settable else place.get(key, NO_FRAME)
        assert isinstance(found, Frame)
        return found

    def _frame(self, name: str, given: list[Value], column: int) -> Frame:
        """CTRANS, CFINE, CROT, CSCALE, CMIRROR of axes and their values."""
        values = [self.state.slot_of.get(v, v) if isinstance(v, str) else v for v in given]
        places = values[::2], values[1::2]
        if name == "CMIRROR":
            places = values, [0.0] * len(values)
        pairs = {str(axis): as_number(value, column) for axis, value in zip(*places)}
        for axis in pairs:
            if axis not in INDEX and pairs[axis]:
                raise WordError(f"'{axis}' is not an axis of this machine (X Y Z A C)", column)
        return self.frame_of(name[1:], pairs)

    def frame_of(self, name: str, values: Mapping[str, float]) -> Frame:
        """The frame of TRANS, FINE, ROT, SCALE or MIRROR with the values of its axes [program units, deg, factors]."""
        if name in ("TRANS", "FINE"):
            return shifted(np.array([self.state.si(axis, values.get(axis, 0.0)) for axis in INDEX]))
        if name == "SCALE" and not all(values.values()):
            raise WordError("SCALE by 0 leaves nothing; give factors other than 0")
        scale = np.diag([values.get(n, 1.0) for n in LINEAR])
        return Frame(rotation_xyz(values) if name == "ROT" else mirrored(values) if name == "MIRROR" else scale, np.zeros(5))


def _element(name: str, index: tuple) -> tuple[str, tuple]:
    """The variable and the element of it that a name and its index mean: R5 and R[5] are the element 5 of the R parameters."""
    if match := re.fullmatch(r"R(\d{1,4})", name):
        return "R[]", (float(match[1]),)
    return ("R[]", (float(int(index[0])),)) if name == "R" and len(index) == 1 and isinstance(index[0], float) else (name, index)


def frame_name(number: Value) -> str:
    n = int(as_number(number, 1))
    return "G500" if n == 0 else f"G{53 + n}" if n <= 4 else f"G{500 + n}"


def frame_number(name: str) -> int:
    """The number of a settable frame: 0 for G500, 1 for G54."""
    number = int(name[1:])
    return 0 if number == 500 else number - 53 if number < 60 else number - 500
