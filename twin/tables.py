"""Values from the tables of a TOML file: what is missing, unknown or of another kind is an InputError with table, key and remedy."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import math
from typing import Any

import numpy as np

from twin.errors import InputError, nearest
from twin.units import UNITS

SMALLEST = 1e-100
"""A positive number below is none: its inverse overflows."""


def is_number(value: object) -> bool:
    """A finite number; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def known(table: Any, keys: Collection[str], where: str) -> None:
    """Refuse what is no table, and keys that nobody reads."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {table!r} is no table; write key = value below [..]")
    known_keys(table, keys, where)


def known_keys(table: Mapping[str, Any], keys: Collection[str], where: str) -> None:
    """Refuse keys that nobody reads."""
    for key in table:
        if key not in keys:
            raise InputError(f"{where}: unknown key '{key}'; {nearest(key, keys)}")


def number(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number of a table."""
    value = _given(table, key, where, default)
    if not is_number(value):
        raise InputError(f"{where}: {key} = {value!r} is no number; correct it")
    return float(value)


def positive(table: Mapping[str, Any], key: str, where: str, default: float | None = None) -> float:
    """A number above 0 of a table."""
    value = _given(table, key, where, default)
    if not is_number(value) or value < SMALLEST:
        raise InputError(f"{where}: {key} = {value!r} is no number above 0; correct it")
    return float(value)


def numbers(table: Mapping[str, Any], key: str, count: int, where: str, default: Sequence[float] | None = None) -> np.ndarray:
    """A list (count,) of numbers."""
    value = _given(table, key, where, default)
    if not isinstance(value, list | tuple) or len(value) != count or not all(map(is_number, value)):
        raise InputError(f"{where}: {key} = {value!r}; give a list of {count} numbers")
    return np.array(value, float)


def limits(table: Mapping[str, Any], key: str, where: str, unit: str = "mm") -> tuple[float, float]:
    """Two numbers in a unit, the first below the second; returned in SI."""
    low, high = numbers(table, key, 2, where).tolist()
    if low >= high:
        raise InputError(f"{where}: {key} = {table[key]}: the first number must lie below the second; correct them")
    return low * UNITS[unit][1], high * UNITS[unit][1]


def listed(table: Mapping[str, Any], key: str, where: str, default: list[Any] | None = None) -> list[Any]:
    """A list of a table."""
    value = _given(table, key, where, default)
    if not isinstance(value, list):
        raise InputError(f"{where}: {key} = {value!r} is no list; write {key} = [..]")
    return value


def one_of(table: Mapping[str, Any], key: str, options: Collection[str], where: str, default: str | None = None) -> str:
    """A word of a table that is one of several."""
    value = _given(table, key, where, default)
    if not isinstance(value, str) or value not in options:
        raise InputError(f"{where}: {key} = {value!r} is not known; {nearest(str(value), options)}")
    return value


def text(table: Mapping[str, Any], key: str, where: str) -> str:
    """A text of a table."""
    value = _given(table, key, where, None)
    if not isinstance(value, str):
        raise InputError(f"{where}: {key} = {value!r} is no text; write it in quotes")
    return value


def _given(table: Mapping[str, Any], key: str, where: str, default: Any) -> Any:
    value = table.get(key, default)
    if value is None:
        raise InputError(f"{where}: {key} is missing; add it")
    return value
