"""Place a part so that its program fits the travel of a machine: the smallest shift of the part frame, from a linear program.

With the part shifted by d on the table, the linear axes of a move at table angles (A, C) go to

    axes = axes without shift + R(A, C) d,      low <= axes <= high for every move

and the feasible d with the smallest |dx| + |dy| + |dz| is chosen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics
from twin.program.moves import ARC, Program, axes_at

KEEP = 1e-4
"""Clearance from the ends of the travel [m]."""

ALONG_ARC = 16
"""Points of an arc that must fit in addition to its end, because it may extend beyond both ends."""


class OutsideTravel(InputError):
    """A program that leaves the travel of the machine; `program` is the program as read."""

    def __init__(self, message: str, program: Program) -> None:
        super().__init__(message)
        self.program = program


def placed(program: Program) -> Program:
    """The program with its part shifted into the travel. Raises InputError, which names the axis, if no place fits."""
    kinematics, moves = program.kinematics, program.moves
    own_turn = _rotations(kinematics, moves.target[:, 3:])
    bulge, of_move = _along_arcs(program)
    at_axes = np.where(moves.traori[of_move, None], np.einsum("nij,nj->ni", own_turn[of_move], bulge), bulge)
    ends = axes_of(program)[:, :3]
    axes = np.vstack([ends, ends[of_move] + at_axes])
    turned = np.concatenate([own_turn, own_turn[of_move]])
    home = np.clip(0.0, kinematics.travel[:, 0], kinematics.travel[:, 1])
    starts_at_home = np.allclose(program.start, home)
    if not starts_at_home:
        at_start = _rotations(kinematics, program.start[None, 3:])
        axes, turned = np.vstack([program.start[:3], axes]), np.concatenate([at_start, turned])
    low, high = kinematics.travel[:3, 0] + KEEP, kinematics.travel[:3, 1] - KEEP
    shift = _least_shift(axes, turned, low, high)
    if shift is None:
        span, travel = np.ptp(axes, axis=0) * 1e3, (high - low + 2.0 * KEEP) * 1e3
        k = int(np.argmax(span / travel))
        what = f"axis {'XYZ'[k]} moves over {span[k]:.1f} mm, its travel is {travel[k]:.1f} mm"
        raise InputError(f"{program.path}: no place on the table fits: {what}; take a machine with more travel")
    target, centre, start = moves.target.copy(), moves.centre.copy(), program.start.copy()
    own = np.where(moves.traori[:, None], shift, own_turn @ shift)
    target[:, :3] += own
    centre[moves.kind == ARC] += own[moves.kind == ARC]
    if not starts_at_home:
        start[:3] += at_start[0] @ shift
    x, y, z = shift * 1e3
    note = f"placed to fit the travel: the part is shifted by X {x:.3f} Y {y:.3f} Z {z:.3f} mm on the table"
    return replace(program, start=start, moves=replace(moves, target=target, centre=centre), notes=(*program.notes, note))


def axes_of(program: Program) -> np.ndarray:
    """Axes (move, 5) at the end of each move [m, rad]."""
    moves, axes = program.moves, program.moves.target.copy()
    axes[moves.traori] = axes_at(program.kinematics, axes[moves.traori], moves.tool_length[moves.traori])
    return axes


def _along_arcs(program: Program) -> tuple[np.ndarray, np.ndarray]:
    """Points along all arcs, each from the end of its arc (point, 3) [m] in the frame of its move, and the moves that they belong to."""
    rows = np.flatnonzero(program.moves.kind == ARC)
    _, _, radius1, radius2, _ = program.moves.curves(rows, program.moves.target[rows])
    back = np.minimum(program.moves.angle[rows], 2.0 * np.pi)[:, None, None] * (np.arange(1, ALONG_ARC) / ALONG_ARC)[:, None]
    points = (np.cos(back) - 1.0) * radius1[:, None] - np.sin(back) * radius2[:, None]
    return points.reshape(-1, 3), np.repeat(rows, ALONG_ARC - 1)


def _rotations(kinematics: Kinematics, angles: np.ndarray) -> np.ndarray:
    """Matrices (row, 3, 3) from a shift of the part to a shift of the linear axes, for table angles (row, 2)."""
    at_zero = kinematics.linear_axes(np.zeros((len(angles), 3)), angles)
    columns = [kinematics.linear_axes(np.tile(unit, (len(angles), 1)), angles) - at_zero for unit in np.eye(3)]
    return np.stack(columns, axis=2)


def _least_shift(axes: np.ndarray, turned: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
    """The smallest shift (3,) that brings all axes into the travel; None if there is none."""
    rows = turned.reshape(-1, 3)
    bound = np.eye(3)
    # d and its size t: R d <= high - axes, -R d <= axes - low, +-d <= t
    matrix = np.block([[rows, np.zeros_like(rows)], [-rows, np.zeros_like(rows)], [bound, -bound], [-bound, -bound]])
    limit = np.concatenate([(high - axes).ravel(), (axes - low).ravel(), np.zeros(6)])
    found = linprog([0.0] * 3 + [1.0] * 3, A_ub=matrix, b_ub=limit, bounds=[(None, None)] * 3 + [(0.0, None)] * 3, method="highs")
    return None if found.x is None or not found.success else np.asarray(found.x[:3])
