"""Expressions of all languages: one evaluator, a grammar for each.

SINUMERIK writes `R1+2*SIN(30)`, `X == 5`, `ARRAY[1,2]`, `$P_UIFR[1,X,TR]`; ISO and LinuxCNC write `[#1+2*SIN[30]]`, `#<depth> GT 5`.
Angles are in degrees. A value is a number, a text, or a frame of a SINUMERIK (`CTRANS(X,5):CROT(Z,30)`). Every fault is a `WordError`
with its column; the reader adds file, line and block.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
import math
import operator
import re
from typing import Any, TypeVar

from twin.program.frames import Frame

Value = float | str | Frame

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"

DEEPEST = 60
"""Largest number of nested brackets; Python allows hardly more."""


class WordError(Exception):
    """A fault in a block: text, and column from 1; 0: it is in no word, so no column is shown."""

    def __init__(self, message: str, column: int = 1) -> None:
        super().__init__(message)
        self.column = column


Kind = TypeVar("Kind")


def needed(value: Kind | None, message: str, column: int = 1) -> Kind:
    """A value that must be there; `message` is the fault if it is not."""
    if value is None:
        raise WordError(message, column)
    return value


def no_value(name: str) -> str:
    """The message about a variable that has none."""
    return f"{name} has no value here; set it before, or give it in the table [variables] of the machine file"


class Null(float):
    """The value of an unset ISO variable: 0 in sums, equal only to another unset one."""


def _bits(operation: Callable[[Any, Any], int]) -> Callable[[float, float], float]:
    return lambda a, b: float(operation(int(a), int(b)))


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, Null) or isinstance(b, Null):
        return isinstance(a, Null) and isinstance(b, Null)
    return bool(a == b)


def _power(a: float, b: float) -> float:
    result = a**b
    if isinstance(result, complex):
        raise ValueError
    return result


COMPARE: dict[str, Callable] = {
    "==": _equal, "<>": lambda a, b: not _equal(a, b), "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
}  # fmt: skip
_LOGIC = {
    "OR": lambda a, b: float(bool(a) or bool(b)), "XOR": lambda a, b: float(bool(a) != bool(b)), "AND": lambda a, b: float(bool(a) and bool(b)),
}  # fmt: skip
SUMS: dict[str, Callable] = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
FUNCTIONS: dict[str, Callable] = {
    "SIN": lambda x: math.sin(math.radians(x)), "COS": lambda x: math.cos(math.radians(x)), "TAN": lambda x: math.tan(math.radians(x)),
    "ASIN": lambda x: math.degrees(math.asin(x)), "ACOS": lambda x: math.degrees(math.acos(x)), "SQRT": math.sqrt, "ABS": abs,
    "LN": math.log, "EXP": math.exp,
    "ROUND": lambda x: math.trunc(2.0 * x) - math.trunc(x),  # a half away from zero
}  # fmt: skip


def as_text(value: Value) -> str:
    """A value as it is written."""
    return value if isinstance(value, str) else "frame" if isinstance(value, Frame) else f"{value:.10g}"


def as_number(value: Value, column: int) -> float:
    """A value that must be a number."""
    if isinstance(value, str):
        raise WordError(f'a number is needed here, not the text "{value[:20]}"', column)
    if isinstance(value, Frame):
        raise WordError("a number is needed here, not a frame", column)
    return value


def outside_quotes(text: str, at: int = 0) -> Iterator[tuple[int, str, int]]:
    """Each character outside quotes: its place, itself, and how many brackets are open behind it."""
    depth, quoted = 0, False
    for i in range(at, len(text)):
        quoted ^= text[i] == '"'
        if not quoted:
            depth += (text[i] in "([") - (text[i] in ")]")
            yield i, text[i], depth


def closing(line: str, at: int) -> int:
    """Position of the bracket that closes the one at `at`; quoted texts are skipped."""
    return needed(next((i for i, _, depth in outside_quotes(line, at) if depth == 0), None), "bracket is not closed", at + 1)


@dataclass(frozen=True)
class Grammar:
    """Grammar of one language: brackets, operators with their precedence, functions."""

    brackets: str
    operators: dict[str, tuple[int, Callable]]
    functions: dict[str, Callable]
    constants: dict[str, float]
    bare: bool = False  # a function may take its argument without brackets


SINUMERIK = Grammar(
    "()",
    {
        "OR": (1, _LOGIC["OR"]), "XOR": (2, _LOGIC["XOR"]), "AND": (3, _LOGIC["AND"]), **{sign: (4, test) for sign, test in COMPARE.items()},
        "<<": (5, lambda a, b: as_text(a) + as_text(b)), "B_OR": (6, _bits(operator.or_)), "B_XOR": (7, _bits(operator.xor)), "B_AND": (8, _bits(operator.and_)),
        "+": (9, SUMS["+"]), "-": (9, SUMS["-"]), "*": (10, SUMS["*"]), "/": (10, SUMS["/"]),
        "DIV": (10, lambda a, b: float(math.trunc(a / b))), "MOD": (10, math.fmod), ":": (11, operator.matmul),
    },
    FUNCTIONS
    | {
        "ATAN2": lambda y, x: math.degrees(math.atan2(y, x)), "POT": lambda x: x * x, "TRUNC": math.trunc, "ROUNDUP": math.ceil,
        "MINVAL": min, "MAXVAL": max, "BOUND": lambda low, high, x: min(max(low, x), high), "NUMBER": float,
        "STRLEN": lambda text: float(str.__len__(text)), "TOUPPER": str.upper, "TOLOWER": str.lower,
        "SUBSTR": lambda text, at, n=200.0: text[int(at) : int(at) + int(n)], "INDEX": lambda text, char: float(str.find(text, char)),
    },
    {"PI": math.pi, "$PI": math.pi, "TRUE": 1.0, "FALSE": 0.0},
)  # fmt: skip
ISO = Grammar(
    "[]",
    {
        **{name: (1, test) for name, test in _LOGIC.items()},
        **{name: (2, COMPARE[sign]) for name, sign in zip(("EQ", "NE", "LT", "GT", "LE", "GE"), COMPARE)},
        "+": (3, SUMS["+"]), "-": (3, SUMS["-"]), "*": (4, SUMS["*"]), "/": (4, SUMS["/"]), "MOD": (4, lambda a, b: a - b * math.floor(a / b)),
        "**": (5, _power),
    },
    FUNCTIONS
    | {
        "FIX": math.floor, "FUP": math.ceil, "SQR": math.sqrt, "ATAN": lambda y, x=1.0: math.degrees(math.atan2(y, x)), "POW": _power,
        "BIN": lambda x: float(sum((int(x) >> 4 * i & 15) * 10**i for i in range(12))), "BCD": lambda x: float(int(str(int(x)), 16)),
    },
    {},
)  # fmt: skip
_ON_BITS = {"AND": (4, _bits(operator.and_)), "OR": (3, _bits(operator.or_)), "XOR": (3, _bits(operator.xor))}
FANUC = replace(
    ISO,
    operators={**ISO.operators, **_ON_BITS, "AN": _ON_BITS["AND"], "XO": _ON_BITS["XOR"]},
    functions={**ISO.functions, **{name[:2]: work for name, work in ISO.functions.items() if name not in ("SQR", "LN", "POW")}},
)
"""ISO as a Fanuc reads it: AND, OR and XOR work on the bits and bind like * and +, ahead of a comparison; two letters of a word are enough."""
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:EX([+-]?\d{1,3}))?", re.A)
_NAME = re.compile(r"[A-Z_$][A-Z0-9_$]*", re.A)
_SIGN = re.compile(r"==|<>|<=|>=|<<|\*\*|[-+*/<>^]|:(?=\s*[A-Z$_])")
_CODED = re.compile(r"'(?:H([0-9A-F]{1,8})|B([01]{1,32}))'")


class Expression:
    """One evaluation of a text in one grammar.

    `variable(expression, name, column)` gives the value of a name; it may read an index with `arguments`.
    `hash_sign(expression, column)` reads the text after a `#`. Without `variable` the text is read for its end alone.
    """

    def __init__(self, text: str, grammar: Grammar, variable: Callable | None, hash_sign: Callable | None = None, column: int = 1) -> None:
        self.text, self.grammar, self.variable, self.hash_sign, self.at, self.column = text, grammar, variable, hash_sign, 0, column
        self.depth = 0

    def fail(self, message: str, at: int | None = None) -> WordError:
        return WordError(message, self.column + (self.at if at is None else at))

    def peek(self) -> str:
        """The next character that is no blank, "" at the end."""
        while self.at < len(self.text) and self.text[self.at] in " \t":
            self.at += 1
        return self.text[self.at] if self.at < len(self.text) else ""

    def whole(self) -> Value:
        """The value of all of the text."""
        value = self.value()
        if self.peek():
            raise self.fail(f"'{self.text[self.at :].strip()[:20]}' does not continue the expression")
        return value

    def value(self, level: int = 1) -> Value:
        """The value up to the first character that does not continue the expression."""
        left = self.atom()
        while (sign := self._operator()) and self.grammar.operators[sign[0]][0] >= level:
            name, end = sign
            at, self.at = self.at, end
            own, work = self.grammar.operators[name]
            right = self.value(own + 1)
            left = self._apply(name, work, (left, right), at)
        return left

    def _operator(self) -> tuple[str, int] | None:
        self.peek()
        match = _SIGN.match(self.text, self.at)
        if not match:
            match = _NAME.match(self.text, self.at)
            if match and self.grammar is not SINUMERIK:  # X1AND2 and 5MOD3: names of ISO are not separated
                for name in self.grammar.operators:
                    if name.isalpha() and match[0].startswith(name):
                        return name, self.at + len(name)
        if not match or match[0] not in self.grammar.operators:
            return None
        return match[0], match.end()

    def _apply(self, name: str, work: Callable, arguments: tuple, at: int) -> Value:
        if self.variable is None:
            return 0.0
        try:
            result = work(*arguments)
            if isinstance(result, str | Frame):
                return result
            finite = math.isfinite(result)
        except ZeroDivisionError:
            raise self.fail("division by zero", at) from None
        except (ValueError, TypeError, OverflowError):
            shown = ", ".join(as_text(a) for a in arguments)
            raise self.fail(f"{name}({shown}) has no value", at) from None
        if not finite:
            raise self.fail("expression gives no finite number", at)
        return float(result)

    def atom(self) -> Value:
        """A number, a variable, a function or an expression in brackets, with its sign."""
        self.depth += 1
        if self.depth > DEEPEST:
            raise self.fail("expression is nested too deeply")
        value = self._atom()
        self.depth -= 1
        return value

    def _atom(self) -> Value:
        char, at = self.peek(), self.at
        if match := _NUMBER.match(self.text, self.at):
            self.at = match.end()
            digits = match[0].split("EX")
            number = float(digits[0]) * (10.0 ** max(-300, min(300, int(digits[1]))) if len(digits) > 1 else 1.0)
            if not math.isfinite(number):
                raise self.fail("the number is too large", at)
            return number
        if char in ("+", "-"):
            self.at += 1
            signed = as_number(self.atom(), self.column + at)
            return -signed if char == "-" else signed
        if char == self.grammar.brackets[0]:
            self.at += 1
            inner = self.value()
            if self.peek() != self.grammar.brackets[1]:
                raise self.fail("bracket is not closed", at)
            self.at += 1
            return inner
        if char == '"':
            self.at = self.text.find('"', at + 1) + 1
            if self.at == 0:
                raise WordError("text is not closed with a quote", self.column + at)
            return self.text[at + 1 : self.at - 1]
        if char == "'" and (match := _CODED.match(self.text, at)):
            self.at = match.end()
            return float(int(match[1], 16) if match[1] else int(match[2], 2))
        if char == "#" and self.hash_sign:
            self.at += 1
            return float.__mul__(1.0, v) if type(v := self.hash_sign(self, at)) is not Null else v
        if match := _NAME.match(self.text, at):
            self.at = match.end()
            return self._named(match[0], at)
        if self.variable is None:
            return 0.0
        raise self.fail("a number or variable is missing" + (f" before '{char}'" if char else ""))

    def _named(self, name: str, at: int) -> Value:
        if name in ("NOT", "B_NOT") and self.grammar is SINUMERIK:
            operand = as_number(self.atom(), self.column + at)
            return float(not operand) if name == "NOT" else float(~int(operand))
        if self.variable is None:
            while self.at < len(self.text) and self.text[self.at] in "([":
                self.at = closing(self.text, self.at) + 1
            return 0.0
        if name in self.grammar.constants:
            return self.grammar.constants[name]
        if name in self.grammar.functions and self.peek() == self.grammar.brackets[0]:
            arguments = self.arguments()
            if name in ("ATAN", "AT") and self.peek() == "/":
                self.at += 1
                arguments += [self.atom()]
            return self._apply(name, self.grammar.functions[name], tuple(arguments), at)
        if name in self.grammar.functions and self.grammar.bare:
            return self._apply(name, self.grammar.functions[name], (self.atom(),), at)
        if name in self.grammar.functions:
            raise self.fail(f"{name} needs its argument in brackets {' '.join(self.grammar.brackets)}", at)
        value: Value = self.variable(self, name, at)
        return value

    def arguments(self) -> list[Value]:
        """Values between brackets of any kind, separated by commas."""
        at, close = self.at, {"(": ")", "[": "]"}[self.peek()]
        self.at += 1
        values = [] if self.peek() == close else [self.value()]
        while self.peek() == ",":
            self.at += 1
            values.append(self.value())
        if self.peek() != close:
            raise self.fail(f"bracket is not closed, '{close}' is missing", at)
        self.at += 1
        return values
