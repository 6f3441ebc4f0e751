"""Thresholds that note what a diagnosis does with them, so that a move that cannot change the answer needs no further diagnosis.

A watched threshold carries its value and the values that it would have after each move. Arithmetic is done for all of them. A move can change
the answer only if a comparison comes out differently for it, or if its value leaves the arithmetic: into a compiled function, an
array, an index, a loop count. Both are noted. If neither happens, the diagnosis with that move is the same one, step by step.

    thresholds, watch = watched(T, {("evidence", 1.33): 18.6})
    diagnose with them installed        (`devtools.sensitivity.installed`)
    watch.open                          the moves that have to be diagnosed
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
import operator
from typing import Any, cast

import numpy as np

from twin.diagnose.settings import Thresholds

Move = tuple[str, float]
"""Name of a threshold and the factor by which it is moved."""


@dataclass
class Watch:
    """What a diagnosis did with its thresholds."""

    open: set[Move] = field(default_factory=set)  # moves that can change the answer
    reached: set[str] = field(default_factory=set)  # thresholds that were used at all
    outcomes: dict[str, set[bool]] = field(default_factory=dict)  # results of the comparisons with each threshold


class Watched:
    """A number that depends on thresholds: its value, and its value after each move that changes it."""

    __slots__ = ("moved", "value", "watch")

    def __init__(self, value: Any, moved: Mapping[Move, Any], watch: Watch) -> None:
        self.value, self.moved, self.watch = value, moved, watch

    @property
    def __class__(self) -> type:  # a number for isinstance, so that a document keeps it
        return type(self.value)

    @__class__.setter
    def __class__(self, _: type) -> None:
        raise TypeError("a watched number keeps its class")

    def plain(self, *_: Any, **__: Any) -> Any:
        """The value alone. From here on nobody watches it, so every move of it stays open."""
        self.watch.open.update(self.moved)
        self.watch.reached.update(name for name, _ in self.moved)
        return self.value

    def __float__(self) -> float:
        return float(self.plain())

    def __int__(self) -> int:
        return int(self.plain())

    def __index__(self) -> int:
        return operator.index(self.plain())

    def __bool__(self) -> bool:
        return bool(_applied(bool, self))

    def __neg__(self) -> Any:
        return _applied(operator.neg, self)

    def __abs__(self) -> Any:
        return _applied(abs, self)

    def __round__(self, digits: int | None = None) -> Any:
        return _applied(lambda value: round(value, digits), self)

    def __divmod__(self, other: Any) -> Any:
        return divmod(self.plain(), other)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.asarray(self.plain(), dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *values: Any, **options: Any) -> Any:
        if method == "__call__" and not any(option is not None for option in options.values()):
            return _applied(ufunc, *values)
        return getattr(ufunc, method)(*(v.plain() if isinstance(v, Watched) else v for v in values), **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.plain(), name)

    def __repr__(self) -> str:
        return repr(self.plain())

    def __hash__(self) -> int:
        return hash(self.plain())


def _operator(function: Callable[..., Any]) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """A method for a binary operator, and the one for swapped operands."""
    return lambda self, other: _applied(function, self, other), lambda self, other: _applied(function, other, self)


for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "pow", "or"):
    _method, _swapped = _operator(getattr(operator, _name if _name != "or" else "or_"))
    setattr(Watched, f"__{_name}__", _method)
    setattr(Watched, f"__r{_name}__", _swapped)
for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Watched, f"__{_name}__", _operator(getattr(operator, _name))[0])


def _applied(function: Callable[..., Any], *values: Any) -> Any:
    """A function of watched values: a watched value, or the plain result of a comparison."""
    among = [v for v in values if isinstance(v, Watched)]
    watch = among[0].watch

    def after(move: Move | None) -> Any:
        return function(*((v.moved.get(move, v.value) if move else v.value) if isinstance(v, Watched) else v for v in values))

    moves = {move for v in among for move in v.moved}
    names = {name for name, _ in moves}
    value = after(None)
    moved = {move: value if move in watch.open else after(move) for move in moves}
    differing = {move for move, other in moved.items() if not np.array_equal(other, value, equal_nan=True)}
    watch.reached.update(names)
    if np.asarray(value).dtype == bool:
        watch.open.update(differing)
        for name in names:
            watch.outcomes.setdefault(name, set()).update(bool(x) for x in np.unique(np.asarray(value)))
        return value
    if np.ndim(value):
        watch.open.update(differing)
        return value
    # a move that the function swallows (a rounded count, a limit that does not bind) is no longer carried
    carried = {move: other for move, other in moved.items() if move in differing or move in watch.open}
    return Watched(value, carried, watch) if carried else value


def watched(thresholds: Thresholds, moves: Mapping[Move, float]) -> tuple[Thresholds, Watch]:
    """The thresholds, watched for the moves (threshold and factor -> moved value), and what will be noted."""
    watch = Watch()
    by_name: dict[str, dict[Move, float]] = {}
    for (name, factor), value in moves.items():
        by_name.setdefault(name, {})[name, factor] = value
    values = {name: Watched(getattr(thresholds, name), of, watch) for name, of in by_name.items()}
    return replace(thresholds, **cast(dict[str, Any], values)), watch
