"""XML: the root element decides the format. A DTD, an entity or an external reference is refused."""

import csv
from pathlib import Path

from twin.errors import InputError
from twin.recordings.formats import delimited, sinumerik
from twin.recordings.formats.text_cells import is_number
from twin.recordings.signals import ReadOptions, Recording


def read(path: Path, options: ReadOptions) -> Recording:
    """The recording of an MTConnect or a SINUMERIK file; what is neither is no trace of a SINUMERIK."""
    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import ParseError, iterparse

    try:
        root = next(element.tag for _, element in iterparse(str(path), events=("start",), forbid_dtd=True))
        return (_mtconnect if root.endswith("MTConnectStreams") else sinumerik.read)(path, options)
    except DefusedXmlException as error:
        declared = type(error).__name__.replace("Forbidden", "").replace("Reference", " reference").lower()
        raise InputError(
            f"{path}: refused: the XML declares its own {declared or 'entities'}, which a trace never contains; export it again"
        ) from None
    except ParseError as error:
        raise InputError(f"{path}: not a complete XML file ({error}); it is cut off or damaged, export it again") from None


def _mtconnect(path: Path, options: ReadOptions) -> Recording:
    """Samples of MTConnect as a long table, one value an element with its time; a signal has the name of its data item, else component, subtype and kind.

    <ComponentStream component="Linear" name="X"><Samples>
      <Position dataItemId="x2" subType="ACTUAL" timestamp="2024-05-03T08:00:00.040Z" name="Xact">12.5</Position>
    """
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
