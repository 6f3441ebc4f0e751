"""A program as typed moves: the result of every reader and the input of the interpolator.

The moves are kept as columns, one row per move, so that a program of 100 000 blocks is a few arrays.
Coordinates are x y z A C in m and rad: under TRAORI x y z is the tool tip in the part frame,
otherwise the axes X Y Z; A and C are always the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twin.geometry.kinematics import Kinematics

RAPID, LINE, ARC, DWELL = 0, 1, 2, 3

SAGITTA = 1e-8
"""Largest distance of the chords from an arc [m]."""
TURN_STEP = np.radians(0.1)
"""Spacing of points on moves whose A and C turn linearly: without TRAORI their path is curved in the part frame."""
MOST_POINTS = 20_000  # per move


@dataclass(frozen=True)
class Moves:
    """Columns of all moves (row,) or (row, 3), (row, 5); SI units.

    `workpiece_orientation`: the tool axis turns on a great circle (ORIWKS), else A and C go linearly. `feed` is the
    greatest speed of the tip [m/s], or of A and C [rad/s] where `rotary`; infinite in rapid moves. `stop`: exact stop
    at the end, then `pause` [s]. `tolerance` [m], `angle_tolerance` [rad], `distance` [m] (ADIS) hold for the corner at
    the end of the move. Arcs turn by `angle` > 0 about `normal`, right-handed, from the start about `centre`.
    """

    kind: np.ndarray
    target: np.ndarray
    traori: np.ndarray
    workpiece_orientation: np.ndarray
    feed: np.ndarray
    rotary: np.ndarray
    stop: np.ndarray
    pause: np.ndarray
    tolerance: np.ndarray
    angle_tolerance: np.ndarray
    distance: np.ndarray
    brisk: np.ndarray
    feedforward: np.ndarray
    tool_length: np.ndarray
    centre: np.ndarray
    normal: np.ndarray
    angle: np.ndarray
    block: np.ndarray
    line: np.ndarray

    def __len__(self) -> int:
        return len(self.kind)

    def take(self, rows: np.ndarray) -> Moves:
        """These rows only."""
        return Moves(**{f.name: getattr(self, f.name)[rows] for f in fields(self)})

    def curves(self, rows: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Moves from `start` (row, 5) as base + s step + cos(s angle) e1 + sin(s angle) e2, s = 0 .. 1 (e1 = e2 = 0 on lines), and their ways.

        Base and step (row, 5), e1 and e2 (row, 3), from the centre at the height of the start; way of the tip (row,) [m].
        """
        normal, angle, arm = self.normal[rows], self.angle[rows][..., None], start[..., :3] - self.centre[rows]
        radius1 = np.where(angle > 0.0, arm - normal * np.sum(arm * normal, axis=-1, keepdims=True), 0.0)
        radius2, base = np.cross(normal, radius1), start.copy()
        base[..., :3] -= radius1
        step = self.target[rows] - base
        step[..., :3] -= np.cos(angle) * radius1 + np.sin(angle) * radius2
        rise = np.sum(np.where(angle > 0.0, step[..., :3], 0.0) * normal, axis=-1)
        way = np.hypot(angle[..., 0] * np.linalg.norm(radius1, axis=-1), rise)
        return base, step, radius1, radius2, np.where(angle[..., 0] > 0.0, way, np.linalg.norm(step[..., :3], axis=-1))


def place_of(path: Path, line: int, block: int, column: int | None = None) -> str:
    """A place of a program, for messages; `block` below 0: it has no number."""
    return f"{path}: line {line}" + (f", column {column}" if column else "") + (f" (block N{block})" if block >= 0 else "")


@dataclass(frozen=True)
class Program:
    """A part program: start of the axes (5,), moves, and modes that the program set.

    `feedforward`: set by the first FFWON or FFWOF (None if neither: the machine file decides). `notes`: one line for each word
    without an effect here (spindle, coolant); `files`: subprograms that were read from other files.
    """

    path: Path
    start: np.ndarray
    moves: Moves
    kinematics: Kinematics
    feedforward: str | None = None
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.moves)

    def place(self, i: int) -> str:
        """Place of move i for messages: file, line and block."""
        return place_of(self.path, int(self.moves.line[i]), int(self.moves.block[i]))

    def starts(self) -> np.ndarray:
        """Start of each move (row, 5), in the coordinates of that move."""
        before = np.vstack([self.start[None], self.moves.target[:-1]])
        traori = np.concatenate([[False], self.moves.traori[:-1]])
        length = np.concatenate([self.moves.tool_length[:1], self.moves.tool_length[:-1]])
        # a change of transformation or tool does not move the axes but changes the coordinates of the point
        changed = (traori != self.moves.traori) | ((length != self.moves.tool_length) & self.moves.traori)
        of_tip, to_tip = changed & traori, changed & self.moves.traori
        before[of_tip] = axes_at(self.kinematics, before[of_tip], length[of_tip])
        before[to_tip] = tips_at(self.kinematics, before[to_tip], self.moves.tool_length[to_tip])
        return before


def axes_at(kinematics: Kinematics, points: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Axes (row, 5) from tips in the part frame, with A and C (row, 5), and the length of the tool of each (row,) [m]."""
    longer = (length - kinematics.tool_length)[:, None] * kinematics.direction(points[:, 3:])
    return np.hstack([kinematics.linear_axes(points[:, :3] + longer, points[:, 3:]), points[:, 3:]])


def tips_at(kinematics: Kinematics, axes: np.ndarray, length: np.ndarray) -> np.ndarray:
    """Tips in the part frame, with A and C (row, 5), from the axes (row, 5): the inverse of `axes_at`."""
    tip, direction = kinematics.forward(axes)
    return np.hstack([tip - (length - kinematics.tool_length)[:, None] * direction, axes[:, 3:]])


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
    arc = m.kind == ARC
    on_circle = m.traori & (arc | (m.workpiece_orientation & (m.kind != RAPID)))
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
    poses[axes] = tips_at(program.kinematics, poses[axes], m.tool_length[row[axes]])
    steps = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)
    return PathCurve(poses, np.concatenate([[0.0], np.cumsum(steps)]), row)
