"""Drilling of all languages as moves along the tool axis of the plane.

One hole is a list of steps: heights along the tool axis [program units], at a share of the feed or by rapid, and dwells. `drill` returns the steps
after the arrival over the hole; the reader moves there and makes them.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import math
from typing import NamedTuple

from twin.program.expressions import WordError

MOST_PECKS = 2000

MOVE, DWELL, ASIDE, BACK = "move", "dwell", "aside", "back"
RAPID = 0.0
Steps = list[tuple[str, float, float]]
"""Kind, height or time, share of the feed or RAPID; ASIDE and BACK also move by a step in the plane."""


class Peck(NamedTuple):
    """One infeed to a depth. Before it the tool backs off from the last depth by `way`, or leaves the hole and returns up to there."""

    depth: float
    way: float
    short: bool


@dataclass(frozen=True)
class Drilling:
    """One drilling cycle: heights and depths in program units, dwells in s.

    `retract`: final height (RTP, or the R plane); `safe`: start of the feed; `depth`: bottom. `pecks`: the infeeds above the bottom.
    `out`, `between`: share of the feed, or RAPID, of the way out at the end, and of those before.
    """

    safe: float
    depth: float
    retract: float
    pecks: tuple[Peck, ...] = ()
    dwell: float = 0.0
    dwell_last: float = 0.0  # at the bottom instead of `dwell`
    dwell_out: float = 0.0
    out: float = RAPID
    between: float = RAPID
    first_scale: float = 1.0
    feed_all_the_way: bool = False  # at feed to `retract`, not only to `safe`
    aside: tuple[float, float] = (0.0, 0.0)  # step off the wall at the bottom, in the plane
    lift: float = 0.0  # with it, along the tool axis


def pecks(depths: Iterable[float], way: float, short: bool) -> tuple[Peck, ...]:
    """Infeeds that are alike, the bottom among them."""
    return tuple(Peck(depth, way, short) for depth in depths)


def levels(top: float, bottom: float, step: float, following: Callable[[float, float], float] = lambda step, _: step) -> list[float]:
    """Depths of the infeeds, the last is the bottom; `following`: the step behind one, from that one and the way left to the bottom."""
    down, at, found = math.copysign(1.0, bottom - top), top, []
    while step > 0.0 and abs(bottom - at) > step + 1e-9:
        at += down * step
        found.append(at)
        step = following(step, abs(bottom - at))
        if len(found) > MOST_PECKS:
            raise WordError(f"more than {MOST_PECKS} pecks in one hole; give a larger step")
    return [*found, bottom]


def drill(c: Drilling) -> Steps:
    """Steps from `safe` down and out again."""
    at, down = c.safe, -1.0 if c.depth <= c.safe else 1.0
    steps: Steps = []

    def dwell(time: float) -> None:
        if time > 0.0:
            steps.append((DWELL, time, RAPID))

    every = c.pecks or (Peck(c.depth, 0.0, False),)
    for k, (depth, way, short) in enumerate(every):
        if k:
            steps.append((MOVE, at - down * way if short else c.safe, c.between))
        if k and not short:
            dwell(c.dwell_out)
            steps.append((MOVE, at - down * way, RAPID))
        steps.append((MOVE, depth, c.first_scale if k == 0 and len(every) > 1 else 1.0))
        dwell(c.dwell_last if depth == c.depth and c.dwell_last else c.dwell)
        at = depth
    if any(c.aside) or c.lift:
        return [*steps, (ASIDE, c.depth - down * abs(c.lift), RAPID), (MOVE, c.retract, c.out), (BACK, c.retract, RAPID)]
    if c.out and not c.feed_all_the_way:
        steps.append((MOVE, c.safe, c.out))
    if c.feed_all_the_way or not c.out or c.retract != c.safe:
        steps.append((MOVE, c.retract, c.out if c.feed_all_the_way else RAPID))
    return steps
