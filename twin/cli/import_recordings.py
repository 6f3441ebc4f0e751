"""`twin import`: recorded files and a map in, a campaign out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
import tempfile

from twin.errors import InputError
from twin.files import output_folder
from twin.progress import Progress
from twin.recordings.formats.by_ending import READERS, read_recording
from twin.recordings.mapping import Map, RunMap, read_map, runs_of
from twin.recordings.signals import Clock, How, Recording


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's arguments."""
    parser.add_argument("files", nargs="+", metavar="FILES", help=f"recorded files ({' '.join(READERS)})")
    parser.add_argument(
        "--map", metavar="MAP", help="map (.toml) of columns to axes and signals; without it the files are listed, and a map begun"
    )
    parser.add_argument("--out", metavar="CAMPAIGN", help="folder for the campaign")
    parser.add_argument("--machine", metavar="FILE", help="machine file to check against (default: the one that the map names)")
    parser.add_argument("--no-picture", action="store_true", help="do not draw the runs")


def carry_out(args: argparse.Namespace) -> int:
    """Read, understand, write; say what was understood."""
    files = [Path(f) for f in args.files]
    if args.map is None:
        return _list(files)
    if args.out is None:
        raise InputError("--out is missing; name the folder for the campaign")
    mapping = read_map(args.map, args.machine)
    traces = import_campaign(mapping, files, Path(args.out), picture=not args.no_picture, say=print)
    pictures = "" if args.no_picture else ", a picture (.png) of each"
    print(f"written to {args.out}: campaign.toml, {traces} trace{'s' * (traces > 1)}{pictures}, import.json")
    return 0


def import_campaign(mapping: Map, files: Sequence[Path], out: Path, picture: bool = True, say: Callable[[str], None] | None = None) -> int:
    """Make the campaign; returns the number of traces. `say` takes the lines that tell what was understood (print)."""
    from twin.recordings.overview import draw_run, understood_table
    from twin.recordings.understand import understand
    from twin.recordings.write import write_campaign, write_run

    tell = say or (lambda _text: None)
    runs = runs_of(mapping, files)
    names = [run.name for run, _ in runs]
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    output_folder(out)
    done, begun = [], _beginnings()
    with Progress("importing", total=len(runs)) as bar:
        for run, paths in runs:
            # what does not fit into memory waits beside the result, not in a /tmp that may be memory
            with tempfile.TemporaryDirectory(prefix=".import_", dir=out) as scratch:
                recordings = _read(mapping, paths, Path(scratch))
                known = understand(mapping, run, recordings)
                traces = write_run(known, begun(run, known.started), out, names)
                if picture:
                    for trace in traces:
                        draw_run(known, trace, out / f"{trace.name}.png")
                done.append((known, traces))
                tell(
                    f"\n{run.name}, feedforward {run.feedforward or 'not said'}: "
                    + ", ".join(f"{t.name} {t.piece.count * t.piece.period:.3f} s" for t in traces)
                    + f" every {traces[0].piece.period * 1e3:g} ms"
                )
                tell(understood_table(known, traces))
                for note in known.notes:
                    tell(f"  - {note}")
            bar(None)
    write_campaign(out, mapping, done)
    return sum(len(traces) for _, traces in done)


def _read(mapping: Map, paths: Sequence[Path], scratch: Path) -> list[Recording]:
    wanted = frozenset(c.name for c in mapping.columns)
    return [read_recording(path, How(mapping.clock, wanted, scratch / str(i), mapping.dialect)) for i, path in enumerate(paths)]


def _beginnings() -> Callable[[RunMap, datetime | None], float]:
    """When each run began [s]: the map's word, else the file's clock after the first run's, else 0."""
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


def _list(files: Sequence[Path]) -> int:
    """What the files hold, and the beginning of a map."""
    from twin.recordings.overview import listing, stub_of

    recordings = []
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        for i, path in enumerate(files):
            recording = read_recording(path, How(Clock(), None, Path(scratch) / str(i)))
            recordings.append(recording)
            print(f"{path}: {'; '.join(recording.notes) or recording.format}")
            print(listing(recording) + "\n")
        print(stub_of(recordings))
    return 0
