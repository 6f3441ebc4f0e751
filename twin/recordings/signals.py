"""What every reader returns: named signals, each with its own times, as the file has them; units and axes come from the map.

A new format is one module with `read(path, how) -> Recording` and one line in `formats.READERS`.
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

NO_MEASUREMENT = 1e15
"""No recorder measures a number as large, in whatever unit; NaN and infinity are none either."""
BLOCK = 1 << 17
"""Samples that are in memory at a time of a signal that is stored on disk."""


class Column(Protocol):
    """A column of float64 that is read by slices: an array, or a file on disk."""

    def __len__(self) -> int: ...
    def __getitem__(self, rows: slice, /) -> Any: ...


@dataclass(frozen=True)
class Stored:
    """Column of float64 in a file of its own: what does not fit into memory stays on disk."""

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
    """One recorded signal: `values` (sample,) in the file's own unit at `time` (sample,) [s]; `unit` is "" where the file says none."""

    name: str
    values: Column
    time: Column | None
    unit: str = ""
    description: str = ""

    def blocks(self) -> Iterator[tuple[int, np.ndarray]]:
        """(first row, values) of consecutive parts."""
        for start in range(0, len(self.values), BLOCK):
            yield start, np.asarray(self.values[start : start + BLOCK], float)


@dataclass(frozen=True)
class Event:
    """A block of the program that became active: time [s] on the clock of the signals, channel of the control, block, its text."""

    time: float
    channel: int
    block: str
    text: str


@dataclass(frozen=True)
class Recording:
    """One file as read: its signals by name, when it was started if the file says so, what the reader noticed, events of the program.

    `restarts` counts the rows where the time of the file begins anew (strokes one below the other); the parts lie a gap apart here.
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
    """Where the times of a format without its own come from: a column and its unit, or a constant interval [s]; neither: found by name."""

    column: str | None = None
    unit: str | None = None
    interval_s: float | None = None


@dataclass(frozen=True)
class How:
    """How to read: the clock, the columns that are wanted (None: all), a folder for what does not fit into memory, the CSV's dialect."""

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
    """The unit as the twin spells it, or "" where it is not known."""
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
    """('Pos X', 'mm') from 'Pos X [mm]' or 'Pos X (mm)'; the heading itself and '' where the brackets hold no unit."""
    match = _IN_BRACKETS.match(text.strip())
    unit = known_unit(match[2] or match[3] or "") if match and not (match[3] or "").strip().isdigit() else ""  # name(1) is an index
    return (match[1].strip(), unit) if match and unit and match[1].strip() else (text.strip(), "")


def find_time_column(names: Sequence[str], units: Sequence[str], clock: Clock, where: str) -> int | None:
    """Number of the time column; None where the map gives an interval instead."""
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
        f'{where}: no column looks like a time; say [time] column = "..." or interval_ms = ... in the map ({", ".join(names[:8])})'
    )


def time_candidates(names: Sequence[str], units: Sequence[str]) -> list[int]:
    """Numbers of the columns that are named like a time, the likeliest first: 'time', 'rec.time', 'rec.time_cont'."""
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
    """Factor that turns the time column into seconds: the map's unit, else the file's, else s."""
    clock_unit = known_unit(clock.unit) if clock.unit else (unit or split_heading(name)[1] or "s")
    if not clock_unit or dimension_recorded(clock_unit) != "time":
        raise InputError(f"{where}: time column '{name}': [{clock.unit or clock_unit}] is no unit of time; use s, ms, us, ns or min")
    return RECORDED_UNITS[clock_unit][1]


def share_time(columns: Mapping[str, tuple[np.ndarray, str]], clock: Clock, where: str) -> dict[str, Signal]:
    """Signals from columns (values, unit) of one length each, all on the time column or interval; what is not as long is left without a time."""
    names = list(columns)
    units = [unit for _, unit in columns.values()]
    at = find_time_column(names, units, clock, where)
    if at is not None and clock.column is None:
        # of several times one that runs: a counter that stands still or a list of other times is none
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
    """A date and time as files print it (2024-05-14T08:21:07.250Z), or None."""
    try:
        return datetime.fromisoformat(text.replace("Z", "+00:00")) if isinstance(text, str) else None
    except ValueError:
        return None


def is_count(value: object) -> TypeGuard[float]:
    """A finite number of a JSON file; true and false are none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < NO_MEASUREMENT


def _runs(time: np.ndarray) -> bool:
    """Is it finite, and does it only go forward?"""
    time = np.asarray(time, float)
    return len(time) > 1 and bool((np.abs(time) < NO_MEASUREMENT).all() and (np.diff(time) > 0.0).all())


def no_file(path: Path) -> InputError | None:
    """The error of a file that cannot be opened, or None."""
    if not path.is_file():
        return InputError(f"{path}: no such file; give a recorded trace")
    try:
        with open(path, "rb") as file:
            if not file.read(1):
                return InputError(f"{path}: the file is empty; export the recording again")
    except OSError as error:
        return InputError(f"{path}: cannot be read ({error.strerror}); check its permissions")
    return None


def starts_with(path: Path, *magic: bytes) -> bool:
    """Does the file begin like its format?"""
    with open(path, "rb") as file:
        head = file.read(max(len(m) for m in magic))
    return any(head.startswith(m) for m in magic)
