"""The proposal for files: read without a map, understood, as text for the terminal and as a map. `twin import` and `twin diagnose FILE...` use it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import tempfile

from twin.recordings.formats.by_content import read_recording
from twin.recordings.map_text import map_text
from twin.recordings.mapping import Map
from twin.recordings.overview import proposal_table
from twin.recordings.propose import Proposal, propose
from twin.recordings.signals import Clock, ReadOptions


@dataclass(frozen=True)
class FilesProposal:
    """What was understood of files: the proposal (columns, notes, questions), the map as text, a table for the terminal with what was read."""

    proposal: Proposal
    map: str
    table: str

    @property
    def lacking(self) -> str:
        """Why the map cannot be used as it is, in one line; "" if it can."""
        if not self.proposal.axes:
            reason = self.proposal.left_out[0] if self.proposal.left_out else "none of the columns is the motion of an axis"
            return f"no axis can be proposed ({reason}); enter its columns there, then use it with --map"
        if not self.proposal.timed:
            return "the files give no time; give the interval of the samples with --interval-ms"
        return ""


def proposal_of(
    files: Sequence[Path], clock: Clock | None = None, dialect: Mapping[str, object] | None = None, given: Map | None = None
) -> FilesProposal:
    """The proposal for these files. `given`: a partial map, which is completed. Raises InputError if a file cannot be read."""
    text = given.path.read_text(encoding="utf-8") if given else ""
    clock = clock or (given.clock if given else None)
    dialect = {**(given.dialect if given else {}), **(dialect or {})}
    with tempfile.TemporaryDirectory(prefix="twin_import_") as scratch:
        options = [ReadOptions(clock or Clock(), None, Path(scratch) / str(i), dialect) for i in range(len(files))]
        recordings = [read_recording(path, own) for path, own in zip(files, options)]
        proposal = propose(recordings, given)
        heads = [f"{r.path}: {'; '.join(r.notes) or r.format}" for r in recordings]
        return FilesProposal(
            proposal,
            map_text(proposal, [f.name for f in files], clock, dialect, text),
            "\n".join([*heads, "", proposal_table(proposal, recordings)]),
        )
