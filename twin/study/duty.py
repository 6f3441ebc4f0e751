"""The drives of a design: its runs simulated again for motor curves and replays, and its holding currents over the angles of the rotary axes."""

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from twin.errors import TwinError
from twin.machine.holding import UNCHANGED, holding_effort, holding_of
from twin.machine.machine import Machine
from twin.report import Table, new_figure
from twin.report.figure import AMBER, BLUE, RED, SOFT
from twin.simulation.run import Run, simulate
from twin.study.evaluate import Work, motion_of

COLOURS = (BLUE, SOFT, RED)
COLUMNS = 3
"""Panels side by side."""
MOST_POINTS = 4000
"""Most points drawn per run and design."""
ROOM = 1.15
"""Upper end of the speed axis over the fastest point."""


@dataclass(frozen=True)
class Duty:
    """One design and its simulated runs by name."""

    label: str
    machine: Machine
    runs: dict[str, Run]


def duty_of(work: Work, machine: Machine, label: str) -> Duty | None:
    """Simulate the runs of a study on a design; None if it cannot run them."""
    try:
        runs = {}
        for source in work.sources:
            setpoints, _ = motion_of(source, machine)
            runs[source.name] = simulate(machine.with_feedforward(source.feedforward), setpoints, count_load=True)
    except TwinError:
        return None
    return Duty(label, machine, runs)


def driven_axes(duties: list[Duty]) -> list[str]:
    """Axes with a winding that move in some run of the first design."""
    first = duties[0]
    return [
        axis.name for axis in first.machine.axes if axis.actuator.winding and any(run.trace.moves(axis.name) for run in first.runs.values())
    ]


def panels_for(count: int, height: float, **options: Any) -> tuple[Any, list[Any]]:
    """A figure with so many panels, at most `COLUMNS` side by side, and the panels."""
    columns = min(COLUMNS, count)
    figure, axes = new_figure(-(-count // columns), columns, width=min(1.4 + 3.7 * columns, 12.5), height=height, **options)
    for panel in axes.ravel()[count:]:
        panel.set_visible(False)
    return figure, list(axes.ravel()[:count])


def torque_speed_figure(duties: list[Duty]) -> Any:
    """Torque against speed of each motor: duty cycle, largest torque of all ticks, torque curve and rated torque."""
    names = driven_axes(duties)
    figure, panels = panels_for(len(names), 3.4)
    for name, panel in zip(names, panels):
        direct = duties[0].machine.axis(name).drive == "direct"
        what, speed_unit, factor = ("force", "m/min", 60.0) if direct else ("torque", "rev/min", 30.0 / math.pi)
        fastest = ROOM * max(run.load[name].speed_max / d.machine.axis(name).ratio for d in duties for run in d.runs.values())
        for duty, colour in reversed(list(zip(duties, COLOURS))):
            axis = duty.machine.axis(name)
            for run in duty.runs.values():
                step = max(1, len(run.trace.time) // MOST_POINTS)
                speed, torque = (np.abs(run.trace.get(name, signal)[::step]) for signal in ("velocity", "torque"))
                panel.plot(speed / axis.ratio * factor, torque, ".", color=colour, alpha=0.25, markersize=2.5, markeredgewidth=0)
            reached = np.max([run.load[name].torque for run in duty.runs.values()], axis=0)
            at = next(iter(duty.runs.values())).load[name].speed * factor
            last = int(np.flatnonzero(reached)[-1]) + 1
            panel.stairs(reached[:last], [0.0, *at[:last]], color=colour, linewidth=1.4, label=f"{duty.label}: largest, every tick")
            rms, mean = _rms_torque(duty, name)
            panel.plot(
                mean * factor, rms, "D", color=colour, markersize=6, markeredgecolor="white", label=f"{duty.label}: RMS at mean speed"
            )
            speeds = np.linspace(0.0, fastest, 60)
            style = "-" if colour == COLOURS[0] else "--"
            panel.plot(
                speeds * factor, axis.motor.torque_at(speeds), style, color=AMBER, linewidth=1.8, label=f"{duty.label}: motor's curve"
            )
            if axis.motor.rated_torque_nm:
                end = min(axis.motor.rated_speed or fastest, fastest)
                rated = axis.motor.rated_torque_nm
                panel.plot([0.0, end * factor], [rated, rated], style, color=RED, linewidth=1.4, label=f"{duty.label}: rated")
        panel.set(xlim=(0.0, fastest * factor), ylim=(0.0, None))
        panel.set(xlabel=f"{name}: speed of the motor [{speed_unit}]", ylabel=f"{what} [{duties[0].machine.axis(name).motor_unit}]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=1 + len(panels), frameon=False, fontsize=8.0)
    return figure


def _rms_torque(duty: Duty, name: str) -> tuple[float, float]:
    """RMS torque and mean speed of a motor over all runs [Nm, rad/s]."""
    axis = duty.machine.axis(name)
    times = [float(run.trace.time[-1]) for run in duty.runs.values()]
    square = np.average([run.load[name].effort_rms ** 2 for run in duty.runs.values()], weights=times)
    speed = np.average([np.abs(run.trace.get(name, "velocity")).mean() for run in duty.runs.values()], weights=times)
    return axis.motor.torque_constant_nm_per_a * math.sqrt(float(square)), float(speed) / axis.ratio


def torque_table(duties: list[Duty]) -> Table:
    """Largest and RMS torque of each axis and design, and their shares of peak and rated torque."""
    lines = []
    for name in driven_axes(duties):
        for duty in duties:
            axis = duty.machine.axis(name)
            motor, unit = axis.motor, axis.motor_unit
            largest = max(run.load[name].effort_max for run in duty.runs.values())
            rms, _ = _rms_torque(duty, name)
            rated = motor.rated_torque_nm
            peak = [f"{largest * motor.torque_constant_nm_per_a:.3g} {unit}", f"{100.0 * largest / motor.peak_current_a:.3g} %"]
            share = f"{100.0 * rms / rated:.3g} %" if rated else "no rating in the file"
            lines.append([name, duty.label, *peak, f"{rms:.3g} {unit}", share])
    return Table(["axis", "design", "largest torque", "of the peak", "RMS torque", "of the rating"], lines)


def held_axes(machine: Machine) -> list[str]:
    """Axes whose holding current depends on the pose."""
    found = []
    for axis in machine.axes:
        effort = holding_effort(machine, axis)
        if axis.actuator.winding and np.ptp(effort) > max(UNCHANGED * np.abs(effort).max(), 1e-6 * axis.motor.peak_current_a):
            found.append(axis.name)
    return found


def span_over(machine: Machine, axis: str, rotary: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (angle,) [deg] of a rotary axis, and least and largest holding current of an axis [A] over all angles of the other rotary axes."""
    holding, effort = holding_of(machine), holding_effort(machine, machine.axis(axis))
    own = holding.angles[:, holding.rotary.index(rotary)]
    angles = np.unique(own)
    least, largest = np.array([(effort[own == angle].min(), effort[own == angle].max()) for angle in angles]).T
    return np.degrees(angles), least, largest


def holding_figure(duties: list[Duty]) -> Any | None:
    """Bands from least to largest holding current, one panel per axis with pose-dependent load and rotary axis; None if there is none."""
    first = duties[0].machine
    rotary = holding_of(first).rotary
    held = [(axis, angle) for axis in held_axes(first) for angle in rotary]
    if not held:
        return None
    figure, panels = panels_for(len(held), 3.2)
    for (axis, angle), panel in zip(held, panels):
        for duty, colour in reversed(list(zip(duties, COLOURS))):
            degrees, least, largest = span_over(duty.machine, axis, angle)
            panel.fill_between(degrees, least, largest, color=colour, alpha=0.25, linewidth=0)
            for edge, name in ((least, None), (largest, duty.label)):
                panel.plot(degrees, edge, color=colour, linewidth=1.4, label=name)
        panel.axhline(0.0, color="#9aa3ab", linewidth=0.8)
        panel.set(xlabel=f"angle of {angle} [deg]", ylabel=f"current of {axis} at rest [A]")
        if math.isfinite(limit := first.axis(axis).motor.peak_current_a):
            panel.set_title(f"limit {limit:g} A", fontsize=8.5)
    panels[0].legend(frameon=False, fontsize=8.5)
    return figure
