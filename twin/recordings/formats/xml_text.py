"""XML: the root element decides the format. A DTD, an entity or an external reference is refused.

Trace of a SINUMERIK solution line control, as its HMI writes it; each signal has its own interval:

    <traceSession>
      <traceData><dataFrame>
        <frameHeader startTime="2024-05-14T08:21:07.250Z" dropOuts="0" .../>
        <dataSignal id="f1" name="/Nck/!SD/nckServoDataCmdPos64 [u1, 1]" description="Position setpoint" interval="0.002000"
                    datapointCount="22709" unitsType="posn" .../>
        <rec time="0.000000" f1="0.000000" f2="..."/>

A record contains only changed values of the servo-cycle signals. A missing value was held; `datapointCount` gives the number of
samples. Signals of the interpolation cycle are written at each of their own samples. So a missing value is a lost sample only if the
count says so. Layout of software 4.x, format version 01.00. Units are not in the file (posn is mm or deg); the map gives them.

Samples of MTConnect are a long table, one value an element with its time; a signal has the name of its data item, else component, subtype and kind:

    <ComponentStream component="Linear" name="X"><Samples>
      <Position dataItemId="x2" subType="ACTUAL" timestamp="2024-05-03T08:00:00.040Z" name="Xact">12.5</Position>
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
import csv
from dataclasses import dataclass, field
from datetime import datetime
import math
from pathlib import Path

import numpy as np

from twin.errors import InputError
from twin.limits import refuse_above, refuse_bytes
from twin.recordings.channels import MOST_ROWS
from twin.recordings.formats import delimited
from twin.recordings.formats.text_cells import is_number
from twin.recordings.signals import ReadOptions, Recording, Signal, date_of

MOST_NUMBERED = 1e15
"""Most intervals between first and last sample."""
NO_NUMBER = 9.2e18
"""Larger values are bit patterns of NaN and infinity, which the control prints as integers."""


def read(path: Path, options: ReadOptions) -> Recording:
    """The recording of an MTConnect or a SINUMERIK file; what is neither is no trace of a SINUMERIK."""
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    try:
        root = next(element.tag for _, element in iterparse(str(path), events=("start",), forbid_dtd=True))
        return _mtconnect(path, options) if root.endswith("MTConnectStreams") else _sinumerik(path)
    except DefusedXmlException as error:
        declared = type(error).__name__.replace("Forbidden", "").replace("Reference", " reference").lower()
        own = f"its own {declared or 'entities'}, which a trace never contains"
        raise InputError(f"{path}: refused: the XML declares {own}; export it again") from None
    except ParseError as error:
        raise InputError(f"{path}: not a complete XML file ({error}); it is cut off or damaged, export it again") from None


@dataclass
class _Samples:
    """One dataSignal while its records are read."""

    name: str
    description: str
    interval: float
    count: int | None
    times: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))


def _sinumerik(path: Path) -> Recording:
    """All signals of the first data frame of a SINUMERIK trace."""
    from defusedxml.ElementTree import iterparse

    samples: dict[str, _Samples] = {}
    started: datetime | None = None
    root, frames, lost, last = "", 0, 0, -math.inf
    parents: list[object] = []
    for event, element in iterparse(str(path), events=("start", "end"), forbid_dtd=True):
        tag = element.tag.rpartition("}")[2]
        if event == "start":
            root = root or tag
            frames += tag == "dataFrame"
            parents.append(element)
            continue
        parents.pop()
        if frames == 1 and tag == "frameHeader":
            started = date_of(element.get("startTime"))
            lost = int(float(element.get("dropOuts") or 0))
        elif frames == 1 and tag == "dataSignal":
            _begin(samples, element.attrib, path)
        elif frames == 1 and tag == "rec":
            last = _record(samples, element.attrib, path, last)
        if tag == "rec" and parents:
            parents[-1].remove(element)  # type: ignore[attr-defined]
    if not samples:
        raise InputError(f"{path}: not a trace of a SINUMERIK (root <{root}>, no <dataSignal>); export the trace, not its settings")
    notes = [f"SINUMERIK trace: {len(samples)} signals"]
    if lost:
        notes.append(f"the control lost {lost} samples (dropOuts)")
    if frames > 1:
        notes.append(f"{frames} data frames: the first is read")
    signals = {}
    clocks: dict[tuple[float, float, int], np.ndarray] = {}
    taken = 0.0
    for one in samples.values():
        if len(one.times) > 1:  # held values are repeated
            taken += 8.0 * abs(one.times[-1] - one.times[0]) / one.interval
            refuse_bytes(taken, str(path), "export a shorter recording")
        signal, note = _signal(one, clocks, path)
        if signal.name in signals:
            raise InputError(f"{path}: signal '{signal.name}' occurs twice; remove one from the trace's settings")
        signals[signal.name] = signal
        notes += filter(None, [note])
    return Recording(path, "SINUMERIK trace XML", signals, started, tuple(notes))


def _begin(samples: dict[str, _Samples], given: Mapping[str, str], path: Path) -> None:
    try:
        key, name, interval = given["id"], given["name"], float(given["interval"])
    except KeyError as missing:
        raise InputError(f"{path}: a <dataSignal> has no {missing}; this is not the layout of a SINUMERIK trace") from None
    if not 0.0 < interval < math.inf:
        raise InputError(f"{path}: signal '{name}': interval = {interval:g}; it must be a number above 0")
    count = given.get("datapointCount")
    samples[key] = _Samples(name, given.get("description", ""), interval, int(count) if count else None)


def _record(samples: dict[str, _Samples], given: Mapping[str, str], path: Path, last: float) -> float:
    """One record: its time, and the values that changed."""
    time = float(given["time"])
    if not last < time < math.inf:
        raise InputError(f"{path}: time does not increase at {time:g} s; the file is damaged, export it again")
    for key, text in given.items():
        if key == "time" or (one := samples.get(key)) is None:
            continue
        value = {"true": 1.0, "false": 0.0}[text] if text in ("true", "false") else float(text)
        if not abs(value) < NO_NUMBER:
            raise InputError(f"{path}: signal '{one.name}': not a number at {time:g} s; cut the recording or leave the signal out")
        one.times.append(time)
        one.values.append(value)
    return time


def _signal(one: _Samples, clocks: dict[tuple[float, float, int], np.ndarray], path: Path) -> tuple[Signal, str]:
    """Values at every sample: held values are repeated, lost ones omitted."""
    times, values = np.array(one.times), np.array(one.values)
    where = f"{path}: signal '{one.name}'"
    if len(times) == 0:
        return Signal(one.name, values, times, "", one.description), f"'{one.name}' holds no value"
    if (last := float(times[-1] - times[0]) / one.interval) > MOST_NUMBERED:
        raise InputError(f"{where}: {last:.3g} intervals of {one.interval:g} s; the file is damaged, export it again")
    at = (times - times[0]) / one.interval
    number = np.rint(at).astype(int)
    span = int(number[-1]) + 1
    note = ""
    if np.abs(at - number).max() > 0.1 or (len(number) > 1 and np.diff(number).min() < 1):
        note = f"'{one.name}' is off its interval of {one.interval * 1e3:g} ms"
    elif len(values) < span and one.count is not None and one.count < span:
        note = f"'{one.name}' lost {span - one.count} samples"  # fewer samples than intervals in the span
    else:
        refuse_above(span, MOST_ROWS, "samples from its first to its last", where, "export a shorter recording")
        values = values[np.searchsorted(number, np.arange(span), side="right") - 1]
        times = clocks.setdefault((float(times[0]), one.interval, span), times[0] + one.interval * np.arange(span))
    return Signal(one.name, values, times, "", one.description), note


def _mtconnect(path: Path, options: ReadOptions) -> Recording:
    """Samples of MTConnect by way of a text."""
    from defusedxml.ElementTree import iterparse

    component, rows = "", []
    for event, element in iterparse(str(path), events=("start", "end"), forbid_dtd=True):
        tag = element.tag.rpartition("}")[2]
        if event == "start" and tag == "ComponentStream":
            component = element.get("name") or ""
        elif event == "end" and element.get("timestamp") and element.get("dataItemId"):
            name = element.get("name") or " ".join(part for part in (component, element.get("subType", "").lower(), tag.lower()) if part)
            rows.append((str(element.get("timestamp")), name, (element.text or "").strip()))
    numbers = sorted((row for row in rows if is_number(row[2])), key=lambda row: row[0])

    def write(file: Path) -> None:
        with file.open("w", encoding="utf-8", newline="") as out:
            csv.writer(out).writerows([("timestamp", "name", "value"), *numbers])

    return delimited.read_made(path, options, write)
