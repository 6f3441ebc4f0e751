"""Place a part so that its program fits the travel of a machine: the smallest shift of the part frame, from a linear program.

With the part shifted by d on the table, the linear axes of a move at table angles (A, C) go to

    axes = axes without shift + R(A, C) d,      low <= axes <= high at every point of the programmed curve

and the feasible d with the smallest |dx| + |dy| + |dz| is chosen.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import linprog

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics
from twin.program.moves import ARC, Program, axes_at, programmed_curve

KEEP = 1e-4
"""Clearance from the ends of the travel [m]."""


class OutsideTravel(InputError):
    """A program that leaves the travel of the machine; `program` is the program as read."""

    def __init__(self, message: str, program: Program) -> None:
        super().__init__(message)
        self.program = program


def placed(program: Program) -> Program:
    """The program with its part shifted into the travel. Raises InputError, which names the axis, if no place fits."""
    kinematics, moves, curve = program.kinematics, program.moves, programmed_curve(program)
    home = np.clip(0.0, kinematics.travel[:, 0], kinematics.travel[:, 1])
    first = int(np.allclose(program.start, home))  # a start at home is not shifted
    poses, length = curve.poses[first:], moves.tool_length[curve.row[first:]]
    axes = axes_at(kinematics, poses, length)[:, :3]
    angles, group = np.unique(poses[:, 3:], axis=0, return_inverse=True)
    least, most = np.full((len(angles), 3), np.inf), np.full((len(angles), 3), -np.inf)
    np.minimum.at(least, group.ravel(), axes)
    np.maximum.at(most, group.ravel(), axes)
    low, high = kinematics.travel[:3, 0] + KEEP, kinematics.travel[:3, 1] - KEEP
    shift = _least_shift(least, most, _rotations(kinematics, angles), low, high)
    if shift is None:
        span, travel = np.ptp(axes, axis=0) * 1e3, (high - low + 2.0 * KEEP) * 1e3
        k = int(np.argmax(span / travel))
        what = f"axis {'XYZ'[k]} moves over {span[k]:.1f} mm, its travel is {travel[k]:.1f} mm"
        raise InputError(f"{program.path}: no place on the table fits: {what}; take a machine with more travel")
    target, centre, start = moves.target.copy(), moves.centre.copy(), program.start.copy()
    own = np.where(moves.traori[:, None], shift, _rotations(kinematics, target[:, 3:]) @ shift)
    target[:, :3] += own
    centre[moves.kind == ARC] += own[moves.kind == ARC]
    if not first:
        start[:3] += _rotations(kinematics, start[None, 3:])[0] @ shift
    x, y, z = shift * 1e3
    note = f"placed to fit the travel: the part is shifted by X {x:.3f} Y {y:.3f} Z {z:.3f} mm on the table"
    return replace(program, start=start, moves=replace(moves, target=target, centre=centre), notes=(*program.notes, note))


def axes_of(program: Program) -> np.ndarray:
    """Axes (move, 5) at the end of each move [m, rad]."""
    moves, axes = program.moves, program.moves.target.copy()
    axes[moves.traori] = axes_at(program.kinematics, axes[moves.traori], moves.tool_length[moves.traori])
    return axes


def _rotations(kinematics: Kinematics, angles: np.ndarray) -> np.ndarray:
    """Matrices (row, 3, 3) from a shift of the part to a shift of the linear axes, for table angles (row, 2)."""
    at_zero = kinematics.linear_axes(np.zeros((len(angles), 3)), angles)
    columns = [kinematics.linear_axes(np.tile(unit, (len(angles), 1)), angles) - at_zero for unit in np.eye(3)]
    return np.stack(columns, axis=2)


def _least_shift(least: np.ndarray, most: np.ndarray, turned: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray | None:
    """The smallest shift (3,) that brings the least and the most axes (angles, 3) of all table angles into the travel; None if there is none."""
    rows = turned.reshape(-1, 3)
    bound = np.eye(3)
    # d and its size t: R d <= high - most, -R d <= least - low, +-d <= t
    matrix = np.block([[rows, np.zeros_like(rows)], [-rows, np.zeros_like(rows)], [bound, -bound], [-bound, -bound]])
    limit = np.concatenate([(high - most).ravel(), (least - low).ravel(), np.zeros(6)])
    found = linprog([0.0] * 3 + [1.0] * 3, A_ub=matrix, b_ub=limit, bounds=[(None, None)] * 3 + [(0.0, None)] * 3, method="highs")
    return None if found.x is None or not found.success else np.asarray(found.x[:3])
