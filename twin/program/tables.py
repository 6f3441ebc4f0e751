"""Meaning of each program word: tables used by the readers and printed in docs/programs.md.

ACTS: it changes the motion or the meaning of later words. NOTE: understood, without effect on the simulation, noted once.
REFUSED: known but not simulated; the text says what to do.
"""

from __future__ import annotations

ACTS, NOTE, REFUSED = "acts", "note", "refused"
NOTHING = "understood, no effect on the motion"
STOPS = (ACTS, "exact stop, then on")

ISO_G: dict[float, tuple[str, str]] = {
    0: (ACTS, "rapid"), 1: (ACTS, "line at feed"), 2: (ACTS, "arc clockwise; I J K from its start, or R; P turns"),
    3: (ACTS, "arc counter-clockwise"), 4: (ACTS, "dwell: P in s (LinuxCNC, or with a decimal point) or ms; X, U in s"),
    5: (ACTS, "LinuxCNC: cubic spline; others: P alone, high-speed mode, noted"), 5.1: (NOTE, "LinuxCNC: quadratic spline; others: look-ahead of the control"),
    5.2: (REFUSED, "NURBS; let the CAM system output lines or arcs"), 5.3: (REFUSED, "NURBS; let the CAM system output lines or arcs"),
    7: (REFUSED, "diameters are programmed on lathes; this machine mills"), 8: (NOTE, "radius or look-ahead, " + NOTHING),
    9: (ACTS, "exact stop in this block"), 10: (ACTS, "L2 and L20 set a zero offset, L10 to L13 (LinuxCNC: L1) a tool"), 11: (ACTS, "end of G10"), 10.9: (ACTS, "X0: radii, as here"),
    12: (REFUSED, "circular pockets; write the arcs"), 13: (REFUSED, "circular pockets; write the arcs"),
    15: (ACTS, "polar coordinates off"), 16: (ACTS, "polar coordinates about the program zero"),
    17: (ACTS, "plane XY"), 18: (ACTS, "plane ZX"), 19: (ACTS, "plane YZ"), 20: (ACTS, "inch"), 21: (ACTS, "mm"),
    22: (NOTE, "stroke limits, which the machine file gives"), 23: (NOTE, "stroke limits, which the machine file gives"), 25: (NOTE, "spindle watch, " + NOTHING),
    26: (NOTE, "spindle watch, " + NOTHING), 27: (ACTS, "to the reference point at rapid; that it lies there is not checked"),
    28: (ACTS, "through the point of the block to the reference point"), 28.1: (ACTS, "this place is the reference point of G28"),
    29: (ACTS, "from the reference point through the point of G28 to that of the block"),
    30: (ACTS, "to the second reference point"), 30.1: (ACTS, "this place is the reference point of G30"),
    31: (REFUSED, "probing is not simulated"), 33: (ACTS, "LinuxCNC: a line of K a turn; others: refused"), 33.1: (ACTS, "LinuxCNC: rigid tapping, K a turn, and back"),
    38.2: (REFUSED, "probing is not simulated"), 38.3: (REFUSED, "probing is not simulated"), 38.4: (REFUSED, "probing is not simulated"),
    38.5: (REFUSED, "probing is not simulated"),
    40: (ACTS, "cutter radius compensation off; the next move is straight"), 41: (ACTS, "cutter to the left of the contour; radius of D from [tool]"),
    42: (ACTS, "cutter to the right of the contour"), 41.1: (ACTS, "as G41, D is the diameter"), 42.1: (ACTS, "as G42, D is the diameter"),
    43: (ACTS, "tool length of H"), 43.1: (ACTS, "tool length in the block"), 43.2: (REFUSED, "a second tool length is not simulated"),
    43.4: (ACTS, "tool centre point control: five-axis transformation on"), 43.5: (ACTS, "as G43.4, tool axis by I J K"),
    44: (ACTS, "as G43: without G43.4 X Y Z are positions of the axes for any length"), 49: (ACTS, "tool length and G43.4 off"),
    50: (ACTS, "scaling off"), 50.1: (ACTS, "mirror off"), 51: (ACTS, "scaling P or I J K about a point"), 51.1: (ACTS, "mirror about X Y Z"),
    52: (ACTS, "local shift"), 53: (ACTS, "machine coordinates in this block"), 53.1: (NOTE, "A and C turn with the next move"),
    53.6: (NOTE, "A and C turn with the next move"),
    54: (ACTS, "zero offset 1; with P an additional one"), 54.1: (ACTS, "additional zero offset P"), 55: (ACTS, "zero offset 2"), 56: (ACTS, "zero offset 3"),
    57: (ACTS, "zero offset 4"), 58: (ACTS, "zero offset 5"), 59: (ACTS, "zero offset 6"), 59.1: (ACTS, "zero offset 7"), 59.2: (ACTS, "zero offset 8"),
    59.3: (ACTS, "zero offset 9"), 61: (ACTS, "LinuxCNC: exact path; others: exact stop"), 61.1: (ACTS, "LinuxCNC: exact stop; others: high accuracy, as G64"), 61.2: (NOTE, "path mode, " + NOTHING),
    62: (NOTE, "corner override, " + NOTHING), 63: (NOTE, "tapping mode, " + NOTHING), 64: (ACTS, "rounding within P"),
    65: (ACTS, "macro call P with arguments, L times"), 66: (ACTS, "macro call behind each move"), 67: (ACTS, "end of G66"),
    68: (ACTS, "turn by R about X Y"), 68.2: (ACTS, "tilted plane by origin and Euler angles I J K"), 69: (ACTS, "end of G68 and G68.2"),
    70: (ACTS, "inch"), 71: (ACTS, "mm"), 72: (REFUSED, "turning cycles; this machine mills"),
    73: (ACTS, "drilling, chips broken: Z R Q"), 74: (ACTS, "left-hand tapping: Z R P"), 76: (ACTS, "fine boring: aside by Q towards +, or by I J"),
    80: (ACTS, "cycle off"), 81: (ACTS, "drilling: Z R"), 82: (ACTS, "drilling with dwell P"), 83: (ACTS, "deep drilling: Q"), 84: (ACTS, "tapping at feed"),
    85: (ACTS, "boring, out at feed"), 86: (ACTS, "boring, out at rapid"), 87: (ACTS, "back boring, upwards from R to Z: aside by Q towards +, or by I J"),
    88: (ACTS, "boring with dwell; the halt for the hand is passed over"), 89: (ACTS, "boring with dwell, out at feed"),
    84.2: (REFUSED, "use G84"), 84.3: (REFUSED, "use G74"),
    90: (ACTS, "absolute"), 91: (ACTS, "incremental"), 90.1: (ACTS, "I J K absolute"), 91.1: (ACTS, "I J K from the start"),
    92: (ACTS, "this place has these coordinates"), 92.1: (ACTS, "G92 cleared"), 92.2: (ACTS, "G92 off"), 92.3: (ACTS, "G92 on again"),
    93: (ACTS, "F is 1/min of the block"), 94: (ACTS, "F per minute"), 95: (ACTS, "F per turn of the spindle"),
    96: (REFUSED, "constant cutting speed is not simulated; use G97"), 97: (NOTE, NOTHING), 98: (ACTS, "cycles retract to the start"), 99: (ACTS, "cycles retract to R"),
    100: (ACTS, "end of G101; with T (Brother) a tool change, then rapid"), 101: (ACTS, "mirror about the zero of X Y Z (Haas)"),
    103: (NOTE, "look-ahead in blocks, " + NOTHING), 60: (NOTE, "approach from one side: the overshoot is omitted"),
    **dict.fromkeys((7.1, 12.1, 107, 112), (REFUSED, "cylinders and polar axes of other machines; let the CAM system output X Y Z")), 13.1: (NOTE, NOTHING),
    **dict.fromkeys((35, 36, 37), (REFUSED, "probing is not simulated")), 47: (REFUSED, "engraving; let the CAM system output the moves"),
    **dict.fromkeys((6.2, 5.4), (REFUSED, "NURBS; let the CAM system output lines or arcs")), 54.2: (REFUSED, "offsets that turn with the table are not simulated; use G43.4"),
    **dict.fromkeys((68.3, 68.4), (REFUSED, "tilted planes by the tool axis; use G68.2")), **dict.fromkeys((41.2, 42.2, 141), (REFUSED, "cutter radius in space; let the CAM system output the tool centre")),
    143: (REFUSED, "use G43.4"), 154: (ACTS, "additional zero offset P"), **dict.fromkeys(range(110, 112), (ACTS, "additional zero offset")), **dict.fromkeys(range(114, 130), (ACTS, "additional zero offset")),
    150: (REFUSED, "pocket cycles; let the CAM system output the moves"), 187: (NOTE, "smoothness of the control, " + NOTHING),
    234: (ACTS, "as G43.4"), 254: (REFUSED, "dynamic zero offsets are not simulated; use G43.4"), 255: (NOTE, NOTHING),
}  # fmt: skip
"""G codes of ISO programs."""

WORDS_OF_M = ("P", "Q", "R", "E", "L", "D", "K")
"""Words that an M code of ISO programs may carry."""

ISO_M: dict[int, tuple[str, str]] = {
    0: STOPS, 1: STOPS, 2: (ACTS, "end"), 30: (ACTS, "end"), 6: (ACTS, "tool change"),
    60: STOPS, 98: (ACTS, "call of O with P, L times"), 198: (ACTS, "as M98, from another memory"), 99: (ACTS, "end of a subprogram; P the block to go on at"),
    **dict.fromkeys((3, 4, 5, 19, 29), (NOTE, "spindle, " + NOTHING)), **dict.fromkeys((7, 8, 9), (NOTE, "coolant, " + NOTHING)),
    **dict.fromkeys((48, 49, 50, 51, 52, 53), (NOTE, "override, " + NOTHING)),
    **dict.fromkeys((62, 63, 64, 65, 67, 68), (NOTE, "inputs and outputs, " + NOTHING)),
    66: (NOTE, "waits for an input, which is assumed to be present"), 61: (ACTS, "tool number"),
    70: (ACTS, "LinuxCNC: keeps the modes"), 71: (ACTS, "LinuxCNC: forgets them"), 72: (ACTS, "LinuxCNC: brings back the modes"), 73: (ACTS, "LinuxCNC: keeps the modes for the end of the subprogram"),
    128: (REFUSED, "use G43.4"), 97: (ACTS, "call of a block N of this program with P, L times (Haas)"),
}  # fmt: skip
"""M codes of ISO programs; any other is not known, and noted as such."""

SINUMERIK_G: dict[float, tuple[str, str]] = {
    0: (ACTS, "rapid"), 1: (ACTS, "line at feed"), 2: (ACTS, "arc clockwise; I J K from its start, CR=, AR=, TURN="), 3: (ACTS, "arc counter-clockwise"),
    4: (ACTS, "dwell, alone in its block: F in s, S in turns of the spindle"), 9: (ACTS, "exact stop in this block"),
    17: (ACTS, "plane XY"), 18: (ACTS, "plane ZX"), 19: (ACTS, "plane YZ"),
    25: (NOTE, "limits of axes and spindle, which the machine file gives"), 26: (NOTE, "limits of axes and spindle, which the machine file gives"),
    33: (REFUSED, "threading is not simulated"), 34: (REFUSED, "threading is not simulated"), 35: (REFUSED, "threading is not simulated"),
    331: (ACTS, "tapping: feed is pitch times S"), 332: (ACTS, "tapping, out"), 63: (ACTS, "tapping with compensating chuck, at feed in this block"),
    40: (ACTS, "cutter radius compensation off; the next move is straight"), 41: (ACTS, "cutter to the left of the contour; radius from [tool] or $TC_DP6"),
    42: (ACTS, "cutter to the right of the contour"),
    43: (REFUSED, "use T and D with a table [tool] in the machine file; G43 H is for .ngc files"), 49: (NOTE, NOTHING), 80: (NOTE, NOTHING), 53: (ACTS, "machine coordinates in this block"), 153: (ACTS, "machine coordinates in this block"),
    54: (ACTS, "settable frame [frame.G54]"), 55: (ACTS, "settable frame"), 56: (ACTS, "settable frame"), 57: (ACTS, "settable frame"),
    58: (ACTS, "programmable shift, absolute"), 59: (ACTS, "programmable shift in addition to G58"), 500: (ACTS, "no settable frame"),
    **dict.fromkeys(range(505, 600), (ACTS, "settable frame")),
    60: (ACTS, "exact stop"), 64: (ACTS, "rounding by 10 um"), 641: (ACTS, "rounding by ADIS"), 642: (ACTS, "rounding within CTOL"),
    643: (ACTS, "rounding within CTOL"), 644: (ACTS, "rounding within CTOL"), 645: (ACTS, "rounding within CTOL"), 646: (ACTS, "rounding within CTOL"),
    601: (ACTS, "exact stop waits 3/Kv"), 602: (ACTS, "exact stop waits 1/Kv"), 603: (ACTS, "exact stop does not wait"),
    70: (ACTS, "inch, not the feed"), 71: (ACTS, "mm, not the feed"), 700: (ACTS, "inch, the feed too"), 710: (ACTS, "mm, the feed too"),
    74: (ACTS, "to the reference point: the zero of the axes named"), 75: (ACTS, "to the fixed point: [frame.G75] of the axes named"),
    90: (ACTS, "absolute"), 91: (ACTS, "incremental"), 93: (ACTS, "F is 1/min of the block"), 94: (ACTS, "F per minute"), 95: (ACTS, "F per turn of the spindle"),
    96: (REFUSED, "constant cutting speed is not simulated; use G97"), 97: (NOTE, NOTHING), 961: (REFUSED, "constant cutting speed is not simulated; use G97"),
    971: (NOTE, NOTHING), 110: (ACTS, "pole from the last position"), 111: (ACTS, "pole in the work coordinates"), 112: (ACTS, "pole from the last pole"),
    147: (REFUSED, "soft approach; write the moves"), 148: (REFUSED, "soft approach; write the moves"), 247: (REFUSED, "soft approach; write the moves"),
    248: (REFUSED, "soft approach; write the moves"), 347: (REFUSED, "soft approach; write the moves"), 348: (REFUSED, "soft approach; write the moves"),
    290: (NOTE, "the language of SINUMERIK"), 291: (REFUSED, "ISO blocks inside a SINUMERIK program; write them in another file"),
    450: (ACTS, "round outside corners on an arc"), 451: (ACTS, "outside corners to the point where the paths meet"),
    **dict.fromkeys((140, 141, 142, 143, 340, 341, 62), (NOTE, "of soft approaches and corners, " + NOTHING)),
    461: (NOTE, NOTHING), 462: (NOTE, NOTHING), 460: (NOTE, NOTHING), 621: (NOTE, NOTHING), 810: (NOTE, NOTHING), 820: (NOTE, NOTHING),
    **dict.fromkeys((810, 811, 812, 813, 814, 815, 816, 817, 818, 819, 820, 821, 822, 823, 824, 825), (NOTE, "set by the machine builder, " + NOTHING)),
}  # fmt: skip
"""G codes of SINUMERIK programs."""

SINUMERIK_M: dict[int, tuple[str, str]] = {
    0: STOPS, 1: STOPS, 2: (ACTS, "end"), 30: (ACTS, "end"), 17: (ACTS, "end of a subprogram"),
    6: (ACTS, "tool change"), **dict.fromkeys((3, 4, 5, 19, 40, 41, 42, 43, 44, 45, 70), (NOTE, "spindle, " + NOTHING)),
    **dict.fromkeys((7, 8, 9), (NOTE, "coolant, " + NOTHING)),
}  # fmt: skip
"""M codes of SINUMERIK programs; any other is not known, and noted as such."""
UNKNOWN_M = "not known: what it does is set by the builder of the machine; here it changes nothing"


def _group(kind: str, meaning: str, names: str) -> dict[str, tuple[str, str]]:
    return dict.fromkeys(names.split(), (kind, meaning))


SINUMERIK_NAMES: dict[str, tuple[str, str]] = {
    **_group(NOTE, "compressor: the blocks stay lines, rounded within the tolerance in force", "COMPON COMPCURV COMPCAD COMPOF COMPSURF"),
    **_group(NOTE, "restores the modes at the end of the subprogram that its PROC line names it in", "SAVE"),
    **_group(NOTE, NOTHING, (
        "NORM CFC CFTCP CFIN CUT2D CUT2DF DIAMOF FNORM FLIN FCUB UPATH SPATH FIFOCTRL STARTFIFO "
        "STOPFIFO STOPRE WALIMOF WALIMON DYNNORM DYNFINISH DYNSEMIFIN DYNROUGH DYNPOS DYNPREC RTLION RTLIOF CPRECON CPRECOF SPCON SPCOF SBLON SBLOF "
        "DISPLOF DISPLON ASUP CDON CDOF CDOF2 POLFMASK ORISON ORISOF TCOABS TCOFR TOROTOF PAROTOF TOFFOF COUPOF CUTCONOF "
        "CUTCONON DRFOF PTPG0 CP OST OSOF OSS OSSE OSC PTP_OFF GFRAME0 TOOLCARRIER AUXFUDEL IPTRUNLOCK IPTRLOCK "
        "ACCLIMA PRIO QUICK SPRINT LFON LFOF LFTXT LFWP LFPOS POLFMLIN ICYCON ICYCOF TCOFRX TCOFRY TCOFRZ BLSYNC PRLOC ACTBLOCNO IPOENDA FINEA COARSEA "
        "IPOBRKA DYNPREC CUT2DD CUT2DFD TOWSTD TOWMCS TOWWCS TOWBCS TOWTCS TOWKCS "
        "BNAT BTAN BAUTO ENAT ETAN EAUTO RMI RMB RME RMN ORIC OSD FTOCOF SPOF POFF WALCS0 TOFROF CUTMODOF TRAILOF LEADOF TANGOF TANGDEL MASLOF CORROF "
        "PROTA PROTS PROTD NPROT NPROTDEF PUTFTOCF")),
    **_group(NOTE, "a parameter of spindle or axes, " + NOTHING, "FA LIMS SPOS SPOSA SVC FPRAON FPRAOF FZ FENDNORM SF SCC"),
    **_group(NOTE, "a lower limit that the program sets is not simulated; those of the machine file count", "FL OVRA OVRRAP ACC ACCLIM VELOLIM JERKLIM VELOLIMA JERKLIMA"),
    **_group(NOTE, "a parameter of the path that is not simulated; feed and tolerance of the tool tip count", "FGREF STOLF CTOLG0 OTOLG0 ATOL FRC FRCM"),
    **_group(ACTS, "feed of the path in percent; feed of this block alone", "OVR FB"),
    **_group(ACTS, "the axes that F counts: with A or C all of them, a degree as a mm, otherwise X Y Z; also before the first FGROUP", "FGROUP"),
    **_group(ACTS, "offsets and modes of the control that are read where they are 0, and refused elsewhere", "OFFN TOFFL TOFFR TOFF TCARR CUTMOD FXS CUTMODK DISC"),
    **_group(NOTE, "a call that moves no axis of this machine, " + NOTHING, (
        "SETMS WORKPIECE GROUP_BEGIN GROUP_END GROUP_ADDEND WRITE DELETE GETD GET RELEASE WAITP WAITM WAITE WAITS WAITMC WAITENC SETM CLEARM INIT "
        "START EXTERN LOCK UNLOCK CANCEL DISABLE ENABLE CLRINT SETAL SETINT NEWCONF DELT RESETMON GETT GETSELT GETTCOR TOOLENV CPROT CPROTDEF EXTCALL_OFF "
        "PUNCHACC POLF LIFTFAST DELAYFSTON DELAYFSTOF HIGHSPEED LOADWCS MMC FGRP CYCLE_HSC CYCLE207 ISD EXTCLOSE EXTOPEN STRINGIS CYCLE208")),
    **_group(ACTS, "five-axis transformation on or off; X Y Z are then the tool tip in the part frame", "TRAORI TRAFOOF"),
    **_group(ACTS, "the tool axis turns on a great circle", "ORIWKS ORIVECT ORIPLANE"),
    **_group(ACTS, "A and C turn linearly", "ORIMKS ORIAXES"),
    **_group(ACTS, "A2= B2= C2= are angles about turned axes, or about fixed ones", "ORIEULER ORIRPY ORIVIRT1 ORIRPY2"),
    **_group(ACTS, "feedforward", "FFWON FFWOF"), **_group(ACTS, "jerk limited or not", "SOFT BRISK"), **_group(NOTE, NOTHING, "DRIVE SOFTA BRISKA DRIVEA"),
    **_group(ACTS, "text for the operator", "MSG"),
    **_group(ACTS, "programmable frame: new, or in addition (A..); alone it is cleared", "TRANS ATRANS ROT AROT SCALE ASCALE MIRROR AMIRROR ROTS AROTS"),
    **_group(ACTS, "machine coordinates in this block", "SUPA"),
    **_group(ACTS, "tolerance (mm) and rounding of free-form surfaces", "CYCLE832"), **_group(ACTS, "tilted plane", "CYCLE800"),
    **_group(ACTS, "drilling", "CYCLE81 CYCLE82 CYCLE83 CYCLE85 CYCLE86 CYCLE87 CYCLE88 CYCLE89"), **_group(ACTS, "tapping at pitch times speed", "CYCLE84 CYCLE840"),
    **_group(ACTS, "holes on a line, a circle, a grid, at places", "HOLES1 HOLES2 CYCLE801 CYCLE802"),
    **_group(ACTS, "a cycle or subprogram behind each move", "MCALL"),
    **_group(ACTS, "subprogram by a name in a text", "CALL PCALL EXTCALL"), **_group(ACTS, "end of a subprogram", "RET ENDPROC"),
    **_group(ACTS, "arc through I1= J1= K1=, tangent arc", "CIP CT"),
    **_group(ACTS, "words of arcs, lines and corners", "CR AR TURN AP RP RPL ANG CHF CHR RND RNDM ADIS ADISPOS CTOL OTOL I1 J1 K1 FP"),
    **_group(ACTS, "tool axis as a vector, or by angles", "A3 B3 C3 A2 B2 C2"),
    **_group(ACTS, "an axis by a variable of type AXIS, e.g. AX[_X]=10", "AX"),
    **_group(ACTS, "axis to a position, with its own motion in this block", "POS POSA"),
    **_group(NOTE, "compensation begins and ends across the contour", "KONT KONTC KONTT"),
    **_group(NOTE, "G91 and the length of the tool: as G90 of a mill", "DIAMCYCOF"),
    **_group(REFUSED, "diameters are programmed on lathes; this machine mills", "DIAMON DIAM90 DIAMONA DIAM90A"),
    **_group(REFUSED, "splines and polynomials; let the CAM system output lines or arcs", "SD PW ASPLINE BSPLINE CSPLINE POLY POLYPATH SPLINEPATH INVCW INVCCW OEMIPO1 OEMIPO2"),
    **_group(REFUSED, "a transformation of other machines; let the CAM system output X Y Z", "TRACYL TRANSMIT TRAANG TRACON TRAFOON"),
    **_group(NOTE, "surface normals, which only CUT3D and ORIPATH use", "A4 B4 C4 A5 B5 C5"),
    **_group(REFUSED, "which way these angles turn the tool is set by the machine builder; let the CAM system output A3= B3= C3=", "ORIPATH ORIPATHS LEAD TILT"),
    **_group(REFUSED, "the orientation follows a special law; use A3= B3= C3= or ORIWKS", (
        "ORICONCW ORICONCCW ORICONIO ORICONTO ORICURVE ORIROTA ORIROTR ORIROTT ORIROTC THETA PHI PSI XH YH ZH A6 B6 C6 A7 B7 C7")),
    **_group(REFUSED, "cutter radius in space; let the CAM system output the tool centre", "CUT3DC CUT3DCC CUT3DCCD CUT3DCD CUT3DF CUT3DFS CUT3DFF CUT3DFD"),
    **_group(REFUSED, "a milling or turning cycle; let the CAM system output the moves", (
        "POCKET1 POCKET2 POCKET3 POCKET4 SLOT1 SLOT2 LONGHOLE CYCLE60 CYCLE61 CYCLE62 CYCLE63 CYCLE64 CYCLE70 CYCLE71 CYCLE72 CYCLE73 CYCLE74 CYCLE75 CYCLE76 CYCLE77 CYCLE78 "
        "CYCLE79 CYCLE90 CYCLE92 CYCLE93 CYCLE94 CYCLE95 CYCLE96 CYCLE97 CYCLE98 CYCLE99 CYCLE899 CYCLE930 CYCLE940 CYCLE950 CYCLE951 CYCLE952 CYCLE4071 "
        "CYCLE4072 CYCLE4073 CYCLE4074 CYCLE4075 CYCLE4077 CYCLE4078 CYCLE4079 E_LAB_A_IN F_ROU_Z")),
    **_group(REFUSED, "this place gets new coordinates; use TRANS or a settable frame", "PRESETON PRESETONS"),
    **_group(REFUSED, "point-to-point motion of the axes is not simulated; use CP", "PTP STAT TU"),
    **_group(REFUSED, "tangential and table-coupled axes are not simulated", "TANG TANGON CTABDEF CTABEND"),
    **_group(REFUSED, "contours in tables are not simulated; let the CAM system output the moves", "CONTPRON CONTDCON EXECUTE INTERSEC CALCDAT"),
    **_group(REFUSED, "axes are exchanged or renamed by this; write the program for the axes of the machine", "GEOAX AXCTSWE AXCTSWED AXTOCHAN"),
    **_group(REFUSED, "measuring is not simulated; remove the call", (
        "CYCLE971 CYCLE973 CYCLE974 CYCLE976 CYCLE977 CYCLE978 CYCLE979 CYCLE982 CYCLE994 CYCLE995 CYCLE996 CYCLE997 CYCLE998 CYCLE961 MEAS MEAW MEASA MEAWA MEAC")),
    **_group(REFUSED, "synchronised actions are not simulated; remove them if they move no axis", "ID IDS WHEN WHENEVER EVERY FROM DO SYNFCT"),
    **_group(REFUSED, "a frame along the tool or from the hand wheel; let the CAM system output the final coordinates", "TOROT TOFRAME TOROTX TOROTY TOROTZ PAROT TOFRAMEX TOFRAMEY TOFRAMEZ"),
    **_group(REFUSED, "text that is run as a program; write the blocks", "EXECSTRING EXECTAB ISOCALL"),
    **_group(REFUSED, "coupled axes are not simulated", "TRAILON COUPON COUPDEF EGON EGDEF LEADON MASLON GANTRY"),
    **_group(REFUSED, "soft approach; write the moves", "DISCL DISR DISRP FAD"),
    **_group(REFUSED, "the way back to an interrupted contour; write the moves", "REPOS REPOSA REPOSL REPOSQ REPOSH REPOSQA REPOSHA"),
    **_group(REFUSED, "stamping and oscillating are not simulated", "SON PON SPN SPP WAITOSC OSP1 OSP2"),
}  # fmt: skip
"""Names of SINUMERIK programs."""


def _named(kind: str, meaning: str, names: str) -> dict[str, tuple[str, str]]:
    return dict.fromkeys(names.split(", "), (kind, meaning))


KLARTEXT: dict[str, tuple[str, str]] = {
    "L": (ACTS, "line; X Y Z A B C, I incremental, R0 RL RR, F, FMAX in this block, F AUTO that of TOOL CALL, M"), "LP": (ACTS, "line to PR PA about CC"),
    "LN": (ACTS, "line with the tool axis TX TY TZ under M128; the surface normal NX NY NZ has no effect"),
    "CC": (ACTS, "pole, or the last position"), "C": (ACTS, "arc about CC; DR+ counter-clockwise"), "CP": (ACTS, "arc about CC by PA or IPA, with Z a helix"),
    "CR": (ACTS, "arc by radius; R below 0 is more than half a circle"), **_named(ACTS, "arc that goes on as a tangent", "CT, CTP"),
    "RND": (ACTS, "rounds the corner between two lines"), "CHF": (ACTS, "cuts off the corner between two lines"),
    **_named(ACTS, "approach on a line, at right angles, on an arc, on a line and an arc", "APPR LT, APPR LN, APPR CT, APPR LCT"),
    **_named(ACTS, "departure, likewise", "DEP LT, DEP LN, DEP CT, DEP LCT"),
    "TOOL CALL": (ACTS, "tool change; its axis gives the plane; S, F, DL, DR"), "TOOL DEF": (ACTS, "L and R of a tool; alone it prepares one"),
    "FUNCTION TCPM": (ACTS, "as M128; PATHCTRL VECTOR turns the tool on a great circle"), "FUNCTION RESET": (ACTS, "TCPM: as M129"),
    "PLANE SPATIAL": (ACTS, "tilted plane by spatial angles; A and C turn with the next move"), "PLANE RESET": (ACTS, "end of a tilted plane"),
    **_named(ACTS, "frames: datum shift, mirror, rotation, scale, tilted plane, scale by axis, preset from [frame.PRESET1]", "CYCL DEF 7, CYCL DEF 8, CYCL DEF 10, CYCL DEF 11, CYCL DEF 19, CYCL DEF 26, CYCL DEF 247"),
    "TRANS DATUM": (ACTS, "as CYCL DEF 7"), "CYCL DEF 9": (ACTS, "dwell"), "CYCL DEF 32": (ACTS, "tolerance T, of the orientation TA"),
    **_named(ACTS, "drilling, reaming, boring, pecking, tapping, bore milling; Q200 and so on", ", ".join(f"CYCL DEF {n}" for n in range(200, 210))),
    "CYCL CALL": (ACTS, "carries out the cycle; with POS at a place"), "CYCL DEF 13": (NOTE, "turns the spindle, " + NOTHING),
    **_named(ACTS, "subprogram or repeated part; program beside this one", "LBL, CALL LBL, CALL PGM"),
    "FN": (ACTS, "0 to 13: values and jumps; 15 and 16 print and are noted; others are refused"), **_named(ACTS, "parameter = formula", "Q, QL, QR"),
    "STOP": STOPS, **_named(ACTS, "begin and end, unit MM or INCH", "BEGIN PGM, END PGM"),
    "BLK FORM": (NOTE, "the blank, without effect on the motion"), "M": (ACTS, "M codes alone in a block"),
    **_named(REFUSED, "free contours; let the CAM system output L, C or CR", "FL, FLT, FC, FCT, FPOL, FSELECT"),
    **_named(REFUSED, "use PLANE SPATIAL", "PLANE PROJECTED, PLANE EULER, PLANE VECTOR, PLANE POINTS, PLANE RELATIV, PLANE AXIAL"),
    **_named(REFUSED, "write the moves", "APPR PLT, APPR PLN, APPR PCT, APPR PLCT, DEP PLCT"),
    **_named(REFUSED, "patterns and contours of cycles; write the places or moves", "PATTERN DEF, CONTOUR DEF, SEL CONTOUR, SEL PATTERN, CYCL DEF 12, CYCL DEF 14, CYCL DEF 220, CYCL DEF 221"),
    **_named(REFUSED, "probing is not simulated", "TCH PROBE"), **_named(REFUSED, "tables of the control are not simulated", "SEL TABLE, SEL PGM, PRESET SELECT"),
    **_named(REFUSED, "turning and other functions of the control are not simulated", "FUNCTION MODE, FUNCTION TURNDATA, FUNCTION FEED, FUNCTION PARAX, FUNCTION PARAXCOMP, FUNCTION PARAXMODE, TRANS MIRROR, TRANS ROTATION, TRANS SCALE, CORRDATA, POLARKIN"),
}  # fmt: skip
"""Words at the start of a HEIDENHAIN Klartext block; any other is refused by name, and so is any other cycle."""

KLARTEXT_M: dict[int, tuple[str, str]] = {
    **dict.fromkeys((0, 1, 6), STOPS), **dict.fromkeys((2, 30), (ACTS, "end")), 89: (ACTS, "the cycle behind each move, until M99"), 99: (ACTS, "the cycle here"),
    91: (ACTS, "machine coordinates in this block"), 92: (REFUSED, "the place is set by the builder of the machine; write it with M91"),
    126: (ACTS, "rotary axes go the shorter way"), 127: (ACTS, "end of M126"), 128: (ACTS, "five-axis transformation on: X Y Z are the tool tip in the part frame"), 129: (ACTS, "end of M128"),
    136: (ACTS, "F in mm a turn"), 137: (ACTS, "F per minute"), 140: (ACTS, "retracts along the tool axis by MB, or to the end of its travel"),
    **dict.fromkeys((3, 4, 5, 13, 14), (NOTE, "spindle and coolant, " + NOTHING)), **dict.fromkeys((7, 8, 9), (NOTE, "coolant, " + NOTHING)),
    **dict.fromkeys((90, 107, 108, 101, 102, 111, 115, 117, 118, 120, 134, 135, 141, 142, 143, 145, 148, 149, 150), (NOTE, NOTHING)),
    **dict.fromkeys((93, 97, 98, 103, 109, 110, 124), (REFUSED, "a special law of the path or its feed")), 94: (REFUSED, "it reduces angles by whole turns; write angles below 360 degrees"),
    **dict.fromkeys((105, 106, 112, 113, 114, 116, 130, 138, 144), (REFUSED, "kinematics and filters of the control; use M128")),
}  # fmt: skip
"""M codes of Klartext; any other is not known, and noted as such."""
