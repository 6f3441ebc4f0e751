"""Circles in a recorded run: two linear axes whose set points run a full circle, in one or both directions."""

from itertools import combinations
import math

import numpy as np

from twin.errors import InputError
from twin.iso230.circles import LEAST_SWEEP, CirclePath, CircleTest, least_squares_circle
from twin.recordings.trace import Trace

ROUNDNESS, ROUNDING = 1e-4, 2e-6
"""Set points that deviate by less belong to a circle: share of the radius, and tolerance of the interpolator [m]."""
RADIAL = 0.05
"""Above this share of the speed along the radius a set point belongs to a lead-in."""
SMALLEST_RADIUS = 1e-3
"""Smallest radius [m]; smaller circles are corners."""
PLANES = (("X", "Y"), ("Y", "Z"), ("Z", "X"))
"""Planes in the order that defines counter-clockwise: ISO 841."""


def circles_of_trace(trace: Trace, signal: str = "position", where: str = "trace") -> list[CircleTest]:
    """All circle tests of a run, one per plane. `signal` is evaluated.

    Raises InputError if no two axes run a circle, or if the signal is missing.
    """
    linear = [a for a in trace.axes if trace.kinds.get(a) == "linear" and trace.moves(a)]
    planes = [p for p in PLANES if set(p) <= set(linear)]
    planes += [p for p in combinations(linear, 2) if not any(set(p) == set(q) for q in PLANES)]
    found = [test for plane in planes if (test := _circle(trace, plane, signal, where)) is not None]
    if not found:
        raise InputError(
            f"{where}: no two linear axes run a full circle; give a run with a circle in both directions (G2 and G3), or a table of readings"
        )
    return found


def _circle(trace: Trace, plane: tuple[str, str], signal: str, where: str) -> CircleTest | None:
    commanded = np.column_stack([trace.get(axis, "setpoint") for axis in plane])
    velocity = np.gradient(commanded, trace.period, axis=0)
    speed = np.hypot(*velocity.T)
    moving = speed > 1e-6
    if moving.sum() < 16:
        return None
    # exclude lead-ins by repeated fits
    inside = moving
    for _ in range(20):
        centre, radius = least_squares_circle(commanded[inside][:: max(1, int(inside.sum()) // 2000)])
        from_centre = commanded - centre
        near = np.abs(np.hypot(*from_centre.T) - radius) < ROUNDNESS * radius + ROUNDING
        along_radius = np.abs(np.einsum("ij,ij->i", velocity, from_centre)) < RADIAL * speed * radius
        before, inside = inside, moving & near & along_radius
        if inside.sum() < 16:
            return None
        if np.array_equal(before, inside):
            break
    if radius < SMALLEST_RADIUS:
        return None
    for axis in plane:
        if not trace.has(axis, signal):
            raise InputError(f"{where}: no {axis}.{signal} column for the circle in {''.join(plane)}; record the scale")
    measured = np.column_stack([trace.get(axis, signal) for axis in plane])
    paths: dict[str, CirclePath] = {}
    speeds = []
    for rows in _stretches(inside, commanded, centre):
        x, y = (measured[rows] - centre).T
        path = CirclePath(np.unwrap(np.arctan2(y, x)), np.hypot(x, y))
        if abs(path.angle[-1] - path.angle[0]) >= LEAST_SWEEP:
            paths[path.direction] = _middle_revolution(path)
            speeds.append(float(np.median(np.hypot(*np.gradient(commanded[rows], trace.period, axis=0).T))))
    return CircleTest(plane, float(radius), float(np.median(speeds)), paths) if paths else None


def _stretches(inside: np.ndarray, commanded: np.ndarray, centre: np.ndarray) -> list[np.ndarray]:
    """Rows of each stretch on the circle with one direction of rotation."""
    angle = np.unwrap(np.arctan2(*(commanded - centre).T[::-1]))
    turn = np.sign(np.gradient(angle)) * inside
    edges = np.flatnonzero(np.diff(turn)) + 1
    return [rows for rows in np.split(np.arange(len(turn)), edges) if len(rows) > 16 and turn[rows[0]] != 0]


def _middle_revolution(path: CirclePath) -> CirclePath:
    """The middle revolution of a longer path; its ends contain start and stop."""
    swept = np.abs(path.angle - path.angle[0])
    spare = swept[-1] - 2.0 * math.pi
    if spare <= 0.0:
        return path
    keep = (swept >= spare / 2.0) & (swept <= spare / 2.0 + 2.0 * math.pi)
    return CirclePath(path.angle[keep], path.distance[keep])
