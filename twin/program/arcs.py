"""Circle geometry of G2 and G3: centre, sense and angle from I J K or the radius."""

import math

import numpy as np

from twin.program.expressions import WordError

CHORD = 0.5e-6
"""Largest distance of the chords from a spline [m]."""
MOST_CHORDS = 10_000
CLOSING_TOLERANCE = 10e-6
"""Radii at start and end of an arc may differ by this [m]; the difference is spread along the arc. Chosen."""

PLANES = {17: (0, 1, 2), 18: (2, 0, 1), 19: (1, 2, 0)}
"""First and second axis of the working plane and its normal."""


Arc = tuple[np.ndarray, np.ndarray, float]
"""Centre (3,), axis (3,) and angle > 0 [rad], right-handed about the axis."""


class ArcError(WordError):
    """A geometrically impossible arc."""

    def __init__(self, message: str) -> None:
        super().__init__(message, 0)


def centre_from_radius(start: np.ndarray, end: np.ndarray, radius: float, plane: int, clockwise: bool) -> np.ndarray:
    """Centre of an arc from its radius: a positive radius gives less than half a circle, a negative one more."""
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


def through(start: np.ndarray, middle: np.ndarray, end: np.ndarray) -> Arc:
    """Centre (3,), normal (3,) and angle of the arc in space from start through a middle point to the end (CIP)."""
    u, v = middle - start, end - start
    normal = np.cross(u, v)
    square = float(normal @ normal)
    if square < 1e-24:
        raise ArcError("the three points of the arc lie on one line, or two of them are the same; correct the middle point (I1= J1= K1=)")
    centre = start + (np.cross(normal, u) * float(v @ v) + np.cross(v, normal) * float(u @ u)) / (2.0 * square)
    axis = normal / math.sqrt(square)
    return centre, axis, angle_between(start - centre, end - centre, axis)


def tangential(start: np.ndarray, direction: np.ndarray, end: np.ndarray, plane: int) -> Arc:
    """Centre, normal and angle of the arc in the plane that starts tangent to a direction (3,) (CT)."""
    a, b, c = PLANES[plane]
    t = np.array([direction[a], direction[b]])
    chord = np.array([end[a] - start[a], end[b] - start[b]])
    left = np.array([-t[1], t[0]])
    side = float(chord @ left)
    if math.hypot(*t) < 1e-9 or abs(side) < 1e-12:
        raise ArcError("the tangent arc would be a line; use G1")
    radius = float(chord @ chord) * math.hypot(*t) / (2.0 * side)
    centre, normal = start.copy(), np.zeros(3)
    centre[[a, b]] = np.array([start[a], start[b]]) + radius * left / math.hypot(*t)
    normal[c] = math.copysign(1.0, side)
    return centre, normal, angle_between(start - centre, end - centre, normal)


def angle_between(first: np.ndarray, last: np.ndarray, normal: np.ndarray, least: float = 1e-9) -> float:
    """Angle from one arm (3,) to the other about the normal; one below `least` is a whole turn."""
    angle = math.atan2(float(np.cross(first, last) @ normal), float(first @ last)) % (2.0 * math.pi)
    return angle if angle > least else 2.0 * math.pi


def bezier_chords(control: np.ndarray) -> np.ndarray:
    """The ends (n, 3) [m] of chords along a cubic Bezier curve with control points (4, 3), none further from it than CHORD."""
    bend = 6.0 * float(np.linalg.norm(np.diff(control, 2, axis=0), axis=1).max())
    count = min(MOST_CHORDS, max(1, math.ceil(math.sqrt(bend / (8.0 * CHORD)))))
    u = np.linspace(0.0, 1.0, count + 1)[1:, None]
    return np.asarray((1 - u) ** 3 * control[0] + 3 * u * (1 - u) ** 2 * control[1] + 3 * u**2 * (1 - u) * control[2] + u**3 * control[3])
