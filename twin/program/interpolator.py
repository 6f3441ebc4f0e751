"""From a program to set points: the interpolator of the control (level 1).

    moves -> stretches between stops -> spline within the tolerance -> time law -> set points at each position cycle

A stretch starts on an interpolation cycle, so that every interpolation cycle is a position cycle too; between two interpolation
cycles the set points lie on the path itself. The differences of the set points are checked against every limit; where
the jerk between two nodes of the time law lies above, the law is planned anew with less there.
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from twin.errors import InputError
from twin.geometry.kinematics import Kinematics, kinematics_of
from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.program import blend, lookahead, sampling, timelaw
from twin.program.axis_path import frames_of
from twin.program.collect import travel_text
from twin.program.moves import Program
from twin.program.stretches import Stretch, great_circle_rows, stretch_of, stretches
from twin.recordings.trace import PROGRAM, Trace

MOST_SETPOINTS = 10_000_000
"""Set points of one program: 2.8 hours at 1 kHz, 1.5 GB on the way."""
REST = 0.1
"""Time [s] at rest after the last move."""
LIMIT_TOLERANCE = 1.5e-4
"""By this fraction the set points may be too fast: a speed limit is exceeded by it, acceleration by twice, jerk by three times it."""
WORTH_PLANNING, ATTEMPTS = 2e-3, 4
"""An excess up to the first makes the stretch slower as a whole; above, it is planned anew, at most so many times."""
NO_LIMIT = 1e9
"""Limit of an axis that the machine lacks, which never moves."""

Progress = Callable[[float], None]


def limits_of(machine: Machine, brisk: bool = False, kinematics: Kinematics | None = None) -> lookahead.Limits:
    """Limits of X Y Z, tilting and turning axis; under BRISK the acceleration is reached within one interpolation cycle, not by the jerk."""
    names = (kinematics or kinematics_of(machine, sites_needed=False)).names
    axes = [machine.axis(name) if name in machine.axis_names else None for name in names]
    acceleration = np.array([axis.max_acceleration if axis else NO_LIMIT for axis in axes])
    jerk = acceleration / machine.interpolation_cycle if brisk else np.array([axis.max_jerk if axis else NO_LIMIT for axis in axes])
    return lookahead.Limits(np.array([axis.max_velocity if axis else NO_LIMIT for axis in axes]), acceleration, jerk)


def interpolate(
    program: Program, machine: Machine, *, cycle: str = "position", progress: Progress | None = None, gap: float = timelaw.GAP
) -> Trace:
    """Set points of a program at the position cycle (`cycle="interpolation"`: at the interpolation cycle only).

    Starts at rest where the program starts and ends REST after its last move. Columns of the pseudo axis `program`: `block`
    (N number, -1 without), `line`, `feed` as programmed [m/s, rad/s where only A and C move, 0 in rapid moves], `path_speed` in the same
    unit, `path_length` of the tip [m], `feedforward` (1 on, 0 off). `progress` gets the share done.
    """
    period = machine.position_cycle
    every = max(1, round(machine.interpolation_cycle / period))
    starts = program.starts()
    circles = great_circle_rows(program, starts)
    parts = stretches(program)
    pieces: list[_Piece] = []
    at, total = program.start, 0.0
    for first, last in parts:
        stretch = stretch_of(program, starts, first, last, circles)

        def report(share: float, first: int = first, last: int = last) -> None:
            if progress:
                progress((first + share * (last + 1 - first)) / len(program))

        pause = float(program.moves.pause[last])
        if stretch is not None:
            piece = _interpolate_stretch(program, machine, stretch, at, period, every, gap, report)
            pieces.append(piece)
            at = piece.axes[-1]
            total += len(piece.axes)
        if pause > 0.0 or last == len(program) - 1:
            rest = pause + (REST if last == len(program) - 1 else 0.0)
            total += rest / period
            _check_length(total * period, period, program, last)
            pieces.append(_standing(at, last, max(1, math.ceil(rest / (period * every) - 1e-9)) * every))
        report(1.0)
    return _trace(program, machine, pieces, period, every if cycle == "interpolation" else 1)


class _Piece:
    """Set points of a stretch or a wait: axes (sample, 5), row of the moves (sample,), path speed (sample,), tip speed (sample,)."""

    def __init__(self, axes: np.ndarray, row: np.ndarray, path_speed: np.ndarray, tip_speed: np.ndarray) -> None:
        self.axes, self.row, self.path_speed, self.tip_speed = axes, row, path_speed, tip_speed


def _standing(at: np.ndarray, row: int, count: int) -> _Piece:
    return _Piece(np.tile(at, (count, 1)), np.full(count, row), np.zeros(count), np.zeros(count))


def spline_of(stretch: Stretch) -> blend.Spline:
    """The path of a stretch in the coordinates of the program."""
    return blend.blend(stretch.elements, stretch.tolerance, stretch.angle_tolerance, stretch.distance)[0]


def _interpolate_stretch(
    program: Program, machine: Machine, stretch: Stretch, start: np.ndarray, period: float, every: int, gap: float, report: Progress
) -> _Piece:
    limits = limits_of(machine, stretch.brisk, program.kinematics)
    frames = frames_of(program.kinematics.with_tool_length(stretch.tool_length), stretch.traori)
    feeds = lookahead.Feeds(program.moves.feed[stretch.row], program.moves.rotary[stretch.row])
    with np.errstate(over="ignore"):
        at_feed = np.diff(stretch.elements.u) / feeds.speed  # s, an estimate
    slowest = int(stretch.row[int(np.argmax(at_feed))])
    _check_length(float(at_feed.sum()), period, program, slowest)
    spline = spline_of(stretch)
    law = lookahead.plan(spline, stretch.elements, frames, limits, feeds, gap, report)
    ease = np.ones(len(law.piece))
    slower, attempt = 1.0, 0
    while True:
        times = sampling.node_times(law.nodes, law.a, law.slope)
        _check_length(times[-1] * slower, period, program, stretch.row[0])
        count = math.ceil(times[-1] * slower / (period * every) - 1e-9) * every
        axes, u, tip, turn = np.empty((count, 5)), np.empty(count), np.empty(count), np.empty(count)
        # the start itself is the last sample of what came before
        sampling.sample(spline, frames, law.nodes, law.piece, law.a, law.slope, times, slower, period, period, count, axes, u, tip, turn)
        excess = _excess(start, axes, period, limits)
        if excess <= 1.0 + LIMIT_TOLERANCE or slower > 2.0:
            break
        attempt += 1
        inside = lookahead.excess(spline, frames, limits, law)
        if excess > 1.0 + WORTH_PLANNING and attempt <= ATTEMPTS and max(v.max() for v in inside) > 1.0:
            # too much between two nodes: plan anew with nodes between them, or less jerk there
            nodes, piece, ease = lookahead.closer(law, ease, *inside)
            law = lookahead.plan(spline, stretch.elements, frames, limits, feeds, gap, report, (nodes, piece, ease))
        else:
            slower *= excess * (1.0 + 1e-5)
    row = stretch.row[np.minimum(np.searchsorted(stretch.elements.u, u, side="right") - 1, len(stretch.row) - 1)]
    _check_travel(program, axes, row)
    return _Piece(axes, row, np.where(program.moves.rotary[row], turn, tip), tip)


def _check_length(seconds: float, period: float, program: Program, row: int) -> None:
    """Refuse a motion that takes for ever, before its set points take the memory."""
    refuse_above(
        seconds / period,
        MOST_SETPOINTS,
        f"set points ({seconds / 3600.0:.3g} h)",
        program.place(int(row)),
        "raise the feed, or split the program",
    )


def _excess(start: np.ndarray, axes: np.ndarray, period: float, limits: lookahead.Limits) -> float:
    """By which factor the motion must be slower so that differences of the set points keep every limit."""
    worst = 1.0
    padded = np.vstack([np.tile(start, (3, 1)), axes, np.tile(axes[-1:], (3, 1))])  # at rest before and behind
    for order, limit in enumerate(limits, start=1):
        ratio = np.abs(np.diff(padded, order, axis=0)).max(axis=0, initial=0.0) / period**order / limit
        worst = max(worst, float(ratio.max()) ** (1.0 / order))
    return worst


def _check_travel(program: Program, axes: np.ndarray, row: np.ndarray) -> None:
    hit = program.kinematics.outside_travel(axes)
    if hit:
        sample, axis = hit
        raise InputError(
            f"{program.place(int(row[sample]))}: on the way {travel_text(axis, float(axes[sample, axis]), program.kinematics)}"
        )


def _trace(program: Program, machine: Machine, pieces: list[_Piece], period: float, every: int) -> Trace:
    """All pieces behind each other, after one sample at rest on the start."""
    m = program.moves
    first = _standing(program.start, 0, 1)
    pieces = [first, *pieces]
    axes = np.concatenate([p.axes for p in pieces])
    row = np.concatenate([p.row for p in pieces])
    path_speed = np.concatenate([p.path_speed for p in pieces])
    tip_speed = np.concatenate([p.tip_speed for p in pieces])
    length = np.concatenate([[0.0], np.cumsum(0.5 * (tip_speed[1:] + tip_speed[:-1]) * period)])
    feed = np.where(np.isfinite(m.feed), m.feed, 0.0)[row]
    signals = {(name, "setpoint"): axes[::every, i] for i, name in enumerate(program.kinematics.names) if name in machine.axis_names}
    columns = {
        "block": m.block[row].astype(float),
        "line": m.line[row].astype(float),
        "feed": feed,
        "path_speed": path_speed,
        "path_length": length,
        "feedforward": m.feedforward[row].astype(float),
    }
    signals |= {(PROGRAM, name): values[::every] for name, values in columns.items()}
    return Trace(np.arange(len(axes))[::every] * period, signals, machine.kinds)
