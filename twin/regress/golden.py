"""The result of a case, and its golden result: `golden/NAME.json` (numbers, events, versions, date, reasons), `golden/NAME.parquet` (decimated trace).

Golden results are stored in the folder `golden` beside the suite file and written only by `twin regress --update`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import date
from importlib.metadata import version
import json
from pathlib import Path
from typing import Any

import msgspec

from twin.documents import read_json
from twin.errors import InputError
from twin.files import beside, write_whole
from twin.machine.machine import Machine
from twin.recordings.trace import Trace, read_trace
from twin.regress.suite import SIGNAL_UNITS, Case
from twin.replay.events import Event
from twin.system import shell_word

FORMAT = 1
"""Format of the files; other formats are refused."""
VERSIONED = ("mujoco", "numba", "numpy", "scipy")


@dataclass(frozen=True)
class Feature:
    """A number with its unit, or a word that must not change; `axis` and `block` it belongs to ('' for none)."""

    value: float | str
    unit: str = ""
    axis: str = ""
    block: str = ""
    noise: float = 0.0  # for a gap: that of the measuring noise alone; for a parameter: half its interval


@dataclass(frozen=True)
class Outcome:
    """Result of a case: numbers and words by name, trace (if it has one), events; `failed` is the reason why a simulation was aborted ('' if it was not)."""

    features: Mapping[str, Feature]
    trace: Trace | None = None
    events: tuple[Event, ...] = ()
    machine: Machine | None = field(default=None, repr=False)
    failed: str = ""


@dataclass(frozen=True)
class Golden:
    """A stored result with its origin, as in its JSON file, where `trace` says whether there is one."""

    features: dict[str, Feature]
    trace: Any
    events: tuple[Event, ...]
    versions: dict[str, str]
    case: str  # digest of its case


def versions() -> dict[str, str]:
    """Versions of the packages that influence the numbers of a run."""
    import twin

    return {"twin": twin.__version__, **{name: version(name) for name in VERSIONED}}


def golden_paths(case: Case) -> tuple[Path, Path]:
    """The JSON and the Parquet file of a case."""
    folder = case.file.parent / "golden"
    return folder / f"{case.name}.json", folder / f"{case.name}.parquet"


def golden_of(outcome: Outcome, case: Case) -> Golden:
    """The golden result of an outcome; its trace is sampled at the position cycle, as the check of the control laws needs."""
    trace = outcome.trace
    if trace is not None and outcome.machine is not None:
        given = case.table.get("keep_every_ms")
        every_s = float(given) * 1e-3 if given else outcome.machine.position_cycle
        every = max(1, round(every_s / trace.period))
        if every >= len(trace.time):
            raise InputError(f"keep_every_ms = {every_s * 1e3:g} keeps one sample of a run of {trace.time[-1]:.4g} s; keep more")
        signals = {key: values for key, values in trace.signals.items() if key[1] in SIGNAL_UNITS}
        trace = replace(trace, signals=signals).decimated(every)
    return Golden(dict(outcome.features), trace, outcome.events, versions(), case.digest())


def read_golden(case: Case, of_this_case: bool = True) -> Golden:
    """The golden result of a case. Raises InputError if it is missing, damaged, of another format or of another case."""
    file, traced = golden_paths(case)
    update = f"make it with: twin regress {shell_word(case.file)} --only {case.name} --update --reason '...'"
    if not file.is_file():
        raise InputError(f"{case.where}: no golden result {file}; {update}")
    try:
        document = read_json(file, "a golden result")
        if document["format"] != FORMAT:
            raise InputError(
                f"{file}: golden result of format {document['format']} (twin {document['versions']['twin']}), this twin "
                f"{versions()['twin']} reads format {FORMAT}; {update}"
            )
        if of_this_case and document["case"] != case.digest():
            raise InputError(f"{case.where} has changed since its golden result of {document['history'][-1]['date']}; {update}")
        found = msgspec.convert(document, Golden)
    except (OSError, ValueError, LookupError, TypeError, msgspec.ValidationError) as error:
        raise InputError(f"{file}: not a golden result ({type(error).__name__}: {error}); restore it, or {update}") from None
    if not found.trace:
        return replace(found, trace=None)
    if not traced.is_file():
        raise InputError(f"{case.where}: the golden trace {traced} is missing; restore it, or {update}")
    try:
        return replace(found, trace=read_trace(traced))
    except InputError as error:
        raise InputError(f"{' '.join(str(error).split())}; restore it, or {update}") from None


def write_golden(case: Case, golden: Golden, history: Sequence[Mapping[str, Any]], reason: str, changed: int) -> None:
    """Write a new golden result; its history records date, versions, number of changed values and the reason."""
    file, traced = golden_paths(case)
    entry = {"date": date.today().isoformat(), "reason": reason, "changed": changed, "versions": dict(golden.versions)}
    document = {
        "format": FORMAT,
        "case": golden.case,
        "versions": dict(golden.versions),
        "history": [*history, entry],
        "trace": golden.trace is not None,
        "features": {name: asdict(feature) for name, feature in golden.features.items()},
        "events": [asdict(event) for event in golden.events],
    }
    if golden.trace is not None:
        write_small(golden.trace, traced)
    else:
        traced.unlink(missing_ok=True)
    write_whole(file, json.dumps(document, indent=1) + "\n")


def write_small(trace: Trace, path: Path) -> None:
    """Write a trace like `write_trace`, with stronger compression."""
    import pyarrow.parquet

    packing = {"compression": "zstd", "compression_level": 19, "use_dictionary": False, "use_byte_stream_split": True}
    with beside(path) as partial:
        pyarrow.parquet.write_table(trace.to_table(), partial, **packing)


def history_of(case: Case) -> list[dict[str, Any]]:
    """History of a golden result; empty if there is none that can be read."""
    try:
        return list(read_json(golden_paths(case)[0])["history"])
    except (InputError, ValueError, KeyError, TypeError):
        return []
