"""A ballbar circle as a campaign for `twin diagnose`: one run with the set points of both directions and the measured radii.

The set points start and end at rest, OVERLAP before and after each measured direction, so that the twin runs the circle like the
machine. Deviations that a radius cannot separate (position of the bar, scale errors, squareness) are removed from measurement and
simulation (`twin.recordings.ballbar`); their sizes are those of measurement minus twin. Lengths in m, angles in rad.
"""

import math

import numpy as np

from twin.errors import InputError
from twin.geometry.scurve import jerk_limited_move, phases_of_move, sample_times, time_of_move
from twin.iso230.circles import CircleTest
from twin.machine.machine import Machine
from twin.recordings.ballbar import FINEST, GEOMETRY, OVERLAP, ballbar_of
from twin.recordings.campaign import MeasuredRun
from twin.recordings.roughness import SECOND_DIFFERENCE, robust_deviation
from twin.recordings.trace import Trace
from twin.simulation.recorded_times import simulated_period
from twin.simulation.run import simulate
from twin.simulation.setpoints import setpoints_of

ACCELERATION, JERK, DWELL = 1.0, 10.0, 0.1
"""Acceleration and jerk along the circle [m/s2, m/s3], and the dwell between the directions [s]."""
RESOLUTION = 1e-7
"""Resolution of a ballbar [m]."""


def ballbar_run(test: CircleTest, machine: Machine, feedforward: str | None) -> tuple[MeasuredRun, dict[str, float]]:
    """The run of a circle test, with set points and ballbar positions, and the slopes [m/m] of the removed deviations by name.

    Raises InputError if the feed of the program is unknown.
    """
    if not test.feed > 0.0:
        raise InputError("a ballbar's campaign needs the feed of its program; give --feed-mm-per-min")
    differences = [np.diff(path.distance, 2) for path in test.paths.values()]
    noise = max(robust_deviation(np.concatenate(differences)) / math.sqrt(SECOND_DIFFERENCE), RESOLUTION)
    commanded = _commanded(test)
    bar = ballbar_of(commanded, test.axes, noise)
    measured = np.zeros(len(commanded.time))
    for path in test.paths.values():
        turns_so = bar.measured & (np.gradient(bar.angle) * (path.angle[-1] - path.angle[0]) > 0.0)
        measured[turns_so] = path.at(bar.angle[turns_so]) - test.radius
    twin = machine.with_feedforward(feedforward).with_axes([axis for axis in machine.axis_names if axis in bar.axes])
    simulated = simulate(twin, setpoints_of(commanded, twin), sample_period=simulated_period(twin, commanded.period, bar))
    sizes = bar.sizes(measured - bar.deviation(simulated.trace))
    slopes = dict(zip((name.format(*test.axes) for name in GEOMETRY[2:]), sizes[2:] / test.radius))
    trace = Trace(commanded.time, {**commanded.signals, **bar.positions(measured)}, commanded.kinds)
    return MeasuredRun(f"circle_{test.name.lower()}", trace, feedforward, 0.0, ballbar=bar), slopes


def _commanded(test: CircleTest) -> Trace:
    """Set points from rest to rest: each direction, and between them the move to the start of the next one.

    Each reading coincides with a sample, because a reversal is shorter than the time between two readings.
    """
    spacing = float(np.median(np.abs(np.concatenate([np.diff(path.angle) for path in test.paths.values()]))))
    each = spacing * test.radius / test.feed
    period = each * math.ceil(FINEST / each - 1e-9)
    # a small circle at high feed needs a higher acceleration
    harder = max(1.0, 2.0 * test.feed**2 / ACCELERATION / (OVERLAP * test.radius))
    limits = test.feed, harder * ACCELERATION, harder * JERK
    moves: list[tuple[float, float]] = []  # start time, distance along the circle
    now, at, start = DWELL, 0.0, 0.0
    for path in test.paths.values():
        turn = 1.0 if path.direction == "ccw" else -1.0
        begin, end = path.angle[0] - turn * OVERLAP, path.angle[-1] + turn * OVERLAP
        across = math.remainder(begin - at, 2.0 * math.pi) * test.radius
        if not moves:
            start = begin
        elif abs(across) > 1e-9:
            moves.append((now, across))
            now += time_of_move(across, *limits) + DWELL
        t_j, t_a, _ = phases_of_move(abs(end - begin) * test.radius, *limits)
        first = 0.5 * (2.0 * t_j + t_a) + OVERLAP * test.radius / test.feed  # from the start of the move to the first reading
        now = math.ceil((now + first) / period) * period - first
        moves.append((now, (end - begin) * test.radius))
        now, at = now + time_of_move((end - begin) * test.radius, *limits) + DWELL, end
    times = sample_times(now, period)
    along = sum(jerk_limited_move(distance, *limits, times - begin) for begin, distance in moves)
    angle = start + along / test.radius
    signals = {(axis, "setpoint"): test.radius * wave for axis, wave in zip(test.axes, (np.cos(angle), np.sin(angle)))}
    return Trace(times, signals, dict.fromkeys(test.axes, "linear"))
