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
"""Spacing of points on moves of A and C without TRAORI, whose path is curved in the part frame."""
MOST_POINTS = 20_000  # per move


class Curve(NamedTuple):
    """Poses (P, 5): points [m] in the part frame, A and C [rad]; length along them (P,) [m], the move that leads to each (P,)."""

    poses: np.ndarray
    length: np.ndarray
    row: np.ndarray


def programmed_curve(program: Program) -> Curve:
    """The programmed curve before rounding of corners."""
    m, starts = program.moves, program.starts()
    turn = np.abs(m.target[:, 3:] - starts[:, 3:]).max(axis=1)
    bent = (m.kind == mv.ARC) | (~m.traori & (turn > 1e-12))
    kept = (np.abs(m.target - starts).max(axis=1) > 1e-12) | (m.kind == mv.ARC)
    pieces, rows = [_in_part(program, starts[:1], 0)], [np.zeros(1, int)]
    row = 0
    while row < len(m):
        if bent[row]:
            pieces.append(_in_part(program, _bent_points(program, starts[row], row), row))
            rows.append(np.full(len(pieces[-1]), row))
            row += 1
            continue
        # straight moves of one kind together
        end = row
        while end < len(m) and not bent[end] and m.traori[end] == m.traori[row] and m.tool_length[end] == m.tool_length[row]:
            end += 1
        index = np.arange(row, end)[kept[row:end]]
        if len(index):
            pieces.append(_in_part(program, m.target[index], row))
            rows.append(index)
        row = end
    poses = np.concatenate(pieces)
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    return Curve(poses, np.concatenate([[0.0], np.cumsum(steps)]), np.concatenate(rows))


def _in_part(program: Program, points: np.ndarray, row: int) -> np.ndarray:
    """Poses (n, 5) in the part frame from coordinates of move `row`."""
    length = np.full(len(points), program.moves.tool_length[row])
    return points if program.moves.traori[row] else mv.tips_at(program.kinematics, points, length)


def _bent_points(program: Program, start: np.ndarray, row: int) -> np.ndarray:
    """Points (n, 5) of an arc or of a move with rotary axes, without its start."""
    m = program.moves
    base, step, radius1, radius2, _ = m.curves(np.array(row), start)
    parts = np.abs(step[3:]).max() / TURN_STEP if not m.traori[row] else 1.0
    if m.kind[row] == mv.ARC:
        parts = max(parts, m.angle[row] / np.sqrt(8.0 * SAGITTA / max(float(np.linalg.norm(radius1)), 1e-6)))
    share = np.linspace(0.0, 1.0, int(min(MOST_POINTS, np.ceil(parts))) + 1)[1:, None]
    points, phi = base + share * step, share * m.angle[row]
    points[:, :3] += np.cos(phi) * radius1 + np.sin(phi) * radius2
    return points


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
