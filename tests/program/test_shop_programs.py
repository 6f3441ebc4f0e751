"""Programs as shops write them: what was read wrongly once, both languages, every word of the tables, mutated programs."""

from pathlib import Path
import re

import numpy as np
import pytest

from devtools import fuzz_programs, words_table
from twin.errors import InputError
from twin.program import interpolate, read_program
from twin.program.moves import ARC
from twin.program.read import understand
from twin.program.tables import ACTS, ISO_G, ISO_M, NOTE, REFUSED, SINUMERIK_G, SINUMERIK_NAMES

LINUXCNC = Path(__file__).resolve().parents[3] / "shared" / "data" / "linuxcnc" / "interp"


@pytest.fixture
def write(tmp_path):
    def writer(text: str, name: str = "part.mpf") -> Path:
        path = tmp_path / name
        path.write_text(text)
        return path

    return writer


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


def test_programmable_shifts_move_nothing(read) -> None:
    assert ends(read("G1 X1 F100\nG58 X10\nG1 X2\nG59 X1\nG1 X3\n"))[:, 0].tolist() == [1, 12, 14]


def test_a_dwell_counts_by_dialect(read) -> None:
    assert read("G1 X1 F100\nG4 P500\nG1 X2\n", "part.nc").moves.pause[1] == pytest.approx(0.5)
    assert read("G1 X1 F100\nG4 P5\nG1 X2\n", "part.ngc").moves.pause[1] == pytest.approx(5.0)
    with pytest.raises(InputError, match="G4 stands alone"):
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
        "rounding",
        "tolerance",
        "offset",
        "comp",
        "cycle",
        "retract_to_start",
        "polar",
        "system",
        "local",
        "shift",
        "shift_on",
        "home",
        "modal_macro",
        "chosen",
        "program_offset",
        "pole",
        "angles_are_rpy",
        "corners_meet",
        "mcall",
        "swivelled",
        "plane_matrix",
    ]
    return (len(out.kinds), out.modes, tuple(out.stops), len(out.messages), front.flow.ended, *(str(getattr(front, n, "")) for n in names))


CONTEXT = {4: "P1", 10: "L2 P1 X1", 28: "X1", 30: "X1", 52: "X1", 92: "X1", 68: "X0 Y0 R9", 68.2: "X0 Y0 Z0 I0 J0 K0", 51: "P2", 51.1: "X0", 54.1: "P3",
           73: "Z-1 R1 Q1", 83: "Z-1 R1 Q1", 41: "D1", 42: "D1", 41.1: "D1", 42.1: "D1", 53: "X1", 65: "P9", 66: "P9", 2: "X1 I5", 3: "X1 I5",
           9: "X3", 64: "P1", 16: "X3"}  # fmt: skip


def test_every_word_of_the_iso_table_acts_or_is_noted_or_is_refused(write, mikron) -> None:
    """Run behind two different states: a word that acts changes one of them, or says what it lacks."""
    states = (
        "G0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\n",
        "G20 G18 G91 G93 G99 G90.1 G61 G16 G55 G52 X1\nG92 X3\nG51 P2\nG17 G90 G20\nG1 X1 F1\nG81 Z-1 R1 F1\nG19 G91 G42.1 D1\n",
    )
    from twin.program.iso import Iso
    from twin.program.source import Source, units_of

    def run(text: str) -> tuple:
        path = write(text, "part.nc")
        front = Iso(path, mikron, units_of(Source(path))[0], linuxcnc=False)
        front.flow.run()
        return fingerprint(front.out, front), tuple(front.out.notes)

    silent = []
    for number, (kind, _) in ISO_G.items():
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
    assert not silent
    assert all(kind in (ACTS, NOTE, REFUSED) for kind, _ in ISO_M.values())


@pytest.mark.parametrize("name", [n for n, (kind, _) in SINUMERIK_NAMES.items() if kind == REFUSED])
def test_every_refused_name_says_what_to_do(read, name: str) -> None:
    bare = () if re.fullmatch(r"[A-Z]\d", name) else (name, f"{name}(1)")  # A4 alone is a position of the axis A
    for block in (f"{name}=1", *bare):
        with pytest.raises(InputError) as error:
            read(f"G1 X1 F100\n{block}\nG1 X2\n")
        assert "\n" not in str(error.value)


def test_every_noted_name_is_noted(write, mikron) -> None:
    for name in [n for n, (kind, _) in SINUMERIK_NAMES.items() if kind == NOTE]:
        out = understand(write(f"G1 X1 F100\n{name}\nG1 X2\n"), mikron)
        assert any(name in note for note in out.notes), name
    for number, (kind, _) in SINUMERIK_G.items():
        if kind == NOTE:
            assert any(f"G{number:g}" in n for n in understand(write(f"G{number:g}\n"), mikron).notes)


def test_the_table_of_words_is_up_to_date() -> None:
    page = words_table.PAGE.read_text(encoding="utf-8")
    assert page == words_table.with_table(page), "run python devtools/words_table.py --write"


def test_mutated_programs(mikron, tmp_path) -> None:
    counts = fuzz_programs.fuzz(90, 7, fuzz_programs.SAMPLES, mikron, tmp_path)
    assert counts["refused"]
    assert counts["read and re-read"]


@pytest.mark.skipif(not LINUXCNC.is_dir(), reason="LinuxCNC's tests are not beside the tree (../shared/data/linuxcnc)")
def test_what_linuxcnc_refuses_is_refused(mikron) -> None:
    programs = sorted((LINUXCNC / "bad").glob("*.ngc"))
    assert len(programs) == 23
    for program in programs:
        with pytest.raises(InputError):
            understand(program, mikron)
