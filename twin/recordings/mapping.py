"""The map (TOML): the axis, signal and unit of each recorded column, and the runs in the files. docs/import_map.md has every key with its default.

A map may be partial: without columns, or without a set point and a motion of an axis, `twin import` completes it.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import Annotated, Any, Literal

from msgspec import field
from msgspec.structs import replace

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import Feedforward, Machine, default_machine_path, load_machine
from twin.recordings.signals import Clock, known_unit, split_heading
from twin.recordings.trace import BY_UNIT, ENCODERS, SIGNALS, UNIT_SIGNALS, measured_position_in
from twin.tables import Number, Positive, Table, Text, asks, typed
from twin.units import RECORDED_UNITS

FOLLOWING_ERROR, PROFILE_SPEED = "following_error", "velocity_feedforward"
_MEASURED = "the recorded motion is the path: no gain, delay or following error of the position loop can be shown"
PATH_FROM = {
    FOLLOWING_ERROR: "position plus following error gives it back",
    **dict.fromkeys(ENCODERS, _MEASURED),
    PROFILE_SPEED: "the speed of the profile is summed up to it, and the position is it less the following error",
    "velocity": "the speed is summed up to the path: friction and inertia can be shown, nothing of the position loop",
}
"""How the path of an axis without a recorded set point is found, and what that cannot show."""


def path_source(signals: Collection[str]) -> str:
    """What the path of an axis with these signals is made from, a key of PATH_FROM; its set point is not recorded."""
    if measured := measured_position_in(signals):
        return FOLLOWING_ERROR if FOLLOWING_ERROR in signals else measured
    return PROFILE_SPEED if FOLLOWING_ERROR in signals and PROFILE_SPEED in signals else "velocity"


MAPPED = (*(s for s in SIGNALS if s not in UNIT_SIGNALS), FOLLOWING_ERROR, *BY_UNIT)


class _Time(Table, frozen=True):
    column: Text | None = None
    unit: Text | None = None
    interval_ms: Positive | None = None


class ColumnMap(Table, frozen=True):
    """One column: value [unit] = sign * scale * recorded + offset."""

    name: Text
    axis: Annotated[str, asks("give a name without spaces, dots and brackets, like X", pattern=r"^[^\s.\[\]]+$")]
    signal: Literal[MAPPED]  # type: ignore[valid-type]
    unit: Text | None = None
    unit_assumed: bool = False
    scale: Number | None = None
    sign: Literal[1, -1] = 1
    offset: Number = 0.0
    skew_ms: Number = 0.0
    mm_per_rev: Positive | None = None
    deg_per_rev: Positive | None = None
    sign_bit: Annotated[int, asks("give the number of the bit, 15 for a word of 16 bits", gt=0, lt=64)] | None = None
    optional: bool = False

    @property
    def key(self) -> tuple[str, str]:
        return self.axis, self.signal

    @property
    def factor(self) -> float:
        """Sign and scale."""
        return self.sign * (1.0 if self.scale is None else self.scale)

    def drive(self, machine: Machine | None) -> tuple[float | None, str | None]:
        """Travel of a motor turn [m or rad] and kind of its axis, from the column or the machine; None if unknown."""
        if self.mm_per_rev:
            return self.mm_per_rev * 1e-3, "linear"
        if self.deg_per_rev:
            return math.radians(self.deg_per_rev), "rotary"
        if machine is None:
            return None, None
        axis = machine.axis(self.axis)
        return None if axis.drive == "direct" else axis.ratio * 2.0 * math.pi, axis.kind  # a direct drive has no revolutions


class RunMap(Table, frozen=True):
    """One run: its files by name, and its settings."""

    file: str | None = None
    files: tuple[str, ...] = ()
    name: Text = ""
    feedforward: Feedforward | None = None
    started_at_s: Number | None = None
    from_s: Number = -math.inf
    to_s: Number = math.inf


class Settings(Table, frozen=True):
    """The whole map as it stands in the file."""

    machine: Text = ""
    feedforward: Feedforward | None = None
    period_ms: Positive | None = None
    gaps: Literal["split", "fill", "refuse"] = "split"
    skew: Literal["report", "correct", "encoders"] = "report"
    offsets: Literal["report", "correct"] = "report"
    labels: Annotated[tuple[Text, ...], asks('give the names of columns, like ["load"]')] = ()
    units: Literal["refuse", "report"] = "refuse"
    time: _Time = _Time()
    csv: dict[str, Any] = field(default_factory=dict)  # its keys are checked with the file
    column: tuple[ColumnMap, ...] = ()
    run: tuple[RunMap, ...] = ()


@dataclass(frozen=True)
class Map:
    """A checked map. `machine` is None if only its name is known."""

    path: Path
    machine: Machine | None
    machine_name: str
    settings: Settings
    columns: tuple[ColumnMap, ...]
    runs: tuple[RunMap, ...]
    clock: Clock
    dialect: Mapping[str, Any]

    @property
    def period_s(self) -> float | None:
        """Period of the traces; None: that of the set points."""
        return None if self.settings.period_ms is None else self.settings.period_ms * 1e-3

    @property
    def partial(self) -> bool:
        """True without columns, or without a set point or a measured motion of an axis."""
        own: dict[str, set[str]] = {}
        for column in self.columns:
            own.setdefault(column.axis, set()).add(column.signal)
        return not own or any("setpoint" not in signals or not signals & MOTIONS for signals in own.values())


MOTIONS = frozenset(("position", "motor_position", FOLLOWING_ERROR, "velocity"))
"""Signals that show how an axis moves."""


def read_map(path: str | Path, machine_path: str | None = None) -> Map:
    """Read and check a map. Raises InputError that names the table, the key and the remedy."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such map; 'twin import FILES --out CAMPAIGN' without --map writes one to start from")
    raw, where = read_toml(path), str(path)
    # older maps have the word "say"
    settings = typed({key: "report" if value == "say" else value for key, value in raw.items()}, Settings, where)
    time = settings.time
    if time.column and time.interval_ms:
        raise InputError(f"{where}: [time] gives a column and an interval_ms; give one of them")
    machine, name = _machine(settings.machine, path, machine_path)
    columns = tuple(_column(column, f"{where}: column {i + 1} ('{column.name}')", machine) for i, column in enumerate(settings.column))
    keys = [c.key for c in columns]
    if twice := next((c.key for c in columns if keys.count(c.key) > 1 and not c.optional), None):
        remedy = "leave one out, or give both optional = true if files name it differently"
        raise InputError(f"{where}: two columns are {'.'.join(twice)}; {remedy}")
    runs = tuple(_run(run, f"{where}: run {i + 1}") for i, run in enumerate(settings.run))
    clock = Clock(time.column, time.unit, None if time.interval_ms is None else time.interval_ms * 1e-3)
    return Map(path, machine, name, settings, columns, runs, clock, settings.csv)


def runs_of(mapping: Map, files: Sequence[Path]) -> list[tuple[RunMap, tuple[Path, ...]]]:
    """The runs with their files: those of the map, or one per file."""
    by_name: dict[str, Path] = {}
    for file in files:
        if file.name in by_name:
            raise InputError(f"{file}: two files are named {file.name}; rename one")
        by_name[file.name] = file
    runs = mapping.runs or [RunMap(name=run_name(f.stem), files=(f.name,)) for f in files]
    out = []
    for i, run in enumerate(runs):
        for name in run.files:
            if name not in by_name:
                raise InputError(f"{mapping.path}: run {i + 1}: file '{name}' is not among the FILES; {nearest(name, by_name)}")
        out.append((replace(run, feedforward=run.feedforward or mapping.settings.feedforward), tuple(by_name[n] for n in run.files)))
    names = [run.name for run, _ in out]
    if (twice := next((n for n in names if names.count(n) > 1), None)) is not None:
        of = " and ".join(f"'{', '.join(run.files)}'" for run, _ in out if run.name == twice)
        raise InputError(f"{mapping.path}: two runs are named '{twice}', those of {of}; give each its own name with [[run]] in the map")
    left = set(by_name) - {n for run in runs for n in run.files}
    if left:
        raise InputError(f"{mapping.path}: no [[run]] uses {', '.join(sorted(left))}; add one, or leave the file out of FILES")
    return out


def run_name(stem: str) -> str:
    """Name of a run from a file name: letters, digits, dash, underscore."""
    return re.sub(r"[^\w\-]+", "_", stem).strip("_") or "run"


def _machine(given: str, path: Path, machine_file: str | None) -> tuple[Machine | None, str]:
    """The machine file of --machine or the map; if the map gives only a name, the name."""
    if machine_file:
        return load_machine(machine_file), Path(machine_file).stem
    if given.lower().endswith(".toml"):
        return load_machine(path.parent / given), Path(given).stem
    return load_machine() if given == default_machine_path().stem else None, given


def _column(column: ColumnMap, where: str, machine: Machine | None) -> ColumnMap:
    """The column with its unit in the twin's spelling, checked against the machine."""
    if machine is not None and column.axis not in machine.axis_names:
        raise InputError(f"{where}: machine {machine.name} has no axis {column.axis}; {nearest(column.axis, machine.axis_names)}")
    unit = known_unit(column.unit) if column.unit else None
    if column.unit and not unit:
        raise InputError(f"{where}: unknown unit [{column.unit}]; {nearest(column.unit, RECORDED_UNITS)}")
    if column.scale == 0.0:
        raise InputError(f"{where}: scale = 0 makes a signal of zeros; correct it")
    kind = column.drive(machine)[1]
    if (column.mm_per_rev and column.deg_per_rev) or (machine is not None and kind != machine.axis(column.axis).kind):
        raise InputError(f"{where}: give mm_per_rev for a linear axis, deg_per_rev for a rotary one, not the other")
    return replace(column, name=split_heading(column.name.strip())[0], unit=unit)


def _run(run: RunMap, where: str) -> RunMap:
    """The run with names of its files and of its own."""
    files = run.files or ((run.file,) if run.file else ())
    if not files:
        raise InputError(f"{where}: 'file' is missing; name one of the FILES (or files = [...] that were recorded together)")
    names = tuple(Path(f).name for f in files)
    name = run.name or run_name(Path(names[0]).stem)
    if run_name(name) != name:
        remedy = f"use letters, digits, dash and underscore, like '{run_name(name)}'"
        raise InputError(f"{where}: name = '{name}' cannot be a file name; {remedy}")
    if not run.from_s < run.to_s:
        raise InputError(f"{where}: from_s = {run.from_s:g} is not before to_s = {run.to_s:g}; correct them")
    return replace(run, name=name, files=names)
