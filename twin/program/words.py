"""Words of a SINUMERIK block.

A block is split into words: an address with a number (`X10.5`, `G641`), an assignment (`X=R1+5`, `A3=0.1`, `FL[X]=500`,
`R3=SIN(30)`), a name with arguments (`CYCLE832(0.01,3)`, `MSG("text")`) or a bare name (`TRAORI`).
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import re

from twin.program.expressions import NUMBER, SINUMERIK, Expression, WordError, closing, needed

_ASSIGN = re.compile(r"([A-Z_$][A-Z_$][A-Z0-9_$]*|[A-Z]\d*)[ \t]*(?==(?!=)|\[)", re.A)
_OTHER = re.compile(rf"([A-Z])[ \t]*({NUMBER})|([A-Z_$][A-Z0-9_$]*)", re.A)


@dataclass(frozen=True)
class Word:
    """One word: `value` of an address, `text` right of an assignment or between brackets (None if there is none)."""

    name: str
    column: int
    value: float | None = None
    text: str | None = None
    assigned: bool = False
    text_column: int = 0
    index: str | None = None


def split_words(line: str) -> list[Word]:
    """The words of a line in capitals, without comment."""
    words, e = [], Expression(line, SINUMERIK, None)
    while e.peek():
        words.append(_word(e))
    return words


def _word(e: Expression) -> Word:
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
        return Word(match[1], at + 1, None, line[begin : e.at], True, begin + 1, index)
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
    return Word(match[1] or match[3], at + 1, value, text, False, column)


def _inside(e: Expression) -> str:
    """The text between the brackets at the place of the expression, which goes behind them."""
    begin, e.at = e.at + 1, closing(e.text, e.at) + 1
    return e.text[begin : e.at - 1]


def split_arguments(text: str) -> list[tuple[str, int]]:
    """Arguments between commas, each with its start; an empty text has none."""
    if not text.strip():
        return []
    parts, begin, depth, quoted = [], 0, 0, False
    for i, char in enumerate(text):
        if char == '"':
            quoted = not quoted
        elif not quoted:
            depth += (char in "([") - (char in ")]")
            if char == "," and depth == 0:
                parts.append((text[begin:i].strip(), begin))
                begin = i + 1
    return [*parts, (text[begin:].strip(), begin)]
