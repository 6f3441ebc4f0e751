"""The nodes of the time law: dense where the speed may change, sparse where only the feed limits it.

They are the breaks of the spline, divided near stops and slow corners. From there the distance of the nodes grows by DIVIDE per
length; the first node lies 1/1000 of the run-up to feed from the stop.
"""

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.program import axis_path, elements
from twin.program.blend import Spline

DIVIDE = 0.06
BEND = 0.1  # change of direction [rad] within an interval
FINEST = 65.0  # nodes at least over a run-up
SHORTEST = 1e-4  # of a piece of the spline: an interval at least
CLOSE = 1e-6  # of a piece of the spline: a change of feed nearer to its end counts as there
NEAR = 0.1  # of a piece of the spline: on a straight, a break nearer to a change of feed moves onto it
STRAIGHT = 1e-12  # m or rad, bend of a piece that counts as straight
AT_EASE = 0.5  # an axis below this share of its limits does not make the path slower


class Limits(NamedTuple):
    """Speed, acceleration and jerk limits of X Y Z A C (5,) in SI."""

    speed: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray


class Feeds(NamedTuple):
    """Feed per element (E,): greatest speed [m/s or rad/s] (infinite: rapid), and whether it is that of the rotary axes."""

    speed: np.ndarray
    rotary: np.ndarray


class Way(NamedTuple):
    """Input of a time law: the spline of the path, the elements that it is made of, the transformation of the axes, limits and feeds."""

    spline: Spline
    elements: elements.Elements
    frames: axis_path.Frames
    limits: Limits
    feeds: Feeds


def split_at_feeds(s: Spline, e: elements.Elements, feeds: Feeds) -> Spline:
    """The same path with a break of the spline wherever the feed changes, so that no piece has two feeds.

    A break on a straight is no property of the path. If it lies close to a change of feed it moves there: many nodes around a piece of a micrometre
    would weigh more in the optimisation than the ways beside it, and would leave a dip of the speed.
    """
    changes = 1 + np.flatnonzero((feeds.speed[1:] != feeds.speed[:-1]) | (feeds.rotary[1:] != feeds.rotary[:-1]))
    at = e.u[changes]
    piece = np.clip(np.searchsorted(s.t, at, side="right") - 1, 0, len(s.t) - 2)
    share = (at - s.t[piece]) / (s.t[piece + 1] - s.t[piece])
    near = np.where(share < NEAR, piece, np.where(share > 1.0 - NEAR, piece + 1, 0))
    alone = (near > 0) & (near < len(s.t) - 1) & (np.bincount(near, minlength=1)[near] == 1)
    inside = np.minimum(share, 1.0 - share) > CLOSE
    at, piece, near, moves = at[inside], piece[inside], near[inside], alone[inside]
    if not len(at):
        return s
    h = np.diff(s.t)[:, None]
    straight = np.all(np.abs(s.c[:, 2]) * h**2 + np.abs(s.c[:, 3]) * h**3 < STRAIGHT, axis=1)
    moves[moves] = straight[near[moves] - 1] & straight[near[moves]]
    t, c = s.t.copy(), s.c.copy()
    t[near[moves]], c[near[moves]] = at[moves], _from(s, near[moves], at[moves])
    s = Spline(t, c)
    at, piece = at[~moves], piece[~moves]
    return Spline(np.insert(s.t, piece + 1, at), np.insert(s.c, piece + 1, _from(s, piece, at), axis=0))


def _from(s: Spline, piece: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Coefficients of these pieces counted from the parameters `at` instead of their breaks."""
    x = (at - s.t[piece])[:, None]
    c0, c1, c2, c3 = (s.c[piece, k] for k in range(4))
    return np.stack([c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2.0 * c2 + 3.0 * x * c3), c2 + 3.0 * x * c3, c3], axis=1)


@compiled(allocates=True)
def _run_up(s, j, f, limits, feed, rotary):
    """Way [m of u] from rest to feed in the direction of piece j under the jerk and acceleration limits."""
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    axis_path.spline_jet(s, j, s.t[j], w)
    axis_path.axis_jet(f, w, work, q)
    speed, jerk, acceleration = along(w, feed, rotary), np.inf, np.inf
    for k in range(5):
        size = abs(q[1, k])
        if size > 1e-12:
            speed = min(speed, limits.speed[k] / size)
            acceleration = min(acceleration, limits.acceleration[k] / size)
            jerk = min(jerk, limits.jerk[k] / size)
    return speed * max(np.sqrt(speed / jerk), 0.5 * speed / acceleration)


@compiled(allocates=True)
def along(w, feed, rotary):
    """Path speed du/dt that gives the feed at a point with jets w."""
    square = w[1, 3] ** 2 + w[1, 4] ** 2 if rotary else w[1, 0] ** 2 + w[1, 1] ** 2 + w[1, 2] ** 2
    size = np.sqrt(square)
    return feed / size if size > 1e-9 else np.inf


@compiled(allocates=True)
def _at_ease(s, j, f, limits, feed, rotary):
    """Whether all axes follow piece j at its feed within the share AT_EASE of every limit; then only the feed limits the speed."""
    w, q, work = np.empty((4, 5)), np.empty((4, 5)), np.empty((5, 4, 4))
    step = 0.5 * (s.t[j + 1] - s.t[j])
    a = np.empty(3)
    for part in range(3):
        axis_path.spline_jet(s, j, s.t[j] + part * step, w)
        a[part] = along(w, feed, rotary) ** 2
        if not np.isfinite(a[part]):
            return False
    bend = (a[0] - 2.0 * a[1] + a[2]) / step**2
    for part in range(3):
        axis_path.spline_jet(s, j, s.t[j] + part * step, w)
        axis_path.axis_jet(f, w, work, q)
        slope = (a[2] - a[0]) / (2.0 * step) + bend * (part - 1.0) * step
        for k in range(5):
            speed = abs(q[1, k]) * np.sqrt(a[part])
            acceleration = abs(0.5 * q[1, k] * slope + q[2, k] * a[part])
            jerk = abs(0.5 * q[1, k] * bend + 1.5 * q[2, k] * slope + q[3, k] * a[part]) * np.sqrt(a[part])
            if max(speed / limits.speed[k], acceleration / limits.acceleration[k], jerk / limits.jerk[k]) > AT_EASE:
                return False
    return True


@compiled(allocates=True)
def _slope_change(s, j):
    """Change of direction of the path within piece j (rad, for small changes)."""
    h = s.t[j + 1] - s.t[j]
    square = 0.0
    for d in range(5):
        change = h * (2.0 * s.c[j, 2, d] + 3.0 * h * s.c[j, 3, d])
        square += (change if d < 3 else elements.REFERENCE_RADIUS * change) ** 2
    return np.sqrt(square)


@compiled(allocates=True)
def run_ups(way):
    """Run-up way of each piece, at most half the stretch."""
    s, e, f, limits, feeds = way
    pieces = s.t.shape[0] - 1
    out = np.empty(pieces)
    i = 0
    for j in range(pieces):
        i = elements.find(e.u, 0.5 * (s.t[j] + s.t[j + 1]), i)
        out[j] = min(_run_up(s, j, f, limits, feeds.speed[i], feeds.rotary[i]), 0.5 * s.t[pieces])
    return out


@compiled(allocates=True)
def grid(way):
    """Nodes of the time law, and the piece of the spline in which each interval lies."""
    s, e, f, limits, feeds = way
    pieces = s.t.shape[0] - 1
    step = np.empty(pieces + 1)  # node distance wanted at the breaks
    far = np.full(pieces + 1, np.inf)  # way to the next place where the speed may have to change
    run_up = run_ups(way)
    i = 0
    for j in range(pieces):
        before = i
        i = elements.find(e.u, 0.5 * (s.t[j] + s.t[j + 1]), i)
        change = _slope_change(s, j)
        size = (s.t[j + 1] - s.t[j]) / min(8.0, max(1.0, np.ceil(change / BEND)))
        step[j] = min(step[j], size) if j else size
        step[j + 1] = size
        bent = (change > 0.05 * BEND or f.active) and not _at_ease(s, j, f, limits, feeds.speed[i], feeds.rotary[i])
        if bent or feeds.speed[i] != feeds.speed[before]:
            far[j] = 0.0
            far[j + 1] = 0.0
        if j and feeds.speed[i] != feeds.speed[before]:
            # the speed changes within the run-up of the slower side, however long the faster one is
            least = SHORTEST * min(s.t[j] - s.t[j - 1], s.t[j + 1] - s.t[j])
            step[j] = min(step[j], max(min(run_up[j - 1], run_up[j]) / FINEST, least))
    # the first and last interval have constant jerk; next to them the steps grow in proportion to the distance from rest
    first_step, last_step = run_up[0] / 1000.0, run_up[pieces - 1] / 1000.0
    step[0] = max(DIVIDE * first_step, SHORTEST * s.t[1])
    step[pieces] = max(DIVIDE * last_step, SHORTEST * (s.t[pieces] - s.t[pieces - 1]))
    far[0] = 0.0
    far[pieces] = 0.0
    for j in range(1, pieces + 1):
        step[j] = min(step[j], step[j - 1] + DIVIDE * (s.t[j] - s.t[j - 1]))
        far[j] = min(far[j], far[j - 1] + (s.t[j] - s.t[j - 1]))
    for j in range(pieces - 1, -1, -1):
        step[j] = min(step[j], step[j + 1] + DIVIDE * (s.t[j + 1] - s.t[j]))
        far[j] = min(far[j], far[j + 1] + (s.t[j + 1] - s.t[j]))
    nodes = [0.0]
    piece: list[int] = []
    for j in range(pieces):
        first = len(nodes)
        at = s.t[j]
        while at < s.t[j + 1] * (1.0 - 1e-14):
            left, right = at - s.t[j], s.t[j + 1] - at
            clear = min(far[j] + left, far[j + 1] + right)
            # fine while the speed changes; once the feed is reached nothing happens
            longest = max(run_up[j] / FINEST, DIVIDE * (clear - 2.0 * run_up[j]))
            size = min(longest, step[j] + DIVIDE * left)
            size = min(size, (step[j + 1] + DIVIDE * right) / (1.0 + DIVIDE))  # DIVIDE times what is left behind it
            size = max(size, min(step[j], step[j + 1], SHORTEST * (s.t[j + 1] - s.t[j])))
            if j == 0 and left == 0.0:
                size = min(first_step, 0.5 * right)
            elif j == pieces - 1 and right < 1.5 * last_step:
                size = right
            if right < 2.0 * size:
                size = right if right < 1.3 * size else 0.5 * right
            at += size
            nodes.append(at)
            piece.append(j)
        # even out: the last step may have been longer
        factor = (s.t[j + 1] - s.t[j]) / (nodes[-1] - s.t[j])
        for k in range(first, len(nodes)):
            nodes[k] = s.t[j] + (nodes[k] - s.t[j]) * factor
        nodes[-1] = s.t[j + 1]
    return np.array(nodes), np.array(piece)
