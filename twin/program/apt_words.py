"""Statements of CL data that have no effect here or are not simulated, the parts of a statement, and drilling cycles (CYCLE/).

The words are those of the CL data standard (ISO 4343) and additional ones of CATIA, NX and Creo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
import math
import re
from typing import NamedTuple

import numpy as np

from twin.program import moves as mv
from twin.program.expressions import WordError
from twin.program.state import INCH

FREE_TEXT = ("PARTNO", "PPRINT", "PPWORD", "COMMENT", "TPRINT", "INSERT", "REMARK", "LETTER", "TITLES", "DISPLY", "PROGRAM")
"""Statements followed by text for the operator."""

WITHOUT_EFFECT = frozenset({
    "AIR", "ARCSLP", "AUTOPS", "AUXFUN", "BREAK", "CHECK", "CLAMP", "CLEARP", "CLRSRF", "COOLNT", "COUPLE", "CUTTER", "DEBUG", "DELETE",
    "END", "END-OF-PATH", "HEAD", "INTOL", "LEADER", "LINTOL", "LOAD", "LOADTL", "MACHIN", "MAXDPM", "MAXVEL", "MCHTOL", "MODE", "MULTAX",
    "OPSKIP", "OPSTOP", "OUTTOL", "OUTOL", "PAINT", "PIVOTZ", "PLABEL", "PLOT", "PSIS", "POSTN", "PPFUN", "PREFUN", "REWIND", "SAFETY", "SELCTL", "SELECT",
    "SELECTL", "SEQNO", "SET", "SLOWDN", "STOP", "SYN", "TDATA", "TLCOM", "TLDATA", "TMARK", "TOLER", "TOOL PATH", "TOOLNO", "TURRET",
    "UNCLMP", "UNLOAD", "VERIFY", "ZERO", "CONTRL", "TAPKUL", "SWITCH", "BEGIN", "MATERL", "OPNAME", "APPLY", "TCP", "TCPCTL",
    "OFSTNO", "OSETNO", "PARTID", "CATCHR", "BARFED", "TLSTCK", "OVRIDE", "ADJUST", "LIMIT", "OPTION", "PRINT", "PUNCH", "CHUCK", "BLANK",
    "TOOL", "STOCK", "FIXTUR", "REGEN", "NOPOST", "TOOLST", "TLSPEC", "RESET", "TYPE", "MODEL",
})  # fmt: skip
"""Statements that have no effect here; each gives a note."""

_DRIVEN = "GOFWD GOBACK GOLFT GORGT GOUP GODOWN GO TLLFT TLRGT TLON PROFIL POCKET PCKET SCON THRUST"
NOT_SIMULATED = {
    **dict.fromkeys(_DRIVEN.split(), "let the CAM system output points (GOTO) instead"),
    **dict.fromkeys(
        ("TRACUT", "COPY", "TRANS", "ORIGIN", "ROTABL", "ROTATE", "ROTHED", "TRANTO"),
        "let the CAM system output the transformed points",
    ),
    **dict.fromkeys(("RETRCT", "RETURN"), "give the place as a GOTO"),
    **dict.fromkeys(("CALSUB", "CALLSUB"), "it calls a subprogram that this file does not hold; put its points out here"),
    "THREAD": "threads cut with a turning spindle are not simulated",
}
"""Statements with a motion that is not simulated -> what to do instead."""

_STATEMENT = re.compile(r"\s*([A-Z][A-Z0-9_-]*(?:\s+[A-Z-]+)*(?:\s*,\s*[A-Z]+)*)\s*(?:/\s*(.*?))?\s*\Z", re.S | re.A)


def word_and_values(text: str) -> tuple[str, str] | None:
    """Major words of a statement ('TLON,GOFWD') and the text after its '/'; None if it is not a statement."""
    for word in FREE_TEXT:
        if text.startswith(word):
            return word, text[len(word) :].lstrip(" /")
    match = _STATEMENT.match(text)
    return None if match is None else (re.sub(r"\s*,\s*", ",", match[1]), match[2] or "")


def moves_nothing(word: str, values: str) -> bool:
    """Whether a shift of the part (ORIGIN/, TRANS/) is zero."""
    try:
        return word in ("ORIGIN", "TRANS") and len(listed(values)) == 3 and not any(map(float, listed(values)))
    except ValueError:
        return False


def listed(values: str) -> list[str]:
    """The values of a statement, without blanks around them."""
    return [v.strip() for v in values.split(",")] if values.strip() else []


def numbers_of(values: str, word: str, counts: tuple[int, ...]) -> list[float]:
    """All values of a statement as finite numbers, as many as one of `counts`."""
    try:
        numbers = [float(v) for v in values.split(",")]
    except ValueError:
        raise WordError(f"{word}/{values[:60]}: not all values are numbers; correct them", 0) from None
    if len(numbers) not in counts or not all(map(math.isfinite, numbers)):
        raise WordError(f"{word}/ has {len(numbers)} values, expected {' or '.join(map(str, counts))} finite numbers; correct it", 0)
    return numbers


def is_number(text: str) -> bool:
    """Whether a value is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


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
