"""The responses of a variant: numbers of one run by name, with their units in the name.

following error      set point minus position at the same time
control deviation    the same with the set point as the position controller gets it, delayed: what the drive leaves
contour error        distance of the followed from the commanded tool path
settling time        from the last change of the set point until the error stays inside SETTLED
copper loss          R i_rms^2 of the one-phase equivalent of the motor
limits used          largest speed and current over their limits
first mode           sqrt(stiffness / load) / 2 pi of the axis' transmission; none where it is rigid
phase, gain margin   of the current, speed and position loop of an axis in the home pose (`twin.machine.loops`)
mark depth           deepest place of the followed cut below the programmed one (a trace: below the commanded one)
"""

from __future__ import annotations

from collections.abc import Callable
import functools
import math

import numpy as np

from twin.effects import load_inertia, settings_of
from twin.errors import TwinError
from twin.geometry.kinematics import kinematics_of
from twin.geometry.tool_path import ToolPath, contour_error, search_window, tool_path_of
from twin.machine.loops import Loop, Margins, loops_of, margins_of
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.run import Run
from twin.simulation.setpoints import Setpoints
from twin.surface.part import Part
from twin.units import AXIS_UNITS

SETTLED = {"linear": 1e-6, "rotary": math.radians(1.0 / 3600.0)}
"""Error inside which an axis counts as settled [m, rad]."""

MARGIN_GRID = 300
"""Frequencies on which the crossings of a loop are looked for; they are refined afterwards."""

Add = Callable[[str, float], None]


def joined(name: str, values: list[float]) -> float:
    """One number for all runs: sums of times, root mean square of RMS values, mean of losses, else the largest."""
    if name == "cycle_time_s":
        return float(np.sum(values))
    if "_rms" in name:
        return float(np.sqrt(np.mean(np.square(values))))
    if name.startswith("copper"):
        return float(np.mean(values))
    return float(np.max(values))


def axis_responses(machine: Machine, run: Run, setpoints: Setpoints, add: Add) -> None:
    time = run.trace.time
    delayed = {d: setpoints.at(time - d) for d in {axis.loops.set_point_delay_s for axis in machine.axes}}
    for a, axis in enumerate(machine.axes):
        setpoint, position, effort = (run.trace.get(axis.name, s) for s in ("setpoint", "position", axis.effort))
        if np.ptp(setpoint) < 1e-9:
            continue  # an axis that stands
        unit, factor = AXIS_UNITS[axis.kind].error
        error = setpoint - position
        for name, e in (("following_error", error), ("control_deviation", delayed[axis.loops.set_point_delay_s][:, a] - position)):
            add(f"{name}_max_{axis.name}_{unit}", float(np.abs(e).max()) * factor)
            add(f"{name}_rms_{axis.name}_{unit}", math.sqrt(e @ e / len(e)) * factor)
        largest, square = float(np.abs(effort).max()), float(effort @ effort) / len(effort)
        per = axis.effort_unit.lower()
        add(f"{axis.effort}_max_{axis.name}_{per}", largest)
        add(f"{axis.effort}_rms_{axis.name}_{per}", math.sqrt(square))
        add(f"{axis.effort}_limit_used_{axis.name}", largest / axis.motor.peak_current_a)
        add(f"speed_limit_used_{axis.name}", float(np.abs(run.trace.get(axis.name, "velocity")).max()) / axis.max_velocity)
        if axis.has_current_loop:
            add(f"copper_loss_{axis.name}_w", axis.motor.resistance_ohm * square)
        add(f"time_at_{axis.effort}_limit_{axis.name}_share", run.current_limited_s[axis.name] / setpoints.duration)
        if axis.has_current_loop:
            add(f"time_at_voltage_limit_{axis.name}_share", run.voltage_limited_s[axis.name] / setpoints.duration)
        # settled: the last sample outside lies before the end of the record
        last = int(np.flatnonzero(np.abs(np.diff(setpoint)) > 1e-12)[-1]) + 1
        outside = np.flatnonzero(np.abs(error[last:]) > SETTLED[axis.kind])
        if not len(outside):
            add(f"settling_time_{axis.name}_ms", 0.0)
        elif outside[-1] < len(error) - last - 1:
            add(f"settling_time_{axis.name}_ms", (int(outside[-1]) + 1) * run.trace.period * 1e3)


def contour_responses(machine: Machine, trace: Trace, commanded: ToolPath | None, add: Add) -> None:
    try:
        kinematics = kinematics_of(machine)
        followed = tool_path_of(trace, "position", machine, kinematics=kinematics)
        if commanded is None or not np.array_equal(commanded.time, followed.time):
            commanded = tool_path_of(trace, "setpoint", machine, kinematics=kinematics)
    except TwinError:
        return  # a machine without a tool in a part frame has no contour
    found = contour_error(followed, commanded, search_window(machine))
    add("contour_error_max_um", float(found.error.max()) * 1e6)
    add("contour_error_rms_um", math.sqrt(found.error @ found.error / len(found.error)) * 1e6)
    add("orientation_error_max_arcsec", math.degrees(found.orientation.max()) * 3600.0)


def mark_depth(machine: Machine, trace: Trace, part: Part, programmed: ToolPath | None) -> float:
    """Deepest mark over all surfaces of the part [um]."""
    from twin.surface.levels import COMMANDED, FOLLOWED, PROGRAMMED, Level, levels_of_trace
    from twin.surface.machining import machine_part
    from twin.surface.metrology import mark

    levels = levels_of_trace(trace, machine, part.tool, (FOLLOWED,) if programmed else (COMMANDED, FOLLOWED), "study")
    if programmed:
        levels.insert(0, Level(PROGRAMMED, "", programmed, {}))
    cuts = machine_part(part, levels, threads=1)
    pairs = [[cuts.of(surface.name, level.level).finest for level in levels] for surface in part.surfaces]
    return max(mark(made, asked).depth for asked, made in pairs) * 1e6


def drive_responses(machine: Machine, add: Add) -> None:
    """Numbers of the drives that need no run: margins and crossovers of every loop, inertia ratio, first mode."""
    inertias = home_inertia_at_motor(machine)
    for axis, inertia in zip(machine.axes, inertias.tolist()):
        for loop in loops_of(machine, axis, inertia):
            margins = _margins(loop.name, loop.period, *((m.tobytes(), m.shape) for m in (loop.a, loop.b, loop.c)))
            name = f"{loop.name}_loop_{axis.name}"
            # an unstable loop has no margin: 0 says so in a table of numbers
            add(f"phase_margin_{name}_deg", margins.phase if margins.stable else 0.0)
            add(f"gain_margin_{name}_db", 20.0 * math.log10(margins.gain) if margins.stable and 0.0 < margins.gain < math.inf else 0.0)
            if math.isfinite(margins.crossover):
                add(f"crossover_{name}_hz", margins.crossover)
        if axis.rotor_inertia_kg_m2 > 0.0:
            add(f"inertia_ratio_{axis.name}", load_inertia(machine, axis) * axis.ratio**2 / axis.rotor_inertia_kg_m2)
    for setting in settings_of(machine):
        if (stiffness := setting.parameters.get("stiffness")) and setting.effect.block == "transmission":
            axis = machine.axis(setting.axis)
            add(f"first_mode_{axis.name}_hz", math.sqrt(stiffness / load_inertia(machine, axis)) / (2 * math.pi))


@functools.lru_cache(maxsize=4096)
def _margins(name: str, period: float, *matrices: tuple[bytes, tuple[int, ...]]) -> Margins:
    """Margins of a loop by its matrices: most variants change the loops of one axis only."""
    return margins_of(Loop(name, period, *(np.frombuffer(data).reshape(shape) for data, shape in matrices)), MARGIN_GRID)
