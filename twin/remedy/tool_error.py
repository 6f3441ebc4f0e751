"""The error on the part: distance of the true tool path from the path of the set points, level 2.

A common delay of all axes does not mark a part; the contour error leaves it out. Positions are those of the loads, also where no encoder
measures them. A machine without a tool and a part frame is judged by the path of its linear axes, one with a single axis by its error without the
control's delay.
"""

from dataclasses import dataclass

import numpy as np

from twin.diagnose.tool_point import LOAD
from twin.errors import TwinError
from twin.geometry.tool_path import contour_of, search_window
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.errors_of_run import REVERSAL_WINDOW, contour_error_of, delayed_set_point, reversal_times


@dataclass(frozen=True)
class ToolError:
    """Contour error (sample,) [m]; by axis the largest error after a reversal, its quadrant peak [m or rad], and the largest share of its peak current."""

    contour: np.ndarray
    peaks: dict[str, float]
    shares: dict[str, float]

    @property
    def rms(self) -> float:
        """RMS contour error [m]."""
        return float(np.sqrt(np.mean(self.contour**2)))

    @property
    def largest(self) -> float:
        """Largest contour error [m]."""
        return float(self.contour.max())


DIVERGED = ToolError(np.array([np.inf]), {}, {})
"""The error of a machine whose simulation diverges."""


def tool_error(trace: Trace, machine: Machine) -> ToolError:
    """The error of a simulated run, whose trace holds `load_position`."""
    try:
        contour = contour_error_of(trace, machine, LOAD).error
    except TwinError:
        linear = [a.name for a in machine.axes if a.kind == "linear" and trace.has(a.name, LOAD)]
        contour = _of_axes(trace, machine, linear or [a.name for a in machine.axes if trace.has(a.name, LOAD)])
    return ToolError(
        contour,
        {a.name: _peak(trace, machine, a.name) for a in machine.axes if trace.has(a.name, LOAD)},
        {a.name: _share(trace, machine, a) for a in machine.axes if trace.has(a.name, "current") and a.motor.peak_current_a > 0.0},
    )


def _share(trace: Trace, machine: Machine, axis: Axis) -> float:
    """Largest current with three standard deviations of what the speed controller makes of the noise of the speed, over the peak current."""
    noise = axis.loops.speed_gain_nm_s_per_rad * machine.noise(axis).speed / axis.ratio / axis.motor.torque_constant_nm_per_a
    return (float(np.abs(trace.get(axis.name, "current")).max()) + 3.0 * noise) / axis.motor.peak_current_a


def _of_axes(trace: Trace, machine: Machine, names: list[str]) -> np.ndarray:
    if len(names) == 1:
        axis = machine.axis(names[0])
        return np.abs(delayed_set_point(trace, axis) - trace.get(axis.name, LOAD))
    followed, commanded = (np.column_stack([trace.get(n, s) for n in names]) for s in (LOAD, "setpoint"))
    return contour_of(trace.time, followed, trace.time, commanded, search_window(machine)).error


def _peak(trace: Trace, machine: Machine, name: str) -> float:
    """Largest error without the control's delay in REVERSAL_WINDOW after a reversal [m or rad]; 0 without one."""
    off = np.abs(delayed_set_point(trace, machine.axis(name)) - trace.get(name, LOAD))
    parts = [
        off[first : first + round(REVERSAL_WINDOW / trace.period)] for first in np.searchsorted(trace.time, reversal_times(trace, name))
    ]
    return max((float(part.max()) for part in parts if len(part)), default=0.0)
