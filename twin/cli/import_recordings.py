"""`twin import`: convert recordings to a campaign."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
import tempfile

from twin.errors import InputError
from twin.files import output_folder, write_whole
from twin.progress import Progress
from twin.recordings.formats.by_ending import READERS, read_recording
from twin.recordings.mapping import Map, RunMap, read_map, runs_of
from twin.recordings.signals import Clock, ReadOptions, Recording

MOST_PICTURES = 6
"""Most pictures per recording; one with many strokes becomes many traces."""


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
    mapping = read_map(map_file, args.machine)
    traces = import_campaign(mapping, files, Path(args.out), picture=not args.no_picture, say=print)
    drawn = "of each" if traces <= MOST_PICTURES else f"of the first {MOST_PICTURES} of a recording"
    pictures = "" if args.no_picture else f", a picture (.png) {drawn}"
    print(f"written to {args.out}: campaign.toml, {traces} trace{'s' * (traces > 1)}{pictures}, import.json")
    return 0


def import_campaign(mapping: Map, files: Sequence[Path], out: Path, picture: bool = True, say: Callable[[str], None] | None = None) -> int:
    """Import runs into the folder `out`; returns the number of traces. `say` receives the lines of the report (e.g. print)."""
    from twin.recordings.overview import draw_run, understood_table
    from twin.recordings.understand import understand
    from twin.recordings.write import write_campaign, write_run

    report = say or (lambda _text: None)
    runs = runs_of(mapping, files)
    names = [run.name for run, _ in runs]
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    output_folder(out)
    done, begun = [], _beginnings()
    with Progress("importing", total=len(runs)) as bar:
        for run, paths in runs:
            # data that do not fit into memory are stored beside the result; /tmp may itself be in memory
            with tempfile.TemporaryDirectory(prefix=".import_", dir=out) as scratch:
                recordings = _read(mapping, paths, Path(scratch))
                known = understand(mapping, run, recordings)
                traces = write_run(known, begun(run, known.started), out, names)
                if picture:
                    for trace in traces[:MOST_PICTURES]:
                        draw_run(known, trace, out / f"{trace.name}.png")
                done.append((known, traces))
                report(
                    f"\n{run.name}, feedforward {run.feedforward or 'unknown'}: "
                    + ", ".join(f"{t.name} {t.piece.count * t.piece.period:.3f} s" for t in traces[:MOST_PICTURES])
                    + (f" and {len(traces) - MOST_PICTURES} more" if len(traces) > MOST_PICTURES else "")
                    + f" every {traces[0].piece.period * 1e3:g} ms"
                )
                report(understood_table(known, traces))
                for note in known.notes:
                    report(f"  - {note}")
            bar(None)
    write_campaign(out, mapping, done)
    return sum(len(traces) for _, traces in done)


def _read(mapping: Map, paths: Sequence[Path], scratch: Path) -> list[Recording]:
    wanted = frozenset([*(c.name for c in mapping.columns), *mapping.labels])
    return [read_recording(path, ReadOptions(mapping.clock, wanted, scratch / str(i), mapping.dialect)) for i, path in enumerate(paths)]


def _beginnings() -> Callable[[RunMap, datetime | None], float]:
    """Start time of each run [s]: from the map, else from the clocks of the files relative to the first run, else 0."""
    first: list[datetime] = []

    def begun(run: RunMap, started: datetime | None) -> float:
        if started is not None and started.tzinfo is None:
            started = started.replace(tzinfo=UTC)
        if started is not None and not first:
            first.append(started)
        if run.started_at_s is not None:
            return run.started_at_s
        return (started - first[0]).total_seconds() if started is not None else 0.0

    return begun


def _read_all(files: Sequence[Path], scratch: str) -> list[Recording]:
    """All columns of all files, without a map."""
    return [read_recording(path, ReadOptions(Clock(), None, Path(scratch) / str(i))) for i, path in enumerate(files)]


def _list(files: Sequence[Path]) -> int:
    """List the content of the files and the proposed map."""
    from twin.recordings.map_text import map_text
    from twin.recordings.overview import listing
    from twin.recordings.propose import propose

    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        recordings = _read_all(files, scratch)
        for recording in recordings:
            print(f"{recording.path}: {'; '.join(recording.notes) or recording.format}")
            print(listing(recording) + "\n")
        print(map_text(propose(recordings), [f.name for f in files]))
    return 0


def _proposed(files: Sequence[Path], out: Path) -> Path:
    """Write the proposed map into the folder of the campaign; returns its path."""
    from twin.recordings.map_text import map_text
    from twin.recordings.propose import propose

    path = out / "map.toml"
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        proposal = propose(_read_all(files, scratch))
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
