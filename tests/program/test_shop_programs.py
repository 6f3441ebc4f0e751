"""Programs as shops write them: what was read wrongly once, both languages, every word of the tables, mutated programs."""

from pathlib import Path
import random
import re

import numpy as np
import pytest

from devtools import fuzz_programs, words_table
from twin.errors import InputError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.program import flow, interpolate, read_program
from twin.program.apt_words import WORDS
from twin.program.iso import ISO_G, ISO_M, execute
from twin.program.iso_blocks import Iso
from twin.program.moves import ARC, LINE, RAPID
from twin.program.read import understand
from twin.program.sinumerik import SINUMERIK_G, SINUMERIK_NAMES, carry_out
from twin.program.sinumerik_blocks import Sinumerik
from twin.program.state import ACTS, NOTE, REFUSED

LINUXCNC = Path(__file__).resolve().parents[3] / "shared" / "data" / "linuxcnc" / "interp"


@pytest.fixture
def read(mikron, write):
    return lambda text, name="part.mpf": read_program(write(text, name), mikron)


def ends(program) -> np.ndarray:
    return np.round(program.moves.target[:, :3] * 1e3, 6)


def test_p_of_an_arc_is_its_turns(read) -> None:
    program = read("G21 G17 G1 X0 Y0 F100\nG2 X10 I5 P2\nG1 X20\n", "part.ngc")
    assert program.moves.angle[program.moves.kind == ARC] == pytest.approx([3.0 * np.pi])
    assert set(program.moves.tolerance) == {10e-6}  # P is not that of G64


@pytest.mark.parametrize(
    ("name", "block"),
    [
        ("part.ngc", "G1 X10 P3 F1"),
        ("part.ngc", "G1 X1 X2 F1"),
        ("part.mpf", "G1 X1 X2 F1"),
        ("part.mpf", "G1 X1 CTOLL=1 F1"),
        ("part.nc", "G1 X1 L3 F1"),
    ],
)
def test_a_word_that_nothing_uses_is_refused(read, name: str, block: str) -> None:
    with pytest.raises(InputError, match=r"no use|twice|not known"):
        read(f"G1 X5 F100\n{block}\n", name)


def test_the_machine_file_gives_variables_and_calls_without_motion(mikron, write) -> None:
    """[variables] and [program] pass through the loader, and another key there is refused."""
    plain, own = write("", "own.toml"), write("G1 F100 X=$MC_EXAMPLE\nTOOLCHECK\nX3\n")
    write_machine(mikron, plain)
    tables = '\n[variables]\n"$MC_EXAMPLE" = 2.0\n[program]\ncalls_without_motion = ["TOOLCHECK"]\n'
    text = plain.read_text()
    plain.write_text(text + tables)
    machine = load_machine(plain)
    assert ends(read_program(own, machine))[:, 0].tolist() == [2, 3]
    write_machine(machine, plain)  # nothing is lost on the way back
    assert load_machine(plain).document["program"] == {"calls_without_motion": ["TOOLCHECK"]}
    for wrong, message in (
        ("[program]\ncall_without_motion = ['A']", "did you mean 'calls_without_motion'"),
        ("[program]\ncalls_without_motion = 'TOOLCHECK'", "list of names"),
        ("[variables]\nR1 = [1, 2]", "number or a text"),
        ("variables = 3", "number or a text"),
    ):
        plain.write_text(wrong + "\n" + text if wrong[0] == "v" else text + "\n" + wrong + "\n")
        with pytest.raises(InputError, match=message):
            load_machine(plain)


def test_programmable_shifts_move_nothing(read) -> None:
    assert ends(read("G1 X1 F100\nG58 X10\nG1 X2\nG59 X1\nG1 X3\n"))[:, 0].tolist() == [1, 12, 14]


def test_a_dwell_counts_by_dialect(read) -> None:
    assert read("G1 X1 F100\nG4 P500\nG1 X2\n", "part.nc").moves.pause[1] == pytest.approx(0.5)
    assert read("G1 X1 F100\nG4 P5\nG1 X2\n", "part.ngc").moves.pause[1] == pytest.approx(5.0)
    with pytest.raises(InputError, match="G4 must be alone"):
        read("G1 X1 F100\nG4 P500\n")


def test_an_exact_reversal_within_a_wide_tolerance_stops(read, mikron) -> None:
    program = read("G642 CTOL=2\nG1 X10 F1000\nX0\nX10\n")
    assert program.moves.stop.all()
    assert interpolate(program, mikron) is not None


def test_a_negative_ctol_goes_back_to_the_default(read) -> None:
    assert set(read("CTOL=-1\nG642\nG1 X1 F100\n").moves.tolerance) == {10e-6}


def test_sinumerik_flow_frames_cycles_and_corners(write, mikron) -> None:
    out = understand(write(fuzz_programs.SAMPLES["part.mpf"]), mikron)
    assert sum(kind == ARC for kind in out.kinds) >= 3


def test_frames_follow_each_other(read) -> None:
    text = "TRANS X10\nAROT Z90\nG1 X1 Y0 F100\nAMIRROR X0\nX1 Y0\nROT\nX1 Y0\n"
    assert ends(read(text))[:, :2].tolist() == [[10, 1], [10, -1], [1, 0]]


def test_subprograms_come_from_the_folder_and_take_values(read, write) -> None:
    write("PROC HOLE(REAL U, INT N=2)\nG1 X=U Y=N F100\nM17\n", "HOLE.SPF")
    write("G91 G1 X1\nG90\nRET\n", "l100.spf")
    program = read('HOLE(5)\nL100 P3\nCALL "HOLE"\n')
    assert ends(program)[:, :2].tolist() == [[5, 2], [6, 2], [7, 2], [8, 2], [0, 2]]
    with pytest.raises(InputError, match=r"no subprogram GONE\.SPF"):
        read("GONE\n")


def test_cutter_radius(read) -> None:
    text = "$TC_DP6[1,1]=5\nT1 D1\nG1 F1000 X0 Y0\nG42 X20 Y0\nX60\nY40\nX20\nG40 X0\nM30\n"
    program = read(text)
    assert (program.moves.kind == ARC).sum() == 2  # round the outside corners
    assert ends(program)[:, :2].min() == -5.0
    inside = read(text.replace("G42", "G41").replace("X0\nM30", "X0 Y60\nM30"))
    assert [55.0, 35.0] in ends(inside)[:, :2].tolist()


@pytest.mark.parametrize("unit", ["G20", "G21"])
def test_the_radius_of_the_tool_table_is_a_length_whatever_the_unit_of_the_program(mikron, write, unit: str) -> None:
    """[tool] radius_m is SI: a tool of 1/16 inch moves an inch program and the same program in mm by 1/32 inch."""
    tool = mikron.with_values({"tool": {"T1": {"length_m": 0.1, "radius_m": 25.4e-3 / 32}}})
    scale = 1.0 if unit == "G20" else 25.4
    text = f"{unit} G17 G90 T1 M6\nG1 X0 Y0 F{10 * scale}\nG42 D1 X{scale} Y0\nX{2 * scale}\nX{3 * scale}\nG40 X{4 * scale}\nM30\n"
    program = read_program(write(text, "part.ngc"), tool)
    assert ends(program)[-3:, :2] == pytest.approx(np.array([[50.8, -25.4 / 32], [76.2, -25.4 / 32], [101.6, 0.0]]), abs=1e-5)


ROUNDED = "G21 G17 G90\nG1 X0 Y0 F100\nG42.1 D4 X10 Y0\nG3 X20 Y10.{} I0 J10\nG2 X30.0005 Y20 I10.0005 J{}\nG1 X40\nG40 X50 Y30\nM30\n"


def test_an_inside_corner_made_by_rounding_is_a_tangent(read) -> None:
    """Two arcs meant to be tangent, a few 0.1 um beside it: the moved circles meet only beyond their ends."""
    program = read(ROUNDED.format("0015", "-0.0015"), "part.ngc")
    path = ends(program)[:, :2]
    nearest_to_join = np.hypot(*(path - [22.0, 10.0]).T).min()
    assert nearest_to_join < 5e-3  # 2 mm to the right of the contour


@pytest.mark.parametrize(("rise", "arcs"), [(2e-4, 0), (0.2, 1)])
def test_an_outside_corner_made_by_rounding_gets_no_arc(read, rise: float, arcs: int) -> None:
    """Two lines meant to be one: 2e-5 rad at a radius of 5 mm make an arc of 0.1 um, which no axis follows; 0.02 rad make one of 0.1 mm."""
    program = read(f"G21 G17 G90\nG1 X0 Y0 F100\nG42.1 D10 X10 Y0\nX20\nX30 Y{rise}\nG40 X40 Y1\nM30\n", "part.ngc")
    assert (program.moves.kind == ARC).sum() == arcs


@pytest.mark.parametrize("beside", [0.0, 1e-4, -1e-4])
def test_a_full_circle_remains_full_with_radius_compensation(read, beside: float) -> None:
    """Inside a bore of 40 mm with a tool of 10 mm: entry on an arc, once round, out; also where the join is not quite tangent."""
    text = "G21 G17 G90\nG0 X0 Y-10\nF100\nG41.1 D10 G1 X10\nG3 X20 Y0 I0 J10\nG3 I-20 J{:.4f}\nG3 X10 Y10 I-10 J0\nG40\nG1 X0 Y0\nM30\n"
    program = read(text.format(beside), "part.ngc")
    whole = np.flatnonzero((program.moves.kind == ARC) & (np.abs(program.moves.angle - 2 * np.pi) < 1e-3))
    assert len(whole) == 1
    assert ends(program)[whole[0], :2] == pytest.approx([15.0, 0.0], abs=2e-3)
    assert program.moves.angle[program.moves.kind == ARC].sum() == pytest.approx(3 * np.pi, abs=1e-3)


def test_an_arc_that_leads_almost_straight_back_is_rounded(read) -> None:
    """The arc begins 0.02 rad beside the line and crosses it; a line back at that angle is a gouge."""
    text = "G21 G17 G90\nG1 X0 Y0 F100\nG42.1 D0.5 X10 Y0\nX20\n{}\nG40\nG1 Y20\nM30\n"
    sine, cosine = 3.0 * np.sin(0.02), 3.0 * np.cos(0.02)
    program = read(text.format(f"G2 X{20 - 2 * sine:.6f} Y{2 * cosine:.6f} I{-sine:.6f} J{cosine:.6f}"), "part.ngc")
    begins, goes_on = ends(program)[np.flatnonzero(program.moves.kind == ARC)[0] + np.array([-1, 0]), :2]
    assert begins == pytest.approx([20.0, -0.25])
    assert goes_on == pytest.approx([20.0 - 0.25 * np.sin(0.02), 0.25 * np.cos(0.02)], abs=1e-5)
    with pytest.raises(InputError, match="inside corner"):
        read(text.format(f"X{20 - cosine:.6f} Y{-sine:.6f}"), "part.ngc")


def test_an_arc_that_leads_back_inside_another_makes_a_cusp(read) -> None:
    """Half a circle of 20 mm, back from its end on one of 10 mm inside it: a tool inside stops short of the cusp, one outside rounds it."""
    text = "G21 G17 G90\nG1 X0 Y-20 F100\nG{}.1 D1 X10\nG3 X10 Y20 J20\nG2 X10 Y0 J-10\nG1 X0\nG40\nG1 X-10\nM30\n"
    program = read(text.format(41), "part.ngc")
    meet = ends(program)[program.moves.kind == ARC][0, :2]  # 19.5 mm from the one centre, 10.5 mm from the other
    assert [np.hypot(*(meet - [10, 0])), np.hypot(*(meet - [10, 10]))] == pytest.approx([19.5, 10.5])
    open_by_10_um = text.replace("Y20 J20", "Y19.99 J20").replace("J-10", "J-9.995").format(41)
    program = read(open_by_10_um, "part.ngc")  # the radius at the corner counts, which is that of the end
    assert np.hypot(*(ends(program)[program.moves.kind == ARC][0, :2] - [10, 0])) == pytest.approx(19.49)
    assert (read(text.format(42), "part.ngc").moves.kind == ARC).sum() > (program.moves.kind == ARC).sum()


@pytest.mark.parametrize("before", ["G1 X-10 Y10\nX0 Y0", "G1 X-10 Y4.142136\nG2 X0 Y0 J-14.142136"])
def test_behind_an_inside_corner_an_arc_is_cut_on_the_circle_through_its_end(read, before: str) -> None:
    """As LinuxCNC cuts it: the start lies 9.99 mm from the centre and the end 10 mm, the tool of 2 mm begins and ends 9 mm from it."""
    program = read(f"G21 G17 G90\nG1 X-20 Y10 F100\nG41.1 D2 {before}\nG3 X10 Y9.99 J9.99\nG1 Y20\nG40\nG1 X0\nM30\n", "part.ngc")
    last = np.flatnonzero(program.moves.kind == ARC)[-1]
    begins, ended = ends(program)[[last - 1, last], :2]
    assert [np.hypot(*(begins - [0, 9.99])), np.hypot(*(ended - [0, 9.99]))] == pytest.approx([9.0, 9.0], abs=2e-6)


def test_an_inside_corner_that_the_tool_cannot_reach_stays_an_error(read) -> None:
    text = "G21 G17 G90\nG1 X0 Y0 F100\nG41.1 D8 X10 Y0\nX20\nY{}\nX40\nG40 X50\nM30\n"
    assert len(read(text.format(20), "part.ngc").moves.kind)
    with pytest.raises(InputError, match="inside corner"):
        read(text.format(2), "part.ngc")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("part.mpf", "G1 X1 F100\nLABEL:\nX1 Y=R1\nX2\nR1=R1+1\nX3\nGOTOB LABEL\nM30\n"),
        ("part.mpf", "G1 X1 F100\nWHILE R1<1\nX=R2\nR2=R2+1\nENDWHILE\nM30\n"),
        ("part.nc", "G21\nG1 X1 F100\nWHILE [1 EQ 1] DO1\n#1=[#1+1]\nX#1\nEND1\nM30\n"),
        ("part.ngc", "G21\nG1 X1 F100\n#2=0\no1 do\n#1=[#1+1]\nX#1\no1 while [#2 EQ 0]\nM2\n"),
    ],
)
def test_an_endless_loop_is_refused(read, monkeypatch, name: str, text: str) -> None:
    monkeypatch.setattr(flow, "MOST_JUMPS", 1000)
    with pytest.raises(InputError, match="more than 1000 jumps have run; the loop with this jump does not end"):
        read(text, name)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("part.mpf", "G1 X1 F100\nWHILE R1<12000\nR1=R1+1\nENDWHILE\nX2\nM30\n"),
        ("part.mpf", "G1 X1 F100\nFOR R1=1 TO 12000\nENDFOR\nX2\nM30\n"),
        ("part.mpf", "G1 X1 F100\nLABEL:\nR1=R1+1\nCASE R1 OF 12000 GOTOF OUT DEFAULT GOTOB LABEL\nOUT:\nX2\nM30\n"),
        ("part.ngc", "G21\nG1 X1 F100\no1 repeat [12000]\no1 endrepeat\nX2\nM2\n"),
        (
            "part.ngc",
            "G21\nG1 X1 F100\no1 while [#1 LT 3]\n#2=0\no2 while [#2 LT 4000]\n#2=[#2+1]\no2 endwhile\n#1=[#1+1]\no1 endwhile\nX2\nM2\n",
        ),
    ],
)
def test_a_long_loop_is_not_refused_as_endless(read, name: str, text: str) -> None:
    assert ends(read(text, name))[-1, 0] == 2


def test_drilling_cycles(read) -> None:
    program = read("G0 X0 Y0 Z20\nF100\nMCALL CYCLE81(10,0,2,-12)\nX5\nX10\nMCALL\nX0\n")
    assert ends(program)[:, [0, 2]].tolist() == [[5, 20], [5, 2], [5, -12], [5, 10], [10, 10], [10, 2], [10, -12], [10, 10], [0, 10]]
    iso = read("G0 X0 Y0 Z20\nG99 G83 X5 Z-4 R2 Q3 F100\nG80\n", "part.nc")
    assert ends(iso)[:, 2].tolist() == [20, 2, -1, 2, -0.746, -4, 2]


def fingerprint(out, front) -> tuple:
    """What a word can change."""
    names = [
        "motion",
        "plane",
        "absolute",
        "centre_absolute",
        "unit",
        "feed",
        "offset",
        "comp",
        "cycle",
        "retract_to_start",
        "polar",
        "system",
        "local",
        "shift",
        "shift_on",
        "reference",
        "modal_macro",
        "chosen",
        "pole",
        "angles_are_rpy",
        "corners_meet",
        "modal",
        "frames",
    ]
    parts = [front, *(part for part in vars(front).values() if type(part).__module__.startswith("twin.program"))]
    return (
        len(out.kinds),
        out.modes,
        tuple(out.stops),
        front.flow.ended,
        *(str(next((getattr(p, n) for p in parts if hasattr(p, n)), "")) for n in names),
    )


CONTEXT = {4: "P1", 10: "L2 P1 X1", 28: "X1", 30: "X1", 52: "X1", 92: "X1", 68: "X0 Y0 R9", 68.2: "X0 Y0 Z0 I0 J0 K0", 51: "P2", 51.1: "X0", 54.1: "P3",
           73: "Z-1 R1 Q1", 83: "Z-1 R1 Q1", 41: "D1", 42: "D1", 41.1: "D1", 42.1: "D1", 53: "X1", 65: "P9", 66: "P9", 2: "X1 I5", 3: "X1 I5",
           9: "X3", 64: "P1", 16: "X3", 27: "X3", 29: "X3", 87: "R-1 Z1", 10.9: "X0", 101: "X0", 100: "X0"}  # fmt: skip


def test_every_word_of_the_iso_table_acts_or_is_noted_or_is_refused(write, mikron) -> None:
    """Run behind two different states: a word that acts changes one of them, or says what it lacks."""
    states = (
        "G0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\n",
        "G20 G18 G91 G93 G99 G90.1 G61 G16 G55 G52 X1\nG92 X3\nG51 P2\nG17 G90 G20\nG1 X1 F1\nG81 Z-1 R1 F1\nG19 G91 G42.1 D1\n",
    )
    from twin.program.source import ProgramText, units_of

    def run(text: str) -> tuple:
        path = write(text, "part.nc")
        front = Iso(path, mikron, units_of(ProgramText(path))[0], execute, linuxcnc=False)
        front.flow.run()
        return fingerprint(front.out, front), tuple(front.out.notes)

    silent = []
    for number, (kind, *_) in ISO_G.items():
        word = f"G{number:g} " + CONTEXT.get(number, "Z-1 R1" if 73 < number < 90 and number != 80 else "")
        outcomes = []
        for state in states:
            try:
                before, notes = run(state)
            except Exception:
                continue
            try:
                after, now = run(state + word + "\n")
            except Exception as error:
                outcomes.append("unknown" if "is not known; remove" in str(error) else "refused")
                continue
            outcomes.append("acts" if before != after else "noted" if set(now) - set(notes) else "silent")
        wanted = {ACTS: {"acts", "noted", "refused"}, NOTE: {"noted"}, REFUSED: {"refused"}}[kind]
        if not set(outcomes) & wanted and number not in (
            11,
            21,
            71,
            40,
            49,
            50,
            50.1,
            69,
            80,
            100,
            15,
            90,
            91.1,
            94,
            98,
            54,
            17,
            67,
            92.1,
            92.2,
            92.3,
            1,
        ):
            silent.append((word, outcomes))
    assert not silent, silent
    assert all(kind in (ACTS, NOTE, REFUSED) for kind, *_ in ISO_M.values())


NAMES_IN_CONTEXT = {
    "TRAORI": "TRAORI", "TRAFOOF": "TRAFOOF", "ORIWKS": "ORIWKS", "ORIMKS": "ORIMKS", "ORIVECT": "ORIVECT", "ORIPLANE": "ORIPLANE", "ORIAXES": "ORIAXES",
    "MSG": 'MSG("a")', "TRANS": "TRANS X1", "ATRANS": "ATRANS X1", "ROT": "ROT Z9", "AROT": "AROT Z9", "SCALE": "SCALE X2", "ASCALE": "ASCALE X2",
    "MIRROR": "MIRROR X0", "AMIRROR": "AMIRROR X0", "SUPA": "SUPA X3", "CYCLE832": "CYCLE832(0.3,1)", "CYCLE800": "CYCLE800(0,,0,57,0,0,0,9,0,0,0,0,0)",
    "CYCLE81": "CYCLE81(5,0,1,-2)", "CYCLE82": "CYCLE82(5,0,1,-2)", "CYCLE83": "CYCLE83(5,0,1,-2,,-1)", "CYCLE84": "CYCLE84(5,0,1,-2,,0,,,1,,100)",
    "CYCLE840": "CYCLE840(5,0,1,-2)", "CYCLE85": "CYCLE85(5,0,1,-2,,0,9,9)", "CYCLE86": "CYCLE86(5,0,1,-2)", "CYCLE87": "CYCLE87(5,0,1,-2)", "CYCLE88": "CYCLE88(5,0,1,-2)",
    "CYCLE89": "CYCLE89(5,0,1,-2)",
    "HOLES1": "MCALL CYCLE81(5,0,1,-2)\nHOLES1(0,0,0,5,5,2)", "HOLES2": "MCALL CYCLE81(5,0,1,-2)\nHOLES2(0,0,5,0,90,2)",
    "CYCLE801": "MCALL CYCLE81(5,0,1,-2)\nCYCLE801(0,0,0,3,3,2,2)", "CYCLE802": "MCALL CYCLE81(5,0,1,-2)\nCYCLE802(1,1,3,4)",
    "MCALL": "MCALL CYCLE81(5,0,1,-2)\nX7", "CALL": 'CALL "SUB1"', "PCALL": 'PCALL "SUB1"', "EXTCALL": 'EXTCALL "SUB1"', "RET": "RET",
    "CIP": "CIP X5 Y5 I1=1 J1=3 K1=5", "CT": "CT X9 Y9", "CR": "G2 X5 Y5 CR=9", "AR": "G2 X5 Y5 AR=20", "TURN": "G2 X1 Y1 I3 TURN=1", "AP": "AP=3",
    "RP": "RP=3", "RPL": "ROT RPL=3", "ANG": "X9 ANG=3", "CHF": "X9 CHF=1\nY9", "CHR": "X9 CHR=1\nY9", "RND": "X9 RND=1\nY9", "RNDM": "X9 RNDM=1\nY9\nX0",
    "ADIS": "G641 ADIS=2", "ADISPOS": "G641 ADISPOS=2", "CTOL": "G642 CTOL=0.4", "OTOL": "G642 OTOL=3", "I1": "CIP X5 Y5 I1=1 J1=3 K1=5",
    "FP": "G75 FP=1 X1=0", "POS": "POS[X]=7", "POSA": "POSA[X]=7", "OVR": "OVR=50\nX7", "FB": "X7 FB=9", "A3": "TRAORI\nX5 A3=0.1 C3=1",
    "A2": "ORIRPY\nTRAORI\nX5 A2=2", "ORIEULER": "ORIEULER", "ORIRPY": "ORIRPY", "FFWON": "FFWON", "FFWOF": "FFWOF", "SOFT": "SOFT", "BRISK": "BRISK",
}  # fmt: skip


def test_every_word_of_sinumerik_that_acts_changes_something(write, mikron) -> None:
    """Names and G codes: behind one of two states each changes the motion or what later words mean, or it says what it lacks.

    RET, ENDPROC and G40 act on what follows: other tests hold them. MSG only speaks to the operator.
    """
    from twin.program.source import ProgramText, units_of

    states = (
        "G0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\nTRAFOOF\n",
        "G700 G18 G91 G93 G60 G602 G451 G55 X1 F1\nG90 TRANS X9\nFFWOF BRISK ORIMKS ORIEULER\nX2 Z3 F1\nG58 X3\nG111 X3\nTRAORI\n",
        "G41 X5 Y5 F100\nG91 X9\n",
    )

    def run(text: str) -> tuple:
        path = write(f"$TC_DP6[1,1]=1\nT1 D1\n{text}")
        write("G91 X1\nG90\nM17\n", "SUB1.SPF")
        front = Sinumerik(path, mikron, units_of(ProgramText(path)), SINUMERIK_NAMES, carry_out)
        front.run()
        return fingerprint(front.out, front), tuple(front.out.feeds), len(front.out.notes)

    context = {4: "F1", 25: "X1", 26: "X1", 331: "Z3 K1", 332: "Z3 K1", 63: "Z3", 41: "X9", 42: "X9", 53: "X3", 153: "X3", 58: "X5", 59: "X5", 74: "X1=0", 75: "X1=0",
               2: "X2 Z3 Y1 I3 K3 CR=5", 3: "X5 Y5 CR=9", 9: "X7", 110: "X4", 111: "X4", 112: "X4", 0: "X7", 1: "X7"}  # fmt: skip
    others = ("RET", "ENDPROC", "MSG")
    words = [NAMES_IN_CONTEXT.get(n, f"{n}=1") for n, (kind, *_) in SINUMERIK_NAMES.items() if kind == ACTS and n not in others]
    words += [f"G{n:g} {context.get(n, '')}" for n, (kind, *_) in SINUMERIK_G.items() if kind == ACTS and n != 40]
    before = [run(state) for state in states]
    silent = []
    for word in words:
        outcomes = []
        for state, was in zip(states, before):
            try:
                now = run(f"{state}{word}\n")
            except InputError as error:
                outcomes.append(str(error))
            except Exception as error:  # the readers' own faults, which `read` turns into an InputError
                outcomes.append("unknown" if "is not known; remove" in str(error) else "refused")
            else:
                outcomes.append("acts" if was != now else "silent")
        if not set(outcomes) - {"silent", "unknown"}:
            silent.append((word, outcomes))
    assert not silent, silent


def meaning(path: Path, machine: Machine) -> tuple[object, set[str]] | None:
    """All that a program means, and its notes; None where it is refused, also for its axes when it is finished."""
    try:
        out = understand(path, machine)
    except InputError:
        return None
    moves = (out.kinds, [list(map(float, t)) for t in out.targets], out.feeds, out.stops, out.arcs, out.tool_axes, out.pauses)
    return str((*moves, [str(out.all_modes[k]) for k in out.mode_of])), set(out.notes)


def ignored(with_word: tuple[object, set[str]] | None, without: tuple[object, set[str]] | None) -> bool:
    """Is a program with one more word accepted with the same meaning, and nothing said of the word?"""
    assert without is not None
    return with_word is not None and with_word[0] == without[0] and with_word[1] <= without[1]


HEAD, TAIL = "G0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\n", "X9 Y2\nX3 Y7\nG2 X5 Y9 I2 J0\n"


MODES_HERE = [
    "MSG",
    "SUPA",
    "CYCLE832",
    "CYCLE800",
    "MCALL",
    "ADIS",
    "ADISPOS",
    "B2",
    "B3",
    "B4",
    "B5",
    "ORIEULER",
    "ORIRPY",
    "ORIVIRT1",
    "ORIRPY2",
]
"""Names that change the meaning of later words only, end what is not on, say something to the operator, or are letters of an axis that the machine lacks."""


def test_no_name_beside_a_move_is_ignored(write, mikron) -> None:
    """Each name of the table, alone, with a value and as a call, in two states: the moves with it are others, or a note or an error names it."""
    words = [word for n, (kind, *_) in SINUMERIK_NAMES.items() if kind != REFUSED for word in (n, f"{n}=3", f"{n}(3)")]
    silent = set(words)
    for head in (HEAD, "G0 X0 Y0 Z200\nTRAORI\nORIMKS\nBRISK\nFFWOF\nG1 X1 Y1 F100 S100\n"):
        without = meaning(write(f"{head}X5 Y5\n{TAIL}"), mikron)
        silent &= {word for word in words if ignored(meaning(write(f"{head}X5 Y5 {word}\n{TAIL}"), mikron), without)}
    assert {re.split(r"[=(]", word)[0] for word in silent} <= set(MODES_HERE), silent


@pytest.mark.parametrize("name", ["SOFT", "BRISK", "FFWON", "ORIWKS", "ORIEULER", "TRAFOOF"])
@pytest.mark.parametrize("value", ["=3", "(3)"])
def test_a_value_that_a_mode_does_not_take_is_refused(read, name: str, value: str) -> None:
    with pytest.raises(InputError, match=rf"{name} takes no value"):
        read(f"G1 X1 F100\nX5 {name}{value}\n")


@pytest.mark.parametrize("word", ["RND=1", "CHF=1", "CHR=1", "RNDM=1"])
def test_a_corner_word_at_a_corner_is_never_thrown_away(write, mikron, word: str) -> None:
    for block in ("G1 X5 Y5", "G1 X5 Y1"):
        for following in ("X9 Y2", "Y9", "G2 X=IC(4) Y=IC(4) I4 J0", "G1 X5 Y9 Z5"):
            without, now = (meaning(write(f"{HEAD}{block} {w}\n{following}\n"), mikron) for w in ("", word))
            assert not ignored(now, without), (block, following)


@pytest.mark.parametrize("number", [73, 74, 76, 81, 82, 83, 84, 85, 86, 88, 89])
@pytest.mark.parametrize("name", ["part.nc", "part.ngc"])
def test_no_word_of_a_cycle_is_ignored(write, mikron, number: int, name: str) -> None:
    cycle = f"G{number} X3. Y2. Z-1. R1. {'Q0.4' if number in (73, 76, 83) else ''}"
    without = meaning(write(f"{HEAD}{cycle}\nX4.\nG80\n", name), mikron)
    if without is None:
        assert (name, number) in (("part.ngc", 76), ("part.ngc", 88))  # LinuxCNC has none of these
        return
    words = [f"{letter}{value}" for letter in "ABCEHIJKLPQUVW" for value in ("2.", "1.5") if letter not in cycle]
    silent = [w for w in words if letter_of_no_axis(w) and ignored(meaning(write(f"{HEAD}{cycle} {w}\nX4.\nG80\n", name), mikron), without)]
    assert not silent, silent


RESETS = {1, 11, 15, 17, 21, 28.1, 30.1, 40, 53, 54, 64, 67, 71, 80, 90, 91.1, 92.1, 92.2, 92.3, 94, 98, 99, 100}
"""Codes that are in force at the start, end what is not on, or act on what is not in this program."""


@pytest.mark.parametrize("name", ["part.nc", "part.ngc"])
def test_no_g_code_beside_a_move_is_ignored(write, mikron, name: str) -> None:
    """Each code of the table with the words it needs, in the block of a move: others move, or a note or an error names it."""
    set_apart = "".join(f"G10 L2 P{n} X{n}. Y0 Z0\n" for n in range(2, 10))
    if name == "part.nc":
        set_apart += "".join(f"G10 L20 P{n} X{n}.\n" for n in range(1, 21))
    head = set_apart + HEAD
    without = meaning(write(f"{head}X5 Y5\n{TAIL}", name), mikron)
    silent = set()
    for number, (kind, *_) in ISO_G.items():
        words = " ".join(w for w in CONTEXT.get(number, "").split() if w[0] not in "XYZ")
        if kind != REFUSED and ignored(meaning(write(f"{head}X5 Y5 G{number:g} {words}\n{TAIL}", name), mikron), without):
            silent.add(number)
    unknown_there = {n for n in ISO_G if n in (54.1, 154) or 110 <= n < 130} if name == "part.ngc" else set()
    assert silent <= RESETS | unknown_there, silent - RESETS


@pytest.mark.parametrize("name", ["part.nc", "part.ngc"])
@pytest.mark.parametrize(
    "block",
    ["X5. Y5.", "G0 X5.", "G28 X1.", "G4 P1.5", "G10 L2 P1 X1.", "G92 X3.", "G68 X0 Y0 R9.", "G43 H1 X5.", "M98 P7", "T1 M6", "M3 S5"],
)
def test_no_letter_beside_a_word_is_ignored(write, mikron, name: str, block: str) -> None:
    """Each letter with a value. On a Fanuc D is kept for G41, F for the next G1, T for the next change; A and C of an offset act later."""
    tail = "X9. Y2.\nX30. Y7. A1. C1.\nM30\nO7\nX2.\nM99\n"
    without = meaning(write(f"{HEAD}{block}\n{tail}", name), mikron)
    if without is None:
        return
    words = [f"{letter}{value}" for letter in "ABCDEFHIJKLPQRSTUVW" if letter not in block for value in ("2", "1.5")]
    silent = {w for w in words if letter_of_no_axis(w) and ignored(meaning(write(f"{HEAD}{block} {w}\n{tail}", name), mikron), without)}
    assert {w[0] for w in silent} <= {"D", "F", "T"}, silent


DRILLING_CALLS = {
    "CYCLE81": "5,0,1,-2,0,0.5,0,1,12", "CYCLE82": "5,0,1,-2,0,0.5,0,1,12", "CYCLE83": "5,0,1,-20,0,-5,5,1,0.5,0.5,0.8,1,3,1,0.6,1,1,0,1,12",
    "CYCLE84": "5,0,1,-2,0,0.5,5,6,1,0,100,120,3,1,1,0", "CYCLE840": "5,0,1,-2,0,0.5,0,3,1,8,1,3,1", "CYCLE85": "5,0,1,-2,0,0.5,90,120,0,1,12",
    "CYCLE86": "5,0,1,-2,0,0.5,3,0.1,0.2,0.3,45,0,1,12", "CYCLE87": "5,0,1,-2,0,3", "CYCLE88": "5,0,1,-2,0,0.5,3", "CYCLE89": "5,0,1,-2,0,0.5",
    "CYCLE800": '1,"TC1",0,57,1,2,3,10,20,30,4,5,6,1,10,0', "CYCLE832": "0.1,13,1",
    "HOLES1": "1,2,10,3,5,2", "HOLES2": '1,2,5,10,20,3,1000,1,"000"', "CYCLE801": "1,2,10,3,4,2,3,0,0,0", "CYCLE802": "111111111,111111111,3,4,5,6,7,8",
}  # fmt: skip
WITHOUT_MOTION = {
    "CYCLE81": {8}, "CYCLE82": {8}, "CYCLE83": {7, 15, 19}, "CYCLE84": {7, 8, 10, 15}, "CYCLE840": {7, 8, 9, 10}, "CYCLE85": {10}, "CYCLE86": {7, 11, 13},
    "CYCLE87": {6}, "CYCLE88": {7}, "CYCLE800": {1, 2, 3, 14, 15, 16}, "HOLES2": {7, 8, 9},
}  # fmt: skip
"""Arguments, from 1, about the spindle, the display, tables of threads, what another argument rules out, or what the note of CYCLE800 names."""


@pytest.mark.parametrize("name", DRILLING_CALLS)
def test_no_value_in_a_call_of_a_cycle_is_ignored(write, mikron, name: str) -> None:
    """Each argument by itself with other values: the moves are others, or a note or an error says so."""
    pattern = "MCALL CYCLE81(5,0,1,-2)\n{}\nMCALL" if name in ("HOLES1", "HOLES2", "CYCLE801", "CYCLE802") else "{}"

    def run(arguments: list[str]) -> tuple[object, set[str]] | None:
        call = pattern.format(f"{name}({','.join(arguments)})")
        return meaning(write(f"G0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\n{call}\nG1 X5 Z7\nY9\n"), mikron)

    given = DRILLING_CALLS[name].split(",")
    without = run(given)
    silent = set()
    for k, value in enumerate(given):
        others = [v for v in ("2", "7", "1.3", "0", "-3", "", "22", "101") if v != value]
        if all(ignored(run([*given[:k], other, *given[k + 1 :]]), without) for other in others):
            silent.add(k + 1)
    assert silent <= WITHOUT_MOTION.get(name, set()), silent


CL_HEAD, CL_TAIL = "UNITS/MM\nSPINDL/500,RPM\nFEDRAT/500\nGOTO/0,0,150\n", "GOTO/5,0,150\nGOTO/5,5,150\nGOTO/5,10,150,0.1,0,1\n"


@pytest.mark.parametrize(
    "statement",
    [
        "UNITS/INCHES", "RAPID", "FEDRAT/7", "FEDRAT/7,IPM", "FEDRAT/0.1,MMPR", "FEDRAT/RAPID", "CIRCLE/2.5,0,150,0,0,1,2.5", "DELAY/2", "DELAY/2,REV",
        "TLAXIS/0.1,0,1", "MSYS/1,0,0,1,0,0,0,1,0", "CSYS/1,0,0,1,0,1,0,0,0,0,1,0", "CYCLE/DRILL,5,100,MMPM,2", "GOHOME/1,1,150", "GODLTA/1,1,1",
        "GODLTA/3", "FROM/1,1,150", "CUTCOM/LEFT", "PSIS/1", "MOVARC/2.5,0,150,0,0,1,2.5,ANGLE,180", "TRNTYP/WORLD,0,0,0",
        "MCSYS/NUM,1,POINT,1,0,0,VECTOR,1,0,0,VECTOR,0,1,0", "FINI", "CYCLE/DRILL,FEDTO,10,RTRCTO,20,RAPTO,3,MMPM,100",
        "CYCLE/DEEP,DEPTH,10,MMPM,100,CLEAR,5,RETURN,9",
    ],
)  # fmt: skip
def test_each_statement_of_cl_data_that_acts_does(write, mikron, statement: str) -> None:
    """The moves with it are others, or a note or an error names it; and each of its numbers matters."""

    def run(text: str) -> tuple[object, set[str]] | None:
        return meaning(write(f"{CL_HEAD}{text}\n{CL_TAIL}", "part.apt"), mikron)

    with_it = run(statement)
    assert not ignored(with_it, run(""))
    if with_it is None or "/" not in statement or statement.startswith(("CUTCOM", "PSIS", "MCSYS", "TRNTYP")):
        return
    head, _, values = statement.partition("/")
    for k, value in enumerate(values.split(",")):
        if re.fullmatch(r"[\d.]+", value):
            changed = [*values.split(",")[:k], "-1" if value == "1" else f"{float(value) + 1.5:g}", *values.split(",")[k + 1 :]]
            assert not ignored(run(f"{head}/{','.join(changed)}"), with_it), (k, value)


def letter_of_no_axis(word: str) -> bool:
    """Letters of axes that the machine lacks are refused when the program is finished, not while it is read."""
    return word[0] not in "BUVW"


@pytest.mark.parametrize("word", sorted(word for word, entry in WORDS.items() if entry.kind == NOTE))
def test_each_statement_of_cl_data_without_effect_is_noted(write, mikron, word: str) -> None:
    program = "UNITS/MM\nFEDRAT/500\nGOTO/0,0,150\n{}GOTO/5,0,150\n"
    without, now = (meaning(write(program.format(w), "part.apt"), mikron) for w in ("", f"{word}/1\n"))
    assert not ignored(now, without)


@pytest.mark.parametrize(
    ("name", "text", "x"),
    [
        ("part.mpf", "G90 G1 X5\nSUB1\nX1\nM30\n%_N_SUB1_SPF\nPROC SUB1 SAVE\nG91 X1\nRET\n", [5, 6, 1]),
        ("part.mpf", "G90 G1 X5\nSUB1\nX1\nM30\n%_N_SUB1_SPF\nPROC SUB1\nG91 X1\nRET\n", [5, 6, 7]),
        ("part.mpf", "G1 X5\nG25 X-100 S10\nG26 X100\nX6\n", [5, 6]),
        ("part.mpf", "G1 X5\nCALL BLOCK AA TO BB\nX9\nGOTOF CC\nAA: X1\nBB: X2\nCC: X3\n", [5, 1, 2, 9, 3]),
        ("part.mpf", "DEFINE FAR AS X50\nG1 FAR Y1\nX1 Y2\n", [50, 1]),
        ("part.mpf", "N1 (a head)\nG1 X5 (and more) Y3\nX6\n", [5, 6]),
        ("part.mpf", "G111 X10 Y0\nG1 X20 Y0\nG3 AP=90 RP=10\n", [20, 10]),
        ("part.mpf", 'IF ISVAR("_Q")\nG1 X1\nENDIF\nDEF REAL _Q\nIF ISVAR("_Q")\nG1 X2\nENDIF\n', [2]),
        ("part.ngc", "o1 sub\nM73\nG91 G1 X1\no1 endsub\nG90 G1 X5\no1 call\nG1 X3\nM2\n", [5, 6, 3]),
        ("part.nc", "G1 X5.\nG91 G10 L2 P1 X2.\nG10 L2 P1 X2.\nG90 G54 X1.\n", [5, 5]),
        ("part.nc", "G1 X5.\nG10 L20 P1 X5.\nX1.\nG54.1 P1 X1.\n", [5, 1, 6]),
        ("part.nc", "G1 X5.\nG22 X100. Y100. Z100. I0 J0 K0\nX6.\n", [5, 6]),
        ("part.nc", "G0 G1 X5.\nG90 G91 X6.\n", [5, 11]),
        ("part.nc", "G1 X5.\nG5 P10000\nX6.\nG5 P0\nX7.\n", [5, 6, 7]),
        ("part.nc", "G10 L12 P3 R2.\nG1 X5.\nG41 D3 X6. Y5.\nG1 Y20.\nG40 X50.\n", [5, 4, 4, 50]),
        ("part.nc", "#13003=2.\nG1 X5.\nG41 D3 X6. Y5.\nG1 Y20. D03\nG40 X50.\n", [5, 4, 4, 50]),
        ("part.nc", "#13003=1.5\n#12003=9.\n#12003=#13003-1.\nG1 X5. D3\nG41 X6. Y5.\nG1 Y20.\nG40 X50.\n", [5, 4, 4, 50]),
        (
            "part.nc",
            "G10 L12 P3 R1.\nG10 L13 P3 R9.\nG10 L13 P3 R0.5\nG91 G10 L13 P3 R0.5\nG90 G1 X5.\nG41 D3 X6. Y5.\nG1 Y20.\nG40 X50.\n",
            [5, 4, 4, 50],
        ),
        ("part.nc", ":10 G1 X5.\n:20 T1 M6\nX6.\n", [5, 6]),
        ("part.nc", "G1 X5.\n#1=#4001\nG#1 X6.\nIF[#4003EQ90]GOTO 9\nX8.\nN9 X7.\n", [5, 6, 7]),
    ],
)
def test_words_that_were_once_misread_give_the_right_moves(read, name: str, text: str, x: list[float]) -> None:
    program = read(f"F100\n{text}" if name != "part.ngc" else text.replace("G90 G1 X", "G90 G1 F100 X", 1), name)
    assert ends(program)[:, 0].tolist() == x


@pytest.mark.parametrize(
    ("name", "block", "message"),
    [
        ("part.mpf", "PRESETON(X,0)", "new coordinates"),
        ("part.mpf", "G90 G91 X3", "G90 and G91 are in one block"),
        ("part.mpf", "OFFN=0.5", "OFFN=0.5 is not supported"),
        ("part.mpf", "ID=1 WHENEVER $AA_IM[X]>1 DO POS[Y]=3", "synchronised"),
        ("part.ngc", "G0 G1 X3", "G0 and G1 are in one block"),
        ("part.ngc", "M72", "M70"),
        ("part.nc", "G5 P2 X3 I1 J1", "splines"),
        ("part.nc", "#2201=5.", "differently"),
        ("part.nc", "G10 L12 P1 R1.\nG10 L12 P2 R2.\nG41 D1 X5 Y5\nX9 D2", "D changes the radius"),
        ("part.mpf", "CUT3DC", "cutter radius in space"),
    ],
)
def test_words_that_would_be_misread_are_refused(read, name: str, block: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(f"G1 X1 F100\n{block}\nG1 X5\n", name)


def test_feeds_of_a_block_and_of_the_override(read) -> None:
    program = read("G1 X1 F600\nX2 FB=300\nOVR=50 X3\nX4\n")
    assert program.moves.feed * 60e3 == pytest.approx([600, 300, 300, 300])


def test_fine_boring_steps_off_the_wall(read) -> None:
    program = read("G0 X0 Y0 Z9.\nG76 X5. Y0 Z-3. R1. Q0.5 F100\nG80\n", "part.nc")
    assert ends(program)[-3:].tolist() == [[5.5, 0, -3], [5.5, 0, 9], [5, 0, 9]]


@pytest.mark.parametrize("name", [n for n, (kind, *_) in SINUMERIK_NAMES.items() if kind == REFUSED])
def test_every_refused_name_says_what_to_do(read, name: str) -> None:
    bare = () if re.fullmatch(r"[A-Z]\d", name) else (name, f"{name}(1)")  # A4 alone is a position of the axis A
    for block in (f"{name}=1", *bare):
        with pytest.raises(InputError) as error:
            read(f"G1 X1 F100\n{block}\nG1 X2\n")
        assert "\n" not in str(error.value)


def test_every_noted_name_is_noted(write, mikron) -> None:
    for name in [n for n, (kind, *_) in SINUMERIK_NAMES.items() if kind == NOTE]:
        word = f"{name}=1" if re.fullmatch(r"[A-Z]\d", name) else name  # A4 alone is a position of the axis A
        out = understand(write(f"G1 X1 F100\n{word}\nG1 X2\n"), mikron)
        assert any(name in note for note in out.notes), name
    for number, (kind, *_) in SINUMERIK_G.items():
        if kind == NOTE:
            assert any(f"G{number:g}" in n for n in understand(write(f"G{number:g}\n"), mikron).notes)


def test_the_table_of_words_is_up_to_date() -> None:
    page = words_table.PAGE.read_text(encoding="utf-8")
    assert page == words_table.with_table(page), "run python devtools/words_table.py --write"


def test_mutated_programs(mikron, tmp_path) -> None:
    """A seeded part of `scripts/fuzz --only program`: some are refused, some read the same from their normalised print."""
    rng, names = random.Random(7), sorted(fuzz_programs.SAMPLES)
    mutated = [(name, fuzz_programs.mutate(fuzz_programs.SAMPLES[name], rng)) for name in names * 6]
    results = {fuzz_programs.check(name, text, mikron, tmp_path) for name, text in mutated}
    assert {"refused", "read and re-read"} <= results


@pytest.mark.skipif(not LINUXCNC.is_dir(), reason="LinuxCNC's tests are not beside the tree (../shared/data/linuxcnc)")
def test_what_linuxcnc_refuses_is_refused(mikron) -> None:
    programs = sorted((LINUXCNC / "bad").glob("*.ngc"))
    assert len(programs) == 23
    for program in programs:
        with pytest.raises(InputError):
            understand(program, mikron)


def test_var_values_come_back_to_the_caller(read, write) -> None:
    """VAR: whole variables and arrays are the caller's own; R parameters and elements are written back; others are copies."""
    write(
        "PROC STEPS(VAR REAL PLACE[3], VAR REAL SCALED, VAR REAL BACK, REAL OWN)\nPLACE[1]=PLACE[0]+5\nSCALED=SCALED*2\nBACK=7\nOWN=99\nENDPROC\n",
        "STEPS.SPF",
    )
    program = read("DEF REAL P[3], Q\nP[0]=1\nQ=3\nR1=0\nR2=4\nSTEPS(P,Q,R1,R2)\nG1 F100 X=P[1] Y=Q Z=R1\nX=R2\n")
    assert ends(program).tolist() == [[6, 6, 7], [4, 6, 7]]


def test_cutter_radius_in_a_tilted_plane(read, write, mikron) -> None:
    """G41 in a plane of CYCLE800 is that of the same plane untilted; a tool askew to the plane is refused."""
    contour = "G41 {d} X10 Y0\nX30\nY20\nX0\nG40 X0 Y30\n"
    head, last = "$TC_DP6[1,1]=3\nT1 D1\nG1 F500 X0 Y-10 Z180\n", contour.format(d="")
    flat = ends(read("TRAORI\n" + head + last))
    assert flat[1, :2].tolist() == [10, 3]
    tilted = read("CYCLE800(0,,0,57,0,0,0,20,0,0,0,0,0)\n" + head + last)
    turn = np.radians(20.0)
    matrix = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    there = ends(tilted)
    shift = there[0] - matrix @ flat[0]
    assert np.allclose(there, flat @ matrix.T + shift, atol=1e-6)
    with pytest.raises(InputError, match="perpendicular to the plane"):
        read("TRAORI\n" + head + "A3=0 B3=-0.3 C3=1\n" + last)


def test_corners_of_fanuc(read) -> None:
    """,C cuts a corner off at that distance from it, ,R rounds it; both need a line behind."""
    text = "G1 X0 Y0 F100\nX20{}\nY20\n"
    assert ends(read(text.format(" ,C5"), "part.nc")).tolist()[1:] == [[15, 0, 0], [20, 5, 0], [20, 20, 0]]
    rounded = read(text.format(",R4."), "part.nc")
    assert ends(rounded).tolist()[1:] == [[16, 0, 0], [20, 4, 0], [20, 20, 0]]
    assert rounded.moves.angle[rounded.moves.kind == ARC] == pytest.approx([np.pi / 2])
    for wrong in ("G1 X9 F1 ,R2\nM8\n", "G1 X9 F1 ,R2\n", "G0 X9 ,R2\nX10\n"):
        with pytest.raises(InputError, match=r",R"):
            read(wrong, "part.nc")


def test_polar_places_of_drilling_cycles(read) -> None:
    """G16 counts for the holes of a cycle, too; with G91 the angle goes on from the last one."""
    program = read("G0 G90 G16 Z9\nG81 X100 Y30 Z-2 R1 F200\nG91 Y60\nG15 G80\n", "part.nc")
    holes = {tuple(p) for p in ends(program)[:, :2].tolist()}
    assert {(round(100 * np.cos(np.radians(a)), 6), round(100 * np.sin(np.radians(a)), 6)) for a in (30, 90)} <= holes
    assert not any(p[0] == 100 for p in holes)


def test_a_fanuc_begins_with_rapid(read) -> None:
    program = read("X1 Y1\nX5\nG1 X9 F100\n", "part.nc")
    assert program.moves.kind.tolist()[-2:] == [RAPID, LINE]
    assert any("before any G0 or G1" in note for note in program.notes)
