"""Result of every reader of recordings: named signals, each with its own times, as in the file. The map adds units and axes.

A new format is one module with `read(path, options) -> Recording` and one line in `formats.by_content`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
import re
from typing import Any, TypeGuard

import numpy as np

from twin.errors import InputError, no_file
from twin.units import RECORDED_UNITS

IMPOSSIBLE_VALUE = 1e15
"""Values at or above this magnitude, NaN and infinity are not measurements in any unit."""
BLOCK = 1 << 17
"""Samples of a stored signal that are in memory at a time."""


@dataclass(frozen=True)
class Stored:
    """A column of float64 in a file, for data that do not fit into memory."""

    path: Path

    def add(self, values: np.ndarray) -> None:
        """Write values behind those that it has."""
        with open(self.path, "ab") as file:
            values.astype(float).tofile(file)

    def __len__(self) -> int:
        return self.path.stat().st_size // 8

    def __getitem__(self, rows: slice, /) -> np.ndarray:
        start, stop, step = rows.indices(len(self))
        with open(self.path, "rb") as file:
            file.seek(8 * start)
            return np.fromfile(file, dtype=float, count=max(stop - start, 0))[::step]


Column = np.ndarray | Stored
"""A column of float64, read by slices."""


@dataclass(frozen=True)
class Signal:
    """One recorded signal: `values` (sample,) in the unit of the file at `time` (sample,) [s], empty if nothing states it. `unit` is "" if the file gives none."""

    name: str
    values: Column
    time: Column
    unit: str = ""
    description: str = ""
    stated_unit: str = ""
    """The unit as the file writes it, if it is none that the twin converts: %, pulses."""
    turn: float = 0.0
    """The number after which the values began anew, before the turns were counted on; 0 if they did not."""

    @property
    def head(self) -> np.ndarray:
        """Values of the first block."""
        return np.asarray(self.values[0:BLOCK], float)

    def impossible(self) -> tuple[int, str] | None:
        """(row, value as text) of the first NaN, infinite or impossible value."""
        for start in range(0, len(self.values), BLOCK):
            values = np.asarray(self.values[start : start + BLOCK], float)
            if (bad := ~(np.abs(values) < IMPOSSIBLE_VALUE)).any():
                row = int(np.argmax(bad))
                return start + row, "NaN" if np.isnan(values[row]) else f"{values[row]:g}"
        return None


@dataclass(frozen=True)
class TimeSource:
    """Where the times of a recording come from: a column, an interval (given, or stated above the numbers), or the format itself.

    known     False if no time is known, and the times of the signals are row numbers 0, 1, 2, ...
    column    name of the time column, and `at`, its index among the columns
    unit      unit of its numbers
    interval  interval of the rows [s], if there is no time column
    assumed   nothing states this unit; `text` says what was assumed
    text      one sentence for the user; "" if the file leaves nothing open
    question  what the user should confirm or give
    count_s   seconds of a count since a date, and `since_s`, this date in seconds before 1970; 0: the column counts from no date
    rest      index of a column with the part of a second that belongs to whole seconds, and seconds per number
    """

    column: str = ""
    unit: str = "s"
    known: bool = True
    assumed: bool = False
    text: str = ""
    at: int | None = None
    interval: float = 1.0
    question: str = ""
    count_s: float = 0.0
    since_s: float = 0.0
    rest: tuple[int, float] | None = None

    @property
    def factor(self) -> float:
        """Seconds per number of the time column, or per row."""
        return self.count_s or (RECORDED_UNITS[self.unit][1] if self.column else self.interval)


@dataclass(frozen=True)
class Event:
    """Start of a program block: time [s] on the clock of the signals (negative: before the trace), channel of the control, block, text."""

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
    source: TimeSource = TimeSource()


@dataclass(frozen=True)
class Clock:
    """What the user gives for a format without times: a column and its unit, or a constant interval [s]. Neither: found by name."""

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
    "°": "deg", "grad": "deg", "degree": "deg", "degrees": "deg", "micron": "um", "inch": "in", "sec": "s",
    "second": "s", "seconds": "s", "amp": "A", "amps": "A", "ampere": "A", "a": "A", "v": "V", "volt": "V", "nm": "Nm", "n.m": "Nm",
    "n·m": "Nm", "n*m": "Nm", "n": "N", "rpm": "rev/min", "u/min": "rev/min", "1/min": "rev/min", "u": "rev", "rev": "rev",
    "s^-1": "rev/s", "1/s": "rev/s", "min-1": "rev/min", "min^-1": "rev/min", "r": "rev", "msec": "ms", "usec": "us", "nsec": "ns",
    "arms": "A", "aeff": "A", "ma": "mA", "mv": "mV", "kn": "kN", "-": "1", "tr": "rev", "sek": "s", "ipm": "in/min", "ips": "in/s", "mps": "m/s",
}  # fmt: skip
_IN_BRACKETS = re.compile(r"^(.*?)\s*(?:\[([^\]]*)\]|\(([^)]*)\))\s*$")


_SCALED = re.compile(r"(\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?)(?:\s*[*x·]\s*|\s+|(?=[^\d\s/]))(\S.*)")


def known_unit(text: str) -> str:
    """The unit in the twin's spelling; "" if unknown."""
    text = text.strip().strip("[]()").strip().replace("µ", "u").replace("μ", "u")
    if text in RECORDED_UNITS:
        return text
    first, slash, per = text.lower().partition("/")
    per = {"minute": "min", "sec": "s", "sek": "s"}.get(per.strip(), per.strip())
    for candidate in (text.lower(), _ALIASES.get(text.lower(), ""), f"{_ALIASES.get(first.strip(), first.strip())}{slash}{per}"):
        if candidate in RECORDED_UNITS:
            return candidate
    return ""


def scaled_unit(text: str) -> tuple[str, float]:
    """('A', 0.01) from '0.01 A' and ('mm', 1.0) from 'mm'; ('', 1.0) if unknown."""
    if unit := known_unit(text):
        return unit, 1.0
    match = _SCALED.match(text.strip().strip("[]()").strip())
    unit = known_unit(match[2]) if match else ""
    return (unit, float(match[1].replace(",", "."))) if match and unit else ("", 1.0)


def split_heading(text: str) -> tuple[str, str]:
    """('Pos X', 'mm') from 'Pos X [mm]' or 'Pos X (mm)'; the heading and '' if the brackets contain no unit."""
    match = _IN_BRACKETS.match(text.strip())
    index = match and ((match[3] or "").strip().isdigit() or re.search(r"\w\[1\]$", text.strip()))  # name(1), name[1]
    unit = known_unit(match[2] or match[3] or "") if match and not index else ""
    return (match[1].strip(), unit) if match and unit and match[1].strip() else (text.strip(), "")


def date_of(text: object) -> datetime | None:
    """A date and time as in files (2024-05-14T08:21:07.250Z), or None."""
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")) if isinstance(text, str) else None
    except ValueError:
        return None


def is_count(value: object) -> TypeGuard[float]:
    """True for a finite number of a JSON file; false for true and false."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < IMPOSSIBLE_VALUE


def head_of(path: Path) -> bytes:
    """The first bytes of a file. Raises InputError if it is missing, empty or not readable."""
    if not path.is_file():
        raise no_file(path, "give a recorded trace")
    try:
        with open(path, "rb") as file:
            head = file.read(64)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    if not head:
        raise InputError(f"{path}: the file is empty; export the recording again")
    return head


def of_given_file(path: Path, file: Path, read_it: Callable[[], Recording]) -> Recording:
    """What was read from the `file` made of it, under the name of the file that the user gave, also in an error."""
    try:
        return replace(read_it(), path=path)
    except InputError as error:
        raise InputError(str(error).replace(str(file), str(path))) from None
