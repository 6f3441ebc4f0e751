"""Result of every reader of recordings: named signals, each with its own times, as in the file. The map adds units and axes.

A new format is one module with `read(path, options) -> Recording` and one line in `formats.READERS`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
import re
from typing import Any, Protocol, TypeGuard

import numpy as np

from twin.errors import InputError, nearest
from twin.units import RECORDED_UNITS, dimension_recorded

IMPOSSIBLE_VALUE = 1e15
"""Values at or above this magnitude, NaN and infinity are not measurements in any unit."""
BLOCK = 1 << 17
"""Samples of a stored signal that are in memory at a time."""


class Column(Protocol):
    """A column of float64 read by slices: an array, or a file on disk."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: slice, /) -> Any: ...


@dataclass(frozen=True)
class Stored:
    """A column of float64 in a file, for data that do not fit into memory."""

    path: Path

    def __len__(self) -> int:
        return self.path.stat().st_size // 8

    def __getitem__(self, rows: slice, /) -> np.ndarray:
        start, stop, step = rows.indices(len(self))
        with open(self.path, "rb") as file:
            file.seek(8 * start)
            return np.fromfile(file, dtype=float, count=max(stop - start, 0))[::step]


@dataclass(frozen=True)
class Signal:
    """One recorded signal: `values` (sample,) in the unit of the file at `time` (sample,) [s]. `unit` is "" if the file gives none."""

    name: str
    values: Column
    time: Column | None
    unit: str = ""
    description: str = ""

    def blocks(self) -> Iterator[tuple[int, np.ndarray]]:
        """(first row, values) of consecutive blocks."""
        for start in range(0, len(self.values), BLOCK):
            yield start, np.asarray(self.values[start : start + BLOCK], float)


@dataclass(frozen=True)
class Event:
    """Start of a program block: time [s] on the clock of the signals, channel of the control, block, text."""

    time: float
    channel: int
    block: str
    text: str


@dataclass(frozen=True)
class Recording:
    """One file as read: signals by name, start time if the file gives one, notes of the reader, events of the program.

    `restarts`: number of rows where the time of the file starts again (strokes one below the other). The parts are separated by gaps here.
    """

    path: Path
    format: str
    signals: Mapping[str, Signal]
    started: datetime | None = None
    notes: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    restarts: int = 0


@dataclass(frozen=True)
class Clock:
    """Time source of a format without times: a column and its unit, or a constant interval [s]. Neither: found by name."""

    column: str | None = None
    unit: str | None = None
    interval_s: float | None = None


@dataclass(frozen=True)
class ReadOptions:
    """How to read: clock, wanted columns (None: all), folder for data that do not fit into memory, CSV dialect."""

    clock: Clock
    wanted: frozenset[str] | None
    scratch: Path
    dialect: Mapping[str, Any] = field(default_factory=dict)


_ALIASES = {
    "°": "deg", "grad": "deg", "degree": "deg", "degrees": "deg", "µm": "um", "μm": "um", "micron": "um", "inch": "in", "sec": "s",
    "second": "s", "seconds": "s", "amp": "A", "amps": "A", "ampere": "A", "a": "A", "v": "V", "volt": "V", "nm": "Nm", "n.m": "Nm",
    "n·m": "Nm", "n*m": "Nm", "n": "N", "rpm": "rev/min", "u/min": "rev/min", "1/min": "rev/min", "u": "rev", "rev": "rev",
    "s^-1": "rev/s", "ma": "mA", "mv": "mV", "kn": "kN", "-": "1",
}  # fmt: skip
_TIME_NAMES = ("time", "t", "zeit", "timestamp", "x-achse", "x axis", "x_value", "temps", "tempo")
_IN_BRACKETS = re.compile(r"^(.*?)\s*(?:\[([^\]]*)\]|\(([^)]*)\))\s*$")


def known_unit(text: str) -> str:
    """The unit in the twin's spelling; "" if unknown."""
    text = text.strip().strip("[]()").strip()
    if text in RECORDED_UNITS:
        return text
    first, slash, per = text.lower().partition("/")
    per = {"minute": "min", "sec": "s", "sek": "s"}.get(per.strip(), per.strip())
    for candidate in (text.lower(), _ALIASES.get(text.lower(), ""), f"{_ALIASES.get(first.strip(), first.strip())}{slash}{per}"):
        if candidate in RECORDED_UNITS:
            return candidate
    return ""


def split_heading(text: str) -> tuple[str, str]:
    """('Pos X', 'mm') from 'Pos X [mm]' or 'Pos X (mm)'; the heading and '' if the brackets contain no unit."""
    match = _IN_BRACKETS.match(text.strip())
    index = match and ((match[3] or "").strip().isdigit() or re.search(r"\w\[1\]$", text.strip()))  # name(1), name[1]
    unit = known_unit(match[2] or match[3] or "") if match and not index else ""
    return (match[1].strip(), unit) if match and unit and match[1].strip() else (text.strip(), "")


def find_time_column(names: Sequence[str], units: Sequence[str], clock: Clock, where: str) -> int | None:
    """Index of the time column; None if the map gives an interval."""
    if clock.interval_s is not None:
        return None
    if clock.column is not None:
        plain = [split_heading(n)[0] for n in names]
        for i, name in enumerate(names):
            if clock.column in (name, plain[i]):
                return i
        raise InputError(f"{where}: no time column '{clock.column}'; {nearest(clock.column, names)}")
    if found := time_candidates(names, units):
        return found[0]
    raise InputError(
        f'{where}: no column looks like a time; give [time] column = "..." or interval_ms = ... in the map ({", ".join(names[:8])})'
    )


def time_candidates(names: Sequence[str], units: Sequence[str]) -> list[int]:
    """Indices of the columns with names of a time, most likely first: 'time', 'rec.time', 'rec.time_cont'."""
    ranked = []
    for i, name in enumerate(names):
        if units[i] == "" or dimension_recorded(units[i]) == "time":
            plain = split_heading(name)[0].lower()
            last = re.split(r"[./]", plain)[-1]
            kinds = (plain in _TIME_NAMES, last in _TIME_NAMES, last.startswith(("time_", "zeit_")))
            if any(kinds):
                ranked.append((kinds.index(True), i))
    return [i for _, i in sorted(ranked)]


def time_factor(name: str, unit: str, clock: Clock, where: str) -> float:
    """Factor from the time column to seconds, by the unit of the map, else of the file, else s."""
    clock_unit = known_unit(clock.unit) if clock.unit else (unit or split_heading(name)[1] or "s")
    if not clock_unit or dimension_recorded(clock_unit) != "time":
        raise InputError(f"{where}: time column '{name}': [{clock.unit or clock_unit}] is not a unit of time; use s, ms, us, ns or min")
    return RECORDED_UNITS[clock_unit][1]


def share_time(columns: Mapping[str, tuple[np.ndarray, str]], clock: Clock, where: str) -> dict[str, Signal]:
    """Signals from columns (values, unit) on one time column or interval. A column of another length gets no time."""
    names = list(columns)
    units = [unit for _, unit in columns.values()]
    at = find_time_column(names, units, clock, where)
    if at is not None and clock.column is None:
        # of several candidates the first that increases: a constant counter or a list of other times is not a time
        at = next((i for i in time_candidates(names, units) if _runs(columns[names[i]][0])), at)
    if at is None:
        rows = max((len(values) for values, _ in columns.values()), default=0)
        time = np.arange(rows) * float(clock.interval_s or 0.0)
    else:
        values, unit = columns[names[at]]
        time = np.asarray(values, float) * time_factor(names[at], unit, clock, where)
    return {
        name: Signal(name, np.asarray(values, float), time if len(values) == len(time) else None, unit)
        for i, (name, (values, unit)) in enumerate(columns.items())
        if i != at
    }


def date_of(text: object) -> datetime | None:
    """A date and time as in files (2024-05-14T08:21:07.250Z), or None."""
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")) if isinstance(text, str) else None
    except ValueError:
        return None


def is_count(value: object) -> TypeGuard[float]:
    """True for a finite number of a JSON file; false for true and false."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < IMPOSSIBLE_VALUE


def _runs(time: np.ndarray) -> bool:
    """True if the time is finite and always increases."""
    time = np.asarray(time, float)
    return len(time) > 1 and bool((np.abs(time) < IMPOSSIBLE_VALUE).all() and (np.diff(time) > 0.0).all())


def check_readable(path: Path) -> None:
    """Refuse a file that is missing, empty or not readable."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give a recorded trace")
    try:
        with open(path, "rb") as file:
            empty = not file.read(1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    if empty:
        raise InputError(f"{path}: the file is empty; export the recording again")


def starts_with(path: Path, *magic: bytes) -> bool:
    """True if the file starts with one of these bytes."""
    with open(path, "rb") as file:
        head = file.read(max(len(m) for m in magic))
    return any(head.startswith(m) for m in magic)
