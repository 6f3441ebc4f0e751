"""Result of a simulation: the trace, its errors, and the time that the drives spent at their limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
import functools
import html
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.drive_load import DriveLoad
from twin.simulation.errors_of_run import AxisErrors, axis_errors, error_without_delay
from twin.units import AXIS_UNITS

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    import pyarrow as pa


@dataclass(frozen=True)
class Run:
    """Result of `simulate`.

    `trace` is the record of the control, `without_noise` the same without measuring noise. `current_limited_s` and
    `voltage_limited_s` are the times at the limits [s] by axis. `machine` is the simulated machine. `load` is the load of
    each drive, if `simulate` was called with `count_load`.
    """

    trace: Trace
    without_noise: Trace
    current_limited_s: dict[str, float]
    voltage_limited_s: dict[str, float]
    machine: Machine
    load: Mapping[str, DriveLoad] = field(default_factory=dict)

    def following_error(self, axis: str) -> np.ndarray:
        """Set point minus position at the same time (sample,) [m, rad]."""
        return self.trace.get(axis, "setpoint") - self.trace.get(axis, "position")

    def error_without_delay(self, axis: str) -> np.ndarray:
        """Delayed set point minus position (sample,) [m, rad]: the error beyond the constant delay of the control."""
        return error_without_delay(self.trace, self.machine.axis(axis))

    @functools.cached_property
    def errors(self) -> Mapping[str, AxisErrors]:
        """Errors by axis [m, rad]: largest with and without the delay, and after a reversal."""
        return {axis.name: axis_errors(self.trace, axis) for axis in self.machine.axes}

    def to_table(self) -> pa.Table:
        """The trace as a pyarrow table, headings with units; `to_table().to_pandas()` where pandas is installed."""
        return self.trace.to_table()

    def to_pandas(self) -> Any:
        """The trace as a pandas data frame indexed by time [s]."""
        return self.trace.to_pandas()

    def plot(self, *axes: str, title: str = "") -> Figure:
        """Plot position, error without the delay and effort of the given axes, or of all moving axes; returns a matplotlib figure."""
        from twin.report.curves import Curve, Panel, curves_figure

        names = axes or tuple(name for name in self.trace.axes if self.trace.moves(name)) or self.trace.axes[:1]
        panels = []
        for name in names:
            axis = self.machine.axis(name)
            units = AXIS_UNITS[axis.kind]
            asked, position = self.trace.get(name, "setpoint"), self.trace.get(name, "position")
            both = (Curve("set point", asked * units.position[1], "setpoint"), Curve("position", position * units.position[1], name))
            panels += [
                Panel(f"{name} position\n{units.position[0]}", both),
                Panel(
                    f"{name} error without\nthe delay, {units.error[0]}",
                    (Curve("", self.error_without_delay(name) * units.error[1], name),),
                    peaks=units.error[0],
                ),
                Panel(f"{name} {axis.effort}\n{axis.effort_unit}", (Curve("", self.trace.get(name, axis.effort), name),)),
            ]
        return curves_figure(self.trace.time, panels, title or self.machine.name)

    def __repr__(self) -> str:
        moving = [name for name in self.trace.axes if self.trace.moves(name)]
        return f"Run of {self.machine.name}: {self.trace.time[-1]:.3f} s, moving axes: {' '.join(moving) or 'none'}"

    def _repr_html_(self) -> str:
        """Notebook display: errors of each axis and the plot."""
        from twin.report.figure import figure_svg

        rows = []
        for axis in self.machine.axes:
            unit, factor = AXIS_UNITS[axis.kind].error
            found = self.errors[axis.name]
            peak = "-" if found.reversal_peak is None else f"{found.reversal_peak * factor:.2f} {unit}"
            cells = (axis.name, f"{found.without_delay * factor:.2f} {unit}", peak, f"{found.following * factor:.2f} {unit}")
            rows.append("".join(f"<td>{cell}</td>" for cell in cells))
        heading = "".join(f"<th>{text}</th>" for text in ("axis", "error without the delay", "after reversals", "following error"))
        return (
            f"<p>{html.escape(repr(self))}</p><table><tr>{heading}</tr><tr>{'</tr><tr>'.join(rows)}</tr></table>{figure_svg(self.plot())}"
        )
