"""The level of a gap: RMS of gap over noise, 1 for noise alone. Every statement about the size of a gap is made with it.

    level^2 = mean over runs and signals of (gap / noise)^2, while the axis moves

Where an axis sticks after a motion depends on its history. A level therefore counts the samples in motion, and whole runs only of an axis
that rests throughout. Signals without noise or without samples to compare do not count.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping
import math
from typing import TypeVar

from twin.simulation.gap import SignalGap

Gaps = Mapping[str, Mapping[str, Mapping[str, SignalGap]]]
"""Run -> axis -> signal -> gap."""

Key = TypeVar("Key", bound=Hashable)


def levels(gaps: Gaps) -> dict[str, float]:
    """Level of each axis."""
    return _levels_by(gaps, lambda axis, _: axis)


def signal_levels(gaps: Gaps) -> dict[tuple[str, str], float]:
    """Level of each signal, by axis and signal."""
    return _levels_by(gaps, lambda axis, signal: (axis, signal))


def levels_at_rest_too(gaps: Gaps) -> dict[str, float]:
    """The same as `levels` over whole runs, for a note on what happens at rest."""
    return _levels_by(gaps, lambda axis, _: axis, lambda gap: gap.times_noise)


def overall(level_of: Mapping[str, float]) -> float:
    """Level of several axes: RMS of the levels of each; 1 without an axis."""
    return _rms(level_of.values()) if level_of else 1.0


def _levels_by(
    gaps: Gaps, key: Callable[[str, str], Key], ratio: Callable[[SignalGap], float] = lambda gap: gap.times_noise_moving
) -> dict[Key, float]:
    found: dict[Key, list[float]] = {}
    for axes in gaps.values():
        for axis, signals in axes.items():
            for signal, gap in signals.items():
                if gap.noise > 0.0 and gap.is_compared:
                    found.setdefault(key(axis, signal), []).append(ratio(gap))
    return {of: _rms(ratios) for of, ratios in found.items()}


def _rms(values: Iterable[float]) -> float:
    squares = [value**2 for value in values]
    return math.sqrt(math.fsum(squares) / len(squares))
