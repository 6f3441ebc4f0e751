"""Campaigns: folders of measured runs with a `campaign.toml` that describes each run.

    machine = "my_machine"
    [[run]]
    file = "stroke.parquet"
    feedforward = "velocity"           # off | velocity | velocity+torque
    started_at_s = 0.0
    [[run.channel]]                    # findings of the import about a channel; every key is optional
    axis = "1"
    signal = "position"
    latency_s = 0.003                  # lateness relative to the first encoder of the axis
    latency_deviation_s = 2e-5         # its standard deviation
    taken_back_s = 0.003               # part of the latency that was removed from the trace
    offset_m = 1.2e-4                  # constant difference to the motor encoder (offset_rad on a rotary axis)
    offset_taken_out = true            # the offset was removed from the trace
    sign = -1                          # the sign was reversed at the import
    against = true                     # pushes against the motion; the sign was kept
    unsigned = true                    # only the magnitude of a force is recorded
    made_from = "position"             # not recorded: a set point that is the recorded motion (position, motor_position, velocity), or that
                                       # motion plus the following_error; a motor_position that is the sum of the velocity
    [run.labels]                       # columns that are constant within the run: load, trial
    load = 20.0
    [run.ballbar]                      # positions come from a ballbar between two axes, see `twin.recordings.ballbar`
    axes = ["X", "Y"]
    noise_m = 1e-7                     # standard deviation of a radius

Program block events are in `events.parquet` beside the traces: time [s] in the trace of `run`, channel, block, text, run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
import os
from pathlib import Path

from twin.documents import named_file, read_toml, reading
from twin.errors import InputError
from twin.limits import refuse_above, refuse_bytes
from twin.machine.machine import FEEDFORWARD, Machine
from twin.recordings.ballbar import Ballbar, ballbar_of
from twin.recordings.parquet_file import read_parquet, text_bytes
from twin.recordings.profile_speed import SIGNAL, answers_position
from twin.recordings.table_file import table_bytes
from twin.recordings.trace import Trace, read_trace
from twin.tables import is_number, known_keys, listed, positive

_RUN_KEYS = ("file", "feedforward", "started_at_s", "channel", "labels", "ballbar")
_CHANNEL_NUMBERS = ("latency_s", "latency_deviation_s", "taken_back_s", "offset_m", "offset_rad")
_CHANNEL_FLAGS = ("offset_taken_out", "against", "unsigned")
EVENTS = "events.parquet"
MADE_FROM = ("following_error", "position", "motor_position", "velocity")
MOST_RUNS = 20_000
"""Runs of one campaign."""


@dataclass(frozen=True)
class ChannelFact:
    """Findings of the import about one channel of a run; see the head of this module."""

    latency: float = 0.0
    latency_deviation: float = 0.0
    taken_back: float = 0.0
    offset: float = 0.0
    offset_taken_out: bool = False
    sign: int = 1
    against: bool = False
    unsigned: bool = False
    profile: bool = False  # a speed set point that does not answer the position; it is not in the trace
    made_from: str = ""

    @property
    def latency_left(self) -> float:
        """Latency [s] that remains in the trace."""
        return self.latency - self.taken_back

    @property
    def offset_left(self) -> float:
        """Offset [m or rad] that remains in the trace."""
        return 0.0 if self.offset_taken_out else self.offset


@dataclass(frozen=True)
class BlockEvent:
    """Start of a program block: time [s] in the run's trace (negative: before it), channel of the control, block, text."""

    time: float
    channel: int
    block: str
    text: str


@dataclass(frozen=True)
class MeasuredRun:
    """One run of a campaign: name (file name without ending), trace, feedforward in use, start time [s].

    facts      findings of the import, by (axis, signal)
    labels     values of label columns
    events     program blocks in order of time
    own_zeros  axes whose encoders have no common zero, such as those with an offset taken out; comparisons remove the mean of their difference
    ballbar    the instrument that measured the positions instead of scales
    """

    name: str
    trace: Trace
    feedforward: str | None
    started_at: float
    facts: Mapping[tuple[str, str], ChannelFact] = field(default_factory=dict)
    labels: Mapping[str, float] = field(default_factory=dict)
    events: tuple[BlockEvent, ...] = ()
    own_zeros: frozenset[str] = frozenset()
    ballbar: Ballbar | None = None

    def fact(self, axis: str, signal: str) -> ChannelFact:
        """Findings about a channel; defaults if there are none."""
        return self.facts.get((axis, signal), ChannelFact())

    def block_at(self, time: float) -> BlockEvent | None:
        """The program block that was active at a time [s] of the trace; None if none is recorded."""
        past = [e for e in self.events if e.time <= time]
        return past[-1] if past else None


@dataclass(frozen=True)
class Campaign:
    """Runs in the order of the file, and the machine named in `campaign.toml`."""

    path: Path
    machine_name: str
    runs: tuple[MeasuredRun, ...]


def read_campaign(path: str | Path, machine: Machine | None = None) -> Campaign:
    """Read `campaign.toml` and its traces, checked against the axes of the machine (None: unknown machine)."""
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; a campaign is a folder with campaign.toml and traces")
    file = path / "campaign.toml"
    if not file.is_file():
        raise InputError(f'{file}: no such file; list the runs there, e.g. [[run]] file = "circle.parquet"')
    document = read_toml(file)
    known_keys(document, ("machine", "run"), str(file))
    tables = document.get("run", [])
    if not isinstance(tables, list) or not tables:
        raise InputError(f'{file}: no [[run]]; list at least one, e.g. [[run]] file = "circle.parquet"')
    refuse_above(len(tables), MOST_RUNS, "runs", str(file), "split the campaign")
    files = [_file_of(path, table, f"{file}: run {i + 1}") for i, table in enumerate(tables)]
    named, taken = set[str](), 0.0
    for one in files:
        if one.stem in named:
            raise InputError(f"{file}: two runs are named {one.stem}; rename one of the files")
        named.add(one.stem)
        taken += table_bytes(one)
        refuse_bytes(taken, str(file), "split the campaign, or record at a lower rate")
    events = _read_events(path)
    runs = [_read_run(one, table, f"{file}: run {i + 1}", machine, events) for i, (one, table) in enumerate(zip(files, tables))]
    return Campaign(path, str(document.get("machine", "")), _without_profiles(runs))


def _without_profiles(runs: Sequence[MeasuredRun]) -> tuple[MeasuredRun, ...]:
    """The runs without recorded speed set points that no position controller gave, see `profile_speed`."""
    axes = dict.fromkeys(axis for run in runs for axis in run.trace.axes)
    gone = [(axis, SIGNAL) for axis in axes if answers_position([run.trace for run in runs], axis) is False]
    out = []
    for run in runs:
        here = [key for key in gone if run.trace.has(*key)]
        kept = {key: values for key, values in run.trace.signals.items() if key not in here}
        facts = {key: replace(run.fact(*key), profile=True) for key in here}
        out.append(replace(run, trace=replace(run.trace, signals=kept), facts={**run.facts, **facts}) if here else run)
    return tuple(out)


def _read_events(folder: Path) -> dict[str, list[BlockEvent]]:
    """Events by run; empty if the campaign has none."""
    if not os.path.lexists(folder / EVENTS):
        return {}
    path = named_file(EVENTS, folder, str(folder))
    kind, remedy = "table of events with time, channel, block, text, run", "remove it or import again"
    table = read_parquet(path, kind, remedy)
    with reading(path, kind, remedy):
        refuse_bytes(text_bytes(table) + 500.0 * table.num_rows, str(path), "remove it or import the recording in parts")
        rows = table.to_pylist()
        named = [(str(r["run"]), BlockEvent(float(r["time"]), int(r["channel"]), str(r["block"]), str(r["text"]))) for r in rows]
    out: dict[str, list[BlockEvent]] = {}
    for run, event in sorted(named, key=lambda one: one[1].time):
        out.setdefault(run, []).append(event)
    return out


def _facts(tables: object, where: str) -> dict[tuple[str, str], ChannelFact]:
    """[[run.channel]]."""
    if not isinstance(tables, list) or not all(isinstance(t, dict) for t in tables):
        raise InputError(f"{where}: channel is a list of tables; write [[run.channel]]")
    out = {}
    for table in tables:
        known_keys(table, ("axis", "signal", "sign", "made_from", *_CHANNEL_NUMBERS, *_CHANNEL_FLAGS), f"{where}: channel")
        for key in ("axis", "signal"):
            if not isinstance(table.get(key), str):
                raise InputError(f"{where}: channel: '{key}' is missing; name the {key} in quotes")
        for key in _CHANNEL_NUMBERS:
            if not is_number(table.get(key, 0.0)):
                raise InputError(f"{where}: channel: {key} = {table[key]!r}: expected a number")
        for key in _CHANNEL_FLAGS:
            if not isinstance(table.get(key, False), bool):
                raise InputError(f"{where}: channel: {key} = {table[key]!r}; use true or false")
        if table.get("made_from", "") not in ("", *MADE_FROM):
            raise InputError(f"{where}: channel: made_from = {table['made_from']!r}; use one of {', '.join(MADE_FROM)}")
        if table.get("sign", 1) not in (1, -1):
            raise InputError(f"{where}: channel: sign = {table['sign']!r}; use 1 or -1")
        latency, deviation, back, metres, radians = (float(table.get(key, 0.0)) for key in _CHANNEL_NUMBERS)
        flags = {key: table.get(key, False) for key in _CHANNEL_FLAGS}
        out[table["axis"], table["signal"]] = ChannelFact(
            latency, deviation, back, metres or radians, sign=table.get("sign", 1), made_from=table.get("made_from", ""), **flags
        )
    return out


def _labels(table: object, where: str) -> dict[str, float]:
    """[run.labels]."""
    if not isinstance(table, dict) or not all(is_number(value) for value in table.values()):
        raise InputError(f"{where}: labels is a table of numbers; write [run.labels] and load = 20.0 below it")
    return {name: float(value) for name, value in table.items()}


def _file_of(folder: Path, table: object, where: str) -> Path:
    """The trace that [[run]] names."""
    if not isinstance(table, dict):
        raise InputError(f'{where}: {table!r} is not a run; write each as [[run]] with file = "circle.parquet"')
    known_keys(table, _RUN_KEYS, where)
    if not isinstance(table.get("file"), str):
        raise InputError(f"{where}: 'file' is missing; name the trace of this run")
    return named_file(table["file"], folder, f"{where}: file")


def _read_run(file: Path, table: dict, where: str, machine: Machine | None, events: Mapping[str, list[BlockEvent]]) -> MeasuredRun:
    feedforward = table.get("feedforward")
    if feedforward is not None and feedforward not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward '{feedforward}'; use one of {', '.join(FEEDFORWARD)}")
    started_at = table.get("started_at_s", 0.0)
    if not is_number(started_at):
        raise InputError(f"{where}: started_at_s = {started_at!r}: expected a number of seconds")
    trace = read_trace(file, axes=machine.kinds if machine else None, need=("setpoint",))
    name = Path(table["file"]).stem
    facts, labels = _facts(table.get("channel", []), where), _labels(table.get("labels", {}), where)
    ballbar = _ballbar(table["ballbar"], trace, f"{where}: ballbar") if "ballbar" in table else None
    centred = frozenset(axis for (axis, signal), fact in facts.items() if signal == "position" and fact.offset_taken_out)
    return MeasuredRun(name, trace, feedforward, float(started_at), facts, labels, tuple(events.get(name, ())), centred, ballbar)


def _ballbar(table: object, trace: Trace, where: str) -> Ballbar:
    """[run.ballbar]."""
    if not isinstance(table, dict):
        raise InputError(f'{where}: {table!r} is not a table; write [run.ballbar] and axes = ["X", "Y"] below it')
    known_keys(table, ("axes", "noise_m"), where)
    axes = listed(table, "axes", where)
    if len(axes) != 2 or axes[0] == axes[1] or any(axis not in trace.axes for axis in axes):
        raise InputError(f"{where}: axes = {axes!r}; name two axes of the trace ({', '.join(trace.axes)})")
    ballbar = ballbar_of(trace, axes, positive(table, "noise_m", where))
    if not ballbar.measured.any():
        raise InputError(f"{where}: the set points of {' and '.join(axes)} form no circle with 90 degrees of overlap at each end")
    return ballbar
