"""Draw the picture of an effect: a short move with the effect (colour of the axis) and without it (grey)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import chirp

from twin.effects import Effect, settings_of, with_effects
from twin.effects.picture import Move
from twin.errors import InputError
from twin.files import beside
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.report.colours import SETPOINT_COLOUR, axis_colour, hexadecimal
from twin.simulation.errors_of_run import delayed_set_point
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.simulation.two_encoders import motor_minus_scale
from twin.units import ARCSEC, AXIS_UNITS

_PERIOD = 1e-3


def setpoint(move: Move, axis: Axis) -> np.ndarray:
    """Set points (sample,) of a move at 1 ms."""
    unit = 1.0 if axis.kind == "linear" else 6.0  # scale of the moves of a rotary axis [rad/m]
    slow = {"slow": (0.004, 0.010), "reversal": (0.0015, 0.010)}
    if move in slow:
        distance, speed = slow[move]
        return moves_in_turn(0.0, [distance * unit, -distance * unit], speed * unit, 0.5 * unit, 20.0 * unit, 0.05, _PERIOD)[1]
    if move == "constant speed":
        return moves_in_turn(0.0, [0.04 * unit, -0.04 * unit], 0.05 * unit, 1.0 * unit, 40.0 * unit, 0.05, _PERIOD)[1]
    if move == "jerk":
        return moves_in_turn(0.0, [0.02 * unit], 0.1 * unit, 2.0 * unit, 2000.0 * unit, 0.15, _PERIOD)[1]
    if move == "turn":
        return moves_in_turn(0.0, [2 * math.pi], 2.0, 5.0, 50.0, 0.1, _PERIOD)[1]
    if move == "gentle":
        return moves_in_turn(0.0, [0.15 * unit, -0.15 * unit], 0.3 * unit, 1.0 * unit, 20.0 * unit, 0.08, _PERIOD)[1]
    if move == "again":
        return moves_in_turn(0.0, [0.0015 * unit, -0.0015 * unit] * 10, 0.010 * unit, 0.5 * unit, 20.0 * unit, 0.2, _PERIOD)[1]
    t = np.arange(1101) * _PERIOD
    if move == "micro":
        ease = np.minimum(t / 0.25, 1.0)
        return 25e-6 * unit * np.sin(2 * np.pi * 2.0 * t) * ease**3 * (10.0 - 15.0 * ease + 6.0 * ease**2)
    if move == "chirp":
        fade = np.clip(np.minimum(t, 1.0 - t) / 0.1, 0.0, 1.0)
        return 20e-6 * unit * fade * chirp(t, 10.0, 1.0, 70.0)
    return moves_in_turn(0.0, [0.05 * unit, -0.05 * unit], 0.25 * unit, axis.max_acceleration, 100.0 * unit, 0.08, _PERIOD)[1]


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
    usual = {p.name: sum(p.usual_range(machine, axis)) / 2.0 for p in effect.parameters if not p.shape}
    return {**usual, **effect.picture.sizes}


def traces_of(effect: Effect, machine: Machine) -> tuple[Axis, Trace, Trace, dict[str, float]]:
    """The shown axis, the runs without and with the effect, and its parameters."""
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
    position = np.column_stack([moves.get(a.name, np.zeros(len(moves[axis.name]))) for a in few.axes])
    sizes = sizes_of(effect, few, axis)
    from_axis = {"from_axis": pushing.name} if pushing else {}
    affected = with_effects(few, [*settings_of(few), {"name": effect.name, "axis": axis.name, **from_axis, **sizes}])
    points = Setpoints(position, _PERIOD)
    without, having = (simulate(m, points, started_at=shown.started_at).trace for m in (few, affected))
    return axis, without, having, sizes


def draw_effect(effect: Effect, machine: Machine, path: Path) -> Path:
    """Write the picture of an effect: speed of the set point, error without the delay, current, motor minus scale, with and without it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    axis, without, having, sizes = traces_of(effect, machine)
    shown, pushing = effect.picture, axes_shown(effect, machine)[1]
    units = AXIS_UNITS[axis.kind]
    error_unit, error_factor = units.error
    speed_unit, speed_factor = units.speed
    moving = pushing.name if pushing else axis.name
    effort = f"{'motor current' if axis.effort == 'current' else axis.effort}\n{axis.effort_unit}"
    rows = (
        (f"speed of {moving}\n{speed_unit}", lambda t: speed_factor * np.gradient(t.get(moving, "setpoint"), t.period)),
        (f"error less delay\n{error_unit}", lambda t: error_factor * (delayed_set_point(t, axis) - t.get(axis.name, "position"))),
        (effort, lambda t: smoothed(t.get(axis.name, axis.effort), shown.smooth_s, t.period)),
        (f"motor − scale\n{error_unit}", lambda t: error_factor * motor_minus_scale(t, axis.name)),
    )
    grey, colour = hexadecimal(SETPOINT_COLOUR), hexadecimal(axis_colour(axis.name))
    style: Any = {
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.color": "#e4e6ea",
        "axes.titlesize": 10,
    }
    with plt.rc_context(style):
        figure, places = plt.subplots(4, 1, figsize=(8.6, 6.2), sharex=True, layout="constrained", height_ratios=(0.7, 1, 1, 1))
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
        values = ", ".join(f"{n} = {readable(sizes[n], effect.parameter(n).unit(axis))}" for n in sizes)
        source = f" from {pushing.name}" if pushing else ""
        figure.suptitle(f"{effect.name} on {axis.name}{source}: {values}", x=0.01, ha="left", size=11, weight="bold")
        with beside(path) as partial:
            figure.savefig(partial, dpi=80)
        plt.close(figure)
    if path.suffix.lower() == ".png":
        quantised(path)
    return path


def smoothed(values: np.ndarray, width: float, period: float) -> np.ndarray:
    """Moving average with edge padding."""
    count = max(1, round(width / period))
    padded = np.pad(values, (count // 2, count - 1 - count // 2), mode="edge")
    return np.convolve(padded, np.full(count, 1.0 / count), "valid")


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


READABLE = {
    "m": ((1e-3, 1e6, "um"), (1.0, 1e3, "mm")),
    "rad": ((1e-2, 1.0 / ARCSEC, "arcsec"),),
    "s": ((0.1, 1e3, "ms"),),
    "m/s": ((1e-4, 1e6, "um/s"), (1.0, 1e3, "mm/s")),
    "N/m": ((math.inf, 1e-6, "N/um"),),
}
"""Display units of small values: (upper limit, factor, name)."""


def display_unit(value: float, unit: str) -> tuple[str, float]:
    """Display unit of a value, and the factor to it."""
    return next(((name, factor) for below, factor, name in READABLE.get(unit, ()) if abs(value) < below), (unit, 1.0))


def readable(value: float, unit: str) -> str:
    """A value with its display unit."""
    name, factor = display_unit(value, unit)
    if name != unit:
        return f"{value * factor:.3g} {name}"
    return f"{value:.4g} {unit}" if unit != "1" else f"{value:.6g}"
