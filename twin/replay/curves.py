"""Time series of the axes: set points, signals, parts of the torque, differences between runs.

    following error = set point - position
    error without the delay = delayed set point - position
    torque = inertia + friction + gravity          inertia is the remainder: it accelerates the axis and its neighbours

Torque feedforward is the part that the control adds from the set points. Every curve has a name with unit.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import POSITIONS, Trace
from twin.replay.names import CONTOUR_ERROR, STEPS, axis_entity, entity
from twin.report.colours import (
    AXIS_COLOURS,
    LIMIT_COLOUR,
    RUN_COLOURS,
    SETPOINT_COLOUR,
    TORQUE_COLOURS,
    Colour,
    axis_colour,
    mixed,
    run_colour,
)
from twin.simulation.errors_of_run import error_without_delay
from twin.units import AXIS_UNITS, in_words

CONTOUR_COLOUR = AXIS_COLOURS["A"]
SET_POINT = "set point"
NEAR_LIMIT = 0.5
"""A limit is drawn if a run reaches this share of it."""
_TORQUE_PARTS = ("friction", "gravity", "feedforward")
_DRAWN = {"setpoint": "set point", "position": "position", "velocity": "speed", "velocity_setpoint": "speed set point"}
"""Signals plotted for every axis, besides current and torque: name in a trace -> name in plots."""
SAME_TIME = 1e-9
"""Samples of two runs that are closer count as simultaneous [s]."""


@dataclass(frozen=True)
class PlotLine:
    """One line of a plot: entity path, name with unit, and samples in that unit.

    `key` is its entry in the key below the plots. `run` is the index of its run: the first is drawn wide, later ones thin upon it.
    """

    path: str
    name: str
    colour: Colour
    time: np.ndarray
    values: np.ndarray
    key: str = ""
    run: int = 0


def line_width(run: int, several: bool) -> float:
    """Width of a line [points]: of several runs the first is wide and later ones lie thin upon it, so that none hides another."""
    return (4.0, 1.5, 0.75)[min(run, 2)] if several else 1.75


def axis_curves(machine: Machine, runs: Mapping[str, Trace]) -> list[PlotLine]:
    """Curves of all axes and runs; differences are later runs minus the first."""
    curves: list[PlotLine] = []
    labels = list(runs)
    for order, axis in enumerate(machine.axes):
        for i, label in enumerate(labels):
            if axis.name in runs[label].axes:
                curves += _run_curves(axis, order, runs[label], label, i, alone=len(labels) == 1)
        curves += _limits(axis, list(runs.values()))
        for i, label in enumerate(labels[1:], 1):
            curves += _differences(axis, runs[labels[0]], runs[label], f"{label} - {labels[0]}", label, i)
    return curves


def contour_curve(label: str, time: np.ndarray, error: np.ndarray, order: int, alone: bool) -> PlotLine:
    """The contour error of one run [um]."""
    name = "contour error" + ("" if alone else f", {label}") + " [um]"
    return PlotLine(entity(CONTOUR_ERROR, label), name, run_colour(order, CONTOUR_COLOUR), time, error * 1e6, label, order)


def step_curves(axis: Axis, time: np.ndarray, steps: Mapping[str, np.ndarray]) -> list[PlotLine]:
    """Curves of a quantity of an axis after each step: name -> values (sample,) [m or rad]."""
    unit, factor = AXIS_UNITS[axis.kind].error
    nominal, corrected = RUN_COLOURS
    return [
        PlotLine(entity(STEPS, f"{i:02d} {name}"), f"{name} [{unit}]", mixed(nominal, share, corrected), time, factor * values)
        for i, (share, (name, values)) in enumerate(zip(np.linspace(0.0, 1.0, len(steps)), steps.items()))
    ]


def position_errors(trace: Trace, axis: Axis) -> dict[str, np.ndarray]:
    """Error without the delay, and set point minus position (sample,) [m or rad], by the group of their plots; empty if one of both is not recorded."""
    if not (trace.has(axis.name, "setpoint") and trace.has(axis.name, "position")):
        return {}
    following = trace.get(axis.name, "setpoint") - trace.get(axis.name, "position")
    return {"error_without_delay": error_without_delay(trace, axis), "following_error": following}


def axis_of_largest(machine: Machine, errors: Mapping[str, np.ndarray]) -> str:
    """The axis with the largest of these errors (sample,) [m or rad], relative to its highest speed; "" without any."""
    return max(errors, key=lambda axis: float(np.abs(errors[axis]).max()) / machine.axis(axis).max_velocity, default="")


def torque_parts(trace: Trace, axis: Axis) -> dict[str, np.ndarray]:
    """Motor torque (sample,) [Nm] as "motor", and its recorded parts.

    Without a recorded torque it is computed from the current and the torque constant.
    """
    parts: dict[str, np.ndarray] = {}
    if trace.has(axis.name, "torque"):
        parts["motor"] = trace.get(axis.name, "torque")
    elif trace.has(axis.name, axis.effort):
        parts["motor"] = axis.motor.torque_constant_nm_per_a * trace.get(axis.name, axis.effort)
    for part in _TORQUE_PARTS:
        if trace.has(axis.name, f"torque_{part}"):
            parts[part] = trace.get(axis.name, f"torque_{part}")
    if {"motor", "friction", "gravity"} <= parts.keys():
        parts["inertia"] = parts["motor"] - parts["friction"] - parts["gravity"]
    return parts


def not_recorded(trace: Trace, machine: Machine) -> list[str]:
    """Curves without data, one line for all axes that lack the same: 'X, Y: speed set point, torque of friction'."""
    axes_that_lack: dict[str, list[str]] = {}
    for axis in machine.axes:
        if axis.name in trace.axes:
            signals = {**_DRAWN, axis.effort: axis.effort, **{f"torque_{part}": f"torque of {part}" for part in _TORQUE_PARTS}}
            if lacking := [word for signal, word in signals.items() if not trace.has(axis.name, signal)]:
                axes_that_lack.setdefault(", ".join(lacking), []).append(axis.name)
    return [f"{', '.join(axes)}: {lacking}" for lacking, axes in axes_that_lack.items()]


def _run_curves(axis: Axis, order: int, trace: Trace, label: str, run: int, alone: bool) -> Iterator[PlotLine]:
    units = AXIS_UNITS[axis.kind]
    first = run == 0
    mine = run_colour(run, axis_colour(axis.name, order))
    behind = "" if alone else f", {label}"

    def curve(group: str, what: str, unit: str, values: np.ndarray, colour: Colour, leaf: str = label, key: str = label) -> PlotLine:
        name = f"{axis.name} {what}{behind} [{unit}]"
        return PlotLine(axis_entity(axis.name, group, leaf), name, colour, trace.time, values, key, run)

    def recorded(group: str, signal: str, what: str, unit: tuple[str, float], colour: Colour, **words: str) -> Iterator[PlotLine]:
        if trace.has(axis.name, signal):
            yield curve(group, what, unit[0], trace.get(axis.name, signal) * unit[1], colour, **words)

    # set points lie behind the positions and are drawn for the first run only
    if first:
        yield from recorded("position", "setpoint", "set point", units.position, SETPOINT_COLOUR, leaf="set_point", key=SET_POINT)
    yield from recorded("position", "position", "position", units.position, mine)
    for group, error in position_errors(trace, axis).items():
        yield curve(group, in_words(group), units.error[0], error * units.error[1], mine)
    if first:
        leaf = f"set_point_{label}"
        yield from recorded("speed", "velocity_setpoint", "speed set point", units.speed, SETPOINT_COLOUR, leaf=leaf, key=SET_POINT)
    yield from recorded("speed", "velocity", "speed", units.speed, mine)
    yield from recorded("current", "current", "current", ("A", 1.0), mine)
    unit = axis.motor_unit
    for part, values in torque_parts(trace, axis).items():
        # with several runs only the whole torques are drawn: their parts would have the same colours
        if part == "motor":
            yield curve("torque", "motor torque", unit, values, mine, f"motor_{label}")
        elif alone:
            yield curve("torque", f"torque, {part}", unit, values, TORQUE_COLOURS[part], f"{part}_{label}", part)


def _limits(axis: Axis, runs: Sequence[Trace]) -> Iterator[PlotLine]:
    """Current limits as two straight lines, if a run comes near them; otherwise they would compress the current."""
    limit = axis.motor.peak_current_a
    reached = max((float(np.abs(t.get(axis.name, "current")).max()) for t in runs if t.has(axis.name, "current")), default=0.0)
    if axis.effort != "current" or reached < NEAR_LIMIT * limit:
        return
    ends = runs[0].time[[0, -1]]
    for sign, word in ((1.0, "upper"), (-1.0, "lower")):
        path = axis_entity(axis.name, "current", f"{word}_limit")
        yield PlotLine(path, f"{axis.name} current limit [A]", LIMIT_COLOUR, ends, np.full(2, sign * limit), "limit")


def _differences(axis: Axis, first: Trace, second: Trace, what: str, label: str, run: int) -> Iterator[PlotLine]:
    """Second run minus first, in position, speed and current."""
    units = AXIS_UNITS[axis.kind]
    for signal, word, (unit, factor) in (
        ("position", "position", units.error), ("velocity", "speed", units.speed), ("current", "current", ("A", 1.0)),
    ):  # fmt: skip
        time, values = difference(first, second, axis.name, signal)
        if len(time) > 1:
            path, name = axis_entity(axis.name, f"difference_{word}", label), f"{axis.name} {word}, {what} [{unit}]"
            yield PlotLine(path, name, run_colour(run, SETPOINT_COLOUR), time, values * factor, label, run)


def difference(first: Trace, second: Trace, axis: str, signal: str) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and values of a signal of the second run minus that of the first (sample,), on the samples of the first; none where one lacks it.

    Positions are interpolated by a cubic spline, because linear interpolation is micrometres off.
    """
    inside = (first.time >= second.time[0] - SAME_TIME) & (first.time <= second.time[-1] + SAME_TIME)
    time = first.time[inside]
    if not (first.has(axis, signal) and second.has(axis, signal)):
        return time[:0], time[:0]
    values = second.get(axis, signal)
    if not (len(time) == len(values) and np.allclose(time, second.time, rtol=0.0, atol=SAME_TIME)):
        is_smooth = signal in POSITIONS and len(values) > 3
        values = CubicSpline(second.time, values)(time) if is_smooth else np.interp(time, second.time, values)
    return time, values - first.get(axis, signal)[inside]
