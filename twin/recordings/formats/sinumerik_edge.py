"""Recording of a SINUMERIK Edge ("Capture4Analysis", Analyze MyWorkpiece): JSON, one row per interpolation cycle.

    {"Header": {"SignalListHFData": [{"Name": "CYCLE"}, {"Name": "DES_POS|1", "Axis": "X1"}, ...], "CycleTimeMs": 2,
                "Initial": {"Time": "2023-12-22T14:25:56.836Z", "HFProbeCounter": 5555962}},
     "Payload": [{"HFData": [[5558098, 0.0, ...], ...]}, {"HFBlockEvent": {"HFProbeCounter": 5558103, "GCode": "N10 G1 X5", ...}},
                 {"HFCallEvent": {"Path": "/_CUTTING", ...}}, {"HFTimestamp": {...}}, {"LFData": [...]}]}

The time is the cycle counter, not the row number: missing counters are a gap. The file gives neither units nor kinds of axes. Column
names are `SIGNAL|axis`. Started program blocks are the events of the recording. Slow data (LFData) are not read.
"""

from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
import itertools
import math
from pathlib import Path, PurePosixPath
import re
from typing import Any

import numpy as np

from twin.errors import InputError
from twin.recordings.signals import Event, ReadOptions, Recording, Signal, date_of, is_count

COUNTER = "CYCLE"
LONGEST_TEXT = 400
"""Most characters of a block's text."""


def recording_of(document: Mapping[str, Any], path: Path, options: ReadOptions) -> Recording:
    """The signals of the interpolation cycle and the events of the program in the content of a file."""
    header, payload = document.get("Header"), document.get("Payload")
    if not isinstance(header, Mapping) or not isinstance(payload, list):
        raise InputError(f"{path}: no Header and Payload: not a recording of a SINUMERIK Edge; export it as JSON again")
    payload = [entry for entry in payload if isinstance(entry, Mapping)]
    listed = header.get("SignalListHFData")
    entries = [one if isinstance(one, Mapping) else {} for one in listed] if isinstance(listed, list) else []
    names = [str(one.get("Name", "")) for one in entries]
    if COUNTER not in names or len(set(names)) < len(names):
        reason = f"no column {COUNTER}" if COUNTER not in names else f"two columns '{next(n for n in names if names.count(n) > 1)}'"
        raise InputError(f"{path}: Header.SignalListHFData has {reason}; this is not the layout of a SINUMERIK Edge recording")
    cycle_ms = header.get("CycleTimeMs") if options.clock.interval_s is None else options.clock.interval_s * 1e3
    if not is_count(cycle_ms) or not 0.01 <= cycle_ms <= 1e4:
        remedy = "correct it, or give [time] interval_ms in the map"
        raise InputError(f"{path}: Header.CycleTimeMs = {cycle_ms!r}: not a cycle time in ms; {remedy}")
    cycle = options.clock.interval_s or float(cycle_ms) * 1e-3
    table = _rows(payload, len(names), path)
    counters = table[:, names.index(COUNTER)]
    if not np.all(np.isfinite(counters)):
        raise InputError(f"{path}: row {int(np.argmin(np.isfinite(counters))) + 1} of HFData has no cycle counter; remove it")
    first = float(counters[0])
    time = (counters - first) * cycle
    signals = {}
    for entry, name, values in zip(entries, names, table.T):
        if name != COUNTER:
            there = ~np.isnan(values)  # null: no sample
            own = time if there.all() else time[there]
            signals[name] = Signal(name, np.ascontiguousarray(values[there]), own, "", str(entry.get("Axis") or ""))
    missing = int(np.count_nonzero(np.diff(counters) > 1.5))
    notes = [f"SINUMERIK Edge: {len(names) - 1} signals every {cycle * 1e3:g} ms, {len(table)} cycles"]
    if missing:
        notes[0] += f", counters missing at {missing} place{'s' * (missing > 1)}"
    events = tuple(sorted(_events(payload, first, cycle), key=lambda event: event.time))
    if events:
        notes.append(f"{len(events)} blocks of the program became active")
    notes += _clock_note(payload, cycle)
    started = _timed(header, "Initial")
    try:
        begin = started and started[1] + timedelta(seconds=(first - started[0]) * cycle)
    except OverflowError:
        begin = None
    return Recording(path, "SINUMERIK Edge JSON", signals, begin, tuple(notes), events)


def _rows(payload: list[Mapping[str, Any]], width: int, path: Path) -> np.ndarray:
    """(row, column) of all HFData; null becomes NaN, other cells that are not numbers are refused."""
    rows = [row for entry in payload if isinstance(part := entry.get("HFData"), list) for row in part]
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != width:
            have = len(row) if isinstance(row, list) else 0
            raise InputError(f"{path}: row {number} of HFData has {have} of {width} cells; the file is damaged there, remove the row")
    if len(rows) < 2:
        raise InputError(f"{path}: {len(rows)} row{'s' * (len(rows) != 1)} of HFData; a trace needs at least two")
    plain = all(type(cell) in (int, float) for row in rows for cell in row)
    table = np.array(rows, float) if plain else np.empty(0)
    if plain and np.isfinite(table).all():
        return table
    for number, row in enumerate(rows, start=1):
        for i, cell in enumerate(row, start=1):
            if cell is not None and not (type(cell) in (int, float) and math.isfinite(cell)):
                raise InputError(f"{path}: row {number} of HFData: cell {i} holds {str(cell)[:40]!r}, which is not a number; repair it")
    return np.array(rows, float)  # NaN for None


def _counted(entry: Mapping[str, Any], kind: str) -> Mapping[str, Any] | None:
    """The event of this kind, if it has a cycle counter."""
    found = entry.get(kind)
    return found if isinstance(found, Mapping) and is_count(found.get("HFProbeCounter")) else None


def _timed(entry: Mapping[str, Any], kind: str) -> tuple[float, datetime] | None:
    """(cycle counter, time) of an event of this kind."""
    found = _counted(entry, kind)
    when = date_of(found.get("Time")) if found is not None else None
    return None if found is None or when is None else (float(found["HFProbeCounter"]), when)


def _events(payload: list[Mapping[str, Any]], first: float, cycle: float) -> Iterator[Event]:
    """Started blocks with their program. A call sets the program of its channel until the next call."""
    programs: dict[int, str] = {}
    for entry, kind in itertools.product(payload, ("HFCallEvent", "HFBlockEvent")):
        if (found := _counted(entry, kind)) is None:
            continue
        channel = int(found["Channel"]) if is_count(found.get("Channel")) else 1
        if kind == "HFCallEvent":
            programs[channel] = PurePosixPath(str(found.get("Path") or "")).name
            continue
        text = " ".join(str(found.get("GCode") or "").split())[:LONGEST_TEXT]
        named = re.match(r"N\d+", text)
        place = named[0] if named else f"@{found['SeekOffset']}" if is_count(found.get("SeekOffset")) else ""
        name = "/".join(part for part in (programs.get(channel, ""), place) if part)
        yield Event((float(found["HFProbeCounter"]) - first) * cycle, channel, name, text)


def _clock_note(payload: list[Mapping[str, Any]], cycle: float) -> list[str]:
    """A note if cycle counters and clock disagree."""
    ties = [tie for entry in payload if (tie := _timed(entry, "HFTimestamp")) is not None]
    steps = [(b[1].timestamp() - a[1].timestamp()) / (b[0] - a[0]) for a, b in itertools.pairwise(ties) if b[0] > a[0]]
    measured = float(np.median(steps)) if len(steps) > 2 else cycle
    if abs(measured - cycle) < 0.05 * cycle:
        return []
    return [f"by the clock of the file a cycle takes {measured * 1e3:.4g} ms, by its header {cycle * 1e3:.4g} ms"]
