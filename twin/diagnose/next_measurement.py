"""The next measurement that would add most evidence: a move for `twin run`, chosen from the candidates that are closest."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
import math
from typing import get_args

import numpy as np

from twin.diagnose.state import GroupState, excess_of
from twin.effects import EFFECTS
from twin.effects.effect import SeparatingMove
from twin.effects.setting import Key
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.summary import listed
from twin.units import in_words

PERIOD = 1e-3

KINDS: tuple[SeparatingMove, ...] = get_args(SeparatingMove)
"""Kinds of moves that can be proposed."""


@dataclass(frozen=True)
class Proposal:
    """The next measurement in words and as set points."""

    text: str
    move: Trace | None


def propose(machine: Machine, states: Sequence[GroupState], verdict: str, named: Collection[Key], laws_on: Sequence[str] = ()) -> Proposal:
    """The move that separates the closest candidates for a named effect. Without a named effect: a move that shows the unlisted laws on these axes
    again. Nothing for the verdict 'none'.
    """
    if verdict == "none" and not laws_on:
        return Proposal("none needed: the machine agrees with its file", None)
    pairs = []
    for f in states:
        for candidates in f.rounds:
            able = [c for c in candidates if c.plausible]
            if able and able[0].key in named:
                rival = able[1] if len(able) > 1 else None
                pairs.append((able[0].evidence - (rival.evidence if rival else 0.0), able[0], rival))
    if not pairs and laws_on:
        return _proposal("accelerations", machine.axis(laws_on[0]), "confirms the law on a new run")
    if not pairs:
        unexplained = [f for f in states if f.unknown] or states
        left = {axis: excess for f in unexplained for axis, excess in excess_of(f.group, f.fit).items()}
        return _proposal("constant speeds", machine.axis(max(left, key=lambda axis: left[axis])), "no known effect explains the residual")
    _, best, rival = min(pairs, key=lambda p: p[0])
    name = in_words(best.setting.effect.name)
    reason = f"separates {name} from {in_words(rival.setting.effect.name)}" if rival else f"confirms {name} on a new run"
    return _proposal((rival or best).setting.effect.separating_move, machine.axis(best.setting.axis), reason)


def propose_for(machine: Machine, states: Sequence[GroupState], axis: str, level: float) -> Proposal:
    """The move on an axis without a named effect whose gap of `level` times the noise remains: that of an effect which these runs would not show."""
    sizes = {name: size for f in states for (name, of, _), size in (f.not_visible or {}).items() if of == axis}
    unseen = [EFFECTS[name] for name in sorted(sizes, key=lambda name: sizes[name])]  # the most visible first
    kind = unseen[0].separating_move if unseen else "constant speeds"
    shows = listed([in_words(e.name) for e in unseen if e.separating_move == kind])
    cause = f"these runs would not show {shows}" if unseen else "no known effect explains it"
    return _proposal(kind, machine.axis(axis), f"{level:.1f} times the noise remains there, and {cause}")


def move_of(kind: str, axes: Sequence[Axis]) -> Trace:
    """Set points of one kind of move for several axes at once; an axis that has finished waits."""
    moves = [_move(kind, axis) for axis in axes]
    count = max(len(time) for time, _ in moves)
    columns = {(axis.name, "setpoint"): np.pad(q, (0, count - len(q)), mode="edge") for axis, (_, q) in zip(axes, moves)}
    return Trace(np.arange(count) * PERIOD, columns, {axis.name: axis.kind for axis in axes})


def _proposal(kind: str, axis: Axis, reason: str) -> Proposal:
    by = ", with the measuring function of the drive, because it exceeds the jerk limit of programs" if kind == "chirp" else ""
    return Proposal(
        f"axis {axis.name}: {kind} ({reason}){by}; set points in next_measurement.csv; simulate them on the corrected machine with: "
        "twin run next_measurement.csv --machine machine.toml",
        move_of(kind, [axis]),
    )


def _move(kind: str, axis: Axis) -> tuple[np.ndarray, np.ndarray]:
    low, high = axis.travel if math.isfinite(axis.travel[0]) else (-math.pi, math.pi)
    middle = 0.5 * (low + high)
    farthest = 0.35 * (high - low)
    reach = min(farthest, 0.1 if axis.kind == "linear" else 0.5)
    v, a, j = axis.max_velocity, axis.max_acceleration, axis.max_jerk
    if kind == "micro-reversals":
        sizes = [2e-6, 5e-6, 10e-6, 20e-6, 50e-6, 200e-6] if axis.kind == "linear" else [2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 2e-3]
        distances = [sign * size for size in sizes for sign in (1, -1, 1, -1)]
        return moves_in_turn(middle, distances, 0.002 * v, 0.1 * a, j, 0.1, PERIOD)
    if kind == "constant speeds":
        times, positions, start = [], [], 0.0
        for part in (0.002, 0.01, 0.03, 0.1, 0.3, 0.7):
            length = min(farthest, part * v * 2.0)  # steady for at least a second if the travel allows
            t, p = moves_in_turn(middle, [length, -length], part * v, a, j, 0.1, PERIOD)
            times.append(t + start)
            positions.append(p)
            start = times[-1][-1] + PERIOD
        return np.concatenate(times), np.concatenate(positions)
    if kind == "chirp":
        t = np.arange(0.0, 8.0, PERIOD)
        f0, f1 = 2.0, 80.0
        phase = 2 * np.pi * (f0 * t + (f1 - f0) * t**2 / 16.0)
        rate = 2 * np.pi * (f0 + (f1 - f0) * t / 8.0)
        amplitude = np.minimum(0.02 * reach, 0.3 * a / rate**2)
        drift = 0.02 * v * t
        return t, middle + drift + amplitude * np.sin(phase) * np.minimum(1.0, t / 0.5)
    if kind == "rest":
        return moves_in_turn(middle, [reach, -reach], 0.3 * v, a, j, 20.0, PERIOD)
    return moves_in_turn(middle, [farthest, -farthest, farthest, -farthest], v, a, j, 0.2, PERIOD)
