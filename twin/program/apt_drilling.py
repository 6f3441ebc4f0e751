"""Drilling cycles of CL data (CYCLE/): their parameters, and the moves at each hole."""

from __future__ import annotations

from collections.abc import Callable, Iterator
import math
from typing import NamedTuple

import numpy as np

from twin.program import moves as mv
from twin.program.apt_words import is_number
from twin.program.state import INCH

PER_MINUTE = {"MMPM": 1e-3, "IPM": INCH, "PERMIN": None}
PER_REVOLUTION = {"MMPR": 1e-3, "IPR": INCH, "PERREV": None}
"""Feed units -> metre; None: the unit of the file."""

_KINDS = "DRILL DEEP DEEP2 DEEPHL CBORE SPOT BRKCHP BRKCH2 FACE CSINK BORE BORE2 REAM SPDRL THRU TAP TAPR"
CYCLES = frozenset(_KINDS.split())
"""Drilling cycles: one stroke at feed to the depth; MecSoft uses numbers for the kinds."""


class Cycle(NamedTuple):
    """The cycle in force [m]; the feed as in FEDRAT. Tapping and the like leave the hole at feed."""

    depth: float
    clearance: float
    retract: float
    feed: float
    out_at_feed: bool


def cycle_of(kind: str, parts: list[str], unit: float, feed: float, feed_of: Callable[[list[str]], float]) -> Cycle | None:
    """The cycle given by `parts`; None without depth or feed. `feed`: the active one; `feed_of` reads a value with its unit."""
    feed_units = {**PER_MINUTE, **PER_REVOLUTION}
    named: dict[str, float] = {}
    plain: list[float] = []
    at = 1
    while at < len(parts):
        text, after = parts[at], parts[at + 1] if at + 1 < len(parts) else ""
        if is_number(text):
            plain.append(float(text))
            if after in feed_units:
                named["FEED"] = feed_of([text, after])
                plain.pop()
                at += 1
        elif is_number(after):
            named["FEED" if text in feed_units else text] = feed_of([after, text]) if text in feed_units else float(after)
            at += 1
        at += 1
    depth = abs(named.get("FEDTO", named.get("DEPTH", plain[0] if plain else math.nan)))
    clear = abs(named.get("CLEAR", named.get("RAPTO", named.get("RTRCTO", plain[-1] if len(plain) > 1 else 0.0))))
    feed = named.get("FEED", feed)
    if not math.isfinite(depth) or not math.isfinite(feed):
        return None
    retract = max(clear, abs(named.get("RTRCTO", named.get("RETURN", clear))))
    return Cycle(depth * unit, clear * unit, retract * unit, feed, kind in ("TAP", "REAM", "BORE", "BORE2", "TAPR"))


def strokes(cycle: Cycle, hole: np.ndarray, up: np.ndarray) -> Iterator[tuple[int, np.ndarray, float]]:
    """Kind, target (3,) and feed of the moves at a hole; `up` (3,) is the direction out of it."""
    above, bottom, high = hole + cycle.clearance * up, hole - cycle.depth * up, hole + cycle.retract * up
    if cycle.retract > cycle.clearance:
        yield mv.RAPID, high, math.inf
    yield mv.RAPID, above, math.inf
    yield mv.LINE, bottom, cycle.feed
    yield mv.LINE if cycle.out_at_feed else mv.RAPID, above, cycle.feed
    if cycle.retract > cycle.clearance:
        yield mv.RAPID, high, math.inf
