"""Columns of the linear problems of a diagnosis, held once in single precision however many problems share them.

A record of two minutes has 400 000 rows an axis, and a search looks at some hundred responses of that length. Fits, tunings and screenings
therefore share the columns themselves: putting columns side by side copies nothing. A response needs no more than the seven digits of single
precision. Sums over all rows do, so every product is computed in double precision, a block of rows at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

BLOCK = 16_384
"""Rows in double precision at a time."""


class Columns:
    """Columns (row, n) side by side; they are never modified. `each` holds them as arrays (row,)."""

    def __init__(self, each: Iterable[np.ndarray], rows: int) -> None:
        self.each = tuple(np.ascontiguousarray(column, np.float32) for column in each)
        self.rows = rows
        for column in self.each:
            column.flags.writeable = False

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
        return Columns((c[rows] for c in self.each), len(rows))

    def scaled(self, scale: np.ndarray) -> Columns:
        """Each row multiplied by `scale` (row,)."""
        return Columns((c * scale for c in self.each), self.rows)

    def part(self, rows: slice | None = None) -> np.ndarray:
        """Some or all rows (row, n) in double precision."""
        rows = rows or slice(0, self.rows)
        out = np.empty((rows.stop - rows.start, len(self)), order="F")
        for i, column in enumerate(self.each):
            out[:, i] = column[rows]
        return out

    def times(self, coefficients: np.ndarray) -> np.ndarray:
        """Sum (row,) of the columns with these coefficients (n,)."""
        out = np.zeros(self.rows)
        for rows in self._blocks():
            out[rows] = self.part(rows) @ coefficients
        return out

    def onto(self, other: np.ndarray | Columns) -> np.ndarray:
        """Inner products with a vector (row,), as (n,), or with other columns (row, m), as (n, m)."""
        return _sum(self.part(rows).T @ (other.part(rows) if isinstance(other, Columns) else other[rows]) for rows in self._blocks())

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

    def _blocks(self) -> Iterator[slice]:
        return (slice(first, min(first + BLOCK, self.rows)) for first in range(0, max(self.rows, 1), BLOCK))


def _sum(products: Iterable[np.ndarray]) -> np.ndarray:
    return np.asarray(sum(products))
