"""The words of HEIDENHAIN Klartext: at the start of a block each has its handler; any other is refused by name, and so is any other cycle."""

import re

from twin.program import klartext_cycles as cycles
from twin.program import klartext_path as path
from twin.program.expressions import WordError, needed
from twin.program.klartext_blocks import FORMULA, VALUE, Block, Klartext
from twin.program.state import ACTS, INCH, NOTE, NOTHING, REFUSED, STOPS, Word, named

# ------------------------------------------------------------------ tools and modes


def tool_call(m: Klartext, b: Block) -> None:
    """TOOL CALL number or name, axis, S, F, DL, DR."""
    m.settle()
    state, column = m.state, b.column
    match = re.match(rf"\s*(?:\"([^\"]*)\"|({VALUE}))?\s*(?:([XYZ])(?![-+\w.]))?", b.text)
    assert match
    number = match[1] or (match[2] and f"{m.number_of(match[2], column):g}")
    b.text, b.column = b.text[match.end() :], column + match.end()
    words = m.only_words(b, "S F DL DR DR2", "; give the tool in [tool] of the machine file")
    if match[3]:
        state.outside_compensation("the tool changes")
        state.plane = m.pole_plane = {"Z": 17, "Y": 18, "X": 19}[match[3]]
    if "S" in words:
        state.set_spindle(words["S"].value)
    if "F" in words:
        state.set_feed(m.feed_of(words["F"]), column)
        m.tool_feed = state.feed
    if more := [name for name in ("DL", "DR2") if name in words and words[name].value]:
        raise WordError(f"{more[0]} is not read in TOOL CALL; give the tool in [tool] of the machine file", column)
    if number:
        m.extra_radius = words["DR"].value * state.unit if "DR" in words else 0.0
        state.tools.block({"T": (number, column)}, change=True)
        state.note("TOOL CALL: the program continues after an exact stop")
        m.control.stop()


def tool_def(m: Klartext, b: Block) -> None:
    """TOOL DEF number, L, R: the table of tools of the program."""
    match = needed(re.match(rf"\s*({VALUE})", b.text), "TOOL DEF needs the number of the tool", b.column)
    name, b.text = f"{m.number_of(match[1], b.column):g}", b.text[match.end() :]
    for word, item in m.only_words(b, "L R", "; give the rest in [tool] of the machine file").items():
        m.state.tools.set_value(name, "length" if word == "L" else "radius", item.value * m.state.unit)


def tcpm(m: Klartext, b: Block) -> None:
    """FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS or VECTOR; FUNCTION RESET TCPM."""
    m.settle()
    wrong = re.sub(r"\b(?:F TCP|AXIS POS|PATHCTRL (?:AXIS|VECTOR)|REFPNT TIP-TIP)\b", "", b.text).strip()
    if wrong != ("TCPM" if b.head == "FUNCTION RESET" else "") or (b.head == "FUNCTION RESET" and b.text.strip() != "TCPM"):
        raise WordError(f"'{wrong or b.text.strip()}' is not supported; write F TCP AXIS POS and PATHCTRL AXIS or VECTOR", b.column)
    m.out.change(workpiece_orientation="VECTOR" in b.text)
    m.state.transform(b.head == "FUNCTION TCPM")


def begin(m: Klartext, b: Block) -> None:
    """BEGIN PGM name MM or INCH."""
    unit = b.text.split()[-1] if b.text.split() else ""
    if unit not in ("MM", "INCH"):
        raise WordError("BEGIN PGM ends in MM or INCH; add the unit", b.column)
    m.state.set_unit(INCH if unit == "INCH" else 1e-3, feed=True)
    if unit == "INCH":
        m.state.note("F in a program in inches counts tenths of an inch a minute, as on an iTNC 530")


def stop(m: Klartext, b: Block) -> None:
    """STOP: as M0."""
    with_code(m, b, "M", "M0 ", b.text)


def with_code(m: Klartext, b: Block, head: str, code: str, text: str) -> None:
    """Carry out a block under another head, with an M code before its text."""
    b.head, b.text, b.column = head, code + text, b.column - len(code)
    path.move(m, b)


def stray(m: Klartext, b: Block) -> None:
    """A word that is read together with another block, and stands alone."""
    where = "stands behind a move in the plane and before another" if b.head in ("RND", "CHF") else "is incomplete"
    raise WordError(f"{b.head} {where}; correct it", b.column)


def function(m: Klartext, b: Block) -> None:
    """FN 0 to FN 8, FN 13 and formulas; printing is noted."""
    if (match := FORMULA.match(b.text)) and int(match["fn"] or 0) in (*range(9), 13):
        m.assign(match["name"], m.number_of(match["text"], b.column + match.start("text")), b.column)
    elif match := re.match(r"FN\s*(15|16)\b", b.text):
        m.state.note(f"FN {match[1]}: it prints, without effect on the motion")
    else:
        raise WordError(f"{b.text[:30]} is not supported: read are FN 0 to 13 and Q = formula; write its result", b.column)


def call_cycle(m: Klartext, b: Block) -> None:
    """CYCL CALL, or at a place with POS: as M99, but M89 stays in force."""
    at_place = b.text.split()[:1] == ["POS"]
    everywhere = m.cycle_everywhere or re.search(r"\bM89\b", b.text)
    with_code(m, b, "L" if at_place else "M", "M99 ", b.text.replace("POS", "   ", at_place))
    m.cycle_everywhere = bool(everywhere)


_FRAMES = "frames: datum shift, mirror, rotation, scale, tilted plane, scale by axis, preset from [frame.PRESET1]"

KLARTEXT: dict[str, Word] = {
    "L": Word(ACTS, "line; X Y Z A B C, I incremental, R0 RL RR, F, FMAX in this block, F AUTO that of TOOL CALL, M", path.move),
    "LP": Word(ACTS, "line to PR PA about CC", path.move),
    "LN": Word(ACTS, "line with the tool axis TX TY TZ under M128; the surface normal NX NY NZ has no effect", path.move),
    "CC": Word(ACTS, "pole, or the last position; its coordinates give the plane of the arcs about it", path.set_pole), "C": Word(ACTS, "arc about CC; DR+ counter-clockwise", path.move),
    "CP": Word(ACTS, "arc about CC by PA or IPA, with Z a helix", path.move), "CR": Word(ACTS, "arc by radius; R below 0 is more than half a circle", path.move),
    **named(ACTS, "arc that goes on as a tangent", "CT, CTP", path.move),
    "RND": Word(ACTS, "rounds the corner between lines and arcs", stray), "CHF": Word(ACTS, "cuts off the corner between two lines", stray),
    **named(ACTS, "approach on a line, at right angles, on an arc, on a line and an arc", "APPR LT, APPR LN, APPR CT, APPR LCT", path.approach),
    **named(ACTS, "departure, likewise", "DEP LT, DEP LN, DEP CT, DEP LCT", path.depart),
    "TOOL CALL": Word(ACTS, "tool change; its axis gives the plane; S, F, DL, DR", tool_call), "TOOL DEF": Word(ACTS, "L and R of a tool; alone it prepares one", tool_def),
    "FUNCTION TCPM": Word(ACTS, "as M128; PATHCTRL VECTOR turns the tool on a great circle", tcpm), "FUNCTION RESET": Word(ACTS, "TCPM: as M129", tcpm),
    "PLANE SPATIAL": Word(ACTS, "tilted plane by spatial angles; A and C turn with the next move", cycles.plane), "PLANE RESET": Word(ACTS, "end of a tilted plane", cycles.plane),
    "CYCL DEF 7": Word(ACTS, _FRAMES, cycles.datum), "CYCL DEF 8": Word(ACTS, _FRAMES, cycles.mirror), "CYCL DEF 10": Word(ACTS, _FRAMES, cycles.turn),
    "CYCL DEF 11": Word(ACTS, _FRAMES, cycles.scale), "CYCL DEF 19": Word(ACTS, _FRAMES, cycles.tilt_cycle), "CYCL DEF 26": Word(ACTS, _FRAMES, cycles.scale),
    "CYCL DEF 247": Word(ACTS, _FRAMES, cycles.preset),
    "TRANS DATUM": Word(ACTS, "as CYCL DEF 7", cycles.trans_datum), "CYCL DEF 9": Word(ACTS, "dwell", cycles.dwell), "CYCL DEF 32": Word(ACTS, "tolerance T, of the orientation TA", cycles.tolerance),
    **named(ACTS, "drilling, reaming, boring, pecking, tapping, bore milling; Q200 and so on", ", ".join(f"CYCL DEF {n}" for n in cycles.NEEDS), cycles.drilling),
    "CYCL CALL": Word(ACTS, "carries out the cycle; with POS at a place", call_cycle), "CYCL DEF 13": Word(NOTE, "turns the spindle, " + NOTHING),
    **named(ACTS, "subprogram or repeated part; program beside this one", "LBL, CALL LBL, CALL PGM", stray),
    "FN": Word(ACTS, "0 to 13: values and jumps; 15 and 16 print and are noted; others are refused", function), **named(ACTS, "parameter = formula", "Q, QL, QR", function),
    "STOP": STOPS._replace(handler=stop), "BEGIN PGM": Word(ACTS, "begin and end, unit MM or INCH", begin), "END PGM": Word(ACTS, "begin and end, unit MM or INCH", stray),
    "BLK FORM": Word(NOTE, "the blank, without effect on the motion"), "M": Word(ACTS, "M codes alone in a block", path.move),
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
