"""Kinds of faults that users of many readers reported: silent wrong readings, and refusals of what a control reads."""

from __future__ import annotations

import itertools
from pathlib import Path
import random

import numpy as np
import pytest

from twin.errors import InputError
from twin.program import check_folder, is_program, read_program
from twin.program.iso import ISO_M
from twin.program.moves import ARC, LINE
from twin.program.read import dialect, understand
from twin.program.sinumerik import SINUMERIK_M
from twin.program.source import ProgramText


def ends(program) -> np.ndarray:
    return np.round(program.moves.target[:, :3] * 1e3, 6)


def times(program) -> np.ndarray:
    """Time of each move at its feed [s]."""
    moves = program.moves
    way = moves.target - program.starts()
    length = np.where(moves.rotary, np.linalg.norm(way[:, 3:], axis=1), np.linalg.norm(way[:, :3], axis=1))
    return length / moves.feed


@pytest.mark.parametrize("seed", range(4))
def test_f_counts_all_axes_on_a_fanuc_and_x_y_z_elsewhere(read, seed: int) -> None:
    """sqrt(20^2 + 40^2) / 300 min is the example of a Fanuc manual; in inches a degree counts as an inch."""
    rng = np.random.default_rng(seed)
    x, y, c, f = 20.0, 0.0, 40.0, 300.0
    if seed:
        x, y, c, f = *rng.uniform(1, 4, 2), rng.uniform(5, 90), rng.uniform(100, 500)
    for unit in ("G21", "G20")[: 1 + bool(seed)]:
        text = f"{unit}\nG0 X0 Y0 Z0 C0\nG1 X{x:.6f} Y{y:.6f} C{c:.6f} F{f:.6f}\n"
        fanuc, linuxcnc = read(text, "part.nc"), read(text, "part.ngc")
        assert times(fanuc)[-1] == pytest.approx(60 * np.sqrt(x * x + y * y + c * c) / f, rel=1e-6)
        assert times(linuxcnc)[-1] == pytest.approx(60 * np.hypot(x, y) / f, rel=1e-6)
        assert all(any("counts" in n for n in p.notes) for p in (fanuc, linuxcnc))
    move = f"G1 X{x:.6f} C{c:.6f} F{f:.6f}\n"
    assert times(read(f"G0 X0 C0\nFGROUP(X,Y,Z,C)\n{move}"))[-1] == pytest.approx(60 * np.hypot(x, c) / f, rel=1e-6)
    assert times(read(f"G0 X0 C0\nFGROUP(X,Y,C)\nFGROUP(X,Y,Z)\n{move}"))[-1] == pytest.approx(60 * x / f, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "feeds"), [("G1 X10 F600\nG20 G1 X1 F10\nG1 X2\n", [600, 10, 10]), ("G20 G0 X0\nG21 G1 F400 X50\n", [10160])]
)
def test_linuxcnc_carries_f_out_before_a_change_of_unit(read, text: str, feeds: list[float]) -> None:
    program = read(f"G21 G90\n{text}M2\n", "part.ngc")
    assert program.moves.feed[program.moves.kind == LINE] * 60e3 == pytest.approx(feeds)
    assert any("before" in note for note in program.notes)


def test_levels_of_a_cycle_stay_where_they_were_given(read) -> None:
    """On a Fanuc each of R and Z keeps the level that it was given under G90 or G91; LinuxCNC takes the words anew. All sequences of modes."""
    for modes in itertools.product("01", repeat=3):
        first, *later = (f"G9{m}" for m in modes)
        z, r = ("Z-5.", "R2.") if first == "G90" else ("Z-7.", "R-10.")
        text = f"G21 G17 G90 G0 X0 Y0 Z12.\n{first} G98 G81 X5. {z} {r} F600\n" + "".join(
            f"{g} Y{10 * k + 10}.\n" for k, g in enumerate(later)
        )
        program = read(text + "G80\nM30\n", "part.nc")
        assert ends(program)[program.moves.kind == LINE, 2].tolist() == [-5.0] * 3, modes
        assert ends(program)[-1, 2] == 12.0
        if len(set(modes)) > 1:
            assert any("keep their levels" in note for note in program.notes)
    linuxcnc = read("G21 G90 G0 X0 Y0 Z12 F600\nG98 G81 Z-5 R2\nG91 Y10\nG80\nM2\n", "part.ngc")
    assert ends(linuxcnc)[linuxcnc.moves.kind == LINE, 2].tolist() == [-5.0, 9.0]


DIFFERENT = [
    "G4 P500", "G81 Z-1 R1 P300\nX3", "G82 Z-1 R1 P0.3", "G52 X3\nX1", "G52 X1\nG92 X0\nX1\nG52 X0\nX1", "G10 L20 P1 X0\nX2", "G61.1\nX3\nY3", "G41 D1 X5 Y5\nX9\nY9\nG40 X0",
    "G20 X1 F10", "G81 Z-1 R1\nG91 X1\nX1\nG90 G80", "#1=[1OR2]\nX#1", "#1=[5AND6]\nX#1", "G5 P1 X3", "G1 X3 P2", "G61\nX3\nY5", "G64 P0.1\nX3\nY5", "G1 X2 G0",
]  # fmt: skip


@pytest.mark.parametrize("block", DIFFERENT)
def test_where_linuxcnc_and_fanuc_differ_a_note_or_an_error_says_so(write, mikron, block: str) -> None:
    """The same text in both: if the moves differ, the reading of .nc, whose control is a guess, names the word; if only one is read, the other is an error."""
    found = []
    machine = mikron.with_values({"tool": {"T1": {"length_m": 0.1, "radius_m": 1e-3}}})
    for name in ("part.nc", "part.ngc"):
        try:
            out = understand(write(f"G21 G17 G90 T1 M6\nG0 X0 Y0 Z5\nG1 X1 Y1 F100 S100\n{block}\n", name), machine)
        except InputError:
            return
        of_block = [k for k, line in enumerate(out.lines) if line > 3]
        modes = [str((out.all_modes[out.mode_of[k]].rounding, out.all_modes[out.mode_of[k]].tolerance)) for k in of_block]
        feeds = [out.feeds[k] for k in of_block]
        found.append((str(([out.targets[k] for k in of_block], feeds, out.pauses, list(out.arcs.values()), modes)), set(out.notes)))
    (nc, notes), (ngc, others) = found
    if nc != ngc:
        assert notes - others


@pytest.mark.parametrize(("name", "table"), [("part.nc", ISO_M), ("part.ngc", ISO_M), ("part.mpf", SINUMERIK_M)])
def test_an_m_code_that_is_not_known_is_not_known(write, mikron, name: str, table: dict) -> None:
    """Of all M codes those without an entry say that they are not known, and none says that it has no effect on the motion."""
    numbers = [n for n in (*range(100), 128, 129, 204, 428, 429, 999) if n not in table]
    out = understand(write("".join(f"M{n}\n" for n in numbers) + "G1 X1 F100\n", name), mikron)
    for number in numbers:
        assert next(note for note in out.notes if note.startswith(f"M{number}:")).startswith(f"M{number}: not known")


@pytest.mark.parametrize(
    "text",
    [
        "% 123 G71\nN10 G90 Z-25. M91\nN20 G17 T1 S0\nN30 G0 X50. Y-10. M13\n",
        "%PART G71 *\nN10 G30 G17 X+0 Y+0 Z-20*\n",
        "N10 G0 Z-5 M91\nN20 I+50 J+50\nN30 G3 X+50 Y+0\n",
        "N10 G0 Z-5 M91\nN20 G1 X5 F100 M13\n",
    ],
)
def test_din_iso_of_heidenhain_is_named(write, text: str) -> None:
    with pytest.raises(InputError, match="HEIDENHAIN program in DIN/ISO"):
        dialect(ProgramText(write(text, "part.nc")))


def test_h_chooses_another_length_while_g43_is_in_force(write, mikron) -> None:
    """H behind G43 acts as G43 H does, H0 as G49; without G43, and on LinuxCNC, it stays an error."""
    machine = mikron.with_values({"tool": {"T1": {"length_m": 0.1}, "T2": {"length_m": 0.15}}})

    def lengths(text: str, name: str = "part.nc") -> list[float]:
        out = understand(write(f"G21 G90 T1 M6\nG0 X0 Y0 Z50.\n{text}\n", name), machine)
        return [out.all_modes[k].tool_length for k in out.mode_of]

    assert lengths("G43 H1 X1.\nX2. H2\nX3. H0\nX4.") == lengths("G43 H1 X1.\nG43 X2. H2\nG49 X3.\nX4.")
    for text, name in (("X1. H1", "part.nc"), ("G43 H1\nG49\nX2. H2", "part.nc"), ("G43 H1 X1\nX2 H2", "part.ngc")):
        with pytest.raises(InputError, match="H chooses"):
            lengths(text, name)


def test_rotary_axes_go_with_a_cycle_to_its_holes(read) -> None:
    program = read("G21 G90 G0 X0 Y0 Z10.\nG81 X5. C30. Z-2. R1. F200\nC60.\nG80\n", "part.nc")
    turned = np.round(np.degrees(program.moves.target[program.moves.kind == LINE, 4]), 6)
    assert turned.tolist() == [30.0, 60.0]
    with pytest.raises(InputError, match="canned cycle"):
        read("G21 G90 G0 X0 Z10\nG81 X5 C30 Z-2 R1 F200\n", "part.ngc")


def test_two_letters_of_a_macro_word_are_enough(read) -> None:
    whole = "#1=0\n#2=ROUND[SQRT[10]]+FIX[2.7]+FUP[0.2]+ABS[-1]+SIN[30]+ATAN[1]/[1]\nWHILE[#1LT3]DO1\n#1=#1+1\nG1 X[#1*10.+#2] F1000\nEND1\nIF[#1EQ3]THEN#3=7.\nIF[[1AND3]EQ1]GOTO9\nX99.\nN9 Y#3\n"
    pairs = ("ROUND", "SQRT", "FIX", "FUP", "ABS", "SIN", "ATAN", "WHILE", "END", "THEN", "AND", "GOTO")
    expected = ends(read(whole, "part.nc"))
    short = whole
    for word in pairs:
        short = short.replace(word, word[:2])
        assert ends(read(short, "part.nc")).tolist() == expected.tolist(), word
    assert expected[:, 0].max() < 99


@pytest.mark.parametrize("seed", range(3))
def test_an_open_arc_says_which_meaning_of_i_j_closes_it(read, seed: int) -> None:
    """Random arcs in three planes: written from the start they are read; written absolutely or turned the message names it."""
    rng = random.Random(seed)
    for plane, (a, b, i, j) in {17: "XYIJ", 18: "ZXKI", 19: "YZJK"}.items():
        centre, radius, first, last = [rng.uniform(-30, 30) for _ in range(2)], rng.uniform(5, 20), rng.uniform(0, 3), rng.uniform(3.3, 6)
        at = [[centre[0] + radius * np.cos(t), centre[1] + radius * np.sin(t)] for t in (first, last)]
        head = f"G21 G90 G{plane} G0 {a}{at[0][0]:.5f} {b}{at[0][1]:.5f}\nG3 F500 {a}{at[1][0]:.5f} {b}{at[1][1]:.5f} "
        way = np.array(centre) - at[0]
        assert (read(f"{head}{i}{way[0]:.5f} {j}{way[1]:.5f}\n", "part.nc").moves.kind == ARC).all()
        for u, v, message in ((*centre, "absolute: write G90.1"), (*-way, "turned"), (way[0] + 3, way[1], "from the start")):
            with pytest.raises(InputError, match="does not close") as error:
                read(f"{head}{i}{u:.5f} {j}{v:.5f}\n", "part.nc")
            assert message in str(error.value)
            assert "AC(" not in str(error.value)
        with pytest.raises(InputError, match=rf"write {i}=AC"):
            read(f"{head}{i}{centre[0]:.5f} {j}{centre[1]:.5f}\n".replace("G21 ", ""), "part.mpf")


def test_g4_x_of_linuxcnc_moves_x(read) -> None:
    program = read("G21 G1 X1 F100\nG4 P2 X5\n", "part.ngc")
    assert ends(program)[-1, 0] == 5
    with pytest.raises(InputError, match="G4 needs its time"):
        read("G21 G1 X1 F100\nG4 X5\n", "part.ngc")


@pytest.mark.parametrize(
    ("text", "noted"),
    [("TRANS X5\nG91 X1\n", True), ("TRANS X5\nX1\nG91 X1\n", False), ("TRANS X5\nG91 Y1\n", False), ("TRANS X5\nX=IC(1)\n", True)],
)
def test_an_increment_behind_a_change_of_the_frame_states_its_assumption(read, text: str, noted: bool) -> None:
    assert any("SD42440" in note for note in read(f"G1 X1 Y1 F100\n{text}").notes) is noted


def test_what_is_a_program_by_its_text(tmp_path: Path) -> None:
    """`.txt` and no ending are read as what they are; a table of numbers, a text and a C header are none."""
    programs = ["G21 G90 G17\nG0 X0\nG1 X50 F3000\n", "%\nO1234\nN1 G21\nX5\n", "0 BEGIN PGM A MM\n1 L X+0 R0 FMAX\n2 END PGM A MM\n"]
    others = ["time,X.setpoint\n0,1\n", "0.1 0.2\n0.3 0.4\n", "#include <a.h>\nint main;\n", "A text about nothing.\n", "", "G1\0X1\n"]
    for ending in (".txt", ""):
        for text in (*programs, *others):
            path = tmp_path / f"part{ending}"
            path.write_text(text)
            assert is_program(path) is (text in programs), text
    (tmp_path / "part.txt").write_text(programs[0])
    (tmp_path / "notes").write_text(others[3])
    (tmp_path / "part").unlink()
    assert [p.name for p in check_folder.programs_in(tmp_path)] == ["part.txt"]


def test_a_program_that_only_computes_is_understood(write, mikron) -> None:
    for text in ("#1=[2+3]\n(debug, #1)\nM2\n", "G21\nG0 X1\nM2\n"):
        found = check_folder.check_program(write(text, "part.ngc"), mikron)
        assert found.verdict == "ok"
        assert found.duration_s == 0.0
        assert "moves no axis" in found.reason
    with pytest.raises(InputError, match="moves no axis"):
        read_program(write("#1=2\nM2\n", "part.ngc"), mikron)
