"""Words of a SINUMERIK block.

A block is split into words: an address with a number (`X10.5`, `G641`), an assignment (`X=R1+5`, `A3=0.1`, `FL[X]=500`,
`R3=SIN(30)`), a name with arguments (`CYCLE832(0.01,3)`, `MSG("text")`) or a bare name (`TRAORI`).
"""

from __future__ import annotations

from dataclasses import dataclass
import math
import re

from twin.program.expressions import WordError

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_BLANK = re.compile(r"[ \t\r\n]*")
_ASSIGN = re.compile(r"([A-Z_$][A-Z_$][A-Z0-9_$]*|[A-Z]\d*)[ \t]*(?==(?!=)|\[)", re.A)
_ADDRESS = re.compile(rf"([A-Z])[ \t]*({NUMBER})", re.A)
_NAME = re.compile(r"[A-Z_$][A-Z0-9_$]*", re.A)
_OPERAND = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:EX[+-]?\d+)?|'[HB][0-9A-F]+'|[A-Z_$][A-Z0-9_$]*", re.A)
_WORD_OPERATOR = re.compile(r"(?:DIV|MOD|AND|OR|XOR|B_AND|B_OR|B_XOR)\b")
_SIGNS = re.compile(r"==|<>|<=|>=|<<|[-+*/<>]")
_PREFIX = re.compile(r"(?:NOT|B_NOT)\b")


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
    words: list[Word] = []
    at = _BLANK.match(line).end()  # type: ignore[union-attr]
    while at < len(line):
        column = at + 1
        word, end = _assignment(line, at) or (None, at)
        if word:
            words.append(word)
        elif match := _ADDRESS.match(line, at):
            end, text, text_column = match.end(), None, 0
            if match[1] == "L" and line[end : end + 1] == "(":
                close = closing(line, end)
                text, text_column, end = line[end + 1 : close], end + 2, close + 1
            if not math.isfinite(value := float(match[2])):
                raise WordError("the number is too large", column)
            words.append(Word(match[1], column, value=value, text=text, text_column=text_column))
        elif match := _NAME.match(line, at):
            end, text, text_column = match.end(), None, 0
            behind = _BLANK.match(line, end).end()  # type: ignore[union-attr]
            if behind < len(line) and line[behind] == "(":
                close = closing(line, behind)
                text, text_column, end = line[behind + 1 : close], behind + 2, close + 1
            elif (
                match[0] in ("CALL", "PCALL", "EXTCALL") and line[behind : behind + 1] == '"' and (close := line.find('"', behind + 1)) > 0
            ):
                text, text_column, end = line[behind : close + 1], behind + 1, close + 1
            words.append(Word(match[0], column, text=text, text_column=text_column))
        else:
            raise WordError(f"'{line[at]}' starts no word", column)
        at = _BLANK.match(line, end).end()  # type: ignore[union-attr]
    return words


def _assignment(line: str, at: int) -> tuple[Word, int] | None:
    """NAME=expression or NAME[index]=expression."""
    match = _ASSIGN.match(line, at)
    if not match:
        return None
    end, index = match.end(), None
    if line[end] == "[":
        close = closing(line, end)
        index, end = line[end + 1 : close], _BLANK.match(line, close + 1).end()  # type: ignore[union-attr]
        if line[end : end + 1] != "=" or line[end : end + 2] == "==":
            raise WordError(f"'{match[1]}[{index}]' is not given a value; add '='", at + 1)
    begin = end + 1
    end = end_of_expression(line, begin)
    return Word(match[1], at + 1, text=line[begin:end], assigned=True, text_column=begin + 1, index=index), end


def closing(line: str, at: int) -> int:
    """Position of the bracket that closes the one at `at`; quoted texts are skipped."""
    depth, quoted = 0, False
    for i in range(at, len(line)):
        if line[i] == '"':
            quoted = not quoted
        elif not quoted and line[i] in "([":
            depth += 1
        elif not quoted and line[i] in ")]":
            depth -= 1
            if depth == 0:
                return i
    raise WordError("bracket is not closed", at + 1)


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


def end_of_expression(line: str, at: int) -> int:
    """End of an expression that starts at `at`: the first character that cannot continue it."""
    operand = True  # an operand is due, not an operator
    while True:
        behind = _BLANK.match(line, at).end()  # type: ignore[union-attr]
        if behind == len(line):
            return behind
        char = line[behind]
        if operand and char == '"':
            at, operand = line.find('"', behind + 1) + 1, False
            if at == 0:
                raise WordError("text is not closed with a quote", behind + 1)
        elif operand and char in "+-":
            at = behind + 1
        elif operand and (match := _PREFIX.match(line, behind)):
            at = match.end()
        elif operand and char == "(":
            at, operand = closing(line, behind) + 1, False
        elif operand:
            match = _OPERAND.match(line, behind)
            if not match:
                return at
            at, operand = match.end(), False
            while at < len(line) and line[at] in "([" and match[0][0] not in "0123456789.":
                at = closing(line, at) + 1
        elif (match := _SIGNS.match(line, behind)) or (match := _WORD_OPERATOR.match(line, behind)):
            at, operand = match.end(), True
        elif char == ":" and re.match(r":\s*[$A-Z_]", line[behind:]):  # frames in a chain
            at, operand = behind + 1, True
        else:
            return at
