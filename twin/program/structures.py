"""Control structures of a program: the lines that begin, divide and end a loop, a condition or a subprogram.

SINUMERIK nests IF .. ENDIF by position, LinuxCNC and Fanuc name both ends of a structure (O100, DO1): the `key`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from twin.program.expressions import WordError
from twin.program.source import Unit

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

    `text` is a condition, a target or arguments, starting at `column`; `rest`: further data for this `kind`.
    """

    kind: str
    key: str = ""
    text: str = ""
    column: int = 1
    rest: tuple = ()


def structures_of(unit: Unit, statement: Callable[[str], Statement | str]) -> Table:
    """The table of a whole program; `statement` classifies a line. A fault in a line is raised when the line runs."""
    table: Table = {}
    stacks: dict[str, list[list[int]]] = {}
    subs: list[int] = []
    for at, text in enumerate(unit.lines):
        if at not in unit.statements:
            try:
                unit.statements[at] = statement(text)
            except WordError:
                continue  # raised when the line runs
        s = unit.statements[at]
        if not isinstance(s, Statement):
            continue
        stack = stacks.setdefault(s.key, [])
        top = unit.statements[stack[-1][0]].kind if stack else ""  # type: ignore[attr-defined]
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


def partners(table: Table, at: int, s: Statement) -> tuple[int, ...]:
    """Lines of the structure that the statement at this line belongs to, first to last."""
    found = table.get(at, ())
    if len(found) < 2:
        end = CLOSES.get(s.kind, "").upper()
        text = f"{s.kind.upper()} has no {end}; add it" if end else f"{s.kind.upper()} ends nothing that was begun; remove it"
        raise WordError(text, s.column)
    if found[0] < 0:
        raise WordError("a subprogram begins inside another one; end the first with ENDSUB before", s.column)
    return found


def loop_around(table: Table, unit: Unit, at: int, s: Statement) -> tuple[int, ...]:
    """The loop with the key of a BREAK or CONTINUE."""
    for places in table.values():
        opener = unit.statements.get(places[0])
        if (
            len(places) > 1
            and places[0] < at < places[-1]
            and isinstance(opener, Statement)
            and opener.kind != "if"
            and opener.key == s.key
        ):
            return places
    raise WordError(f"{s.kind.upper()} is outside the loop {s.key}; correct its number", s.column)
