"""Draw the picture of an effect: a short move with the effect (colour of the axis) and without it (grey)."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from scipy.ndimage import uniform_filter1d

from twin.effects import Effect, Setting, settings_of, with_effects
from twin.effects.effect import Move
from twin.effects.readable import setting_text
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.report import new_figure, save_png
from twin.report.colours import SETPOINT_COLOUR, axis_colour, hexadecimal
from twin.simulation.errors_of_run import error_without_delay
from twin.simulation.motor_and_scale import motor_minus_scale
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.units import AXIS_UNITS

_PERIOD = 1e-3


MOVES: dict[str, tuple[tuple[float, ...], float, float, float, float]] = {
    "acceleration": ((0.05, -0.05), 0.25, math.inf, 100.0, 0.08),
    "slow": ((0.004, -0.004), 0.010, 0.5, 20.0, 0.05),
    "reversal": ((0.0015, -0.0015), 0.010, 0.5, 20.0, 0.05),
    "constant speed": ((0.04, -0.04), 0.05, 1.0, 40.0, 0.05),
    "jerk": ((0.02,), 0.1, 2.0, 2000.0, 0.15),
    "gentle": ((0.15, -0.15), 0.3, 1.0, 20.0, 0.08),
    "again": ((0.0015, -0.0015) * 10, 0.010, 0.5, 20.0, 0.2),
}
"""Moves in turn of a linear axis: distances [m], speed [m/s], acceleration [m/s2], jerk [m/s3], dwell [s]. Infinite: the limit of the axis."""

ROTARY = 6.0
"""Scale of the moves of a rotary axis [rad/m]."""


def setpoint(move: Move, axis: Axis) -> np.ndarray:
    """Set points (sample,) of a move at 1 ms."""
    unit = 1.0 if axis.kind == "linear" else ROTARY
    if move in MOVES:
        distances, speed, acceleration, jerk, dwell = MOVES[move]
        acceleration = acceleration * unit if acceleration < math.inf else axis.max_acceleration
        return moves_in_turn(0.0, [d * unit for d in distances], speed * unit, acceleration, jerk * unit, dwell, _PERIOD)[1]
    if move == "turn":
        return moves_in_turn(0.0, [2 * math.pi], 2.0, 5.0, 50.0, 0.1, _PERIOD)[1]
    t = np.arange(1101) * _PERIOD
    if move == "micro":
        ease = np.minimum(t / 0.25, 1.0)
        return 25e-6 * unit * np.sin(2 * np.pi * 2.0 * t) * ease**3 * (10.0 - 15.0 * ease + 6.0 * ease**2)
    fade = np.clip(np.minimum(t, 1.0 - t) / 0.1, 0.0, 1.0)
    return 20e-6 * unit * fade * scipy.signal.chirp(t, 10.0, 1.0, 70.0)


def axes_shown(effect: Effect, machine: Machine) -> tuple[Axis, Axis | None]:
    """The axis of the picture, and the source axis of an effect that has one. Raises InputError if the machine has no such axis."""
    able = effect.axes(machine)
    if len(able) < 1 + effect.from_axis:
        raise InputError(f"{machine.path or machine.name}: no axis of this machine can have {effect.name}: it is for {effect.which_axes}")
    axis = next((a for a in able if a.name == effect.picture.axis), able[0])
    others = [a for a in able if a.name != axis.name]
    return axis, next((a for a in others if a.name == effect.picture.from_axis), others[0]) if effect.from_axis else None


def sizes_of(effect: Effect, machine: Machine, axis: Axis) -> dict[str, float]:
    """Parameters of the picture: as given, or the middle of the usual range."""
    return {p.name: sum(p.usual_range(machine, axis)) / 2.0 for p in effect.parameters if not p.shape} | dict(effect.picture.sizes)


def traces_of(effect: Effect, machine: Machine) -> tuple[Axis, Trace, Trace, Setting]:
    """The shown axis, the runs without and with the effect, and its setting."""
    shown = effect.picture
    axis, pushing = axes_shown(effect, machine)
    also = [a for a in shown.with_axes if a in machine.axis_names]
    few = machine.with_axes([axis.name, *also, *([pushing.name] if pushing else [])])
    if shown.feedforward:
        few = few.with_feedforward(shown.feedforward)
    if pushing:
        push, steady = setpoint("acceleration", few.axis(pushing.name)), setpoint("constant speed", axis)
        count = max(len(steady), len(push) + 200)
        padded = np.pad(push, (200, count - 200 - len(push)), mode="edge")
        moves = {axis.name: np.pad(steady, (0, count - len(steady)), mode="edge"), pushing.name: padded}
    else:
        moves = {axis.name: setpoint(shown.move, axis)}
    points = Setpoints(np.column_stack([moves.get(a.name, np.zeros(len(moves[axis.name]))) for a in few.axes]), _PERIOD)
    setting = Setting(effect, axis.name, sizes_of(effect, few, axis), pushing.name if pushing else None)
    without, having = (
        simulate(m, points, started_at=shown.started_at).trace for m in (few, with_effects(few, [*settings_of(few), setting]))
    )
    return axis, without, having, setting


def draw_effect(effect: Effect, machine: Machine, path: Path) -> Path:
    """Write the picture of an effect: speed of the set point, error without the delay, current, motor minus scale, with and without it."""
    axis, without, having, setting = traces_of(effect, machine)
    units, moving = AXIS_UNITS[axis.kind], setting.from_axis or axis.name
    effort = f"{'motor current' if axis.effort == 'current' else axis.effort}\n{axis.effort_unit}"
    rows = (
        (f"speed of {moving}\n{units.speed[0]}", lambda t: units.speed[1] * np.gradient(t.get(moving, "setpoint"), t.period)),
        (f"error less delay\n{units.error[0]}", lambda t: units.error[1] * error_without_delay(t, axis)),
        (
            effort,
            lambda t: uniform_filter1d(t.get(axis.name, axis.effort), max(1, round(effect.picture.smooth_s / t.period)), mode="nearest"),
        ),
        (f"motor − scale\n{units.error[0]}", lambda t: units.error[1] * motor_minus_scale(t, axis.name)),
    )
    grey, colour = hexadecimal(SETPOINT_COLOUR), hexadecimal(axis_colour(axis.name))
    figure, grid = new_figure(4, 1, 8.6, 1.55, sharex=True, height_ratios=(0.7, 1, 1, 1))
    places = grid[:, 0]
    for place, (label, of) in zip(places, rows):
        # the curve without the effect is wider and below, so that both are visible where they agree
        place.plot(without.time, of(without), color=grey, linewidth=2.6, alpha=0.75)
        if place is not places[0]:
            place.plot(having.time, of(having), color=colour, linewidth=1.1)
        place.set_ylabel(label)
        place.margins(x=0.0)
        floor(place, 1e-3 * (1.0 if label != effort else 10.0))
    figure.legend(places[-1].lines, ["without", "with"], loc="lower right", ncols=2, frameon=False, borderaxespad=0.1)
    places[-1].set_xlabel("time in s")
    figure.align_ylabels(places)
    figure.suptitle(setting_text(setting, machine), x=0.01, ha="left", size=11, weight="bold")
    save_png(figure, path, 80)
    if path.suffix.lower() == ".png":
        quantised(path)
    return path


def floor(place: Any, smallest: float) -> None:
    """Limit the vertical scale to at least `smallest`, so that rounding errors are drawn as zero."""
    low, high = place.get_ylim()
    if high - low < smallest:
        middle = (low + high) / 2.0
        place.set_ylim(middle - smallest, middle + smallest)


def quantised(path: Path) -> None:
    """Reduce the colours of an image, to a third of the file size."""
    from PIL import Image

    Image.open(path).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)
