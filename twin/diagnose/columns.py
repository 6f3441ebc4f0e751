"""Columns of the linear problems of a diagnosis, held once in single precision however many problems share them, without the zeros at their ends.

A record of two minutes has 400 000 rows an axis, and a search looks at some hundred responses of that length. Fits, tunings and screenings
therefore share the columns themselves: putting columns side by side copies nothing. A response needs no more than the seven digits of single
precision. Sums over all rows do, so every product is computed in double precision. The rows are sorted by axis and channel, so that what an
effect does not touch lies at the ends of its column.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.compiled_functions import compiled

BLOCK = 16_384
"""Rows of several columns in double precision at a time."""
LONG = 65_536
"""Rows of one vector in double precision at a time: they stay near the processor while the columns pass."""


FEW = 2
"""Columns that are multiplied one by one: with more, a product of matrices is faster, although it copies them."""


class Column(NamedTuple):
    """A column from its first to its last value beside zero, in single precision; `first` is the row of the first. It is never modified."""

    first: int
    values: np.ndarray

    def within(self, rows: slice) -> tuple[slice, np.ndarray]:
        """The rows of a slice that have values, and the values."""
        low = max(rows.start, self.first)
        high = max(min(rows.stop, self.first + len(self.values)), low)
        return slice(low, high), self.values[low - self.first : high - self.first]

    def scaled(self, scale: np.ndarray) -> Column:
        """Each row multiplied by `scale` (row,)."""
        return Column(self.first, (self.values * scale[self.first :][: len(self.values)]).astype(np.float32))


def column_of(values: np.ndarray) -> Column:
    """The column of values (row,)."""
    seen = np.flatnonzero(values)
    first, end = (int(seen[0]), int(seen[-1]) + 1) if seen.size else (0, 0)
    shown = np.array(values[first:end], np.float32)
    shown.flags.writeable = False
    return Column(first, shown)


class Columns:
    """Columns (row, n) side by side; they are never modified."""

    def __init__(self, each: Iterable[np.ndarray | Column], rows: int) -> None:
        self.each = tuple(column if isinstance(column, Column) else column_of(column) for column in each)
        self.rows = rows

    def __len__(self) -> int:
        """Number of columns."""
        return len(self.each)

    def beside(self, *others: Columns) -> Columns:
        """These columns and then those of others."""
        return Columns((c for columns in (self, *others) for c in columns.each), self.rows)

    def chosen(self, which: Iterable[int]) -> Columns:
        """Some of the columns, by index."""
        return Columns((self.each[i] for i in which), self.rows)

    def at(self, rows: np.ndarray) -> Columns:
        """The columns at some rows, by index."""
        return Columns((self.whole(i)[rows] for i in range(len(self))), len(rows))

    def scaled(self, scale: np.ndarray) -> Columns:
        """Each row multiplied by `scale` (row,)."""
        return Columns((c.scaled(scale) for c in self.each), self.rows)

    def whole(self, i: int) -> np.ndarray:
        """Column i (row,) with its zeros, in double precision."""
        return self.chosen([i]).part()[:, 0]

    def part(self, rows: slice | None = None) -> np.ndarray:
        """Some or all rows (row, n) in double precision."""
        rows = rows or slice(0, self.rows)
        out = np.zeros((rows.stop - rows.start, len(self)), order="F")
        for i, column in enumerate(self.each):
            shown, values = column.within(rows)
            out[shown.start - rows.start : shown.stop - rows.start, i] = values
        return out

    def times(self, coefficients: np.ndarray) -> np.ndarray:
        """Sum (row,) of the columns with these coefficients (n,)."""
        out = np.zeros(self.rows)
        for rows in self._blocks(LONG):
            for column, coefficient in zip(self.each, coefficients.tolist()):
                shown, values = column.within(rows)
                _add(out[shown], values, coefficient)
        return out

    def onto(self, other: np.ndarray | Columns) -> np.ndarray:
        """Inner products with a vector (row,), as (n,), or with other columns (row, m), as (n, m)."""
        if isinstance(other, Columns) and len(other) <= FEW:
            return np.array([self.onto(other.whole(i)) for i in range(len(other))]).reshape(len(other), len(self)).T
        if isinstance(other, Columns):
            return _sum(self.part(rows).T @ other.part(rows) for rows in self._blocks())
        vector = np.ascontiguousarray(other, float)
        shown = ([column.within(rows) for column in self.each] for rows in self._blocks(LONG))
        return _sum(np.array([_inner(values, vector[rows]) for rows, values in of_block]) for of_block in shown)

    def gram(self, mapper: Callable[..., Iterable[Any]] = map) -> np.ndarray:
        """Inner products (n, n) of the columns; `mapper` maps over blocks of rows."""
        return _sum(mapper(self._products, self._blocks()))

    def grams(self, parts: Sequence[Sequence[slice]]) -> np.ndarray:
        """Inner products (part, n, n) over the rows of each part of the record."""
        out = np.zeros((len(parts), len(self), len(self)))
        for i, slices in enumerate(parts):
            for rows in slices:
                out[i] += self._products(rows)
        return out

    def _products(self, rows: slice) -> np.ndarray:
        part = self.part(rows)
        return part.T @ part

    def _blocks(self, length: int = BLOCK) -> Iterator[slice]:
        return (slice(first, min(first + length, self.rows)) for first in range(0, max(self.rows, 1), length))


@compiled(fastmath={"reassoc", "contract"})
def _inner(column, vector):  # type: ignore[no-untyped-def]
    """Inner product of a column in single precision with a vector in double precision, without a copy of the column."""
    total = 0.0
    for i in range(len(column)):
        total += column[i] * vector[i]
    return total


@compiled(fastmath={"contract"})
def _add(out, column, coefficient):  # type: ignore[no-untyped-def]
    """out += coefficient column."""
    for i in range(len(column)):
        out[i] += coefficient * column[i]


def _sum(products: Iterable[np.ndarray]) -> np.ndarray:
    return np.asarray(sum(products))
