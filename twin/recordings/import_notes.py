"""What an import says about a run: how a missing set point was made, late channels, offsets, constant or stuck channels, units, columns left out."""

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from twin.recordings.convert import Channel
from twin.recordings.grid import Piece
from twin.recordings.mapping import Map
from twin.recordings.relations import stuck
from twin.recordings.signals import Recording
from twin.recordings.skew import Skew
from twin.recordings.trace import POSITIONS
from twin.recordings.units_found import steps_of_a_turn
from twin.units import AXIS_UNITS, in_words

SAME_INTERVAL = 1e-3
SMALL_OFFSET = 2e-6
"""Smallest constant difference between two encoders that is reported [m or rad]."""


def skew(skews: Sequence[Skew], correct: Collection[tuple[str, str]], period: float) -> list[str]:
    """Notes on each clear skew, with its interval and whether it was corrected."""
    notes = []
    for item in skews:
        if item.clear:
            size = f"{abs(item.seconds) * 1e3:.3f} ms {'late' if item.seconds > 0 else 'early'}"
            done = (
                "corrected" if (item.axis, item.signal) in correct else "left as it is: skew = 'correct' or skew_ms in the map corrects it"
            )
            if samples := item.differenced(period):
                done += f" (a difference of positions over {samples} samples is late by this)"
            against = f"against the {in_words(item.reference)} (+-{1.96e3 * item.deviation:.3f} ms)"
            notes.append(f"{item.axis}.{item.signal} is {size} {against}; {done}")
    return notes


def stuck_channels(channels: Sequence[Channel]) -> list[str]:
    """Notes on counters that stand at the end of their range."""
    free = [c for c in channels if c.column.sign_bit is None]
    return [f"{'.'.join(c.key)}: '{c.column.name}' {place}" for c in free if (place := stuck(c.source.signal.head))]


def radians(channels: Sequence[Channel]) -> list[str]:
    """Notes on positions that were mapped as lengths, but have the steps of an encoder in radians."""
    notes = []
    for channel in channels:
        if channel.key[1] in POSITIONS and channel.conversion.kind == "linear" and channel.column.scale is None:
            turn = steps_of_a_turn(channel.source.signal.head, 2.0 * np.pi)
            if turn is not None:
                notes.append(
                    f"{'.'.join(channel.key)}: its steps are 1/{turn:.0f} of a turn in rad, but it is mapped as {channel.conversion.unit}: radians?"
                )
    return notes


def left_columns(mapping: Map, recordings: Sequence[Recording]) -> list[str]:
    """A note on the columns of the files that the map leaves out."""
    used = {*(c.name for c in mapping.columns), *mapping.settings.labels}
    left = [name for r in recordings for name in r.signals if name not in used and name.rpartition("/")[2] not in used]
    shown = ", ".join(left[:6]) + (f" and {len(left) - 6} more" if len(left) > 6 else "")
    return [f"not in the map: {shown}"] if left else []


def offset(offsets: Mapping[tuple[Piece, str], float], kinds: Mapping[str, str], centred: bool) -> list[str]:
    """Notes on offsets above SMALL_OFFSET, one per axis."""
    notes = []
    for axis, kind in kinds.items():
        own = [value for (_, a), value in offsets.items() if a == axis]
        unit, factor = AXIS_UNITS[kind].error
        if own and max(map(abs, own)) > SMALL_OFFSET:
            shown = ", ".join(f"{value * factor:.4g}" for value in own[:3]) + (", ..." if len(own) > 3 else "")
            notes.append(
                f"{axis}.position differs from the motor position by a constant {shown} {unit}; {'removed' if centred else 'left as it is'}"
            )
    return notes


def interval(channels: Sequence[Channel], period: float) -> list[str]:
    """Notes on signals with another interval."""
    groups: dict[float, list[str]] = {}
    for channel in channels:
        interval = channel.source.timing.interval
        if abs(interval - period) > SAME_INTERVAL * period:
            groups.setdefault(round(interval, 9), []).append(".".join(channel.key))
    return [
        f"{', '.join(names)}: recorded every {interval * 1e3:.4g} ms, {'interpolated to' if interval > period else 'picked every'} {period * 1e3:.4g} ms"
        for interval, names in groups.items()
    ]


def constant_channels(window: Mapping[tuple[str, str], np.ndarray]) -> list[str]:
    """Notes on channels that never change although the axis moves."""
    return [
        f"{axis}.{signal} never changes while the axis moves: is it the right column?"
        for (axis, signal), values in window.items()
        if np.ptp(values) == 0.0 and np.ptp(window[axis, "setpoint"]) > 0.0
    ]
