"""The steps of `twin import` and `twin diagnose FILE...`: a map proposed for files that are read without one; files read with a map, understood, written."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
import shutil
import tempfile

from twin.errors import InputError
from twin.files import output_folder, write_whole
from twin.progress import Progress
from twin.recordings.formats.by_content import read_recording
from twin.recordings.map_text import map_text, proposal_table
from twin.recordings.mapping import Map, runs_of
from twin.recordings.propose import Proposal, propose
from twin.recordings.recorded_run import has_columns, run_of_recordings
from twin.recordings.signals import Clock, ReadOptions
from twin.recordings.write import draw_run, understood_table, write_campaign, write_run

MOST_PICTURES = 6
"""Most pictures per recording; one with many strokes becomes many traces."""
SCRATCH = ".import_"
"""Begin of the names of folders with data that do not fit into memory."""


def import_campaign(mapping: Map, files: Sequence[Path], out: Path, picture: bool = True, say: Callable[[str], None] | None = None) -> int:
    """Import runs into the folder `out`; returns the number of traces. `say` receives the lines of the report (e.g. print)."""
    report = say or (lambda _text: None)
    runs = runs_of(mapping, files)
    names = [run.name for run, _ in runs]
    if (out / "campaign.toml").exists() and not (out / "import.json").exists():
        raise InputError(f"{out}: holds a campaign that was not imported; give another --out")
    output_folder(out)
    for left in out.glob(f"{SCRATCH}*"):  # of an import that was killed: this one has the lock of the folder
        shutil.rmtree(left, ignore_errors=True)
    wanted = frozenset([*(c.name for c in mapping.columns), *mapping.settings.labels])
    done = []
    first: datetime | None = None
    with Progress("importing", total=len(runs)) as bar:
        for run, paths in runs:
            # data that do not fit into memory are stored beside the result; /tmp may itself be in memory
            with tempfile.TemporaryDirectory(prefix=SCRATCH, dir=out) as scratch:
                options = [ReadOptions(mapping.clock, wanted, Path(scratch) / str(i), mapping.dialect) for i in range(len(paths))]
                recordings = [read_recording(path, own) for path, own in zip(paths, options)]
                if len(runs) > 1 and not mapping.runs and not has_columns(mapping, recordings):
                    report(f"\n{run.name}: left out, none of its columns is in the map")
                    continue
                known = run_of_recordings(mapping, run, recordings)
                # the start of a run: from the map, else from the clocks of the files relative to the first run, else 0
                started = known.started.replace(tzinfo=known.started.tzinfo or UTC) if known.started is not None else None
                first = first or started
                begun = (started - first).total_seconds() if started is not None and first is not None else 0.0
                traces = write_run(known, begun if run.started_at_s is None else run.started_at_s, out, names)
                if picture:
                    for trace in traces[:MOST_PICTURES]:
                        draw_run(known, trace, out / f"{trace.name}.png")
                done.append((known, traces))
                shown = ", ".join(f"{t.name} {t.piece.count * t.piece.period:.3f} s" for t in traces[:MOST_PICTURES])
                more = f" and {len(traces) - MOST_PICTURES} more" if len(traces) > MOST_PICTURES else ""
                every = f" every {traces[0].piece.period * 1e3:g} ms"
                report(f"\n{run.name}, feedforward {run.feedforward or 'unknown'}: {shown}{more}{every}")
                report(understood_table(known, traces))
                for note in known.notes:
                    report(f"  - {note}")
            bar(None)
    if not done:
        lacking = f"none of the {len(runs)} files has a column of this map, such as '{mapping.columns[0].name}'"
        raise InputError(f"{mapping.path}: {lacking}; correct its names, or run 'twin import' without --map")
    write_campaign(out, mapping, done)
    return sum(len(traces) for _, traces in done)


@dataclass(frozen=True)
class FilesProposal:
    """What was understood of files: the proposal (columns, notes, questions), the map as text, a table for the terminal with what was read."""

    proposal: Proposal
    map: str
    table: str

    def write(self, path: Path) -> None:
        """Write the map. Raises InputError if it cannot be used: without an axis once it is written, to be filled in; without a time before."""
        if self.proposal.axes and not self.proposal.time.known:
            raise InputError("the files give no time; give the interval of the samples with --interval-ms")
        write_whole(path, self.map)
        if not self.proposal.axes:
            reason = self.proposal.left_out[0] if self.proposal.left_out else "none of the columns is the motion of an axis"
            raise InputError(f"{path}: no axis can be proposed ({reason}); enter its columns there, then use it with --map")


def proposal_of(
    files: Sequence[Path], clock: Clock | None = None, dialect: Mapping[str, object] | None = None, given: Map | None = None
) -> FilesProposal:
    """The proposal for these files. `given`: a partial map, which is completed. Raises InputError if a file cannot be read."""
    text = given.path.read_text(encoding="utf-8") if given else ""
    clock = clock or (given.clock if given else Clock())
    dialect = {**(given.dialect if given else {}), **(dialect or {})}
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        options = [ReadOptions(clock, None, Path(scratch) / str(i), dialect) for i in range(len(files))]
        recordings = [read_recording(path, own) for path, own in zip(files, options)]
        proposal = propose(recordings, given)
        own = [r for r in recordings if any(c.name in r.signals for c in proposal.used)]
        if own and len(own) < len(recordings):  # of another recorder: their times are no times of this map
            proposal = propose(own, given)
        heads = [f"{r.path}: {'; '.join(r.notes) or r.format}" for r in recordings]
        proposed = map_text(proposal, [f.name for f in files], clock, dialect, text)
        return FilesProposal(proposal, proposed, "\n".join([*heads, "", proposal_table(proposal, recordings)]))
