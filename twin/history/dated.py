"""Dated campaigns in a folder: campaigns, or single traces, each with the day of its recording.

The day stands in `campaign.toml` (`recorded = 2026-05-03`), or in the name of the folder or the file (2026-05-03, 2026-05-03_06-30, 20260503).
Where none has a day, the order of the names counts, one week apart, and this is said.
"""

from dataclasses import dataclass
from datetime import date, datetime, timedelta
import hashlib
from pathlib import Path
import re

from twin.documents import named_file, read_toml
from twin.errors import InputError, TwinError
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun, read_campaign
from twin.recordings.trace import TRACE_ENDINGS, read_trace

_DAY = re.compile(r"(?<!\d)(20\d\d)[-_.]?(\d\d)[-_.]?(\d\d)(?:[T_ -]?([0-2]\d)[-:.]?([0-5]\d))?(?!\d)")
FIRST = datetime(2000, 1, 3)
"""Day of the first campaign of a folder without days."""


@dataclass(frozen=True)
class Dated:
    """A campaign or a single trace, its day, and the digest of its files."""

    path: Path
    day: datetime
    digest: str

    @property
    def name(self) -> str:
        return self.path.name

    def runs(self, machine: Machine) -> tuple[MeasuredRun, ...]:
        """Its runs, checked against the machine."""
        if self.path.is_dir():
            return read_campaign(self.path, machine).runs
        return (MeasuredRun(self.path.stem, read_trace(self.path, axes=machine.kinds, need=("setpoint",)), None, 0.0),)


def dated_campaigns(folder: Path) -> tuple[list[Dated], dict[str, str], list[str]]:
    """Everything dated in a folder by day, what is wrong with the others by name, and notes. Raises InputError if nothing is there."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give a folder of dated campaigns, one subfolder or trace each")
    if (folder / "campaign.toml").is_file():
        raise InputError(f"{folder}: one campaign; give the folder that holds it and the others, one subfolder or trace a day")
    there = [p for p in sorted(folder.iterdir()) if not p.name.startswith(".")]
    found = [p for p in there if ((p / "campaign.toml").is_file() if p.is_dir() else p.suffix.lower() in TRACE_ENDINGS)]
    if not found:
        raise InputError(
            f"{folder}: holds no campaign (a subfolder with campaign.toml) and no trace ({', '.join(TRACE_ENDINGS)}); import recordings first"
        )
    known: dict[Path, tuple[datetime | None, str]] = {}  # day and digest
    wrong: dict[str, str] = {}
    for path in found:
        try:
            known[path] = day_of(path), digest_of(path)
        except (TwinError, OSError) as error:
            wrong[path.name] = str(error)
    notes = []
    if not any(day for day, _ in known.values()):
        order = sorted(found, key=lambda p: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", p.name)])
        known = {path: (FIRST + timedelta(weeks=i), known[path][1]) for i, path in enumerate(order) if path in known}
        notes.append(
            "no campaign has a day: they count as one week apart, in the order of their names; write recorded = 2026-05-03 in campaign.toml"
        )
    unique: dict[str, Dated] = {}
    for path, (day, digest) in sorted(known.items(), key=lambda one: (one[1][0] or FIRST, one[0].name)):
        if day is None:
            wrong[path.name] = (
                f"{path}: has no day, others have; put it in the name (2026-05-03) or in campaign.toml as recorded = 2026-05-03"
            )
        elif digest in unique:
            notes.append(f"{path.name}: the same recording as {unique[digest].name}; it counts once")
        else:
            unique[digest] = Dated(path, day, digest)
    return list(unique.values()), wrong, notes


def day_of(path: Path) -> datetime | None:
    """The day of a campaign or trace; None if it has none."""
    if path.is_dir():
        day = read_toml(path / "campaign.toml").get("recorded")
        if isinstance(day, datetime):
            return day.replace(tzinfo=None)
        if isinstance(day, date):
            return datetime(day.year, day.month, day.day)
        if day is not None:
            raise InputError(f"{path / 'campaign.toml'}: recorded = {day!r} is no date; write recorded = 2026-05-03, without quotes")
    for match in _DAY.finditer(path.stem if path.suffix.lower() in TRACE_ENDINGS else path.name):
        try:
            year, month, day, hour, minute = (int(part) for part in match.groups(default="0"))
            return datetime(year, month, day, hour, minute)
        except ValueError:
            continue
    return None


def digest_of(path: Path) -> str:
    """SHA-256 of the files of a campaign, or of a trace, whatever their folder is called."""
    digest, files = hashlib.sha256(), [path]
    if path.is_dir():
        toml = path / "campaign.toml"
        runs = read_toml(toml).get("run", [])
        names = [run.get("file") for run in runs if isinstance(run, dict)] if isinstance(runs, list) else []
        files = [toml, *(named_file(name, path, f"{toml}: file") for name in names if isinstance(name, str))]
    for file in files:
        digest.update(f"{file.name}\0".encode() if path.is_dir() else b"")
        with file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()
