"""Statements of CL data: those without effect here or not simulated, their parts, drilling cycles (CYCLE/) and arcs.

The words are those of the CL data standard (ISO 4343) and additional ones of CATIA, NX and Creo.

CIRCLE/ x,y,z,i,j,k[,r]          arc to the next GOTO, right-handed about its axis (NX, Creo; RhinoCAM without radius)
MOVARC/ x,y,z,i,j,k,r,ANGLE,a    the same; of the two senses the one that the angle fits (Fusion)
INDIRV/ i,j,k                    direction of the start (CATIA); INDIRP/ x,y,z: a point in that direction
TLON,GOFWD/ (CIRCLE/ x,y,z,r),ON,[n,INTOF,](LINE/ x1,y1,z1,x2,y2,z2)
                                 along the circle about the tool axis to its first (n-th) meeting with the line;
                                 CIRCLE/CANON,x,y,z,i,j,k,r gives another axis, (PLANE/ i,j,k,d) replaces the line
"""

from collections.abc import Callable
import math
import re

import numpy as np

from twin.program import moves as mv
from twin.program.arcs import CLOSING_TOLERANCE, Arc, ArcError, angle_between
from twin.program.expressions import WordError
from twin.program.state import INCH, NOTE, NOTHING, REFUSED, Word, named

FREE_TEXT = ("PARTNO", "PPRINT", "PPWORD", "COMMENT", "TPRINT", "INSERT", "REMARK", "LETTER", "TITLES", "DISPLY", "PROGRAM")
"""Statements followed by text for the operator."""

WORDS: dict[str, Word] = {
    **named(NOTE, NOTHING, " ".join(FREE_TEXT)), "TOOL PATH": Word(NOTE, NOTHING),
    **named(NOTE, NOTHING, (
        "AIR ARCSLP AUTOPS AUXFUN BREAK CHECK CLAMP CLEARP CLRSRF COOLNT COUPLE CUTTER DEBUG DELETE END END-OF-PATH HEAD INTOL LEADER "
        "LINTOL LOAD LOADTL MACHIN MAXDPM MAXVEL MCHTOL MODE MULTAX OPSKIP OPSTOP OUTTOL OUTOL PAINT PIVOTZ PLABEL PLOT PSIS POSTN "
        "PPFUN PREFUN REWIND SAFETY SELCTL SELECT SELECTL SEQNO SET SLOWDN STOP SYN TDATA TLCOM TLDATA TMARK TOLER TOOLNO TURRET "
        "UNCLMP UNLOAD VERIFY ZERO CONTRL TAPKUL SWITCH BEGIN MATERL OPNAME APPLY TCP TCPCTL OFSTNO OSETNO PARTID CATCHR BARFED "
        "TLSTCK OVRIDE ADJUST LIMIT OPTION PRINT PUNCH CHUCK BLANK TOOL STOCK FIXTUR REGEN NOPOST TOOLST TLSPEC RESET TYPE MODEL")),
    **named(REFUSED, "let the CAM system output points (GOTO) instead", "GOFWD GOBACK GOLFT GORGT GOUP GODOWN GO TLLFT TLRGT TLON PROFIL POCKET PCKET SCON THRUST"),
    **named(REFUSED, "let the CAM system output the transformed points", "TRACUT COPY TRANS ORIGIN ROTABL ROTATE ROTHED TRANTO"),
    **named(REFUSED, "give the place as a GOTO", "RETRCT RETURN"),
    **named(REFUSED, "it calls a subprogram that this file does not hold; put its points out here", "CALSUB CALLSUB"),
    **named(REFUSED, "threads cut with a turning spindle are not simulated", "THREAD"),
}  # fmt: skip
"""Statements without effect here, or with a motion that is not simulated; `twin.program.apt` has those that it carries out."""

_PART = re.compile(r"\(?\s*(CIRCLE|LINE|PLANE)\s*/\s*([^()]*?)\s*\)?\s*(?=,\s*(?:ON|TO|PAST|TANTO|\d+\s*,\s*INTOF)\b|\s*\Z|,\s*\()", re.S)
_ORDINAL = re.compile(r",\s*(\d+)\s*,\s*INTOF")
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
    return word in ("ORIGIN", "TRANS") and [is_number(v) and float(v) == 0.0 for v in listed(values)] == [True] * 3


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


FEED_UNITS = {"MMPM": 1e-3, "IPM": INCH, "PERMIN": None, "MMPR": 1e-3, "IPR": INCH, "PERREV": None}
"""Feed units -> metre; None: the unit of the file."""
PER_REVOLUTION = {"MMPR", "IPR", "PERREV"}

_KINDS = "DRILL DEEP DEEP2 DEEPHL CBORE SPOT BRKCHP BRKCH2 FACE CSINK BORE BORE2 REAM SPDRL THRU TAP TAPR"
CYCLES = frozenset(_KINDS.split())
"""Drilling cycles: one stroke at feed to the depth; MecSoft uses numbers for the kinds."""


Strokes = list[tuple[int, float, float]]
"""Kind of a move, height above the hole [m] and feed."""


def cycle_of(kind: str, parts: list[str], unit: float, feed: float, feed_of: Callable[[list[str]], float]) -> Strokes | None:
    """The moves at a hole of the cycle given by `parts`; None without depth or feed. Tapping and the like leave the hole at feed.

    `feed`: the active one; `feed_of` reads a value with its unit.
    """
    named: dict[str, float] = {}
    plain: list[float] = []
    at = 1
    while at < len(parts):
        text, after = parts[at], parts[at + 1] if at + 1 < len(parts) else ""
        if is_number(text):
            plain.append(float(text))
            if after in FEED_UNITS:
                named["FEED"] = feed_of([text, after])
                plain.pop()
                at += 1
        elif is_number(after):
            named["FEED" if text in FEED_UNITS else text] = feed_of([after, text]) if text in FEED_UNITS else float(after)
            at += 1
        at += 1
    depth = abs(named.get("FEDTO", named.get("DEPTH", plain[0] if plain else math.nan)))
    clear = abs(named.get("CLEAR", named.get("RAPTO", named.get("RTRCTO", plain[-1] if len(plain) > 1 else 0.0))))
    feed = named.get("FEED", feed)
    if not math.isfinite(depth) or not math.isfinite(feed):
        return None
    retract = max(clear, abs(named.get("RTRCTO", named.get("RETURN", clear))))
    out = mv.LINE if kind in ("TAP", "REAM", "BORE", "BORE2", "TAPR") else mv.RAPID
    high = [(mv.RAPID, retract * unit, math.inf)] if retract > clear else []
    return [*high, (mv.RAPID, clear * unit, math.inf), (mv.LINE, -depth * unit, feed), (out, clear * unit, feed), *high]


# ------------------------------------------------------------------ arcs


ANGLE_FITS = math.radians(1.0)
"""Tolerance between the angle of MOVARC and that of its points [rad]: some posts round it to whole degrees."""


def arc_to(
    start: np.ndarray, end: np.ndarray, centre: np.ndarray, normal: np.ndarray, radius: float | None, sweep: float | None = None
) -> Arc:
    """The arc from start to end about an axis; equal places are a full circle.

    Without `radius` [m] the radius is that of the start. With `sweep` [rad] the direction is the one that gives this angle, because the
    older post of Fusion writes the axis of a clockwise arc as that of a counter-clockwise one.
    """
    arms = [_arm(p, centre, normal) for p in (start, end)]
    radius = float(np.linalg.norm(arms[0])) if radius is None else radius
    for arm, place in zip(arms, ("start", "end")):
        if abs(np.linalg.norm(arm) - radius) > CLOSING_TOLERANCE:
            raise ArcError(
                f"the arc does not close: its {place} lies {np.linalg.norm(arm) * 1e3:.4f} mm from the axis of CIRCLE/, "
                f"the radius is {radius * 1e3:.4f} mm; correct it"
            )
    angle = angle_between(arms[0], arms[1], normal)
    if sweep is not None and abs(angle - abs(sweep)) > ANGLE_FITS:
        back = 2.0 * math.pi - angle
        if abs(back - abs(sweep)) > ANGLE_FITS:
            raise ArcError(f"the arc turns by {math.degrees(angle):.3f} deg, and ANGLE says {math.degrees(abs(sweep)):.3f} deg; correct it")
        return centre, -normal, back
    return centre, normal, angle


def driven_arc(values: str, start: np.ndarray, direction: np.ndarray, tool_axis: np.ndarray, unit: float) -> tuple[Arc, np.ndarray]:
    """The arc of TLON,GOFWD and its end point (3,) [m]; `direction` (3,) is that of the start, `unit` [m] of the numbers."""
    parts = {m[1]: m[2] for m in _PART.finditer(values)}
    if "CIRCLE" not in parts or not {"LINE", "PLANE"} & parts.keys():
        raise ArcError("TLON,GOFWD needs (CIRCLE/ ..) and (LINE/ ..) or (PLANE/ ..); let the CAM system output points instead")
    numbers = numbers_of(parts["CIRCLE"].removeprefix("CANON").lstrip(" ,"), "CIRCLE", (4, 7))
    centre, radius = np.array(numbers[:3]) * unit, numbers[-1] * unit
    normal, way = np.array(numbers[3:6]), start - centre
    if len(numbers) == 4:
        normal = tool_axis / np.linalg.norm(tool_axis)
        if abs(float(way @ normal)) > CLOSING_TOLERANCE and abs(float(np.linalg.norm(way)) - radius) <= CLOSING_TOLERANCE:
            normal = np.cross(way, direction)  # a contour of turning stands on edge: its plane is that of the start and its direction
    if not np.linalg.norm(normal) > 0.0:
        raise ArcError(
            "the plane of the arc is not known: the axis of CIRCLE/ has no length, or INDIRV/ points along the radius; correct it"
        )
    normal = normal / np.linalg.norm(normal)
    arm = _arm(start, centre, normal)
    if abs(np.linalg.norm(arm) - radius) > CLOSING_TOLERANCE or radius <= 0.0:
        raise ArcError(
            f"the arc does not begin here: the tool is {np.linalg.norm(arm) * 1e3:.4f} mm from the axis of CIRCLE/, the radius is {radius * 1e3:.4f} mm"
        )
    # the sense of the turn is that of the starting direction
    turn = float(np.cross(arm, direction) @ normal)
    if abs(turn) < 1e-6 * radius * float(np.linalg.norm(direction)):
        raise ArcError("INDIRV/ points along the radius of the circle, so the sense of the arc is not known; correct it")
    normal = math.copysign(1.0, turn) * normal
    meetings = [angle_between(arm, place, normal, 1e-6) for place in _meetings(parts, centre, normal, radius, unit)]
    ordinal = int(match[1]) if (match := _ORDINAL.search(values)) else 1
    if ordinal < 1 or ordinal > len(meetings):
        raise ArcError(f"the circle meets the line {len(meetings)} times, not {ordinal}; correct it")
    angle = sorted(meetings)[ordinal - 1]
    height = normal * float((start - centre) @ normal)
    end = centre + height + math.cos(angle) * arm + math.sin(angle) * np.cross(normal, arm)
    return (centre, normal, angle), end


def _meetings(parts: dict[str, str], centre: np.ndarray, normal: np.ndarray, radius: float, unit: float) -> list[np.ndarray]:
    """Where the circle meets the line or plane, as arms from its centre (3,)."""
    if "PLANE" in parts:
        numbers = numbers_of(parts["PLANE"], "PLANE", (4,))
        along, distance = np.array(numbers[:3]), numbers[3] * unit - float(np.array(numbers[:3]) @ centre)
        flat = along - normal * (along @ normal)
    else:
        numbers = numbers_of(parts["LINE"], "LINE", (4, 6))
        half = len(numbers) // 2
        first, second = (np.pad(np.array(p) * unit, (0, 3 - half)) for p in (numbers[:half], numbers[half:]))
        way = _arm(second, first, normal)
        flat = np.cross(normal, way)
        distance = float(_arm(first, centre, normal) @ flat)
    length = float(np.linalg.norm(flat))
    if length < 1e-12:
        raise ArcError("the line that ends the arc has no direction in the plane of its circle; correct it")
    across, offset = flat / length, distance / length
    if abs(offset) > radius + CLOSING_TOLERANCE:
        raise ArcError(f"the circle does not meet the line that ends it: it passes {(abs(offset) - radius) * 1e3:.4f} mm away; correct it")
    reach = math.sqrt(max(radius**2 - offset**2, 0.0))
    along_line = np.cross(across, normal)
    return [across * offset + along_line * reach, across * offset - along_line * reach]


def _arm(point: np.ndarray, centre: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """From the axis through the centre to a point (3,)."""
    return np.asarray(point - centre - normal * ((point - centre) @ normal))
