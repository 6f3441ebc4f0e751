"""The programmed curve in the part frame as a fine polyline, and the distance of points to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twin.compiled_functions import compiled
from twin.program import moves as mv
from twin.program.moves import Program

SAGITTA = 1e-8
"""Largest distance of the chords from an arc [m]."""
TURN_STEP = np.radians(0.1)
"""Spacing of points on moves whose A and C turn linearly: without TRAORI their path is curved in the part frame."""
MOST_POINTS = 20_000  # per move


class PathCurve(NamedTuple):
    """Poses (P, 5): points [m] in the part frame, A and C [rad]; length along them (P,) [m], the move that leads to each (P,)."""

    poses: np.ndarray
    length: np.ndarray
    row: np.ndarray


def programmed_curve(program: Program) -> PathCurve:
    """The programmed curve before rounding of corners; a move without motion has no point.

    A straight move needs no points within it if its tool axis turns on the great circle between its ends.
    """
    m, starts = program.moves, program.starts()
    base, step, radius1, radius2, _ = m.curves(np.arange(len(m)), starts)
    arc = m.kind == mv.ARC
    on_circle = m.traori & (arc | (m.workpiece_orientation & (m.kind != mv.RAPID)))
    of_turn = np.where(on_circle, 1.0, np.abs(step[:, 3:]).max(axis=1) / TURN_STEP)
    of_arc = m.angle / np.sqrt(8.0 * SAGITTA / np.maximum(np.linalg.norm(radius1, axis=1), 1e-6))
    moves = arc | (np.abs(m.target - starts).max(axis=1) > 1e-12)
    parts = np.where(moves, np.clip(np.ceil(np.maximum(of_turn, of_arc)), 1, MOST_POINTS), 0).astype(int)
    row = np.repeat(np.arange(len(m)), parts)
    share = (1.0 + np.arange(len(row)) - (np.cumsum(parts) - parts)[row]) / parts[row]
    phi = (share * m.angle[row])[:, None]
    poses = base[row] + share[:, None] * step[row]
    poses[:, :3] += np.cos(phi) * radius1[row] + np.sin(phi) * radius2[row]
    poses, row = np.vstack([starts[:1], poses]), np.concatenate([[0], row])
    axes = ~m.traori[row]
    poses[axes] = mv.tips_at(program.kinematics, poses[axes], m.tool_length[row[axes]])
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    return PathCurve(poses, np.concatenate([[0.0], np.cumsum(steps)]), row)


@compiled(allocates=True)
def nearest_along(points, length, at, hint, back, ahead):
    """Distance (n,) of points `at` (n, 3) to a polyline of points or poses, and the length (n,) of the polyline up to the nearest point.

    Each is searched between hint - back and hint + ahead along the polyline; a hint of NaN means the foot of the point before.
    """
    n = at.shape[0]
    distance, foot = np.empty(n), np.empty(n)
    last = points.shape[0] - 2
    first = 0
    before = 0.0
    for i in range(n):
        middle = before if np.isnan(hint[i]) else hint[i]
        low, high = middle - back, middle + ahead
        while first > 0 and length[first] > low:
            first -= 1
        while first < last and length[first + 1] < low:
            first += 1
        best, best_foot = np.inf, middle
        k = first
        while k <= last:
            square = 0.0
            along = 0.0
            for d in range(3):
                edge = points[k + 1, d] - points[k, d]
                square += edge * edge
                along += edge * (at[i, d] - points[k, d])
            share = min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
            off = 0.0
            for d in range(3):
                off += (at[i, d] - points[k, d] - share * (points[k + 1, d] - points[k, d])) ** 2
            if off < best:
                best, best_foot = off, length[k] + share * (length[k + 1] - length[k])
            if length[k + 1] > high:
                break
            k += 1
        distance[i], foot[i] = np.sqrt(best), best_foot
        before = best_foot
    return distance, foot
