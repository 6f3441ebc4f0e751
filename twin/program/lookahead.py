"""Look-ahead: the limits at the nodes of the time law, and long stretches in overlapping windows.

A stretch of any length is planned in windows of at most WINDOW nodes, each from rest to rest. Neighbours overlap by twice the
distance over which the artificial stop and start affect the speed, and are joined in the middle of the overlap, where both agree.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.errors import TwinError
from twin.program import axis_path, elements, timelaw
from twin.program.nodes import Way, along, grid, run_ups
from twin.system import cores

WINDOW = 20_000  # nodes planned at once
FELT = 6.0  # distance over which an artificial stop affects the speed, in run-ups to feed
MUCH_LONGER = 4.0  # a run-up longer than the following ones by this factor begins a new stretch
JOIN = 64  # nodes over which two windows are joined
MOST_THREADS = 4  # windows planned at the same time, each of which needs memory
SPEED_MARGIN, ACCELERATION_MARGIN, JERK_MARGIN = 0.9998, 0.9995, 0.999
"""Factors on the limits in planning, because limits may be exceeded slightly between two nodes."""


class TimeLaw(NamedTuple):
    """The time law of a stretch: nodes (N + 1,), piece of the spline per interval (N,), a and a' at the nodes (N + 1,)."""

    nodes: np.ndarray
    piece: np.ndarray
    a: np.ndarray
    slope: np.ndarray


Span = tuple[int, int, int]
"""First and last node of a window, and the first node where it replaces the previous window."""

Windows = dict[tuple[int, int], tuple[np.ndarray, np.ndarray]]
"""First and last node of each window planned so far -> the factors on its limits, its coefficients."""


@compiled(allocates=True)
def limit_rows(way, nodes, piece, q1, q2, q3, top):
    """Derivatives of the axes at the nodes into q1, q2, q3 and the greatest a by speed and feed into `top`."""
    s, e, f, limits, feeds = way
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    intervals = piece.shape[0]
    top[:] = np.inf
    i = 0
    for n in range(intervals):
        i = elements.find(e.u, nodes[n], i)
        for end in range(2):
            axis_path.spline_jet(s, piece[n], nodes[n + end], w)
            axis_path.axis_jet(f, w, work, q)
            # the smallest feed of the blocks that the interval touches
            speed = SPEED_MARGIN * along(w, feeds.speed[i], feeds.rotary[i])
            k = i + 1
            while k < feeds.speed.shape[0] and e.u[k] < nodes[n + 1]:
                speed = min(speed, SPEED_MARGIN * along(w, feeds.speed[k], feeds.rotary[k]))
                k += 1
            for k in range(5):
                q1[n + end, k] = q[1, k]
                q2[n + end, k] = q[2, k]
                q3[n, end, k] = q[3, k]
                if abs(q[1, k]) > 1e-12:
                    speed = min(speed, SPEED_MARGIN * limits.speed[k] / abs(q[1, k]))
            top[n + end] = min(top[n + end], speed * speed)


@compiled(allocates=True)
def keep_rest(q1, q2, q3, h, limit_j, most):
    """Lower the greatest a at the inner end of the first and last interval so that u ~ t^3 keeps the jerk limits there.

    With a = alpha u^(4/3) the jerk of an axis is alpha^(3/2) (2/9 q' + 2 q'' u + q''' u^2).
    """
    n = h.shape[0]
    for side in range(2):
        i, inner, outer = (0, 1, 0) if side == 0 else (n - 1, n - 1, n)
        alpha, sign = 1e12, 1.0 - 2.0 * side  # reversed in u, every odd derivative changes its sign
        for k in range(q1.shape[1]):
            rest = abs(2.0 / 9.0 * q1[outer, k])
            moved = abs(2.0 / 9.0 * sign * q1[inner, k] + 2.0 * q2[inner, k] * h[i] + sign * q3[i, 1 - side, k] * h[i] ** 2)
            size = max(rest, moved)
            if size > 0.0:
                alpha = min(alpha, (limit_j[k] / size) ** (2.0 / 3.0))
        most[inner] = min(most[inner], alpha * h[i] ** (4.0 / 3.0))


def _window(way: Way, nodes: np.ndarray, piece: np.ndarray, ease: np.ndarray) -> np.ndarray:
    """Coefficients of one window, from rest to rest; `ease` (2, interval) scales the acceleration and the jerk limits."""
    n = len(piece)
    q1, q2, q3, top = np.empty((n + 1, 5)), np.empty((n + 1, 5)), np.empty((n, 2, 5)), np.empty(n + 1)
    limit_rows(way, nodes, piece, q1, q2, q3, top)
    moving = np.flatnonzero(np.any(np.abs(q1) > 1e-12, axis=0) | np.any(np.abs(q2) > 1e-12, axis=0))
    q1, q2, q3 = (np.ascontiguousarray(q[..., moving]) for q in (q1, q2, q3))
    at_node = np.minimum(np.append(ease[0], 1.0), np.append(1.0, ease[0]))
    limit_a = ACCELERATION_MARGIN * np.outer(at_node, way.limits.acceleration[moving])
    h, most, limit_j = np.diff(nodes), top.copy(), JERK_MARGIN * way.limits.jerk[moving]
    keep_rest(q1, q2, q3, h, limit_j, most)
    rows = timelaw.rows_of(h, q1, q2, q3, most, top, limit_a, limit_j, np.ascontiguousarray(ease[1]))
    c, started = timelaw.time_law(h, timelaw.first_guess(h, q1, q2, q3, top, limit_a, limit_j), rows)
    if not started:
        raise TwinError("interpolator: no feasible start was found for the time law; report this program")
    return c


@compiled(allocates=True)
def felt_to(nodes, piece, run_up, first, last):
    """The last node before `last` that a stop at `last` does not affect (-1: none after `first`).

    The effect ends after FELT times the longest run-up on the way. A rapid move close to the stop does not count if slow moves
    over such a way precede it.
    """
    from_node = last  # end of the stretch that is looked at
    longest = -1.0  # nothing of it yet
    for i in range(last - 1, first - 1, -1):
        here = run_up[piece[i]]
        if longest >= 0.0 and here > MUCH_LONGER * longest:
            from_node = i
            longest = -1.0
            continue
        longest = max(longest, here)
        if nodes[from_node] - nodes[i] >= FELT * longest:
            return i
    return -1


def plan(
    way: Way,
    progress: Callable[[float], None] | None = None,
    eased: tuple[TimeLaw, np.ndarray] | None = None,
    kept: Windows | None = None,
) -> TimeLaw:
    """The time law of a stretch: windows, each planned on its own thread, joined where the artificial stops have no effect.

    `progress` is called with the share done. `eased`: an earlier law, and factors (2, interval) on its acceleration and jerk limits for the
    new plan. Windows in `kept` whose factors are unchanged are reused.
    """
    nodes, piece = grid(way) if eased is None else (eased[0].nodes, eased[0].piece)
    ease, known = np.ones((2, len(piece))) if eased is None else eased[1], {} if kept is None else kept
    total = len(piece)
    c = np.zeros(total + 2)

    def planned(span: Span) -> np.ndarray:
        begin, end, _ = span
        factors, new = known.get((begin, end), (None, np.empty(0)))
        if factors is None or not np.array_equal(factors, ease[:, begin:end]):
            new = _window(way, nodes[begin : end + 1], piece[begin:end], ease[:, begin:end])
            known[begin, end] = ease[:, begin:end].copy(), new
        return new

    spans = _spans(nodes, piece, run_ups(way))
    pool = ThreadPoolExecutor(min(MOST_THREADS, cores()))
    try:
        windows = pool.map(planned, spans) if len(spans) > 1 else map(planned, spans)
        for (begin, end, join_at), new in zip(spans, windows):
            # from one to the other over JOIN nodes: a mean of two laws that keep the limits keeps them
            share = np.clip((np.arange(begin, end + 2) - join_at) / JOIN, 0.0, 1.0) if begin else np.ones(end + 2)
            share = share * share * (3.0 - 2.0 * share)
            c[begin : end + 2] = np.where(share >= 1.0, new, (1.0 - share) * c[begin : end + 2] + share * new)
            if progress:
                progress(end / total)
    finally:
        pool.shutdown(cancel_futures=True)
    return TimeLaw(nodes, piece, *timelaw.node_values(np.diff(nodes), c))


def _spans(nodes: np.ndarray, piece: np.ndarray, run_up: np.ndarray) -> list[Span]:
    """The windows of a stretch; `run_up` (piece,)."""
    total, window = len(piece), WINDOW
    begin = join_at = 0
    spans: list[Span] = []
    while True:
        end = min(begin + window, total)
        if end == total:
            return [*spans, (begin, end, join_at)]
        join = felt_to(nodes, piece, run_up, begin, end) - JOIN
        begin_next = felt_to(nodes, piece, run_up, begin, join) - JOIN
        if join <= join_at + JOIN or begin_next <= begin:
            window *= 2  # the run-ups are longer than the window
            continue
        spans.append((begin, end, join_at))
        begin, join_at, window = begin_next, join, WINDOW


@compiled(allocates=True)
def excess(way, law):
    """Largest acceleration and jerk within each interval, between the nodes, as shares of their limits (2, interval)."""
    s, _, f, limits, _ = way
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    n = law.piece.shape[0]
    out = np.zeros((2, n))
    for i in range(1, n - 1):
        h = law.nodes[i + 1] - law.nodes[i]
        bend = (law.slope[i + 1] - law.slope[i]) / h
        for part in range(1, 4):
            x = 0.25 * part * h
            slope = law.slope[i] + bend * x
            a = law.a[i] + x * (law.slope[i] + 0.5 * bend * x)
            axis_path.spline_jet(s, law.piece[i], law.nodes[i] + x, w)
            axis_path.axis_jet(f, w, work, q)
            for k in range(5):
                second = abs(0.5 * q[1, k] * slope + q[2, k] * a)
                third = abs(0.5 * q[1, k] * bend + 1.5 * q[2, k] * slope + q[3, k] * a) * np.sqrt(max(a, 0.0))
                out[0, i] = max(out[0, i], second / limits.acceleration[k])
                out[1, i] = max(out[1, i], third / limits.jerk[k])
    return out
