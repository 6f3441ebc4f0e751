"""The values of a program: its formulas in the grammar of a language, over variables that the language names."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from twin.program.expressions import Expression, Grammar, Value, WordError
from twin.program.flow import Flow
from twin.program.state import State


class Values:
    """Formulas over the variables of the running program; a language says what a name means."""

    def __init__(self, state: State, flow: Flow, grammar: Grammar) -> None:
        self.state, self.flow, self.grammar = state, flow, grammar

    def variable(self, e: Expression, name: str, at: int) -> Value:
        """The value of a name at column `at` of an expression."""
        raise NotImplementedError

    def hashed(self, e: Expression, at: int) -> Value:
        """The value of what follows a `#`."""
        raise e.fail("a number or variable is missing before '#'", at)

    def expression(self, text: str, column: int = 1) -> Expression:
        """An expression that begins at `column`; a condition notes what it reads, so that loops without progress are seen."""

        variable, hashed, reads = self.variable, self.hashed, self.state.reads

        def noted(read: Callable[..., Value], *at: Any) -> Value:
            value = read(*at)
            if reads is not None:
                reads.append(value)
            return value

        if reads is not None:
            variable, hashed = partial(noted, variable), partial(noted, hashed)
        return Expression(text, self.grammar, variable, hashed, 0, column)

    def value_of(self, text: str, column: int) -> Value:
        """The value of an expression: a number or a text."""
        return self.expression(text, column).whole()

    def number_of(self, text: str, column: int) -> float:
        """The value of an expression or condition (1 true, 0 false)."""
        return as_number(self.value_of(text, column), column)

    def no_value(self, name: str, how: str = "set it before") -> str:
        """The message about a variable that has none."""
        return f"{name} has no value here; {how}, or give it in the table [variables] of the machine file"


def as_number(value: Value, column: int) -> float:
    """A value that must be a number."""
    if isinstance(value, str):
        raise WordError(f'a number is needed here, not the text "{value[:20]}"', column)
    return float(value)
