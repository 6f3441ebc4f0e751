"""Execution order of the blocks of a program: labels, jumps, loops, conditions, calls, for all languages.

A language classifies each line (`Statement`), and `Flow` executes it. Limits on blocks, jumps and calls prevent endless programs. The lines that
begin, divide and end a loop, a condition or a subprogram are a structure: SINUMERIK nests IF .. ENDIF by position, LinuxCNC and Fanuc name
both ends (O100, DO1): the `key`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
import re
from typing import Any

from twin.program.expressions import WordError, needed
from twin.program.source import Unit
from twin.program.state import State

CLOSES = {
    "if": "endif", "while": "endwhile", "for": "endfor", "loop": "endloop", "repeat": "until", "do": "while", "times": "endtimes",
    "sub": "endsub",
}  # fmt: skip
"""Structure -> the statement that ends it; a label is repeated by `repeat_label`, LinuxCNC's O.. REPEAT is `times`."""

STRUCTURES = {*CLOSES, *CLOSES.values(), "elseif", "else"} - {"endif", "endsub"}
"""Statements that belong to a structure; an ENDIF only marks its end, and ENDSUB returns."""

Table = dict[int, tuple[int, ...]]
"""Line -> lines of its structure, first to last."""


@dataclass(frozen=True)
class Statement:
    """Statement of the flow in a line.

    `key`: name of its structure, label or program; `text`: condition, first value or arguments, starting at `column`; `target`: label or
    variable; `way` to it (F forwards, B backwards, C: it may be missing, S: the start); `last`: the end of a part or loop.
    """

    kind: str
    column: int = 1
    key: str = ""
    text: str = ""
    target: str = ""
    way: str = ""
    last: str = ""
    times: str = ""


Forms = tuple[tuple[str, re.Pattern[str]], ...]
"""Kinds of statements with their patterns, whose groups are the parts of the statement; a group `kind` is its kind."""


def statement_of(forms: Forms, text: str) -> Statement | None:
    """The statement of the first form that fits a line."""
    for kind, pattern in forms:
        if match := pattern.match(text):
            parts = {"kind": kind} | {name: part for name, part in match.groupdict().items() if part is not None}
            column = match.start("text") if "text" in parts else len(text) - len(text.lstrip())
            return Statement(**parts | {"kind": parts["kind"].lower()}, column=column + 1)  # type: ignore[arg-type]
    return None


MOST_BLOCKS = 2_000_000  # that run, with repeats
MOST_JUMPS = 100_000
DEEPEST_CALL = 40


@dataclass
class Call:
    """One running program or subprogram."""

    unit: Unit
    at: int
    name: str = ""
    again: int = 0  # times that a call still repeats
    first: int = 0
    variables: dict[Any, Any] = field(default_factory=dict)
    repeats: list[list[int]] = field(default_factory=list)  # [last line, line to return to, first line, times left]
    counters: dict[int, int] = field(default_factory=dict)
    loop: int = -1  # the line of a loop whose end was reached, and which decides whether it runs once more
    style: str = ""  # how it was called, where the end must fit
    on_return: Callable[[], None] | None = None
    kept: Callable[[], None] | None = None  # brings back the modes of M70


class Flow:
    """Executes the blocks of a program.

    `language` is its reader: `clean`, `statement` and `labels_of` read lines; `values` have the formulas and variables;
    `fast` and `words` carry out a block, `other` a statement that the flow does not know; `runs_into`: a program does not end itself.
    """

    def __init__(self, unit: Unit, state: State, language: Any) -> None:
        self.state, self.language = state, language
        self.frames = [Call(unit, 0)]
        self.ran = self.jumps = 0
        self.ended = False

    @property
    def frame(self) -> Call:
        """The running program or subprogram."""
        return self.frames[-1]

    def run(self) -> None:
        """Execute all blocks until the program ends."""
        state, fast = self.state, self.language.fast
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
                    self.language.runs_into("the end of the file", 1)
                self.back()

    def _run_line(self, frame: Call, at: int, text: str) -> None:
        """Execute one line and advance `frame.at`, except at a jump, and at a call, which advances it at its end."""
        known = frame.unit.statements.get(at)
        if known is None:
            known = frame.unit.statements[at] = self._statement(text)
        depth = len(self.frames)
        if isinstance(known, Statement) and self._follow(frame, at, known):
            return
        if known and not isinstance(known, Statement):
            self.language.words(known)
        if not self.ended and len(self.frames) == depth and frame is self.frames[-1] and frame.at == at:
            self.advance(frame)

    def _statement(self, text: str) -> Statement | str:
        clean = self.language.clean(text)
        if not clean.strip():
            return ""
        return self.language.statement(clean) or clean

    def advance(self, frame: Call) -> None:
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
            self.state.line = self.frame.unit.offset + self.frame.at + 1
            raise WordError(f"more than {MOST_BLOCKS} blocks have run; repeat less often or split the program", 0)

    # ------------------------------------------------------------------ calls

    def call(self, unit: Unit, at: int, variables: dict[Any, Any], name: str, *, times: int = 1, column: int = 1, **more: Any) -> None:
        """Run a subprogram from line `at`; the caller continues after its block. `more`: further fields of its `Call`."""
        if len(self.frames) > DEEPEST_CALL:
            raise WordError(f"more than {DEEPEST_CALL} calls inside each other; {name} calls itself without end", column)
        if times > 0:
            self.frames.append(Call(unit, at, name, times - 1, at, variables, **more))

    def back(self, target: str = "") -> None:
        """The end of a program or subprogram: RET, M17, M99, endsub, or the end of its lines."""
        frame = self.frame
        if frame.again > 0:
            frame.again -= 1
            frame.at, frame.repeats, frame.counters = frame.first, [], {}
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

    def _follow(self, frame: Call, at: int, s: Statement) -> bool:
        """Execute a statement; True if it has set the next line."""
        kind = s.kind
        if kind in ("label", "endif"):
            return False
        if kind == "goto":
            if s.text and not self.language.number_of(s.text, s.column):
                return False
            self.jump_to(frame, s)
        elif kind == "repeat_label":
            self._repeat(frame, at, s)
        elif kind in ("break", "continue"):
            end = self._loop_around(frame.unit, at, s)[-1]
            if kind == "continue":
                self._jump(s.column)
            self._behind(frame, end - (kind == "continue"))
        elif kind in STRUCTURES:
            self._behind(frame, self._structure(frame, at, s))
        else:
            self.language.other(s, frame)
            return False
        return True

    def _structure(self, frame: Call, at: int, s: Statement) -> int:
        """The program goes on behind this line: it enters or skips a loop or branch, or leaves a loop at its end."""
        kind, opens, statements = s.kind, self.table(frame.unit).get(at, (at,))[0] == at, frame.unit.statements
        if opens and kind in ("while", "for", "times") and self._enters(frame, at, s):
            return at
        places = self._partners(frame.unit, at, s)
        first, last = places[0], places[-1]
        if kind == "if":  # the first branch whose condition is true
            others = ((place, statements[place]) for place in places[1:])
            ends = (place for place, other in others if other.kind != "elseif" or self.language.number_of(other.text, other.column))
            return at if self.language.number_of(s.text, s.column) else next(ends)
        if kind == "sub":
            self.language.runs_into("a subprogram", s.column)
        if kind in ("sub", "elseif", "else"):  # the part before ELSE has run
            return last
        if opens:
            return at if kind in ("loop", "repeat", "do") else last
        if kind not in ("until", "while") or bool(self.language.number_of(s.text, s.column)) == (kind == "while"):
            self._jump(s.column)
            frame.loop = first
            return first - 1
        return at

    def _enters(self, frame: Call, at: int, s: Statement) -> bool:
        """Whether a loop runs, from its beginning on or once more."""
        again, frame.loop = frame.loop == at, -1
        if s.kind == "while":
            return bool(self.language.number_of(s.text, s.column))
        if s.kind == "for":
            self.language.assign(
                s.target,
                self.language.number_of(s.target, s.column) + 1.0 if again else self.language.number_of(s.text, s.column),
                s.column,
            )
            return self.language.number_of(s.target, s.column) <= self.language.number_of(s.last, s.column)
        frame.counters[at] = frame.counters.get(at, 1) - 1 if again else int(self.language.number_of(s.text, s.column))
        return frame.counters[at] > 0

    def _behind(self, frame: Call, place: int) -> None:
        """Continue after a line; a repeated part that ends among the skipped lines is finished."""
        if frame.repeats and frame.at <= frame.repeats[-1][0] < place:
            place = frame.repeats[-1][0]
        frame.at = place
        self.advance(frame)

    def _jump(self, column: int) -> None:
        self._count()
        self.jumps += 1
        if self.jumps > MOST_JUMPS:
            raise WordError(f"more than {MOST_JUMPS} jumps have run; the loop with this jump does not end, correct it", column)

    def table(self, unit: Unit) -> Table:
        """The structures of a program by their lines. A fault in a line is raised when the line runs."""
        if unit.partners is not None:
            return unit.partners
        table: Table = {}
        unit.partners = table
        stacks: dict[str, list[list[int]]] = {}
        subs: list[int] = []
        for at, text in enumerate(unit.lines):
            if at not in unit.statements:
                try:
                    unit.statements[at] = self._statement(text)
                except WordError:
                    continue  # raised when the line runs
            s = unit.statements[at]
            if not isinstance(s, Statement):
                continue
            stack = stacks.setdefault(s.key, [])
            top = unit.statements[stack[-1][0]].kind if stack else ""
            if top and s.kind == CLOSES[top]:
                places = (*stack.pop(), at)
                if s.kind == "endsub":
                    subs.remove(places[0])
                if table[places[0]][0] >= 0:
                    table |= dict.fromkeys(places, places)
            elif s.kind in ("elseif", "else") and top == "if":
                stack[-1].append(at)
            elif s.kind in CLOSES:
                stack.append([at])
                table[at] = (at,)
                if s.kind == "sub":
                    if subs:
                        table[subs[-1]] = (-1, -1)
                    subs.append(at)
        return table

    def _partners(self, unit: Unit, at: int, s: Statement) -> tuple[int, ...]:
        """Lines of the structure that the statement at this line belongs to, first to last."""
        found = self.table(unit).get(at, ())
        if len(found) < 2:
            end = CLOSES.get(s.kind, "").upper()
            text = f"{s.kind.upper()} has no {end}; add it" if end else f"{s.kind.upper()} ends nothing that was begun; remove it"
            raise WordError(text, s.column)
        if found[0] < 0:
            raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
        return found

    def _loop_around(self, unit: Unit, at: int, s: Statement) -> tuple[int, ...]:
        """The loop with the key of a BREAK or CONTINUE."""
        for places in self.table(unit).values():
            inside = 0 <= places[0] < at < places[-1]
            if inside and (opener := unit.statements[places[0]]).kind != "if" and opener.key == s.key:
                return places
        raise WordError(f"{s.kind.upper()} is outside the loop {s.key}; correct its number", s.column)

    # ------------------------------------------------------------------ jumps

    def jump_to(self, frame: Call, s: Statement) -> None:
        """Continue at the target of a jump."""
        self._jump(s.column)
        place = frame.first if s.way == "S" else self.place(frame, s.target, s.way, s.column)
        frame.repeats = [r for r in frame.repeats if r[2] <= place <= r[0]]
        frame.at = place

    def labels(self, unit: Unit) -> dict[str, list[int]]:
        """Lines of a program by their labels and block numbers."""
        if unit.labels is None:
            unit.labels = {}
            for i, line in enumerate(unit.lines):
                for name in self.language.labels_of(line):
                    unit.labels.setdefault(name, []).append(i)
        return unit.labels

    def place(self, frame: Call, target: str, direction: str, column: int) -> int:
        """Line of a label or block number; `direction` F: forwards, B: backwards, C: a missing target is ignored."""
        if target.startswith("="):  # a block number by an expression
            target = f"N{int(self.language.number_of(target[1:], column))}"
        places = self.labels(frame.unit).get(target, [])
        forward = [i for i in places if i > frame.at]
        back = [i for i in places if i <= frame.at]
        found = {"F": forward[:1], "B": back[-1:]}.get(direction, forward[:1] or back[-1:])
        if not found and direction == "C":
            return frame.at + 1
        if not found:
            way = {"F": " further on (GOTOF)", "B": " before (GOTOB)"}.get(direction, "")
            raise WordError(f"there is no label or block '{target}'{way}; add it or correct the jump", column)
        return found[0]

    def _repeat(self, frame: Call, at: int, s: Statement) -> None:
        labels = self.labels(frame.unit)

        def label(text: str) -> int:
            return needed(labels.get(text), f"there is no label '{text}'; add '{text}:' before the part to repeat", s.column)[0]

        first = label(s.target)
        if s.last:
            last = label(s.last)
        elif s.way == "B":
            last = first
        else:
            closing = [i for i in labels.get("ENDLABEL", []) if i >= first]
            last = closing[0] if closing and (closing[0] < at or first > at) else (at - 1 if first < at else len(frame.unit.lines) - 1)
        if last < first or first <= at <= last:
            raise WordError(f"REPEAT {s.target}: the part to repeat holds the REPEAT itself or is empty; move the labels", s.column)
        times = int(self.language.number_of(s.times, s.column)) if s.times else 1
        if len(frame.repeats) >= 20:
            raise WordError("more than 20 REPEAT inside each other; correct the labels", s.column)
        if times <= 0:
            self.advance(frame)
            return
        self._count()
        frame.repeats.append([last, at, first, times])
        frame.at = first
