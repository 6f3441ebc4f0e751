"""Words of ISO and SINUMERIK programs that few programs use: what each does, by hand calculation."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from twin.errors import InputError
from twin.program.moves import LINE, RAPID
from twin.program.read import dialect, understand
from twin.program.source import ProgramText


def places(program, axes: int = 2) -> list[list[float]]:
    """Ends of the moves [mm], rounded."""
    return (np.round(program.moves.target[:, :axes] * 1e3, 6) + 0.0).tolist()


def test_mirror_scale_and_turn_are_nested(read) -> None:
    """The example of the Fanuc manual: a mirror in each axis by itself. Then a turn inside a scale, centres given and not given."""
    text = "G0 X0 Y0\nG51.1 X50.\nX60. Y10.\nG51.1 Y50.\nX60. Y10.\nG50.1 X0\nX60. Y10.\nG50.1 Y0\nX60. Y10.\n"
    assert places(read(text, "part.nc")) == [[40, 10], [40, 90], [60, 90], [60, 10]]
    text = "G0 X0 Y0\nG51 X0 Y0 Z0 P2000\nX10. Y10.\nG68 X10. Y0 R90.\nX20. Y0\nG69\nG50\nX1. Y1.\n"
    assert places(read(text, "part.nc")) == [[20, 20], [20, 20], [1, 1]]
    assert places(read("G0 X10. Y10.\nG51 P2.\nX12. Y13.\n", "part.nc")) == [[14, 16]]
    assert places(read("G0 X0 Y0\nG51 X0 Y0 Z0 I-1000 J1000 K1000\nX10. Y10.\n", "part.nc")) == [[-10, 10]]


def test_mirror_of_a_haas(read) -> None:
    assert places(read("G0 X1. Y1.\nG101 X0\nX10. Y10.\nG100 X0\nX10.\n", "part.nc")) == [[-10, 10], [10, 10]]
    with pytest.raises(InputError, match="zero of the program"):
        read("G0 X1.\nG101 X5.\nX10.\n", "part.nc")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("part.mpf", "$TC_DP6[1,1]=1\nT1 D1\nG0 X0 Y0\nSCALE X2 Y2 Z2\nG41 G1 X10 Y0 F100\nX20\nY10\nG40 X30\n"),
        ("part.nc", "G10 L12 P1 R1.\nG0 X0 Y0\nG51 X0 Y0 Z0 P2.\nG41 D1 G1 X10. Y0 F100\nX20. D1\nY10.\nG40 X30.\n"),
    ],
)
def test_a_scale_leaves_the_radius_of_the_tool(read, name: str, text: str) -> None:
    assert places(read(text, name)) == [[20, 1], [39, 1], [39, 20], [60, 20]]


def test_unequal_scales_and_a_tool_radius_are_refused(read) -> None:
    with pytest.raises(InputError, match="same scale"):
        read("$TC_DP6[1,1]=1\nT1 D1\nG1 X0 F100\nSCALE X2\nG41 X10 Y0\nX20\nG40 X30\n")


def test_reference_points(read) -> None:
    """G28 goes through its point, G29 comes back through it; an axis without a value goes at once; G27 is a rapid move."""
    program = read("G0 X0 Y0\nG28 X10. Y10.\nG29 X30. Y5.\nG27 X3. Y0\nG28 X\n", "part.nc")
    assert places(program) == [[10, 10], [0, 0], [10, 10], [30, 5], [3, 0], [3, 0], [0, 0]]
    assert set(program.moves.kind.tolist()) == {RAPID}


def test_back_boring(read) -> None:
    program = read("G0 X0 Y0 Z50.\nG87 X10. Y10. Z-5. R-25. Q2. F100\nG80\n", "part.nc")
    assert places(program, 3) == [
        [10, 10, 50], [12, 10, 50], [12, 10, -25], [10, 10, -25], [10, 10, -5], [12, 10, -5], [12, 10, 50], [10, 10, 50],
    ]  # fmt: skip
    assert program.moves.kind.tolist().count(LINE) == 1
    with pytest.raises(InputError, match="below R"):
        read("G0 X0 Z50.\nG87 X10. Z-30. R-25. Q2. F100\n", "part.nc")


def test_tool_change_of_a_brother(read) -> None:
    program = read("G0 X0 Y0 Z50.\nG1 Y1. F100\nG100 T3 X5. Y6. Z7. G43 H3 S500 M3\nX9.\n", "part.nc")
    assert places(program, 3)[1:] == [[5, 6, 50], [5, 6, 7], [9, 6, 7]]
    assert program.moves.kind.tolist()[1:] == [RAPID, RAPID, LINE]


def test_threads_of_linuxcnc(read) -> None:
    program = read("G0 X0 Z1\nS1000 M3\nG33.1 Z-1.2 K0.1\nG33 Z-5 K0.5\nM2\n", "part.ngc")
    assert [row[2] for row in places(program, 3)] == [-1.2, 1, -5]
    assert program.moves.feed * 60e3 == pytest.approx([100, 100, 500])
    with pytest.raises(InputError, match="threading"):
        read("G0 X0 Z1\nG33 Z-1. F1.\n", "part.nc")


def test_splines_of_linuxcnc(read) -> None:
    """G5 from (0, 0) with (0, 3) to (1, 1) with (0, -3): points of the curve by hand; the next goes on with its arm; G5.1 by I and J."""
    program = read("G0 X0 Y0\nG5 I0 J3 P0 Q-3 X1 Y1 F100\nP0 Q-3 X2 Y1\nG5.1 X4 Y0 I1 J2\nM2\n", "part.ngc")
    ends = np.array(places(program))
    u = np.linspace(0.0, 1.0, 12)[1:-1]
    curve = np.stack([3 * u**2 * (1 - u) + u**3, 9 * u * (1 - u) ** 2 - 6 * u**2 * (1 - u) + u**3], axis=1)
    chords = np.concatenate([np.linspace(a, b, 20) for a, b in pairwise(ends)])
    assert max(np.linalg.norm(chords - p, axis=1).min() for p in curve) < 2e-3
    assert {(1, 1), (2, 1), (4, 0)} <= set(map(tuple, ends.tolist()))
    with pytest.raises(InputError, match="needs I J P Q"):
        read("G0 X0 Y0\nG5 P0 Q-3 X1 Y1 F100\n", "part.ngc")
    with pytest.raises(InputError, match="splines"):
        read("G0 X0 Y0\nG5 I0 J3 P0 Q-3 X1 Y1 F100\n", "part.nc")


@pytest.mark.parametrize(
    ("name", "condition", "holds"),
    [
        ("part.nc", "#2AND512EQ512", True), ("part.nc", "#1 EQ 3 OR 4", False), ("part.nc", "[#1GT2]AND[#1LT3]", False), ("part.nc", "#1AND1", True),
        ("part.nc", "5XOR4EQ1", True),
    ],
)  # fmt: skip
def test_and_or_xor_of_a_fanuc_work_on_bits(read, name: str, condition: str, holds: bool) -> None:
    text = f"#1=3\n#2=512\nG0 X0\nIF[{condition}]GOTO5\nX100.\nN5 X1.\n"
    assert ([100, 0] not in places(read(text, name))) is holds


def test_radius_and_angle_of_linuxcnc(read) -> None:
    text = "F100\nG1 X0 Y0\n@10 ^0\n^90\nG91 @5\n^90\nG90 @3\nG81 @5 ^180 Z-1 R1\nG80\nM2\n"
    ends = places(read(text, "part.ngc"))
    assert ends[:6] == [[0, 0], [10, 0], [0, 10], [0, 15], [-15, 0], [-3, 0]]
    assert ends[-1] == [-5, 0]
    with pytest.raises(InputError, match="stand for X and Y"):
        read("G1 F100 X1 @10\n", "part.ngc")
    with pytest.raises(InputError, match="starts no word"):
        read("G1 F100 @10\n", "part.nc")


def test_radius_by_h(read) -> None:
    assert places(read("G10 L12 P19 R2.\nG1 X0 Y0 F100\nG42 H19 X10. Y5.\nX20.\nG40 X30.\n", "part.nc"))[1:] == [[10, 3], [20, 3], [30, 5]]


def test_one_list_of_offsets(read) -> None:
    """G10 P R without L of a Fanuc sets an offset, not a zero offset."""
    program = read("G10 P3 R2.\nG1 X5. F100\nG41 D3 X6. Y5.\nG1 Y20.\nG40 X50.\n", "part.nc")
    assert [x for x, _ in places(program)] == [5, 4, 4, 50]


def test_jumps_of_macros(read) -> None:
    """Behind an assignment, and to a computed block; a call from another memory; commands that print."""
    program = read(
        "#1=10\nG0 X0\nDPRNT[X#1[53]]\nGOTO[#1+10]\nG0 X100.\nN20 X5.\n#2=30 GOTO30\nX200.\nN30 M198 P7\nM30\nO7\nX3.\nM99\n", "part.nc"
    )
    assert [x for x, _ in places(program)] == [5, 3]


def test_values_of_the_control_from_the_machine_file(read, mikron) -> None:
    from dataclasses import replace

    machine = replace(mikron, document={**mikron.document, "variables": {"#1004": 7.0, "#<_ini[a]b>": 2.0}})
    assert places(read("G0 X0\nX#1004\n", "part.nc", machine=machine))[-1] == [7, 0]
    assert places(read("G0 X0\nX#<_ini[a]b>\nM2\n", "part.ngc", machine=machine))[-1] == [2, 0]
    with pytest.raises(InputError, match=r"\[variables\]"):
        read("G0 X0\nX#1004\n", "part.nc")


def test_a_label_that_occurs_twice(read) -> None:
    """GOTOB goes to the last one before, GOTOF to the next one behind."""
    assert places(read("G1 X0 F100\nAA: R1=R1+1\nX=R1\nIF R1<2 GOTOB AA\nGOTOF AA\nX99\nAA: X=R1+10\n"), 1)[1:] == [[1], [2], [12]]


@pytest.mark.parametrize("name", ["part.nc", "part.ngc"])
def test_a_second_g92_counts_from_the_machine(read, name: str) -> None:
    """Each G92 gives the place of the tool its coordinates, whatever the one before did."""
    assert places(read("G90 G1 X0 Y0 F100\nG92 X5\nX8\nG92 X0 Y1\nX3 Y2\n", name))[1:] == [[3, 0], [6, 1]]


@pytest.mark.parametrize("sense", [2, 3])
def test_arc_by_its_angle(read, sense: int) -> None:
    """AR= with the end: a quarter circle about (5, 5), or (5, -5) clockwise; with the centre (10, 0): to (10, -10), or (10, 10) clockwise."""
    up = 1 if sense == 3 else -1
    moves = read(f"G0 X0 Y0\nG{sense} X10 Y0 AR=90 F100\n").moves
    np.testing.assert_allclose(moves.centre[0, :2], [5e-3, up * 5e-3], atol=1e-12)
    np.testing.assert_allclose([moves.angle[0], moves.normal[0, 2]], [np.pi / 2, up], atol=1e-12)
    moves = read(f"G0 X0 Y0\nG{sense} I10 J0 AR=90 F100\n").moves
    np.testing.assert_allclose(moves.target[0, :2], [10e-3, -up * 10e-3], atol=1e-12)
    np.testing.assert_allclose(moves.angle[0], np.pi / 2, atol=1e-12)


@pytest.mark.parametrize("name", ["part.mpf", "part.nc", "part.ngc"])
def test_plunge_before_the_approach(read, name: str) -> None:
    """A move of Z alone between G41 and the first move in the plane is made where the tool stands, not on the way to the contour."""
    tool, d = ("$TC_DP6[1,1]=3\nT1 D1\n", "") if name == "part.mpf" else ("", "41.1 D6" if name == "part.ngc" else " D1")
    tool = "G10 L12 P1 R3.\n" if name == "part.nc" else tool
    program = read(f"{tool}G0 X0 Y0 Z10\nG1 F1000 G41{d.removeprefix('41')}\nZ-5\nX10 Y0\nX20\nY10\nG40 X30\nM30\n", name)
    assert places(program, 3)[0] == [0, 0, -5]
    assert all(place[2] == -5 for place in places(program, 3))


def test_frames_in_variables(read) -> None:
    """DEF FRAME, chains of frames with names in them, and a component; F1 turns by 90 degrees about (10, 5)."""
    text = "DEF FRAME F1, F2=CTRANS(X,5)\nF1=CTRANS(X,10,Y,5):CROT(Z,90)\n$P_UIFR[1]=F1\nG54 G0 X0 Y0\nX10\n"
    text += "$P_PFRAME=F2:CTRANS(Y,2)\nX0 Y0\nF1[X,TR]=20\n$P_PFRAME=F1\nX0 Y0\n"
    assert places(read(text)) == [[10, 15], [8, 10], [5, 25]]
    with pytest.raises(InputError, match="is not a frame"):
        read("DEF FRAME F1\nF1=9\nG1 X1 F100\n")
    with pytest.raises(InputError, match="variable 'F9' has no value"):
        read("DEF FRAME F1\nF1=F9\nG1 X1 F100\n")


@pytest.mark.parametrize(
    ("call", "pauses"),
    [
        ("CYCLE81(5,0,1,-2,0,1.5)", [1.5]),
        ("CYCLE82(5,0,1,-2,0,10,0,1,12)", [10]),
        ("CYCLE82(5,0,1,-2,0,10,0,1,22)", [6]),
        ("CYCLE82(5,0,1,-2,0,-10)", [6]),
        ("CYCLE83(5,0,1,-2,0,-1,,0,0.5,0,1,0,0,0,0,2)", [0.5, 2]),
    ],
)
def test_dwells_of_drilling_cycles(write, mikron, call: str, pauses: list[float]) -> None:
    """DTB in s or, negative or with the second digit of _AMODE, in turns (100 1/min); _DTD at the bottom."""
    out = understand(write(f"G0 X0 Z9\nF100 S100\n{call}\n"), mikron)
    assert list(out.pauses.values()) == pauses


@pytest.mark.parametrize(("unit", "feed"), [(0, 200), (1, 200), (2, 25.4e3 / 2 / 10), (3, 5080), (4, 200 * np.pi)])
def test_pitches_of_taps(write, mikron, unit: int, feed: float) -> None:
    """_PITA: mm, threads an inch, inches, modules."""
    pitch = 20 if unit == 2 else 2
    out = understand(write(f"G0 X0 Z9\nCYCLE84(5,0,1,-2,0,0,3,,{pitch},0,100,100,3,{unit})\n"), mikron)
    assert out.feeds[out.kinds.index(LINE)] == pytest.approx(feed if unit != 2 else 25.4 / 20 * 100)


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ("CYCLE83(5,0,1,-2,0,-1,,0,0,0,1,0,1)", "geometry axis 1"),
        ("MCALL CYCLE81(5,0,1,-2)\nCYCLE802(111111112,111111111,3,4)", "incremental places"),
        ('MCALL CYCLE81(5,0,1,-2)\nHOLES2(1,2,5,10,20,3,1000,1,"10")', "with omitted places"),
        ("G147 G41 DISR=5 X5", "soft approach"),
        ("REPOSL", "interrupted contour"),
        ("DISC=50", "DISC=50"),
    ],
)
def test_unsupported_arguments_of_a_cycle_are_refused(read, block: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(f"G1 X1 F100 S100\n{block}\nG1 X5\n")


@pytest.mark.parametrize(
    ("name", "text", "language"),
    [
        ("part.nc", "O7700(MACRO)\n(#1=A)\n\nIF[#1EQ#0]GOTO10\nG0X1.\nN10\nM99\n", "iso"),
        ("part.tap", "( X= 100.000, Y= 100.000, Z= 10.000)\n(Tools: T=\"A\")\nN1G00G21G17G90\nN2G1X1F100\n", "iso"),
        ("part.nc", "o<x> sub\nG1 X1\no<x> endsub\n", "linuxcnc"),
        ("part.nc", "o100 if [1]\nG1 X1\no100 endif\n", "linuxcnc"),
        ("part.nc", "MSG(\"A\")\nG1 X=R1 F100\nCYCLE832(0.1,1)\n", "sinumerik"),
    ],
)  # fmt: skip
def test_the_language_of_a_file_is_detected(write, name: str, text: str, language: str) -> None:
    assert dialect(ProgramText(write(text, name))) == language


@pytest.mark.parametrize(
    ("text", "language"),
    [
        ("%12\nN10 G0 G52 Z0\nN20 G77 N30 N40\n", "NUM"),
        ("%@MACRO\n@1 := 5;\nG0 X@1;\n", "SYNTEC"),
        ("%PART,MX--\nG0 X0\n", "FAGOR"),
        ("%L UP1\nG0 X1\nM17\n%MAIN\nLL UP1\n", "ISG"),
        ("sub change_tool\nG0 X1\nendsub\n", "Eding"),
        ("N1 R101=1\nN220 @136 R101 K50 K300\nN250 @100 K-220\n", "810"),
        ("M104 S200\nG28\nG1 X1 E2.5 F100\n", "3-D printer"),
    ],
)
def test_other_languages_are_named(write, text: str, language: str) -> None:
    with pytest.raises(InputError, match=language):
        dialect(ProgramText(write(text, "part.nc")))


def test_parameters_of_a_zero_offset_begin_with_its_x(read) -> None:
    """#5221 is X of G54, #5242 Y of G55, #5230 the rotation of G54."""
    assert places(read("G10 L2 P1 X7. Y3.\nG10 L2 P2 X1. Y2.\nG1 X#5221 Y#5242 F100\n", "part.ngc")) == [[14, 5]]
    assert places(read("#5221=7.\nG54\nG1 X1. Y1. F100\n", "part.nc")) == [[8, 1]]
    assert places(read("G10 L2 P1 R90.\nG1 X#5230 F100\n", "part.ngc")) == [[0, 90]]


def test_linuxcnc_has_30_parameters_of_a_subprogram(read) -> None:
    assert places(read("#30=10\n#31=11\n#33=13\nG1 X#30 Y#31 F100\nX#33\n", "part.ngc")) == [[10, 11], [13, 11]]


def test_arrays_of_a_sinumerik_are_filled(read) -> None:
    text = "DEF REAL A[3]=REP(5)\nDEF REAL B[2,2]=SET(1,2,3,4)\nDEF REAL C[3]=SET(7,8)\nG1 X=A[0] Y=A[2] F100\nX=B[0,1] Y=B[1,1]\nX=C[1] Y=C[2]\n"
    assert places(read(text)) == [[5, 5], [2, 4], [8, 0]]


@pytest.mark.parametrize(("name", "word"), [("part.ngc", "G53"), ("part.mpf", "SUPA")])
def test_all_axes_of_a_block_in_machine_coordinates_are_absolute(read, name: str, word: str) -> None:
    program = read(f"G0 X1 A5\nG91\n{word} G0 X10 A10\n{word} G0 X10 A10\n", name)
    assert np.allclose(program.moves.target[1:, 0], 10e-3)
    assert np.allclose(np.degrees(program.moves.target[1:, 3]), 10.0)


def test_inverse_time_feed_is_asked_for_in_every_block(read) -> None:
    for text in ("G93\nG1 X10. F2\nX20.\n", "G90 G93\nG1 X10. F2\nX20.\n"):
        with pytest.raises(InputError, match="every block needs its own F"):
            read(text, "part.nc")


def test_a_modal_macro_is_not_called_by_its_own_moves(read) -> None:
    text = "G90 G0 X0 Y0 Z0\nG66 P9100 Z5.\nX10.\nX20.\nG67\nX30.\nM30\nO9100\nG0 Z#26\nG0 Z0.\nM99\n"
    assert places(read(text, "part.nc"), 3) == [[10, 0, 0], [10, 0, 5], [10, 0, 0], [20, 0, 0], [20, 0, 5], [20, 0, 0], [30, 0, 0]]


def test_a_code_of_the_machine_builder_leaves_the_words_of_the_move(read) -> None:
    (end,) = places(read("G0 X1. Y0\nG2 X11. Y0. R5. F100 M123\n", "part.nc"))[-1:]
    assert end == [11, 0]
    assert places(read("G1 X5. F100 M123 P7\n", "part.nc")) == [[5, 0]]


def test_a_number_of_four_hundred_digits_is_refused(read) -> None:
    with pytest.raises(InputError, match="the number is too large"):
        read(f"O1\nG1 X1. F100\nM{'9' * 400}\n", "part.nc")


def ends_of(out, row: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (2,) of the motion at the start and the end of a move in the plane."""
    start, end = (np.array(out.targets[k][:3]) for k in (row - 1, row))
    if row not in out.arcs:
        ways = [end - start] * 2
    else:
        centre, normal, _ = out.arcs[row]
        ways = [np.cross(normal, p - centre) for p in (start, end)]
    return ways[0][:2] / np.linalg.norm(ways[0]), ways[1][:2] / np.linalg.norm(ways[1])


def test_a_rounding_is_a_tangent_to_the_lines_and_arcs_on_both_sides(write, mikron) -> None:
    """Random corners of lines and arcs: without a corner left, with the radius of RND, ends kept; SINUMERIK and Klartext agree."""
    rng, rounded = np.random.default_rng(3), 0
    for _ in range(60):
        corner, end = rng.uniform(20, 60, 2), rng.uniform(20, 60, 2)
        size, sizes, senses = rng.uniform(0.5, 3.0), rng.uniform(25, 60, 2), rng.integers(0, 3, 2)  # 0 line, 1 and 2 arcs
        siemens, klartext = "G0 X0 Y0\nF500\n", "BEGIN PGM A MM\nL X+0 Y+0 FMAX\n"
        for k, (x, y) in enumerate((corner, end)):
            word = f"G{(1, 2, 3)[senses[k]]} X{x:.4f} Y{y:.4f}" + (f" CR={sizes[k]:.4f}" if senses[k] else "")
            siemens += word + (f" RND={size:.4f}\n" if k == 0 else "\n")
            arc = f" R{sizes[k]:.4f} DR{'-+'[senses[k] - 1]}" if senses[k] else ""
            klartext += f"{'CR' if senses[k] else 'L'} X{x:+.4f} Y{y:+.4f}{arc} F500\n" + (f"RND R{size:.4f}\n" if k == 0 else "")
        try:
            out = understand(write(siemens, "a.mpf"), mikron)
        except InputError as error:
            if not any(text in str(error) for text in ("does not fit", "less than half")):
                raise
            continue
        other = understand(write(klartext + "END PGM A MM\n", "a.h"), mikron)
        assert np.allclose([t[:3] for t in out.targets], [t[:3] for t in other.targets], atol=1e-12)
        rounded += 1
        assert len(out.kinds) == 4
        assert out.targets[3][:2] == pytest.approx(end * 1e-3, abs=1e-7)
        assert np.linalg.norm(np.array(out.targets[1][:3]) - out.arcs[2][0]) == pytest.approx(size * 1e-3, abs=1e-7)
        for row in (1, 2):
            assert ends_of(out, row)[1] == pytest.approx(ends_of(out, row + 1)[0], abs=1e-6)
        for row, sense in ((1, senses[0]), (3, senses[1])):
            assert (row in out.arcs) == bool(sense)
    assert rounded > 25


@pytest.mark.parametrize("text", ["G1 X10 F100\nCT X20 Y10\n", "G1 X10 F100 M8\nCT X20 Y10\n", "X10 Y0 F100\nG4 F1\nCT X20 Y10\n"])
def test_a_tangent_arc_goes_on_behind_any_line(write, mikron, text: str) -> None:
    """Also behind a block of coordinates alone, and behind a dwell."""
    out = understand(write(text), mikron)
    centre, _, angle = out.arcs[len(out.kinds) - 1]
    assert centre == pytest.approx([0.01, 0.01, 0.0])
    assert angle == pytest.approx(np.pi / 2)
