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

Nodes are n = 0 .. N, intervals i = 0 .. N - 1; `twin.program.newton_step.rows_of` has the limits at them.
Coefficient i of the spline belongs to the middle of interval i - 1: node i lies between the coefficients i and i + 1.
"""

from __future__ import annotations

import math

import numpy as np

from twin.compiled_functions import compiled
from twin.program.newton_step import assemble, dual_steps, least_slack, node_values, solve_band

GAP = 0.001
"""The iteration ends when limits times multipliers (the duality gap) fall below this fraction of the time."""
MAX_STEPS = 200
START_SHARE = 0.5  # share of the jerk limit that the first guess aims at
STILL_GROWING = 0.2
"""The duality gap bounds the time only if the last Newton step was short: no coefficient grew by more than this fraction."""
TO_THE_WALL = 0.98  # share of the way to the nearest limit that a step may go


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
