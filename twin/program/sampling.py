"""From the time law to set points: the time of each node, and the positions of the axes at each position cycle.

Within an interval a(u) is a quadratic, so u(t) solves u'' = y0 + k (u - u0) with k = a''/2, in closed form:

    u - u0 = x0 S1(t) + y0 S2(t),   S1 = sinh(sqrt(k) t) / sqrt(k),   S2 = (cosh(sqrt(k) t) - 1) / k      (sin, cos for k < 0)

x0 = sqrt(a), y0 = a'/2 at the node; x1, y1 at the next one. From rest u = j t^3 / 6.
"""

import math

import numpy as np

from twin.compiled_functions import compiled
from twin.program import axis_path

SMALL = 1e-4  # the series is used for a smaller |k| t^2


@compiled(allocates=True)
def _moved(x0, y0, k, t):
    """Distance and speed after the time t in an interval."""
    z = k * t * t
    if abs(z) < SMALL:
        s1 = t * (1.0 + z / 6.0 * (1.0 + z / 20.0 * (1.0 + z / 42.0)))
        s2 = 0.5 * t * t * (1.0 + z / 12.0 * (1.0 + z / 30.0))
        c = 1.0 + 0.5 * z * (1.0 + z / 12.0 * (1.0 + z / 30.0))
    elif k > 0.0:
        r = math.sqrt(k)
        s1 = math.sinh(r * t) / r
        c = math.cosh(r * t)
        half = math.sinh(0.5 * r * t)
        s2 = 2.0 * half * half / k
    else:
        r = math.sqrt(-k)
        s1 = math.sin(r * t) / r
        c = math.cos(r * t)
        half = math.sin(0.5 * r * t)
        s2 = 2.0 * half * half / -k
    return x0 * s1 + y0 * s2, x0 * c + y0 * s1


@compiled(allocates=True)
def _interval_time(x0, x1, y0, y1, h):
    """Time for an interval in closed form, T = 2 artanh(sqrt(z)) / sqrt(k) with z = k h^2 / (x0 + x1)^2 (arctan for k < 0).

    1 - z = 2 (b + x0 x1) / (x0 + x1)^2 with the middle Bernstein coefficient b of a(u). From the slower end b is exact, so T is exact for any ratio
    of the two speeds.
    """
    both = x0 + x1
    t = 2.0 * h / both
    z = (y1 - y0) * h / (both * both)
    if abs(z) < SMALL:
        return t * (1.0 + z * (1.0 / 3.0 + z * (0.2 + z / 7.0)))
    if z < 0.0:
        w = math.sqrt(-z)
        return t * math.atan(w) / w
    w = math.sqrt(z)
    b = x0 * x0 + y0 * h if x0 < x1 else x1 * x1 - y1 * h
    return t * math.log((1.0 + w) * both / math.sqrt(2.0 * (b + x0 * x1))) / w


@compiled(allocates=True)
def node_times(nodes, a, slope):
    """Time (node,) [s] of each node, from rest at the first to rest at the last."""
    n = nodes.shape[0] - 1
    times = np.zeros(n + 1)
    for i in range(n):
        h = nodes[i + 1] - nodes[i]
        if i == 0 or i == n - 1:
            t = 3.0 * h / math.sqrt(max(a[i], a[i + 1]))  # u = j t^3 / 6, speed 3 u / t; a is 0 at rest
        else:
            t = _interval_time(math.sqrt(a[i]), math.sqrt(a[i + 1]), 0.5 * slope[i], 0.5 * slope[i + 1], h)
        times[i + 1] = times[i] + t
    return times


@compiled(allocates=True)
def sample(s, f, law, times, stretch, begin, period, out):
    """Fill `out`: axes (count, 5), u, tip speed [m/s] and speed of A and C together [rad/s] (count,).

    Sample i is taken begin + i + 1 periods [s] after the start; `stretch` slows the law down. A time behind the motion gives its end.
    """
    nodes, piece, a, slope = law
    axes, u, tip_speed, turn_speed = out
    n, count = nodes.shape[0] - 1, u.shape[0]
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    i = 0
    for m in range(count):
        t = (period + (begin + m) * period) / stretch
        if t >= times[n]:
            at, x, i = nodes[n], 0.0, n - 1
        else:
            while t >= times[i + 1]:
                i += 1
            h = nodes[i + 1] - nodes[i]
            if i == 0:
                part = t / times[1]
                at, x = nodes[0] + h * part**3, math.sqrt(a[1]) * part**2
            elif i == n - 1:
                part = (times[n] - t) / (times[n] - times[n - 1])
                at, x = nodes[n] - h * part**3, math.sqrt(a[n - 1]) * part**2
            else:
                k = 0.5 * (slope[i + 1] - slope[i]) / h
                # from the slower end: rounding errors grow with sinh towards it
                if a[i] <= a[i + 1]:
                    way, x = _moved(math.sqrt(a[i]), 0.5 * slope[i], k, t - times[i])
                    at = nodes[i] + min(max(way, 0.0), h)
                else:
                    way, x = _moved(math.sqrt(a[i + 1]), -0.5 * slope[i + 1], k, times[i + 1] - t)
                    at = nodes[i + 1] - min(max(way, 0.0), h)
        axis_path.spline_jet(s, piece[i], at, w)
        axis_path.axis_jet(f, w, work, q)
        for d in range(5):
            axes[m, d] = q[0, d]
        u[m] = at
        tip_speed[m] = x / stretch * math.sqrt(w[1, 0] ** 2 + w[1, 1] ** 2 + w[1, 2] ** 2)
        turn_speed[m] = x / stretch * math.sqrt(w[1, 3] ** 2 + w[1, 4] ** 2)
