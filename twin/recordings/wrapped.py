"""Positions of rotary axes that begin anew after a turn: from 359.9 to 0.1 deg is a step of 0.2 deg. The turns are counted on.

x = u - M floor(u / M):   M = 360 deg, 2 pi rad, 1 rev, or a usual number of counts. A step farther than M / 2 passes the end of the turn.
"""

from collections.abc import Iterator
from dataclasses import replace
import math

import numpy as np
from scipy.ndimage import maximum_filter1d

from twin.recordings.names import meaning_of
from twin.recordings.relations import whole
from twin.recordings.signals import BLOCK, Recording, Signal, Stored
from twin.recordings.units_found import COUNTS_OF_A_TURN

_TURNS = {"deg": [360.0], "rad": [2.0 * math.pi], "rev": [1.0], "": [360.0, 2.0 * math.pi]}
FILLED, FARTHEST_STEP = 0.9, 0.1
"""Shares of a turn: one that wraps passes most of it, and no step is longer."""
BY_NOISE = 1e-3
"""Share of a turn by which a position at rest may be off an end of it."""
BESIDE, LIKE, ODD, RARE = 11, 4.0, 4, 0.05
"""Samples around a step that show its size, how many times as long it may be, how many sound ones outweigh an odd one, and weight of a long one."""


def unwrapped(recording: Recording) -> Recording:
    """The recording with positions that begin anew after a turn counted on; they begin within the same turn, and a note names them."""
    found = {name: turn for name, one in recording.signals.items() if (turn := turn_of(one))}
    signals, made = recording.signals, dict[str, Signal]()
    for name, turn in found.items():
        # a set point at rest does not pass the end of the turn that the position wavers about
        same_unit = (s for s in signals.values() if s.unit == signals[name].unit and len(s.values))
        alike = next(s for s in same_unit if _within(float(s.head.min()), float(s.head.max()), turn))
        parts, values = _counted_on(signals[name], turn, float(alike.head[0])), signals[name].values
        if isinstance(values, Stored):
            values = Stored(values.path.with_suffix(".turns"))
            for part in parts:
                values.add(part)
        made[name] = replace(signals[name], values=values if isinstance(values, Stored) else np.concatenate(list(parts)), turn=turn)
    turns = " or ".join(f"{turn:.6g}" for turn in dict.fromkeys(found.values()))
    notes = (*recording.notes, f"{', '.join(found)}: begin anew after {turns}: turns counted on") if found else recording.notes
    return replace(recording, signals={**signals, **made}, notes=notes)


def turn_of(signal: Signal) -> float | None:
    """The turn after which the values of a signal begin anew; None if they do not.

    A step over the end of the turn is of the size of those beside it, once the turn is taken off: a step of a set point by 350 mm is not. Nearly all have to
    be, for rows may be lost. Whole numbers without a known name may be any counter that overflows, unless they pass the end in both directions.
    """
    turns = _TURNS.get(signal.unit, [])
    counts = bool(turns and not signal.unit and whole(signal.head))
    meaning = meaning_of(signal.name) if counts else None
    counted = counts and (meaning is None or meaning.signal in ("setpoint", "position", "motor_position"))
    sound = dict.fromkeys([*turns, *(COUNTS_OF_A_TURN if counted else ())], 0)
    ways = dict.fromkeys(sound, {1.0, -1.0} if counts and meaning is None else set[float]())
    odd = dict.fromkeys(sound, 0.0)
    low = high = last = float(signal.head[0]) if len(signal.values) else math.nan
    for start in range(0, len(signal.values), BLOCK):
        values = np.asarray(signal.values[start : start + BLOCK], float)
        steps, last = np.diff(values, prepend=last), float(values[-1])
        low, high = min(low, float(values.min())), max(high, float(values.max()))
        for turn in list(sound):
            if not _within(low, high, turn):
                del sound[turn]
                continue
            passes = np.abs(steps) > 0.5 * turn
            sizes = np.abs(steps - turn * np.rint(steps / turn))
            beside = maximum_filter1d(np.where(passes, 0.0, sizes), BESIDE)
            wavers = (sizes > 0.0) & (sizes <= BY_NOISE * turn)  # about the end of the turn at rest, where nothing else moves
            like = (sizes <= LIKE * beside + np.min(sizes[(sizes > 0.0) & ~passes], initial=turn)) & (beside > 0.0) | wavers
            sound[turn] += int(np.count_nonzero(passes & like))
            ways[turn] = ways[turn] - {*np.sign(steps[passes & like])}
            # a step over lost rows may be long: a few count little
            odd[turn] += np.count_nonzero(passes & ~like) + RARE * np.count_nonzero(sizes > FARTHEST_STEP * turn)
        if not sound:
            return None
    return next((turn for turn, count in sound.items() if count > ODD * odd[turn] and high - low > FILLED * turn and not ways[turn]), None)


def _within(low: float, high: float, turn: float) -> bool:
    """True if values lie between 0 and a turn, or within half a turn of 0."""
    off = BY_NOISE * turn
    return (low >= -off and high <= turn + off) or (low >= -0.5 * turn - off and high <= 0.5 * turn + off)


def _counted_on(signal: Signal, turn: float, near: float) -> Iterator[np.ndarray]:
    """Values without the steps at the ends of the turn, block by block, from the turn on whose first value is nearest to `near`."""
    last = near
    for start in range(0, len(signal.values), BLOCK):
        own = np.asarray(signal.values[start : start + BLOCK], float)
        own = own - turn * np.cumsum(np.rint(np.diff(own, prepend=last) / turn))
        last = float(own[-1])
        yield own
