"""The responses of a variant: numbers by name, with the unit in the name.

following error      set point minus position at the same time
control deviation    the same with the delayed set point of the position controller
contour error        distance of the followed from the commanded tool path
settling time        from the last change of the set point until the error stays within SETTLED
current              largest and RMS over all ticks; smooth: means over position cycles; ripple: the rest
copper loss          Kt / Ke R i_rms^2: R i_rms^2 of the one-phase equivalent, times the phases that make Ke i w equal to Kt i w
energies             of a run: work of the motors, work returned while braking, electrical energy of the windings (Kt / Ke u i)
limits used          largest speed and current over their limits; largest torque over the motor's torque curve
torque RMS used      RMS torque over rated torque, if the machine file has one; winding heat with its thermal time constant, for the repeated run
holding current      largest current against gravity at rest, over all angles of the rotary axes
first mode           sqrt(stiffness / load) / 2 pi of the axis' transmission, unless it is rigid
phase, gain margin   of the current, speed and position loop of an axis in the home pose (`twin.machine.loops`)
mark depth           largest depth of the followed cut below the programmed one (for a trace: below the commanded one)
"""

from collections.abc import Callable
import functools
import math

import numpy as np
import scipy

from twin.control.linear import Loop
from twin.effects import load_inertia
from twin.errors import TwinError
from twin.geometry.tool_path import ToolPath
from twin.machine.holding import holding_effort
from twin.machine.loops import Margins, first_mode, loops_of, margins_of
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.drive_load import DriveLoad
from twin.simulation.errors_of_run import contour_error_of
from twin.simulation.run import Run
from twin.simulation.setpoints import Setpoints
from twin.study.paths import inertia_at_motor
from twin.surface.part import Part
from twin.units import AXIS_UNITS

SETTLED = {"linear": 1e-6, "rotary": math.radians(1.0 / 3600.0)}
"""An axis with a smaller error counts as settled [m, rad]."""

MARGIN_GRID = 300
"""Number of frequencies for the search of a loop's crossings, which are refined afterwards."""

HELD = 1e-9
"""Below this holding current over the limit an axis counts as not loaded by gravity."""

Add = Callable[[str, float], None]


def joined(name: str, values: list[float], durations: list[float]) -> float:
    """One value for all runs: sum of times and energies, RMS and mean over the time [s] of all runs, otherwise the largest."""
    if name == "cycle_time_s" or name.endswith("_j"):
        return float(np.sum(values))
    if "_rms" in name:
        return float(np.sqrt(np.average(np.square(values), weights=durations)))
    if name.startswith("copper"):
        return float(np.average(values, weights=durations))
    return float(np.max(values))


def axis_responses(machine: Machine, run: Run, setpoints: Setpoints, add: Add) -> None:
    """Errors, drive loads and limits of every moving axis; energies of all axes."""
    time = run.trace.time
    delayed = {d: setpoints.at(time - d) for d in {axis.loops.set_point_delay_s for axis in machine.axes}}
    for a, axis in enumerate(machine.axes):
        setpoint, position = (run.trace.get(axis.name, s) for s in ("setpoint", "position"))
        if np.ptp(setpoint) < 1e-9:
            continue  # the axis does not move
        unit, factor = AXIS_UNITS[axis.kind].error
        error = setpoint - position
        for name, e in (("following_error", error), ("control_deviation", delayed[axis.loops.set_point_delay_s][:, a] - position)):
            add(f"{name}_max_{axis.name}_{unit}", float(np.abs(e).max()) * factor)
            add(f"{name}_rms_{axis.name}_{unit}", math.sqrt(e @ e / len(e)) * factor)
        load_responses(axis, run.load[axis.name], add)
        if axis.motor.rated_torque_nm and axis.motor.thermal_time_constant_s:
            add(f"winding_heat_used_{axis.name}", winding_heat(axis, run))
        add(f"time_at_{axis.effort}_limit_{axis.name}_share", run.current_limited_s[axis.name] / setpoints.duration)
        if axis.actuator.winding:
            add(f"time_at_voltage_limit_{axis.name}_share", run.voltage_limited_s[axis.name] / setpoints.duration)
        # settled: the last sample outside the band is not the last one
        last = int(np.flatnonzero(np.abs(np.diff(setpoint)) > 1e-12)[-1]) + 1
        outside = np.flatnonzero(np.abs(error[last:]) > SETTLED[axis.kind])
        if not len(outside):
            add(f"settling_time_{axis.name}_ms", 0.0)
        elif outside[-1] < len(error) - last - 1:
            add(f"settling_time_{axis.name}_ms", (int(outside[-1]) + 1) * run.trace.period * 1e3)
    add("mechanical_energy_j", sum(run.load[axis.name].work for axis in machine.axes))
    if all(axis.motor.back_emf_v_s_per_rad > 0.0 for axis in machine.axes):
        add("electrical_energy_j", sum(run.load[axis.name].electrical * axis.motor.phases for axis in machine.axes))


def load_responses(axis: Axis, load: DriveLoad, add: Add) -> None:
    """Load of one drive over all ticks, against its limits and ratings."""
    motor, name, per = axis.motor, axis.name, axis.effort_unit.lower()
    for part in ("effort_max", "effort_rms", "smooth_max", "smooth_rms", "ripple_rms"):
        add(f"{axis.effort}_{part.removeprefix('effort_')}_{name}_{per}", getattr(load, part))
    add(f"{axis.effort}_limit_used_{name}", load.effort_max / motor.peak_current_a)
    add(f"speed_limit_used_{name}", load.speed_max / axis.max_velocity)
    add(f"mechanical_energy_{name}_j", load.work)
    add(f"braking_energy_{name}_j", load.braking)
    if axis.actuator.winding:
        add(f"copper_loss_{name}_w", motor.phases * motor.resistance_ohm * load.effort_rms**2)
        if motor.back_emf_v_s_per_rad > 0.0:
            add(f"electrical_energy_{name}_j", motor.phases * load.electrical)
    if motor.rated_torque_nm:
        add(f"torque_rms_used_{name}", motor.torque_constant_nm_per_a * load.effort_rms / motor.rated_torque_nm)
    if motor.max_speed:
        add(f"motor_speed_used_{name}", load.speed_max / axis.ratio / motor.max_speed)
    if axis.actuator.winding:
        # largest ratio of torque to the motor's curve over the speed bins; the curve is taken at the lower end of each bin
        reached = load.torque > 0.0
        at = np.concatenate([[0.0], load.speed[:-1]])[reached]
        curve = motor.torque_at(at)
        with np.errstate(divide="ignore"):
            add(f"torque_curve_used_{name}", float(np.max(load.torque[reached] / curve, initial=0.0)))


def winding_heat(axis: Axis, run: Run) -> float:
    """Largest heat of a winding over that of its rated torque [1], if the run is repeated for ever.

    The heat h follows T dh/dt = i^2 - h with the motor's thermal time constant T. i^2 is taken from the trace and scaled to the mean
    of all ticks.
    """
    motor = axis.motor
    square = run.trace.get(axis.name, axis.effort)[:-1] ** 2
    square *= run.load[axis.name].effort_rms ** 2 / float(square.mean())
    kept = math.exp(-run.trace.period / (motor.thermal_time_constant_s or math.inf))
    from_cold = scipy.signal.lfilter([1.0 - kept], [1.0, -kept], square)
    # periodic solution: h(start) = h(end)
    before = from_cold[-1] / -math.expm1(len(square) * math.log(kept))
    heat = from_cold + before * kept ** np.arange(1, len(square) + 1)
    return float(heat.max()) * (motor.torque_constant_nm_per_a / (motor.rated_torque_nm or math.inf)) ** 2


def contour_responses(machine: Machine, trace: Trace, add: Add) -> None:
    """Contour and orientation error of the tool path; nothing for a machine without a tool in a part frame."""
    try:
        found = contour_error_of(trace, machine)
    except TwinError:
        return
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
    finest = [one.finest for one in machine_part(part, levels, threads=1).cuts]  # of each surface the two levels in turn
    return max(mark(made, asked)["depth_um"] for asked, made in zip(finest[::2], finest[1::2]))


def drive_responses(machine: Machine, add: Add) -> None:
    """Responses that need no run: margins, crossover and bandwidth of every loop, inertia ratio, first mode, holding current."""
    for axis in machine.axes:
        for loop in loops_of(machine, axis, inertia_at_motor(machine, axis)):
            margins = _margins(loop.name, loop.period, *((m.tobytes(), m.shape) for m in (loop.a, loop.b, loop.c)))
            name = f"{loop.name}_loop_{axis.name}"
            # an unstable loop gets a margin of 0; a loop that never reaches a gain of 1 has an infinite one, which is left out
            for key, value in (
                (f"phase_margin_{name}_deg", margins.phase if margins.stable else 0.0),
                (f"gain_margin_{name}_db", 20.0 * math.log10(margins.gain) if margins.stable and margins.gain > 0.0 else 0.0),
                (f"crossover_{name}_hz", margins.crossover),
                (f"bandwidth_{name}_hz", margins.bandwidth if margins.stable else math.inf),
            ):
                if math.isfinite(value):
                    add(key, value)
        if axis.rotor_inertia_kg_m2 > 0.0:
            add(f"inertia_ratio_{axis.name}", load_inertia(machine, axis) * axis.ratio**2 / axis.rotor_inertia_kg_m2)
        held = float(np.abs(holding_effort(machine, axis)).max())
        if held > HELD * axis.motor.peak_current_a:
            add(f"holding_{axis.effort}_{axis.name}_{axis.effort_unit.lower()}", held)
        if (mode := first_mode(machine, axis)) is not None:
            add(f"first_mode_{axis.name}_hz", mode)


@functools.lru_cache(maxsize=4096)
def _margins(name: str, period: float, *matrices: tuple[bytes, tuple[int, ...]]) -> Margins:
    """Margins of a loop by its matrices; cached, because most variants change the loops of one axis only."""
    return margins_of(Loop(name, period, *(np.frombuffer(data).reshape(shape) for data, shape in matrices)), MARGIN_GRID)
