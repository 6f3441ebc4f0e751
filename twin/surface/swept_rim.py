"""Lowest intersection of a ray with a rounded element of a moving tool: spheres of radius r around the points of a circle of radius Rm.

Each sphere has a closed form (`swept_sphere`); the angle of the lowest one is found by search. All lengths in m.
"""

import math

from twin.compiled_functions import compiled
from twin.surface.sweep import GOLDEN, TINY, dot, swept_sphere

RIM_SAMPLES = 12
"""Start points of the search on the rim of a rounded element."""

RIM_CLOSE = 1e-4
"""Final interval of the golden section on the rim [rad]: the height is then off by some 1e-8 of the radius of the tool."""


@compiled(ieee_division=True, allocates=True)
def _rim(y, n, phi, d, f1, f2, g1, g2, major, square):  # type: ignore[no-untyped-def]
    """One point of the rim: lowest t in its swept sphere, and the squared distance of the ray from its path, 0 for a hit.

    f1, f2 span the circle at the start, g1, g2 at the end; y = ray point - first centre.
    """
    c, s = math.cos(phi), math.sin(phi)
    e0 = (c * f1[0] + s * f2[0], c * f1[1] + s * f2[1], c * f1[2] + s * f2[2])
    e1 = (c * g1[0] + s * g2[0], c * g1[1] + s * g2[1], c * g1[2] + s * g2[2])
    v = (y[0] - major * e0[0], y[1] - major * e0[1], y[2] - major * e0[2])
    w = (d[0] + major * (e1[0] - e0[0]), d[1] + major * (e1[1] - e0[1]), d[2] + major * (e1[2] - e0[2]))
    ww = dot(w, w)
    t = swept_sphere(v, n, w, ww, square)
    if t < math.inf:
        return t, 0.0
    # closest approach of the ray and the path of this point
    nw, vn, vw = dot(n, w), dot(v, n), dot(v, w)
    det = ww - nw * nw
    at = min(1.0, max(0.0, (vw - nw * vn) / det)) if det > TINY else 0.0
    near = nw * at - vn
    q = (v[0] + near * n[0] - at * w[0], v[1] + near * n[1] - at * w[1], v[2] + near * n[2] - at * w[2])
    return t, dot(q, q)


@compiled(ieee_division=True, allocates=True)
def _lowest_near(y, n, d, f1, f2, g1, g2, major, square, low, high):  # type: ignore[no-untyped-def]
    """Lowest t on the rim between two angles: golden section, on the distance until there is a hit."""
    x1, x2 = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    t1, gap1 = _rim(y, n, x1, d, f1, f2, g1, g2, major, square)
    t2, gap2 = _rim(y, n, x2, d, f1, f2, g1, g2, major, square)
    best = min(t1, t2)
    while high - low > RIM_CLOSE:
        if t1 < t2 or (t1 == t2 and gap1 <= gap2):
            high, x2, t2, gap2 = x2, x1, t1, gap1
            x1 = high - GOLDEN * (high - low)
            t1, gap1 = _rim(y, n, x1, d, f1, f2, g1, g2, major, square)
        else:
            low, x1, t1, gap1 = x1, x2, t2, gap2
            x2 = low + GOLDEN * (high - low)
            t2, gap2 = _rim(y, n, x2, d, f1, f2, g1, g2, major, square)
        best = min(best, t1, t2)
    return best


@compiled(ieee_division=True, allocates=True)
def swept_rim(y, n, d, f1, f2, g1, g2, major, radius):  # type: ignore[no-untyped-def]
    """Lowest t in a moving torus (spheres of `radius` around a circle of radius `major`); y = ray point - first centre.

    The search starts at every sample of the rim that is lower (or, without a hit, nearer) than both neighbours.
    """
    square = radius * radius
    step = 2.0 * math.pi / RIM_SAMPLES
    t1, gap1 = _rim(y, n, -2.0 * step, d, f1, f2, g1, g2, major, square)
    t2, gap2 = _rim(y, n, -step, d, f1, f2, g1, g2, major, square)
    best = math.inf
    for i in range(RIM_SAMPLES):
        t3, gap3 = _rim(y, n, i * step, d, f1, f2, g1, g2, major, square)
        lower = t2 <= t1 and t2 <= t3 and t2 < math.inf
        nearer = t1 == math.inf and t2 == math.inf and t3 == math.inf and gap2 <= gap1 and gap2 <= gap3
        if lower or nearer:
            best = min(best, _lowest_near(y, n, d, f1, f2, g1, g2, major, square, (i - 2) * step, i * step))
        t1, gap1, t2, gap2 = t2, gap2, t3, gap3
    return best
