"""Find the recording or trace that `twin replay` shows for a path: a file, an output folder, a campaign or a machine."""

from dataclasses import dataclass
from pathlib import Path
import warnings

from twin.documents import read_json, read_toml
from twin.errors import InputError, nearest
from twin.recordings.trace import TRACE_ENDINGS, trace_in
from twin.system import shell_word
from twin.units import in_words

MODEL_ENDINGS = (".xml", ".mjcf", ".urdf")
_WHAT = "give a run folder, a recording (.rrd), a trace (.parquet, .csv) or a model (.xml, .urdf)"
_NAMES = ("run.rrd", "diagnosis.rrd", "cut.rrd", "compare.rrd")
"""Recordings that commands write; they come before others, which are sorted by name."""


@dataclass(frozen=True)
class ReplaySource:
    """A recording, a trace, or both; the label in plots; a note if one of several was chosen."""

    path: Path
    label: str
    recording: Path | None
    trace: Path | None
    note: str = ""


def source_of(path: Path) -> ReplaySource:
    """The source at a path; InputError if nothing there can be replayed."""
    if path.is_dir():
        return _of_folder(path)
    ending = path.suffix.lower()
    if not path.exists():
        raise InputError(f"{path}: no such file or folder; {_WHAT}")
    if ending == ".rrd":
        return ReplaySource(path, _label(path), check_recording(path), trace_in(path.parent) if path.name == "run.rrd" else None)
    if ending in TRACE_ENDINGS:
        return ReplaySource(path, _label(path), None, path)
    if ending in MODEL_ENDINGS:
        raise InputError(f"{path}: a model comes first; give its trace after it")
    raise InputError(f"{path}: '{ending or path.name}' cannot be replayed; {nearest(ending, ('.rrd', *TRACE_ENDINGS, *MODEL_ENDINGS))}")


def check_recording(path: str | Path) -> Path:
    """The path of a complete recording; InputError for any other file."""
    from rerun.chunk import RrdReader

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such recording; give an .rrd file or a run folder")
    try:
        head = path.open("rb").read(4)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None
    if not head:
        raise InputError(f"{path}: the recording is empty; write it again with twin run")
    if head != b"RRF2":
        raise InputError(f"{path}: not a recording; give an .rrd file written by twin, or a trace (.parquet, .csv)")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # for a truncated file the reader only warns
            recordings = RrdReader(path).recordings()
    except (RuntimeError, ValueError, Warning):
        raise InputError(f"{path}: the recording is truncated or damaged; write it again with twin run") from None
    if not recordings:
        raise InputError(f"{path}: the file has a layout but no recording; give the recording of a run")
    return path


def machine_file_in(path: Path) -> Path | None:
    """The machine file of a folder with one machine file and no run, such as that of `twin machine new`."""
    if not path.is_dir() or _recordings_in(path) or trace_in(path) or (path / "campaign.toml").is_file():
        return None
    files = [file for file in sorted(path.glob("*.toml")) if "axis" in _tables_of(file)]
    return files[0] if len(files) == 1 else None


def effects_beside(trace: Path) -> str:
    """Effects of the simulated machine, 'backlash X', from the summary beside a trace; '' without any."""
    try:
        found = read_json(trace.parent / "summary.json").get("effects", [])
    except InputError:
        return ""
    tables = [one for one in found if isinstance(one, dict)] if isinstance(found, list) else []
    return ", ".join(in_words(f"{one.get('name', '')} {one.get('axis', '')}") for one in tables)


def _of_folder(path: Path) -> ReplaySource:
    recordings, trace, name = _recordings_in(path), trace_in(path), path.resolve().name
    if recordings or trace is not None:
        return ReplaySource(path, name, check_recording(recordings[0]) if recordings else None, trace)
    if (path / "campaign.toml").is_file():
        runs = _tables_of(path / "campaign.toml").get("run", [])
        named = [path / str(run.get("file", "")) for run in (runs if isinstance(runs, list) else []) if isinstance(run, dict)]
        files = [file for file in named if file.is_file()]
        if files:
            others = ", ".join(file.name for file in files[1:])
            note = f"{files[0].name} of {len(files)} runs of the campaign is shown; others: {others}" if others else ""
            return ReplaySource(path, files[0].stem, None, files[0], note)
    # each case of a regression or an examination has a folder
    below = sorted(path.rglob("*.rrd"))
    if below:
        note = f"{below[0].relative_to(path)} of {len(below)} recordings in this folder is shown"
        return ReplaySource(path, below[0].parent.name, check_recording(below[0]), None, note)
    programs, pages = sorted(path.glob("*.mpf")), sorted(path.glob("*.html"))
    if programs:
        raise InputError(f"{path}: this folder has part programs but no run; simulate one: twin run {shell_word(programs[0])}")
    if pages:
        raise InputError(f"{path}: this folder has a report but no motion; open {pages[0]} in a browser")
    raise InputError(f"{path}: this folder has neither a recording (.rrd) nor trace.parquet; {_WHAT}")


def _recordings_in(folder: Path) -> list[Path]:
    """Recordings in a folder, those of commands first."""
    named = [folder / name for name in _NAMES if (folder / name).is_file()]
    return named + [file for file in sorted(folder.glob("*.rrd")) if file not in named]


def _tables_of(file: Path) -> dict:
    try:
        return read_toml(file)
    except InputError:
        return {}


def _label(path: Path) -> str:
    """Name of the file, or of its folder for files of a run."""
    return path.resolve().parent.name if path.stem in ("trace", "run") else path.stem
