"""How a gap is judged: does a correction help, does a law help, is a law missing, what is the verdict.

`before` and `after` are levels (`twin.simulation.gap_level`) by axis on held-out runs, before and after correction; 1 is noise alone.
"""

from collections.abc import Collection, Mapping
import math

from twin.diagnose.settings import T
from twin.simulation.campaign_gap import AS_EXPECTED
from twin.simulation.gap_level import overall

Levels = Mapping[str, float]
SignalLevels = Mapping[tuple[str, str], float]

LOUD = 3.0
"""A law is sought for a louder axis although effects explain most of its gap."""

NEXT_TO_NOTHING = 1e-3
"""A single loud signal starts no search for a law if a smaller fraction of the gap of the axis is unexplained, unless several effects
share a block."""

EVEN = 0.5
"""Probability of one of two causes of which none is likelier: the largest of an effect whose own block shows what it does not explain. The verdict
"unknown" names only a likelier effect as a part of the gap."""

HARDLY_LOUD = 2.0
"""A law is sought for a louder axis if effects explain less than half of its gap."""


def above_noise(level: float) -> float:
    """Squared level above that of noise."""
    return max(level**2 - 1.0, 0.0)


def unexplained_share(before: float, after: float) -> float:
    """Fraction of the squared level above noise that correction leaves on one axis."""
    return above_noise(after) / max(above_noise(before), 1e-300)


def explained(before: Levels, after: Levels, axes: Collection[str]) -> float:
    """Fraction of the squared levels above noise that correction closes on these axes together, from 0 to 1."""
    was, now = (sum(above_noise(of[axis]) for axis in axes if axis in of) for of in (before, after))
    return max(0.0, min(1.0, 1.0 - now / max(was, 1e-9)))


def gap_remains(before: float, after: float) -> bool:
    """Whether a considerable gap of an axis remains: above LOUD with more than a tenth of it left, or above HARDLY_LOUD with more than half."""
    left = unexplained_share(before, after)
    return (after > LOUD and left > T.remaining) or (after > HARDLY_LOUD and left > 0.5)


def is_worse(axes: Collection[str], before: Levels, after: Levels) -> bool:
    """Does the correction raise the level of these axes by more than chance?"""
    was, now = (overall({axis: level for axis, level in of.items() if axis in axes}) for of in (before, after))
    return now > was + (T.small_residual - 1.0)


def needs_a_law(before: float, after: float, loudest_signal: float, imitated: bool) -> bool:
    """Whether a law is sought for an axis; `imitated`: several effects share a block and may imitate one law.

    A deviation at reversals only contributes little to the level of an axis, but is loud in a single signal.
    """
    return after > LOUD or (loudest_signal > AS_EXPECTED and (imitated or unexplained_share(before, after) > NEXT_TO_NOTHING))


def loudest(of_signals: SignalLevels) -> dict[str, float]:
    """Largest level of a signal of each axis."""
    return {axis: max(level for (of, _), level in of_signals.items() if of == axis) for axis, _ in of_signals}


def remaining_share(before: SignalLevels, after: SignalLevels, axes: Collection[str]) -> float:
    """Geometric mean over the signals of these axes of (after / before)^2, levels of at least 1.

    The geometric mean compares relative changes. In a sum of squares, the random duration of one stiction could outweigh a signal that a law
    explains completely. Signals within noise before and after do not count; 1 if there is no other.
    """
    changes = [
        math.log(max(1.0, after[key]) / max(1.0, level)) for key, level in before.items() if key[0] in axes and max(level, after[key]) > 1.0
    ]
    return math.exp(2.0 * math.fsum(changes) / len(changes)) if changes else 1.0


def worse_signals(before: SignalLevels, after: SignalLevels) -> list[tuple[str, str]]:
    """Signals that a law makes worse, as (axis, signal).

    A law of the wrong kind may close the gap of one signal and open one in another that the machine explained without it.
    """
    return [key for key, level in after.items() if level > HARDLY_LOUD * max(1.0, before.get(key, math.inf))]


def final_verdict(found: str, before: Levels, after: Levels, has_laws: bool) -> str:
    """The verdict that the held-out gaps allow; `found` is that of the search: 'effect', 'none' or 'unknown'.

    'law' if laws are part of the correction and all but `remaining` of the gap is explained. 'unknown' if too much remains, or beside a law that explains less:
    a machine with a law is not without a fault.
    """
    if has_laws and explained(before, after, after.keys()) >= 1.0 - T.remaining:
        return "law"
    if found == "none" and (has_laws or max(after.values(), default=1.0) > 2.0 * LOUD):
        return "unknown"
    if found == "effect" and any(gap_remains(before[axis], level) for axis, level in after.items()):
        return "unknown"
    return found
