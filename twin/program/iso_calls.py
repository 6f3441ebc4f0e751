"""Subprograms of ISO programs: M98 and M99, macros (G65, G66), O-words."""

from __future__ import annotations

from typing import Any, Protocol

from twin.program.expressions import WordError
from twin.program.flow import Frame
from twin.program.iso_drilling import MOST_REPEATS
from twin.program.iso_lines import COMMENT, OWORD, PROGRAM, between_percents, subs_of
from twin.program.iso_motion import IsoMotion
from twin.program.machine_file import moves_no_axis
from twin.program.source import Folder, Unit
from twin.program.state import Item
from twin.program.structures import Statement

MACRO = dict(zip("ABCIJKDEFHMQRSTUVWXYZ", (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26)))
"""Letter of G65 -> variable that it sets."""


class Executor(Protocol):
    """Executes blocks, as text or as G codes, M codes and words."""

    def words(self, text: str) -> None: ...
    def execute(self, g: list[tuple[float, int]], m: list[tuple[float, int]], words: dict[str, Item]) -> None: ...


class IsoCalls:
    """Calls and returns."""

    def __init__(self, moves: IsoMotion, front: Executor, unit: Unit) -> None:
        self.moves, self.state, self.flow, self.values, self.front = moves, moves.state, moves.flow, moves.values, front
        self.unit_read = unit
        self.folder = Folder(self.state.path)
        self.main_seen = False

    def other(self, s: Statement, frame: Frame) -> None:
        """O-words of calls, program numbers, IF .. THEN."""
        if s.kind == "then":
            if self.values.number_of(s.text, s.column):
                self.front.words(" " * s.rest[0] + s.key)
        elif s.kind == "words_goto":
            self.front.words(s.key)
            self.flow.jump_to(frame, s)
        elif s.kind == "program":
            self._program(s, frame)
        elif s.kind == "call":
            self._call_oword(s)
        elif s.kind in ("return", "endsub"):
            if s.kind == "return" and len(self.flow.frames) == 1:
                raise WordError("RETURN is outside a subprogram; remove it", s.column)
            self._back(s)
        else:
            raise WordError(f"O.. {s.kind} does not fit here; correct the O-words", s.column)

    def _program(self, s: Statement, frame: Frame) -> None:
        """A line O1234: the name of the program, or the start of the next one."""
        if frame.style == "m98" or (self.main_seen and len(self.flow.frames) == 1):
            raise WordError(f"the program runs on into O{s.key}; end it with M30 or M99 before", 1)
        if len(self.flow.frames) == 1:
            self.main_seen = True

    def block(self, codes: set[float], m: list[int], w: dict[str, Item]) -> bool:
        """M98, M99, G65 and G66; True if the block is done."""
        if 65 in codes or 66 in codes:
            self._macro(w, modal=66 in codes)
            return True
        if 67 in codes:
            self.moves.modal_macro = None
        if 198 in m and not self.state.linuxcnc:
            m[m.index(198)] = 98
        if 97 in m or 98 in m:
            own = 97 in m
            if own and self.state.linuxcnc:
                raise WordError("M97 is no word of LinuxCNC; use M98 and O", 1)
            if "P" not in w:
                raise WordError(f"M{97 if own else 98} needs P, the number of the {'block' if own else 'subprogram'}", 1)
            p, times = w.pop("P"), 1
            number = int(p.value)
            if "L" in w or "K" in w:
                word = w.pop("L" if "L" in w else "K")
                times = int(word.value)
                if times != word.value:
                    raise WordError(f"M98 repeats {word.value:g} times; give a whole number", word.column)
            elif not self.state.linuxcnc and not own and number > 9999:
                times, number = divmod(number, 10000)
            if w or codes:
                self.front.execute([(c, 1) for c in sorted(codes)], [(float(n), 1) for n in m if n not in (97, 98)], w)
            if times > MOST_REPEATS:
                raise WordError(f"M98 repeats more than {MOST_REPEATS} times", p.column)
            place = self._block_place(number, p.column) if own else self._program_place(number, p.column)
            if place is not None:
                unit, at = place
                self.flow.call(unit, at, times=times, name=f"{'N' if own else 'O'}{number}", style="m98", shared=True, column=p.column)
            return True
        if 99 in m:
            frame = self.flow.frame
            if len(self.flow.frames) == 1:
                self.state.note("M99 ends the main program here, which the control would run again without end")
                self.flow.ended = True
                return True
            if frame.style not in ("m98", "macro"):
                raise WordError("M99 ends a subprogram that O.. sub began; end it with endsub", 1)
            target = f"N{int(w.pop('P').value)}" if "P" in w else ""
            if w:
                self.front.execute([(c, 1) for c in sorted(codes)], [(float(n), 1) for n in m if n != 99], w)
            self.flow.back(target)
            return True
        return False

    def _block_place(self, number: int, column: int) -> tuple[Unit, int]:
        """Line of block N.. of this program, for M97 of a Haas."""
        unit = self.flow.frame.unit
        found = self.flow.lines.labels(unit).get(f"N{number}")
        if not found:
            raise WordError(f"M97 P{number}: this program has no block N{number}; add it", column)
        return unit, found[0]

    def _program_place(self, number: int, column: int) -> tuple[Unit, int] | None:
        """Unit and line of program O.., in this file or in the folder; None if the machine file lists it as a call without motion."""
        wrong = False
        for unit in dict.fromkeys((self.flow.frame.unit, self.unit_read)):
            for at, line in enumerate(unit.lines):
                body = COMMENT.sub("", line.split(";")[0]).upper()
                if "O" not in body and ":" not in body:
                    continue
                match = PROGRAM.match(body)
                if match and match[1].isdigit() and int(match[1]) == number:
                    return unit, at + 1
                oword = OWORD.match(body)
                wrong = wrong or bool(oword and oword[2] == "SUB" and oword[1].isdigit() and int(oword[1]) == number)
        if wrong:
            raise WordError(f"O{number} is a subprogram 'O{number} sub' and is called by 'O{number} call', not by M98", column)
        unit = self.folder.find(f"O{number:04d}", f"O{number}", f"{number:04d}", str(number))  # type: ignore[assignment]
        if unit is None:
            if moves_no_axis(self.state.machine, [f"O{number}", f"O{number:04d}"]):
                self.state.note(f"O{number}: the machine file lists it as moving no axis")
                return None
            raise WordError(
                f"subprogram O{number} is neither in this file nor beside it (O{number:04d}.nc); add it, or list it in [program] "
                "calls_without_motion of the machine file if it moves no axis",
                column,
            )
        unit = between_percents(unit)
        at = next((i + 1 for i, line in enumerate(unit.lines) if PROGRAM.match(COMMENT.sub("", line).upper())), 0)
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
        place = self._program_place(int(p.value), p.column)
        if place is None:
            return
        unit, at = place
        if modal:
            self.moves.modal_macro = unit, at, variables
            return
        if frame := self.flow.call(unit, at, times=min(times, MOST_REPEATS), name=f"O{p.value:g}", style="macro", column=p.column):
            frame.variables = dict(variables)

    def _call_oword(self, s: Statement) -> None:
        name = self._oword_name(s.key, s.column)
        arguments = {}
        e = self.values.expression(s.text, 0, s.column)
        k = 0
        while e.peek():
            k += 1
            if e.peek() != "[" or k > 30:
                raise e.fail("a call takes up to 30 arguments in brackets, e.g. O100 call [1] [2]")
            arguments[k] = float(e.atom())
        calling = self.flow.frame
        for unit in dict.fromkeys((calling.unit, self.unit_read)):
            at = subs_of(unit).get(name)
            if at is not None and name.isdigit() and unit is not self.unit_read and at > calling.at:
                at = None  # a numbered subprogram of another file must stand before its call
            if at is not None:
                break
        else:
            unit = self.folder.find(name.strip("<>"))  # type: ignore[assignment]
            at = None if unit is None else subs_of(unit).get(name)
        if unit is None or at is None:
            fanuc = any((p := PROGRAM.match(COMMENT.sub("", line).upper())) and p[1] == name for line in self.unit_read.lines)
            text = (
                f"O{name} is called by M98 P{name}"
                if fanuc
                else f"subprogram O{name.lower()} is neither in this file nor beside it; add it"
            )
            raise WordError(text, s.column)
        partners = self.flow._table(unit).get(at, (at,))
        if partners[0] < 0:
            raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
        self.values.returned_value = (0.0, 0.0)
        if frame := self.flow.call(unit, at + 1, name=name, style="oword", column=s.column):
            frame.variables = arguments

    def _oword_name(self, key: str, column: int) -> str:
        if key.startswith(("[", "#")):
            return str(int(self.values.number_of(key, column)))
        return key

    def _back(self, s: Statement) -> None:
        frame = self.flow.frame
        if frame.style == "m98":
            raise WordError("a subprogram called by M98 ends with M99, not with endsub", s.column)
        self.values.returned_value = (self.values.number_of(s.text, s.column), 1.0) if s.text.strip() else (0.0, 0.0)
        self.flow.back()

    def runs_into(self, what: str, column: int) -> None:
        """The main program reaches a subprogram or the end of the file; one with a name O.. must have ended before."""
        if self.main_seen and len(self.flow.frames) == 1 and self.state.linuxcnc:
            raise WordError(f"the program O.. runs on into {what}; end it with M2, M30 or %", column)
