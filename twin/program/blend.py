"""Smooth the programmed curve: corners and short chords become a cubic spline within the tolerance, which the drives can follow.

The curve w(u) (lines, arcs) is turned into a cubic B-spline S(u) = sum_i P_i B_i(u) whose control points are taken from the
curve at the knot averages, P_i = w((t_i+1 + t_i+2 + t_i+3) / 3) (Schoenberg's variation diminishing spline). It is continuous to the second
derivative, lies on lines exactly, overshoots nowhere, and departs from a corner of slope step D by |D| h / 6, from a
smooth curve by w'' h^2 / 6, where h is the local knot distance. The tolerance therefore determines h:

- at a corner between long blocks a knot lies on the corner and h = 6 tolerance / |D|, at most 0.45 of the shorter block;
- in polylines of short chords (CAM) h is the largest for which the mean of the curve over +-h stays within the tolerance: h
  spans several chords, and control points are means over h, which removes the facets and the rounding of the program;
- an arc has its control points moved outwards so that the spline keeps the radius.

h grows from each tight place by at most GROWTH per length. The result is measured at every block end and refined until
each is within its tolerance.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline

from twin.compiled_functions import compiled
from twin.program import elements as el
from twin.program.axis_path import spline_jet

GROWTH = 0.3
LONGEST_SHARE = 0.45  # of the shorter block beside a corner: two blends never meet
CORNER = 0.3  # a larger slope step is always a corner, never a facet
WITHIN = 0.9  # share of the tolerance used in planning; the rest covers neglected terms
ARC_STEP = 0.06  # knot distance on an arc in rad
END_ERROR = 5e-8  # m, error of an arc near an exact stop
ACCEPTED = 0.98  # of the tolerance, measured at the same parameter
REFINEMENTS = 12
LONGEST_SPAN = 5e-3  # m, knot distance on lines far from corners


class Spline(NamedTuple):
    """Cubic pieces on the breaks t (M + 1,): w = c0 + c1 s + c2 s^2 + c3 s^3, s = u - t_j, `c` (M, 4, 5)."""

    t: np.ndarray
    c: np.ndarray


@compiled(allocates=True)
def _ratio(d, tolerance, angle_tolerance):
    """Size of a deviation (5,) in tolerances."""
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]) / tolerance
    return max(length, abs(d[3]) / angle_tolerance, abs(d[4]) / angle_tolerance)


@compiled(allocates=True)
def knot_distances(e, tolerance, angle_tolerance, distance):
    """Knot distance h (E + 1,) wanted at every joint, and whether a knot must lie on it.

    `tolerance` [m], `angle_tolerance` [rad], `distance` [m] (ADIS, else infinite) per joint (E + 1,).
    """
    n = e.angle.shape[0]
    total = e.u[n]
    h = np.full(n + 1, np.inf)
    corner = np.zeros(n + 1, np.bool_)
    before, after, here = np.empty(5), np.empty(5), np.empty(5)
    if e.angle[0] > 0.0:
        h[0] = np.sqrt(6.0 * END_ERROR * np.sqrt(np.sum(e.radius1[0] ** 2)))
    for k in range(1, n):
        el.slope(e, k - 1, True, before)
        el.slope(e, k, False, after)
        step = _ratio(after - before, tolerance[k], angle_tolerance[k])
        turn = np.sqrt(np.sum((after[:3] - before[:3]) ** 2)) + el.REFERENCE_RADIUS * (
            abs(after[3] - before[3]) + abs(after[4] - before[4])
        )
        room = min(e.u[k] - e.u[k - 1], e.u[k + 1] - e.u[k])
        single = WITHIN * 6.0 / step if step > 0.0 else np.inf
        if turn > 1e-9 and (turn > CORNER or single < LONGEST_SHARE * room):
            corner[k] = True
            h[k] = min(single, LONGEST_SHARE * room, distance[k])
        if e.angle[k - 1] > 0.0 or e.angle[k] > 0.0 or (not corner[k] and turn > 1e-9):
            # the mean over +-h instead of the point: smaller until within tolerance
            near = h[k - 1] + GROWTH * (e.u[k] - e.u[k - 1])
            size = min(min(h[k], near), min(0.4 * total, distance[k] / 2.5))
            el.point(e, k, e.u[k], here)
            for _ in range(60):
                reach = min(size, e.u[k], total - e.u[k])
                el.mean(e, e.u[k] - reach, e.u[k] + reach, k, before)
                off = _ratio(before - here, tolerance[k], angle_tolerance[k])
                if off <= WITHIN:
                    break
                size *= max(0.5, min(0.9, WITHIN / off))
            h[k] = size
    if e.angle[n - 1] > 0.0:
        h[n] = np.sqrt(6.0 * END_ERROR * np.sqrt(np.sum(e.radius1[n - 1] ** 2)))
    return h, corner


@compiled(allocates=True)
def grade(e, h):
    """Limit the growth of h from tight joints to GROWTH per length (in place)."""
    n = h.shape[0]
    cap = min(LONGEST_SPAN, e.u[n - 1] / 8.0)
    for k in range(n):
        h[k] = min(h[k], cap)
    for k in range(1, n):
        h[k] = min(h[k], h[k - 1] + GROWTH * (e.u[k] - e.u[k - 1]))
    for k in range(n - 2, -1, -1):
        h[k] = min(h[k], h[k + 1] + GROWTH * (e.u[k + 1] - e.u[k]))


@compiled(allocates=True)
def _wanted(e, h, corner, i, at):
    """h at parameter `at` of element i: constant for 2 h around a corner, then growing; capped on arcs."""
    low, high = at - e.u[i], e.u[i + 1] - at
    if corner[i]:
        low = max(0.0, low - 2.0 * h[i])
    if corner[i + 1]:
        high = max(0.0, high - 2.0 * h[i + 1])
    size = min(h[i] + GROWTH * low, h[i + 1] + GROWTH * high)
    if e.angle[i] > 0.0:
        size = min(size, ARC_STEP * (e.u[i + 1] - e.u[i]) / e.angle[i])
    return min(size, min(LONGEST_SPAN, e.u[e.u.shape[0] - 1] / 8.0))


@compiled(allocates=True)
def breaks(e, h, corner):
    """Breaks t of the spline: marched by h from one corner (or end) to the next, then fitted to meet it."""
    n = e.angle.shape[0]
    t, begin = [0.0], 0
    while begin < n:
        stop = begin + 1
        while stop < n and not corner[stop]:
            stop += 1
        first, i = len(t), begin
        # march until the end of this piece is passed
        while t[-1] < e.u[stop] * (1.0 - 1e-14):
            i = el.find(e.u, t[-1], i)
            size = _wanted(e, h, corner, i, t[-1])
            middle = min(t[-1] + 0.5 * size, e.u[stop])
            t.append(t[-1] + _wanted(e, h, corner, el.find(e.u, middle, i), middle))
        # shrink the steps a little so that the last one ends on the corner
        least = 2 if n > 1 else 8
        begun = t[first - 1]
        if len(t) - first < least:
            while len(t) > first:
                t.pop()
            for k in range(1, least + 1):
                t.append(begun + (e.u[stop] - begun) * k / least)
        factor = (e.u[stop] - begun) / (t[-1] - begun)
        for k in range(first, len(t)):
            t[k] = begun + (t[k] - begun) * factor
        t[-1] = e.u[stop]
        begin = stop
    return np.array(t)


@compiled(allocates=True)
def control_points(e, t):
    """Knots and control points, from the curve, of the spline on given breaks."""
    pieces = t.shape[0] - 1
    total = t[pieces]
    knots = np.empty(pieces + 7)
    for k in range(pieces + 7):
        knots[k] = t[min(max(k - 3, 0), pieces)]
    control = np.empty((pieces + 3, 5))
    i = 0
    for k in range(pieces + 3):
        at = (knots[k + 1] + knots[k + 2] + knots[k + 3]) / 3.0
        size = (knots[k + 3] - knots[k + 1]) / 2.0
        i = el.find(e.u, at, i)
        low, high = at - 0.5 * size, at + 0.5 * size
        a, b = el.find(e.u, low, i), el.find(e.u, high, i)
        if b - a > 1 and low > 0.0 and high < total:
            # several chords within one knot distance: their mean
            el.mean(e, low, high, a, control[k])
        else:
            el.point(e, i, min(at, total), control[k])
            if e.angle[i] > 0.0 and 1 < k < pieces + 1:
                rate = e.angle[i] / (e.u[i + 1] - e.u[i])
                phi = (at - e.u[i]) * rate
                swell = 3.0 / (2.0 + np.cos(size * rate)) - 1.0
                if at - 1.5 * size > e.u[i] and at + 1.5 * size < e.u[i + 1]:
                    for d in range(3):
                        control[k, d] += swell * (np.cos(phi) * e.radius1[i, d] + np.sin(phi) * e.radius2[i, d])
    return knots, control


@compiled(allocates=True)
def joint_ratios(e, s, tolerance, angle_tolerance):
    """Deviation of the spline at every joint (E + 1,) in tolerances; next to an arc also between joints, assigned to the nearer one."""
    n = e.angle.shape[0]
    out = np.zeros(n + 1)
    have, want = np.empty((4, 5)), np.empty(5)
    j = 0
    for k in range(1, n):
        j = el.find(s.t, e.u[k], j)
        spline_jet(s, j, e.u[k], have)
        el.point(e, k, e.u[k], want)
        out[k] = _ratio(have[0] - want, tolerance[k], angle_tolerance[k])
    i = 0
    for j in range(1, s.t.shape[0] - 1):
        i = el.find(e.u, s.t[j], i)
        if e.angle[max(0, i - 1) : i + 2].max() > 0.0:
            spline_jet(s, j, s.t[j], have)
            el.point(e, i, s.t[j], want)
            k = i if s.t[j] - e.u[i] < e.u[i + 1] - s.t[j] else i + 1
            out[k] = max(out[k], _ratio(have[0] - want, tolerance[k], angle_tolerance[k]))
    return out


def blend(e: el.Elements, tolerance: np.ndarray, angle_tolerance: np.ndarray, distance: np.ndarray) -> tuple[Spline, np.ndarray]:
    """The spline of a stretch and its deviation at every joint in tolerances (at most 1)."""
    h, corner = knot_distances(e, tolerance, angle_tolerance, distance)
    for _ in range(REFINEMENTS + 1):
        grade(e, h)
        t = breaks(e, h, corner)
        curve = BSpline(*control_points(e, t), 3)
        s = Spline(t, np.stack([curve(t[:-1], order) / math.factorial(order) for order in range(4)], axis=1))
        ratios = joint_ratios(e, s, tolerance, angle_tolerance)
        if ratios.max() <= ACCEPTED:
            break
        h *= np.where(ratios > ACCEPTED, np.maximum(0.3, 0.9 / np.maximum(ratios, ACCEPTED)), 1.0)
    return s, ratios
