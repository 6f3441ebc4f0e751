"""Raw recordings for `twin diagnose FILE...`: a campaign and a machine in the output folder, each made anew only if older than its source.

OUT/campaign/map.toml                the proposed map; edit it and repeat the command
OUT/campaign/campaign.toml           the imported campaign; newer than the map and the files, it is used as it stands
OUT/machine_from_recording.toml      the machine; newer than the campaign, it is used as it stands
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from twin.errors import InputError
from twin.identify.from_recording import NewMachine, machine_from_recording
from twin.recordings.imported import import_campaign, proposal_of
from twin.recordings.mapping import read_map
from twin.recordings.signals import Clock

MACHINE = "machine_from_recording.toml"


def files_of(inputs: Sequence[Path]) -> list[Path]:
    """The files among the inputs; a folder stands for the files in it. A run of the twin itself is no recording."""
    if simulated := next((path for path in inputs if (path / "summary.json").is_file() and (path / "trace.parquet").is_file()), None):
        raise InputError(f"{simulated}: a run of 'twin run', simulated, no recording; give recordings, or compare it with 'twin compare'")
    files = [f for path in inputs for f in (sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path])]
    if missing := next((f for f in files if not f.exists()), None):
        raise InputError(f"{missing}: no such file; give recordings, or the folder of a campaign")
    if not files:
        raise InputError(f"{inputs[0]}: holds no files; give recordings, or the folder of a campaign")
    return files


def campaign_of(
    files: Sequence[Path],
    given: Path | None,
    out: Path,
    say: Callable[[str], None],
    clock: Clock | None = None,
    dialect: Mapping[str, object] | None = None,
) -> Path:
    """Import the files to OUT/campaign with the given map, the map that stands there, or a proposed one; returns the folder.

    A partial map is completed. `clock` and `dialect` say what a file without times or headings leaves open.
    """
    folder = out / "campaign"
    map_file = folder / "map.toml"
    partial = read_map(str(given)) if given is not None else None
    if partial is not None and not partial.partial and given is not None:
        map_file = given
    elif not map_file.exists():
        found = proposal_of(files, clock, dialect, partial)
        say(found.table)
        found.write(map_file)
        say(f"map proposed from names and numbers: {map_file}; edit it and repeat this command")
    if is_stale(folder / "campaign.toml", [map_file, *files]):
        import_campaign(read_map(str(map_file)), files, folder, say=say)
    else:
        say(f"campaign used as it stands: {folder}")
    return folder


def machine_of_campaign(
    campaign: Path, out: Path, say: Callable[[str], None], progress: Callable[[str], None], identified: bool = False
) -> tuple[Path, NewMachine | None]:
    """OUT/machine_from_recording.toml, and what was found if it was made now; without `identified` the first values."""
    file = out / MACHINE
    if not is_stale(file, [campaign / "campaign.toml"]):
        say(f"machine used as it stands: {file}")
        return file, None
    for path in (file, file.with_suffix(".xml")):
        path.unlink(missing_ok=True)
    return file, machine_from_recording(campaign, file, progress, identified)


def is_stale(made: Path, sources: Sequence[Path]) -> bool:
    """True if a file is missing or older than one of its sources."""
    return not made.exists() or made.stat().st_mtime < max(s.stat().st_mtime for s in sources)
