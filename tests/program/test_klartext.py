"""HEIDENHAIN Klartext: programs whose end points have a closed form, every word of the table, mutations, and other languages with the same meaning."""

from __future__ import annotations

import math
from pathlib import Path
import random

import numpy as np
import pytest

from devtools import fuzz_programs
from tests.conftest import ROOT
from twin.errors import InputError
from twin.program import check_folder, read_program
from twin.program.klartext import KLARTEXT, KLARTEXT_M
from twin.program.moves import ARC, LINE, RAPID
from twin.program.read import understand
from twin.program.state import ACTS, NOTE, REFUSED

ROOT2 = math.sqrt(0.5)
DRILL = "CYCL DEF {} ~\n Q200=2 ;CLEARANCE ~\n Q201=-10 ;DEPTH ~\n Q206=200 ;FEED ~\n Q202=4 ~\n Q210=0 ~\n Q203=+1 ~\n Q204=20 ~\n Q211=0.5 {}\n"
NEAR = "L X+5 Y+5 Z+30 R0 FMAX\n"
CONTOUR = "L X+0 Y-20 R0 FMAX\n{}\nL X+30 Y+0\n{}"


@pytest.fixture
def equipped(mikron):
    return mikron.with_values({"tool": {"T1": {"length_m": 0.1, "radius_m": 5e-3}}})


@pytest.fixture
def moves(write, equipped):
    """Kind, end [mm] and angle [deg] of each move of a text between BEGIN PGM and END PGM."""

    def reader(text: str, unit: str = "MM") -> list[tuple]:
        lines = f"BEGIN PGM A {unit}\nTOOL CALL 1 Z S1000 F400\n{text}\nEND PGM A {unit}\n".splitlines()
        out = understand(write("\n".join(f"{k} {line}" for k, line in enumerate(lines)), "a.h"), equipped)
        return [
            (kind, *(round(v * 1e3, 4) + 0.0 for v in t[:3]), *(round(math.degrees(v), 4) for v in t[3:]))
            for kind, t in zip(out.kinds, out.targets)
        ]

    return reader


def xyz(*points: tuple[float, float, float], kind: int = LINE) -> list[tuple]:
    return [(kind, *p) for p in points]


def drilled(*heights: float) -> list[float]:
    return list(heights)


PROGRAMS = {
    "line": ("L X+10 Y-5 F500\nL IX+5 IZ+1\nL X+Q1", "FN 0: Q1=+2\n", [(10, -5, 0), (15, -5, 1), (2, -5, 1)]),
    "decimal comma and no sign": ("L X10,5 F500", "", [(10.5, 0, 0)]),
    "circle about CC": ("L X+20 Y+0 F500\nCC X+0 Y+0\nC X+0 Y+20 DR+\nC X-20 Y+0 DR+", "", [(20, 0, 0), (0, 20, 0), (-20, 0, 0)]),
    "full circle": ("L X+20 Y+0 F500\nCC IX-20 IY+0\nC X+20 Y+0 DR-", "", [(20, 0, 0), (20, 0, 0)]),
    "CC at the last place": ("L X+5 Y+5 F500\nCC\nLP PR+10 PA+90\nCP IPA-90 DR-", "", [(5, 5, 0), (5, 15, 0), (15, 5, 0)]),
    "polar steps": ("CC X+0 Y+0\nLP PR+10 PA+0 F500\nLP IPA+45\nLP IPR+10 PA+90", "", [(10, 0, 0), (10 * ROOT2, 10 * ROOT2, 0), (0, 20, 0)]),
    "helix of two and a quarter turns": ("L X+10 Y+0 Z+0 F500\nCC X+0 Y+0\nCP IPA+810 IZ-9 DR+", "", [(10, 0, 0), (0, 10, -9)]),
    "CR short and long": ("L X+10 Y+0 F500\nCR X+0 Y+10 R+10 DR+\nCR X-10 Y+0 R-10 DR-", "", [(10, 0, 0), (0, 10, 0), (-10, 0, 0)]),
    "CT": ("L X+10 Y+0 F500\nCT X+20 Y+10\nCT X+10 Y+20", "", [(10, 0, 0), (20, 10, 0), (10, 20, 0)]),
    "CTP": ("L X+10 Y+0 F500\nCC X+10 Y+10\nCTP PR+10 PA+0", "", [(10, 0, 0), (20, 10, 0)]),
    "RND": ("L X+10 Y+0 F500\nRND R2\nL X+10 Y+10", "", [(8, 0, 0), (10, 2, 0), (10, 10, 0)]),
    "CHF": ("L X+10 Y+0 F500\nCHF 2\nL X+10 Y+10", "", [(8, 0, 0), (10, 2, 0), (10, 10, 0)]),
    "M91": ("CYCL DEF 7.0 DATUM\nCYCL DEF 7.1 X+10\nCYCL DEF 7.2 Y+20\nL X+1 Y+1 F500\nL X+0 M91\nL X+0", "", [(11, 21, 0), (0, 21, 0), (10, 21, 0)]),
    "shifts add": ("CYCL DEF 7.0\nCYCL DEF 7.1 X+10\nCYCL DEF 7.0\nCYCL DEF 7.1 IX+5\nL X+1 F500\nTRANS DATUM RESET\nL X+1", "", [(16, 0, 0), (1, 0, 0)]),
    "mirror": ("CYCL DEF 8.0 MIRROR\nCYCL DEF 8.1 X\nL X+10 Y+5 F500\nCYCL DEF 8.0\nCYCL DEF 8.1\nL X+10", "", [(-10, 5, 0), (10, 5, 0)]),
    "rotation": ("CYCL DEF 10.0 ROT\nCYCL DEF 10.1 ROT+30\nCYCL DEF 10.0 ROT\nCYCL DEF 10.1 IROT+60\nL X+10 Y+0 F500\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+0\nL X+1", "", [(0, 10, 0), (1, 10, 0)]),
    "scale": ("CYCL DEF 11.0 SCALE\nCYCL DEF 11.1 SCL 0.5\nL X+10 F500\nCYCL DEF 26.0 SCALE\nCYCL DEF 26.1 X2 Y0.5 CCX+4 CCY+0\nL X+6 Y+8", "", [(5, 0, 0), (8, 4, 0)]),
    "shift, mirror and rotation": ("CYCL DEF 7.0\nCYCL DEF 7.1 X+5 Y+1\nCYCL DEF 8.0\nCYCL DEF 8.1 X\nCYCL DEF 10.0\nCYCL DEF 10.1 ROT+90\nL X+10 Y+2 F500", "", [(7, 11, 0)]),
    "repeat": ("L X+0 F500\nLBL 1\nL IX+10\nCALL LBL 1 REP 3\nL Y+1", "", [(0, 0, 0), (10, 0, 0), (20, 0, 0), (30, 0, 0), (40, 0, 0), (40, 1, 0)]),
    "subprogram": ("CALL LBL 5\nL X+9\nCALL LBL \"B\"\nM30\nLBL 5\nL IX+1 F500\nCALL LBL \"B\"\nLBL 0\nLBL \"B\"\nL IY+2\nLBL 0", "", [(1, 0, 0), (1, 2, 0), (9, 2, 0), (9, 4, 0)]),
    "jump": ("LBL 7\nQ1 = Q1 + 1\nL X+Q1 F500\nFN 12: IF +Q1 LT +3 GOTO LBL 7\nFN 9: IF +Q1 EQU 3 GOTO LBL 8\nL X+99\nLBL 8\nL Y+1", "Q1 = 0\n", [(1, 0, 0), (2, 0, 0), (3, 0, 0), (3, 1, 0)]),
    "FN": ("L X+Q1 Y+Q2 Z+Q3 F500\nL X+Q4 Y+Q5 Z+Q6\nL X+Q7 Y+Q8", "FN 1: Q1=+1+2\nFN 2: Q2=9-Q1\nFN 3: Q3=+2 * +Q1\nFN 4: Q4=+9 DIV +2\nFN 5: Q5=SQRT 16\nFN 6: Q6=SIN+30\nFN 7: Q7=COS60\nFN 7: Q7=COS+60\nFN 8: Q8=+3 LEN +4\n".replace("FN 7: Q7=COS60\n", ""), [(3, 6, 6), (4.5, 4, 0.5), (0.5, 5, 0.5)]),
    "formulas": ("L X+Q1 Y-Q2 Z+Q3 F500", "Q1 = 2 * (3 + SQ 2) - NEG 1\nQ2 = ATAN 1 + INT 3.7 + FRAC 1.25\nQ3 = ABS -2 ^ 3 + SGN 5\nFN 13: Q4 = +1 ANG -1\nQ3 = Q3 + Q4 / 135\n", [(15, -48.25, 10)]),
    "APPR LT, DEP LT": (CONTOUR.format("APPR LT X+10 Y+0 LEN8 R0 F300", "DEP LT LEN5"), "", [(0, -20, 0), (2, 0, 0), (10, 0, 0), (30, 0, 0), (35, 0, 0)]),
    "APPR LN, DEP LN": (CONTOUR.format("APPR LN X+10 Y+0 LEN8 RL F300", "DEP LN LEN8"), "", [(0, -20, 0), (10, 13, 0), (10, 5, 0), (30, 5, 0), (30, 13, 0)]),
    "APPR CT, DEP CT": (CONTOUR.format("APPR CT X+10 Y+0 CCA90 R+12 RL F300", "DEP CT CCA90 R+12"), "", [(0, -20, 0), (3, 12, 0), (10, 5, 0), (30, 5, 0), (37, 12, 0)]),
    "APPR LCT, DEP LCT": ("L X-12 Y+40 R0 FMAX\nAPPR LCT X+0 Y+0 R12 RL F300\nL X+30 Y+0\nDEP LCT X+42 Y+40 R12", "", [(-12, 40, 0), (-7, 12, 0), (0, 5, 0), (30, 5, 0), (37, 12, 0), (42, 40, 0)]),
    "RR with a corner": ("L X+0 Y+0 F500\nL X+10 Y+10 RR\nL X+10 Y+30\nL X+30 Y+30\nL X+40 Y+40 R0", "", [(0, 0, 0), (15, 10, 0), (15, 25, 0), (30, 25, 0), (40, 40, 0)]),
    "plane ZX": ("TOOL CALL 1 Y S1\nL X+0 Z+10 F500\nCC X+0 Z+0\nC X+10 Z+0 DR+", "", [(0, 0, 10), (10, 0, 0)]),
    "CC in YZ and in ZX": ("L X+2 Y+14 Z+8 F500\nCC Y+10 Z+8\nCP IPA-90 DR-\nL X+8\nCC X+8 Z+8\nCP IPA-180 DR-\nC X+12 Z+8 DR-\nCC X+9 Y+4\nLP PR+3 PA+90", "", [(2, 14, 8), (2, 10, 4), (8, 10, 4), (8, 10, 12), (12, 10, 8), (9, 7, 8)]),
    "M140": ("L Z+5 F500\nL M140 MB 7\nL M140 MB MAX FMAX", "", [(0, 0, 5), (0, 0, 12), None]),
}  # fmt: skip


@pytest.mark.parametrize("name", PROGRAMS)
def test_end_points_are_those_of_the_closed_form(moves, name: str) -> None:
    text, head, expected = PROGRAMS[name]
    found = [m[1:4] for m in moves(head + text)]
    assert len(found) == len(expected)
    for got, wanted in zip(found, expected):
        assert wanted is None or got == pytest.approx(wanted, abs=2e-4), name


def test_there_are_thirty_programs() -> None:
    assert len(PROGRAMS) >= 30


HEIGHTS = {
    200: [3, -3, 3, -2.8, -7, 3, -6.8, -9, 3, 21], 201: [3, -9, 3, 21], 203: [3, -3, 3, -2.8, -7, 3, -6.8, -9, 3, 21], 205: [3, -3, 3, -2.8, -7, 3, -6.8, -9, 3, 21],
    206: [3, -9, 3, 21], 207: [3, -9, 3, 21], 202: [3, -9, -9, 3, 3, 21], 209: [3, -2, 3, -5, 3, -8, 3, -9, 3, 21],
}  # fmt: skip
MORE = {207: "Q239=+1.5", 202: "Q214=1", 209: "Q239=+1.5 ~\n Q257=3 ~\n Q256=0"}


@pytest.mark.parametrize("number", HEIGHTS)
def test_heights_of_drilling(moves, number: int) -> None:
    """Clearance 2 above the surface 1, depth 10 in steps of 4, 0.2 mm above the last depth at rapid, second clearance 20."""
    more = f"~\n {MORE[number]}" if number in MORE else ""
    text = DRILL.format(number, more) + NEAR + "CYCL CALL\nL X+6 FMAX\n"
    found = [m for m in moves(text) if m[0] in (RAPID, LINE)]
    assert [m[3] for m in found[1:-1]] == HEIGHTS[number]
    assert {m[1] for m in found} <= {5.0, 6.0, 4.8}
    if number == 207:
        assert sum(m[0] == LINE for m in found) == 2


def test_a_cycle_is_called_by_m99_and_m89(moves) -> None:
    """M89 calls it behind each move until M99, which calls once more; Q parameters may be set without ~."""
    head = "CYCL DEF 200 DRILLING\nQ200 = 2\nQ201=-3\nQ206=100\nQ202=5\nQ203=+0\nQ204=2\n" + NEAR
    count = lambda text: sum(m[0] == LINE for m in moves(head + text))  # noqa: E731
    assert count("L X+1 FMAX M99\nL X+2 FMAX\nCYCL CALL") == 2
    assert count("L X+1 FMAX M89\nL X+2 FMAX\nL X+3 FMAX M99\nL X+4 FMAX") == 3
    assert count("CYCL CALL POS X+1 Y+1 FMAX M3\n") == 1
    with pytest.raises(InputError, match="cycle 200 needs Q202"):
        moves("CYCL DEF 200\nQ200=2\nQ201=-3\nQ206=100\nQ203=+0\nCYCL CALL")


def test_bore_milling_and_back_boring(moves) -> None:
    helix = moves(DRILL.format(208, "~\n Q334=5 ~\n Q335=30 ~\n Q342=0") + NEAR + "CYCL CALL")
    assert [m[1:4] for m in helix if m[0] == ARC] == [(15, 5, 3), (15, 5, -9), (15, 5, -9), (5, 5, -9)]
    back = moves(
        "CYCL DEF 204 ~\n Q200=2 ~\n Q249=4 ~\n Q250=20 ~\n Q251=3 ~\n Q252=1 ~\n Q253=500 ~\n Q254=100 ~\n Q255=0 ~\n Q203=0 ~\n Q204=0 ~\n Q214=3\n"
        + NEAR
        + "CYCL CALL"
    )
    assert [m[1:4] for m in back[1:]] == [
        (5, 5, 2),
        (8, 5, 2),
        (8, 5, -23),
        (5, 5, -23),
        (5, 5, -17),
        (5, 5, -23),
        (8, 5, -23),
        (8, 5, 2),
        (5, 5, 2),
    ]


def test_dwell_stops_tolerance_and_feeds(write, equipped) -> None:
    text = "BEGIN PGM A MM\nTOOL CALL 1 Z S1000 F300\nL X+1 F AUTO\nCYCL DEF 9.0 DWELL\nCYCL DEF 9.1 DWELL 1.5\nCYCL DEF 32.0 TOL\nCYCL DEF 32.1 T0.05\nCYCL DEF 32.2 HSC-MODE:1 TA0.5\nL X+2 F500\nL X+3 FMAX\nL X+4\nM136\nL X+5 F0.2\nM137\nSTOP\nL X+6 F100\nEND PGM A MM\n"
    out = understand(write(text, "a.h"), equipped)
    assert out.feeds == [300, math.inf, 500, math.inf, 500, 0.2, 100]
    assert list(out.pauses.values()) == [1.5]
    assert 5 in out.stops
    assert [out.all_modes[k].tolerance for k in out.mode_of][2:] == pytest.approx([50e-6] * 5)
    inch = understand(write("BEGIN PGM A INCH\nL X+1 F100\nEND PGM A INCH\n", "a.h"), equipped)
    assert inch.targets[0][0] == pytest.approx(25.4e-3)
    assert inch.finish().moves.feed[0] * 60e3 == pytest.approx(254.0)


def test_a_feed_behind_m140_is_that_of_its_retract(write, equipped) -> None:
    """The retract alone goes at it; F AUTO without a feed in TOOL CALL is refused."""
    head = "BEGIN PGM A MM\nTOOL CALL 1 Z S1000\nL X+1 F500\n"
    out = understand(write(f"{head}L M140 MB 7 F750\nL X+2\nL M140 MB MAX FMAX\nL X+3\n", "a.h"), equipped)
    assert out.feeds == [500, 750, 500, math.inf, 500]
    with pytest.raises(InputError, match="F AUTO is the feed of TOOL CALL"):
        understand(write(f"{head}L X+2 F AUTO\n", "a.h"), equipped)


def test_tilted_planes_and_tool_centre_control_are_those_of_sinumerik(write, mikron) -> None:
    """PLANE SPATIAL and cycle 19 against CYCLE800, M128 and TCPM against TRAORI, LN against A3= B3= C3=."""

    def target(text: str, name: str) -> np.ndarray:
        program = read_program(write(text, name), mikron)
        return np.vstack([program.start, program.moves.target])[-2:]

    tail, other = "L X+10 Y+20 Z+190 F500\nL X+12\nEND PGM A MM\n", "G1 F500 X10 Y20 Z190\nX12\n"
    plane = target(f"BEGIN PGM A MM\nPLANE SPATIAL SPA+20 SPB+0 SPC+30 TURN FMAX\n{tail}", "a.h")
    assert np.allclose(plane, target(f"CYCLE800(0,,0,27,0,0,0,30,0,20,0,0,0)\n{other}", "a.mpf"), atol=1e-9)
    assert np.allclose(plane, target(f"BEGIN PGM A MM\nCYCL DEF 19.0 PLANE\nCYCL DEF 19.1 A+20 B+0 C+30\n{tail}", "a.h"), atol=1e-12)
    reset = target(f"BEGIN PGM A MM\nPLANE SPATIAL SPA+20 SPB+0 SPC+0 STAY\nPLANE RESET STAY\n{tail}", "a.h")
    assert np.allclose(reset[:, :3] * 1e3, [[10, 20, 190], [12, 20, 190]])
    tcp = "{}\nL X+10 Y+20 Z+190 A-10 C+20 F500\nL X+12\n{}\nEND PGM A MM\n"
    traori = target(f"TRAORI\nORIMKS\n{other.replace('Z190', 'Z190 A=-10 C=20')}", "a.mpf")
    for on, off in (("M128", "M129"), ("FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS", "FUNCTION RESET TCPM")):
        assert np.allclose(target("BEGIN PGM A MM\n" + tcp.format(on, off), "a.h"), traori)
    vector = target("BEGIN PGM A MM\nM128\nLN X+10 Y+20 Z+190 NX0 NY0 NZ1 TX+0.1 TY+0.2 TZ+0.9 F500\nL X+12\nEND PGM A MM\n", "a.h")
    assert np.allclose(vector, target("TRAORI\nG1 F500 X10 Y20 Z190 A3=0.1 B3=0.2 C3=0.9\nX12\n", "a.mpf"))


def test_parameters_of_the_tilt_are_the_rotary_angles(moves) -> None:
    found = moves("PLANE SPATIAL SPA+20 SPB+0 SPC+0 STAY\nL A+Q120 C+Q122 FMAX\nL X+0 Y+0 Z+190 F500")
    assert abs(found[0][4]) == pytest.approx(20.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_seq_chooses_the_solution_by_the_sign_of_the_tilting_axis(write, mikron, sign: int) -> None:
    """Both solutions hold the tool at right angles to the plane; after SEQ the tilting axis has its sign."""
    for c in (0, 40, 170):
        text = f"BEGIN PGM A MM\nL X+0 F500\nPLANE SPATIAL SPA+0 SPB+20 SPC+{c} TURN FMAX SEQ{'+' if sign > 0 else '-'} TABLE ROT\nL X+10 Y+20 Z+190\nL X+12\nEND PGM A MM\n"
        program = read_program(write(text, "a.h"), mikron)
        tilt = np.degrees(program.moves.target[-2:, 3])
        assert tilt * sign == pytest.approx([20, 20])
        axes = program.kinematics.forward(np.concatenate([np.zeros((1, 3)), program.moves.target[-1:, 3:]], axis=1))[1][0]
        turn = math.radians(c)
        assert axes == pytest.approx(
            [math.sin(math.radians(20)) * math.cos(turn), math.sin(math.radians(20)) * math.sin(turn), math.cos(math.radians(20))], abs=1e-9
        )


def test_rotary_axes_the_shorter_way(moves) -> None:
    assert moves("L C+350 F500\nM126\nL C+10\nM127\nL C+350")[-2:][0][5] == pytest.approx(370)


def test_call_of_a_program_beside(moves, write) -> None:
    write("0 BEGIN PGM SUB MM\n1 L IX+Q5 F500\n2 QL1 = 3\n3 END PGM SUB MM\n", "SUB.H")
    assert [m[1] for m in moves("Q5=2\nCALL PGM SUB\nCALL PGM TNC:\\DIR\\SUB.H\nL X+9")] == [2, 4, 9]
    with pytest.raises(InputError, match=r"GONE.*not beside"):
        moves("CALL PGM GONE")


EXAMPLES = {
    "L": "L X+7", "LP": "CC X+0 Y+0\nLP PR+9 PA+8", "LN": "M128\nLN X+7 NX0 NY0 NZ1", "CC": "CC X+3 Y+3\nLP PA+90", "C": "CC X+2 Y+1\nC X+3 Y+1 DR+", "CP": "CC X+2 Y+1\nCP IPA+9 DR+",
    "CR": "CR X+3 Y+1 R+5 DR+", "CT": "CT X+5 Y+9", "CTP": "CC X+5 Y+9\nCTP PR+3 PA+3", "RND": "L X+9\nRND R1\nL Y+9", "CHF": "L X+9\nCHF 1\nL Y+9",
    "APPR LT": "APPR LT X+9 Y+9 LEN3 RL\nL X+20", "APPR LN": "APPR LN X+9 Y+9 LEN3 RL\nL X+20", "APPR CT": "APPR CT X+9 Y+9 CCA90 R+9 RL\nL X+20", "APPR LCT": "APPR LCT X+9 Y+9 R+7 RL\nL X+20",
    "DEP LT": "DEP LT LEN3", "DEP LN": "L X+20 Y+0 RL\nL X+30\nDEP LN LEN3", "DEP CT": "L X+20 Y+0 RL\nL X+30\nDEP CT CCA90 R+9", "DEP LCT": "L X+20 Y+0 RL\nL X+30\nDEP LCT X+50 Y+50 R+9",
    "TOOL CALL": "TOOL CALL 1 Z S500", "TOOL DEF": "TOOL DEF 1 L+0 R+3\nL X+20 RL\nL X+30\nL Y+30", "FUNCTION TCPM": "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS\nL Z+200", "FUNCTION RESET": "M128\nFUNCTION RESET TCPM\nL Z+200 C+9",
    "PLANE SPATIAL": "PLANE SPATIAL SPA+20 SPB+0 SPC+0 STAY", "PLANE RESET": "PLANE RESET STAY\nL X+3", "CYCL DEF 7": "CYCL DEF 7.0\nCYCL DEF 7.1 X+4\nL X+3", "CYCL DEF 8": "CYCL DEF 8.0\nCYCL DEF 8.1 X\nL X+3",
    "CYCL DEF 10": "CYCL DEF 10.0\nCYCL DEF 10.1 ROT+9\nL X+3", "CYCL DEF 11": "CYCL DEF 11.0\nCYCL DEF 11.1 SCL 3\nL X+3", "CYCL DEF 19": "CYCL DEF 19.0\nCYCL DEF 19.1 A+9", "CYCL DEF 26": "CYCL DEF 26.0\nCYCL DEF 26.1 X3\nL X+3",
    "CYCL DEF 247": "CYCL DEF 247 Q339=2\nL X+3", "TRANS DATUM": "TRANS DATUM AXIS X+9\nL X+3", "CYCL DEF 9": "CYCL DEF 9.0\nCYCL DEF 9.1 2", "CYCL DEF 32": "CYCL DEF 32.0\nCYCL DEF 32.1 T0.3", "CYCL CALL": "CYCL CALL",
    "LBL": "LBL 1\nL IX+1\nCALL LBL 1 REP 2", "CALL LBL": "CALL LBL 1\nM30\nLBL 1\nL X+4\nLBL 0", "CALL PGM": "CALL PGM X", "FN": "FN 0: Q1=3\nL X+Q1", "Q": "Q1=3\nL X+Q1", "QL": "QL1=3\nL X+QL1", "QR": "QR1=3\nL X+QR1",
    "STOP": "STOP", "BEGIN PGM": "BEGIN PGM B INCH\nL X+1", "END PGM": "END PGM A MM\nL X+99", "M": "M99",
    **{f"CYCL DEF {n}": DRILL.format(n, "~\n Q239=1 ~\n Q214=1 ~\n Q334=3 ~\n Q335=50 ~\n Q256=0 ~\n Q257=3 ~\n Q249=1 ~\n Q250=5 ~\n Q251=1 ~\n Q252=1 ~\n Q253=9 ~\n Q254=9") + "CYCL CALL" for n in range(200, 210)},
}  # fmt: skip


def test_every_word_of_the_table_acts_or_is_noted_or_is_refused(write, equipped) -> None:
    """Behind a first line: a word that acts changes the moves or says what it lacks; a noted one is noted; a refused one names itself."""

    def meaning(text: str) -> tuple[str, set[str]]:
        out = understand(write(f"BEGIN PGM A MM\nTOOL CALL 1 Z S900\nL X+1 Y+1 Z+5 F100\n{text}\nL Y+2\n", "a.h"), equipped)
        return str(
            (
                out.kinds,
                out.targets,
                out.feeds,
                out.pauses,
                out.stops,
                [str(out.all_modes[k]) for k in out.mode_of],
                list(out.arcs.values()),
            )
        ), set(out.notes)

    without, notes = meaning("")
    wrong = []
    for word, (kind, *_) in KLARTEXT.items():
        try:
            now, said = meaning(EXAMPLES.get(word, f"{word} 1"))
            result = ACTS if now != without else NOTE if said - notes else "silent"
        except InputError as error:
            result = (
                REFUSED
                if word in str(error) and ("is not supported" in str(error))
                else ACTS
                if word in ("CYCL CALL", "CALL PGM", "M")
                else str(error)
            )
        if result != kind and not (word == "PLANE RESET" and result == ACTS):
            wrong.append((word, kind, result))
    assert not wrong, wrong
    for number in range(160):
        kind = KLARTEXT_M.get(number, (NOTE, ""))[0]
        try:
            said = meaning(f"L X+7 M{number}" + (" MB 3" if number == 140 else ""))[1]
            result = NOTE if any(note.startswith((f"M{number}:", "TOOL CALL")) for note in said) else ACTS
        except InputError:
            result = ACTS if number in (89, 99, 136) else REFUSED
        assert result == kind or (kind, result) == (ACTS, NOTE), (number, kind, result)


@pytest.mark.parametrize(
    "block",
    ["FL PR+10", "XYZZY 5", "CYCL DEF 251 POCKET", "L X+5 K+3", "PLANE EULER EULPR0", "X+10 R+ F100", "FN 18: Q1 = SYSREAD ID1", "FN 14: ERROR=1", "TCH PROBE 413", "L X+1 X+2", "RND R5", "C X+5 Y+5",
     "CYCL DEF 7.0\nCYCL DEF 7.1 #3", "TOOL CALL 1 Z K5", "FUNCTION TCPM F CONT AXIS POS", "L X+Q77", "CALL LBL 9", "M116", "L X+5 LEN3", "CC X+1 Y+1\nCP IPA+9 DR-", "CYCL DEF 10.0\nCYCL DEF 10.1 ROT+9\nCYCL DEF 7.0\nCYCL DEF 7.1 X+3"],
)  # fmt: skip
def test_what_is_not_read_is_refused_by_name(moves, block: str) -> None:
    with pytest.raises(InputError) as error:
        moves(f"L X+1 F100\n{block}\nL X+5 Y+9")
    assert "\n" not in str(error.value)
    assert "line 4" in str(error.value) or "line 5" in str(error.value) or "line 6" in str(error.value) or "line 7" in str(error.value)


BESIDE = [
    "L X+5", "L X+5 F300", "L X+5 FMAX", "L X+5 R0 M3", "LP PR+5 PA+10", "C X+3 Y+1 DR+", "CP IPA+9 DR+", "CR X+3 Y+1 R+5 DR+", "CT X+5 Y+9", "CTP PR+3 PA+3", "CC X+2 Y+1", "L M91 X+3", "M8", "STOP",
    "TOOL CALL 1 Z S500", "TOOL DEF 1 L+3", "CYCL CALL", "CYCL CALL POS X+3 Y+3", "DEP LT LEN3", "CYCL DEF 7.0\nCYCL DEF 7.1 X+4", "CYCL DEF 8.0\nCYCL DEF 8.1 X",
    "CYCL DEF 10.0\nCYCL DEF 10.1 ROT+9", "CYCL DEF 11.0\nCYCL DEF 11.1 SCL 2", "CYCL DEF 19.0\nCYCL DEF 19.1 A+9", "CYCL DEF 26.0\nCYCL DEF 26.1 X2", "CYCL DEF 9.0\nCYCL DEF 9.1 2", "CYCL DEF 32.0\nCYCL DEF 32.1 T0.3",
    "PLANE SPATIAL SPA+20 SPB+0 SPC+0 STAY", "PLANE RESET STAY", "FUNCTION TCPM F TCP AXIS POS PATHCTRL AXIS", "TRANS DATUM AXIS X+9", "Q1 = 3", "FN 1: Q1=+1+2", "CALL LBL 9", "CYCL DEF 200 Q200=3",
]  # fmt: skip


@pytest.mark.parametrize("block", BESIDE)
def test_no_word_beside_a_block_is_ignored(write, equipped, block: str) -> None:
    """Each word added at the end of a block: the meaning is another one, or a note or an error names it."""
    head = (
        "BEGIN PGM A MM\nTOOL DEF 1 L+100 R+2\nTOOL CALL 1 Z S900\n"
        + DRILL.format(200, "").replace("Q200=2", "Q200=2.5")
        + "CC X+2 Y+1\nL X-9 Y+1 Z+50 F100\nL X+1\n"
    )
    tail = "L X+50 Y+20 R0\nL X+60 Z+51 C+3\nCC IX+1 Y+5\nLP PR+3 PA+5\nL X+Q1 M99\nM30\nLBL 9\nL IX+1\nLBL 0\nEND PGM A MM\n"

    def meaning(text: str) -> tuple[str, set[str]] | None:
        try:
            out = understand(write(f"{head}{text}\n{tail}", "a.h"), equipped)
        except InputError:
            return None
        return str(
            (
                out.kinds,
                out.targets,
                out.feeds,
                out.pauses,
                out.stops,
                [str(out.all_modes[k]) for k in out.mode_of],
                list(out.arcs.values()),
            )
        ), set(out.notes)

    head = head.replace("CC X+2", "Q1 = 7\nCC X+2", 1)
    without = meaning(block)
    assert without is not None, block
    silent = []
    for word in (
        "X+7",
        "IY+2",
        "Z+3",
        "C+9",
        "PR+4",
        "IPA+5",
        "R+4",
        "RL",
        "RR",
        "DR+",
        "DR-",
        "F77",
        "FMAX",
        "F AUTO",
        "M5",
        "M128",
        "M136",
        "M89",
        "LEN4",
        "CCA9",
        "K+3",
        "Q5",
        "SPA+5",
        "TX+1",
        "NX+1",
        "17",
        "MB 4",
        "SCL 3",
        "T0.2",
        "*",
        "XYZ",
    ):
        now = meaning(f"{block} {word}")
        if word not in block and now is not None and now[0] == without[0] and now[1] <= without[1]:
            silent.append(word)
    later = (
        {"F77", "FMAX", "F AUTO", "MB 4"} if "PLANE" in block or "19.1" in block else {"R+4"} if "DEF 1" in block else set()
    )  # how it turns; a radius for RL
    assert set(silent) <= later


def test_klartext_in_a_folder_is_seen(tmp_path: Path, mikron) -> None:
    (tmp_path / "part.h").write_text("0 BEGIN PGM A MM\n" + "QL1 = 1\n" * 9 + "1 L X+10 F500\n2 L X+20\n3 END PGM A MM\n")
    (tmp_path / "header.h").write_text("#include <stdio.h>\nint main(void);\n")
    assert [p.name for p in check_folder.programs_in(tmp_path)] == ["part.h"]
    assert check_folder.check_program(tmp_path / "part.h", mikron).verdict == "ok"


def test_mutated_klartext(mikron, tmp_path) -> None:
    rng = random.Random(3)
    results = {
        fuzz_programs.check("part.h", fuzz_programs.mutate(fuzz_programs.SAMPLES["part.h"], rng), mikron, tmp_path) for _ in range(40)
    }
    assert {"refused", "read and re-read"} <= results


def test_the_example_of_a_plate(mikron) -> None:
    """`plate.h`: the tool stays 5 mm outside the outline of 100 mm by 60 mm, and the holes end 12 mm deep."""
    found = check_folder.check_program(ROOT / "examples" / "plate.h", mikron)
    assert found.verdict == "ok", found.reason
    program = read_program(ROOT / "examples" / "plate.h", mikron)
    ends = program.moves.target[~program.moves.traori, :3] * 1e3
    cut = ends[np.abs(ends[:, 2] - 95.0) < 1e-9]
    assert cut[1:-1, 0].max() == pytest.approx(55.0)
    assert (cut[:, 1].min(), cut[:, 1].max()) == pytest.approx((-35.0, 35.0))
    assert ends[(program.moves.kind[~program.moves.traori] == LINE), 2].min() == pytest.approx(88.0)
