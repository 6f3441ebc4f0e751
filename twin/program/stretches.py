"""Divide a program at its stops: each stretch between two standstills becomes elements for blending and the time law.

Under TRAORI with ORIWKS the tool axis turns in the plane of its two directions (great circle), while A and C are not linear. If the
difference to linear A and C exceeds GREAT_CIRCLE_ERROR, the move is divided into parts that follow the great circle.
"""

from dataclasses import dataclass

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import great_circle
from twin.program import elements as el
from twin.program import moves as mv
from twin.program.orientation import choose_angles

GREAT_CIRCLE_ERROR = 1e-4
"""Largest deviation of the tool axis from the plane of two programmed directions [rad]."""
MOST_PARTS = 2000
LEAVES_THE_CIRCLE = 0.02
"""Direction error [rad] that remains for any division if A reaches the end of its travel and both axes switch to their other solution."""


@dataclass(frozen=True)
class Stretch:
    """Elements from standstill to standstill; `row` (E,) is the move of each element, `joints` the tolerances (E + 1,)."""

    elements: el.Elements
    row: np.ndarray
    tolerance: np.ndarray
    angle_tolerance: np.ndarray
    distance: np.ndarray


def stretches(program: mv.Program) -> list[tuple[int, int]]:
    """Rows [first, last] of each stretch, divided at exact stops."""
    ends = np.flatnonzero(program.moves.stop)
    return [(int(a), int(b)) for a, b in zip(np.concatenate([[0], ends[:-1] + 1]), ends)]


def stretch_of(program: mv.Program, starts: np.ndarray, first: int, last: int, great_circle: np.ndarray) -> Stretch | None:
    """The elements of rows first .. last; None if nothing moves (a dwell, or moves of no length)."""
    m, rows = program.moves, np.arange(first, last + 1)
    base, step, radius1, radius2, way = m.curves(rows, starts[rows])
    length = np.hypot(way, el.REFERENCE_RADIUS * np.linalg.norm(step[:, 3:], axis=1))
    kept = length > 1e-10
    if not kept.any():
        return None
    fields = [v[kept] for v in (base, step, radius1, radius2, m.angle[rows], length, rows)]
    if great_circle[rows].any():
        fields = _divided(program, fields, great_circle)
    *curve, length, row = fields
    elements = el.Elements(np.concatenate([[0.0], np.cumsum(length)]), *(np.ascontiguousarray(v, float) for v in curve))

    # joint k lies at the end of element k - 1; a joint inside a divided move has its tolerance too
    def joints(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values[row[:1]], values[row]])

    return Stretch(elements, row, joints(m.tolerance), joints(m.angle_tolerance), joints(m.distance))


def great_circle_rows(program: mv.Program, starts: np.ndarray) -> np.ndarray:
    """Which moves must be divided so that the tool axis keeps to the plane between its directions (row,) bool."""
    m = program.moves
    out = np.zeros(len(m), bool)
    way = np.abs(m.target[:, 3:] - starts[:, 3:]).max(axis=1)
    wide = np.flatnonzero(m.traori & m.workpiece_orientation & (way > 1e-3) & (m.kind != mv.RAPID))
    if wide.size:
        start, end = starts[wide, 3:], m.target[wide, 3:]
        first, last, on_the_way = (program.kinematics.direction(angles) for angles in (start, end, 0.5 * (start + end)))
        middle = first + last
        size = np.linalg.norm(middle, axis=1, keepdims=True)
        # opposite directions have no plane: A and C stay linear
        off = np.where(size[:, 0] > 1e-6, np.linalg.norm(middle / np.maximum(size, 1e-12) - on_the_way, axis=1), 0.0)
        out[wide[off > GREAT_CIRCLE_ERROR]] = True
    return out


def _divided(program: mv.Program, fields: list[np.ndarray], great_circle: np.ndarray) -> list[np.ndarray]:
    """Elements with the great circles divided into parts."""
    base, step, radius1, radius2, angle, length, row = fields
    parts, ways = np.ones(len(row), int), {}
    for i in np.flatnonzero(great_circle[row] & (angle == 0.0)):
        if (angles := _great_circle(program, int(row[i]), base[i, 3:], base[i, 3:] + step[i, 3:])) is not None:
            parts[i], ways[i] = len(angles) - 1, angles
    of, first = np.repeat(np.arange(len(row)), parts), np.cumsum(parts) - parts
    share = (np.arange(len(of)) - first[of]) / parts[of]
    base, step = base[of] + share[:, None] * step[of], step[of] / parts[of, None]
    for i, angles in ways.items():
        base[first[i] : first[i] + parts[i], 3:], step[first[i] : first[i] + parts[i], 3:] = angles[:-1], np.diff(angles, axis=0)
    ways_of_parts = np.hypot(np.linalg.norm(step[:, :3], axis=1), el.REFERENCE_RADIUS * np.linalg.norm(step[:, 3:], axis=1))
    return [base, step, radius1[of], radius2[of], angle[of], np.where(parts[of] > 1, ways_of_parts, length[of]), row[of]]


def _great_circle(program: mv.Program, row: int, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
    """A and C (part + 1, 2) along the great circle between two poses; None if the solutions do not lead to the end.

    Raises:
        InputError: A and C cannot follow it to its end without a swing to their other solution.
    """
    k = program.kinematics
    first, last = k.direction(np.array([start, end]))
    between = np.arctan2(np.linalg.norm(np.cross(first, last)), first @ last)
    if between < 1e-9:
        return None
    for parts in (8, 32, 128, 512, MOST_PARTS):
        share = np.linspace(0.0, 1.0, parts + 1)[:, None]
        directions = great_circle(first, last, between, share)
        chosen = choose_angles(k, directions, start)
        angles = chosen.angles
        angles[0] = start
        if np.any(chosen.status) or np.abs(angles[-1] - end).max() > 1e-6:
            return None
        angles[-1] = end
        middle = directions[1:] + directions[:-1]
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        off = np.abs(k.direction(0.5 * (angles[1:] + angles[:-1])) - middle).max()
        if off < GREAT_CIRCLE_ERROR:
            return angles
    if off > LEAVES_THE_CIRCLE:
        raise InputError(
            f"{program.place(row)}: on the way the tool axis asks for more than the travel of {k.label[3]} and would swing through while it cuts; "
            f"begin the move with the other {k.label[3]} and {k.label[4]} (retract, turn, approach), or divide it there"
        )
    return angles
