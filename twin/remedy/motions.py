"""Motions that judge a remedy: the program of the command, and standard circles at three feeds and radii."""

import math

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.remedy.predict import Motionful, motionful
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of

CIRCLES = ((0.05, 3.0), (0.05, 1.0), (0.025, 6.0))
"""Radius [m] and feed [m/min] of the standard circles; the first one is judged if no program is given."""
TURNS = 2.25
RAMP_S = 0.3
SHARE = 0.4
"""Largest share of the travel for the radius of a circle, and of the largest speed and acceleration for its motion."""


def given_motion(name: str, trace: Trace, machine: Machine) -> Motionful:
    """The set points of a trace."""
    setpoints = setpoints_of(trace, machine)
    check_travel(setpoints, machine, name)
    return motionful(name, setpoints, machine)


def slowed(motion: Motionful, machine: Machine, override: float) -> Motionful:
    """A motion at a share of its feed: speeds times `override`, accelerations its square, jerk its cube."""
    points = motion.setpoints
    times = np.arange(0.0, points.duration / override, points.period) * override
    return motionful(f"{motion.name} at {override:.0%} of its feed", Setpoints(points.at(times), points.period), machine)


def standard_motions(machine: Machine) -> list[Motionful]:
    """Circles of the first two axes of a kind; of a machine with one axis, the sines that it would make on them."""
    kinds = [[a for a in machine.axes if a.kind == kind] for kind in ("linear", "rotary")]
    axes = next((own[:2] for own in kinds if len(own) > 1), next((own for own in kinds if own), []))
    if not axes:
        raise InputError(f"machine {machine.name}: has no axis; describe one in the machine file")
    return [_circle(machine, axes, radius, feed / 60.0) for radius, feed in CIRCLES]


def _circle(machine: Machine, axes: list[Axis], radius: float, feed: float) -> Motionful:
    if axes[0].kind == "rotary":  # 0.05 m stand for 5 degrees
        radius, feed = radius * math.radians(100.0), feed * math.radians(100.0)
    reach = min((0.5 * (a.travel[1] - a.travel[0]) for a in axes), default=math.inf)
    radius = min(radius, SHARE * reach)
    feed = min(feed, SHARE * min(a.max_velocity for a in axes), math.sqrt(SHARE * min(a.max_acceleration for a in axes) * radius))
    period, rate = machine.sample_period, feed / radius
    time = np.arange(0.0, TURNS * 2.0 * math.pi / rate + RAMP_S, period)
    phase = rate * period * np.cumsum(0.5 - 0.5 * np.cos(np.pi * np.minimum(time / RAMP_S, 1.0)))
    waves = dict(zip((axis.name for axis in axes), (np.cos(phase) - 1.0, np.sin(phase))))
    position = np.zeros((len(time), len(machine.axes)))
    for a, axis in enumerate(machine.axes):
        low, high = axis.travel
        middle = 0.5 * (low + high) if math.isfinite(low) and math.isfinite(high) else 0.0
        if axis.name in waves:
            position[:, a] = middle + radius * waves[axis.name]
        elif not low <= 0.0 <= high:
            position[:, a] = middle
    unit, factor = ("mm", 1e3) if axes[0].kind == "linear" else ("deg", 180.0 / math.pi)
    name = f"circle {'/'.join(a.name for a in axes)}, radius {radius * factor:.3g} {unit}, {feed * factor * 60:.4g} {unit}/min"
    return motionful(name, Setpoints(position, period), machine)
