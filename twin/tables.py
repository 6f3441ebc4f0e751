"""Tables of TOML files as typed values. Every fault raises an InputError of one line: the place in the file, what stands there, what to do.

A table has a model (msgspec), whose fields are its keys with types, bounds and defaults:

    class Run(Table, frozen=True):
        file: Annotated[str, asks("name the trace of this run")]
        started_at_s: Number = 0.0

    run = typed(table, Run, "campaign.toml: run 1")

`asks` states what to do; without it the line follows from the type.
"""

from collections.abc import Collection, Mapping
import functools
import math
import re
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import msgspec
import msgspec.structs

from twin.documents import LARGEST_NUMBER
from twin.errors import InputError, nearest

Model = TypeVar("Model", bound=msgspec.Struct)


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of the models of tables."""


def asks(what: str = "", **limits: Any) -> msgspec.Meta:
    """What to do about a wrong value, and limits of the value: gt, ge, lt, le, min_length, max_length, pattern."""
    return msgspec.Meta(description=what or None, **limits)


Number = Annotated[float, msgspec.Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=LARGEST_NUMBER)]
NotNegative = Annotated[float, msgspec.Meta(ge=0.0, le=LARGEST_NUMBER)]
Whole = Annotated[int, msgspec.Meta(ge=0)]
Text = Annotated[str, msgspec.Meta(pattern=r"\S")]


def typed(table: Any, model: type[Model], where: str) -> Model:
    """The table as its model. Raises InputError; `where` names the file and the table."""
    try:
        return msgspec.convert(table, model)
    except msgspec.ValidationError as error:
        said, _, path = str(error).partition(" - at `$")
        raise InputError(_line(table, model, where, said, path.rstrip("`"))) from None


def typed_kind(table: Any, models: Mapping[str, type[Model]], where: str) -> Model:
    """The table as the model that its key `kind` names."""
    kind = table.get("kind") if isinstance(table, Mapping) else None
    if not isinstance(kind, str) or kind not in models:
        raise InputError(f"{where}: {'kind is missing' if kind is None else f'kind = {kind!r}'}; {nearest(str(kind), models)}")
    return typed(table, models[kind], where)


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
    limit = f" {bound.format(f'{float(bounds[2]):g}')}" if bounds and abs(float(bounds[2])) < LARGEST_NUMBER else ""
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


def is_number(value: object) -> bool:
    """True for a finite number; false for true and false."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def known_keys(table: Mapping[str, Any], keys: Collection[str], where: str) -> None:
    """Raise InputError for any other key."""
    for key in table:
        if key not in keys:
            raise InputError(f"{where}: unknown key '{key}'; {nearest(key, keys)}")


def one_of(table: Mapping[str, Any], key: str, options: Collection[str], where: str, default: str) -> str:
    """One of several words."""
    value = table.get(key, default)
    if not isinstance(value, str) or value not in options:
        raise InputError(f"{where}: {key} = {value!r} is not known; {nearest(str(value), options)}")
    return value
