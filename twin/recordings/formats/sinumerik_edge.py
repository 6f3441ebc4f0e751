"""Recording of a SINUMERIK Edge ("Capture4Analysis", Analyze MyWorkpiece): JSON, one row per interpolation cycle.

    {"Header": {"SignalListHFData": [{"Name": "CYCLE"}, {"Name": "DES_POS|1", "Axis": "X1"}, ...], "CycleTimeMs": 2,
                "Initial": {"Time": "2023-12-22T14:25:56.836Z", "HFProbeCounter": 5555962}},
     "Payload": [{"HFData": [[5558098, 0.0, ...], ...]}, {"HFBlockEvent": {"HFProbeCounter": 5558103, "GCode": "N10 G1 X5", ...}},
                 {"HFCallEvent": {"Path": "/_CUTTING", ...}}, {"HFTimestamp": {...}}, {"LFData": [...]}]}

The time is the cycle counter, not the row number: missing counters are a gap. The file gives neither units nor kinds of axes. Column
names are `SIGNAL|axis`. Started program blocks are the events of the recording. Slow data (LFData) are not read.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
import itertools
from pathlib import Path, PurePosixPath
import re
from typing import Any

import numpy as np

from twin.documents import read_json
from twin.errors import InputError
from twin.recordings.signals import Event, ReadOptions, Recording, Signal, date_of, is_count, starts_with

COUNTER = "CYCLE"
LONGEST_TEXT = 400
"""Most characters of a block's text."""


def read(path: Path, options: ReadOptions) -> Recording:
    """Read the signals of the interpolation cycle and the events of the program."""
    if not starts_with(path, b"{", b" ", b"\n", b"\r", b"\t", b"\xef\xbb\xbf"):
        raise InputError(f"{path}: not a JSON file; give it the ending of its true format")
    header, payload = _parts(path)
    listed = header.get("SignalListHFData")
    entries = listed if isinstance(listed, list) else []
    names = [str(one.get("Name", "")) if isinstance(one, Mapping) else "" for one in entries]
    if COUNTER not in names or len(set(names)) < len(names):
        reason = f"no column {COUNTER}" if COUNTER not in names else f"two columns '{next(n for n in names if names.count(n) > 1)}'"
        raise InputError(f"{path}: Header.SignalListHFData has {reason}; this is not the layout of a SINUMERIK Edge recording")
    labels = {str(one.get("Name")): str(one.get("Axis") or "") for one in entries if isinstance(one, Mapping)}
    cycle = options.clock.interval_s or _cycle(header, path)
    table = _rows(payload, len(names), path)
    at = names.index(COUNTER)
    counters = table[:, at]
    if not np.all(np.isfinite(counters)):
        raise InputError(f"{path}: row {int(np.argmin(np.isfinite(counters))) + 1} of HFData has no cycle counter; remove it")
    first = float(counters[0])
    time = (counters - first) * cycle
    signals = {}
    for i, name in enumerate(names):
        if i != at:
            there = ~np.isnan(table[:, i])  # null: no sample
            own = time if there.all() else time[there]
            signals[name] = Signal(name, np.ascontiguousarray(table[there, i]), own, "", labels.get(name, ""))
    missing = int(np.count_nonzero(np.diff(counters) > 1.5))
    notes = [f"SINUMERIK Edge: {len(names) - 1} signals every {cycle * 1e3:g} ms, {len(table)} cycles"]
    if missing:
        notes[0] += f", counters missing at {missing} place{'s' * (missing > 1)}"
    events = tuple(sorted(_events(payload, first, cycle), key=lambda event: event.time))
    if events:
        notes.append(f"{len(events)} blocks of the program became active")
    notes += _clock_note(payload, cycle)
    return Recording(path, "SINUMERIK Edge JSON", signals, _started(header, first, cycle), tuple(notes), events)


def _parts(path: Path) -> tuple[Mapping[str, Any], list[Any]]:
    """Header and payload."""
    document = read_json(path, "a whole JSON file")
    document = document if isinstance(document, Mapping) else {}
    header, payload = document.get("Header"), document.get("Payload")
    if not isinstance(header, Mapping) or not isinstance(payload, list):
        raise InputError(f"{path}: no Header and Payload: not a recording of a SINUMERIK Edge; export it as JSON again")
    return header, payload


def _cycle(header: Mapping[str, Any], path: Path) -> float:
    """Cycle time [s]."""
    cycle_ms = header.get("CycleTimeMs")
    if not is_count(cycle_ms) or not 0.01 <= cycle_ms <= 1e4:
        raise InputError(
            f"{path}: Header.CycleTimeMs = {cycle_ms!r}: not a cycle time in ms; correct it, or give [time] interval_ms in the map"
        )
    return float(cycle_ms) * 1e-3


def _rows(payload: list[Any], width: int, path: Path) -> np.ndarray:
    """(row, column) of all HFData; null becomes NaN, other cells that are not numbers are refused."""
    rows: list[Any] = []
    for entry in payload:
        part = entry.get("HFData") if isinstance(entry, Mapping) else None
        rows += part if isinstance(part, list) else []
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != width:
            have = len(row) if isinstance(row, list) else 0
            raise InputError(f"{path}: row {number} of HFData has {have} of {width} cells; the file is damaged there, remove the row")
    if len(rows) < 2:
        raise InputError(f"{path}: {len(rows)} row{'s' * (len(rows) != 1)} of HFData; a trace needs at least two")
    if all(type(cell) in (int, float) for row in rows for cell in row):
        return _finite(np.array(rows, float), path)
    table = np.empty((len(rows), width))
    for number, row in enumerate(rows):
        for i, cell in enumerate(row):
            if cell is not None and not is_count(cell):
                raise InputError(
                    f"{path}: row {number + 1} of HFData: cell {i + 1} holds {str(cell)[:40]!r}, which is not a number; repair it"
                )
            table[number, i] = np.nan if cell is None else cell
    return table


def _finite(table: np.ndarray, path: Path) -> np.ndarray:
    bad = ~np.isfinite(table)
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(f"{path}: row {row + 1} of HFData: cell {column + 1} holds {table[row, column]:g}; repair it or leave the row out")
    return table


def _events(payload: list[Any], first: float, cycle: float) -> Iterator[Event]:
    """Started blocks with their program. A call sets the program of its channel until the next call."""
    programs: dict[int, str] = {}
    for entry in payload:
        if not isinstance(entry, Mapping):
            continue
        for kind in ("HFCallEvent", "HFBlockEvent"):
            entry_value = entry.get(kind)
            if not isinstance(entry_value, Mapping) or not is_count(entry_value.get("HFProbeCounter")):
                continue
            channel = int(entry_value["Channel"]) if is_count(entry_value.get("Channel")) else 1
            if kind == "HFCallEvent":
                programs[channel] = PurePosixPath(str(entry_value.get("Path") or "")).name
                continue
            text = " ".join(str(entry_value.get("GCode") or "").split())[:LONGEST_TEXT]
            named = re.match(r"N\d+", text)
            place = named[0] if named else f"@{entry_value['SeekOffset']}" if is_count(entry_value.get("SeekOffset")) else ""
            name = "/".join(part for part in (programs.get(channel, ""), place) if part)
            yield Event((float(entry_value["HFProbeCounter"]) - first) * cycle, channel, name, text)


def _clock_note(payload: list[Any], cycle: float) -> list[str]:
    """A note if cycle counters and clock disagree."""
    ties = []
    for entry in payload:
        entry_value = entry.get("HFTimestamp") if isinstance(entry, Mapping) else None
        if (
            isinstance(entry_value, Mapping)
            and is_count(entry_value.get("HFProbeCounter"))
            and (when := date_of(entry_value.get("Time"))) is not None
        ):
            ties.append((float(entry_value["HFProbeCounter"]), when.timestamp()))
    steps = [(b[1] - a[1]) / (b[0] - a[0]) for a, b in itertools.pairwise(ties) if b[0] > a[0]]
    measured = float(np.median(steps)) if len(steps) > 2 else cycle
    if abs(measured - cycle) < 0.05 * cycle:
        return []
    return [f"by the clock of the file a cycle takes {measured * 1e3:.4g} ms, by its header {cycle * 1e3:.4g} ms"]


def _started(header: Mapping[str, Any], first: float, cycle: float) -> datetime | None:
    """Time when the first row was recorded."""
    entry_value = header.get("Initial")
    if (
        not isinstance(entry_value, Mapping)
        or not is_count(entry_value.get("HFProbeCounter"))
        or (when := date_of(entry_value.get("Time"))) is None
    ):
        return None
    try:
        return when + timedelta(seconds=(first - float(entry_value["HFProbeCounter"])) * cycle)
    except OverflowError:
        return None
