"""`twin import`: convert recordings to a campaign."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import tempfile

from twin.errors import InputError
from twin.files import output_folder, write_whole
from twin.recordings.formats.by_ending import READERS
from twin.recordings.mapping import read_map


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("files", nargs="+", metavar="FILES", help=f"recorded files ({' '.join(READERS)})")
    parser.add_argument(
        "--map",
        metavar="MAP",
        help="map (.toml) from columns to axes and signals (default: proposed from the column names, written to CAMPAIGN/map.toml)",
    )
    parser.add_argument("--out", metavar="CAMPAIGN", help="folder for the campaign (without --out and --map: only list the files)")
    parser.add_argument("--machine", metavar="FILE", help="machine file to check against (default: from the map)")
    parser.add_argument("--no-picture", action="store_true", help="do not plot the runs")


def carry_out(args: argparse.Namespace) -> int:
    """Import the files and print a report."""
    files = [Path(f) for f in args.files]
    if args.map is None and args.out is None:
        return _list(files)
    if args.out is None:
        raise InputError("--out is missing; name the folder for the campaign")
    map_file = args.map or _proposed(files, Path(args.out))
    from twin.recordings.imported import MOST_PICTURES, import_campaign

    mapping = read_map(map_file, args.machine)
    traces = import_campaign(mapping, files, Path(args.out), picture=not args.no_picture, say=print)
    drawn = "of each" if traces <= MOST_PICTURES else f"of the first {MOST_PICTURES} of a recording"
    pictures = "" if args.no_picture else f", a picture (.png) {drawn}"
    print(f"written to {args.out}: campaign.toml, {traces} trace{'s' * (traces > 1)}{pictures}, import.json")
    return 0


def _list(files: Sequence[Path]) -> int:
    """List the content of the files and the proposed map."""
    from twin.recordings.imported import read_all
    from twin.recordings.map_text import map_text
    from twin.recordings.overview import listing
    from twin.recordings.propose import propose

    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        recordings = read_all(files, scratch)
        for recording in recordings:
            print(f"{recording.path}: {'; '.join(recording.notes) or recording.format}")
            print(listing(recording) + "\n")
        print(map_text(propose(recordings), [f.name for f in files]))
    return 0


def _proposed(files: Sequence[Path], out: Path) -> Path:
    """Write the proposed map into the folder of the campaign; returns its path."""
    from twin.recordings.imported import read_all
    from twin.recordings.map_text import map_text
    from twin.recordings.propose import propose

    path = out / "map.toml"
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        proposal = propose(read_all(files, scratch))
    text = map_text(proposal, [f.name for f in files])
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
