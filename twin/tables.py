"""Typed access to the tables of a TOML file. Every fault raises an InputError with table, key and remedy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math
from typing import Any

import numpy as np

from twin.errors import InputError, nearest
from twin.units import UNITS

SMALLEST = 1e-100
"""Least positive number: the inverse of a smaller one could overflow."""


def is_number(value: object) -> bool:
    """True for a finite number; false for true and false."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def known(table: Any, keys: Collection[str], where: str) -> None:
    """Raise InputError unless this is a table with these keys only."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {table!r} is not a table; write key = value below [..]")
    known_keys(table, keys, where)


def known_keys(table: Mapping[str, Any], keys: Collection[str], where: str) -> None:
    """Raise InputError for any other key."""
    for key in table:
        if key not in keys:
            raise InputError(f"{where}: unknown key '{key}'; {nearest(key, keys)}")


def number(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A finite number."""
    value = _given(table, key, where, default)
    if not is_number(value):
        raise InputError(f"{where}: {key} = {value!r} is not a number; correct it")
    return float(value)


def positive(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number above 0."""
    value = _given(table, key, where, default)
    if not is_number(value) or value < SMALLEST:
        raise InputError(f"{where}: {key} = {value!r} is not a number above 0; correct it")
    return float(value)


def numbers(table: Mapping[str, Any], key: str, count: int, where: str, default: Sequence[float] | None = None) -> np.ndarray:
    """A list (count,) of numbers."""
    value = _given(table, key, where, default)
    if not isinstance(value, list | tuple) or len(value) != count or not all(map(is_number, value)):
        raise InputError(f"{where}: {key} = {value!r}; give a list of {count} numbers")
    return np.array(value, float)


def limits(table: Mapping[str, Any], key: str, where: str, unit: str = "mm") -> tuple[float, float]:
    """Two increasing numbers in `unit`, returned in SI."""
    low, high = numbers(table, key, 2, where).tolist()
    if low >= high:
        raise InputError(f"{where}: {key} = {table[key]}: the first number must be less than the second; correct them")
    return low * UNITS[unit][1], high * UNITS[unit][1]


def listed(table: Mapping[str, Any], key: str, where: str, default: list[Any] | None = None) -> list[Any]:
    """A list."""
    value = _given(table, key, where, default)
    if not isinstance(value, list):
        raise InputError(f"{where}: {key} = {value!r} is not a list; write {key} = [..]")
    return value


def one_of(table: Mapping[str, Any], key: str, options: Collection[str], where: str, default: str | None = None) -> str:
    """One of several words."""
    value = _given(table, key, where, default)
    if not isinstance(value, str) or value not in options:
        raise InputError(f"{where}: {key} = {value!r} is not known; {nearest(str(value), options)}")
    return value


def text(table: Mapping[str, Any], key: str, where: str) -> str:
    """A text."""
    value = _given(table, key, where, None)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} = {value!r} is not text; write it in quotes")
    return value


def _given(table: Mapping[str, Any], key: str, where: str, default: Any) -> Any:
    value = table.get(key, default)
    if value is None:
        raise InputError(f"{where}: {key} is missing; add it")
    return value
