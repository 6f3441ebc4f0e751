"""Circle geometry of G2 and G3: centre, sense and angle from I J K or the radius."""

from __future__ import annotations

import math

import numpy as np

CLOSING_TOLERANCE = 10e-6
"""Radii at start and end of an arc may differ by this [m]; the difference is spread along the arc. Chosen."""

PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""First and second axis of the working plane and its normal."""


class ArcError(Exception):
    """An arc that cannot be; the reader adds the place."""


def from_centre(
    start: np.ndarray, end: np.ndarray, centre: np.ndarray, plane: int, clockwise: bool, turns: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre (3,), normal (3,) and angle > 0 of an arc in a plane; equal start and end are a full circle."""
    a, b, c = PLANES[plane]
    first = np.array([start[a] - centre[a], start[b] - centre[b]])
    last = np.array([end[a] - centre[a], end[b] - centre[b]])
    radius, radius_end = math.hypot(*first), math.hypot(*last)
    if radius < 1e-9:
        raise ArcError("the arc has no radius; give the centre with I J K (from the start) or the radius")
    if abs(radius - radius_end) > CLOSING_TOLERANCE:
        raise ArcError(
            f"the arc does not close: the radius is {radius * 1e3:.4f} mm at its start and {radius_end * 1e3:.4f} mm at its end; "
            "correct the end point or I J K (from the start; absolute as I=AC(..))"
        )
    sense = -1.0 if clockwise else 1.0
    angle = sense * (math.atan2(last[1], last[0]) - math.atan2(first[1], first[0]))
    angle %= 2.0 * math.pi
    if angle < 1e-9 or math.hypot(*(last - first)) < 1e-9:
        angle = 2.0 * math.pi
    normal = np.zeros(3)
    normal[c] = sense
    middle = np.array(start, float)
    middle[a], middle[b] = centre[a], centre[b]
    return middle, normal, angle + 2.0 * math.pi * turns


def centre_from_radius(start: np.ndarray, end: np.ndarray, radius: float, plane: int, clockwise: bool) -> np.ndarray:
    """Centre of an arc by its radius: less than half a circle for a positive radius, more for a negative one."""
    a, b, _ = PLANES[plane]
    chord = np.array([end[a] - start[a], end[b] - start[b]])
    half = 0.5 * math.hypot(*chord)
    if half < 1e-12:
        raise ArcError("a full circle cannot be given by its radius; give its centre with I J K")
    if half > abs(radius) + CLOSING_TOLERANCE:
        raise ArcError(
            f"the arc does not close: the radius {radius * 1e3:g} mm is less than half the distance of its ends, {half * 1e3:.4f} mm; correct it"
        )
    height = math.sqrt(max(0.0, radius * radius - half * half))
    side = 1.0 if (radius > 0) != clockwise else -1.0
    left = np.array([-chord[1], chord[0]]) / (2.0 * half)
    centre = np.array(start, float)
    centre[[a, b]] = np.array([start[a], start[b]]) + 0.5 * chord + side * height * left
    return centre
