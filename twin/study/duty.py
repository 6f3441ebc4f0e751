"""Duty cycles of a design: its runs simulated again for motor curves and replays."""

from __future__ import annotations

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from twin.errors import TwinError
from twin.machine.axis import Axis
from twin.machine.machine import Machine
from twin.report import Table, new_figure
from twin.report.figure import AMBER, BLUE, RED, SOFT
from twin.simulation.run import Run, simulate
from twin.study.evaluate import Work, motion_of

COLOURS = (BLUE, SOFT, RED)
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
        axis.name
        for axis in first.machine.axes
        if axis.actuator.electrical and any(run.trace.moves(axis.name) for run in first.runs.values())
    ]


def _units(axis: Axis) -> tuple[str, float, str]:
    """Unit of a motor's speed, its factor from SI, and the unit of its torque."""
    return ("m/min", 60.0, "N") if axis.drive == "direct" else ("rev/min", 30.0 / math.pi, "Nm")


def torque_speed_figure(duties: list[Duty]) -> Any:
    """Torque against speed of each motor: duty cycle, largest torque of all ticks, torque curve and rated torque."""
    names = driven_axes(duties)
    columns = min(3, len(names))
    figure, axes = new_figure(-(-len(names) // columns), columns, width=min(1.4 + 3.7 * columns, 12.5), height=3.4)
    panels = axes.ravel()
    for panel in panels[len(names) :]:
        panel.set_visible(False)
    for name, panel in zip(names, panels):
        speed_unit, factor, torque_unit = _units(duties[0].machine.axis(name))
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
        panel.set_xlim(0.0, fastest * factor)
        panel.set_ylim(0.0, None)
        panel.set_xlabel(f"{name}: speed of the motor [{speed_unit}]")
        panel.set_ylabel(f"torque [{torque_unit}]" if torque_unit == "Nm" else f"force [{torque_unit}]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8.0)
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
            motor, unit = axis.motor, _units(axis)[2]
            largest = max(run.load[name].effort_max for run in duty.runs.values())
            rms, _ = _rms_torque(duty, name)
            rated = motor.rated_torque_nm
            lines.append(
                [
                    name,
                    duty.label,
                    f"{largest * motor.torque_constant_nm_per_a:.3g} {unit}",
                    f"{100.0 * largest / motor.peak_current_a:.3g} %",
                    f"{rms:.3g} {unit}",
                    f"{100.0 * rms / rated:.3g} %" if rated else "no rating in the file",
                ]
            )
    return Table(["axis", "design", "largest torque", "of the peak", "RMS torque", "of the rating"], lines)
