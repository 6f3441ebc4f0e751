"""Holding current of each axis against the angle of each rotary axis."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from twin.machine.holding import UNCHANGED, holding_effort, holding_of
from twin.machine.machine import Machine
from twin.report import new_figure
from twin.report.figure import BLUE, SOFT

COLOURS = (BLUE, SOFT)


def held_axes(machine: Machine) -> list[str]:
    """Axes whose holding current depends on the pose."""
    found = []
    for axis in machine.axes:
        effort = holding_effort(machine, axis)
        if axis.actuator.measured and np.ptp(effort) > max(UNCHANGED * np.abs(effort).max(), 1e-6 * axis.motor.peak_current_a):
            found.append(axis.name)
    return found


def span_over(machine: Machine, axis: str, rotary: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles (angle,) [deg] of a rotary axis, and least and largest holding current of an axis [A] over all angles of the other rotary axes."""
    holding, effort = holding_of(machine), holding_effort(machine, machine.axis(axis))
    own = holding.angles[:, holding.rotary.index(rotary)]
    angles = np.unique(own)
    least, largest = np.array([(effort[own == angle].min(), effort[own == angle].max()) for angle in angles]).T
    return np.degrees(angles), least, largest


def holding_figure(designs: dict[str, Machine]) -> Any | None:
    """Bands from least to largest holding current, one panel per axis with pose-dependent load and rotary axis; None if there is none."""
    first = next(iter(designs.values()))
    rotary = holding_of(first).rotary
    panels = [(axis, angle) for axis in held_axes(first) for angle in rotary]
    if not panels:
        return None
    figure, axes = new_figure(1, len(panels), width=min(1.4 + 3.7 * len(panels), 12.5), height=3.2)
    for (axis, angle), panel in zip(panels, axes[0]):
        for (label, machine), colour in reversed(list(zip(designs.items(), COLOURS))):
            degrees, least, largest = span_over(machine, axis, angle)
            panel.fill_between(degrees, least, largest, color=colour, alpha=0.25, linewidth=0)
            for edge, name in ((least, ""), (largest, label)):
                panel.plot(degrees, edge, color=colour, linewidth=1.4, label=name or None)
        panel.axhline(0.0, color="#9aa3ab", linewidth=0.8)
        panel.set_xlabel(f"angle of {angle} [deg]")
        panel.set_ylabel(f"current of {axis} at rest [A]")
        if math.isfinite(float(first.axis(axis).motor.peak_current_a)):
            panel.set_title(f"limit {first.axis(axis).motor.peak_current_a:g} A", fontsize=8.5)
    axes[0][0].legend(frameon=False, fontsize=8.5)
    return figure
