"""A second way to the fastest motion along a path, for comparison: slow, plain, and another discretisation and solver.

Unknown are the values of a = (du/dt)^2 at many nodes, with finite differences for a' and a''. Speed and acceleration limits
are linear, the jerk limit is linearised on its safe side, the time as well; the linear programs are solved by HiGHS
until the time no longer falls.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, vstack

from twin.program import axis_path, elements, interpolator
from twin.program.stretches import great_circle_rows, stretch_of, stretches


def only_stretch(program, machine):
    """The input of the time law of a program without a stop in between."""
    starts = program.starts()
    (first, last), *more = stretches(program)
    assert not more
    stretch = stretch_of(program, starts, first, last, great_circle_rows(program, starts))
    return interpolator.way_of(program, machine, stretch)


def jets_at(spline, frames, at):
    """Derivatives 0 to 3 of the axes (4, n, 5) at parameters (n,)."""
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    out = np.empty((4, len(at), 5))
    for i, u in enumerate(at):
        j = elements.find(spline.t, u, 0)
        axis_path.spline_jet(spline, j, u, w)
        axis_path.axis_jet(frames, w, work, q)
        out[:, i] = q
    return out


def fastest_time(program, machine, nodes: int = 300, per_piece: int = 4, rounds: int = 40) -> float:
    """Time [s] of the fastest motion found along the path of the program."""
    spline, e, frames, limits, feeds = only_stretch(program, machine)
    total = spline.t[-1]
    # dense at both ends like t^3, and a few nodes in each piece of the spline
    t = np.linspace(0.0, 1.0, nodes)
    u = total * (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5)
    inner = np.concatenate([np.linspace(a, b, per_piece + 1)[:-1] for a, b in zip(spline.t[:-1], spline.t[1:])])
    u = np.unique(np.concatenate([u, inner]))
    u = u[np.concatenate([[True], np.diff(u) > 1e-9 * total])]
    u[-1] = total
    n = len(u)
    q = jets_at(spline, frames, u)
    eps = 1e-6 * np.diff(u).min()
    third = [jets_at(spline, frames, np.clip(u + side * eps, 0.0, total))[3] for side in (-1, 1)]
    left, right = np.diff(u)[:-1], np.diff(u)[1:]
    m = n - 2

    def rows(a, b, c):
        i = np.arange(m)
        return csr_matrix((np.concatenate([a, b, c]), (np.tile(i, 3), np.concatenate([i, i + 1, i + 2]))), shape=(m, n))

    slope = rows(-right / left / (left + right), (right - left) / left / right, left / right / (left + right))
    bend = rows(2 / left / (left + right), -2 / left / right, 2 / right / (left + right))
    here = rows(np.zeros(m), np.ones(m), np.zeros(m))
    top = np.full(n, np.inf)
    for i in range(n):
        k = {elements.find(e.u, min(max(u[i] + s * eps, 0.0), total), 0) for s in (-1, 1)}
        j = elements.find(spline.t, u[i], 0)
        w = np.empty((4, 5))
        axis_path.spline_jet(spline, j, u[i], w)
        part = {True: np.linalg.norm(w[1, 3:]), False: np.linalg.norm(w[1, :3])}
        top[i] = min((feeds.speed[x] / max(part[bool(feeds.rotary[x])], 1e-9)) ** 2 for x in k)
        for axis in range(5):
            if abs(q[1, i, axis]) > 1e-12:
                top[i] = min(top[i], (limits.speed[axis] / abs(q[1, i, axis])) ** 2)
    # from and to rest u = j t^3 / 6, so a = (9 j / 2)^(2/3) u^(4/3): without this the motion would start with a jump of acceleration
    for node, end, width in ((1, 0, u[1]), (-2, -1, total - u[-2])):
        path_jerk = min(limits.jerk[axis] / abs(q[1, end, axis]) for axis in range(5) if abs(q[1, end, axis]) > 1e-12)
        top[node] = min(top[node], (4.5 * path_jerk) ** (2.0 / 3.0) * width ** (4.0 / 3.0))
    accelerations, jerks = [], []
    for axis in range(5):
        q1, q2 = q[1, 1:-1, axis], q[2, 1:-1, axis]
        if np.abs(q1).max() < 1e-12:
            continue
        accelerations.append((_scaled(slope, 0.5 * q1) + _scaled(here, q2), limits.acceleration[axis]))
        jerks += [(_scaled(bend, 0.5 * q1) + _scaled(slope, 1.5 * q2) + _scaled(here, d[1:-1, axis]), limits.jerk[axis]) for d in third]
    # a slow start that keeps every limit
    a = (u * (total - u)) ** (4.0 / 3.0)
    a *= 0.5 * (top[1:-1] / a[1:-1]).min()
    while any(np.any(np.abs(f @ a) > bound) for f, bound in accelerations) or any(
        np.any(np.abs(f @ a) * np.sqrt(a[1:-1]) > bound) for f, bound in jerks
    ):
        a *= 0.7
    best = np.inf
    for _ in range(rounds):
        weight = _time_gradient(u, a)
        matrix, side = [], []
        for f, bound in accelerations:
            matrix += [f, -f]
            side += [np.full(m, bound)] * 2
        for f, bound in jerks:
            # bound / sqrt(a) is convex: its tangent at the last a lies below
            fall = _scaled(here, 0.5 * bound * a[1:-1] ** -1.5)
            matrix += [f + fall, fall - f]
            side += [1.5 * bound / np.sqrt(a[1:-1])] * 2
        bounds = np.column_stack([0.3 * a, np.minimum(3.0 * a, top)])
        bounds[[0, -1]] = 0.0
        scale = np.abs(a).max()
        scaled = [row.multiply(1.0 / s[:, None]) for row, s in zip(matrix, side)]
        found = linprog(
            -weight * scale,
            vstack(scaled) * scale,
            np.ones(2 * m * (len(accelerations) + len(jerks))),
            bounds=bounds / scale,
            method="highs",
        )
        if not found.success:
            break
        a = found.x * scale
        time = _time(u, a)
        if time > best * (1.0 - 1e-4):
            break
        best = min(best, time)
    return best


def _scaled(matrix, values):
    return matrix.multiply(values[:, None]).tocsr()


def _time(u, a):
    h, x = np.diff(u), np.sqrt(np.maximum(a, 0.0))
    parts = 2.0 * h / (x[1:] + x[:-1])
    return parts[1:-1].sum() + 3.0 * h[0] / x[1] + 3.0 * h[-1] / x[-2]


def _time_gradient(u, a):
    """- dT/da at the nodes."""
    h, x = np.diff(u), np.sqrt(np.maximum(a, 1e-300))
    out = np.zeros(len(u))
    share = h / (x[1:] + x[:-1]) ** 2
    out[1:-1] = (share[:-1] + share[1:]) / x[1:-1]
    return out
