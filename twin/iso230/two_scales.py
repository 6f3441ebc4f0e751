"""What two scales would have shown of a circle that a ballbar measured: a campaign for `twin diagnose`.

A ballbar shows the distance from its centre. It does not show the way along the circle, nor the scales. Its radius is therefore taken apart over the
angle, both directions in one linear problem:

    radius(measured) - radius(twin) = sum_j c_j u . e_j + rest

u is the unit vector along the radius, e_j (sample, 2) what one cause does to the two axes: an effect of the library at about its usual size, simulated; an
error of a scale or of the squareness; a displaced centre of the bar. As few c_j as the radius asks for differ from 0 (`few_causes`), each radius is known to
SIGMA. Scales show neither their own errors nor the squareness nor where the bar stands, so that

    two scales = twin + sum over effects c_j e_j + u rest

Set points start and end at rest, OVERLAP before and behind the circle, so that the twin runs the circle itself as the machine did. Beside the circle the rest
fades out. Along the circle this is the most probable motion, no measurement. Lengths in m, angles in rad.
"""

from __future__ import annotations

from collections.abc import Mapping
import contextlib
from dataclasses import dataclass, replace
import math

import numpy as np

from twin.effects import EFFECTS, Effect, Setting, with_effects
from twin.errors import InputError, TwinError
from twin.geometry.scurve import moves_in_turn
from twin.iso230.circles import CirclePath, CircleTest
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

PERIOD = 1e-3
"""Sample period of the traces [s]."""
SIGMA = 1e-6
"""Standard deviation of one radius [m]: noise, and what no cause here describes."""
OVERLAP, FADE = math.radians(90.0), math.radians(20.0)
"""What is run beside the measured circle, on both sides, and where in it the rest fades out."""
ACCELERATION, JERK = 1.0, 10.0
"""Along the circle, to get up to the feed [m/s2, m/s3]."""
EACH = math.radians(0.5)
"""The linear problem takes one radius each so much of the circle."""
USUAL_SLOPE, USUAL_CENTRE = 30e-6, 1e-3
"""Usual sizes of a scale's error and of the squareness [m/m], and of the bar's displacement [m]."""
ROUNDS = 4
"""Of the linear problem, each about the sizes found before."""
GEOMETRY = ("scale {0}", "scale {1}", "squareness")


@dataclass(frozen=True)
class TwoScales:
    """`traces` by direction: set points and positions of both axes. `slopes` [m/m]: value and standard deviation of what the scales do not show, by name."""

    traces: Mapping[str, Trace]
    slopes: Mapping[str, tuple[float, float]]


def two_scales(test: CircleTest, machine: Machine) -> TwoScales:
    """Set points of a ballbar's circle and what two scales would have shown of it; `machine` is the twin, with the feedforward of the test.

    Raises InputError where the feed of the program is not known.
    """
    if not test.feed > 0.0:
        raise InputError("a ballbar's campaign needs the feed of its program; give --feed-mm-per-min")
    commanded = {direction: _commanded(test, path) for direction, path in test.paths.items()}
    twin = {direction: _positions(machine, trace) for direction, trace in commanded.items()}
    directions = list(commanded)
    ends = np.cumsum([len(twin[d]) for d in directions])[:-1]
    position = np.concatenate([twin[d] for d in directions])
    distance = np.hypot(*position.T)
    radial = position / distance[:, None]
    fade = np.concatenate([_fade(test.paths[d], twin[d]) for d in directions])
    measured = np.concatenate([test.paths[d].at(np.arctan2(*twin[d].T[::-1])) for d in directions])

    settings, effects = _effects(machine, test.axes, commanded, twin)
    causes = np.array([*effects, *_geometry(position)])  # (cause, sample, 2)
    positive = np.array([*(_is_positive(s) for s in settings), *[False] * (len(causes) - len(settings))])
    rows = np.flatnonzero(fade == 1.0)[:: max(1, round(EACH * test.radius / test.feed / PERIOD))]
    for again in range(ROUNDS):
        seen = np.einsum("jsk,sk->sj", causes, radial)
        size, covariance = few_causes(seen[rows] / SIGMA, (measured - distance)[rows] / SIGMA, positive)
        # what an effect does is not quite in proportion to its size: once more at the sizes found
        for j in np.flatnonzero(size[: len(settings)]) if again < ROUNDS - 1 else ():
            with contextlib.suppress(TwinError):  # this machine cannot have so much of it
                causes[j] = _response(machine, _of_size(settings[j], size[j]), commanded, twin) / size[j]
    rest = fade * (measured - distance - seen @ size)
    scales = position + np.tensordot(size[: len(effects)], causes[: len(effects)], 1) + radial * rest[:, None]

    traces = {}
    for direction, part in zip(directions, np.split(scales, ends)):
        trace = commanded[direction]
        signals = {**trace.signals, **{(axis, "position"): part[:, k] for k, axis in enumerate(test.axes)}}
        traces[direction] = Trace(trace.time, signals, trace.kinds)
    deviation = np.sqrt(np.diag(covariance))
    first = len(effects)
    slopes = {
        name.format(*test.axes): (float(size[first + i] * USUAL_SLOPE), float(deviation[first + i] * USUAL_SLOPE))
        for i, name in enumerate(GEOMETRY)
    }
    return TwoScales(traces, slopes)


def few_causes(matrix: np.ndarray, difference: np.ndarray, positive: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sizes (cause,) of the most probable set of causes, 0 of the others, and the covariance of all where none is left out.

    Each c_j of a set is normal about 0 with a standard deviation of 1. Causes enter, are exchanged and leave one at a time, as long as the
    probability of the difference grows: by more than a choice among all causes is worth, where one enters. Those that are `positive`
    (cause,) cannot be less than 0.
    """
    normal, right = matrix.T @ matrix, matrix.T @ difference
    count = len(right)

    def sizes(causes: list[int]) -> np.ndarray:
        return np.linalg.solve(normal[np.ix_(causes, causes)] + np.eye(len(causes)), right[causes])

    def worth(causes: list[int]) -> float:
        found = sizes(causes)
        if (found[positive[causes]] < 0.0).any():
            return -math.inf
        volume = np.linalg.slogdet(normal[np.ix_(causes, causes)] + np.eye(len(causes)))[1]
        return 0.5 * float(right[causes] @ found) - 0.5 * float(volume) - math.log(count) * len(causes)

    best: list[int] = []
    while True:
        others = [j for j in range(count) if j not in best]
        entered = [[*best, j] for j in others]
        exchanged = [[*best[:i], *best[i + 1 :], j] for i in range(len(best)) for j in others]
        left = [[*best[:i], *best[i + 1 :]] for i in range(len(best))]
        next_ = max([*entered, *exchanged, *left], key=worth)
        if worth(next_) <= worth(best) + 1e-9:
            break
        best = next_
    size = np.zeros(count)
    size[best] = sizes(best)
    return size, np.linalg.inv(normal + np.eye(count))


def _commanded(test: CircleTest, path: CirclePath) -> Trace:
    """Set points of one direction, from rest to rest."""
    sweep = abs(float(path.angle[-1] - path.angle[0])) + 2.0 * OVERLAP
    # a small circle at high feed is too short for the usual acceleration
    harder = max(1.0, 2.0 * test.feed**2 / ACCELERATION / (OVERLAP * test.radius))
    times, way = moves_in_turn(0.0, [sweep * test.radius], test.feed, harder * ACCELERATION, harder * JERK, 0.1, PERIOD)
    turn = 1.0 if path.direction == "ccw" else -1.0
    angle = path.angle[0] + turn * (way / test.radius - OVERLAP)
    signals = {(axis, "setpoint"): test.radius * wave for axis, wave in zip(test.axes, (np.cos(angle), np.sin(angle)))}
    return Trace(times, signals, dict.fromkeys(test.axes, "linear"))


def _fade(path: CirclePath, position: np.ndarray) -> np.ndarray:
    """1 on the measured part of the circle, down to 0 beside it, (sample,)."""
    turn = 1.0 if path.direction == "ccw" else -1.0
    angle = turn * np.unwrap(np.arctan2(*position.T[::-1]))
    first, last = turn * path.angle[0], turn * path.angle[-1]
    angle += 2.0 * math.pi * round((first + last - angle[0] - angle[-1]) / (4.0 * math.pi))
    return np.clip(1.0 - np.maximum(first - angle, angle - last) / FADE, 0.0, 1.0)


def _positions(machine: Machine, commanded: Trace) -> np.ndarray:
    """Where the axes of the set points are on a machine, (sample, axis)."""
    axes = [axis for axis in machine.axis_names if axis in commanded.axes]
    machine = machine.with_axes(axes)
    run = simulate(machine, setpoints_of(commanded, machine), sample_period=PERIOD)
    return run.trace.matrix("position", list(commanded.axes))


def _effects(
    machine: Machine, axes: tuple[str, str], commanded: Mapping[str, Trace], twin: Mapping[str, np.ndarray]
) -> tuple[list[Setting], list[np.ndarray]]:
    """The effects that either axis can have, and what each does to both axes, [(sample, 2)]."""
    settings, out = [], []
    for axis in axes:
        for effect in EFFECTS.values():
            setting = _usual(effect, machine, machine.axis(axis))
            if setting is not None:
                with contextlib.suppress(TwinError):  # this machine cannot have it at this size
                    out.append(_response(machine, setting, commanded, twin))
                    settings.append(setting)
    return settings, out


def _response(machine: Machine, setting: Setting, commanded: Mapping[str, Trace], twin: Mapping[str, np.ndarray]) -> np.ndarray:
    """What an effect of one axis changes, (sample, 2)."""
    name = setting.axis
    varied = with_effects(machine.with_axes([name]), [setting.table()])
    changes = []
    for direction, trace in commanded.items():
        alone = Trace(trace.time, {(name, "setpoint"): trace.get(name, "setpoint")}, {name: "linear"})
        change = np.zeros_like(twin[direction])
        k = list(trace.axes).index(name)
        change[:, k] = _positions(varied, alone)[:, 0] - twin[direction][:, k]
        changes.append(change)
    return np.concatenate(changes)


def _is_positive(setting: Setting) -> bool:
    """Whether the effect cannot be less than nothing."""
    size = setting.effect.size
    return size.is_spring or size.low == size.neutral


def _of_size(setting: Setting, times: float) -> Setting:
    """The effect `times` as large."""
    size = setting.effect.size
    neutral = size.neutral or 0.0
    value = setting.size / times if size.is_spring else neutral + times * (setting.size - neutral)
    return replace(setting, parameters={**setting.parameters, size.name: min(max(value, size.low), size.high)})


def _usual(effect: Effect, machine: Machine, axis: Axis) -> Setting | None:
    """The effect at half the greatest deviation that is usual; None where it has no such size, or is one of the scale itself."""
    waves = effect.phase is not None  # of unknown wavelength and phase: what they do stays in the rest
    if effect.block == "measurement" or effect.from_axis or waves or not effect.can_have(machine, axis):
        return None
    size = effect.size
    if not (size.is_scaled or size.is_spring):
        return None
    low, high = size.usual_range(machine, axis)
    if not (math.isfinite(low) and math.isfinite(high)):
        return None
    neutral = size.neutral or 0.0
    values = {size.name: math.sqrt(low * high) if size.is_spring else neutral + 0.5 * (high - neutral)}
    for parameter in effect.parameters:
        if parameter.fitted is not None:
            values[parameter.name] = parameter.fitted(machine, axis, values)
        elif parameter is not size and parameter.default is None and parameter.usual is not None:
            low, high = parameter.usual_range(machine, axis)
            values[parameter.name] = math.sqrt(low * high) if parameter.logarithmic else 0.5 * (low + high)
    return Setting(effect, axis.name, values)


def _geometry(position: np.ndarray) -> list[np.ndarray]:
    """What scales' errors, squareness and a displaced bar do, [(sample, 2)]."""
    x, y = position.T
    nothing, one = np.zeros(len(x)), np.ones(len(x))
    slopes = [(x, nothing), (nothing, y), (y, nothing)]
    return [USUAL_SLOPE * np.column_stack(e) for e in slopes] + [
        USUAL_CENTRE * np.column_stack(e) for e in ((one, nothing), (nothing, one))
    ]
