"""A program as typed moves: the result of every reader and the input of the interpolator.

The moves are kept as columns, one row per move, so that a program of 100 000 blocks is a few arrays; `Program.move(i)`
gives one of them as a record. Coordinates are x y z A C in m and rad: under TRAORI x y z is the tool tip in the part frame,
otherwise the axes X Y Z; A and C are always the axes.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from twin.geometry.kinematics import Kinematics

RAPID, LINE, ARC, DWELL = 0, 1, 2, 3
KIND_NAMES = ("rapid", "line", "arc", "dwell")


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


@dataclass(frozen=True)
class Move:
    """One move as a record; see `Moves` for units."""

    kind: str
    start: np.ndarray
    target: np.ndarray
    feed: float
    stop: bool
    traori: bool
    tolerance: float
    block: int
    line: int
    centre: np.ndarray | None
    angle: float | None


def place_of(path: Path, line: int, block: int, column: int | None = None) -> str:
    """A place of a program, for messages; `block` below 0: it has no number."""
    return f"{path}: line {line}" + (f", column {column}" if column else "") + (f" (block N{block})" if block >= 0 else "")


@dataclass(frozen=True)
class Program:
    """A part program: start of the axes (5,), moves, and modes that the program set.

    `feedforward`: set by the first FFWON or FFWOF (None if neither: the machine file decides). `notes`: one line for each word
    without an effect here (spindle, coolant); `messages`: the texts of MSG; `files`: subprograms that were read from other files.
    """

    path: Path
    start: np.ndarray
    moves: Moves
    kinematics: Kinematics
    feedforward: str | None = None
    notes: tuple[str, ...] = ()
    messages: tuple[str, ...] = field(default=())
    files: tuple[Path, ...] = ()

    def __len__(self) -> int:
        return len(self.moves)

    def place(self, i: int) -> str:
        """Place of move i for messages: file, line and block."""
        return place_of(self.path, int(self.moves.line[i]), int(self.moves.block[i]))

    def move(self, i: int) -> Move:
        """Move i as a record."""
        m = self.moves
        arc = m.kind[i] == ARC
        return Move(
            kind=KIND_NAMES[m.kind[i]],
            start=self.starts()[i],
            target=m.target[i],
            feed=float(m.feed[i]),
            stop=bool(m.stop[i]),
            traori=bool(m.traori[i]),
            tolerance=float(m.tolerance[i]),
            block=int(m.block[i]),
            line=int(m.line[i]),
            centre=m.centre[i] if arc else None,
            angle=float(m.angle[i]) if arc else None,
        )

    def starts(self) -> np.ndarray:
        """Start of each move (row, 5), in the coordinates of that move."""
        before = np.vstack([self.start[None], self.moves.target[:-1]])
        traori = np.concatenate([[False], self.moves.traori[:-1]])
        length = np.concatenate([self.moves.tool_length[:1], self.moves.tool_length[:-1]])
        # a change of transformation or tool does not move the axes but changes the coordinates of the point
        changed = (traori != self.moves.traori) | ((length != self.moves.tool_length) & self.moves.traori)
        for i in np.flatnonzero(changed):
            axes = before[i]
            if traori[i]:
                axes = np.concatenate(
                    [self.kinematics.with_tool_length(length[i]).linear_axes(axes[None, :3], axes[None, 3:])[0], axes[3:]]
                )
            if self.moves.traori[i]:
                tip, _ = self.kinematics.with_tool_length(self.moves.tool_length[i]).forward(axes)
                axes = np.concatenate([tip[0], axes[3:]])
            before[i] = axes
        return before
