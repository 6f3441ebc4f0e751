"""`twin import`: convert recordings to a campaign."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
import tempfile

from twin.errors import InputError
from twin.files import output_folder, write_whole
from twin.recordings.formats.by_content import FORMATS
from twin.recordings.mapping import read_map
from twin.recordings.signals import Clock


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("files", nargs="+", metavar="FILES", help=f"recorded files: {FORMATS}")
    parser.add_argument(
        "--map",
        metavar="MAP",
        help="map (.toml) from columns to axes and signals (default: proposed from the column names, written to CAMPAIGN/map.toml)",
    )
    parser.add_argument("--out", metavar="CAMPAIGN", help="folder for the campaign (without --out and --map: only list the files)")
    add_reading_arguments(parser)
    parser.add_argument("--machine", metavar="FILE", help="machine file to check against (default: from the map)")
    parser.add_argument("--no-picture", action="store_true", help="do not plot the runs")


def add_reading_arguments(parser: argparse.ArgumentParser) -> None:
    """What a file without a heading or without a time leaves open."""
    parser.add_argument("--interval-ms", type=float, metavar="T", help="interval of the samples, for files without a time")
    parser.add_argument(
        "--columns", metavar="A,B,...", help="names of all columns, for text without a heading: 'time [ms],position [mm],-' (-: unused)"
    )


def reading_of(args: argparse.Namespace) -> tuple[Clock, dict[str, object]]:
    """Clock and [csv] table of these arguments."""
    if args.interval_ms is not None and not 0.0 < args.interval_ms < 1e6:
        raise InputError(f"--interval-ms {args.interval_ms:g}: give a number above 0, the milliseconds between two samples")
    dialect: dict[str, object] = {"columns": [c.strip() for c in args.columns.split(",")]} if args.columns else {}
    return Clock(interval_s=args.interval_ms * 1e-3 if args.interval_ms else None), dialect


def carry_out(args: argparse.Namespace) -> int:
    """Import the files and print a report."""
    files = [Path(f) for f in args.files]
    clock, dialect = reading_of(args)
    if args.map is None and args.out is None:
        return _list(files, clock, dialect)
    if args.out is None:
        raise InputError("--out is missing; name the folder for the campaign")
    map_file = args.map or _proposed(files, Path(args.out), clock, dialect)
    from twin.recordings.imported import MOST_PICTURES, import_campaign

    mapping = read_map(map_file, args.machine)
    mapping = replace(mapping, clock=clock if clock.interval_s else mapping.clock, dialect={**mapping.dialect, **dialect})
    traces = import_campaign(mapping, files, Path(args.out), picture=not args.no_picture, say=print)
    drawn = "of each" if traces <= MOST_PICTURES else f"of the first {MOST_PICTURES} of a recording"
    pictures = "" if args.no_picture else f", a picture (.png) {drawn}"
    print(f"written to {args.out}: campaign.toml, {traces} trace{'s' * (traces > 1)}{pictures}, import.json")
    return 0


def _list(files: Sequence[Path], clock: Clock, dialect: dict[str, object]) -> int:
    """List the content of the files and the proposed map."""
    from twin.recordings.imported import read_all
    from twin.recordings.map_text import map_text
    from twin.recordings.overview import listing
    from twin.recordings.propose import propose

    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        recordings = read_all(files, scratch, clock, dialect)
        for recording in recordings:
            print(f"{recording.path}: {'; '.join(recording.notes) or recording.format}")
            print(listing(recording) + "\n")
        print(map_text(propose(recordings), [f.name for f in files], clock, dialect))
    return 0


def _proposed(files: Sequence[Path], out: Path, clock: Clock, dialect: dict[str, object]) -> Path:
    """Write the proposed map into the folder of the campaign; returns its path."""
    from twin.recordings.imported import read_all, with_times
    from twin.recordings.map_text import map_text
    from twin.recordings.propose import propose

    path = out / "map.toml"
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        proposal = propose(with_times(read_all(files, scratch, clock, dialect)))
    text = map_text(proposal, [f.name for f in files], clock, dialect)
    if path.exists() and path.read_text(encoding="utf-8", errors="replace") != text:
        raise InputError(f"{path}: differs from the map proposed now; use it with --map {path}, or remove it")
    output_folder(out)
    write_whole(path, text)
    if not proposal.axes:
        reason = proposal.left_out[0] if proposal.left_out else "no column name is known"
        raise InputError(
            f"{path}: no axis can be proposed ({reason}); enter the set-point column of each axis there, then use it with --map"
        )
    print(f"map proposed from the column names: {path}")
    for line in [*(f"doubtful, not used: {c.name} ({c.doubt})" for c in proposal.columns if c.doubt), *proposal.left_out]:
        print(f"  - {line}")
    return path
