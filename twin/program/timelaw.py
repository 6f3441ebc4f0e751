"""The time law: the fastest motion along a path from rest to rest within the speed, acceleration and jerk limits of every axis.

Along the path q(u) the square of the path speed, a(u) = (du/dt)^2, is a quadratic spline (so that acceleration is continuous);
with ' = d/du,

    speed         q' sqrt(a)
    acceleration  q' a'/2 + q'' a
    jerk          (q' a''/2 + 3/2 q'' a' + q^(3) a) sqrt(a)

Speed and acceleration limits are linear in a. The jerk limit |f(a)| <= J / sqrt(a) is linearised by its tangent, which is on
the safe side. The time T = int du / sqrt(a) is convex in a. A primal-dual interior point method minimises it with Newton
steps on the optimality conditions. Every iterate is strictly inside all limits at the nodes, and so is the result. The
Hessian has five diagonals, so a step takes linear time. In the first and last interval the jerk is constant, a = alpha u^(4/3).
The speed-squared formulation is that of Verscheure et al. 2009, extended by jerk.

Nodes are n = 0 .. N, intervals i = 0 .. N - 1. Coefficient i of the spline belongs to the middle of interval i - 1: node i lies between
the coefficients i and i + 1. The limits of node i and of interval i are linear forms of the coefficients c_i, c_i+1, c_i+2, in four
groups: acceleration at node i, jerk at the left and at the right end of interval i, and a in its middle. The first and the last group
have a bound of a, and a share of the time,

    a = value . c < cap,   T = sum share / sqrt(a),      |form . c| < bound,  for the jerk bound / sqrt(a)

Behind the last interval but one there is the first group alone.
"""

import math

import numpy as np

from twin.compiled_functions import compiled

GAP = 0.001
"""The iteration ends when limits times multipliers (the duality gap) fall below this fraction of the time."""
MAX_STEPS = 200
START_SHARE = 0.5  # share of the jerk limit that the first guess aims at
STILL_GROWING = 0.2
"""The duality gap bounds the time only if the last Newton step was short: no coefficient grew by more than this fraction."""
TO_THE_WALL = 0.98  # share of the way to the nearest limit that a step may go
_FAST = {"contract", "arcp", "reassoc"}


@compiled(allocates=True)
def _tie(first, second):
    """The coefficient beside a standstill as a share of the next one, from a ~ u^(4/3); lengths of the first two intervals."""
    return first / (3.0 * first + 2.0 * second)


@compiled(allocates=True)
def node_values(h, c):
    """a and a' at the nodes from the coefficients (zero at both ends, where the motion rests)."""
    n = h.shape[0]
    a, slope, c = np.zeros(n + 1), np.zeros(n + 1), c.copy()
    c[1], c[n] = _tie(h[0], h[1]) * c[2], _tie(h[n - 1], h[n - 2]) * c[n - 1]
    for i in range(1, n):
        share = h[i - 1] / (h[i - 1] + h[i])
        a[i] = (1.0 - share) * c[i] + share * c[i + 1]
        slope[i] = 2.0 / (h[i - 1] + h[i]) * (c[i + 1] - c[i])
    return a, slope


@compiled(allocates=True)
def rows_of(h, q1, q2, q3, most, top, limit_a, limit_j, ease):
    """The limits as rows: weights (3,), cap and share by interval and group (interval, 4, 5), and weights (3,) and bound (interval, 3, axis, 4).

    The coefficients beside both ends are tied to the next ones (`_tie`) and have no weight.
    `h` (interval,) distances of the nodes, `q1` `q2` (node, axis) and `q3` (interval, left and right end, axis) derivatives of the axes,
    `most` (node,) the greatest a by speed and feed, beside the ends also by the constant jerk from and to rest, `top` the same without
    that, `limit_a` (node, axis), `limit_j` (axis,), which `ease` (interval,) scales (1: as given).
    """
    n, axes = h.shape[0], q1.shape[1]
    value, form, slope = np.zeros((n, 4, 5)), np.zeros((n, 3, axes, 4)), np.zeros((2, 3))
    value[:, 3, 1] = 1.0
    for i in range(1, n):
        for end in range(2 if i < n - 1 else 1):  # node i, and node i + 1, which lies one coefficient further
            width = h[i + end - 1] + h[i + end]
            value[i, 2 * end, end + 1] = h[i + end - 1] / width
            value[i, 2 * end, end] = 1.0 - value[i, 2 * end, end + 1]
            slope[end, end], slope[end, end + 1] = -2.0 / width, 2.0 / width
        value[i, 0, 3], value[i, 0, 4] = most[i], 0.25 * (h[i - 1] + h[i])
        value[i, 3, 3], value[i, 3, 4] = 0.5 * (top[i] + top[i + 1]), 0.5 * h[i]
        for m in range(3):
            value[i, 1, m] = value[i, 0, m]
            bend = (slope[1, m] - slope[0, m]) / h[i]
            for k in range(axes):
                form[i, 0, k, m] = 0.5 * q1[i, k] * slope[0, m] + q2[i, k] * value[i, 0, m]
                for end in range(2):
                    part = 0.5 * q1[i + end, k] * bend + 1.5 * q2[i + end, k] * slope[end, m]
                    form[i, 1 + end, k, m] = part + q3[i, end, k] * value[i, 1 + end, m]
        for k in range(axes):
            form[i, 0, k, 3], form[i, 1, k, 3], form[i, 2, k, 3] = limit_a[i, k], ease[i] * limit_j[k], ease[i] * limit_j[k]
    last = _tie(h[n - 1], h[n - 2])
    for i, outer, inner, tie in ((1, 0, 1, _tie(h[0], h[1])), (n - 1, 1, 0, last), (n - 2, 2, 1, last)):
        for rows in (value[i], form[i, 0], form[i, 1], form[i, 2]):
            for row in rows:
                row[inner] += tie * row[outer]
                row[outer] = 0.0
    return value, form


@compiled(allocates=True)
def least_slack(c, rows):
    """The smallest slack of all limits (negative: a limit is exceeded); only its sign has a meaning."""
    value, form = rows
    n, axes, least = form.shape[0], form.shape[2], np.inf
    for i in range(1, n):
        for p in range(4 if i < n - 1 else 1):
            a = value[i, p, 0] * c[i] + value[i, p, 1] * c[i + 1] + value[i, p, 2] * c[i + 2]
            least = min(least, a, value[i, p, 3] - a if p in (0, 3) else a)
            if least <= 0.0:
                return least
            for k in range(axes if p < 3 else 0):
                f = form[i, p, k, 0] * c[i] + form[i, p, k, 1] * c[i + 1] + form[i, p, k, 2] * c[i + 2]
                least = min(least, form[i, p, k, 3] / (math.sqrt(a) if p else 1.0) - abs(f))
    return least


@compiled(allocates=True, fastmath=_FAST)
def assemble(c, rows, mu, fresh, dual, equations):
    """The equations of T - mu sum(log slack): gradient and Hessian (diagonal, two side diagonals), which has the weights dual / slack.

    `dual` (interval, 4, axis and cap, upper and lower): the multipliers; `fresh` sets them to mu / slack first. Returns the time and the sum of
    slack times multiplier.
    """
    value, form = rows
    gradient, diagonal, beside, apart = equations
    n, axes = form.shape[0], form.shape[2]
    for part in equations:
        part[:] = 0.0
    time = gap = 0.0
    for i in range(1, n):
        c0, c1, c2 = c[i], c[i + 1], c[i + 2]
        g0 = g1 = g2 = h00 = h11 = h22 = h01 = h12 = h02 = 0.0
        for p in range(4 if i < n - 1 else 1):
            v0, v1, v2 = value[i, p, 0], value[i, p, 1], value[i, p, 2]
            a = v0 * c0 + v1 * c1 + v2 * c2
            root = math.sqrt(a)
            scale, half = (1.0 / root, 0.5 / a) if p else (1.0, 0.0)  # of the limit, and its fall with a
            ga = haa = m0 = m1 = m2 = 0.0  # first and second derivative by a, mixed by a and the forms
            if p == 0 or p == 3:
                time += value[i, p, 4] / root
                slack = value[i, p, 3] - a
                s = 1.0 / slack
                if fresh:
                    dual[i, p, axes, 0] = mu * s
                gap += dual[i, p, axes, 0] * slack
                ga = mu * s - 0.5 * value[i, p, 4] / (a * root)
                haa = dual[i, p, axes, 0] * s + 0.75 * value[i, p, 4] / (a * a * root)
            for k in range(axes if p < 3 else 0):
                f0, f1, f2 = form[i, p, k, 0], form[i, p, k, 1], form[i, p, k, 2]
                f = f0 * c0 + f1 * c1 + f2 * c2
                limit = form[i, p, k, 3] * scale
                fall = half * limit
                g = both = mixed = 0.0
                for side in range(2):
                    sign = 1.0 - 2.0 * side
                    slack = limit - sign * f
                    s = 1.0 / slack
                    if fresh:
                        dual[i, p, k, side] = mu * s
                    d = dual[i, p, k, side]
                    gap += d * slack
                    ga += mu * fall * s
                    g += sign * mu * s
                    both += d * s
                    mixed += sign * fall * d * s
                haa += both * fall * fall
                g0 += g * f0
                g1 += g * f1
                g2 += g * f2
                m0 += mixed * f0
                m1 += mixed * f1
                m2 += mixed * f2
                h00 += both * f0 * f0
                h11 += both * f1 * f1
                h22 += both * f2 * f2
                h01 += both * f0 * f1
                h12 += both * f1 * f2
                h02 += both * f0 * f2
            g0 += ga * v0
            g1 += ga * v1
            g2 += ga * v2
            h00 += 2.0 * m0 * v0 + haa * v0 * v0
            h11 += 2.0 * m1 * v1 + haa * v1 * v1
            h22 += 2.0 * m2 * v2 + haa * v2 * v2
            h01 += m0 * v1 + m1 * v0 + haa * v0 * v1
            h12 += m1 * v2 + m2 * v1 + haa * v1 * v2
            h02 += m0 * v2 + m2 * v0
        gradient[i] += g0
        gradient[i + 1] += g1
        gradient[i + 2] += g2
        diagonal[i] += h00
        diagonal[i + 1] += h11
        diagonal[i + 2] += h22
        beside[i] += h01
        beside[i + 1] += h12
        apart[i] += h02
    return time, gap


@compiled(allocates=True, fastmath=_FAST)
def dual_steps(c, step, rows, mu, dual, move):
    """Changes of all multipliers (written to `move`), and the largest steps of primal and dual before a limit or zero.

    The linearised slack is the safe side of the true one, so the ratio test keeps every limit.
    """
    value, form = rows
    n, axes = form.shape[0], form.shape[2]
    primal = falls = 0.0  # greatest relative fall of a slack, of a multiplier
    for i in range(1, n):
        c0, c1, c2, d0, d1, d2 = c[i], c[i + 1], c[i + 2], step[i], step[i + 1], step[i + 2]
        for p in range(4 if i < n - 1 else 1):
            v0, v1, v2 = value[i, p, 0], value[i, p, 1], value[i, p, 2]
            a, da = v0 * c0 + v1 * c1 + v2 * c2, v0 * d0 + v1 * d1 + v2 * d2
            if p == 0 or p == 3:
                s = 1.0 / (value[i, p, 3] - a)
                primal = max(primal, da * s, -da / a)
                move[i, p, axes, 0] = mu * s - dual[i, p, axes, 0] * (1.0 - da * s)
                falls = max(falls, -move[i, p, axes, 0] / dual[i, p, axes, 0])
            scale, half = (1.0 / math.sqrt(a), 0.5 / a * da) if p else (1.0, 0.0)
            for k in range(axes if p < 3 else 0):
                f0, f1, f2 = form[i, p, k, 0], form[i, p, k, 1], form[i, p, k, 2]
                f, df = f0 * c0 + f1 * c1 + f2 * c2, f0 * d0 + f1 * d1 + f2 * d2
                limit = form[i, p, k, 3] * scale
                fall = half * limit
                for side in range(2):
                    sign = 1.0 - 2.0 * side
                    s = 1.0 / (limit - sign * f)
                    primal = max(primal, (fall + sign * df) * s)
                    move[i, p, k, side] = mu * s - dual[i, p, k, side] * (1.0 - (fall + sign * df) * s)
                    falls = max(falls, -move[i, p, k, side] / dual[i, p, k, side])
    return primal, falls


@compiled(allocates=True)
def solve_band(first, last, diagonal, beside, apart, right):
    """Solve the symmetric five-diagonal system in place for the unknowns first .. last, which no equation ties to others."""
    for i in range(first, last + 1):
        diagonal[i] -= beside[i - 1] ** 2 * diagonal[i - 1] + apart[i - 2] ** 2 * diagonal[i - 2]
        beside[i] = (beside[i] - beside[i - 1] * diagonal[i - 1] * apart[i - 1]) / diagonal[i]
        apart[i] /= diagonal[i]
        right[i] -= beside[i - 1] * right[i - 1] + apart[i - 2] * right[i - 2]
    for i in range(last, first - 1, -1):
        right[i] = right[i] / diagonal[i] - beside[i] * right[i + 1] - apart[i] * right[i + 2]


@compiled(allocates=True)
def first_guess(h, q1, q2, q3, top, limit_a, limit_j):
    """Approximately reachable node values of a: local limits, then growth from every minimum as under constant jerk."""
    intervals = h.shape[0]
    a, growth = top.copy(), np.empty(intervals)
    for n in range(intervals + 1):
        for k in range(q1.shape[1]):
            if abs(q2[n, k]) > 0.0:
                a[n] = min(a[n], START_SHARE * limit_a[n, k] / abs(q2[n, k]))
            third = abs(q3[min(n, intervals - 1), 0, k])
            if n:
                third = max(third, abs(q3[n - 1, 1, k]))
            if third > 0.0:
                a[n] = min(a[n], (START_SHARE * limit_j[k] / third) ** (2.0 / 3.0))
    for i in range(intervals):
        jerk = 1e12
        for k in range(q1.shape[1]):
            size = max(abs(q1[i, k]), abs(q1[i + 1, k]))
            if size > 0.0:
                jerk = min(jerk, limit_j[k] / size)
        growth[i] = 1.5 * START_SHARE * math.sqrt(2.0 * jerk) * h[i]
    a[0] = a[intervals] = 0.0
    for i in range(intervals):
        a[i + 1] = min(a[i + 1], (a[i] ** 0.75 + growth[i]) ** (4.0 / 3.0))
    for i in range(intervals - 1, -1, -1):
        a[i] = min(a[i], (a[i + 1] ** 0.75 + growth[i]) ** (4.0 / 3.0))
    return a


@compiled(allocates=True)
def time_law(h, guess, rows):
    """Coefficients c (interval + 2,) of a(u) within `rows_of` at least four intervals, and whether a feasible start was found.

    `guess`: node values of a. The second and the last but one coefficient are tied to their neighbours (`node_values`) and not set.
    """
    intervals, axes = h.shape[0], rows[1].shape[2]
    n = intervals + 2
    c = np.zeros(n)
    for i in range(2, n - 2):
        # a(u) lies between its neighbouring coefficients, so it stays below the guess at any change of feed
        c[i] = min(guess[i - 1], guess[i])
    # shrink until strictly inside; a motion that is slow enough keeps every limit
    for _ in range(200):
        if least_slack(c, rows) > 0.0:
            break
        c *= 0.6
    else:
        return c, False
    c *= 0.8
    gradient, diagonal, beside, apart = equations = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    dual, move = np.zeros((intervals, 4, axes + 1, 2)), np.zeros((intervals, 4, axes + 1, 2))
    all_dual, all_moves = dual.ravel(), move.ravel()
    count = (intervals - 1.0) * (2.0 + 2.0 * axes) + (intervals - 2.0) * 4.0 * axes
    mu = 0.3 / count * np.sum(0.5 * (h[:-1] + h[1:]) / np.sqrt(node_values(h, c)[0][1:-1]))
    settled = False
    for steps in range(MAX_STEPS):
        time, gap = assemble(c, rows, mu, steps == 0, dual, equations)
        if gap < GAP * time and settled:
            break
        step = -gradient
        solve_band(2, n - 3, diagonal, beside, apart, step)
        primal, falls = dual_steps(c, step, rows, mu, dual, move)
        go_primal = min(1.0, TO_THE_WALL / primal) if primal > 0.0 else 1.0
        go_dual = min(1.0, TO_THE_WALL / falls) if falls > 0.0 else 1.0
        grown = 0.0
        for i in range(2, n - 2):
            grown = max(grown, step[i] / c[i])
        c += go_primal * step
        for i in range(all_dual.shape[0]):
            all_dual[i] += go_dual * all_moves[i]
        worse = min(go_primal, go_dual)
        settled = worse > 0.6 and grown < STILL_GROWING
        # the larger the last step, the more the multipliers are reduced
        mu = gap / count * max(0.3, 1.0 - worse) if steps else mu
    return c, True
