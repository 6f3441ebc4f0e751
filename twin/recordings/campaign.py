"""Campaigns: a folder of measured runs with a `campaign.toml` that says how each was recorded."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
import tomllib

from twin.errors import InputError
from twin.machine.machine import FEEDFORWARD, Machine
from twin.recordings.trace import Trace, read_trace
from twin.tables import is_number, known_keys

_RUN_KEYS = ("file", "feedforward", "started_at_s")


@dataclass(frozen=True)
class MeasuredRun:
    """One run of a campaign: its name (file name without ending), trace, feedforward that was on, start time [s]."""

    name: str
    trace: Trace
    feedforward: str | None
    started_at: float


@dataclass(frozen=True)
class Campaign:
    """Runs in the order of the file, and the machine that `campaign.toml` names."""

    path: Path
    machine_name: str
    runs: tuple[MeasuredRun, ...]


def read_campaign(path: str | Path, machine: Machine) -> Campaign:
    """Read `campaign.toml` and its traces, checked against the machine's axes."""
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; a campaign is a folder with campaign.toml and traces")
    file = path / "campaign.toml"
    if not file.is_file():
        raise InputError(f'{file}: no such file; list the runs there, e.g. [[run]] file = "circle.parquet"')
    try:
        document = tomllib.loads(file.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise InputError(f"{file}: not a valid TOML file: {error}") from None
    known_keys(document, ("machine", "run"), str(file))
    tables = document.get("run", [])
    if not isinstance(tables, list) or not tables:
        raise InputError(f'{file}: no [[run]]; list at least one, e.g. [[run]] file = "circle.parquet"')
    runs = tuple(_read_run(path, table, f"{file}: run {i + 1}", machine) for i, table in enumerate(tables))
    names = [run.name for run in runs]
    if len(set(names)) < len(names):
        raise InputError(f"{file}: two runs are named {next(n for n in names if names.count(n) > 1)}; rename one of the files")
    return Campaign(path, str(document.get("machine", "")), runs)


def _read_run(folder: Path, table: dict, where: str, machine: Machine) -> MeasuredRun:
    if not isinstance(table, dict):
        raise InputError(f'{where}: {table!r} is no run; write each as [[run]] with file = "circle.parquet"')
    known_keys(table, _RUN_KEYS, where)
    if not isinstance(table.get("file"), str):
        raise InputError(f"{where}: 'file' is missing; name the trace of this run")
    file = folder / table["file"]
    if not file.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{where}: file '{table['file']}' leaves the campaign's folder; put the trace inside it")
    feedforward = table.get("feedforward")
    if feedforward is not None and feedforward not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward '{feedforward}'; use one of {', '.join(FEEDFORWARD)}")
    started_at = table.get("started_at_s", 0.0)
    if not is_number(started_at):
        raise InputError(f"{where}: started_at_s = {started_at!r}: expected a number of seconds")
    trace = read_trace(file, axes=machine.kinds, need=("setpoint",))
    return MeasuredRun(Path(table["file"]).stem, trace, feedforward, float(started_at))
