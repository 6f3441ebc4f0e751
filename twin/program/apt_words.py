"""Statements of CL data that have no effect here or are not simulated, and functions that split a statement.

The words are those of the CL data standard (ISO 4343) and additional ones of CATIA, NX and Creo.
"""

from __future__ import annotations

import math
import re

FREE_TEXT = ("PARTNO", "PPRINT", "PPWORD", "COMMENT", "TPRINT", "INSERT", "REMARK", "LETTER", "TITLES", "DISPLY", "PROGRAM")
"""Statements followed by text for the operator."""

WITHOUT_EFFECT = frozenset({
    "AIR", "ARCSLP", "AUTOPS", "AUXFUN", "BREAK", "CHECK", "CLAMP", "CLEARP", "CLRSRF", "COOLNT", "COUPLE", "CUTTER", "DEBUG", "DELETE",
    "END", "END-OF-PATH", "HEAD", "INTOL", "LEADER", "LINTOL", "LOAD", "LOADTL", "MACHIN", "MAXDPM", "MAXVEL", "MCHTOL", "MODE", "MULTAX",
    "OPSKIP", "OPSTOP", "OUTTOL", "OUTOL", "PAINT", "PIVOTZ", "PLABEL", "PLOT", "POSTN", "PPFUN", "PREFUN", "REWIND", "SAFETY", "SELCTL", "SELECT",
    "SELECTL", "SEQNO", "SET", "SLOWDN", "SPINDL", "STOP", "SYN", "TDATA", "TLCOM", "TLDATA", "TMARK", "TOLER", "TOOL PATH", "TOOLNO", "TURRET",
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


def is_number(text: str) -> bool:
    """Whether a value is a finite number."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
