"""What builders of machines put into programs: axes and G codes by variables, calls with values, what the machine file says."""

from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.program.moves import RAPID


@pytest.fixture
def with_program_table(mikron, tmp_path):
    def machine(lines: str) -> Machine:
        path = tmp_path / "own.toml"
        write_machine(mikron, path)
        text = path.read_text()
        assert "[program]" not in text
        path.write_text(f"{text}\n[program]\n{lines}\n")
        return load_machine(path)

    return machine


def ends(program) -> np.ndarray:
    return np.round(program.moves.target[:, :3] * 1e3, 6)


def test_axes_by_variables(read) -> None:
    program = read("DEF AXIS _A\n_A=$P_AXN2\nG1 F100 X1\nAX[_A]=20 Z5\nTRANS AX[X]=10\nX0\nPOS[_A]=7\n")
    assert ends(program).tolist() == [[1, 0, 0], [1, 20, 5], [10, 20, 5], [10, 7, 5]]


def test_g_codes_by_group_and_number(read) -> None:
    program = read("G1 X1 F100\nG[14]=2\nG[1]=1 X10\nG[8]=2 G[1]=2 X1\nIF ($P_GG[14]==2) AND ($P_GG[8]==2)\nG[14]=1 X0\nENDIF\n")
    assert ends(program)[:, 0].tolist() == [1, 11, 12, 0]
    assert (program.moves.kind == RAPID).tolist() == [False, True, False, False]
    with pytest.raises(InputError, match=r"G\[2\]=5 is not read"):
        read("G1 X1 F100\nG[2]=5 X3\n")


@pytest.mark.parametrize("block", ["X[1]=5", "Y[X]=2"])
def test_an_index_that_names_no_axis_is_refused(read, block: str) -> None:
    with pytest.raises(InputError, match="is not an axis"):
        read(f"G1 X1 F100\n{block}\n")


def test_a_numbered_subprogram_takes_values(read, tmp_path: Path) -> None:
    (tmp_path / "L140.SPF").write_text("PROC L140(REAL WAY)\nG1 Y=WAY\nM17\n")
    assert ends(read("G1 X1 F100\nL140(2)\nX3\n")).tolist() == [[1, 0, 0], [1, 2, 0], [3, 2, 0]]


def test_a_local_subprogram_of_a_haas(read) -> None:
    text = "G21 G90 G1 X0 F100\nM97 P100 L2\nX50\nM30\nN100 G91 X5\nG90\nM99\n"
    assert ends(read(text, "part.nc"))[-3:, 0].tolist() == [5, 10, 50]
    with pytest.raises(InputError, match="no block N200"):
        read(text.replace("P100", "P200"), "part.nc")
    with pytest.raises(InputError, match="no word of LinuxCNC"):
        read(text, "part.ngc")


@pytest.mark.parametrize(
    ("name", "text"), [("part.mpf", "G1 X1\nX3\n"), ("part.nc", "G21 G1 X1\nX3\n"), ("part.apt", "GOTO/1,0,150\nGOTO/3,0,150\n")]
)
def test_the_feed_before_the_first_f(read, with_program_table, name: str, text: str) -> None:
    with pytest.raises(InputError, match="feed_mm_min"):
        read(text, name)
    assert read(text, name, with_program_table("feed_mm_min = 600")).moves.feed * 60e3 == pytest.approx([600, 600])


def test_a_feed_of_zero_is_refused(with_program_table) -> None:
    with pytest.raises(InputError, match="feed_mm_min must be a number above 0"):
        with_program_table("feed_mm_min = 0")


@pytest.mark.parametrize(("name", "call"), [("part.nc", "G65 P9810 X5. F50"), ("part.nc", "M98 P9810"), ("part.mpf", "CHECKTOOL(1)")])
def test_calls_that_move_no_axis(read, with_program_table, name: str, call: str) -> None:
    text = f"G21 G1 X1 F100\n{call}\nX3\n" if name == "part.nc" else f"G1 X1 F100\n{call}\nX3\n"
    with pytest.raises(InputError, match="calls_without_motion"):
        read(text, name)
    program = read(text, name, with_program_table('calls_without_motion = ["O9810", "CHECKTOOL"]'))
    assert ends(program)[:, 0].tolist() == [1, 3]
    assert any("moving no axis" in note for note in program.notes)


def test_surface_normals_change_nothing_and_angles_about_them_are_refused(read) -> None:
    moved, plain = "TRAORI\nG1 F500 X10 A3=0.1 B3=0 C3=1 {}\nX20\n", "A4=0 B4=0 C4=1 A5=0 B5=0.1 C5=1"
    with_normals = read(moved.format(plain))
    assert with_normals.moves.target.tolist() == read(moved.format("")).moves.target.tolist()
    assert any("A5: surface normals" in note for note in with_normals.notes)
    for word in ("LEAD=5", "TILT=0"):
        with pytest.raises(InputError, match=r"set by the machine builder.*A3= B3= C3="):
            read(moved.format(f"{plain} {word}"))
