"""Meaning of each program word: tables used by the readers and printed in docs/programs.md.

ACTS: it changes the motion or the meaning of later words. NOTE: understood, without effect on the simulation, noted once.
REFUSED: known but not simulated; the text says what to do.
"""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

Handler = TypeVar("Handler")


class Word(NamedTuple, Generic[Handler]):
    """A word of a language: kind, meaning, what carries it out, and its modal group: a block takes one word of a group."""

    kind: str
    meaning: str
    handler: Handler | None = None
    group: str = ""


ACTS, NOTE, REFUSED = "acts", "note", "refused"
NOTHING = "understood, no effect on the motion"
STOPS: Word = Word(ACTS, "exact stop, then on")
UNKNOWN = "not known: what it does is set by the builder of the machine; here it changes nothing"


def named(kind: str, meaning: str, names: str, handler: Handler | None = None) -> dict[str, Word[Handler]]:
    """Words with one meaning; names of several words are separated by commas."""
    return dict.fromkeys(names.split(", ") if "," in names else names.split(), Word(kind, meaning, handler))


SINUMERIK_G: dict[float, Word] = {
    0: Word(ACTS, "rapid"), 1: Word(ACTS, "line at feed"), 2: Word(ACTS, "arc clockwise; I J K from its start, CR=, AR=, TURN="), 3: Word(ACTS, "arc counter-clockwise"),
    4: Word(ACTS, "dwell, alone in its block: F in s, S in turns of the spindle"), 9: Word(ACTS, "exact stop in this block"),
    17: Word(ACTS, "plane XY"), 18: Word(ACTS, "plane ZX"), 19: Word(ACTS, "plane YZ"),
    25: Word(NOTE, "limits of axes and spindle, which the machine file gives"), 26: Word(NOTE, "limits of axes and spindle, which the machine file gives"),
    33: Word(REFUSED, "threading is not simulated"), 34: Word(REFUSED, "threading is not simulated"), 35: Word(REFUSED, "threading is not simulated"),
    331: Word(ACTS, "tapping: feed is pitch times S"), 332: Word(ACTS, "tapping, out"), 63: Word(ACTS, "tapping with compensating chuck, at feed in this block"),
    40: Word(ACTS, "cutter radius compensation off; the next move is straight"), 41: Word(ACTS, "cutter to the left of the contour; radius from [tool] or $TC_DP6"),
    42: Word(ACTS, "cutter to the right of the contour"),
    43: Word(REFUSED, "use T and D with a table [tool] in the machine file; G43 H is for .ngc files"), 49: Word(NOTE, NOTHING), 80: Word(NOTE, NOTHING), 53: Word(ACTS, "machine coordinates in this block"), 153: Word(ACTS, "machine coordinates in this block"),
    54: Word(ACTS, "settable frame [frame.G54]"), 55: Word(ACTS, "settable frame"), 56: Word(ACTS, "settable frame"), 57: Word(ACTS, "settable frame"),
    58: Word(ACTS, "programmable shift, absolute"), 59: Word(ACTS, "programmable shift in addition to G58"), 500: Word(ACTS, "no settable frame"),
    **dict.fromkeys(range(505, 600), Word(ACTS, "settable frame")),
    60: Word(ACTS, "exact stop"), 64: Word(ACTS, "rounding by 10 um"), 641: Word(ACTS, "rounding by ADIS"), 642: Word(ACTS, "rounding within CTOL"),
    643: Word(ACTS, "rounding within CTOL"), 644: Word(ACTS, "rounding within CTOL"), 645: Word(ACTS, "rounding within CTOL"), 646: Word(ACTS, "rounding within CTOL"),
    601: Word(ACTS, "exact stop waits 3/Kv"), 602: Word(ACTS, "exact stop waits 1/Kv"), 603: Word(ACTS, "exact stop does not wait"),
    70: Word(ACTS, "inch, not the feed"), 71: Word(ACTS, "mm, not the feed"), 700: Word(ACTS, "inch, the feed too"), 710: Word(ACTS, "mm, the feed too"),
    74: Word(ACTS, "to the reference point: the zero of the axes named"), 75: Word(ACTS, "to the fixed point: [frame.G75] of the axes named"),
    90: Word(ACTS, "absolute"), 91: Word(ACTS, "incremental"), 93: Word(ACTS, "F is 1/min of the block"), 94: Word(ACTS, "F per minute"), 95: Word(ACTS, "F per turn of the spindle"),
    96: Word(REFUSED, "constant cutting speed is not simulated; use G97"), 97: Word(NOTE, NOTHING), 961: Word(REFUSED, "constant cutting speed is not simulated; use G97"),
    971: Word(NOTE, NOTHING), 110: Word(ACTS, "pole from the last position"), 111: Word(ACTS, "pole in the work coordinates"), 112: Word(ACTS, "pole from the last pole"),
    147: Word(REFUSED, "soft approach; write the moves"), 148: Word(REFUSED, "soft approach; write the moves"), 247: Word(REFUSED, "soft approach; write the moves"),
    248: Word(REFUSED, "soft approach; write the moves"), 347: Word(REFUSED, "soft approach; write the moves"), 348: Word(REFUSED, "soft approach; write the moves"),
    290: Word(NOTE, "the language of SINUMERIK"), 291: Word(REFUSED, "ISO blocks inside a SINUMERIK program; write them in another file"),
    450: Word(ACTS, "round outside corners on an arc"), 451: Word(ACTS, "outside corners to the point where the paths meet"),
    **dict.fromkeys((140, 141, 142, 143, 340, 341, 62), Word(NOTE, "of soft approaches and corners, " + NOTHING)),
    461: Word(NOTE, NOTHING), 462: Word(NOTE, NOTHING), 460: Word(NOTE, NOTHING), 621: Word(NOTE, NOTHING), 810: Word(NOTE, NOTHING), 820: Word(NOTE, NOTHING),
    **dict.fromkeys((810, 811, 812, 813, 814, 815, 816, 817, 818, 819, 820, 821, 822, 823, 824, 825), Word(NOTE, "set by the machine builder, " + NOTHING)),
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
    **named(ACTS, "feed of the path in percent; feed of this block alone", "OVR FB"),
    **named(ACTS, "the axes that F counts: with A or C all of them, a degree as a mm, otherwise X Y Z; also before the first FGROUP", "FGROUP"),
    **named(ACTS, "offsets and modes of the control that are read where they are 0, and refused elsewhere", "OFFN TOFFL TOFFR TOFF TCARR CUTMOD FXS CUTMODK DISC"),
    **named(NOTE, "a call that moves no axis of this machine, " + NOTHING, (
        "SETMS WORKPIECE GROUP_BEGIN GROUP_END GROUP_ADDEND WRITE DELETE GETD GET RELEASE WAITP WAITM WAITE WAITS WAITMC WAITENC SETM CLEARM INIT "
        "START EXTERN LOCK UNLOCK CANCEL DISABLE ENABLE CLRINT SETAL SETINT NEWCONF DELT RESETMON GETT GETSELT GETTCOR TOOLENV CPROT CPROTDEF EXTCALL_OFF "
        "PUNCHACC POLF LIFTFAST DELAYFSTON DELAYFSTOF HIGHSPEED LOADWCS MMC FGRP CYCLE_HSC CYCLE207 ISD EXTCLOSE EXTOPEN STRINGIS CYCLE208")),
    **named(ACTS, "five-axis transformation on or off; X Y Z are then the tool tip in the part frame", "TRAORI TRAFOOF"),
    **named(ACTS, "the tool axis turns on a great circle", "ORIWKS ORIVECT ORIPLANE"),
    **named(ACTS, "A and C turn linearly", "ORIMKS ORIAXES"),
    **named(ACTS, "A2= B2= C2= are angles about turned axes, or about fixed ones", "ORIEULER ORIRPY ORIVIRT1 ORIRPY2"),
    **named(ACTS, "feedforward", "FFWON FFWOF"), **named(ACTS, "jerk limited or not", "SOFT BRISK"), **named(NOTE, NOTHING, "DRIVE SOFTA BRISKA DRIVEA"),
    **named(ACTS, "text for the operator", "MSG"),
    **named(ACTS, "programmable frame: new, or in addition (A..); alone it is cleared", "TRANS ATRANS ROT AROT SCALE ASCALE MIRROR AMIRROR ROTS AROTS"),
    **named(ACTS, "machine coordinates in this block", "SUPA"),
    **named(ACTS, "tolerance (mm) and rounding of free-form surfaces", "CYCLE832"), **named(ACTS, "tilted plane", "CYCLE800"),
    **named(ACTS, "drilling", "CYCLE81 CYCLE82 CYCLE83 CYCLE85 CYCLE86 CYCLE87 CYCLE88 CYCLE89"), **named(ACTS, "tapping at pitch times speed", "CYCLE84 CYCLE840"),
    **named(ACTS, "holes on a line, a circle, a grid, at places", "HOLES1 HOLES2 CYCLE801 CYCLE802"),
    **named(ACTS, "a cycle or subprogram behind each move", "MCALL"),
    **named(ACTS, "subprogram by a name in a text", "CALL PCALL EXTCALL"), **named(ACTS, "end of a subprogram", "RET ENDPROC"),
    **named(ACTS, "arc through I1= J1= K1=, tangent arc", "CIP CT"),
    **named(ACTS, "words of arcs, lines and corners", "CR AR TURN AP RP RPL ANG CHF CHR RND RNDM ADIS ADISPOS CTOL OTOL I1 J1 K1 FP"),
    **named(ACTS, "tool axis as a vector, or by angles", "A3 B3 C3 A2 B2 C2"),
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
