"""Models of TOML tables: every fault is one line with place, value and remedy, and nothing else is refused."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import pytest

from twin.errors import InputError
from twin.tables import Number, Positive, Table, Whole, asks, typed


class Channel(Table, frozen=True):
    name: str
    gain: Positive = 1.0
    shift: Number = 0.0
    mode: Literal["report", "correct"] = "report"
    sign: Literal[1, -1] = 1
    ends: tuple[float, float] | None = None
    on: bool = False


class Clock(Table, frozen=True):
    count: Whole = 1


class File(Table, frozen=True):
    channel: Annotated[tuple[Channel, ...], asks("give at least one [[channel]]", min_length=1)]
    clock: Clock = Clock()
    words: tuple[str, ...] = ()


def file(**channel: Any) -> dict[str, Any]:
    return {"channel": [{"name": "a", **channel}]}


GOOD = [file(), file(gain=2), file(sign=-1, ends=[0, 1.5], on=True), {**file(), "clock": {"count": 0}, "words": []}]
BAD = [
    ({}, "f.toml: 'channel' is missing; give at least one [[channel]]"),
    ({"channel": []}, "f.toml: channel = []; give at least one [[channel]]"),
    ({"channel": [3]}, "f.toml: channel 1: 3 is not a table; write key = value below it"),
    ({"channel": [{}]}, "f.toml: channel 1: 'name' is missing; add it"),
    ({**file(), "clocks": {}}, "f.toml: unknown key 'clocks'; did you mean 'clock'?"),
    (file(gian=1.0), "f.toml: channel 1 ('a'): unknown key 'gian'; did you mean 'gain'?"),
    (file(gain=0.0), "f.toml: channel 1 ('a'): gain = 0.0; give a number above 0"),
    (file(gain=True), "f.toml: channel 1 ('a'): gain = True; give a number"),
    (file(shift=float("nan")), "f.toml: channel 1 ('a'): shift = nan; give a number"),
    (file(shift=float("inf")), "f.toml: channel 1 ('a'): shift = inf; give a number"),
    (file(mode="reprot"), "f.toml: channel 1 ('a'): mode = 'reprot'; did you mean 'report'?"),
    (file(mode=2), "f.toml: channel 1 ('a'): mode = 2; use report or correct"),
    (file(sign=2), "f.toml: channel 1 ('a'): sign = 2; use 1 or -1"),
    (file(ends=[1]), "f.toml: channel 1 ('a'): ends = [1]; give a list of 2 numbers"),
    (file(ends=[1, "x"]), "f.toml: channel 1 ('a'): ends = [1, 'x']; give a list of 2 numbers"),
    (file(on=1), "f.toml: channel 1 ('a'): on = 1; write true or false"),
    ({"channel": [{"name": 1}]}, "f.toml: channel 1: name = 1; write it in quotes"),
    ({**file(), "clock": 3}, "f.toml: clock = 3; write [clock] and its keys below it"),
    ({**file(), "clock": {"count": -1}}, "f.toml: [clock]: count = -1; give a whole number of 0 or more"),
    ({**file(), "clock": {"count": 1.5}}, "f.toml: [clock]: count = 1.5; give a whole number"),
    ({**file(), "words": ["a", 1]}, "f.toml: words = ['a', 1]; give a list of texts"),
]


@pytest.mark.parametrize("table", GOOD)
def test_a_right_table_is_read(table: dict[str, Any]) -> None:
    assert typed(table, File, "f.toml").channel[0].name == "a"


@pytest.mark.parametrize(("table", "line"), BAD)
def test_a_fault_is_one_line(table: dict[str, Any], line: str) -> None:
    with pytest.raises(InputError) as refused:
        typed(table, File, "f.toml")
    assert str(refused.value) == line
