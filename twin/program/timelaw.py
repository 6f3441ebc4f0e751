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

Arrays: node n = 0 .. N, interval i = 0 .. N - 1, `q1` `q2` (node, axis), `q3` (interval, left and right end, axis).
Coefficient i of the spline belongs to the middle of interval i - 1: node i lies between the coefficients i and i + 1.
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled_functions import compiled
from twin.program.newton_step import assemble, dual_steps, least_slack, solve_band, tie_ends

CONVERGED, NOT_STARTED, STALLED = 0, 1, 2

GAP = 0.001
"""The iteration ends when limits times multipliers (the duality gap) fall below this fraction of the time."""
MAX_STEPS = 200
START_SHARE = 0.5  # share of the jerk limit that the first guess aims at
STILL_GROWING = 0.2
"""The duality gap bounds the time only if the last Newton step was short: no coefficient grew by more than this fraction."""
TO_THE_WALL = 0.98  # share of the way to the nearest limit that a step may go


@compiled(allocates=True)
def first_guess(h, q1, q2, q3, ease, top, rest_top, limit_a, limit_j):
    """Approximately reachable node values of a: local limits, then growth from every minimum as under constant jerk."""
    intervals = h.shape[0]
    a = np.empty(intervals + 1)
    growth = np.empty(intervals)
    for n in range(intervals + 1):
        a[n] = top[n]
        for k in range(q1.shape[1]):
            if abs(q2[n, k]) > 0.0:
                a[n] = min(a[n], START_SHARE * limit_a[n, k] / abs(q2[n, k]))
            third = abs(q3[min(n, intervals - 1), 0, k])
            if n:
                third = max(third, abs(q3[n - 1, 1, k]))
            if third > 0.0:
                a[n] = min(a[n], (START_SHARE * limit_j[k] / third) ** (2.0 / 3.0))
    for i in range(intervals):
        jerk = np.inf
        for k in range(q1.shape[1]):
            size = max(abs(q1[i, k]), abs(q1[i + 1, k]))
            if size > 0.0:
                jerk = min(jerk, limit_j[k] / size)
        growth[i] = 1.5 * START_SHARE * math.sqrt(2.0 * min(jerk, 1e12)) * h[i]
    a[0] = 0.0
    a[intervals] = 0.0
    for i in range(intervals):
        a[i + 1] = min(a[i + 1], (a[i] ** 0.75 + growth[i]) ** (4.0 / 3.0))
    for i in range(intervals - 1, -1, -1):
        a[i] = min(a[i], (a[i + 1] ** 0.75 + growth[i]) ** (4.0 / 3.0))
    return a


@compiled(allocates=True)
def time_law(h, q1, q2, q3, ease, top, rest_top, limit_a, limit_j, gap_wanted):
    """Coefficients c (interval + 2,) of a(u), the time [s], the number of Newton steps and a status.

    `limit_a` (node, axis); `ease` (interval,) scales `limit_j` (axis,) (1: as given). `top` (node,) is the greatest a by speed and feed; `rest_top`
    (2,) bounds a at the first and last inner node so that
    the constant jerk from or to rest keeps the limits. At least four intervals.
    """
    intervals = h.shape[0]
    axes = q1.shape[1]
    n = intervals + 2
    ties = np.empty(2)
    ties[0] = (h[0] / 3.0) / (h[0] / 3.0 + 2.0 / 3.0 * (h[0] + h[1]))
    ties[1] = (h[-1] / 3.0) / (h[-1] / 3.0 + 2.0 / 3.0 * (h[-1] + h[-2]))
    guess = first_guess(h, q1, q2, q3, ease, top, rest_top, limit_a, limit_j)
    c = np.zeros(n)
    for i in range(2, n - 2):
        c[i] = min(
            guess[i - 1], guess[i]
        )  # a(u) lies between its neighbouring coefficients, so it stays below the guess at any change of feed
    c[1] = ties[0] * c[2]
    c[n - 2] = ties[1] * c[n - 3]
    # shrink until strictly inside; a motion that is slow enough keeps every limit
    inside = False
    for _ in range(200):
        if least_slack(c, h, q1, q2, q3, ease, top, rest_top, limit_a, limit_j) > 0.0:
            inside = True
            break
        c *= 0.6
    if not inside:
        return c, np.inf, 0, NOT_STARTED
    c *= 0.8
    gradient, diagonal, beside, apart = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    dual_top, dual_a, dual_j = np.zeros(intervals + 1), np.zeros((intervals + 1, axes, 2)), np.zeros((intervals, 2, axes, 2))
    dual_c, move_c = np.zeros(intervals), np.zeros(intervals)
    move_top, move_a, move_j = np.zeros(intervals + 1), np.zeros((intervals + 1, axes, 2)), np.zeros((intervals, 2, axes, 2))
    rows = (intervals - 1.0) * (2.0 + 2.0 * axes) + (intervals - 2.0) * 4.0 * axes
    time = 0.0
    for i in range(1, intervals):
        time += 0.5 * (h[i - 1] + h[i]) / math.sqrt((h[i] * c[i] + h[i - 1] * c[i + 1]) / (h[i - 1] + h[i]))
    mu = 0.3 * time / rows
    settled = False
    for steps in range(1, MAX_STEPS + 1):
        time, gap = assemble(
            c,
            h,
            q1,
            q2,
            q3,
            ease,
            top,
            rest_top,
            limit_a,
            limit_j,
            mu,
            steps == 1,
            dual_top,
            dual_c,
            dual_a,
            dual_j,
            gradient,
            diagonal,
            beside,
            apart,
        )
        if gap < gap_wanted * time and settled:
            return c, time, steps, CONVERGED
        tie_ends(ties, gradient, diagonal, beside, apart)
        step = -gradient
        solve_band(2, n - 3, diagonal, beside, apart, step)
        step[1] = ties[0] * step[2]
        step[n - 2] = ties[1] * step[n - 3]
        step[0] = 0.0
        step[n - 1] = 0.0
        primal, dual = dual_steps(
            c,
            step,
            h,
            q1,
            q2,
            q3,
            ease,
            top,
            rest_top,
            limit_a,
            limit_j,
            mu,
            dual_top,
            dual_c,
            dual_a,
            dual_j,
            move_top,
            move_c,
            move_a,
            move_j,
        )
        go_primal = min(1.0, TO_THE_WALL / primal) if primal > 0.0 else 1.0
        go_dual = min(1.0, TO_THE_WALL / dual) if dual > 0.0 else 1.0
        grown = 0.0
        for i in range(2, n - 2):
            grown = max(grown, step[i] / c[i])
        c += go_primal * step
        dual_top += go_dual * move_top
        dual_c += go_dual * move_c
        dual_a += go_dual * move_a
        dual_j += go_dual * move_j
        worse = min(go_primal, go_dual)
        settled = worse > 0.6 and grown < STILL_GROWING
        # the larger the last step, the more the multipliers are reduced
        mu = gap / rows * max(0.3, 1.0 - worse) if steps > 1 else mu
    return c, time, MAX_STEPS, STALLED
