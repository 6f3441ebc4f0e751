"""The words of SINUMERIK programs, the functions that carry them out, and the order of the words of a block."""

from twin.program import sinumerik_cycles as cycles
from twin.program import sinumerik_moves as moves
from twin.program.expressions import WordError, as_text
from twin.program.frames import AXES, ROTARY
from twin.program.reader import set_mode
from twin.program.sinumerik_blocks import Block, Sinumerik
from twin.program.sinumerik_values import Written, split_arguments
from twin.program.source import plain_name
from twin.program.state import ACTS, INCH, NOTE, NOTHING, REFUSED, STOPS, Word, named

UNITS: dict[float, tuple[float, bool]] = {70: (INCH, False), 71: (1e-3, False), 700: (INCH, True), 710: (1e-3, True)}
"""G code -> unit [m], and whether F counts in it, too."""


def carry_out(m: Sinumerik, b: Block) -> None:
    """Execute the words of a block in the order of the control."""
    s, codes = m.state, b.codes
    for number, column in b.g:
        s.check_word(f"G{number:g}", SINUMERIK_G.get(number), column)
    s.one_of_each(sorted(codes), {n: SINUMERIK_G[n].group for n in codes})
    if codes & {25, 26}:
        b.pick(*AXES, "S")
    s.tools.block(b.tool, change=6 in b.m)
    if 4 in codes:
        moves.dwell(m, b)
        return
    vector = moves.orientation(m, b)
    _values(m, b)
    modal, feed = m.modal, s.feed
    for number, column in b.g:
        b.column = column
        if (handler := SINUMERIK_G[number].handler) is not None:
            handler(m, b, number)
    for word in b.names:
        _name(m, b, word)
    stops = s.note_m(b.m, SINUMERIK_M, (2, 17, 30))
    moves_axes = not b.w.keys().isdisjoint(AXES)
    if "FB" in b.w:
        s.set_feed(b.take("FB"))
    moves.motion_block(m, b, vector, bool(codes & {53, 153}) or b.has("SUPA"))
    s.feed = feed if codes.isdisjoint({331, 332}) else s.feed
    if moves_axes and m.modal is not None and m.modal is modal:
        m.modal()
    if 9 in codes or stops:
        m.corners.release()
        m.control.stop()
    times = int(b.take("P")) if "P" in b.w and b.calls else 1
    b.all_used()
    if len(b.calls) > 1:
        raise WordError(f"'{b.calls[1].name}' is a second call in the block; write it in the next one", b.calls[1].column)
    for word in b.calls:
        m.call(word, times)
    if returns := b.has("RET", "ENDPROC"):
        m.corners.release()
    if returns or 17 in b.m:
        m.flow.back()
    elif 2 in b.m or 30 in b.m:
        m.flow.ended = True


def _values(m: Sinumerik, b: Block) -> None:
    """G93 to G95, units, F, S, OVR and the tolerances of the block, which count before its names."""
    s = m.state
    m.values_first(b, UNITS, before_unit=False)
    if "OVR" in b.w:
        s.override = b.take("OVR") / 100.0
    if not 0.0 < s.override <= 2.0:
        raise WordError(f"OVR={100 * s.override:g} is out of range; give 1 to 200 percent")
    if given := {name: item.value for name, item in b.pick("CTOL", "OTOL", "ADIS", "ADISPOS").items()}:
        s.set_tolerances(given.get("CTOL"), given.get("OTOL"))
        s.out.change(**{name.lower(): max(0.0, given[name]) * s.unit for name in given.keys() & {"ADIS", "ADISPOS"}})


def _name(m: Sinumerik, b: Block, word: Written) -> None:
    """Carry out, note or refuse a name."""
    meaning = SINUMERIK_NAMES[word.name]
    m.state.check_word(word.name, meaning, word.column)
    if meaning.kind == ACTS and meaning.handler is None:
        raise WordError(f"{word.name} needs a value, e.g. {word.name}=1", word.column)
    if meaning.handler is not None:
        meaning.handler(m, b, word)


# ------------------------------------------------------------------ G codes


def _plane(m: Sinumerik, b: Block, number: float) -> None:
    if m.state.plane != number:
        m.state.outside_compensation("the plane changes")
    m.corners.release()
    set_mode(m, b, number)


def _compensation(m: Sinumerik, b: Block, number: float) -> None:
    m.corners.release()
    radius = 0.0 if number == 40 else m.state.tools.radius(m.state.tools.name, b.column)
    m.control.compensate({40: 0, 41: 1, 42: -1}[int(number)], radius)


def _settable(m: Sinumerik, _: Block, number: float) -> None:
    m.values.choose(f"G{int(number)}")


# ------------------------------------------------------------------ names


def _later(m: Sinumerik, b: Block, word: Written) -> None:
    """A name without effect here, or one that the block itself carries out, behind its modes."""


def _bare(word: Written) -> None:
    """Refuse a value of a mode."""
    if given := (word.text or "").strip():
        raise WordError(f"{word.name} takes no value; remove '{given[:20]}'", word.column)


def _transformation(m: Sinumerik, _: Block, word: Written) -> None:
    if word.name == "TRAFOOF":
        _bare(word)
    elif (word.text or "").strip():
        m.state.note("TRAORI: its number is ignored; the transformation is that of the model")
    m.corners.release()
    m.state.untilt()
    m.state.transform(word.name == "TRAORI")


def _mode(m: Sinumerik, b: Block, word: Written) -> None:
    _bare(word)
    if word.name in ("FFWON", "FFWOF") and m.out.feedforward is None:
        m.out.feedforward = "velocity+torque" if word.name == "FFWON" else "off"
    set_mode(m, b, word.name)


def _feed_axes(m: Sinumerik, _: Block, word: Written) -> None:
    axes = {m.state.slot_of.get(t, t) for t, _ in split_arguments(word.text or "")} - {""}
    m.out.change(feed_of_all=bool(axes & set(ROTARY)))
    m.state.note("FGROUP: F counts X Y Z alone, or with A or C all axes, a degree as a mm (FGREF as delivered)")


def _zero_only(m: Sinumerik, _: Block, word: Written) -> None:
    meaning = SINUMERIK_NAMES[word.name].meaning
    if value := m.values.value(word):
        raise WordError(f"{word.name}={value:g} is not supported: {meaning}", word.column)
    m.state.note(f"{word.name}: {meaning}")


def _curve(m: Sinumerik, b: Block, word: Written) -> None:
    b.curve, m.state.motion = word.name, 2


def _by_text(m: Sinumerik, b: Block, word: Written) -> None:
    """CALL "NAME", or CALL NAME with a variable that holds the name."""
    text = (word.text or "").strip()
    if text or not b.calls:
        b.calls.append(Written(plain_name(as_text(m.value_of(text, word.text_column))), word.column))
    elif isinstance(held := (m.values.store_of(b.calls[0].name) or {}).get(()), str):
        b.calls[0] = Written(plain_name(held), word.column)


def _modal(m: Sinumerik, b: Block, word: Written) -> None:
    """MCALL: a cycle or subprogram after each block with motion; without one it ends."""
    m.corners.release()
    cycle = cycles.modal_cycle(m, b)
    if cycle is not None:
        m.modal = cycles.drilling(m, cycle)
    else:
        m.modal = m.modal_call(b.calls.pop(0)) if b.calls else None


SINUMERIK_G: dict[float, Word] = {
    0: Word(ACTS, "rapid", set_mode, "motion"), 1: Word(ACTS, "line at feed", set_mode, "motion"), 2: Word(ACTS, "arc clockwise; I J K from its start, CR=, AR=, TURN=", set_mode, "motion"), 3: Word(ACTS, "arc counter-clockwise", set_mode, "motion"),
    4: Word(ACTS, "dwell, alone in its block: F in s, S in turns of the spindle"), 9: Word(ACTS, "exact stop in this block"),
    17: Word(ACTS, "plane XY", _plane, "plane"), 18: Word(ACTS, "plane ZX", _plane, "plane"), 19: Word(ACTS, "plane YZ", _plane, "plane"),
    25: Word(NOTE, "limits of axes and spindle, which the machine file gives"), 26: Word(NOTE, "limits of axes and spindle, which the machine file gives"),
    **dict.fromkeys((33, 34, 35), Word(REFUSED, "threading is not simulated")),
    331: Word(ACTS, "tapping: feed is pitch times S", None, "motion"), 332: Word(ACTS, "tapping, out", None, "motion"), 63: Word(ACTS, "tapping with compensating chuck, at feed in this block"),
    40: Word(ACTS, "cutter radius compensation off; the next move is straight", _compensation, "radius"), 41: Word(ACTS, "cutter to the left of the contour; radius from [tool] or $TC_DP6", _compensation, "radius"),
    42: Word(ACTS, "cutter to the right of the contour", _compensation, "radius"),
    43: Word(REFUSED, "use T and D with a table [tool] in the machine file; G43 H is for .ngc files"), 49: Word(NOTE, NOTHING), 80: Word(NOTE, NOTHING), 53: Word(ACTS, "machine coordinates in this block"), 153: Word(ACTS, "machine coordinates in this block"),
    54: Word(ACTS, "settable frame [frame.G54]", _settable, "offset"), **dict.fromkeys((55, 56, 57, *range(505, 600)), Word(ACTS, "settable frame", _settable, "offset")),
    58: Word(ACTS, "programmable shift, absolute", moves.frame_words, "block"), 59: Word(ACTS, "programmable shift in addition to G58", moves.frame_words, "block"), 500: Word(ACTS, "no settable frame", _settable, "offset"),
    60: Word(ACTS, "exact stop", set_mode, "path"), 64: Word(ACTS, "rounding by 10 um", set_mode, "path"), 641: Word(ACTS, "rounding by ADIS", set_mode, "path"),
    **dict.fromkeys(range(642, 647), Word(ACTS, "rounding within CTOL", set_mode, "path")),
    601: Word(ACTS, "exact stop waits 3/Kv", set_mode, "window"), 602: Word(ACTS, "exact stop waits 1/Kv", set_mode, "window"), 603: Word(ACTS, "exact stop does not wait", set_mode, "window"),
    70: Word(ACTS, "inch, not the feed", None, "unit"), 71: Word(ACTS, "mm, not the feed", None, "unit"), 700: Word(ACTS, "inch, the feed too", None, "unit"), 710: Word(ACTS, "mm, the feed too", None, "unit"),
    74: Word(ACTS, "to the reference point: the zero of the axes named", moves.fixed_point, "block"), 75: Word(ACTS, "to the fixed point: [frame.G75] of the axes named", moves.fixed_point, "block"),
    90: Word(ACTS, "absolute", set_mode, "distance"), 91: Word(ACTS, "incremental", set_mode, "distance"), 93: Word(ACTS, "F is 1/min of the block", None, "feed"), 94: Word(ACTS, "F per minute", None, "feed"), 95: Word(ACTS, "F per turn of the spindle", None, "feed"),
    96: Word(REFUSED, "constant cutting speed is not simulated; use G97"), 97: Word(NOTE, NOTHING), 961: Word(REFUSED, "constant cutting speed is not simulated; use G97"),
    971: Word(NOTE, NOTHING), 110: Word(ACTS, "pole from the last position", moves.set_pole, "block"), 111: Word(ACTS, "pole in the work coordinates", moves.set_pole, "block"), 112: Word(ACTS, "pole from the last pole", moves.set_pole, "block"),
    **dict.fromkeys((147, 148, 247, 248, 347, 348), Word(REFUSED, "soft approach; write the moves")),
    290: Word(NOTE, "the language of SINUMERIK"), 291: Word(REFUSED, "ISO blocks inside a SINUMERIK program; write them in another file"),
    450: Word(ACTS, "round outside corners on an arc", set_mode, "corner"), 451: Word(ACTS, "outside corners to the point where the paths meet", set_mode, "corner"),
    **dict.fromkeys((140, 141, 142, 143, 340, 341, 62), Word(NOTE, "of soft approaches and corners, " + NOTHING)),
    **dict.fromkeys((460, 461, 462, 621), Word(NOTE, NOTHING)), **dict.fromkeys(range(810, 826), Word(NOTE, "set by the machine builder, " + NOTHING)),
}  # fmt: skip
"""G codes of SINUMERIK programs."""

SINUMERIK_M: dict[int, Word] = {
    0: STOPS, 1: STOPS, 2: Word(ACTS, "end"), 30: Word(ACTS, "end"), 17: Word(ACTS, "end of a subprogram"),
    6: Word(ACTS, "tool change"), **dict.fromkeys((3, 4, 5, 19, 40, 41, 42, 43, 44, 45, 70), Word(NOTE, "spindle, " + NOTHING)),
    **dict.fromkeys((7, 8, 9), Word(NOTE, "coolant, " + NOTHING)),
}  # fmt: skip
"""M codes of SINUMERIK programs; any other is not known, and noted as such."""

SINUMERIK_NAMES: dict[str, Word] = {
    **named(NOTE, "compressor: the blocks stay lines, rounded within the tolerance in force", "COMPON COMPCURV COMPCAD COMPOF COMPSURF"),
    **named(NOTE, "restores the modes at the end of the subprogram that its PROC line names it in", "SAVE"),
    **named(NOTE, NOTHING, (
        "NORM CFC CFTCP CFIN CUT2D CUT2DF DIAMOF FNORM FLIN FCUB UPATH SPATH FIFOCTRL STARTFIFO "
        "STOPFIFO STOPRE WALIMOF WALIMON DYNNORM DYNFINISH DYNSEMIFIN DYNROUGH DYNPOS DYNPREC RTLION RTLIOF CPRECON CPRECOF SPCON SPCOF SBLON SBLOF "
        "DISPLOF DISPLON ASUP CDON CDOF CDOF2 POLFMASK ORISON ORISOF TCOABS TCOFR TOROTOF PAROTOF TOFFOF COUPOF CUTCONOF "
        "CUTCONON DRFOF PTPG0 CP OST OSOF OSS OSSE OSC PTP_OFF GFRAME0 TOOLCARRIER AUXFUDEL IPTRUNLOCK IPTRLOCK "
        "ACCLIMA PRIO QUICK SPRINT LFON LFOF LFTXT LFWP LFPOS POLFMLIN ICYCON ICYCOF TCOFRX TCOFRY TCOFRZ BLSYNC PRLOC ACTBLOCNO IPOENDA FINEA COARSEA "
        "IPOBRKA DYNPREC CUT2DD CUT2DFD TOWSTD TOWMCS TOWWCS TOWBCS TOWTCS TOWKCS "
        "BNAT BTAN BAUTO ENAT ETAN EAUTO RMI RMB RME RMN ORIC OSD FTOCOF SPOF POFF WALCS0 TOFROF CUTMODOF TRAILOF LEADOF TANGOF TANGDEL MASLOF CORROF "
        "PROTA PROTS PROTD NPROT NPROTDEF PUTFTOCF")),
    **named(NOTE, "a parameter of spindle or axes, " + NOTHING, "FA LIMS SPOS SPOSA SVC FPRAON FPRAOF FZ FENDNORM SF SCC"),
    **named(NOTE, "a lower limit that the program sets is not simulated; those of the machine file count", "FL OVRA OVRRAP ACC ACCLIM VELOLIM JERKLIM VELOLIMA JERKLIMA"),
    **named(NOTE, "a parameter of the path that is not simulated; feed and tolerance of the tool tip count", "FGREF STOLF CTOLG0 OTOLG0 ATOL FRC FRCM"),
    **named(ACTS, "feed of the path in percent; feed of this block alone", "OVR FB", group="value"),
    **named(ACTS, "the axes that F counts: with A or C all of them, a degree as a mm, otherwise X Y Z; also before the first FGROUP", "FGROUP", _feed_axes),
    **named(ACTS, "offsets and modes of the control that are read where they are 0, and refused elsewhere", "OFFN TOFFL TOFFR TOFF TCARR CUTMOD FXS CUTMODK DISC", _zero_only),
    **named(NOTE, "a call that moves no axis of this machine, " + NOTHING, (
        "SETMS WORKPIECE GROUP_BEGIN GROUP_END GROUP_ADDEND WRITE DELETE GETD GET RELEASE WAITP WAITM WAITE WAITS WAITMC WAITENC SETM CLEARM INIT "
        "START EXTERN LOCK UNLOCK CANCEL DISABLE ENABLE CLRINT SETAL SETINT NEWCONF DELT RESETMON GETT GETSELT GETTCOR TOOLENV CPROT CPROTDEF EXTCALL_OFF "
        "PUNCHACC POLF LIFTFAST DELAYFSTON DELAYFSTOF HIGHSPEED LOADWCS MMC FGRP CYCLE_HSC CYCLE207 ISD EXTCLOSE EXTOPEN STRINGIS CYCLE208")),
    **named(ACTS, "five-axis transformation on or off; X Y Z are then the tool tip in the part frame", "TRAORI TRAFOOF", _transformation),
    **named(ACTS, "the tool axis turns on a great circle", "ORIWKS ORIVECT ORIPLANE", _mode),
    **named(ACTS, "A and C turn linearly", "ORIMKS ORIAXES", _mode),
    **named(ACTS, "A2= B2= C2= are angles about turned axes, or about fixed ones", "ORIEULER ORIRPY ORIVIRT1 ORIRPY2", _mode),
    **named(ACTS, "feedforward", "FFWON FFWOF", _mode), **named(ACTS, "jerk limited or not", "SOFT BRISK", _mode), **named(NOTE, NOTHING, "DRIVE SOFTA BRISKA DRIVEA"),
    **named(ACTS, "text for the operator", "MSG", _later),
    **named(ACTS, "programmable frame: new, or in addition (A..); alone it is cleared", "TRANS ATRANS ROT AROT SCALE ASCALE MIRROR AMIRROR ROTS AROTS", moves.frame_words),
    **named(ACTS, "machine coordinates in this block", "SUPA", _later),
    **named(ACTS, "tolerance (mm) and rounding of free-form surfaces", "CYCLE832", cycles.carry_out), **named(ACTS, "tilted plane", "CYCLE800", cycles.carry_out),
    **named(ACTS, "drilling", "CYCLE81 CYCLE82 CYCLE83 CYCLE85 CYCLE86 CYCLE87 CYCLE88 CYCLE89", cycles.carry_out), **named(ACTS, "tapping at pitch times speed", "CYCLE84 CYCLE840", cycles.carry_out),
    **named(ACTS, "holes on a line, a circle, a grid, at places", "HOLES1 HOLES2 CYCLE801 CYCLE802", cycles.carry_out),
    **named(ACTS, "a cycle or subprogram behind each move", "MCALL", _modal),
    **named(ACTS, "subprogram by a name in a text", "CALL PCALL EXTCALL", _by_text), **named(ACTS, "end of a subprogram", "RET ENDPROC", _later),
    **named(ACTS, "arc through I1= J1= K1=, tangent arc", "CIP CT", _curve),
    **named(ACTS, "words of arcs, lines and corners", "CR AR TURN AP RP RPL ANG CHF CHR RND RNDM ADIS ADISPOS CTOL OTOL I1 J1 K1 FP", group="value"),
    **named(ACTS, "tool axis as a vector, or by angles", "A3 B3 C3 A2 B2 C2", group="value"),
    **named(ACTS, "an axis by a variable of type AXIS, e.g. AX[_X]=10", "AX"),
    **named(ACTS, "axis to a position, with its own motion in this block", "POS POSA"),
    **named(NOTE, "compensation begins and ends across the contour", "KONT KONTC KONTT"),
    **named(NOTE, "G91 and the length of the tool: as G90 of a mill", "DIAMCYCOF"),
    **named(REFUSED, "diameters are programmed on lathes; this machine mills", "DIAMON DIAM90 DIAMONA DIAM90A"),
    **named(REFUSED, "splines and polynomials; let the CAM system output lines or arcs", "SD PW ASPLINE BSPLINE CSPLINE POLY POLYPATH SPLINEPATH INVCW INVCCW OEMIPO1 OEMIPO2"),
    **named(REFUSED, "a transformation of other machines; let the CAM system output X Y Z", "TRACYL TRANSMIT TRAANG TRACON TRAFOON"),
    **named(NOTE, "surface normals, which only CUT3D and ORIPATH use", "A4 B4 C4 A5 B5 C5"),
    **named(REFUSED, "which way these angles turn the tool is set by the machine builder; let the CAM system output A3= B3= C3=", "ORIPATH ORIPATHS LEAD TILT"),
    **named(REFUSED, "the orientation follows a special law; use A3= B3= C3= or ORIWKS", (
        "ORICONCW ORICONCCW ORICONIO ORICONTO ORICURVE ORIROTA ORIROTR ORIROTT ORIROTC THETA PHI PSI XH YH ZH A6 B6 C6 A7 B7 C7")),
    **named(REFUSED, "cutter radius in space; let the CAM system output the tool centre", "CUT3DC CUT3DCC CUT3DCCD CUT3DCD CUT3DF CUT3DFS CUT3DFF CUT3DFD"),
    **named(REFUSED, "a milling or turning cycle; let the CAM system output the moves", (
        "POCKET1 POCKET2 POCKET3 POCKET4 SLOT1 SLOT2 LONGHOLE CYCLE60 CYCLE61 CYCLE62 CYCLE63 CYCLE64 CYCLE70 CYCLE71 CYCLE72 CYCLE73 CYCLE74 CYCLE75 CYCLE76 CYCLE77 CYCLE78 "
        "CYCLE79 CYCLE90 CYCLE92 CYCLE93 CYCLE94 CYCLE95 CYCLE96 CYCLE97 CYCLE98 CYCLE99 CYCLE899 CYCLE930 CYCLE940 CYCLE950 CYCLE951 CYCLE952 CYCLE4071 "
        "CYCLE4072 CYCLE4073 CYCLE4074 CYCLE4075 CYCLE4077 CYCLE4078 CYCLE4079 E_LAB_A_IN F_ROU_Z")),
    **named(REFUSED, "this place gets new coordinates; use TRANS or a settable frame", "PRESETON PRESETONS"),
    **named(REFUSED, "point-to-point motion of the axes is not simulated; use CP", "PTP STAT TU"),
    **named(REFUSED, "tangential and table-coupled axes are not simulated", "TANG TANGON CTABDEF CTABEND"),
    **named(REFUSED, "contours in tables are not simulated; let the CAM system output the moves", "CONTPRON CONTDCON EXECUTE INTERSEC CALCDAT"),
    **named(REFUSED, "axes are exchanged or renamed by this; write the program for the axes of the machine", "GEOAX AXCTSWE AXCTSWED AXTOCHAN"),
    **named(REFUSED, "measuring is not simulated; remove the call", (
        "CYCLE971 CYCLE973 CYCLE974 CYCLE976 CYCLE977 CYCLE978 CYCLE979 CYCLE982 CYCLE994 CYCLE995 CYCLE996 CYCLE997 CYCLE998 CYCLE961 MEAS MEAW MEASA MEAWA MEAC")),
    **named(REFUSED, "synchronised actions are not simulated; remove them if they move no axis", "ID IDS WHEN WHENEVER EVERY FROM DO SYNFCT"),
    **named(REFUSED, "a frame along the tool or from the hand wheel; let the CAM system output the final coordinates", "TOROT TOFRAME TOROTX TOROTY TOROTZ PAROT TOFRAMEX TOFRAMEY TOFRAMEZ"),
    **named(REFUSED, "text that is run as a program; write the blocks", "EXECSTRING EXECTAB ISOCALL"),
    **named(REFUSED, "coupled axes are not simulated", "TRAILON COUPON COUPDEF EGON EGDEF LEADON MASLON GANTRY"),
    **named(REFUSED, "soft approach; write the moves", "DISCL DISR DISRP FAD"),
    **named(REFUSED, "the way back to an interrupted contour; write the moves", "REPOS REPOSA REPOSL REPOSQ REPOSH REPOSQA REPOSHA"),
    **named(REFUSED, "stamping and oscillating are not simulated", "SON PON SPN SPP WAITOSC OSP1 OSP2"),
}  # fmt: skip
"""Names of SINUMERIK programs."""
