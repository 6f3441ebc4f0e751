"""The words of HEIDENHAIN Klartext: at the start of a block each has its handler; any other is refused by name, and so is any other cycle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import re

from twin.machine.machine import Machine
from twin.program import klartext_frames as frames
from twin.program import klartext_path as path
from twin.program import moves as mv
from twin.program.expressions import WordError
from twin.program.klartext_blocks import Handler, Klartext
from twin.program.klartext_cycles import NEEDS, cycle_here
from twin.program.klartext_lines import VALUE, all_parts
from twin.program.source import Unit
from twin.program.state import INCH
from twin.program.tables import ACTS, NOTE, NOTHING, REFUSED, STOPS, Word, named

_PLANE_OF = {"Z": 17, "Y": 18, "X": 19}


def klartext(program: Path, machine: Machine, unit: Unit) -> Klartext:
    """The reader of one program."""
    return Klartext(program, machine, unit, KLARTEXT, KLARTEXT_M)


# ------------------------------------------------------------------ tools and modes


def tool_call(m: Klartext, _: str, text: str, column: int) -> None:
    """TOOL CALL number or name, axis, S, F, DL, DR."""
    m.settle()
    state = m.state
    match = re.match(rf"\s*(?:\"([^\"]*)\"|({VALUE}))?\s*(?:([XYZ])(?![-+\w.]))?", text)
    assert match
    number = match[1] or (match[2] and f"{m.values.number_of(match[2], column):g}")
    block = m.scan(text[match.end() :], column + match.end(), "in TOOL CALL; write its axis, S, F, DL, DR")
    values = {name: item.value for name, item in block.w.items()}
    if match[3]:
        if state.comp is not None:
            raise WordError("the tool changes inside RL or RR; write R0 and a move before", column)
        state.plane = _PLANE_OF[match[3]]
    if "S" in values:
        state.set_spindle(values.pop("S"))
    if block.feed:
        m.set_feed(block.feed, column)
        m.tool_feed = state.feed
    length, more = values.pop("DL", 0.0), values.pop("DR", 0.0)
    beside = block.rapid or block.m or block.arg or block.sense or block.side is not None
    if beside or length or any(values.values()) or values.keys() - {"L", "R", "DR2"}:
        what = "DL" if length else next(iter(values), "FMAX" if block.rapid else "the rest")
        raise WordError(f"{what} is not read in TOOL CALL; give the tool in [tool] of the machine file", column)
    if number:
        m.extra_radius = more * state.unit
        state.tools.block({"T": (number, column), "M6": (6.0, column)})
        state.note("TOOL CALL: the program continues after an exact stop")
        m.control.stop(0.0)


def tool_def(m: Klartext, head: str, text: str, column: int) -> None:
    """TOOL DEF number, L, R: the table of tools of the program."""
    match = re.match(rf"\s*({VALUE})", text)
    if match is None:
        raise WordError("TOOL DEF needs the number of the tool", column)
    name = f"{m.values.number_of(match[1], column):g}"
    for word, item in m.only_words(head, text[match.end() :], column, "L R", "; give the rest in [tool] of the machine file").items():
        m.state.tools.set_value(name, "length" if word == "L" else "radius", item.value * m.state.unit)


def tcpm(m: Klartext, head: str, text: str, column: int) -> None:
    """FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS or VECTOR; FUNCTION RESET TCPM."""
    m.settle()
    wrong = re.sub(r"\b(?:F TCP|AXIS POS|PATHCTRL (?:AXIS|VECTOR)|REFPNT TIP-TIP)\b", "", text).strip()
    if wrong != ("TCPM" if head == "FUNCTION RESET" else "") or (head == "FUNCTION RESET" and text.strip() != "TCPM"):
        raise WordError(f"'{wrong or text.strip()}' is not supported; write F TCP AXIS POS and PATHCTRL AXIS or VECTOR", column)
    m.out.set_modes(replace(m.out.modes, workpiece_orientation="VECTOR" in text))
    m.state.transform(head == "FUNCTION TCPM")


def begin(m: Klartext, _: str, text: str, column: int) -> None:
    """BEGIN PGM name MM or INCH."""
    unit = text.split()[-1] if text.split() else ""
    if unit not in ("MM", "INCH"):
        raise WordError("BEGIN PGM ends in MM or INCH; add the unit", column)
    m.state.set_unit(INCH if unit == "INCH" else 1e-3, feed=True)
    if unit == "INCH":
        m.state.note("F in a program in inches counts tenths of an inch a minute, as on an iTNC 530")


def stop(m: Klartext, _: str, text: str, column: int) -> None:
    """STOP: as M0."""
    path.move(m, "M", f"M0 {text}", column)


def blank(m: Klartext, head: str, _: str, column: int) -> None:
    """BLK FORM."""
    m.state.note(f"{head}: {KLARTEXT[head].meaning}")


def stray(m: Klartext, head: str, _: str, column: int) -> None:
    """A word that is read together with another block, and stands alone."""
    where = "stands behind a move in the plane and before another" if head in ("RND", "CHF") else "is incomplete"
    raise WordError(f"{head} {where}; correct it", column)


def function(m: Klartext, head: str, text: str, column: int) -> None:
    """FN and formulas; printing is noted."""
    if m.values.calculation(text, column):
        return
    if match := re.match(r"FN\s*(15|16)\b", text):
        m.state.note(f"FN {match[1]}: it prints, without effect on the motion")
        return
    raise WordError(f"{text[:30]} is not supported: read are FN 0 to 13 and Q = formula; write its result", column)


# ------------------------------------------------------------------ cycles


def cycle(m: Klartext, head: str, text: str, column: int) -> None:
    """CYCL DEF: frames, dwell, tolerance at once; drilling for the next call."""
    m.settle()
    first, *parts = all_parts(text)
    match = re.match(r"\d+(?:\.\d+)?\s*(.*)", first)
    assert match
    number, handler = int(head.split()[-1]), CYCLES.get(int(head.split()[-1]), drilling)
    if number < 200 and number != 13 and (not parts or re.search(r"\d", match[1])):
        raise WordError(f"CYCL DEF {number} needs a part {number}.1, and no value in {number}.0; correct it", column)
    if number >= 200 and (parts or not re.fullmatch(rf"(?:(?!Q\d)[^=])*(?:\s*Q\d+\s*=\s*{VALUE})*\s*", match[1])):
        raise WordError(f"{head} takes parameters as Q201=-10; correct them", column)
    handler(m, head, match[1] if number >= 200 else " ".join(re.sub(r"^CYCL DEF \d+\.\d+\s*", "", part) for part in parts), column)


def drilling(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycles 200 to 209: their parameters, then the cycle for the next call."""
    for word in re.finditer(rf"(Q\d+)\s*=\s*({VALUE})", text):
        m.values.assign(word[1], m.values.number_of(word[2], column), column)
    m.cycle, m.cycle_everywhere = int(head.split()[-1]), False


def dwell(m: Klartext, _: str, text: str, column: int) -> None:
    """Cycle 9."""
    found = re.fullmatch(rf"[A-Z. ]*({VALUE})", text)
    if found is None:
        raise WordError("cycle 9 needs its time, e.g. CYCL DEF 9.1 DWELL 0.5", column)
    m.control.dwell(m.values.number_of(found[1], column))


def tolerance(m: Klartext, head: str, text: str, column: int) -> None:
    """Cycle 32: T of the path, TA of the orientation; without them as switched on."""
    words = m.only_words(head, re.sub(r"\bHSC-MODE:\s*\d", "", text), column, "T TA", " and HSC-MODE")
    m.state.set_tolerances(*(words[n].value if n in words else 0.0 for n in ("T", "TA")))
    m.state.round_corners()


def call_cycle(m: Klartext, _: str, text: str, column: int) -> None:
    """CYCL CALL, or at a place with POS."""
    m.settle()
    at_place = text.split()[:1] == ["POS"]
    block = m.scan(text.replace("POS", "   ", 1) if at_place else text, column)
    m.modes(block, column)
    if block.side or block.sense or block.arg or (not at_place and (block.rapid or block.w)):
        raise WordError("CYCL CALL takes a place behind POS only", column)
    if at_place:
        element, angles = path.element_of(m, "L", block, m.start(), False, column)
        block.all_used()
        if element is not None:
            m.emit(mv.RAPID if block.rapid else mv.LINE, element, angles)
    cycle_here(m)
    path.afterwards(m, block, column)


CYCLES: dict[int, Handler] = {
    7: frames.datum, 8: frames.mirror, 9: dwell, 10: frames.turn, 11: frames.scale, 13: blank, 19: frames.tilt_cycle, 26: frames.scale,
    32: tolerance, 247: frames.preset,
}  # fmt: skip

KLARTEXT: dict[str, Word[Handler]] = {
    "L": Word(ACTS, "line; X Y Z A B C, I incremental, R0 RL RR, F, FMAX in this block, F AUTO that of TOOL CALL, M", path.move),
    "LP": Word(ACTS, "line to PR PA about CC", path.move),
    "LN": Word(ACTS, "line with the tool axis TX TY TZ under M128; the surface normal NX NY NZ has no effect", path.move),
    "CC": Word(ACTS, "pole, or the last position", path.set_pole), "C": Word(ACTS, "arc about CC; DR+ counter-clockwise", path.move),
    "CP": Word(ACTS, "arc about CC by PA or IPA, with Z a helix", path.move), "CR": Word(ACTS, "arc by radius; R below 0 is more than half a circle", path.move),
    **named(ACTS, "arc that goes on as a tangent", "CT, CTP", path.move),
    "RND": Word(ACTS, "rounds the corner between lines and arcs", stray), "CHF": Word(ACTS, "cuts off the corner between two lines", stray),
    **named(ACTS, "approach on a line, at right angles, on an arc, on a line and an arc", "APPR LT, APPR LN, APPR CT, APPR LCT", path.approach),
    **named(ACTS, "departure, likewise", "DEP LT, DEP LN, DEP CT, DEP LCT", path.depart),
    "TOOL CALL": Word(ACTS, "tool change; its axis gives the plane; S, F, DL, DR", tool_call), "TOOL DEF": Word(ACTS, "L and R of a tool; alone it prepares one", tool_def),
    "FUNCTION TCPM": Word(ACTS, "as M128; PATHCTRL VECTOR turns the tool on a great circle", tcpm), "FUNCTION RESET": Word(ACTS, "TCPM: as M129", tcpm),
    "PLANE SPATIAL": Word(ACTS, "tilted plane by spatial angles; A and C turn with the next move", frames.plane), "PLANE RESET": Word(ACTS, "end of a tilted plane", frames.plane),
    **named(ACTS, "frames: datum shift, mirror, rotation, scale, tilted plane, scale by axis, preset from [frame.PRESET1]", "CYCL DEF 7, CYCL DEF 8, CYCL DEF 10, CYCL DEF 11, CYCL DEF 19, CYCL DEF 26, CYCL DEF 247", cycle),
    "TRANS DATUM": Word(ACTS, "as CYCL DEF 7", frames.trans_datum), "CYCL DEF 9": Word(ACTS, "dwell", cycle), "CYCL DEF 32": Word(ACTS, "tolerance T, of the orientation TA", cycle),
    **named(ACTS, "drilling, reaming, boring, pecking, tapping, bore milling; Q200 and so on", ", ".join(f"CYCL DEF {n}" for n in NEEDS), cycle),
    "CYCL CALL": Word(ACTS, "carries out the cycle; with POS at a place", call_cycle), "CYCL DEF 13": Word(NOTE, "turns the spindle, " + NOTHING, cycle),
    **named(ACTS, "subprogram or repeated part; program beside this one", "LBL, CALL LBL, CALL PGM", stray),
    "FN": Word(ACTS, "0 to 13: values and jumps; 15 and 16 print and are noted; others are refused", function), **named(ACTS, "parameter = formula", "Q, QL, QR", function),
    "STOP": STOPS._replace(handler=stop), "BEGIN PGM": Word(ACTS, "begin and end, unit MM or INCH", begin), "END PGM": Word(ACTS, "begin and end, unit MM or INCH", stray),
    "BLK FORM": Word(NOTE, "the blank, without effect on the motion", blank), "M": Word(ACTS, "M codes alone in a block", path.move),
    **named(REFUSED, "free contours; let the CAM system output L, C or CR", "FL, FLT, FC, FCT, FPOL, FSELECT"),
    **named(REFUSED, "use PLANE SPATIAL", "PLANE PROJECTED, PLANE EULER, PLANE VECTOR, PLANE POINTS, PLANE RELATIV, PLANE AXIAL"),
    **named(REFUSED, "write the moves", "APPR PLT, APPR PLN, APPR PCT, APPR PLCT, DEP PLCT"),
    **named(REFUSED, "patterns and contours of cycles; write the places or moves", "PATTERN DEF, CONTOUR DEF, SEL CONTOUR, SEL PATTERN, CYCL DEF 12, CYCL DEF 14, CYCL DEF 220, CYCL DEF 221"),
    **named(REFUSED, "probing is not simulated", "TCH PROBE"), **named(REFUSED, "tables of the control are not simulated", "SEL TABLE, SEL PGM, PRESET SELECT"),
    **named(REFUSED, "turning and other functions of the control are not simulated", "FUNCTION MODE, FUNCTION TURNDATA, FUNCTION FEED, FUNCTION PARAX, FUNCTION PARAXCOMP, FUNCTION PARAXMODE, TRANS MIRROR, TRANS ROTATION, TRANS SCALE, CORRDATA, POLARKIN"),
}  # fmt: skip
"""Words at the start of a block."""

KLARTEXT_M: dict[int, Word] = {
    **dict.fromkeys((0, 1, 6), STOPS), **dict.fromkeys((2, 30), Word(ACTS, "end")), 89: Word(ACTS, "the cycle behind each move, until M99"), 99: Word(ACTS, "the cycle here"),
    91: Word(ACTS, "machine coordinates in this block"), 92: Word(REFUSED, "the place is set by the builder of the machine; write it with M91"),
    126: Word(ACTS, "rotary axes go the shorter way"), 127: Word(ACTS, "end of M126"), 128: Word(ACTS, "five-axis transformation on: X Y Z are the tool tip in the part frame"), 129: Word(ACTS, "end of M128"),
    136: Word(ACTS, "F in mm a turn"), 137: Word(ACTS, "F per minute"), 140: Word(ACTS, "retracts along the tool axis by MB, or to the end of its travel"),
    **dict.fromkeys((3, 4, 5, 13, 14), Word(NOTE, "spindle and coolant, " + NOTHING)), **dict.fromkeys((7, 8, 9), Word(NOTE, "coolant, " + NOTHING)),
    **dict.fromkeys((90, 107, 108, 101, 102, 111, 115, 117, 118, 120, 134, 135, 141, 142, 143, 145, 148, 149, 150), Word(NOTE, NOTHING)),
    **dict.fromkeys((93, 97, 98, 103, 109, 110, 124), Word(REFUSED, "a special law of the path or its feed")), 94: Word(REFUSED, "it reduces angles by whole turns; write angles below 360 degrees"),
    **dict.fromkeys((105, 106, 112, 113, 114, 116, 130, 138, 144), Word(REFUSED, "kinematics and filters of the control; use M128")),
}  # fmt: skip
"""M codes of Klartext; any other is not known, and noted as such."""
