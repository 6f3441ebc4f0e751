"""The programmed curve of one stretch without a stop: lines and arcs in the five coordinates x y z A C.

x y z are the tool tip in the part frame under TRAORI, otherwise the axes X Y Z; A and C are always the axes. Each element
runs over an interval of the path parameter u [m] with constant speed of all its parts; the length of an element is

    du^2 = |d(x y z)|^2 + r^2 (dA^2 + dC^2),     r = REFERENCE_RADIUS

so that a pure rotation also has a length. With the share s = 0 .. 1 of its interval every element, line or helix, is the curve

    w = base + s step + cos(s angle) e1 + sin(s angle) e2,     angle = e1 = e2 = 0 on a line
"""

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled

REFERENCE_RADIUS = 0.1
"""Radius [m] that turns rad into path length for A and C (as FGREF on the control); only the parametrisation depends on it."""


class Elements(NamedTuple):
    """Arrays of the elements e = 0 .. E - 1 of a stretch; `u` (E + 1,) are the ends of their parameter intervals."""

    u: np.ndarray
    base: np.ndarray  # (E, 5) start of a line; centre of an arc at the height of its start, with A and C there
    step: np.ndarray  # (E, 5) way of a line; pitch of a helix, with the way of A and C
    radius1: np.ndarray  # (E, 3) e1, from the centre to the start
    radius2: np.ndarray  # (E, 3) e2, perpendicular to e1 in the sense of motion
    angle: np.ndarray  # (E,) angle [rad] > 0 of arcs


def ways(e: Elements, rotary: np.ndarray) -> np.ndarray:
    """Way (E,) that the feed of each element counts: of the tip [m], or of A and C together [rad] where `rotary` (E,)."""
    turn = np.linalg.norm(e.step[:, 3:], axis=1)
    arc = np.sqrt(np.maximum(np.diff(e.u) ** 2 - (REFERENCE_RADIUS * turn) ** 2, 0.0))
    return np.where(rotary, turn, np.where(e.angle > 0.0, arc, np.linalg.norm(e.step[:, :3], axis=1)))


@compiled(allocates=True)
def find(u, at, hint):
    """Index of the interval of the increasing array `u` that holds `at`, searched from `hint`."""
    last = u.shape[0] - 2
    i = min(max(hint, 0), last)
    while i < last and at >= u[i + 1]:
        i += 1
    while i > 0 and at < u[i]:
        i -= 1
    return i


@compiled(allocates=True)
def point(e, i, at, out):
    """Programmed point (5,) at parameter `at` of element i."""
    share = (at - e.u[i]) / (e.u[i + 1] - e.u[i])
    for k in range(5):
        out[k] = e.base[i, k] + share * e.step[i, k]
    if e.angle[i] > 0.0:
        cos, sin = np.cos(share * e.angle[i]), np.sin(share * e.angle[i])
        for k in range(3):
            out[k] += cos * e.radius1[i, k] + sin * e.radius2[i, k]


@compiled(allocates=True)
def slope(e, i, at_end, out):
    """dw/du (5,) at the start or the end of element i."""
    length = e.u[i + 1] - e.u[i]
    for k in range(5):
        out[k] = e.step[i, k] / length
    if e.angle[i] > 0.0:
        phi = e.angle[i] if at_end else 0.0
        cos, sin = np.cos(phi), np.sin(phi)
        for k in range(3):
            out[k] += e.angle[i] * (cos * e.radius2[i, k] - sin * e.radius1[i, k]) / length


@compiled(allocates=True)
def mean(e, low, high, hint, out):
    """Mean of the programmed point over [low, high] into `out` (5,): the sum of its integrals over each element."""
    out[:] = 0.0
    i, last, at = find(e.u, low, hint), e.u.shape[0] - 2, low
    while i <= last and at < high:
        upto, length, phi = min(high, e.u[i + 1]), e.u[i + 1] - e.u[i], e.angle[i]
        a, b = (at - e.u[i]) / length, (upto - e.u[i]) / length
        half = 0.5 * (b * b - a * a) * length
        for k in range(5):
            out[k] += e.base[i, k] * (upto - at) + half * e.step[i, k]
        if phi > 0.0:
            sines, cosines = (np.sin(b * phi) - np.sin(a * phi)) / phi, (np.cos(a * phi) - np.cos(b * phi)) / phi
            for k in range(3):
                out[k] += (sines * e.radius1[i, k] + cosines * e.radius2[i, k]) * length
        at, i = upto, i + 1
    for k in range(5):
        out[k] /= high - low
