"""The reader of SINUMERIK programs: lines, the words of a block by their use, subprograms, and what the dialect keeps from block to block."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
import re

import numpy as np

from twin.errors import nearest
from twin.machine.machine import Machine
from twin.program.expressions import NUMBER, SINUMERIK, Value, WordError, as_text, needed, outside_quotes
from twin.program.flow import Call, Forms, Statement, statement_of
from twin.program.frames import INDEX, OTHER
from twin.program.reader import Reader
from twin.program.sinumerik_values import SinumerikValues, Store, Written, split_arguments, split_words
from twin.program.source import Unit, plain_name
from twin.program.state import REFUSED, Item, Word
from twin.program.state import Block as Words

SINUMERIK_FRAMES = ("basic", "settable", "fine", "program", "plane")
"""Outermost first; `fine` is G59."""
_LABEL = re.compile(r"\s*(?:[N:]\d+\s*)?([A-Z_][A-Z_][A-Z0-9_]*)\s*:(?!=)", re.A)
_NUMBERED = re.compile(r"\s*[N:](\d+)", re.A)
_FLOW = re.compile(
    r"\s*(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|UNTIL|GOTO[FBCS]?|REPEATB?|CASE|ENDLABEL|PROC|DEF|REDEF|DEFINE|EXTERN)\b(?!\s*=[^=])",
    re.A,
)
_LABELS = r"(?P<target>[A-Z_N][A-Z0-9_]*)"
FORMS: Forms = (
    ("goto", re.compile(r"\s*(?:IF\b(?P<text>.*?)\b)?GOTO(?P<way>[FBCS]?)(?:(?<=S)|\s+(?P<target>[A-Z0-9_]+))\s*\Z", re.A)),
    ("", re.compile(r"\s*(?P<kind>IF|WHILE|UNTIL)\b(?!.*\bGOTO[FBCS]?\b)(?P<text>.*)\Z", re.A)),
    ("", re.compile(r"\s*(?P<kind>ELSE|ENDIF|ENDWHILE|ENDFOR|LOOP|ENDLOOP|REPEAT)B?\s*\Z", re.A)),
    ("repeat_label", re.compile(
        rf"\s*REPEAT(?P<way>B?)\s+{_LABELS}(?:\s+(?!P\s*=?\s*[\dR])(?P<last>[A-Z_][A-Z0-9_]*))?(?:\s+P\s*=?\s*(?P<times>\d+|R\d+|[A-Z_]\w*))?\s*\Z", re.A)),
    ("for", re.compile(r"\s*FOR\s*(?P<target>[A-Z_][A-Z0-9_]*(?:\[[^\]]*\])?)\s*=\s*(?P<text>.+?)\s+TO\s+(?P<last>.+)\Z", re.A)),
    ("label", re.compile(r"\s*ENDLABEL\b", re.A)),
    ("", re.compile(r"\s*(?P<text>(?P<kind>CASE|PROC|DEF|REDEF|DEFINE|EXTERN)\b.*)\Z", re.A)),
)  # fmt: skip
"""Statements that begin with a word of the flow."""
OTHER_FORMS: Forms = (
    ("label", re.compile(r"\s*\Z")),
    ("repeat_label", re.compile(rf"\s*CALL\s+BLOCK\s+{_LABELS}\s+TO\s+(?P<last>[A-Z_N][A-Z0-9_]*)\s*\Z", re.A)),
    ("synchronised", re.compile(r"\s*(?:IDS?\s*=\s*\d+\s*)?(?:\b(?:WHEN|WHENEVER|EVERY|FROM)\b.*)?\bDO\b(?P<text>.*)\Z", re.A)),
)
_GOTO = "GOTO needs one label or block number, e.g. GOTOF END1"
_REPEAT = "REPEAT needs a label, e.g. REPEAT PART1 P=3 or REPEAT FROM1 TO1"
HINTS = {"IF": _GOTO, "GOTO": _GOTO, "REPE": _REPEAT, "FOR": "FOR needs a variable and its ends, e.g. FOR I=1 TO 10"}
"""What to do where a statement does not fit, by the first letters of its word."""
_COMMENT = re.compile(
    r"((?:^|:)\s*(?:N\d+\s*)?|\s[A-KM-Z]=?[-+]?(?:\d+\.?\d*|\.\d+)\s*|\b[A-Z_]\w*\s*=\s*[-+]?(?:\d+\.?\d*|\.\d+)\s+)\(([^()\"]*(?:\([^()\"]*\)[^()\"]*)*)\)(?=\s*(?:[A-Z]|\Z))",
    re.A,
)
ADD_FILE = "add the file, or list it in [program] calls_without_motion of the machine file if it moves no axis"
_DEFINE = re.compile(r"\s*DEFINE\s+([A-Z_][A-Z0-9_]*)\s+AS\s+(.+?)\s*\Z", re.A)
_QUIET = re.compile(
    r"\s*(?:M\d*=?\d+|H\d*=?\d+|(?:\$A_OUTA?|\$AC_MARKER|\$AC_PARAM|\$AC_TIMER|\$R|\$A_DB\w+|\$A_DLB|\$AC_FIFO\d*)\s*(?:\[[^\]]*\])?\s*=\s*[^ ]+|SETAL\([^)]*\))",
    re.A,
)
_CASE = re.compile(r"\s*CASE\s*(.+?)\s+OF\b(.*)\Z", re.A)
_CASE_PART = re.compile(r"\s*(DEFAULT|[^\s].*?)\s+(GOTO[FBC]?)\s+([A-Z0-9_]+)", re.A)
_PROC = re.compile(r"\s*PROC\s+([A-Z_][A-Z0-9_]*)\s*(?:\((.*?)\))?", re.A)
_INDEXED_AXES = {"POS", "POSA", "AX"}
_MACHINE_AXES = {"X1", "Y1", "Z1", "A1", "B1", "C1"}


@dataclass
class Block(Words):
    """The words of one block by their use."""

    tool: dict[str, tuple[Value, int]] = field(default_factory=dict)  # T D H: value and column
    names: list[Written] = field(default_factory=list)  # words without a number
    calls: list[Written] = field(default_factory=list)  # subprograms
    curve: str = ""  # CIP or CT

    def has(self, *names: str) -> bool:
        """Whether one of these names stands in the block."""
        return any(word.name in names for word in self.names)


class Sinumerik(Reader):
    """Reads the blocks of one SINUMERIK program."""

    grammar = SINUMERIK

    def __init__(
        self, path: Path, machine: Machine, units: list[Unit], names: Mapping[str, Word], carry_out: Callable[[Sinumerik, Block], None]
    ) -> None:
        super().__init__(path, machine, "sinumerik", units[0], SINUMERIK_FRAMES)
        self.known, self.carry_out = names, partial(carry_out, self)
        self.units = {plain_name(u.name): u for u in reversed(units)}
        self.macros: dict[str, str] = {}  # DEFINE .. AS
        self.pole = np.zeros(3)
        self.modal: Callable[[], None] | None = None  # MCALL
        self.values = SinumerikValues(self, names)
        self.variable, self.assign = self.values.variable, self.values.assign
        letters = "".join(rf"(?:{letter}=?({NUMBER})\s*)?" for letter in self.out.kinematics.letters)
        vector = rf"(?:A3=({NUMBER})\s*B3=({NUMBER})\s*C3=({NUMBER})\s*)?"
        self.plain_block = re.compile(rf"\s*(?:N(\d+)\s*)?(?:G0?([01])(?!\d)\s*)?{letters}{vector}(?:F({NUMBER})\s*)?$", re.A)
        self.out.mixed_feed = "F beside X Y Z with A or C: it counts X Y Z alone, the setting as delivered (FGROUP changes it)"
        self.values.choose("G500")

    def find(self, name: str) -> Unit | None:
        """A subprogram in this file or beside it."""
        return self.units.get(plain_name(name)) or self.folder.find(name)

    def plain_now(self) -> bool:
        return self.modal is None and not self.corners.every_corner and self.state.override == 1.0

    # ------------------------------------------------------------------ lines

    def clean(self, text: str) -> str:
        """The block in capitals without comment; texts in quotes keep their length."""
        if ";" in text:
            text = text[: next((i for i, char, _ in outside_quotes(text) if char == ";"), None)]
        text = text.upper().rstrip()
        stripped = text.lstrip()
        if stripped.startswith("%"):
            return ""
        if stripped.startswith("/"):
            text = re.sub(r"/\d?", lambda m: " " * len(m[0]), text, count=1)  # block skip is off: the block runs
        if "(" in text and (bare := _COMMENT.sub(lambda m: m[1] + " " * (len(m[0]) - len(m[1])), text)) != text:
            self.state.note("( ): a text in brackets that belongs to no word is a comment, as on older controls")
            text = bare
        if self.macros:
            parts = text.split('"')
            for name, meaning in self.macros.items():
                parts[::2] = [re.sub(rf"\b{name}\b(?!\s+AS\b)", meaning.replace("\\", r"\\\\"), part) for part in parts[::2]]
            text = '"'.join(parts)
        return text

    def body(self, text: str) -> tuple[str, int]:
        """The block without label and number, which keep their length; the number, -1 if there is none."""
        number = _NUMBERED.match(text)
        start = number.end() if number else 0
        if (label := _LABEL.match(text)) and label[1] != "ENDLABEL":
            start = label.end()
            if again := re.compile(r"\s*N(\d+)").match(text, start):
                number, start = again, again.end()
        return " " * start + text[start:], int(number[1]) if number else -1

    def statement(self, text: str) -> Statement | None:
        """The statement of the flow in a line."""
        body, _ = self.body(text)
        word = _FLOW.match(body)
        found = statement_of(FORMS if word else OTHER_FORMS, body)
        if word and found is None:
            alone = f"{word[1]} must be alone in its block; write the rest in the next one"
            raise WordError(HINTS.get(word[1][:4], alone), word.start(1) + 1)
        return found

    def labels_of(self, line: str) -> Iterator[str]:
        """Label and block number of a line."""
        text = line.upper()
        if match := _LABEL.match(text):
            yield match[1]
        if match := _NUMBERED.match(text):
            yield f"N{match[1]}"

    # ------------------------------------------------------------------ words of a block

    def words(self, text: str) -> None:
        body, number = self.body(text)
        if number >= 0:
            self.state.block = number
        block = Block()
        for word in split_words(body):
            self._sort(block, word, self.state.slot_of.get(word.name, word.name))
        self.carry_out(block)

    def _sort(self, block: Block, word: Written, name: str) -> None:
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
            block.put(name, self.values.item(word))
        elif name == "M" and with_number:
            block.m.append(int(values.value(word)))
        elif name in ("T", "D", "H") and with_number:
            block.tool[name] = self.value_of(word.text or "", word.text_column) if word.assigned else values.value(word), word.column
        elif name == "L" and word.value is not None:
            block.calls.append(word)
        elif name == "S1" and word.assigned and "S" not in block.w:
            block.put("S", self.values.item(word))
        elif re.fullmatch(r"[SMHTD]\d+", name) and word.assigned:
            self.state.note(f"{name}=: a word of another spindle or tool, understood, no effect on the motion")
        elif name == "R":
            raise WordError("R is an R-parameter here (X=R1, R1=5); the radius of an arc is CR=, R in .ngc files only", word.column)
        elif len(name) == 1:
            raise WordError(
                f"word '{name}' is not known; remove it or replace it by moves (docs/program_words.md lists what is read)", word.column
            )
        elif meaning is not None and not (meaning.kind == REFUSED and name.startswith("CYCLE") and self.find(name) is not None):
            block.names.append(word)
        elif word.assigned:
            values.assignment(word)
        else:
            block.calls.append(word)

    def _axis(self, block: Block, word: Written, name: str) -> None:
        """A coordinate: X, X1, AX[..], POS[..]."""
        if word.index and name not in _INDEXED_AXES:
            raise WordError(f"{name}[..] is not an axis; write {name} and its place, or AX[..]", word.column)
        axis = name[0] if name not in _INDEXED_AXES else self.values.axis_of(word)
        axis = self.state.slot_of.get(axis, axis) if axis != name else axis
        if axis not in INDEX and axis not in OTHER:
            raise WordError(f"{name}[{axis}]: this machine has {self.out.own_axes}", word.column)
        block.put(axis, self.values.item(word))
        if name.startswith("POS"):
            self.state.note("POS, POSA: the axis moves with the others of the block, and at rapid if it is alone")
            block.w["POS"] = Item(1.0, "", word.column)

    # ------------------------------------------------------------------ subprograms

    def other(self, s: Statement, frame: Call) -> None:
        """CASE, DEF, PROC and the like."""
        if s.kind == "case":
            self._case(s, frame)
        elif s.kind in ("def", "redef"):
            self.values.define(s, frame)
        elif s.kind == "define":
            macro = needed(_DEFINE.match(s.text), "DEFINE needs a name and its words, e.g. DEFINE COOLANT AS M8", s.column)
            self.macros[macro[1]] = macro[2]
            frame.unit.statements.clear()
            frame.unit.partners = None
        elif s.kind == "synchronised":
            if _QUIET.sub("", s.text).strip() or not s.text.strip():
                raise WordError(f"DO{s.text[:30]}: {self.known['DO'].meaning}", s.column)
            self.state.note("DO: a synchronised action that sets outputs or marks, without effect on the motion")
        elif s.kind == "proc" and len(self.flow.frames) == 1:
            match = _PROC.match(s.text)
            for part, _ in split_arguments(match[2] or "") if match else []:
                self.values.unset.update(re.sub(r"\[[^\]]*\]|=.*", " ", part).split()[-1:])
        elif s.kind == "extern":
            self.state.note("EXTERN: a declaration, without effect on the motion")

    def _case(self, s: Statement, frame: Call) -> None:
        """CASE: the jump of the first value that fits."""
        match = needed(_CASE.match(s.text), "CASE needs values, e.g. CASE (R1) OF 1 GOTOF A1 DEFAULT GOTOF B1", s.column)
        value = as_text(self.value_of(match[1], s.column))
        for part in _CASE_PART.finditer(match[2]):
            if part[1] == "DEFAULT" or as_text(self.value_of(part[1], s.column)) == value:
                self.flow.jump_to(frame, Statement("goto", s.column, target=part[3], way=part[2][4:]))
                return

    def call(self, word: Written, times: int) -> None:
        """A subprogram by its name or L number."""
        name, unit = self._unit_of(word)
        if unit is None and name == "L":
            raise WordError("L needs a number", word.column)
        if unit is None:
            if self.moves_nothing(name):
                return
            hint = nearest(name, self.known) if len(name) > 2 else ""
            hint = f"{hint}; or " if hint.startswith("did you") else ""
            what = f"word '{name}' is not known and there is no subprogram {name}.SPF beside the program"
            raise WordError(f"{what}; {hint}{ADD_FILE}", word.column)
        self.corners.release()
        variables, first, written = self.arguments(unit, word)
        kept = self._kept_modes() if first and re.search(r"\)?[^)]*\bSAVE\b", self.clean(unit.lines[first - 1])) else None

        def restore() -> None:
            if kept:
                kept()
            for target, store, column in written:
                self.values.assign(target, store[()], column)

        self.flow.call(unit, first, variables, name, times=times, column=word.column, on_return=restore)

    def _unit_of(self, word: Written) -> tuple[str, Unit | None]:
        """The name of a subprogram, and its program."""
        name = word.name if word.name != "L" or word.value is None else f"L{word.value:g}"
        return name, self.find(name)

    def _kept_modes(self) -> Callable[[], None]:
        """What PROC .. SAVE restores at the end of the subprogram: the modal G codes and the programmable frame."""
        kept = self.state.kept(("program", "fine"))
        side, chosen = self.state.comp, self.values.chosen

        def restore() -> None:
            self.corners.release()
            if (self.state.comp is None) != (side is None):
                raise WordError("SAVE with a change of G40, G41 or G42 in the subprogram is not supported; change it in the caller")
            kept()
            self.values.choose(chosen)

        return restore

    def arguments(self, unit: Unit, word: Written) -> tuple[dict[str, Store], int, list[tuple[str, Store, int]]]:
        """The values of a call: the variables of its PROC, the line that it begins at, and the VAR values to write back to their targets."""
        values = [(t, word.text_column + c) for t, c in split_arguments(word.text or "")]
        bodies = ((at, self.body(self.clean(line))[0].strip()) for at, line in enumerate(unit.lines))
        at, body = next(((at, body) for at, body in bodies if body and not body.startswith("EXTERN")), (0, ""))
        if not (match := _PROC.match(body)):
            if any(t for t, _ in values):
                raise WordError(f"{unit.name} takes no values (it has no PROC line); remove the brackets", word.column)
            return {}, 0, []
        variables: dict[str, Store] = {}
        written: list[tuple[str, Store, int]] = []
        for k, (part, _) in enumerate(split_arguments(match[2] or "")):
            declared, _, default = part.partition("=")
            words = re.sub(r"\[[^\]]*\]", " ", declared).split()
            if not words:
                continue
            start: Value = "" if any(w in declared for w in ("STRING", "CHAR", "AXIS")) else 0.0
            text, column = values[k] if k < len(values) and values[k][0] else (default.strip(), 1)
            store = self.values.store_of(text) if words[0] == "VAR" else None
            if store is not None:  # the variable of the caller itself
                store.setdefault(("default",), start)
            else:
                by_name = "AXIS" in declared and words[0] != "VAR"
                store = {(): start if not text else text if by_name else self.value_of(text, column), ("default",): start}
                if words[0] == "VAR" and text:
                    written.append((text, store, column))
            variables[words[-1]] = store
        if len(values) > len(split_arguments(match[2] or "")):
            raise WordError(f"{unit.name} takes {len(variables)} values; the call gives {len(values)}", word.column)
        return variables, at + 1, written

    def modal_call(self, word: Written) -> Callable[[], None]:
        """The subprogram of MCALL, which is called behind each block with motion."""
        unit = needed(self._unit_of(word)[1], f"MCALL: there is no cycle or subprogram '{word.name}'; add {word.name}.SPF", word.column)
        variables, first, _ = self.arguments(unit, word)

        return lambda: self.flow.call(unit, first, {k: dict(v) for k, v in variables.items()}, unit.name, column=word.column)
