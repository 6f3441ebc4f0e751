"""The path of the axes: q(u) and its derivatives from the spline w(u), through the five-axis transformation under TRAORI.

Without TRAORI q = w. With it X Y Z hold the tip while the rotary axes turn the part, the tool or both:

    b = part_origin + part_axes p, turned by those of turning and tilting axis that are on the table (Rot(b - anchor) + anchor)
    t = tool_tip, turned by those of tilting and turning axis that are on the head
    (X, Y, Z) = slides^-1 (b - t)

The chain rule to the third derivative is done on jets (f, f', f'', f'''), with Rot = P + cos (1 - P) + sin K.
"""

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.geometry.kinematics import Kinematics


class Frames(NamedTuple):
    """The transformation as arrays for compiled code; `active` is False without TRAORI."""

    active: bool
    slides_inverse: np.ndarray
    part_axes: np.ndarray
    part_origin: np.ndarray
    tool_tip: np.ndarray
    on_table: np.ndarray  # of tilting and turning axis: (2,), below (2, 3) and P, K (2, 3, 3)
    anchor: np.ndarray
    along: np.ndarray
    cross: np.ndarray


def frames_of(kinematics: Kinematics, active: bool) -> Frames:
    """Arrays of a machine's transformation."""
    k = kinematics
    arrays = np.linalg.inv(k.slides), k.part_axes, k.part_origin, k.tool_tip
    swings = zip(*((j.on_table, j.anchor, np.outer(j.axis, j.axis), np.cross(np.eye(3), j.axis)) for j in (k.tilt, k.turn)))
    return Frames(bool(active), *(np.ascontiguousarray(a, float) for a in (*arrays, *swings)))


@compiled(allocates=True)
def _row(matrix, i, v, d):
    """Component i of a matrix (3, 3) times the derivative d of jets (4, 3)."""
    return matrix[i, 0] * v[d, 0] + matrix[i, 1] * v[d, 1] + matrix[i, 2] * v[d, 2]


@compiled(allocates=True)
def _times(f, g, out):
    """Jet of a product: Leibniz' rule."""
    out[0] = f[0] * g[0]
    out[1] = f[1] * g[0] + f[0] * g[1]
    out[2] = f[2] * g[0] + 2.0 * f[1] * g[1] + f[0] * g[2]
    out[3] = f[3] * g[0] + 3.0 * (f[2] * g[1] + f[1] * g[2]) + f[0] * g[3]


@compiled(allocates=True)
def _swung(f, joint, angle, v, work, out):
    """Jets (4, 3) of Rot(angle) (v - anchor) + anchor of a joint for jets angle (4,) and v (4, 3); `v` is changed."""
    anchor, along, cross = f.anchor[joint], f.along[joint], f.cross[joint]
    cos, sin, part, product = work[2, 0], work[2, 1], work[3, 0], work[3, 1]
    c, s = np.cos(angle[0]), np.sin(angle[0])
    one, two, three = angle[1], angle[2], angle[3]
    cos[0], sin[0] = c, s
    cos[1], sin[1] = -s * one, c * one
    cos[2], sin[2] = -c * one * one - s * two, -s * one * one + c * two
    cos[3] = s * one**3 - 3.0 * c * one * two - s * three
    sin[3] = -c * one**3 - 3.0 * s * one * two + c * three
    for i in range(3):
        v[0, i] -= anchor[i]
    for i in range(3):
        for d in range(4):
            out[d, i] = _row(along, i, v, d)
            part[d] = v[d, i] - out[d, i]
        _times(cos, part, product)
        for d in range(4):
            out[d, i] += product[d]
            part[d] = _row(cross, i, v, d)
        _times(sin, part, product)
        for d in range(4):
            out[d, i] += product[d]
        out[0, i] += anchor[i]


@compiled(allocates=True)
def axis_jet(f, w, work, out):
    """Jets (4, 5) of the axes from jets (4, 5) of tip, tilting and turning axis; `work` (5, 4, 4) is scratch."""
    if not f.active:
        for d in range(4):
            for i in range(5):
                out[d, i] = w[d, i]
        return
    a, b, t = work[0], work[1], work[4]
    t[:] = 0.0
    for i in range(3):
        t[0, i] = f.tool_tip[i]
        for d in range(4):
            a[d, i] = _row(f.part_axes, i, w, d)
        a[0, i] += f.part_origin[i]
    # a table turns before it tilts, a head tilts before it turns
    for joint in range(1, -1, -1):
        if f.on_table[joint]:
            _swung(f, joint, w[:, 3 + joint], a, work, b)
            a, b = b, a
    for joint in range(2):
        if not f.on_table[joint]:
            _swung(f, joint, w[:, 3 + joint], t, work, b)
            t, b = b, t
    for i in range(3):
        for d in range(4):
            a[d, i] -= t[d, i]
    for d in range(4):
        for i in range(3):
            out[d, i] = _row(f.slides_inverse, i, a, d)
        out[d, 3] = w[d, 3]
        out[d, 4] = w[d, 4]


@compiled(allocates=True)
def spline_jet(s, j, at, out):
    """Jets (4, 5) of the spline at parameter `at` of piece j."""
    x = at - s.t[j]
    for d in range(5):
        c1, c2, c3 = s.c[j, 1, d], s.c[j, 2, d], s.c[j, 3, d]
        out[0, d] = s.c[j, 0, d] + x * (c1 + x * (c2 + x * c3))
        out[1, d] = c1 + x * (2.0 * c2 + 3.0 * x * c3)
        out[2, d] = 2.0 * c2 + 6.0 * x * c3
        out[3, d] = 6.0 * c3
