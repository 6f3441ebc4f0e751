"""The words of ISO programs, the functions that carry them out, and the order of the words of a block."""

from twin.program import arcs
from twin.program import iso_frames as frames
from twin.program import iso_moves as moves
from twin.program.expressions import WordError, needed
from twin.program.frames import AXES, LINEAR
from twin.program.iso_blocks import Iso
from twin.program.reader import set_mode
from twin.program.state import ACTS, INCH, NOTE, NOTHING, REFUSED, STOPS, Block, Word

LENGTH_ON = {43, 43.4, 43.5, 44, 234}
"""G codes that switch a tool length on."""
NOT_IN_LINUXCNC: dict[float, str] = {
    76: "threading is not simulated", 88: "boring with a halt for the hand is not simulated", 87: "LinuxCNC itself does not carry it out",
    100: "LinuxCNC has no such code", 101: "LinuxCNC has no such code",
}  # fmt: skip
ONLY_IN_LINUXCNC: dict[float, str] = dict.fromkeys((33, 33.1), "threading is not simulated")
WORDS_OF_NOTES = {5.1: "PQR", 8: "PQR", 61.2: "PQR", 187: "PQRE", 103: "P", 22: "XYZIJK"}
WORDS_OF_M = "PQRELDK"
"""Words that an M code may carry."""
UNITS: dict[float, tuple[float, bool]] = {20: (INCH, True), 21: (1e-3, True), 70: (INCH, True), 71: (1e-3, True)}
"""G code -> unit [m], which F counts in, too."""
F_WITH_UNIT = {
    True: "F beside G20 or G21: it is in the unit before them, since LinuxCNC carries F out first",
    False: "F beside G20 or G21: it is in the new unit; in .ngc files in the one before",
}


def execute(m: Iso, b: Block) -> None:
    """Execute the words of a block in the order of the control; an unused word is an error."""
    s, codes = m.state, b.codes
    for number, column in b.g:
        other = (NOT_IN_LINUXCNC if m.linuxcnc else ONLY_IN_LINUXCNC).get(number)
        word = ISO_G.get(number) if other is None else Word(REFUSED, other)
        s.check_word(f"G{number:g}", Word(ACTS, "") if word is not None and word.kind == NOTE else word, column)
    for number in b.m:
        if ISO_M.get(number, Word(ACTS, "")).kind == REFUSED:
            s.check_word(f"M{number}", ISO_M[number], 1)
    if m.corners.held is not None and (not b.w.keys() & set("XYZ") or codes - {1, 2, 3} or b.m):
        m.corners.release()
    if m.call_block(b):
        return
    if 100 in codes and "T" in b.w:
        _change_and_move(m, b)
        return
    b.w = {s.slot_of.get(name, name): item for name, item in b.w.items()}
    if not m.linuxcnc and codes & {41, 42} and not codes & {43, 43.4, 43.5, 44} and "H" in b.w and "D" not in b.w:
        s.note("G41 H, G42 H: H is the number of the radius, as on older controls")
        b.w["D"] = b.w.pop("H")
    _feed_and_tool(m, b)
    groups = {number: ISO_G[number].group for number in codes}
    if m.linuxcnc:
        s.one_of_each([n for n, _ in b.g], groups)
    motion = next((n for n, _ in reversed(b.g) if groups[n] == "motion"), None)
    plane = s.plane
    for number, column in b.g:
        b.column = column
        word = ISO_G[number]
        if word.kind == NOTE and not (m.linuxcnc and number == 5.1):
            s.note(f"G{number:g}: {word.meaning}")
            b.pick(*WORDS_OF_NOTES.get(number, ""))
        elif word.handler is not None:
            word.handler(m, b, number)
    if s.plane != plane:
        s.outside_compensation("the plane changes")
    if motion is not None and motion > 3:
        if m.cycle is None:
            m.sticky, m.initial = {}, float(s.here()[arcs.PLANES[s.plane][2]])
        m.cycle = int(motion)
    elif motion is not None:
        m.cycle, s.motion = None, int(motion)
    keeping = (70, 71, 72, 73) if m.linuxcnc else ()
    stops = s.note_m(b.m, ISO_M, {2, 30, *keeping})
    for number in b.m:
        if number in keeping:
            _stored(m, number)
        b.pick(*(WORDS_OF_M if number in (19, 62, 63, 64, 65, 66, 67, 68) else "P" if 48 <= number <= 53 else ""))
    if "D" in b.w and not m.linuxcnc:
        moves.other_radius(m, b.w.pop("D"))
    moves.move_words(m, b)
    if any(number == 29 or number not in ISO_M for number in b.m):  # codes of the machine builder have what no move used
        b.pick(*WORDS_OF_M)
    if 9 in codes or stops:
        m.control.stop()
    b.all_used()
    if 2 in b.m or 30 in b.m:
        m.flow.ended = True


def _change_and_move(m: Iso, b: Block) -> None:
    """G100 T of a Brother: a tool change, then rapid, Z last."""
    m.state.note("G100 T: a tool change, then the other axes at rapid, then Z")
    motion, places = m.state.motion, b.pick(*AXES)
    execute(m, Block([entry for entry in b.g if entry[0] != 100], [*b.m, 6], b.w))
    for part in ({n: i for n, i in places.items() if n != "Z"}, {n: i for n, i in places.items() if n == "Z"}):
        if part:
            execute(m, Block([(0, 1)], [], part))
    m.state.motion = motion


def _feed_and_tool(m: Iso, b: Block) -> None:
    """G93 to G95, units, F, S, T, H and tool lengths, which count before the rest of the block."""
    s, codes, w = m.state, b.codes, b.w
    feed, inverse_time = m.values_first(b, UNITS, m.linuxcnc, F_WITH_UNIT[m.linuxcnc]), s.out.modes.feed_mode == 93
    if inverse_time and not feed and s.motion in (1, 2, 3) and not codes & {0, 4, 10, 92, 52} and w.keys() & set("XYZAC"):
        raise WordError("under G93 every block needs its own F; add it")
    tool: dict[str, tuple] = {n: (w[n].value, w.pop(n).column) for n in ("T", "H") if n in w and (n == "T" or 10 not in codes)}
    by_number = 61 in b.m and 6 not in b.m and "Q" in w
    if by_number:
        tool["T"] = w["Q"].value, w.pop("Q").column
    if 44 in codes:
        if s.out.modes.traori:
            raise WordError("G44 under G43.4 is not supported; use G43 with a negative length")
        s.note("G44: treated as G43; without G43.4 X Y Z are positions of the axes for any length")
    if 49 in codes and not s.tilted:
        s.transform(False)
    s.tools.block(tool, by_number or 6 in b.m, on=bool(codes & LENGTH_ON), off=49 in codes)
    if codes & {43.4, 43.5, 234}:
        s.transform(True)
    if "E" in w and 187 not in codes:
        raise WordError("E has no use in this block; remove it", w["E"].column)


def _stored(m: Iso, number: int) -> None:
    """M70 stores the modes, M71 discards them, M72 restores them; M73 restores them at the end of the subprogram."""
    frame = m.flow.frame
    if number in (70, 73):
        kept, system = m.state.kept(with_feed=True), m.offsets.system

        def restore() -> None:
            kept()
            m.offsets.choose(system)

        frame.kept = restore
    if number == 73:
        frame.on_return = frame.kept
    elif number == 71:
        frame.kept = None
    elif number == 72:
        needed(frame.kept, "M72 finds no modes that M70 has kept in this program or subprogram; add M70")()


# ------------------------------------------------------------------ modes


def _polar(m: Iso, _: Block, number: float) -> None:
    m.polar, m.polar_place = number == 16, None


def _cycle_off(m: Iso, _: Block, number: float) -> None:
    m.cycle = None
    if m.linuxcnc:
        m.state.motion = None


def _high_speed(m: Iso, b: Block, _: float) -> None:
    """G5 P of a Fanuc; on LinuxCNC G5 is a motion."""
    if m.linuxcnc:
        return
    if "P" not in b.w or b.w.keys() & set("XYZIJQ"):
        raise WordError("G5 is not supported: splines; let the CAM system output lines or arcs", b.column)
    b.take("P")
    m.state.note("G5 P: high-speed mode of the control, understood, no effect on the motion")


def _radii(m: Iso, b: Block, _: float) -> None:
    if b.take("X"):
        raise WordError("G10.9 X1 is not supported: diameters are programmed on lathes; this machine mills", b.column)
    m.state.note("G10.9 X0: lengths are radii, as here")


def _length(m: Iso, b: Block, _: float) -> None:
    b.pick(*LINEAR)
    m.state.note("G43.1: its length is used as that of the tool in the spindle")


ISO_G: dict[float, Word] = {
    0: Word(ACTS, "rapid", None, "motion"), 1: Word(ACTS, "line at feed", None, "motion"), 2: Word(ACTS, "arc clockwise; I J K from its start, or R; P turns", None, "motion"),
    3: Word(ACTS, "arc counter-clockwise", None, "motion"), 4: Word(ACTS, "dwell: P in s (LinuxCNC, or with a decimal point) or ms; X, U in s", moves.dwell),
    5: Word(ACTS, "LinuxCNC: cubic spline; others: P alone, high-speed mode, noted", _high_speed), 5.1: Word(NOTE, "LinuxCNC: quadratic spline; others: look-ahead of the control"),
    **dict.fromkeys((5.2, 5.3, 5.4, 6.2), Word(REFUSED, "NURBS; let the CAM system output lines or arcs")),
    7: Word(REFUSED, "diameters are programmed on lathes; this machine mills"), 8: Word(NOTE, "radius or look-ahead, " + NOTHING),
    9: Word(ACTS, "exact stop in this block"), 10: Word(ACTS, "L2 and L20 set a zero offset, L10 to L13 (LinuxCNC: L1) a tool", frames.g10), 11: Word(ACTS, "end of G10"), 10.9: Word(ACTS, "X0: radii, as here", _radii),
    12: Word(REFUSED, "circular pockets; write the arcs"), 13: Word(REFUSED, "circular pockets; write the arcs"),
    15: Word(ACTS, "polar coordinates off", _polar), 16: Word(ACTS, "polar coordinates about the program zero", _polar),
    17: Word(ACTS, "plane XY", set_mode, "plane"), 18: Word(ACTS, "plane ZX", set_mode, "plane"), 19: Word(ACTS, "plane YZ", set_mode, "plane"), 20: Word(ACTS, "inch", None, "unit"), 21: Word(ACTS, "mm", None, "unit"),
    22: Word(NOTE, "stroke limits, which the machine file gives"), 23: Word(NOTE, "stroke limits, which the machine file gives"), 25: Word(NOTE, "spindle watch, " + NOTHING),
    26: Word(NOTE, "spindle watch, " + NOTHING), 27: Word(ACTS, "to the reference point at rapid; that it lies there is not checked"),
    28: Word(ACTS, "through the point of the block to the reference point"), 28.1: Word(ACTS, "this place is the reference point of G28", moves.keep_home),
    29: Word(ACTS, "from the reference point through the point of G28 to that of the block"),
    30: Word(ACTS, "to the second reference point"), 30.1: Word(ACTS, "this place is the reference point of G30", moves.keep_home),
    **dict.fromkeys((31, 35, 36, 37, 38.2, 38.3, 38.4, 38.5), Word(REFUSED, "probing is not simulated")), 33: Word(ACTS, "LinuxCNC: a line of K a turn; others: refused"), 33.1: Word(ACTS, "LinuxCNC: rigid tapping, K a turn, and back"),
    40: Word(ACTS, "cutter radius compensation off; the next move is straight", moves.compensation, "radius"), 41: Word(ACTS, "cutter to the left of the contour; radius of D from [tool]", moves.compensation, "radius"),
    42: Word(ACTS, "cutter to the right of the contour", moves.compensation, "radius"), 41.1: Word(ACTS, "as G41, D is the diameter", moves.compensation, "radius"), 42.1: Word(ACTS, "as G42, D is the diameter", moves.compensation, "radius"),
    43: Word(ACTS, "tool length of H"), 43.1: Word(ACTS, "tool length in the block", _length), 43.2: Word(REFUSED, "a second tool length is not simulated"),
    43.4: Word(ACTS, "tool centre point control: five-axis transformation on"), 43.5: Word(ACTS, "as G43.4, tool axis by I J K"),
    44: Word(ACTS, "as G43: without G43.4 X Y Z are positions of the axes for any length"), 49: Word(ACTS, "tool length and G43.4 off"),
    50: Word(ACTS, "scaling off", frames.local_map), 50.1: Word(ACTS, "mirror off", frames.local_map), 51: Word(ACTS, "scaling P or I J K about a point", frames.local_map), 51.1: Word(ACTS, "mirror about X Y Z", frames.local_map),
    52: Word(ACTS, "local shift", frames.g52), 53: Word(ACTS, "machine coordinates in this block"), 53.1: Word(NOTE, "A and C turn with the next move"),
    53.6: Word(NOTE, "A and C turn with the next move"),
    54: Word(ACTS, "zero offset 1; with P an additional one", frames.choose_system, "offset"), 54.1: Word(ACTS, "additional zero offset P", frames.choose_system), 55: Word(ACTS, "zero offset 2", frames.choose_system, "offset"), 56: Word(ACTS, "zero offset 3", frames.choose_system, "offset"),
    57: Word(ACTS, "zero offset 4", frames.choose_system, "offset"), 58: Word(ACTS, "zero offset 5", frames.choose_system, "offset"), 59: Word(ACTS, "zero offset 6", frames.choose_system, "offset"), 59.1: Word(ACTS, "zero offset 7", frames.choose_system, "offset"), 59.2: Word(ACTS, "zero offset 8", frames.choose_system, "offset"),
    59.3: Word(ACTS, "zero offset 9", frames.choose_system, "offset"), 61: Word(ACTS, "LinuxCNC: exact path; others: exact stop", moves.path_mode, "path"), 61.1: Word(ACTS, "LinuxCNC: exact stop; others: high accuracy, as G64", moves.path_mode, "path"), 61.2: Word(NOTE, "path mode, " + NOTHING),
    62: Word(NOTE, "corner override, " + NOTHING), 63: Word(NOTE, "tapping mode, " + NOTHING), 64: Word(ACTS, "rounding within P", moves.path_mode, "path"),
    65: Word(ACTS, "macro call P with arguments, L times"), 66: Word(ACTS, "macro call behind each move"), 67: Word(ACTS, "end of G66"),
    68: Word(ACTS, "turn by R about X Y", frames.local_map), 68.2: Word(ACTS, "tilted plane by origin and Euler angles I J K", frames.tilt), 69: Word(ACTS, "end of G68 and G68.2", frames.local_map),
    70: Word(ACTS, "inch", None, "unit"), 71: Word(ACTS, "mm", None, "unit"), 72: Word(REFUSED, "turning cycles; this machine mills"),
    73: Word(ACTS, "drilling, chips broken: Z R Q", None, "motion"), 74: Word(ACTS, "left-hand tapping: Z R P", None, "motion"), 76: Word(ACTS, "fine boring: aside by Q towards +, or by I J", None, "motion"),
    80: Word(ACTS, "cycle off", _cycle_off), 81: Word(ACTS, "drilling: Z R", None, "motion"), 82: Word(ACTS, "drilling with dwell P", None, "motion"), 83: Word(ACTS, "deep drilling: Q", None, "motion"), 84: Word(ACTS, "tapping at feed", None, "motion"),
    85: Word(ACTS, "boring, out at feed", None, "motion"), 86: Word(ACTS, "boring, out at rapid", None, "motion"), 87: Word(ACTS, "back boring, upwards from R to Z: aside by Q towards +, or by I J", None, "motion"),
    88: Word(ACTS, "boring with dwell; the halt for the hand is passed over", None, "motion"), 89: Word(ACTS, "boring with dwell, out at feed", None, "motion"),
    84.2: Word(REFUSED, "use G84"), 84.3: Word(REFUSED, "use G74"),
    90: Word(ACTS, "absolute", set_mode, "distance"), 91: Word(ACTS, "incremental", set_mode, "distance"), 90.1: Word(ACTS, "I J K absolute", set_mode), 91.1: Word(ACTS, "I J K from the start", set_mode),
    92: Word(ACTS, "this place has these coordinates", frames.g92), 92.1: Word(ACTS, "G92 cleared", frames.g92_off), 92.2: Word(ACTS, "G92 off", frames.g92_off), 92.3: Word(ACTS, "G92 on again", frames.g92_off),
    93: Word(ACTS, "F is 1/min of the block", None, "feed"), 94: Word(ACTS, "F per minute", None, "feed"), 95: Word(ACTS, "F per turn of the spindle", None, "feed"),
    96: Word(REFUSED, "constant cutting speed is not simulated; use G97"), 97: Word(NOTE, NOTHING), 98: Word(ACTS, "cycles retract to the start", set_mode, "retract"), 99: Word(ACTS, "cycles retract to R", set_mode, "retract"),
    100: Word(ACTS, "end of G101; with T (Brother) a tool change, then rapid", frames.local_map), 101: Word(ACTS, "mirror about the zero of X Y Z (Haas)", frames.local_map),
    103: Word(NOTE, "look-ahead in blocks, " + NOTHING), 60: Word(NOTE, "approach from one side: the overshoot is omitted"),
    **dict.fromkeys((7.1, 12.1, 107, 112), Word(REFUSED, "cylinders and polar axes of other machines; let the CAM system output X Y Z")), 13.1: Word(NOTE, NOTHING),
    47: Word(REFUSED, "engraving; let the CAM system output the moves"),
    54.2: Word(REFUSED, "offsets that turn with the table are not simulated; use G43.4"),
    **dict.fromkeys((68.3, 68.4), Word(REFUSED, "tilted planes by the tool axis; use G68.2")), **dict.fromkeys((41.2, 42.2, 141), Word(REFUSED, "cutter radius in space; let the CAM system output the tool centre")),
    143: Word(REFUSED, "use G43.4"), 154: Word(ACTS, "additional zero offset P", frames.choose_system), **dict.fromkeys((110, 111, *range(114, 130)), Word(ACTS, "additional zero offset", frames.choose_system)),
    150: Word(REFUSED, "pocket cycles; let the CAM system output the moves"), 187: Word(NOTE, "smoothness of the control, " + NOTHING),
    234: Word(ACTS, "as G43.4"), 254: Word(REFUSED, "dynamic zero offsets are not simulated; use G43.4"), 255: Word(NOTE, NOTHING),
}  # fmt: skip
"""G codes; motion, cycles, feed, tool lengths, reference points and stops are carried out by the block."""

ISO_M: dict[int, Word] = {
    0: STOPS, 1: STOPS, 2: Word(ACTS, "end"), 30: Word(ACTS, "end"), 6: Word(ACTS, "tool change"),
    60: STOPS, 98: Word(ACTS, "call of O with P, L times"), 198: Word(ACTS, "as M98, from another memory"), 99: Word(ACTS, "end of a subprogram; P the block to go on at"),
    **dict.fromkeys((3, 4, 5, 19, 29), Word(NOTE, "spindle, " + NOTHING)), **dict.fromkeys((7, 8, 9), Word(NOTE, "coolant, " + NOTHING)),
    **dict.fromkeys((48, 49, 50, 51, 52, 53), Word(NOTE, "override, " + NOTHING)),
    **dict.fromkeys((62, 63, 64, 65, 67, 68), Word(NOTE, "inputs and outputs, " + NOTHING)),
    66: Word(NOTE, "waits for an input, which is assumed to be present"), 61: Word(ACTS, "tool number"),
    70: Word(ACTS, "LinuxCNC: keeps the modes"), 71: Word(ACTS, "LinuxCNC: forgets them"), 72: Word(ACTS, "LinuxCNC: brings back the modes"), 73: Word(ACTS, "LinuxCNC: keeps the modes for the end of the subprogram"),
    128: Word(REFUSED, "use G43.4"), 97: Word(ACTS, "call of a block N of this program with P, L times (Haas)"),
}  # fmt: skip
"""M codes of ISO programs; any other is not known, and noted as such."""
