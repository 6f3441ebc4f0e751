"""The map (TOML): the axis, signal and unit of each recorded column, and the runs in the files.

A map may be partial: without columns, or without a set point and a motion of an axis, `twin import` completes it.

machine = "my_machine.toml"        # machine file beside the map, or a name for campaign.toml (default: the machine that ships with twin)
feedforward = "velocity"           # feedforward in use: off | velocity | velocity+torque; a run may give its own
period_ms = 1.0                    # period of the traces; default: that of the set points
gaps = "split"                     # lost samples: split the run (default) | fill | refuse
skew = "report"                    # late channels: report (default) | correct | encoders (correct encoders only)
offsets = "report"                 # constant difference between two encoders: report (default) | correct
labels = ["load", "trial"]         # columns that are constant within a run and describe it; they go into campaign.toml
units = "refuse"                   # implausible units: refuse (default) | report

[time]                             # for formats without times of their own; default: found by name
column = "Time"                    # or interval_ms = 0.25
unit = "ms"

[csv]                              # only for what is not detected
delimiter = ";"
decimal = ","
header_line = 3
units_row = true
encoding = "latin-1"
columns = ["time [ms]", "position"]   # names of all columns where the file gives none or wrong ones; "-" where unused

[[column]]
name = "Lagesollwert X"            # as in the file
axis = "X"
signal = "setpoint"                # setpoint, position, motor_position, velocity, velocity_setpoint, velocity_feedforward, acceleration,
                                   # current, torque, torque_setpoint, torque_feedforward, voltage, following_error, disturbance, injected_command
unit = "mm"                        # default: the unit in the file
scale = 1.0                        # value = sign * scale * recorded + offset, in that unit
sign = 1
offset = 0.0
skew_ms = 0.0                      # lateness of this column relative to the position; it is removed
mm_per_rev = 10.0                  # travel per motor revolution (deg_per_rev), for rev, rev/min, and N as torque
sign_bit = 15                      # whole numbers whose sign is a bit of the word: 33118 is -350
optional = false                   # true: some files lack it, or name it differently

[[run]]                            # default: each file is a run named after it
file = "reversal.csv"              # or files = ["control.xml", "scope.tdms"], recorded together
name = "reversal"
feedforward = "off"
started_at_s = 0.0
from_s = 0.5                       # part of the recording
to_s = 20.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
import re
from typing import Any

from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import FEEDFORWARD, Machine, default_machine_path, load_machine
from twin.recordings.signals import Clock, known_unit, split_heading
from twin.recordings.trace import BY_UNIT, SIGNALS, UNIT_SIGNALS
from twin.tables import is_number, known_keys
from twin.units import RECORDED_UNITS

FOLLOWING_ERROR = "following_error"
MAPPED = (*(s for s in SIGNALS if s not in UNIT_SIGNALS), FOLLOWING_ERROR, *BY_UNIT)
_TOP = ("machine", "feedforward", "period_ms", "gaps", "skew", "offsets", "labels", "units", "time", "csv", "column", "run")
_TIME = ("column", "unit", "interval_ms")
_COLUMN = ("name", "axis", "signal", "unit", "scale", "sign", "offset", "skew_ms", "mm_per_rev", "deg_per_rev", "sign_bit", "optional")
_RUN = ("file", "files", "name", "feedforward", "started_at_s", "from_s", "to_s")
_CHOICES = {
    "gaps": ("split", "fill", "refuse"),
    "skew": ("report", "correct", "encoders"),
    "offsets": ("report", "correct"),
    "units": ("refuse", "report"),
}


@dataclass(frozen=True)
class ColumnMap:
    """One column: value [unit] = factor * recorded + offset. `scaled`: the map gives the factor."""

    name: str
    axis: str
    signal: str
    unit: str
    factor: float
    offset: float
    scaled: bool
    skew_s: float
    per_turn: float | None  # m or rad per motor revolution
    kind: str | None
    optional: bool
    sign_bit: int | None = None

    @property
    def key(self) -> tuple[str, str]:
        return self.axis, self.signal


@dataclass(frozen=True)
class RunMap:
    """One run: its files by name, and its settings."""

    name: str
    files: tuple[str, ...]
    feedforward: str | None
    started_at_s: float | None
    from_s: float
    to_s: float


@dataclass(frozen=True)
class Map:
    """A checked map. `machine` is None if only its name is known."""

    path: Path
    machine: Machine | None
    machine_name: str
    feedforward: str | None
    period_s: float | None
    gaps: str
    skew: str
    offsets: str
    labels: tuple[str, ...]
    units: str
    clock: Clock
    dialect: Mapping[str, Any]
    columns: tuple[ColumnMap, ...]
    runs: tuple[RunMap, ...]

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
    document = read_toml(path)
    where = str(path)
    known_keys(document, _TOP, where)
    for key, choices in _CHOICES.items():
        if document.get(key) == "say":  # the word of older maps
            document[key] = "report"
        if document.get(key, choices[0]) not in choices:
            raise InputError(f"{where}: {key} = {document[key]!r}; use one of {', '.join(choices)}")
    time = _table(document, "time", where)
    known_keys(time, _TIME, f"{where}: [time]")
    if "column" in time and "interval_ms" in time:
        raise InputError(f"{where}: [time] gives a column and an interval_ms; give one of them")
    interval = _number(time, "interval_ms", None, f"{where}: [time]", above_zero=True)
    period = _number(document, "period_ms", None, where, above_zero=True)
    machine, name = _machine(document, path, machine_path)
    columns = tuple(_column(table, f"{where}: column {i + 1}", machine) for i, table in enumerate(_tables(document, "column", where)))
    keys = [c.key for c in columns]
    if twice := next((c.key for c in columns if keys.count(c.key) > 1 and not c.optional), None):
        raise InputError(
            f"{where}: two columns are {'.'.join(twice)}; leave one out, or give both optional = true if files name it differently"
        )
    return Map(
        path, machine, name, _feedforward(document, where), None if period is None else period * 1e-3,
        document.get("gaps", "split"), document.get("skew", "report"), document.get("offsets", "report"), _labels(document, where), document.get("units", "refuse"),
        Clock(_text(time, "column", f"{where}: [time]"), _text(time, "unit", f"{where}: [time]"), None if interval is None else interval * 1e-3),
        _table(document, "csv", where), columns,
        tuple(_run(table, f"{where}: run {i + 1}") for i, table in enumerate(_tables(document, "run", where))),
    )  # fmt: skip


def runs_of(mapping: Map, files: Sequence[Path]) -> list[tuple[RunMap, tuple[Path, ...]]]:
    """The runs with their files: those of the map, or one per file."""
    by_name: dict[str, Path] = {}
    for file in files:
        if file.name in by_name:
            raise InputError(f"{file}: two files are named {file.name}; rename one")
        by_name[file.name] = file
    runs = mapping.runs or [RunMap(run_name(f.stem), (f.name,), None, None, -math.inf, math.inf) for f in files]
    out = []
    for i, run in enumerate(runs):
        for name in run.files:
            if name not in by_name:
                raise InputError(f"{mapping.path}: run {i + 1}: file '{name}' is not among the FILES; {nearest(name, by_name)}")
        out.append((replace(run, feedforward=run.feedforward or mapping.feedforward), tuple(by_name[n] for n in run.files)))
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


def _machine(document: Mapping[str, Any], path: Path, machine_file: str | None) -> tuple[Machine | None, str]:
    """The machine file of --machine or the map; if the map gives only a name, the name."""
    given = _text(document, "machine", str(path))
    if machine_file:
        return load_machine(machine_file), Path(machine_file).stem
    if given is None:
        return None, ""
    if given.endswith(".toml"):
        return load_machine(path.parent / given), Path(given).stem
    return (load_machine(), given) if given == default_machine_path().stem else (None, given)


def _column(table: Mapping[str, Any], where: str, machine: Machine | None) -> ColumnMap:
    known_keys(table, _COLUMN, where)
    name, axis, signal = (_text(table, key, where, needed=True) or "" for key in ("name", "axis", "signal"))
    where = f"{where} ('{name}')"
    if signal not in MAPPED:
        raise InputError(f"{where}: unknown signal '{signal}'; {nearest(signal, MAPPED)}")
    if not re.fullmatch(r"[^\s.\[\]]+", axis):
        raise InputError(f"{where}: axis = '{axis}': a name without spaces, dots and brackets, like X")
    if machine is not None and axis not in machine.axis_names:
        raise InputError(f"{where}: machine {machine.name} has no axis {axis}; {nearest(axis, machine.axis_names)}")
    unit = ""
    if (text := _text(table, "unit", where)) is not None:
        unit = known_unit(text)
        if not unit:
            raise InputError(f"{where}: unknown unit [{text}]; {nearest(text, RECORDED_UNITS)}")
    sign = table.get("sign", 1)
    if isinstance(sign, bool) or sign not in (1, -1):
        raise InputError(f"{where}: sign = {sign!r}; use 1 or -1")
    scale = _number(table, "scale", 1.0, where)
    if scale == 0.0:
        raise InputError(f"{where}: scale = 0 makes a signal of zeros; correct it")
    per_turn, kind = None, machine.axis(axis).kind if machine else None
    for key, implied, factor in (("mm_per_rev", "linear", 1e-3), ("deg_per_rev", "rotary", math.pi / 180.0)):
        if key in table:
            if per_turn is not None or (kind or implied) != implied:
                raise InputError(f"{where}: {key} does not go with a {kind} axis; use {'deg' if implied == 'linear' else 'mm'}_per_rev")
            per_turn, kind = (_number(table, key, None, where, above_zero=True) or 0.0) * factor, implied
    if per_turn is None and machine is not None and machine.axis(axis).drive != "direct":
        per_turn = machine.axis(axis).ratio * 2.0 * math.pi  # a direct drive has no revolutions
    bit = table.get("sign_bit")
    if bit is not None and (isinstance(bit, bool) or not isinstance(bit, int) or not 0 < bit < 64):
        raise InputError(f"{where}: sign_bit = {bit!r}; give the number of the bit, 15 for a word of 16 bits")
    optional = table.get("optional", False)
    if not isinstance(optional, bool):
        raise InputError(f"{where}: optional = {optional!r}; use true or false")
    return ColumnMap(
        split_heading(name)[0], axis, signal, unit, float(sign) * float(scale or 1.0), _number(table, "offset", 0.0, where) or 0.0, "scale" in table,
        (_number(table, "skew_ms", 0.0, where) or 0.0) * 1e-3, per_turn, kind, optional, bit,
    )  # fmt: skip


def _run(table: Mapping[str, Any], where: str) -> RunMap:
    known_keys(table, _RUN, where)
    files = table.get("files", [table["file"]] if "file" in table else [])
    if not isinstance(files, list) or not files or not all(isinstance(f, str) for f in files):
        raise InputError(f"{where}: 'file' is missing; name one of the FILES (or files = [...] that were recorded together)")
    names = tuple(Path(f).name for f in files)
    name = _text(table, "name", where) or run_name(Path(names[0]).stem)
    if run_name(name) != name:
        raise InputError(
            f"{where}: name = '{name}' cannot be a file name; use letters, digits, dash and underscore, like '{run_name(name)}'"
        )
    begin, end = _number(table, "from_s", -math.inf, where), _number(table, "to_s", math.inf, where)
    assert begin is not None
    assert end is not None
    if not begin < end:
        raise InputError(f"{where}: from_s = {begin:g} is not before to_s = {end:g}; correct them")
    return RunMap(name, names, _feedforward(table, where), _number(table, "started_at_s", None, where), begin, end)


def _table(document: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: {key} is a table; write [{key}]")
    return table


def _tables(document: Mapping[str, Any], key: str, where: str) -> list[Any]:
    tables = document.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(t, Mapping) for t in tables):
        raise InputError(f"{where}: {key} is a list of tables; write [[{key}]]")
    return tables


def _text(table: Mapping[str, Any], key: str, where: str, needed: bool = False) -> str | None:
    value = table.get(key)
    if value is None and needed:
        raise InputError(f"{where}: '{key}' is missing; give it as text")
    if value is not None and (not isinstance(value, str) or not value.strip()):
        raise InputError(f"{where}: {key} = {value!r}; give it as text")
    return value.strip() if value is not None else None


def _number(table: Mapping[str, Any], key: str, default: float | None, where: str, above_zero: bool = False) -> float | None:
    value = table.get(key, default)
    if value is None or (key not in table):
        return value
    if not is_number(value) or (above_zero and value <= 0.0):
        raise InputError(f"{where}: {key} = {value!r}; give a {'number above 0' if above_zero else 'number'}")
    return float(value)


def _labels(document: Mapping[str, Any], where: str) -> tuple[str, ...]:
    value = document.get("labels", [])
    if not isinstance(value, list) or not all(isinstance(one, str) and one.strip() for one in value):
        raise InputError(f'{where}: labels = {value!r}; give the names of columns, like ["load"]')
    return tuple(dict.fromkeys(value))


def _feedforward(table: Mapping[str, Any], where: str) -> str | None:
    value = _text(table, "feedforward", where)
    if value is not None and value not in FEEDFORWARD:
        raise InputError(f"{where}: feedforward = '{value}'; use one of {', '.join(FEEDFORWARD)}")
    return value
