"""Compare two runs: differences by axis and signal, and the largest of them; two machine files: the numbers and effects that differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
import html
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from twin.compare.align import aligned
from twin.documents import flat
from twin.effects import settings_of
from twin.machine.machine import Axis, Machine, load_machine
from twin.recordings.trace import Trace
from twin.report.curves import Curve, Panel, curves_figure
from twin.report.figure import figure_svg
from twin.simulation.errors_of_run import axis_errors, delayed_set_point
from twin.simulation.gap import COMPARED, gap_unit
from twin.simulation.result import Run
from twin.simulation.summary import table
from twin.units import AXIS_UNITS, LEAST_SHOWN, in_words, plain

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Difference:
    """Second minus first of one signal: RMS and largest size in `unit`, and the time of the largest [s]."""

    axis: str
    signal: str
    rms: float
    max: float
    unit: str
    at_s: float


@dataclass(frozen=True)
class Comparison:
    """Comparison of two runs: `first` and `second` are the traces on common rows, `by` is the method of alignment.

    `errors` of an axis: largest error without the delay and largest reversal peak (None without a reversal) of both runs, in `unit`.
    """

    names: tuple[str, str]
    machine: Machine
    first: Trace
    second: Trace
    by: str
    differences: Sequence[Difference]
    errors: Sequence[Mapping[str, Any]]

    @property
    def verdict(self) -> str:
        """One sentence: the axes that differ, and the largest difference."""
        found = [d for d in self.differences if d.max > LEAST_SHOWN]
        if not found:
            return f"{self.names[0]} and {self.names[1]} move alike."
        worst = max(found, key=lambda d: (d.signal == "position", d.max))
        axes = ", ".join(self.differing)
        most = f", most on {worst.axis}" if len(self.differing) > 1 else ""
        return (
            f"{self.names[0]} and {self.names[1]} differ on {axes}{most}: {in_words(worst.signal)} by up to "
            f"{plain(worst.max)} {worst.unit} at {worst.at_s:.3f} s."
        )

    @property
    def differing(self) -> tuple[str, ...]:
        """Names of the axes that differ."""
        return tuple(dict.fromkeys(d.axis for d in self.differences if d.max > LEAST_SHOWN))

    def table(self) -> str:
        """Errors of both runs and differences by signal, for the axes that differ."""
        if not self.differing:
            return ""
        errors = table(["axis", "error without delay", *self.names], self.error_rows(), left=2)
        return f"{errors}\n\n{table(['axis', 'difference', 'RMS', 'largest', 'at'], self.difference_rows(), left=2)}"

    def error_rows(self) -> list[list[str]]:
        """Axis, 'largest' or 'after reversals', and that error in both runs, with units."""
        rows = []
        for e in (e for e in self.errors if e["axis"] in self.differing):
            for kind, end in (("largest", ""), ("after reversals", "_reversal")):
                pair = (e[f"{run}{end}"] for run in ("first", "second"))
                rows.append([e["axis"], kind, *("-" if v is None else f"{plain(v)} {e['unit']}" for v in pair)])
        return rows

    def difference_rows(self) -> list[list[str]]:
        """Axis, signal, RMS and largest difference with units, and the time of the largest."""
        return [
            [d.axis, in_words(d.signal), f"{plain(d.rms)} {d.unit}", f"{plain(d.max)} {d.unit}", f"{d.at_s:.3f} s"]
            for d in self.differences
            if d.axis in self.differing
        ]

    def document(self) -> dict[str, Any]:
        """Content of compare.json."""
        return {
            "first": self.names[0],
            "second": self.names[1],
            "aligned_by": self.by,
            "verdict": self.verdict,
            "errors": list(self.errors),
            "differences": [asdict(d) for d in self.differences],
        }

    def plot(self) -> Figure:
        """A matplotlib figure: error without the delay of both runs, for the axes that differ; for the first axis if none does."""
        panels = []
        for axis in (a for a in self.machine.axes if a.name in (self.differing or self.first.axes[:1])):
            unit, factor = AXIS_UNITS[axis.kind].error
            asked = delayed_set_point(self.first, axis)
            curves = [
                Curve(name, (asked - trace.get(axis.name, "position")) * factor, colour)
                for name, trace, colour in zip(self.names, (self.first, self.second), ("setpoint", axis.name))
                if trace.has(axis.name, "position")
            ]
            panels.append(Panel(f"{axis.name} error without\nthe delay, {unit}", curves, peaks=unit))
        return curves_figure(self.first.time, panels, f"{self.names[0]} and {self.names[1]}, aligned by {self.by}")

    def __repr__(self) -> str:
        return f"Comparison: {self.verdict}"

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.verdict)}</p><pre>{html.escape(self.table())}</pre>{figure_svg(self.plot())}"


def compare(a: Run | Trace, b: Run | Trace, machine: Machine | None = None, *, names: tuple[str, str] = ("first", "second")) -> Comparison:
    """Compare two runs or traces of the same motion, aligned on their set points.

    `machine` gives the kind and delay of each axis (default: that of a run, else the Mikron). Differences are second minus first in um,
    arcsec, mm/s, deg/s, A. Raises InputError if the set points are not of the same motion.
    """
    machine = machine or next((run.machine for run in (a, b) if isinstance(run, Run)), None) or load_machine()
    first, second, by = aligned(*(run.trace if isinstance(run, Run) else run for run in (a, b)))
    differences, errors = [], []
    for axis in machine.axes:
        if axis.name not in first.axes or axis.name not in second.axes:
            continue
        differences += [_difference(first, second, axis, s) for s in COMPARED if first.has(axis.name, s) and second.has(axis.name, s)]
        if first.has(axis.name, "position") and second.has(axis.name, "position"):
            errors.append(_errors(first, second, axis))
    return Comparison(names, machine, first, second, by, differences, errors)


def _difference(first: Trace, second: Trace, axis: Axis, signal: str) -> Difference:
    difference = second.get(axis.name, signal) - first.get(axis.name, signal)
    unit, factor = gap_unit(axis, signal)
    worst = int(np.argmax(np.abs(difference)))
    rms = float(np.sqrt(np.mean(difference**2)))
    return Difference(axis.name, signal, rms * factor, float(abs(difference[worst])) * factor, unit, float(first.time[worst]))


def _errors(first: Trace, second: Trace, axis: Axis) -> dict[str, Any]:
    unit, factor = AXIS_UNITS[axis.kind].error
    both = {"first": axis_errors(first, axis), "second": axis_errors(second, axis)}
    largest = {run: e.without_delay * factor for run, e in both.items()}
    peaks = {f"{run}_reversal": None if e.reversal_peak is None else e.reversal_peak * factor for run, e in both.items()}
    return {"axis": axis.name, "unit": unit, **largest, **peaks}


class Number(NamedTuple):
    """A number that differs: its path in the machine file, and its value in both files (None if missing)."""

    path: str
    first: Any
    second: Any


def differing_numbers(a: Machine, b: Machine) -> list[Number]:
    """Numbers that differ, in the order of the first file; paths of effects are `effect.NAME.AXIS.PARAMETER`."""
    first, second = flat(_plain(a)), flat(_plain(b))
    return [
        Number(path, first.get(path), second.get(path)) for path in dict.fromkeys([*first, *second]) if first.get(path) != second.get(path)
    ]


def _plain(machine: Machine) -> dict[str, Any]:
    """The document with effects by name and axis, without names of machine and model."""
    document = {key: value for key, value in machine.document.items() if key not in ("effect", "model", "name")}
    effects: dict[str, Any] = {}
    for setting in settings_of(machine):
        own = {k: v for k, v in setting.table().items() if k not in ("name", "axis")}
        path = f"{setting.effect.name}.{setting.axis}"
        same = sum(name.partition("#")[0] == path for name in effects)  # several laws, or couplings to several axes
        effects[f"{path}#{same + 1}" if same else path] = own
    return {**document, "effect": effects}
