"""From a program to set points: the interpolator of the control (level 1).

    moves -> stretches between stops -> spline within the tolerance -> time law -> set points at each position cycle

A stretch starts on an interpolation cycle, so every interpolation cycle is also a position cycle; between two interpolation
cycles the set points lie on the path. The differences of the set points are checked against every limit. Where a limit is exceeded
between two nodes of the time law, the law is planned again with a lower limit there.
"""

from collections.abc import Callable, Iterable, Iterator
import itertools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from twin.errors import InputError, TwinError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.limits import MOST_SETPOINTS, refuse_above
from twin.machine.machine import Machine, load_machine
from twin.program import axis_path, blend, elements, lookahead, sampling
from twin.program.build import travel_text
from twin.program.moves import Program
from twin.program.nodes import Feeds, Limits, Way, split_at_feeds
from twin.program.read import read_program
from twin.program.stretches import Stretch, great_circle_rows, stretch_of, stretches
from twin.recordings.trace import PROGRAM, Trace, joined

MOST_WRITTEN = 100_000_000
"""Largest number of set points of a program written to disk block by block: 28 hours at 1 kHz, 10 GB."""
BLOCK = 131_072
"""Number of set points computed at once: 13 MB."""
REST = 0.1
"""Time [s] at rest after the last move."""
LIMIT_TOLERANCE = 1e-4
"""Tolerated excess: a speed limit may be exceeded by this fraction, acceleration by twice and jerk by three times it."""
WORTH_PLANNING, ATTEMPTS = 2e-3, 8
"""An excess up to the first value slows the whole stretch; a larger one causes a new plan, at most this many times."""
FUTILE = 3
"""Number of times in a row that a slower motion may leave more than the root of its excess."""
FAR_ABOVE = 1.1
"""If a value between two nodes exceeds its limit by more than this factor, the limit there is divided by the square of the excess, because
the result decreases by less than the limit."""
NO_LIMIT = 1e9
"""Limit of a missing axis, which never moves."""

Progress = Callable[[float], None]


def limits_of(machine: Machine, brisk: bool | np.bool_ = False, kinematics: Kinematics | None = None) -> Limits:
    """Limits of X Y Z, tilting and turning axis. Under BRISK the jerk limit is replaced by one that allows a full change of acceleration in one
    interpolation cycle."""
    names = (kinematics or kinematics_of(machine, sites_needed=False)).names
    own = {axis.name: (axis.max_velocity, axis.max_acceleration, axis.max_jerk) for axis in machine.axes}
    speed, acceleration, jerk = np.array([own.get(name, (NO_LIMIT,) * 3) for name in names]).T.copy()
    return Limits(speed, acceleration, acceleration / machine.interpolation_cycle if brisk else jerk)


def interpolate(program: Program | str | Path, machine: Machine | None = None, *, progress: Progress | None = None) -> Trace:
    """Set points of a program, or of its file, at the position cycle.

    Starts at rest where the program starts and ends REST after its last move. Columns `<axis>.setpoint` [m, rad], and of the pseudo axis
    `program`: `block` (N number, -1 without), `line`, `feed` as programmed [m/s, rad/s where only A and C move, 0 in rapid moves],
    `path_speed` in the same unit, `path_length` of the tip [m], `feedforward` (1 on, 0 off). `progress` gets the share done.

    Raises:
        InputError: with file and line, a word that is not understood, or a position outside the travel of an axis.
    """
    machine = machine or load_machine()
    program = program if isinstance(program, Program) else read_program(Path(program), machine)
    return joined(set_point_blocks(program, machine, progress=progress, most=MOST_SETPOINTS))


def set_point_blocks(
    program: Program, machine: Machine, *, progress: Progress | None = None, most: float = MOST_WRITTEN
) -> Iterator[Trace]:
    """The same set points in consecutive traces of about BLOCK samples, so that memory does not grow with the length of the program."""
    motion = _Motion(program, machine, most)
    held, count = [_standing(program.start, 0, 1)], 1
    for piece in motion.pieces(progress or (lambda share: None)):
        held.append(piece)
        count += len(piece.axes)
        if count >= BLOCK:
            yield motion.trace(held)
            held, count = [], 0
    if held:
        yield motion.trace(held)


class _Piece(NamedTuple):
    """Consecutive set points: axes (sample, 5), row of the moves (sample,), path speed (sample,), tip speed (sample,)."""

    axes: np.ndarray
    row: np.ndarray
    path_speed: np.ndarray
    tip_speed: np.ndarray


def _standing(at: np.ndarray, row: int, count: int) -> _Piece:
    return _Piece(np.tile(at, (count, 1)), np.full(count, row), np.zeros(count), np.zeros(count))


def way_of(program: Program, machine: Machine, stretch: Stretch) -> Way:
    """The input of the time law: the path of a stretch in the coordinates of the program, with a break at each change of feed."""
    moves, first = program.moves, stretch.row[0]
    feeds = Feeds(moves.feed[stretch.row], moves.rotary[stretch.row])
    spline = blend.blend(stretch.elements, stretch.tolerance, stretch.angle_tolerance, stretch.distance)[0]
    frames = axis_path.frames_of(program.kinematics.with_tool_length(float(moves.tool_length[first])), moves.traori[first])
    limits = limits_of(machine, moves.brisk[first], program.kinematics)
    return Way(split_at_feeds(spline, stretch.elements, feeds), stretch.elements, frames, limits, feeds)


_Samples = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""Of a stretch: axes (sample, 5), u, speed of the tip and of A and C together (sample,)."""


class _Motion:
    """Makes the set points of a program, a set point every `period` [s], an interpolation cycle every `every` of them."""

    def __init__(self, program: Program, machine: Machine, most: float) -> None:
        self.program, self.machine, self.most, self.period = program, machine, most, machine.position_cycle
        self.every = max(1, round(machine.interpolation_cycle / self.period))
        self.count, self.length, self.tip_speed = 0, 0.0, 0.0  # set points in traces so far, way [m] and speed at their end

    def _check_length(self, seconds: float, row: int) -> None:
        """Refuse a motion whose set points would not fit into memory or on the disk."""
        what, hint = f"set points ({seconds / 3600.0:.3g} h)", "raise the feed, or split the program"
        refuse_above(seconds / self.period, self.most, what, self.program.place(int(row)), hint)

    def _cycles(self, seconds: float) -> int:
        """Number of set points up to the end of the last interpolation cycle."""
        return math.ceil(seconds / (self.period * self.every) - 1e-9) * self.every

    def pieces(self, progress: Progress) -> Iterator[_Piece]:
        """Set points of each stretch and wait, at most BLOCK samples at once."""
        program, starts = self.program, self.program.starts()
        circles = great_circle_rows(program, starts)
        at, total = program.start, 0.0
        for first, last in stretches(program):
            stretch = stretch_of(program, starts, first, last, circles)

            def report(share: float, first: int = first, last: int = last) -> None:
                progress((first + share * (last + 1 - first)) / len(program))

            pause = float(program.moves.pause[last])
            if stretch is not None:
                for piece in self._moving(stretch, at, report):
                    yield piece
                    at = piece.axes[-1]
                    total += len(piece.axes)
                    self._check_length(total * self.period, last)
            if pause > 0.0 or last == len(program) - 1:
                rest = pause + (REST if last == len(program) - 1 else 0.0)
                total += rest / self.period
                self._check_length(total * self.period, last)
                left = max(self.every, self._cycles(rest))
                while left:
                    yield _standing(at, last, min(left, BLOCK))
                    left -= min(left, BLOCK)
            report(1.0)

    def _samples(self, way: Way, law: lookahead.TimeLaw, times: np.ndarray, slower: float, count: int) -> Iterator[_Samples]:
        """The set points of a stretch, at most BLOCK at once; its start is the last sample of the previous stretch."""
        for begin in range(0, count, BLOCK):
            n = min(BLOCK, count - begin)
            out = np.empty((n, 5)), np.empty(n), np.empty(n), np.empty(n)
            sampling.sample(way.spline, way.frames, law, times, slower, begin, self.period, out)
            yield out

    def _moving(self, stretch: Stretch, start: np.ndarray, report: Progress) -> Iterator[_Piece]:
        """The set points of a stretch."""
        moves = self.program.moves
        with np.errstate(over="ignore"):
            at_feed = elements.ways(stretch.elements, moves.rotary[stretch.row]) / moves.feed[stretch.row]  # s, an estimate
        self._check_length(float(at_feed.sum()), stretch.row[int(np.argmax(at_feed))])
        way, windows = way_of(self.program, self.machine, stretch), lookahead.Windows()
        law = lookahead.plan(way, report, kept=windows)
        ease = np.ones((2, len(law.piece)))
        slower, slowed_by, attempt, futile = 1.0, math.inf, 0, 0
        while True:
            times = sampling.node_times(law.nodes, law.a, law.slope)
            self._check_length(times[-1] * slower, stretch.row[0])
            count = self._cycles(times[-1] * slower)
            blocks: Iterable[_Samples] = self._samples(way, law, times, slower, count)
            if count <= BLOCK:
                blocks = list(blocks)
            excess = _excess(start, (axes for axes, *_ in blocks), self.period, way.limits)
            if excess <= 1.0 + LIMIT_TOLERANCE:
                break
            inside = lookahead.excess(way, law)
            attempt += 1
            if excess > 1.0 + WORTH_PLANNING and attempt <= ATTEMPTS and inside.max() > 1.0:
                # a limit is exceeded between two nodes: plan again with a lower limit there
                ease /= np.where(inside > 1.0, inside * 1.001, 1.0) ** np.where(inside > FAR_ABOVE, 2, 1)
                law = lookahead.plan(way, report, (law, ease), windows)
                continue
            # slower by its excess, a smooth motion keeps its limits; the excess of a jump stays
            futile = futile + 1 if excess > math.sqrt(slowed_by) else 0
            if futile == FUTILE:
                raise TwinError(
                    f"{self.program.place(int(stretch.row[0]))}: the set points of the moves to line {moves.line[stretch.row[-1]]} exceed a limit "
                    f"{excess:.4g} times, however slow they are; report this program"
                )
            slowed_by = excess
            slower *= excess * (1.0 + 1e-5)
        if count > BLOCK:
            blocks = self._samples(way, law, times, slower, count)  # compute them again instead of keeping all in memory
        for axes, u, tip, turn in blocks:
            row = stretch.row[np.minimum(np.searchsorted(stretch.elements.u, u, side="right") - 1, len(stretch.row) - 1)]
            if hit := self.program.kinematics.outside_travel(axes):
                sample, axis = hit
                text = travel_text(axis, float(axes[sample, axis]), self.program.kinematics)
                raise InputError(f"{self.program.place(int(row[sample]))}: on the way {text}")
            yield _Piece(axes, row, np.where(moves.rotary[row], turn, tip), tip)

    def trace(self, pieces: list[_Piece]) -> Trace:
        """The trace of consecutive pieces, behind those of the calls before."""
        m, names = self.program.moves, self.program.kinematics.names
        axes, row, path_speed, tip_speed = (np.concatenate(parts) for parts in zip(*pieces))
        way = 0.5 * (tip_speed + np.concatenate([[self.tip_speed], tip_speed[:-1]])) * self.period
        length = np.cumsum(np.concatenate([[self.length], way]))[1:]
        time = np.arange(self.count, self.count + len(axes)) * self.period
        self.count, self.length, self.tip_speed = self.count + len(axes), float(length[-1]), float(tip_speed[-1])
        signals = {(name, "setpoint"): axes[:, i] for i, name in enumerate(names) if name in self.machine.axis_names}
        columns = {
            "block": m.block[row].astype(float), "line": m.line[row].astype(float), "feed": np.where(np.isfinite(m.feed), m.feed, 0.0)[row],
            "path_speed": path_speed, "path_length": length, "feedforward": m.feedforward[row].astype(float),
        }  # fmt: skip
        return Trace(time, signals | {(PROGRAM, name): values for name, values in columns.items()}, self.machine.kinds)


def _excess(start: np.ndarray, blocks: Iterable[np.ndarray], period: float, limits: Limits) -> float:
    """The motion must be slower by this factor, so that the differences of the set points keep every limit."""
    worst = 1.0
    before = np.tile(start, (3, 1))  # at rest before and behind
    for axes in itertools.chain(blocks, (None,)):
        padded = np.vstack([before, np.tile(before[-1:], (3, 1)) if axes is None else axes])
        for order, limit in enumerate(limits, start=1):
            ratio = np.abs(np.diff(padded, order, axis=0)).max(axis=0, initial=0.0) / period**order / limit
            worst = max(worst, float(ratio.max()) ** (1.0 / order))
        before = padded[-3:]
    return worst
