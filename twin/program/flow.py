"""Execution order of the blocks of a program: labels, jumps, loops, conditions, calls, for all languages.

The lines of a language classify each line (`twin.program.structures.Statement`), and `Flow` executes it. Limits on blocks, jumps and calls prevent
endless programs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from twin.errors import InputError
from twin.program.expressions import WordError
from twin.program.source import Unit
from twin.program.state import State
from twin.program.structures import Statement, loop_around, partners, structures_of

MOST_BLOCKS = 2_000_000  # that run, with repeats
MOST_JUMPS = 100_000
MOST_SAME_JUMPS = 10_000
"""Number of consecutive jumps without a change of any value in a condition, after which the loop counts as endless."""
DEEPEST_CALL = 40


@dataclass
class Frame:
    """One running program or subprogram."""

    unit: Unit
    at: int
    name: str = ""
    again: int = 0  # times that a call still repeats
    first: int = 0
    variables: dict[Any, Any] = field(default_factory=dict)
    repeats: list[list[int]] = field(default_factory=list)  # [last line, line to return to, first line, times left]
    counters: dict[int, int] = field(default_factory=dict)
    style: str = ""  # how it was called, where the end must fit
    on_return: Callable[[], None] | None = None


class Lines(Protocol):
    """How a language writes lines: a line without comment, the statement of the flow in it, the labels of a program."""

    def clean(self, text: str) -> str: ...
    def statement(self, text: str) -> Statement | None: ...
    def labels(self, unit: Unit) -> dict[str, list[int]]: ...


class Values(Protocol):
    """Variables and expressions of a language."""

    def number_of(self, text: str, column: int) -> float: ...
    def assign(self, name: str, value: float, column: int) -> None: ...


class Calls(Protocol):
    """Statements of a language that the flow does not know, and the end of a program that does not end itself."""

    def other(self, statement: Statement, frame: Frame) -> None: ...
    def runs_into(self, what: str, column: int) -> None: ...


class Blocks(Protocol):
    """Executes blocks; `fast` returns False for one that must be read word by word."""

    def fast(self, text: str, line: int) -> bool: ...
    def words(self, text: str) -> None: ...


class Flow:
    """Executes the blocks of a program."""

    lines: Lines
    values: Values
    calls: Calls
    blocks: Blocks

    def __init__(self, unit: Unit, state: State) -> None:
        self.state = state
        self.frames = [Frame(unit, unit.first)]
        self.ran = self.jumps = self.same_jumps = 0
        self._seen: dict[tuple, tuple] = {}
        self.ended = False

    @property
    def frame(self) -> Frame:
        """The running program or subprogram."""
        return self.frames[-1]

    def speak(self, lines: Lines, values: Values, calls: Calls, blocks: Blocks) -> None:
        """Set the parts of the language."""
        self.lines, self.values, self.calls, self.blocks = lines, values, calls, blocks

    def run(self) -> None:
        """Execute all blocks until the program ends."""
        state, fast, calls = self.state, self.blocks.fast, self.calls
        while not self.ended and self.frames:
            frame = self.frames[-1]
            lines, offset = frame.unit.lines, frame.unit.offset
            while frame.at < len(lines):
                at = frame.at
                text = lines[at]
                if fast(text, offset + at + 1):
                    self.advance(frame)
                    continue
                state.line, state.block = offset + at + 1, -1
                self._run_line(frame, at, text)
                if self.ended or self.frames[-1] is not frame:
                    break
            else:
                if not frame.style:
                    calls.runs_into("the end of the file", 1)
                self.back()

    def _run_line(self, frame: Frame, at: int, text: str) -> None:
        """Execute one line and advance `frame.at`, except at a call, which advances it at its end."""
        known = frame.unit.statements.get(at)
        if known is None:
            known = frame.unit.statements[at] = self._statement(text)
        if isinstance(known, Statement):
            self._follow(frame, at, known)
            return
        depth = len(self.frames)
        if known:
            self.blocks.words(known)  # type: ignore[arg-type]
        if not self.ended and len(self.frames) == depth and frame is self.frames[-1] and frame.at == at:
            self.advance(frame)

    def _statement(self, text: str) -> Statement | str:
        clean = self.lines.clean(text)
        if not clean.strip():
            return ""
        return self.lines.statement(clean) or clean

    def advance(self, frame: Frame) -> None:
        """Advance to the next line, or back to the start of a repeated part at its end."""
        self._count()
        at = frame.at
        while frame.repeats and frame.repeats[-1][0] == at:
            part = frame.repeats[-1]
            part[3] -= 1
            if part[3] > 0:
                frame.at = part[2]
                return
            frame.repeats.pop()
            at = part[1]  # behind the REPEAT block, which may itself end a part
        frame.at = at + 1

    def _count(self) -> None:
        self.ran += 1
        if self.ran > MOST_BLOCKS:
            frame = self.frame
            raise InputError(
                f"{frame.unit.path}: line {frame.unit.offset + frame.at + 1}: more than {MOST_BLOCKS} blocks have run; "
                "repeat less often or split the program"
            )

    # ------------------------------------------------------------------ calls

    def call(
        self, unit: Unit, at: int, *, times: int = 1, name: str = "", style: str = "", shared: bool = False, column: int = 1
    ) -> Frame | None:
        """Run a subprogram from line `at`; the caller continues after its block."""
        if len(self.frames) > DEEPEST_CALL:
            raise WordError(f"more than {DEEPEST_CALL} calls inside each other; {name or unit.name} calls itself without end", column)
        if times <= 0:
            return None
        frame = Frame(unit, at, name or unit.name, times - 1, at, self.frame.variables if shared else {}, style=style)
        self.frames.append(frame)
        return frame

    def back(self, target: str = "") -> None:
        """The end of a program or subprogram: RET, M17, M99, endsub, or the end of its lines."""
        frame = self.frame
        if frame.again > 0:
            frame.again -= 1
            frame.at, frame.repeats, frame.counters = frame.first, [], {}
            self.same_jumps = 0
            self._jump(1)
            return
        self.frames.pop()
        if frame.on_return:
            frame.on_return()
        if not self.frames:
            self.ended = True
        elif target:
            self.frame.at = self.place(self.frame, target, "", 1)
        else:
            self.advance(self.frame)

    # ------------------------------------------------------------------ structures

    def _follow(self, frame: Frame, at: int, s: Statement) -> None:
        """Execute a statement of the flow."""
        kind = s.kind
        if kind == "if":
            self._branch(frame, at, s)
        elif kind in ("elseif", "else"):  # the part before it has run
            frame.at = self._partners(frame, at, s)[-1]
            self.advance(frame)
        elif kind == "while" and self._opens(frame, at):
            if self._value(s.text, s.column):
                self.advance(frame)
            else:
                self._behind(frame, self._partners(frame, at, s)[-1])
        elif kind == "while":  # it ends a DO
            self._loop(frame, self._partners(frame, at, s)[0], bool(self._value(s.text, s.column)), s.column)
        elif kind == "endwhile" or kind == "endloop":
            opener = self._partners(frame, at, s)[0]
            self._jump(s.column)
            frame.at = opener
        elif kind == "until":
            self._loop(frame, self._partners(frame, at, s)[0], not self._value(s.text, s.column), s.column)
        elif kind == "for":
            name, first, last = s.rest
            self.values.assign(name, self._value(first, s.column), s.column)
            if self._value(name, s.column) <= self._value(last, s.column):
                self.advance(frame)
            else:
                self._behind(frame, self._partners(frame, at, s)[-1])
        elif kind == "endfor":
            opener = self._partners(frame, at, s)[0]
            name, _, last = frame.unit.statements[opener].rest  # type: ignore[attr-defined]
            self.values.assign(name, self._value(name, s.column) + 1.0, s.column)
            self._loop(frame, opener, self._value(name, s.column) <= self._value(last, s.column), s.column)
        elif kind == "times":
            count = int(self._value(s.text, s.column))
            frame.counters[at] = count
            if count > 0:
                self.advance(frame)
            else:
                self._behind(frame, self._partners(frame, at, s)[-1])
        elif kind == "endtimes":
            opener = self._partners(frame, at, s)[0]
            frame.counters[opener] = frame.counters.get(opener, 1) - 1
            self.same_jumps = 0
            self._loop(frame, opener, frame.counters[opener] > 0, s.column)
        elif kind == "break":
            self._behind(frame, self._around(frame, at, s)[-1])
        elif kind == "continue":
            frame.at = self._around(frame, at, s)[-1]
            self._jump(s.column)
        elif kind in ("loop", "repeat", "do", "endif", "label"):
            self.advance(frame)
            if kind in ("loop", "repeat", "do"):
                self._partners(frame, at, s)
        elif kind == "sub":
            self.calls.runs_into("a subprogram", s.column)
            self._behind(frame, self._partners(frame, at, s)[-1])
        elif kind == "goto":
            self._goto(frame, s)
        elif kind == "repeat_label":
            self._repeat(frame, at, s)
        else:
            depth = len(self.frames)
            self.calls.other(s, frame)
            if not self.ended and len(self.frames) == depth and frame is self.frames[-1] and frame.at == at:
                self.advance(frame)

    def _value(self, text: str, column: int) -> float:
        """The value of a condition or of the bound of a loop."""
        reads: list[Any] = []
        self.state.reads = reads
        value = self.values.number_of(text, column)
        self.state.reads = None
        self.decided(text, (value, *reads))
        return value

    def decided(self, text: str, by: tuple) -> None:
        """Record the values of a decision; values that differ from the last time show that the loop makes progress."""
        key = (self.frame.unit.path, self.frame.unit.name, self.frame.at, text)
        if self._seen.get(key) != by:
            self._seen[key] = by
            self.same_jumps = 0

    def _branch(self, frame: Frame, at: int, s: Statement) -> None:
        """IF: go to the first branch whose condition is true; a branch ends at the next ELSE."""
        if self._value(s.text, s.column):
            self._partners(frame, at, s)
            self.advance(frame)
            return
        for place in self._partners(frame, at, s)[1:]:
            other = frame.unit.statements[place]
            assert isinstance(other, Statement)
            if other.kind != "elseif" or self._value(other.text, other.column):
                self._behind(frame, place)
                return

    def _behind(self, frame: Frame, place: int) -> None:
        """Continue after a line; a repeated part that ends among the skipped lines is finished."""
        if frame.repeats and frame.at <= frame.repeats[-1][0] < place:
            place = frame.repeats[-1][0]
        frame.at = place
        self.advance(frame)

    def _loop(self, frame: Frame, opener: int, again: bool, column: int) -> None:
        """The end of a loop: back to its start, or continue."""
        if again:
            self._jump(column)
            frame.at = opener + 1
        else:
            self.advance(frame)

    def _jump(self, column: int) -> None:
        self._count()
        self.jumps += 1
        self.same_jumps += 1
        if self.same_jumps > MOST_SAME_JUMPS:
            raise WordError(
                f"the loop with this jump does not end: in {MOST_SAME_JUMPS} jumps nothing has changed that a condition reads; correct it",
                column,
            )
        if self.jumps > MOST_JUMPS:
            raise WordError(f"more than {MOST_JUMPS} jumps have run; the loop with this jump does not end, correct it", column)

    def _opens(self, frame: Frame, at: int) -> bool:
        return self.table(frame.unit).get(at, (at,))[0] == at

    def _partners(self, frame: Frame, at: int, s: Statement) -> tuple[int, ...]:
        return partners(self.table(frame.unit), at, s)

    def _around(self, frame: Frame, at: int, s: Statement) -> tuple[int, ...]:
        return loop_around(self.table(frame.unit), frame.unit, at, s)

    def table(self, unit: Unit) -> dict[int, tuple[int, ...]]:
        """The structures of a program by their lines."""
        if unit.partners is None:
            unit.partners = structures_of(unit, self._statement)
        return unit.partners

    # ------------------------------------------------------------------ jumps

    def _goto(self, frame: Frame, s: Statement) -> None:
        condition, *_ = s.rest
        if condition and not self._value(condition, s.column):
            self.advance(frame)
            return
        self.jump_to(frame, s)

    def jump_to(self, frame: Frame, s: Statement) -> None:
        """Continue at the target of a jump."""
        _, direction, target = s.rest
        self._jump(s.column)
        place = frame.first if direction == "S" else self.place(frame, target, direction, s.column)
        frame.repeats = [r for r in frame.repeats if r[2] <= place <= r[0]]
        frame.at = place

    def place(self, frame: Frame, target: str, direction: str, column: int) -> int:
        """Line of a label or block number; `direction` F: forwards, B: backwards, C: a missing target is ignored."""
        if target.startswith("="):  # a block number by an expression
            target = f"N{int(self.values.number_of(target[1:], column))}"
        if frame.unit.labels is None:
            frame.unit.labels = self.lines.labels(frame.unit)
        places = frame.unit.labels.get(target, [])
        forward = [i for i in places if i > frame.at]
        back = [i for i in places if i <= frame.at]
        found = {"F": forward[:1], "B": back[-1:]}.get(direction, forward[:1] or back[-1:])
        if not found and direction == "C":
            return frame.at + 1
        if not found:
            way = {"F": " further on (GOTOF)", "B": " before (GOTOB)"}.get(direction, "")
            raise WordError(f"there is no label or block '{target}'{way}; add it or correct the jump", column)
        return found[0]

    def _repeat(self, frame: Frame, at: int, s: Statement) -> None:
        word, name, end, times_text = s.rest
        if frame.unit.labels is None:
            frame.unit.labels = self.lines.labels(frame.unit)

        def label(text: str) -> int:
            places = frame.unit.labels.get(text, [])  # type: ignore[union-attr]
            if not places:
                raise WordError(f"there is no label '{text}'; add '{text}:' before the part to repeat", s.column)
            return places[0]

        first = label(name)
        if end:
            last = label(end)
        elif word == "REPEATB":
            last = first
        else:
            closing = [i for i in frame.unit.labels.get("ENDLABEL", []) if i >= first]
            last = closing[0] if closing and (closing[0] < at or first > at) else (at - 1 if first < at else len(frame.unit.lines) - 1)
        if last < first or first <= at <= last:
            raise WordError(f"REPEAT {name}: the part to repeat holds the REPEAT itself or is empty; move the labels", s.column)
        times = int(self.values.number_of(times_text, s.column)) if times_text else 1
        if len(frame.repeats) >= 20:
            raise WordError("more than 20 REPEAT inside each other; correct the labels", s.column)
        if times <= 0:
            self.advance(frame)
            return
        self._count()
        frame.repeats.append([last, at, first, times])
        frame.at = first
