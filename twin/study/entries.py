"""Catalogue entries in a polynomial: they have no order, so each entry but the first gets an indicator column."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Columns:
    """(factor, entry) of each column: the factor's values if entry is None, otherwise 1 where that entry is chosen. `first` has no column."""

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
    """Columns for factors (row, factor); the `listed` factors hold numbers of entries."""
    of: list[tuple[int, float | None]] = []
    first = {}
    for i in range(table.shape[1]):
        if i not in listed:
            of.append((i, None))
            continue
        first[i], *others = np.unique(table[:, i]).tolist()
        of += [(i, entry) for entry in others] or [(i, None)]
    return Columns(tuple(of), first)
