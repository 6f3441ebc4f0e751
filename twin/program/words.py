"""Words of a block, as the Sinumerik 840D writes them, and arithmetic with R-parameters.

A block is split into words: an address with a number (`X10.5`, `G641`), an assignment (`X=R1+5`, `A3=0.1`, `ADIS=0.2`,
`R3=SIN(30)`), a name with arguments (`CYCLE832(0.01,3)`, `MSG("text")`) or a bare name (`TRAORI`). Angles are in degrees.
Every fault is a `WordError` with its column; the reader adds file, line and block.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from dataclasses import dataclass
import math
import re

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"
_BLANK = re.compile(r"[ \t\r\n]*")
_ASSIGN = re.compile(r"(R\d{1,4}|[A-Z]{2,}[A-Z0-9_]*|[A-Z]\d?)[ \t]*=(?!=)", re.A)
_ADDRESS = re.compile(rf"([A-Z])[ \t]*({NUMBER})", re.A)
_NAME = re.compile(r"[A-Z_$][A-Z0-9_$]*", re.A)
_TOKEN = re.compile(r"[ \t]*(?:(\d+\.?\d*|\.\d+)(?:EX([+-]?\d+))?|(R\d{1,4})|([A-Z][A-Z0-9]*)|(==|<>|<=|>=|[-+*/()<>,=]))", re.A)


class WordError(Exception):
    """A fault in a block: what, and at which column (from 1)."""

    def __init__(self, message: str, column: int):
        super().__init__(message)
        self.column = column


@dataclass(frozen=True)
class Word:
    """One word: `value` of an address, `text` right of an assignment or between brackets (None if there is none)."""

    name: str
    column: int
    value: float | None = None
    text: str | None = None
    assigned: bool = False
    text_column: int = 0


def split_words(line: str) -> list[Word]:
    """The words of a line in capitals, comment already taken off."""
    words: list[Word] = []
    at = _BLANK.match(line).end()  # type: ignore[union-attr]
    while at < len(line):
        column = at + 1
        if match := _ASSIGN.match(line, at):
            end = _end_of_expression(line, match.end())
            words.append(Word(match[1], column, text=line[match.end() : end], assigned=True, text_column=match.end() + 1))
        elif match := _ADDRESS.match(line, at):
            end = match.end()
            words.append(Word(match[1], column, value=float(match[2])))
        elif match := _NAME.match(line, at):
            end, text, text_column = match.end(), None, 0
            behind = _BLANK.match(line, end).end()  # type: ignore[union-attr]
            if behind < len(line) and line[behind] == "(":
                close = _closing(line, behind)
                text, text_column, end = line[behind + 1 : close], behind + 2, close + 1
            words.append(Word(match[0], column, text=text, text_column=text_column))
        else:
            raise WordError(f"'{line[at]}' starts no word", column)
        at = _BLANK.match(line, end).end()  # type: ignore[union-attr]
    return words


def _closing(line: str, at: int) -> int:
    """Position of the bracket that closes the one at `at`; texts in quotes are passed over."""
    depth, quoted = 0, False
    for i in range(at, len(line)):
        if line[i] == '"':
            quoted = not quoted
        elif not quoted and line[i] == "(":
            depth += 1
        elif not quoted and line[i] == ")":
            depth -= 1
            if depth == 0:
                return i
    raise WordError("bracket is not closed", at + 1)


def _end_of_expression(line: str, at: int) -> int:
    """Where an expression that starts at `at` ends: at the first thing that cannot continue it."""
    behind = _BLANK.match(line, at).end()  # type: ignore[union-attr]
    if behind < len(line) and line[behind] == '"':
        close = line.find('"', behind + 1)
        if close < 0:
            raise WordError("text is not closed with a quote", behind + 1)
        return close + 1
    operand = True  # an operand is due, not an operator
    while True:
        behind = _BLANK.match(line, at).end()  # type: ignore[union-attr]
        if behind == len(line):
            return behind
        char = line[behind]
        if char == "(":
            at = _closing(line, behind) + 1
            operand = False
        elif char in "+-*/":
            at, operand = behind + 1, True
        elif operand:
            match = _TOKEN.match(line, at)
            if not match:
                return at
            at, operand = match.end(), False
        else:
            word = re.compile(r"(DIV|MOD|AND|OR)\b").match(line, behind)
            if not word:
                return at
            at, operand = word.end(), True


_FUNCTIONS = {
    "SIN": lambda x: math.sin(math.radians(x)),
    "COS": lambda x: math.cos(math.radians(x)),
    "TAN": lambda x: math.tan(math.radians(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)),
    "ACOS": lambda x: math.degrees(math.acos(x)),
    "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)),
    "SQRT": math.sqrt,
    "ABS": abs,
    "POT": lambda x: x * x,
    "ROUND": lambda x: math.trunc(2.0 * x) - math.trunc(x),  # the nearest integer, a half away from zero
    "TRUNC": math.trunc,
    "LN": math.log,
    "EXP": math.exp,
}
_COMPARE = {
    "==": lambda a, b: a == b,
    "<>": lambda a, b: a != b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
    "<=": lambda a, b: a <= b,
    ">=": lambda a, b: a >= b,
}


class Arithmetic:
    """Evaluates expressions with R-parameters, which start at 0 as on the control."""

    def __init__(self) -> None:
        self.parameters: MutableMapping[int, float] = {}

    def value(self, text: str, column: int) -> float:
        """The value of an expression or condition (1 true, 0 false); `column` is where the text starts."""
        self._text, self._column, self._at, self._depth = text, column, 0, 0
        result = self._or()
        if _BLANK.match(text, self._at).end() != len(text):  # type: ignore[union-attr]
            raise WordError(f"'{text[self._at :].strip()[:20]}' does not continue the expression", column + self._at)
        if not math.isfinite(result):
            raise WordError("expression gives no finite number", column)
        return result

    def _peek(self) -> re.Match[str] | None:
        return _TOKEN.match(self._text, self._at)

    def _take(self, *wanted: str) -> str | None:
        """Step over one of the wanted operators or names and return it."""
        match = self._peek()
        if match and (match[5] in wanted or match[4] in wanted):
            self._at = match.end()
            return match[5] or match[4]
        return None

    def _or(self) -> float:
        left = self._and()
        while self._take("OR"):
            right = self._and()
            left = float(bool(left) or bool(right))
        return left

    def _and(self) -> float:
        left = self._compare()
        while self._take("AND"):
            right = self._compare()
            left = float(bool(left) and bool(right))
        return left

    def _compare(self) -> float:
        left = self._sum()
        if sign := self._take(*_COMPARE):
            left = float(_COMPARE[sign](left, self._sum()))
        return left

    def _sum(self) -> float:
        left = self._product()
        while sign := self._take("+", "-"):
            right = self._product()
            left = left + right if sign == "+" else left - right
        return left

    def _product(self) -> float:
        left = self._factor()
        while sign := self._take("*", "/", "DIV", "MOD"):
            at = self._at
            right = self._factor()
            if sign != "*" and right == 0.0:
                raise WordError("division by zero", self._column + at)
            if sign == "*":
                left = left * right
            elif sign == "/":
                left = left / right
            else:
                left = float(math.trunc(left / right)) if sign == "DIV" else math.fmod(left, right)
        return left

    def _factor(self) -> float:
        self._depth += 1
        if self._depth > 100:
            raise WordError("expression is nested too deeply", self._column)
        match = self._peek()
        where = self._column + self._at
        if not match:
            raise WordError("a number or R-parameter is missing", where)
        self._at = match.end()
        number, exponent, parameter, name, sign = match.groups()
        if number:
            result = float(number) * (10.0 ** max(-300, min(300, int(exponent))) if exponent else 1.0)
        elif parameter:
            result = self.parameters.get(int(parameter[1:]), 0.0)
        elif sign in ("-", "+"):
            result = self._factor() * (-1.0 if sign == "-" else 1.0)
        elif sign == "(":
            result = self._or()
            if not self._take(")"):
                raise WordError("bracket is not closed", where)
        elif name == "NOT":
            result = float(not self._factor())
        elif name == "PI":
            result = math.pi
        elif name in _FUNCTIONS:
            result = self._call(name, where)
        else:
            raise WordError(f"'{match[0].strip()}' is neither a number, an R-parameter nor a function", where)
        self._depth -= 1
        return float(result)

    def _call(self, name: str, where: int) -> float:
        if not self._take("("):
            raise WordError(f"{name} needs its argument in brackets", where)
        arguments = [self._sum()]
        while self._take(","):
            arguments.append(self._sum())
        if not self._take(")"):
            raise WordError("bracket is not closed", where)
        try:
            return float(_FUNCTIONS[name](*arguments))  # type: ignore[operator]
        except (ValueError, TypeError, OverflowError):
            raise WordError(f"{name}({', '.join(f'{a:g}' for a in arguments)}) has no value", where) from None
