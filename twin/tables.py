"""Tables of TOML files as typed values. Every fault raises an InputError of one line: the place in the file, what stands there, what to do.

A table has a model (msgspec), whose fields are its keys with types, bounds and defaults:

    class Run(Table, frozen=True):
        file: Annotated[str, asks("name the trace of this run")]
        started_at_s: Number = 0.0

    run = typed(table, Run, "campaign.toml: run 1")

`asks` states what to do; without it the line follows from the type. `number`, `positive`, ... read single keys of tables whose keys
depend on others.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
import functools
import math
import re
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import msgspec.structs
import numpy as np

from twin.errors import InputError, nearest
from twin.units import UNITS

LARGEST = 1e100
"""Larger numbers are refused, as in every TOML file."""

Model = TypeVar("Model", bound=msgspec.Struct)


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the models of tables."""


def asks(what: str = "", **limits: Any) -> msgspec.Meta:
    """What to do about a wrong value, and limits of the value: gt, ge, lt, le, min_length, max_length, pattern."""
    return msgspec.Meta(description=what or None, **limits)


Number = Annotated[float, msgspec.Meta(ge=-LARGEST, le=LARGEST)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=LARGEST)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST)]
Whole = Annotated[int, msgspec.Meta(ge=0)]
Text = Annotated[str, msgspec.Meta(pattern=r"\S")]


def typed(table: Any, model: type[Model], where: str) -> Model:
    """The table as its model. Raises InputError; `where` names the file and the table."""
    try:
        return msgspec.convert(table, model)
    except msgspec.ValidationError as error:
        said, _, path = str(error).partition(" - at `$")
        raise InputError(_line(table, model, where, said, path.rstrip("`"))) from None


def _line(value: Any, kind: Any, where: str, said: str, path: str) -> str:
    """The fault at a path such as `.run[0].file` in words."""
    key, ask, places, here = "", "", [where], ""
    for name, number in re.findall(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]", path):
        if name:
            places += [here] if here else []
            (kind, ask), value = _plain(_fields(kind)[name]), value[name]
            key, here = name, f"[{name}]"
        elif _is_table(_item(kind)):
            kind, value = _item(kind), value[int(number)]
            name = value.get("name") if isinstance(value, dict) else None
            here = f"{key} {int(number) + 1}" + (f" ('{name}')" if isinstance(name, str) else "")
        else:
            break  # a list of values stands in the line as a whole
    if not said.startswith("Object "):
        if (here and here != f"[{key}]") or not key:
            return f"{': '.join([*places, here] if here else places)}: {value!r} is not a table; write key = value below it"
        return f"{': '.join(places)}: {key} = {value!r}; {ask or _remedy(key, kind, value, said)}"
    place, field = ": ".join([*places, here] if here else places), said.split("`")[1]
    if "unknown" in said:
        return f"{place}: unknown key '{field}'; {nearest(field, _fields(kind))}"
    return f"{place}: '{field}' is missing; {_plain(_fields(kind)[field])[1] or 'add it'}"


@functools.cache
def _fields(model: Any) -> dict[str, Any]:
    """Type of each key of a model."""
    return {f.encode_name: f.type for f in msgspec.structs.fields(model)} if _is_table(model) else {}


def _is_table(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, msgspec.Struct)


def _item(kind: Any) -> Any:
    """Type of the elements of a list."""
    return _plain((get_args(kind) or (Any,))[0])[0]


def _plain(kind: Any) -> tuple[Any, str]:
    """A type without annotations and None, and what its annotations ask for."""
    ask = ""
    while True:
        if get_origin(kind) is Annotated:
            kind, *notes = get_args(kind)
            ask = ask or next((n.description for n in notes if isinstance(n, msgspec.Meta) and n.description), "")
        elif get_origin(kind) in (Union, UnionType):
            kind = next(one for one in get_args(kind) if one is not NoneType)
        else:
            return kind, ask


def _remedy(key: str, kind: Any, value: Any, said: str) -> str:
    """What to do about a value of the wrong type or beyond its bounds."""
    bounds = re.search(r"(>=|<=|>|<) (\S+)$", said)
    bound = {">": "above {}", ">=": "of {} or more", "<": "below {}", "<=": "of {} or less"}[bounds[1]] if bounds else ""
    limit = f" {bound.format(f'{float(bounds[2]):g}')}" if bounds and abs(float(bounds[2])) < LARGEST else ""
    if get_origin(kind) is Literal:
        words = [str(word) for word in get_args(kind)]
        close = nearest(value, words)
        return close if close.startswith("did") else f"use {' or '.join(words)}" if len(words) < 3 else f"use one of {', '.join(words)}"
    if kind in (float, int):
        return f"give a {'whole ' * (kind is int)}number{limit}"
    if kind is bool:
        return "write true or false"
    if _is_table(kind) or get_origin(kind) is dict:
        return f"write [{key}] and its keys below it"
    if get_origin(kind) in (tuple, list):
        inner = [_plain(a)[0] for a in get_args(kind) if a is not Ellipsis]
        count = f"{len(inner)} " if Ellipsis not in get_args(kind) and get_origin(kind) is tuple else ""
        return f"write [[{key}]]" if _is_table(inner[0]) else f"give a list of {count}{'texts' if inner[0] is str else 'numbers'}"
    return "write it in quotes"


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
