"""Samples of MTConnect (XML): one value an element, with its time, as a long table.

<ComponentStream component="Linear" name="X"><Samples>
  <Position dataItemId="x2" subType="ACTUAL" timestamp="2024-05-03T08:00:00.040Z" name="Xact">12.5</Position>
"""

import csv
from pathlib import Path

from twin.recordings.formats import delimited
from twin.recordings.formats.text_cells import is_number
from twin.recordings.signals import ReadOptions, Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """Each data item as a signal: by its name, else by component, subtype and kind."""
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
