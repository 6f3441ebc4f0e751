"""Campaigns: folders of measured runs with a `campaign.toml` that describes each run.

    machine = "my_machine"
    recorded = 2026-05-03              # day of the recording, for a history; optional
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
    offset_m = 1.2e-4                  # constant difference to the other encoder (offset_rad on a rotary axis)
    offset_taken_out = true            # the offset was removed from the trace
    sign = -1                          # the sign was reversed at the import
    against = true                     # pushes against the motion; the sign was kept
    unsigned = true                    # only the magnitude of a force is recorded
    made_from = "position"             # not recorded: a set point that is the recorded motion (position, motor_position, velocity), or that
                                       # motion plus the following_error; a motor_position that is the sum of the velocity
    stated_unit = "%"                  # the file states this unit, which is none, and the map gives no scale; "?": its unit is assumed
    [run.labels]                       # columns that are constant within the run: load, trial
    load = 20.0
    [run.ballbar]                      # positions come from a ballbar between two axes, see `twin.recordings.ballbar`
    axes = ["X", "Y"]
    noise_m = 1e-7                     # standard deviation of a radius

Program block events are in `events.parquet` beside the traces: time [s] in the trace of `run`, channel, block, text, run.
"""

from collections.abc import Mapping, Sequence
import dataclasses
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import field
import numpy as np

from twin.documents import named_file, read_toml
from twin.errors import InputError
from twin.limits import refuse_above, refuse_bytes
from twin.machine.machine import Feedforward, Machine
from twin.recordings.ballbar import Ballbar, ballbar_of
from twin.recordings.profile_speed import SIGNAL, answers_position
from twin.recordings.relations import force_sign
from twin.recordings.table_file import table_bytes
from twin.recordings.trace import ENCODERS, Trace, read_trace
from twin.system import shell_word
from twin.tables import Number, Positive, Table, asks, typed

EVENTS = "events.parquet"
MOST_RUNS = 20_000
"""Runs of one campaign."""
UNSTATED = "?"
"""Stated unit of a channel whose unit is an assumption of the import."""
BEGINNING = 64
"""Samples in which most runs differ before they are compared as a whole."""
COPY = "equals run {original} sample for sample: a copy is no second measurement and is left out"


def is_campaign(inputs: Sequence[Path]) -> bool:
    """True if the input is one folder with a campaign.toml."""
    return len(inputs) == 1 and (inputs[0] / "campaign.toml").is_file()


class ChannelFact(Table, frozen=True, omit_defaults=True):
    """Findings of the import about one channel of a run; see the head of this module."""

    axis: Annotated[str, asks("name the axis in quotes")]
    signal: Annotated[str, asks("name the signal in quotes")]
    latency: Number = field(default=0.0, name="latency_s")
    latency_deviation: Number = field(default=0.0, name="latency_deviation_s")
    taken_back: Number = field(default=0.0, name="taken_back_s")
    offset_m: Number = 0.0
    offset_rad: Number = 0.0
    offset_taken_out: bool = False
    sign: Literal[1, -1] = 1
    against: bool = False
    unsigned: bool = False
    stated_unit: str = ""
    made_from: Literal["", "following_error", "velocity_feedforward", "position", "motor_position", "velocity"] = ""

    @property
    def offset(self) -> float:
        """Constant difference to the other encoder [m or rad]."""
        return self.offset_m or self.offset_rad


class _Ballbar(Table, frozen=True):
    axes: Annotated[tuple[str, str], asks("name two axes of the trace")]
    noise_m: Positive


class _Run(Table, frozen=True):
    file: Annotated[str, asks("name the trace of this run")]
    feedforward: Feedforward | None = None
    started_at_s: Annotated[Number, asks("give a number of seconds")] = 0.0
    channel: tuple[ChannelFact, ...] = ()
    labels: Annotated[dict[str, Number], asks("give a table of numbers: [run.labels] and load = 20.0 below it")] = field(
        default_factory=dict
    )
    ballbar: _Ballbar | None = None


class CampaignFile(Table, frozen=True):
    run: Annotated[tuple[_Run, ...], asks('list at least one, e.g. [[run]] file = "circle.parquet"', min_length=1)]
    machine: str = ""
    recorded: Any = None  # a day; `twin.history.dated` reads it


@dataclass(frozen=True)
class MeasuredRun:
    """One run of a campaign: name (file name without ending), trace, feedforward in use, start time [s].

    facts      findings of the import, by (axis, signal)
    labels     values of label columns
    own_zeros  axes whose encoders have no common zero, such as those with an offset taken out; comparisons remove the mean of their difference
    ballbar    the instrument that measured the positions instead of scales
    profiles   axes whose recorded speed set point does not answer the position; it is not in the trace
    """

    name: str
    trace: Trace
    feedforward: str | None
    started_at: float
    facts: Mapping[tuple[str, str], ChannelFact] = dataclasses.field(default_factory=dict)
    labels: Mapping[str, float] = dataclasses.field(default_factory=dict)
    own_zeros: frozenset[str] = frozenset()
    ballbar: Ballbar | None = None
    profiles: frozenset[str] = frozenset()

    def fact(self, axis: str, signal: str) -> ChannelFact:
        """Findings about a channel; defaults if there are none."""
        return self.facts.get((axis, signal), ChannelFact(axis=axis, signal=signal))

    def path_is_motion(self, axis: str) -> bool:
        """True if the set point is not recorded, but made from the recorded motion."""
        return self.fact(axis, "setpoint").made_from in (*ENCODERS, "velocity")

    def is_unsigned(self, axis: str, signal: str) -> bool:
        """True if only the magnitude of a force is recorded: the import noted it, or the motion shows it."""
        noted, where = self.fact(axis, signal).unsigned, self.trace.measured_position(axis)
        if noted or not where or not self.trace.has(axis, signal):
            return noted
        force, position = self.trace.get(axis, signal), self.trace.get(axis, where)
        return force_sign(force, position, self.trace.period, self.trace.kinds[axis]).unsigned


def any_unsigned(runs: Sequence[MeasuredRun], axis: str, signal: str) -> bool:
    """True if a run shows that only the magnitude of a force is recorded, and no run that it has both signs: a short one may hold one by chance."""
    values = [run.trace.get(axis, signal) for run in runs if run.trace.has(axis, signal)]
    one_sign = all(v.min() >= 0.0 for v in values) or all(v.max() <= 0.0 for v in values)
    return one_sign and any(run.is_unsigned(axis, signal) for run in runs)


def without_scale(runs: Sequence[MeasuredRun], axis: str, signals: Sequence[str]) -> dict[str, str]:
    """Signal -> unit as the file states it, of those whose scale nobody gave."""
    return {s: unit for run in runs for s in signals if (unit := run.fact(axis, s).stated_unit)}


@dataclass(frozen=True)
class Campaign:
    """Runs in the order of the file, and the machine named in `campaign.toml`."""

    path: Path
    machine_name: str
    runs: tuple[MeasuredRun, ...]


def read_campaign(path: str | Path, machine: Machine | None = None) -> Campaign:
    """Read `campaign.toml` and its traces, checked against the axes of the machine (None: unknown machine)."""
    path = Path(path)
    if path.is_file():
        raise InputError(f"{path}: a file, but a campaign is a folder; make one of it with: twin import {shell_word(path)} --out CAMPAIGN")
    if not path.is_dir():
        raise InputError(f"{path}: no such folder; a campaign is a folder with campaign.toml and traces")
    file = path / "campaign.toml"
    if not file.is_file():
        raise InputError(f'{file}: no such file; list the runs there, e.g. [[run]] file = "circle.parquet"')
    document = typed(read_toml(file), CampaignFile, str(file))
    refuse_above(len(document.run), MOST_RUNS, "runs", str(file), "split the campaign")
    files = [named_file(run.file, path, f"{file}: run {i + 1}: file") for i, run in enumerate(document.run)]
    named, taken = set[str](), 0.0
    for one in files:
        if one.stem in named:
            raise InputError(f"{file}: two runs are named {one.stem}; rename one of the files")
        named.add(one.stem)
        taken += table_bytes(one)
        refuse_bytes(taken, str(file), "split the campaign, or record at a lower rate")
    runs = [_read_run(one, run, f"{file}: run {i + 1}", machine) for i, (one, run) in enumerate(zip(files, document.run))]
    return Campaign(path, document.machine, _without_profiles(runs))


def without_copies(campaign: Campaign) -> tuple[Campaign, dict[str, str]]:
    """The campaign without runs that repeat another one sample for sample, and these: run -> the run that it copies.

    A machine does not repeat its noise. A copy is no second measurement: a fit that is tested on a copy of its own data passes every test. A run
    that equals only the beginning of another run is a copy, too.
    """
    originals: dict[tuple[bytes, ...], list[MeasuredRun]] = {}
    copies: dict[str, str] = {}
    for run in sorted(campaign.runs, key=lambda r: -len(r.trace.time)):  # stable: the first of equally long ones is the original
        signals, n = run.trace.signals, len(run.trace.time)
        similar = originals.setdefault(tuple(f"{key}".encode() + values[:BEGINNING].tobytes() for key, values in signals.items()), [])
        same = (other for other in similar if all(np.array_equal(other.trace.signals[key][:n], signals[key]) for key in signals))
        if (original := next(same, None)) is not None:
            copies[run.name] = original.name
        else:
            similar.append(run)
    return replace(campaign, runs=tuple(run for run in campaign.runs if run.name not in copies)), copies


def _without_profiles(runs: Sequence[MeasuredRun]) -> tuple[MeasuredRun, ...]:
    """The runs without recorded speed set points that no position controller gave, see `profile_speed`.

    A control records the same for all of its axes. An axis that alone does not answer its position has another fault, such as a dead band.
    Where no axis shows that it answers, because too little motion is recorded, none is taken as a controller's output.
    """
    moved = dict.fromkeys(axis for run in runs for axis in run.trace.axes if run.trace.has(axis, SIGNAL) and run.trace.moves(axis))
    answers = {axis: answers_position([run.trace for run in runs], axis) for axis in moved}
    said = [*answers.values()]
    gone = [(axis, SIGNAL) for axis, answer in answers.items() if not answer and said.count(False) >= said.count(True)]
    out = []
    for run in runs:
        here = [key for key in gone if run.trace.has(*key)]
        kept = {key: values for key, values in run.trace.signals.items() if key not in here}
        # beside a set point that is the recorded motion nothing shows what a speed set point is
        of_profile = frozenset(axis for axis, _ in here if not run.path_is_motion(axis))
        out.append(replace(run, trace=replace(run.trace, signals=kept), profiles=of_profile) if here else run)
    return tuple(out)


def _read_run(file: Path, run: _Run, where: str, machine: Machine | None) -> MeasuredRun:
    trace = read_trace(file, axes=machine.kinds if machine else None, need=("setpoint",))
    name = Path(run.file).stem
    facts = {(fact.axis, fact.signal): fact for fact in run.channel}
    own_zeros = frozenset(fact.axis for fact in run.channel if fact.offset_taken_out)
    ballbar = None
    if (table := run.ballbar) is not None:
        where = f"{where}: [ballbar]"
        if table.axes[0] == table.axes[1] or any(axis not in trace.axes for axis in table.axes):
            raise InputError(f"{where}: axes = {list(table.axes)}; name two axes of the trace ({', '.join(trace.axes)})")
        ballbar = ballbar_of(trace, table.axes, table.noise_m)
        if not ballbar.measured.any():
            raise InputError(f"{where}: the set points of {' and '.join(table.axes)} form no circle with 90 degrees of overlap at each end")
    return MeasuredRun(name, trace, run.feedforward, run.started_at_s, facts, run.labels, own_zeros, ballbar)
