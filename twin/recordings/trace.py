"""Traces: time series of axis signals in SI, read from and written to Parquet and CSV.

The first column of a file is `time [s]`, then `<axis>.<signal> [<unit>]`; the heading gives the unit. Signals without an axis
(block number, path feed) belong to the pseudo axis `program`.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import dataclass, field, replace
import html
import itertools
from pathlib import Path
import re
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.errors import InputError, nearest
from twin.files import beside
from twin.recordings.table_file import read_table
from twin.system import shell_word
from twin.units import AXIS_UNITS, UNITS, dimension_recorded, factor_to_si, in_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pyarrow as pa

TRACE_ENDINGS = (".parquet", ".csv")

# quantity of each signal, to check the unit that is read and to choose the unit that is written
POSITIONS = ("setpoint", "position", "motor_position", "load_position")
ENCODERS = ("position", "motor_position")
"""The scale, and the motor encoder."""
SPEEDS = ("velocity", "velocity_setpoint", "drive_velocity_setpoint", "velocity_feedforward")
FORCES = ("current", "torque", "voltage")
"""What moves an axis, as controls record it."""
DISTURBANCE, INJECTED = "disturbance", "injected_command"
LOADS = {"N": "disturbance_force", "Nm": "disturbance_torque"}
"""External load that pushes the axis towards +q: force on the carriage; torque on a rotary axis, or on the motor shaft of a linear axis."""
INJECTIONS = {"V": "injected_voltage", "A": "injected_current", "Nm": "injected_torque", "N": "injected_force"}
"""Quantity that a test rig adds to the command of the drive; N and Nm: the resulting force at the carriage or torque at the motor."""
BY_UNIT = {DISTURBANCE: {**LOADS, "V": INJECTIONS["V"], "A": INJECTIONS["A"]}, INJECTED: INJECTIONS}
"""Signals of a file that are identified by their unit. A disturbance in V or A is an injected command."""
UNIT_SIGNALS = {signal: unit for table in (LOADS, INJECTIONS) for unit, signal in table.items()}
OTHER_UNITS = {
    **dict.fromkeys(("current", "current_setpoint"), "A"),
    **dict.fromkeys(("torque", "torque_setpoint", "torque_feedforward", "torque_friction", "torque_gravity"), "Nm"),
    "voltage": "V",
    **UNIT_SIGNALS,
}
SIGNALS = (*POSITIONS, *SPEEDS, "acceleration", *OTHER_UNITS)
PROGRAM = "program"

MOTION = {"position": POSITIONS, "speed": SPEEDS, "acceleration": ("acceleration",)}
"""Signals of each quantity that depends on the kind of axis."""
QUANTITY = {
    **{signal: quantity for quantity, signals in MOTION.items() for signal in signals},
    **{signal: UNITS[unit][0] for signal, unit in OTHER_UNITS.items()},
}
"""Quantity of each signal: position, speed, acceleration, current, torque, ..."""
_OF_AXES: dict[str, tuple[str, str | None]] = {
    **{UNITS[getattr(units, quantity)[0]][0]: (quantity, kind) for kind, units in AXIS_UNITS.items() for quantity in MOTION},
    **{"turns": ("position", None), "turning speed": ("speed", None)},
}

_HEADING = re.compile(r"^\s*([^\s.\[\]]+)\.([^\s\[\]]+)\s*\[([^\]]*)\]\s*$")
_TIME_HEADING = re.compile(r"^\s*time\s*\[([^\]]*)\]\s*$")

LARGEST_VALUE = 1e30
"""Largest value in SI; products of such values are still finite."""
SAME_PATH = 1e-12
"""Share of its travel by which a set point and the motion that it was made of differ: the rounding of a shifted zero."""
RELATIVE_PERIOD_TOLERANCE = 0.02
"""Sample times may deviate from the constant period by this fraction, because printed times are rounded."""


@dataclass(frozen=True)
class Trace:
    """Signals of several axes on one time base.

    time     (sample,) [s], strictly increasing with a constant period
    signals  (axis, signal) -> (sample,) array in SI
    kinds    axis -> 'linear' or 'rotary', which determines the units in files
    forces   axes whose motor gives a force (direct linear drives): their torques are written in N
    """

    time: np.ndarray
    signals: Mapping[tuple[str, str], np.ndarray]
    kinds: Mapping[str, str] = field(default_factory=dict)
    forces: frozenset[str] = frozenset()

    @property
    def axes(self) -> tuple[str, ...]:
        """Axis names in the order of the columns, without the pseudo axis `program`."""
        return tuple(dict.fromkeys(axis for axis, _ in self.signals if axis != PROGRAM))

    @property
    def period(self) -> float:
        """Sample period [s]."""
        return float((self.time[-1] - self.time[0]) / (len(self.time) - 1))

    @property
    def is_simulated(self) -> bool:
        """True if the trace holds the true position of a load, which no sensor shows."""
        return any(signal == "load_position" for _, signal in self.signals)

    def moves(self, axis: str) -> bool:
        """True if the set point of the axis moves by more than 1e-6 m or rad."""
        return axis in self.axes and bool(np.ptp(self.get(axis, "setpoint")) > 1e-6)

    def follows_itself(self, axis: str) -> bool:
        """True if the set point of a moving axis is its own recorded motion, but for the zero of the encoder: such a record shows no following error."""
        if not (self.has(axis, "setpoint") and self.moves(axis)):
            return False
        path = self.get(axis, "setpoint")
        return any(self.has(axis, s) and bool(np.ptp(self.get(axis, s) - path) <= SAME_PATH * np.ptp(path)) for s in ENCODERS)

    def has(self, axis: str, signal: str) -> bool:
        """True if this signal of this axis is recorded."""
        return (axis, signal) in self.signals

    def measured_position(self, axis: str) -> str:
        """The signal of the measured position of an axis: its scale, else its motor encoder; '' without one."""
        return measured_position_in([signal for name, signal in self.signals if name == axis])

    def get(self, axis: str, signal: str) -> np.ndarray:
        """One signal (sample,), SI."""
        try:
            return self.signals[axis, signal]
        except KeyError:
            have = [s for a, s in self.signals if a == axis]
            raise InputError(f"trace has no {axis}.{signal}; axis {axis} has: {', '.join(have) or 'nothing'}") from None

    def loads(self, axis: str) -> dict[str, np.ndarray]:
        """Known external loads on an axis by unit, see LOADS; empty if none is recorded."""
        return {unit: self.signals[axis, signal] for unit, signal in LOADS.items() if (axis, signal) in self.signals}

    def injections(self, axis: str) -> dict[str, np.ndarray]:
        """Quantities that a test rig adds to the command of an axis, by unit, see INJECTIONS; empty if none is recorded."""
        return {unit: self.signals[axis, signal] for unit, signal in INJECTIONS.items() if (axis, signal) in self.signals}

    def matrix(self, signal: str, axes: Sequence[str] | None = None) -> np.ndarray:
        """One signal of several axes as (sample, axis), SI."""
        return np.column_stack([self.get(axis, signal) for axis in (axes or self.axes)])

    def select(self, axes: Iterable[str]) -> Trace:
        """The trace with only these axes, and the signals of the program."""
        keep = {*axes, PROGRAM}
        return replace(self, signals={k: v for k, v in self.signals.items() if k[0] in keep})

    def decimated(self, every: int) -> Trace:
        """Every `every`-th sample."""
        return self.samples(slice(None, None, every))

    def samples(self, rows: slice) -> Trace:
        """Only these samples."""
        return replace(self, time=self.time[rows], signals={k: v[rows] for k, v in self.signals.items()})

    def unit(self, axis: str, signal: str) -> str:
        """Written unit of a signal of an axis."""
        if axis == PROGRAM:
            return "1"
        unit = unit_of(signal, self.kinds.get(axis, "linear"))  # without a kind no signal depends on it
        return "N" if unit == "Nm" and axis in self.forces else unit

    def to_table(self) -> pa.Table:
        """The columns that `write_trace` writes, as a pyarrow table: `time [s]`, `X.position [mm]`, ..."""
        import pyarrow as pa

        columns = {"time [s]": self.time}
        for (axis, signal), values in self.signals.items():
            unit = self.unit(axis, signal)
            name = DISTURBANCE if signal in LOADS.values() else INJECTED if signal in INJECTIONS.values() else signal
            columns[f"{axis}.{name} [{unit}]"] = values / UNITS[unit][1]
        return pa.table(columns)

    def to_pandas(self) -> Any:
        """The same columns as a pandas data frame with index time [s]. Raises InputError if pandas is not installed."""
        try:
            return self.to_table().to_pandas().set_index("time [s]")
        except ImportError:
            raise InputError("to_pandas needs pandas: pip install pandas; to_table() gives a pyarrow table without it") from None

    def plot(self, *axes: str) -> Figure:
        """Plot all signals of the given axes, or of all, over time in mm, mm/s, deg, deg/s, A. Returns a matplotlib figure."""
        from twin.report.curves import Curve, Panel, curves_figure

        panels = []
        for axis in axes or self.axes:
            units = {signal: self.unit(axis, signal) for name, signal in self.signals if name == axis}
            if not units:
                raise InputError(f"trace has no axis {axis}; {nearest(axis, self.axes)}")
            for unit in dict.fromkeys(units.values()):
                dashes = itertools.cycle(("-", "--", ":", "-."))
                styles = {s: ("setpoint", "-") if s == "setpoint" else (axis, next(dashes)) for s, its in units.items() if its == unit}
                curves = [Curve(in_words(s), self.get(axis, s) / UNITS[unit][1], *style) for s, style in styles.items()]
                panels.append(Panel(f"{axis}\n{unit}", curves))
        return curves_figure(self.time, panels, "")

    def __repr__(self) -> str:
        signals = ", ".join(dict.fromkeys(signal for _, signal in self.signals))
        return f"Trace of {' '.join(self.axes) or 'no axis'}: {len(self.time)} samples every {self.period * 1e3:.6g} ms; {signals}"

    def _repr_html_(self) -> str:
        """Notebook display: a summary and a plot."""
        from twin.report.figure import figure_svg

        return f"<p>{html.escape(repr(self))}</p>{figure_svg(self.plot())}"


def measured_position_in(signals: Container[str]) -> str:
    """The measured position among the signals of an axis: its scale, else its motor encoder; '' without one."""
    return next((signal for signal in ENCODERS if signal in signals), "")


def quantity_of(unit: str) -> tuple[str, str | None]:
    """Quantity that a unit measures, and the kind of axis (linear, rotary) that it shows; turns are those of a motor."""
    return _OF_AXES.get(dimension_recorded(unit), (dimension_recorded(unit), None))


def unit_of(signal: str, kind: str) -> str:
    """Written unit of a signal: mm, mm/s, deg, deg/s, A, Nm."""
    quantity = QUANTITY.get(signal, "")
    return str(getattr(AXIS_UNITS[kind], quantity)[0]) if quantity in MOTION else OTHER_UNITS.get(signal, "1")


def with_program_columns(followed: Trace, setpoints: Trace) -> Trace:
    """A simulated trace with the block numbers and feeds of its set points."""
    rows = np.clip(np.floor(followed.time / setpoints.period + 1e-9).astype(int), 0, len(setpoints.time) - 1)
    columns = {key: values[rows] for key, values in setpoints.signals.items() if key[0] == PROGRAM}
    return replace(followed, signals={**followed.signals, **columns})


def read_trace(path: str | Path, *, axes: Mapping[str, str] | None = None, need: Sequence[str] = ()) -> Trace:
    """Read and check a trace.

    `axes` maps the known axes to their kind ('linear', 'rotary'); other axes in the file are an error. `need` names signals that every
    axis of the file must have. Raises InputError with file, column and row.
    """
    path = Path(path)
    table = read_table(path)
    names = list(table)
    if not names or not _TIME_HEADING.match(names[0]):
        raise InputError(
            f"{path}: not a trace: the first column must be 'time [s]', found {names[0] if names else 'no column'!r}; "
            f"import a recording of a control: twin import {shell_word(path)} --out CAMPAIGN"
        )
    signals: dict[tuple[str, str], np.ndarray] = {}
    kinds: dict[str, str] = {}
    forces = set()
    for name in names[1:]:
        if (heading := _HEADING.match(name)) is None:
            raise InputError(f"{path}: column '{name}' is not of the form '<axis>.<signal> [<unit>]'; rename it, e.g. 'X.setpoint [mm]'")
        axis, signal, unit = heading[1], heading[2], heading[3].strip()
        if signal in BY_UNIT:
            if unit not in BY_UNIT[signal]:
                raise InputError(f"{path}: column '{name}': [{unit}] is not a unit of {signal}; use one of {', '.join(BY_UNIT[signal])}")
            signal = BY_UNIT[signal][unit]
        if axis != PROGRAM:
            if axes is not None and axis not in axes:
                raise InputError(f"{path}: column '{name}': unknown axis {axis}; {nearest(axis, axes)}; rename it, or give its --machine")
            kind = _kind_from_unit(axis, signal, unit, (kinds if axes is None else axes).get(axis), f"{path}: column '{name}'")
            if kind:
                kinds[axis] = kind
            if unit == "N" and OTHER_UNITS.get(signal) == "Nm":
                forces.add(axis)
        if (axis, signal) in signals:
            raise InputError(f"{path}: column '{name}' occurs twice; remove one")
        signals[axis, signal] = table[name] * factor_to_si(unit, f"{path}: column '{name}'")
    time = table[names[0]] * factor_to_si(_TIME_HEADING.match(names[0])[1], f"{path}: column '{names[0]}'")  # type: ignore[index]
    trace = Trace(time, signals, {**kinds, **(axes or {})}, frozenset(forces))
    _check_samples(trace, path, names)
    for signal in need:
        lacking = [axis for axis in trace.axes if not trace.has(axis, signal)]
        if lacking or not trace.axes:
            raise InputError(f"{path}: no {signal} column for axis {', '.join(lacking) or 'any'}; expected e.g. 'X.{signal} [mm]'")
    return trace


def joined(traces: Iterable[Trace]) -> Trace:
    """Consecutive traces of the same signals as one trace."""
    first, *others = traces
    if not others:
        return first
    parts = [dict(t.signals) for t in (first, *others)]
    time = np.concatenate([t.time for t in (first, *others)])
    return replace(first, time=time, signals={key: np.concatenate([part.pop(key) for part in parts]) for key in first.signals})


def trace_in(folder: Path) -> Path | None:
    """The trace in the folder of a run, or None."""
    return next((file for end in TRACE_ENDINGS if (file := folder / f"trace{end}").is_file()), None)


def write_trace(trace: Trace, path: str | Path) -> None:
    """Write Parquet or CSV, by the file's ending, in mm, mm/s, deg, deg/s, A, unrounded."""
    for _ in written((trace,), path):
        pass


def written(traces: Iterable[Trace], path: str | Path) -> Iterator[Trace]:
    """Write consecutive traces into one file while passing them on. The file appears after the last one."""
    import pyarrow.csv
    import pyarrow.parquet

    path = Path(path)
    if path.suffix.lower() not in TRACE_ENDINGS:
        raise InputError(f"{path}: a trace is .parquet or .csv; give the file one of these endings")
    make = pyarrow.csv.CSVWriter if path.suffix.lower() == ".csv" else pyarrow.parquet.ParquetWriter
    with beside(path) as partial, contextlib.ExitStack() as stack:
        file = stack.enter_context(pyarrow.OSFile(str(partial), "wb"))  # a CSVWriter keeps a file of its own open
        writer = None
        for trace in traces:
            table = trace.to_table()
            writer = writer or stack.enter_context(make(file, table.schema))
            writer.write_table(table)
            yield trace


def _kind_from_unit(axis: str, signal: str, unit: str, kind: str | None, where: str) -> str | None:
    """Kind of the axis that the unit implies, checked against the known kind and the signal."""
    factor_to_si(unit, where)
    wanted, (quantity, implied) = QUANTITY.get(signal), quantity_of(unit)
    of_direct_drive = wanted == "torque" and unit == "N" and kind != "rotary"
    if wanted and quantity != wanted and not of_direct_drive:
        raise InputError(f"{where}: [{unit}] is not a unit of a {signal}; use [{unit_of(signal, kind or 'linear')}]")
    if wanted in MOTION and kind and implied != kind:
        raise InputError(f"{where}: axis {axis} is {kind}, but [{unit}] is a unit of a {implied} axis; use [{unit_of(signal, kind)}]")
    return implied if wanted in MOTION else None


def _check_samples(trace: Trace, path: Path, names: list[str]) -> None:
    """Check for finite values of possible size, at least two samples, strictly increasing time and a constant period."""
    for name, values in zip(names, [trace.time, *trace.signals.values()]):
        if (i := _first(~(np.abs(values) < LARGEST_VALUE))) is not None:
            held = "NaN (not a number)" if np.isnan(values[i]) else f"{values[i]:g}, which is impossible"
            raise InputError(f"{path}: column '{name}': row {i + 1} holds {held}; repair or cut the recording")
    if len(trace.time) < 2:
        raise InputError(f"{path}: only one sample; a trace needs at least two")
    steps = np.diff(trace.time)
    if (i := _first(steps <= 0.0)) is not None:
        raise InputError(f"{path}: time does not increase at row {i + 2} ({trace.time[i + 1]:.6g} s); sort or repair the recording")
    period = float(np.median(steps))
    if (i := _first(np.abs(steps - period) > RELATIVE_PERIOD_TOLERANCE * period + 2e-9)) is not None:
        gap = f"{steps[i] * 1e3:.6g} ms after {trace.time[i]:.6g} s where the period is {period * 1e3:.6g} ms"
        raise InputError(f"{path}: gap in time at row {i + 2}: {gap}; cut the recording there or resample it")


def _first(flags: np.ndarray) -> int | None:
    """Row of the first flag; None if there is none."""
    return int(np.argmax(flags)) if flags.any() else None
