"""Results in a folder: runs, campaigns, diagnoses, studies, ..., each recognised by the document that its command writes."""

from collections.abc import Iterator, Mapping
import contextlib
from dataclasses import dataclass
from datetime import datetime
import html
import os
from pathlib import Path
import re
from typing import Any

from twin.documents import read_json
from twin.errors import InputError
from twin.units import in_words, plain

DEEPEST = 5
"""Levels of folders that are searched."""
LARGEST_BYTES = 20_000_000
"""Largest document whose summary is read."""
MOST = 500
"""Most entries listed."""

RUN, CAMPAIGN = "run", "campaign"
_BY_DOCUMENT = {
    "summary.json": RUN,
    "remedy.json": "remedy",
    "diagnosis.json": "diagnosis",
    "history.json": "history",
    "compare.json": "comparison",
    "study.json": "study",
    "cut.json": "cut",
    "exam.json": "examination",
    "regress.json": "regression",
    "campaign.toml": CAMPAIGN,
}
"""Document -> kind of result. If a folder has several, the first of this order counts: a run with a comparison is a run."""
REPORT = "report.html"
_TITLE, _LEAD = re.compile(r"<title>(.*?)</title>", re.S), re.compile(r'<meta name="description" content="(.*?)">', re.S)
HEAD_CHARACTERS = 4000
"""Characters at the start of a page that hold its title and its lead."""

PICTURES = ("run.png", "x_200mm.png", "plots/*.png", "pictures/*.png", "*.png")
"""Patterns of the thumbnail, the first match counts."""


@dataclass(frozen=True)
class Entry:
    """A result: `path` relative to the desk's folder, kind, one-line summary, time of writing."""

    path: str
    kind: str
    summary: str
    written: datetime
    report: str | None  # relative to the desk's folder, like `picture`
    picture: str | None
    replayed: bool  # the viewer can show it
    machine_file: str | None = None

    @property
    def compared(self) -> bool:
        """Whether it can be compared with another of its kind."""
        return self.kind in (RUN, CAMPAIGN)


def entries_in(folder: Path) -> list[Entry]:
    """All entries below a folder, newest first."""
    folder = folder.resolve()
    found = []
    for place, names in _folders(folder):
        entry = None
        with contextlib.suppress(OSError):  # a running command may replace its files
            entry = _entry(folder, place, names)
        found += [entry] if entry is not None else []
        for name in sorted(names):
            if entry is None or name != REPORT:
                with contextlib.suppress(OSError, InputError):
                    found += _alone(folder, place / name)
        if len(found) >= MOST:
            break
    return sorted(found[:MOST], key=lambda entry: entry.written, reverse=True)


def place_in(folder: Path, name: str) -> Path | None:
    """The regular file `name` in a resolved folder; None if there is none, or if links lead out of the folder."""
    try:
        file = (folder / name).resolve()
        return file if file.is_relative_to(folder) and file.is_file() else None
    except (OSError, RuntimeError, ValueError):  # a loop of links, a name that is too long, NUL
        return None


def _folders(folder: Path) -> Iterator[tuple[Path, set[str]]]:
    """The folder and those below it with the names of their regular files, without hidden ones and links that lead out of the folder."""
    for place, below, files in os.walk(folder, followlinks=False):
        here = Path(place)
        if len(here.relative_to(folder).parts) >= DEEPEST:
            below.clear()
        below[:] = sorted(name for name in below if not name.startswith(".") and "exam.json" not in files)  # its inside is no result
        yield here, {name for name in files if not name.startswith(".") and place_in(folder, str(here / name))}


def _entry(folder: Path, place: Path, names: set[str]) -> Entry | None:
    recordings = sorted(n for n in names if n.endswith(".rrd"))
    name = next((name for name in _BY_DOCUMENT if name in names), recordings[0] if recordings else None)
    if name is None:
        return None
    kind = _BY_DOCUMENT.get(name, "recording")
    document: Mapping[str, Any] = {}
    if name.endswith(".json"):
        try:
            document = read_json(place / name, largest=LARGEST_BYTES)
        except InputError as error:
            document = {"verdict": f"cannot be read: {error}"}
    picture = next((file for pattern in PICTURES for file in sorted(place.glob(pattern)) if place_in(folder, str(file))), None)
    machine_file = document.get("machine_file")
    return Entry(
        path=place.relative_to(folder).as_posix(),
        kind=kind,
        summary=(_said(place / REPORT) if REPORT in names and kind != RUN else "") or _summary(document),
        written=datetime.fromtimestamp((place / name).stat().st_mtime),
        report=(place / REPORT).relative_to(folder).as_posix() if REPORT in names else None,
        picture=None if picture is None else picture.relative_to(folder).as_posix(),
        replayed=bool(recordings) or "trace.parquet" in names,
        machine_file=machine_file if isinstance(machine_file, str) else None,
    )


def _alone(folder: Path, file: Path) -> list[Entry]:
    """A single report, such as that of `twin gap --html`, or an evaluation by ISO 230 with the plot beside it; nothing for another file."""
    name, written, picture = file.relative_to(folder).as_posix(), datetime.fromtimestamp(file.stat().st_mtime), file.with_suffix(".png")
    if file.suffix.lower() == ".html":
        return [Entry(name, "report", _said(file), written, name, None, False)]
    document = read_json(file, largest=LARGEST_BYTES) if file.suffix.lower() == ".json" and file.name not in _BY_DOCUMENT else {}
    if not str(document.get("schema")).startswith("iso230/"):
        return []
    shown = picture.relative_to(folder).as_posix() if place_in(folder, str(picture)) else None
    return [Entry(name, str(document.get("standard")), _summary(document), written, None, shown, False)]


def _summary(document: Mapping[str, Any]) -> str:
    """One-line summary of a document; '' if it lacks the keys (it may be from another version)."""
    try:
        errors = {axis: (float(a["error_without_delay_max"]), a["following_error_unit"]) for axis, a in document["axes"].items()}
        worst = max(errors, key=lambda axis: errors[axis][0])
        effects = ", ".join(f"{in_words(e['name'])} {e['axis']}" for e in document["effects"]) or "no effects"
        return f"{Path(document['input']).name} on {document['machine']}, {effects}: error of {worst} {plain(errors[worst][0])} {errors[worst][1]}"
    except (TypeError, ValueError, AttributeError, LookupError, ArithmeticError):
        verdict = document.get("verdict", "")
        return verdict if isinstance(verdict, str) else ""


def _said(page: Path) -> str:
    """Title and lead of a report, '' where it has none."""
    with page.open(encoding="utf-8", errors="replace") as file:
        head = file.read(HEAD_CHARACTERS)
    found = (part.search(head) for part in (_TITLE, _LEAD))
    return " ".join(f"{html.unescape(text[1]).strip().rstrip('.')}." for text in found if text)
