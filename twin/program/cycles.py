"""Drilling cycles of both languages as moves along the tool axis of the plane.

One cycle is a list of steps at one place: heights along the tool axis [program units], by rapid or at feed, and dwells.
`drill` returns the steps after the arrival over the hole; the reader moves there and makes them.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

CHIP_BREAK = 0.254
"""Retract of G73, and distance above the last depth at which G83 resumes feed [mm]; LinuxCNC's value, a parameter on other controls."""
MOST_PECKS = 2000

RAPID, FEED, DWELL, ASIDE, BACK = "rapid", "feed", "dwell", "aside", "back"


class CycleError(Exception):
    """An impossible cycle; the reader adds the place."""


@dataclass(frozen=True)
class Drilling:
    """One drilling cycle: heights and depths in program units, dwells in s.

    `retract`: final height (RTP, or the R plane); `safe`: start of the feed; `depth`: bottom. `peck` above 0: drilling in steps of this
    size; `levels`: individual steps; `break_chip`: short retracts inside the hole; `out`: how the tool leaves the hole.
    """

    safe: float
    depth: float
    retract: float
    dwell: float = 0.0
    peck: float = 0.0
    break_chip: bool = False
    back: float = CHIP_BREAK
    dwell_last: float = 0.0  # at the bottom instead of `dwell`
    dwell_out: float = 0.0
    out: str = RAPID
    out_scale: float = 1.0
    first_scale: float = 1.0
    levels: tuple[float, ...] = ()
    feed_all_the_way: bool = False  # at feed to `retract`, not only to `safe`
    aside: tuple[float, float] = (0.0, 0.0)  # step off the wall at the bottom, in the plane
    lift: float = 0.0  # with it, along the tool axis


def drill(c: Drilling) -> list[tuple[str, float, float]]:
    """Steps (kind, height or time, share of the feed) from `safe` down and out again; ASIDE and BACK also move by `aside`."""
    at, down = c.safe, -1.0 if c.depth <= c.safe else 1.0
    steps: list[tuple[str, float, float]] = []

    def dwell(time: float) -> None:
        if time > 0.0:
            steps.append((DWELL, time, 1.0))

    depths = list(c.levels)
    if not depths and c.peck > 0.0:
        count = math.ceil(abs(c.depth - c.safe) / c.peck - 1e-9)
        if count > MOST_PECKS:
            raise CycleError(f"more than {MOST_PECKS} pecks in one hole; give a larger step")
        depths = [c.safe + down * c.peck * (k + 1) for k in range(count - 1)]
    for k, depth in enumerate([*(d for d in depths if (c.depth - d) * down > 0.0), c.depth]):
        if k and not c.break_chip:
            steps += [(RAPID, c.safe, 1.0)]
            dwell(c.dwell_out)
            steps += [(RAPID, at - down * c.back, 1.0)]
        elif k:
            steps += [(RAPID, at - down * c.back, 1.0)]
        steps.append((FEED, depth, c.first_scale if k == 0 and depths else 1.0))
        dwell(c.dwell_last if depth == c.depth and c.dwell_last else c.dwell)
        at = depth
    if any(c.aside) or c.lift:
        steps += [(ASIDE, c.depth - down * abs(c.lift), 1.0), (RAPID, c.retract, 1.0), (BACK, c.retract, 1.0)]
        return steps
    if c.out == FEED:
        steps.append((FEED, c.retract if c.feed_all_the_way else c.safe, c.out_scale))
    if c.out != FEED or (c.retract != c.safe and not c.feed_all_the_way):
        steps.append((RAPID, c.retract, 1.0))
    return steps
