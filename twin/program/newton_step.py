"""One Newton step of the time law (`twin.program.timelaw`): slack of the limits, the equations, and their solution.

Symbols and shapes are those of that module.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled

_FAST = {"contract", "arcp", "reassoc"}


class Bounds(NamedTuple):
    """The path at the nodes and its limits.

    `h` (interval,) distances of the nodes, `q1` `q2` (node, axis) and `q3` (interval, left and right end, axis) derivatives of the axes,
    `most` (node,) the greatest a by speed and feed, beside the ends also by the constant jerk from and to rest, `top` the same without
    that, `acceleration` (node, axis), `jerk` (axis,), which `ease` (interval,) scales (1: as given).
    """

    h: np.ndarray
    q1: np.ndarray
    q2: np.ndarray
    q3: np.ndarray
    most: np.ndarray
    top: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray
    ease: np.ndarray


class Multipliers(NamedTuple):
    """Of the limits on a at the nodes and in the middles, of acceleration and jerk (upper and lower)."""

    top: np.ndarray
    middle: np.ndarray
    a: np.ndarray
    j: np.ndarray


class Equations(NamedTuple):
    """Gradient and Hessian (diagonal and two side diagonals) by the coefficients."""

    gradient: np.ndarray
    diagonal: np.ndarray
    beside: np.ndarray
    apart: np.ndarray


@compiled(allocates=True)
def node_values(h, c):
    """a and a' at the nodes from the coefficients (zero at both ends, where the motion rests)."""
    n = h.shape[0]
    a, slope = np.zeros(n + 1), np.zeros(n + 1)
    for i in range(1, n):
        share = h[i - 1] / (h[i - 1] + h[i])
        a[i] = (1.0 - share) * c[i] + share * c[i + 1]
        slope[i] = 2.0 / (h[i - 1] + h[i]) * (c[i + 1] - c[i])
    return a, slope


@compiled(allocates=True)
def least_slack(c, b):
    """The smallest slack of all limits (negative: a limit is exceeded); only its sign has a meaning."""
    h, q1, q2, q3, most, top, limit_a, limit_j, ease = b
    a, slope = node_values(h, c)
    intervals, least = h.shape[0], np.inf
    for i in range(1, intervals):
        least = min(least, a[i], most[i] - a[i])
        for k in range(q1.shape[1]):
            least = min(least, limit_a[i, k] - abs(0.5 * q1[i, k] * slope[i] + q2[i, k] * a[i]))
    for i in range(1, intervals - 1):
        least = min(least, 0.5 * (top[i] + top[i + 1]) - c[i + 1])
        if least <= 0.0:
            break
        bend = (slope[i + 1] - slope[i]) / h[i]
        for n in range(i, i + 2):
            for k in range(q1.shape[1]):
                f = 0.5 * q1[n, k] * bend + 1.5 * q2[n, k] * slope[n] + q3[i, n - i, k] * a[n]
                least = min(least, ease[i] * limit_j[k] / math.sqrt(a[n]) - abs(f))
    return least


@compiled(allocates=True, fastmath=_FAST)
def assemble(c, b, mu, fresh, dual, equations):
    """The equations of T - mu sum(log slack), whose Hessian has the weights dual / slack.

    `fresh` sets all multipliers to mu / slack first. Returns the time and the sum of slack times multiplier.
    """
    h, q1, q2, q3, most, top, limit_a, limit_j, ease = b
    dual_top, dual_c, dual_a, dual_j = dual
    gradient, diagonal, beside, apart = equations
    intervals, axes = q1.shape[0] - 1, q1.shape[1]
    at, slopes = node_values(h, c)
    gradient[:] = 0.0
    diagonal[:] = 0.0
    beside[:] = 0.0
    apart[:] = 0.0
    time = gap = 0.0
    for i in range(1, intervals):
        # a and a' at node i from the two coefficients i and i + 1
        a, slope = at[i], slopes[i]
        width = h[i - 1] + h[i]
        w1 = h[i - 1] / width
        w0 = 1.0 - w1
        d = 2.0 / width
        share = 0.25 * width
        root = math.sqrt(a)
        time += share / root
        # first and second derivatives by a and by a': the time, then each limit at the node
        s = 1.0 / (most[i] - a)
        if fresh:
            dual_top[i] = mu * s
        gap += dual_top[i] / s
        ga = mu * s - 0.5 * share / (a * root)
        haa = dual_top[i] * s + 0.75 * share / (a * a * root)
        gs = hss = has = 0.0
        for k in range(axes):
            fs = 0.5 * q1[i, k]
            fa = q2[i, k]
            f = fs * slope + fa * a
            up = 1.0 / (limit_a[i, k] - f)
            down = 1.0 / (limit_a[i, k] + f)
            if fresh:
                dual_a[i, k, 0] = mu * up
                dual_a[i, k, 1] = mu * down
            gap += dual_a[i, k, 0] / up + dual_a[i, k, 1] / down
            g = mu * (up - down)
            hh = dual_a[i, k, 0] * up + dual_a[i, k, 1] * down
            ga += g * fa
            gs += g * fs
            haa += hh * fa * fa
            has += hh * fa * fs
            hss += hh * fs * fs
        gradient[i] += w0 * ga - d * gs
        gradient[i + 1] += w1 * ga + d * gs
        diagonal[i] += w0 * w0 * haa - 2.0 * w0 * d * has + d * d * hss
        diagonal[i + 1] += w1 * w1 * haa + 2.0 * w1 * d * has + d * d * hss
        beside[i] += w0 * w1 * haa + (w0 - w1) * d * has - d * d * hss
        if i == intervals - 1:
            break
        # the coefficient of the interval itself stands for its middle
        middle = c[i + 1]
        root = 0.5 * h[i] / (middle * math.sqrt(middle))
        time += root * middle
        s = 1.0 / (0.5 * (top[i] + top[i + 1]) - middle)
        if fresh:
            dual_c[i] = mu * s
        gap += dual_c[i] / s
        gradient[i + 1] += mu * s - 0.5 * root
        diagonal[i + 1] += dual_c[i] * s + 0.75 * root / middle
        # jerk at both ends of interval i, in the three coefficients i, i + 1, i + 2
        width2 = h[i] + h[i + 1]
        d2 = 2.0 / width2
        v1 = h[i] / width2
        v0 = 1.0 - v1
        b0 = d / h[i]
        b2 = d2 / h[i]
        b1 = -(b0 + b2)
        bend = (slopes[i + 1] - slope) / h[i]
        for end in range(2):
            n, x, y = i + end, at[i + end], slopes[i + end]
            if end == 0:
                a0, a1, a2, s0, s1, s2 = w0, w1, 0.0, -d, d, 0.0
            else:
                a0, a1, a2, s0, s1, s2 = 0.0, v0, v1, 0.0, -d2, d2
            inverse_root = 1.0 / math.sqrt(x)
            ex = ey = eb = 0.0
            xx = xy = xb = yy = yb = bb = 0.0
            for k in range(axes):
                fb = 0.5 * q1[n, k]
                fy = 1.5 * q2[n, k]
                fx = q3[i, end, k]
                f = fb * bend + fy * y + fx * x
                bound = ease[i] * limit_j[k] * inverse_root
                fall = 0.5 * bound / x  # the bound falls by this with a
                up = 1.0 / (bound - f)
                down = 1.0 / (bound + f)
                if fresh:
                    dual_j[i, end, k, 0] = mu * up
                    dual_j[i, end, k, 1] = mu * down
                gap += dual_j[i, end, k, 0] / up + dual_j[i, end, k, 1] / down
                up_x = fall + fx
                down_x = fall - fx
                g = mu * (up - down)
                hu = dual_j[i, end, k, 0] * up
                hd = dual_j[i, end, k, 1] * down
                ex += mu * (up * up_x + down * down_x)
                ey += g * fy
                eb += g * fb
                hx = hu * up_x - hd * down_x
                hh = hu + hd
                xx += hu * up_x * up_x + hd * down_x * down_x
                xy += hx * fy
                xb += hx * fb
                yy += hh * fy * fy
                yb += hh * fy * fb
                bb += hh * fb * fb
            gradient[i] += ex * a0 + ey * s0 + eb * b0
            gradient[i + 1] += ex * a1 + ey * s1 + eb * b1
            gradient[i + 2] += ex * a2 + ey * s2 + eb * b2
            x0, y0, z0 = xx * a0 + xy * s0 + xb * b0, xy * a0 + yy * s0 + yb * b0, xb * a0 + yb * s0 + bb * b0
            x1, y1, z1 = xx * a1 + xy * s1 + xb * b1, xy * a1 + yy * s1 + yb * b1, xb * a1 + yb * s1 + bb * b1
            x2, y2, z2 = xx * a2 + xy * s2 + xb * b2, xy * a2 + yy * s2 + yb * b2, xb * a2 + yb * s2 + bb * b2
            diagonal[i] += x0 * a0 + y0 * s0 + z0 * b0
            diagonal[i + 1] += x1 * a1 + y1 * s1 + z1 * b1
            diagonal[i + 2] += x2 * a2 + y2 * s2 + z2 * b2
            beside[i] += x0 * a1 + y0 * s1 + z0 * b1
            beside[i + 1] += x1 * a2 + y1 * s2 + z1 * b2
            apart[i] += x0 * a2 + y0 * s2 + z0 * b2
    return time, gap


@compiled(allocates=True, fastmath=_FAST)
def dual_steps(c, step, b, mu, dual, move):
    """Changes of all multipliers (written to `move`), and the largest steps of primal and dual before a limit or zero.

    The linearised slack is the safe side of the true one, so the ratio test keeps every limit.
    """
    h, q1, q2, q3, most, top, limit_a, limit_j, ease = b
    dual_top, dual_c, dual_a, dual_j = dual
    move_top, move_c, move_a, move_j = move
    intervals, axes = q1.shape[0] - 1, q1.shape[1]
    (at, slopes), (at_step, slope_step) = node_values(h, c), node_values(h, step)
    primal = falls = 0.0  # greatest relative fall of a slack, of a multiplier
    for i in range(1, intervals):
        a, slope, da, dslope = at[i], slopes[i], at_step[i], slope_step[i]
        s = 1.0 / (most[i] - a)
        primal = max(primal, da * s, -da / a)
        move_top[i] = mu * s - dual_top[i] * (1.0 - da * s)
        falls = max(falls, -move_top[i] / dual_top[i])
        for k in range(axes):
            f = 0.5 * q1[i, k] * slope + q2[i, k] * a
            df = 0.5 * q1[i, k] * dslope + q2[i, k] * da
            up = 1.0 / (limit_a[i, k] - f)
            down = 1.0 / (limit_a[i, k] + f)
            primal = max(primal, df * up, -df * down)
            move_a[i, k, 0] = mu * up - dual_a[i, k, 0] * (1.0 - df * up)
            move_a[i, k, 1] = mu * down - dual_a[i, k, 1] * (1.0 + df * down)
            falls = max(falls, -move_a[i, k, 0] / dual_a[i, k, 0], -move_a[i, k, 1] / dual_a[i, k, 1])
        if i == intervals - 1:
            break
        s = 1.0 / (0.5 * (top[i] + top[i + 1]) - c[i + 1])
        primal = max(primal, -step[i + 1] / c[i + 1], step[i + 1] * s)
        move_c[i] = mu * s - dual_c[i] * (1.0 - step[i + 1] * s)
        falls = max(falls, -move_c[i] / dual_c[i])
        bend, dbend = (slopes[i + 1] - slope) / h[i], (slope_step[i + 1] - dslope) / h[i]
        for end in range(2):
            n, x, y, dx, dy = i + end, at[i + end], slopes[i + end], at_step[i + end], slope_step[i + end]
            inverse_root = 1.0 / math.sqrt(x)
            for k in range(axes):
                f = 0.5 * q1[n, k] * bend + 1.5 * q2[n, k] * y + q3[i, end, k] * x
                df = 0.5 * q1[n, k] * dbend + 1.5 * q2[n, k] * dy + q3[i, end, k] * dx
                bound = ease[i] * limit_j[k] * inverse_root
                dbound = 0.5 * bound / x * dx
                up = 1.0 / (bound - f)
                down = 1.0 / (bound + f)
                fall_up = (dbound + df) * up
                fall_down = (dbound - df) * down
                primal = max(primal, fall_up, fall_down)
                move_j[i, end, k, 0] = mu * up - dual_j[i, end, k, 0] * (1.0 - fall_up)
                move_j[i, end, k, 1] = mu * down - dual_j[i, end, k, 1] * (1.0 - fall_down)
                falls = max(falls, -move_j[i, end, k, 0] / dual_j[i, end, k, 0], -move_j[i, end, k, 1] / dual_j[i, end, k, 1])
    return primal, falls


@compiled(allocates=True)
def tie_ends(ties, equations):
    """Eliminate coefficient 1 (= tie * coefficient 2) and the last but one from the equations."""
    gradient, diagonal, beside, apart = equations
    t = ties[0]
    gradient[2] += t * gradient[1]
    diagonal[2] += t * t * diagonal[1] + 2.0 * t * beside[1]
    beside[2] += t * apart[1]
    n = gradient.shape[0] - 2
    t = ties[1]
    gradient[n - 1] += t * gradient[n]
    diagonal[n - 1] += t * t * diagonal[n] + 2.0 * t * beside[n - 1]
    beside[n - 2] += t * apart[n - 2]


@compiled(allocates=True)
def solve_band(first, last, diagonal, beside, apart, right):
    """Solve the symmetric five-diagonal system in place for the unknowns first .. last (inclusive)."""
    for i in range(first, last + 1):
        if i > first:
            factor = beside[i - 1]  # already divided
            diagonal[i] -= factor * factor * diagonal[i - 1]
        if i > first + 1:
            factor = apart[i - 2]
            diagonal[i] -= factor * factor * diagonal[i - 2]
        if i < last:
            if i > first:
                beside[i] -= beside[i - 1] * diagonal[i - 1] * apart[i - 1]
            beside[i] /= diagonal[i]
        if i < last - 1:
            apart[i] /= diagonal[i]
    for i in range(first, last + 1):
        if i > first:
            right[i] -= beside[i - 1] * right[i - 1]
        if i > first + 1:
            right[i] -= apart[i - 2] * right[i - 2]
    for i in range(last, first - 1, -1):
        right[i] /= diagonal[i]
        if i < last:
            right[i] -= beside[i] * right[i + 1]
        if i < last - 1:
            right[i] -= apart[i] * right[i + 2]
