"""Mutated part programs: each is refused in one line, or its normalised print is read with the same meaning.

scripts/fuzz --only program --cases 100000 --seed 0
"""

from __future__ import annotations

import math
from pathlib import Path
import random
import time

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program import flow
from twin.program import moves as mv
from twin.program.build import Collector
from twin.program.read import understand

FEWER_JUMPS = 300
"""Limit on jumps while fuzzing. The samples need 20; reaching the limit of the reader takes seconds."""
SLOWEST = 60.0
"""Processor time for reading one program [s]. The limits on blocks and jumps end every loop sooner."""

SAMPLES = {
    "part.mpf": """%_N_PART_MPF
;$PATH=/_N_WKS_DIR/_N_X_WPD
N10 G17 G54 G64 G71 G90 G94 G40
DEF REAL DEPTH=-5, STEP[3]
DEF INT I
STEP[0]=1 STEP[1]=2
T1 D1 M6
S5000 M3 M8
TRANS Z1
AROT Z30
CYCLE832(0.01,_FINISH,1)
FOR I=1 TO 3
G0 X=I*10 Y0 Z10
G1 Z=DEPTH F500
INNER(I, 2.5)
ENDFOR
ROT
R1=0
WHILE R1<3
G91 G1 X1
R1=R1+STEP[0]
ENDWHILE
G90
LOOP
R1=R1+1
IF (R1>5) AND NOT (R1>9) GOTOF FIN
ENDLOOP
FIN:
MCALL CYCLE83(50,0,2,-25,,-5,,2,0.1,0.1,1,1)
G0 X10 Y10
HOLES2(0,0,20,0,60,6)
MCALL
CYCLE800()
G0 X0 Y0 Z20
G1 X10 Y0 RND=2 F1000
X10 Y20 CHF=1
X0 Y20
$TC_DP6[1,1]=5
G1 G41 X20 Y20
X40
Y40
X20
G40 X0 Y0
G111 X0 Y0
G1 AP=30 RP=20
CIP X0 Y40 I1=20 J1=30
G2 X0 Y0 CR=30
CASE (R1) OF 0 GOTOF LA 6 GOTOF LB DEFAULT GOTOF LB
LA: MSG("at A")
LB: G75 FP=1 X1=0 Z0
DEF FRAME FA, FB=CTRANS(X,5)
FA=CTRANS(X,1,Y,2):CROT(Z,30)
$P_PFRAME=FB:FA
G1 X1 Y1
$P_PFRAME=CTRANS()
CYCLE84(5,0,1,-2,,0,3,,20,0,100,100,3,2)
SUPA G0 Z100 D0
M30
%_N_INNER_SPF
PROC INNER(REAL NR, REAL SIZE) SAVE DISPLOF
G91 G1 X=SIZE
X=-SIZE
G90
RET
""",
    "part.nc": """%
O1234 (PART)
N10 G21 G17 G40 G49 G80 G90
T1 M6
G54 G0 X0 Y0 S3000 M3
G43 H1 Z50. M8
G98 G81 X10. Y10. Z-5. R2. F200.
X20.
G80 G0 Z50.
#100=3
WHILE [#100 GT 0] DO1
G1 X[#100*2.] Y#100 F500.
#100=#100-1
END1
IF [#100 EQ 0] GOTO 100
G1 X99.
N100 G68 X0 Y0 R45.
G1 X10. Y0.
G69
G0 X10. Y0.
G2 X20. Y0 I5.
M98 P2000 L2
G65 P3000 A1. B2.
G91 G28 Z0.
G90 G52 X5.
G1 X1.
G52 X0
G16 G1 X20. Y30.
G15
G04 P500
G10 L2 P1 X0. Y0. Z0.
G51.1 X5.
G51 X0 Y0 Z0 P2.
G1 X7. Y1.
G50
G50.1 X0
G28 X3. Y
G29 X1. Y2.
G87 X1. Y1. Z-5. R-9. Q1.
G80
#4=1 GOTO[#4+109]
G1 X88.
N110 G101 Y0
Y3.
G100
G10 P7 R0.5
G41 D7 X9. Y9.
X20.
G40 X30.
M30
O2000
G91 G1 X1.
G90
M99
O3000
G1 X#1 Y#2
M99
%
""",
    "part.ngc": """g21 g90 g17
#<deep> = 3
o<cut> sub
g1 x#1 y[#2 * 2] f100
o10 if [#1 gt 3]
g3 x0 y0 r20
o10 elseif [#1 eq 2]
g1 z-1
o10 else
g1 z1
o10 endif
o<cut> endsub [#1 + 1]
g0 z5
o100 while [#<deep> gt 0]
o<cut> call [#<deep>] [2.5]
#<deep> = [#<deep> - 1]
o100 endwhile
g41.1 d4
g1 x20 y0
x40
y40
x20
g40 g1 x0
g10 l2 p2 x1 r30
g55 g0 x0 y0
g92 x1
g1 x5
g92.1
s100 g33.1 z-3 k0.5
g1 z1
(debug, deep #<deep>)
m2
""",
    "part.h": """0 BEGIN PGM PART MM
1 BLK FORM 0.1 Z X+0 Y+0 Z-20
2 BLK FORM 0.2 X+100 Y+100 Z+0
3 TOOL DEF 5 L+0 R+3
4 TOOL CALL 5 Z S3000 F500
5 L X-20 Y-20 Z+10 R0 FMAX M3
6 CYCL DEF 7.0 DATUM
7 CYCL DEF 7.1 X+5
8 CYCL DEF 7.2 IY+2
9 CYCL DEF 10.0 ROT
10 CYCL DEF 10.1 ROT+30
11 Q1 = 2 * SIN 30 + SQRT 16
12 LBL 1
13 L X+Q1 IY+2 F AUTO
14 FN 1: Q1=+Q1 + +2
15 FN 12: IF +Q1 LT +10 GOTO LBL 1
16 CYCL DEF 10.0 ROT
17 CYCL DEF 10.1 ROT+0
18 L X+20 Y+0
19 RND R2
20 L X+20 Y+20
21 CC X+10 Y+20
22 C X+0 Y+20 DR+
23 CP IPA+90 DR+
24 CR X+20 Y+20 R+12 DR-
25 CT X+30 Y+10
26 LP PR+25 PA+45
27 APPR LCT X+40 Y+0 R8 RL F300
28 L X+60 Y+0
29 L X+60 Y+20
30 DEP CT CCA90 R+6
31 L Z+30 R0 FMAX
32 CYCL DEF 200 DRILLING ~
   Q200=2 ;CLEARANCE ~
   Q201=-6 ;DEPTH ~
   Q206=150 ;FEED ~
   Q202=4 ;STEP ~
   Q210=0 ~
   Q203=+0 ;SURFACE ~
   Q204=10 ~
   Q211=0.2
33 L X+5 Y+5 FMAX M99
34 CALL LBL 2
35 LBL 3
36 L IX+3 F200
37 CALL LBL 3 REP 2
38 CYCL DEF 9.0 DWELL
39 CYCL DEF 9.1 0.5
40 CYCL DEF 8.0 MIRROR
41 CYCL DEF 8.1 X
42 L X+8 Y+3
43 M30
44 LBL 2
45 L IY+4 F300
46 LBL 0
47 END PGM PART MM
""",
    "part.apt": """PARTNO/PART
$$ comment
UNITS/MM
LOADTL/1,ADJUST,1
SPINDL/2000,RPM,CLW
FROM/0,0,150
RAPID
GOTO/10,0,150,0.1,-0.1,1
FEDRAT/500,MMPM
GOTO/20,$
0,150
TLAXIS/0,0,1
CIRCLE/20,10,150,0,0,1,10
GOTO/30,10,150
MOVARC/20,10,150,0,0,1,10,ANGLE,90
GOTO/20,20,150
INDIRV/1,0,0
TLON,GOFWD/(CIRCLE/20,30,150,10),ON,(LINE/20,30,150,40,30,150)
FEDRAT/0.1,MMPR
GODLTA/0,0,5
MSYS/1,2,0,1,0,0,0,1,0
GOTO/5,5,150
TRNTYP/WORLD,0,0,0
CYCLE/DRILL,RAPTO,3,FEDTO,-10,MMPM,200,RTRCTO,20
GOTO/10,0,150
CYCLE/OFF
DELAY/2,REV
ORIGIN/0,0,0
COOLNT/ON
CUTCOM/LEFT
FINI
""",
}


def normalised(out: Collector) -> str | None:
    """The program as plain G-code, or None if that cannot express it (tool axes, transformations, arcs in space)."""
    lines, feed = ["G90 G94 G64 G710"], None
    here = np.array([*out.position[:3]]) * 0.0
    plane = 17
    for row, (kind, target) in enumerate(zip(out.kinds, out.targets)):
        mode = out.all_modes[out.mode_of[row]]
        if (
            out.tool_axes[row] is not None
            or mode.traori
            or mode.feed_mode != 94
            or not all(abs(v) < 1e6 for v in target if not math.isnan(v))
        ):
            return None
        end = np.array(target[:3])
        words = "".join(f" {n}={v * 1e3:.15f}" for n, v in zip("XYZ", map(float, end)))
        words += "".join(f" {n}={math.degrees(v):.15f}" for n, v in zip("AC", target[3:]) if not math.isnan(v))
        if kind == mv.DWELL:
            lines.append(f"G4 F{out.pauses[row]:.15f}")
            continue
        if kind != mv.RAPID:
            value = out.feeds[row] * mode.feed_unit * 1e3
            words += "" if value == feed else f" F={value:.15f}"
            feed = value
        if kind == mv.ARC:
            centre, normal, angle = out.arcs[row]
            axis = int(np.argmax(np.abs(normal)))
            if row == 0 or abs(abs(normal[axis]) - 1.0) > 1e-12:
                return None
            plane = {2: 17, 1: 18, 0: 19}[axis]
            turns = math.ceil(angle / (2.0 * math.pi) - 1e-9) - 1
            arm = centre - here
            a, b = [i for i in range(3) if i != axis]
            words += f" {'IJK'[a]}={arm[a] * 1e3:.15f} {'IJK'[b]}={arm[b] * 1e3:.15f}" + (f" TURN={turns}" if turns else "")
            lines.append(f"G{plane} G{2 if normal[axis] < 0 else 3}{words}")
        else:
            lines.append(f"G{kind}{words}")
        here = end
    return "\n".join([*lines, "M30", ""])


def mutate(text: str, rng: random.Random) -> str:
    """Change a few characters, words or lines."""
    for _ in range(rng.randint(1, 4)):
        at = rng.randrange(max(1, len(text)))
        what = rng.randrange(6)
        if what == 0:
            text = text[:at] + text[at + 1 :]
        elif what == 1:
            text = text[:at] + rng.choice('0123456789.-+=()[]#<>";:%/ GXYZFMRNPQLIJK\n') + text[at:]
        elif what == 2:
            lines = text.split("\n")
            i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
            text = "\n".join(lines)
        elif what == 3:
            lines = text.split("\n")
            lines.insert(rng.randrange(len(lines)), rng.choice(lines))
            text = "\n".join(lines)
        elif what == 4:
            lines = text.split("\n")
            lines.pop(rng.randrange(len(lines)))
            text = "\n".join(lines) or "\n"
        else:
            text = text[:at] + str(rng.choice([0, -1, 1e9, 99999, 0.001])) + text[at + 1 :]
    return text


def check(name: str, text: str, machine: Machine, folder: Path) -> str:
    """Read a program: 'refused', 'read' or 'read and re-read'. Raises AssertionError if its print has another meaning."""
    most, flow.MOST_JUMPS = flow.MOST_JUMPS, FEWER_JUMPS
    path = folder / name
    path.write_text(text)
    begin = time.process_time()
    try:
        out = understand(path, machine)
    except InputError as error:
        if "\n" in str(error):
            raise AssertionError(f"more than one line: {error}") from None
        return "refused"
    finally:
        flow.MOST_JUMPS = most
        assert time.process_time() - begin < SLOWEST, "too slow"
    plain = normalised(out)
    if plain is None or not out.kinds:
        return "read"
    again = folder / "again.mpf"
    again.write_text(plain)
    try:
        other = understand(again, machine)
    except InputError as error:
        if "close" in str(error) or "no feed" in str(error) or "feed" in str(error) or "out of range" in str(error):
            return "read"  # arcs within the wider ISO tolerance; feeds that are known only at the end of the program
        raise AssertionError(f"the normalised print is refused: {error}") from None
    assert other.kinds == out.kinds
    same = [np.allclose(a, b, rtol=0, atol=1e-9, equal_nan=True) for a, b in zip(out.targets, other.targets)]
    assert all(same), f"move {same.index(False)} has another meaning"
    for row, (_, normal, angle) in out.arcs.items():
        assert np.allclose(other.arcs[row][1], normal, atol=1e-6)
        assert abs(other.arcs[row][2] - angle) < 1e-5
    return "read and re-read"
