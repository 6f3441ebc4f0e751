"""Entries of a catalogue in a polynomial: their numbers have no order, so each but the first is a column of its own, 1 where it is chosen."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Columns:
    """(factor, entry) of each column: the factor's values where entry is None, else whether that entry is chosen; `first` is left out."""

    of: tuple[tuple[int, float | None], ...]
    first: dict[int, float]

    @property
    def factors(self) -> list[int]:
        """The factor of each column."""
        return [factor for factor, _ in self.of]

    def spread(self, table: np.ndarray) -> np.ndarray:
        """Columns (row, column) of factors (row, factor)."""
        return np.column_stack([table[:, i] if entry is None else (table[:, i] == entry).astype(float) for i, entry in self.of])


def columns_of(table: np.ndarray, listed: Collection[int] = ()) -> Columns:
    """The columns for factors (row, factor), of which the `listed` ones are numbers of entries."""
    of: list[tuple[int, float | None]] = []
    first = {}
    for i in range(table.shape[1]):
        if i not in listed:
            of.append((i, None))
            continue
        first[i], *others = np.unique(table[:, i]).tolist()
        of += [(i, entry) for entry in others] or [(i, None)]
    return Columns(tuple(of), first)
