"""The Sinumerik reader: each word does one thing, loops run as on the control, and what is not understood is reported."""

import math

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import Machine, load_machine, write_machine
from twin.program import interpolate, read_program
from twin.program.expressions import SINUMERIK, Expression, WordError
from twin.program.moves import ARC, DWELL, LINE, RAPID
from twin.program.sinumerik_values import split_words


@pytest.fixture
def with_tools(mikron, tmp_path):
    """Reads the Mikron back from a file to which a text has been added."""

    def reader(text: str) -> Machine:
        path = tmp_path / "machine.toml"
        write_machine(mikron, path)
        path.write_text(path.read_text() + text)
        return load_machine(path)

    return reader


def targets(program) -> np.ndarray:
    """Targets in mm and deg, rounded."""
    return np.round(program.moves.target * [1e3, 1e3, 1e3, 180 / math.pi, 180 / math.pi], 6)


def test_words_of_a_block() -> None:
    words = split_words('N10 G1X-1.5Y=R1+2 A3=.5 CR=(1+2)*3 G641ADIS=0.5 MSG("A;(B") TRAORI')
    assert [(w.name, w.value if w.value is not None else w.text) for w in words] == [
        ("N", 10), ("G", 1), ("X", -1.5), ("Y", "R1+2"), ("A3", ".5"), ("CR", "(1+2)*3"), ("G", 641), ("ADIS", "0.5"),
        ("MSG", '"A;(B"'), ("TRAORI", None),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1+2*3", 7),
        ("-(2-5)*2", 6),
        ("SIN(30)*4", 2),
        ("7 DIV 2", 3),
        ("7 MOD 4", 3),
        ("R5/4", 2.5),
        ("R5>9 AND NOT R6", 1),
        ("ATAN2(1,1)", 45),
        ("ROUND(0.5)", 1),  # half away from zero, not to the even neighbour
        ("ROUND(2.5)", 3),
        ("ROUND(-2.5)", -3),
        ("ROUND(2.49)", 2),
        ("ROUND(0.49999999999999994)", 0),
    ],
)
def test_arithmetic(text: str, value: float) -> None:
    assert evaluate(text) == pytest.approx(value)


def evaluate(text: str):
    """The value of a SINUMERIK expression in which R5 is 10 and other parameters are 0."""
    return Expression(text, SINUMERIK, lambda e, name, at: {"R5": 10.0, "R6": 0.0}[name]).whole()


@pytest.mark.parametrize("text", ["1+", "(1", "1/0", "SQRT(-1)", "1 2", "", "(" * 500 + "1"])
def test_bad_arithmetic_is_an_error_with_a_column(text: str) -> None:
    with pytest.raises(WordError):
        evaluate(text)


def test_modes_and_coordinates(read) -> None:
    program = read("N10 G710 G90\nG1 X10 Y=20 F600 ; comment\nG91 X1 Y=AC(5)\nG90 Y=IC(1) A-20 C=DC(350)\nG0 X0\n")
    assert targets(program).tolist() == [[10, 20, 0, 0, 0], [11, 5, 0, 0, 0], [11, 6, 0, -20, -10], [0, 6, 0, -20, -10]]
    assert program.moves.kind.tolist() == [LINE, LINE, LINE, RAPID]
    assert program.moves.feed[0] == pytest.approx(0.01)
    assert np.isinf(program.moves.feed[3])
    assert program.moves.line.tolist() == [2, 3, 4, 5]


def test_a_first_rapid_is_the_start(read) -> None:
    program = read("G0 X10 Z5\nG1 X20 F100\n")
    assert np.allclose(program.start, [0.01, 0, 0.005, 0, 0])
    assert len(program) == 1


def test_inches(read) -> None:
    assert np.allclose(read("G70\nG1 X1 F100\n").moves.target[0, 0], 0.0254)
    assert read("G70\nG1 X1 F100\n").moves.feed[0] == pytest.approx(0.1 / 60)  # G70: feed stays in mm
    assert read("G700\nG1 X1 F100\n").moves.feed[0] == pytest.approx(2.54 / 60)


def test_feeds(read) -> None:
    assert read("G93 G1 X60 F2\n").moves.feed[0] == pytest.approx(0.06 * 2 / 60)
    assert read("G95 S1000 G1 X60 F0.1\n").moves.feed[0] == pytest.approx(0.1 / 60)
    turn = read("G1 C90 F360\n")
    assert turn.moves.rotary[0]
    assert turn.moves.feed[0] == pytest.approx(2 * math.pi / 60)


@pytest.mark.parametrize(
    ("block", "centre", "angle"),
    [
        ("G2 X10 Y0 CR=5", (5, 0), math.pi),
        ("G3 X10 Y0 I5 J0", (5, 0), math.pi),
        ("G3 X10 Y10 CR=10", (0, 10), math.pi / 2),
        ("G3 X10 Y10 CR=-10", (10, 0), 3 * math.pi / 2),
        ("G2 X0 Y0 I=AC(5) J=AC(0)", (5, 0), 2 * math.pi),
        ("G3 X0 Y0 Z4 I5 J0 TURN=1", (5, 0), 4 * math.pi),
    ],
)
def test_arcs(read, block: str, centre: tuple[float, float], angle: float) -> None:
    program = read(f"G1 X0 Y0 F1000\n{block}\n")
    row = len(program) - 1
    assert program.moves.kind[row] == ARC
    assert np.allclose(program.moves.centre[row, :2] * 1e3, centre, atol=1e-6)
    assert program.moves.angle[row] == pytest.approx(angle)


def test_arcs_by_radius_in_the_iso_dialect(read) -> None:
    program = read("#5=2\nG1 X0 Y0 F1000\nG2 X2 Y0 R1\nG3 X[#5-2] Y0 R-1.25\n", "part.ngc")
    assert program.moves.kind.tolist()[-2:] == [ARC, ARC]
    assert np.allclose(program.moves.centre[-2:, :2] * 1e3, [[1, 0], [1, 0.75]], atol=1e-6)
    assert program.moves.angle[-2] == pytest.approx(math.pi)
    assert program.moves.angle[-1] > math.pi


def test_planes(read) -> None:
    program = read("G18 G1 X0 F1000\nG3 X10 Z10 I0 K10\n")
    assert np.allclose(program.moves.normal[-1], [0, 1, 0])


def test_stops_and_rounding(read) -> None:
    program = read("G60 G603\nG1 X1 F100\nG64 X2\nG9 X3\nG641 ADIS=0.3 X4\nCYCLE832(0.02,13,0.5)\nX5\nG642 X6\nX7\n")
    m = program.moves
    assert m.stop.tolist() == [True, False, True, False, False, False, True]
    assert m.distance[3] == pytest.approx(0.3e-3)
    assert m.tolerance[4:].tolist() == pytest.approx([20e-6] * 3)
    assert m.angle_tolerance[4] == pytest.approx(math.radians(0.5))


def test_dwell_and_switches(read) -> None:
    program = read("FFWOF BRISK\nG1 X1 F100\nG4 F0.5\nSOFT\nX2\n")
    assert program.moves.kind.tolist() == [LINE, DWELL, LINE]
    assert program.moves.pause[1] == 0.5
    assert program.moves.feed[2] == pytest.approx(0.1 / 60)  # the F of G4 is a time
    assert program.feedforward == "off"
    assert program.moves.brisk.tolist() == [True, True, False]


def test_frames_come_from_the_machine_file(read, mikron) -> None:
    from dataclasses import replace

    machine = replace(mikron, document={**mikron.document, "frame": {"G54": {"x_m": 0.01, "c_deg": 90.0}}})
    program = read("G54 G1 X1 C0 F100\nG53 G1 X1\nTRANS X2\nX1\nG500 X1\n", machine=machine)
    assert targets(program)[:, [0, 4]].tolist() == [[11, 90], [1, 90], [13, 90], [3, 90]]


TOOLS = """
[tool.T1]
length_m = 0.15
[tool.T5]
length_m = 0.2
[tool.DRILL]
length_m = 0.1
"""


@pytest.mark.parametrize(
    ("blocks", "lengths"),
    [
        ("MOVE", [0.12]),  # the tool of the model
        ("T5 D1/MOVE", [0.2]),
        ("T5/MOVE", [0.2]),  # with the tool comes its D1
        ("R1=1/T=R1/MOVE", [0.15]),
        ('T="DRILL"/MOVE', [0.1]),
        ("T1/T0/MOVE", [0.0]),
        ("T1/T0/D1/MOVE", [0.0]),  # the empty spindle
        ("T1 D0/MOVE/D1/MOVE", [0.0, 0.15]),
        ("D0 T1/MOVE", [0.0]),  # the block counts, not the order of its words
        ("T1 D0/H5/MOVE", [0.0]),  # H is an auxiliary function
        ("T1 M6/MOVE/T5/MOVE/M6/MOVE", [0.15, 0.15, 0.2]),  # T prepares, M6 changes
        ("T1 M6/T5 D0/MOVE/D1/MOVE", [0.0, 0.15]),
    ],
)
def test_tools_come_from_the_machine_file(read, with_tools, blocks: str, lengths: list[float]) -> None:
    text = "TRAORI\nG1 F1000\n" + blocks.replace("/", "\n").replace("MOVE", "X=IC(1) Z200")
    assert read(text, machine=with_tools(TOOLS)).moves.tool_length.tolist() == lengths


@pytest.mark.parametrize(
    ("blocks", "lengths"),
    [
        ("T1 M6/MOVE", [0.2]),  # a tool alone brings no length
        ("T1 M6/G43/MOVE", [0.15]),
        ("T5 M6/G43 H1/MOVE/G43 H0/MOVE", [0.15, 0.0]),
    ],
)
def test_tool_lengths_of_the_iso_dialect(read, with_tools, blocks: str, lengths: list[float]) -> None:
    text = "G43.4 H5\nG1 F1000\n" + blocks.replace("G43", "G43.4").replace("/", "\n").replace("MOVE", "G90 X1 Z200")
    assert read(text, "part.ngc", machine=with_tools(TOOLS)).moves.tool_length.tolist() == lengths


def test_without_traori_the_tip_of_the_tool_in_the_spindle_moves(read, with_tools) -> None:
    machine = with_tools(TOOLS)
    assert read("T1 D0\nG1 X1 F100\nT5\nX2\n", machine=machine).moves.tool_length.tolist() == [0.15, 0.2]
    assert read("G49\nG1 X1 F100\n", "part.ngc", machine=machine).moves.tool_length.tolist() == [0.12]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("part.mpf", "T6\nG1 X1 F1\n", "line 1, column 1: tool 6 is not in the table"),
        ("part.mpf", "T1 D2\nG1 X1 F1\n", "line 1, column 4: D2: .* use D1"),
        ("part.mpf", "G43 H1\nG1 X1 F1\n", "G43 is not supported: use T and D"),
        ("part.ngc", "G43 H6\nG1 X1 F1\n", "line 1, column 5: tool 6 is not in the table"),
        ("part.ngc", "H1\nG1 X1 F1\n", "write G43 H"),
    ],
)
def test_tools_that_are_not_there(read, with_tools, name: str, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(text, name, machine=with_tools(TOOLS))


def test_without_a_table_every_tool_is_that_of_the_model(read) -> None:
    program = read("TRAORI\nT7 D3\nG1 X1 Z200 F100\n")
    assert program.moves.tool_length.tolist() == [0.12]
    assert any("no table [tool]" in note for note in program.notes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[tool.T1]\nlenght_m = 0.15\n", r"machine.toml: \[tool.T1\]: unknown key 'lenght_m'; did you mean 'length_m'"),
        ('[tool.T1]\nlength_m = "long"\n', r"\[tool.T1\]: length_m = 'long': expected a number"),
        ("[tool.T1]\nlength_m = -0.1\n", r"\[tool.T1\]: length_m = -0.1: impossible"),
        ("[tool.T1]\n", r"\[tool.T1\]: 'length_m' is missing"),
        ("[tool]\nlength_m = 0.15\n", r"'tool' must hold one table for each tool; write \[tool.T1\]"),
        ("[[tool]]\nlength_m = 0.15\n", r"'tool' must hold one table for each tool; write \[tool.T1\]"),
    ],
)
def test_tool_tables_are_checked(with_tools, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        with_tools("\n" + text)


def test_loops(read) -> None:
    program = read(
        "R1=0\nNEXT:\nG1 X=R1 F100\nR1=R1+1\nIF R1<3 GOTOB NEXT\nREPEAT NEXT P=2\n"
        "PART: G91 X1\nREPEATB PART P=2\nGOTOF DONE\nX99\nDONE: M30\nX77\n"
    )
    assert targets(program)[:, 0].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]


@pytest.mark.parametrize(
    ("part", "x"),
    [
        ("PART1:/X1/IF R1==1/X2/ENDIF/REPEAT PART1 P=2", [1, 2, 3]),
        ("PART1:/X1/IF R1==0/X2/ELSE/X4/ENDIF/REPEAT PART1 P=1", [1, 3, 4, 6]),
        ("PART1:/X1/IF R1==1/X2/ELSE/X4/ENDIF/REPEAT PART1", [1, 5, 6, 10]),
        ("PART1:/X1/IF R1==1/ENDLABEL:/X2/ENDIF/REPEAT PART1", [1, 2]),  # the part ends among lines that are skipped
        ("PART1: X1/LAST1: IF R1==1/X2/ENDIF/REPEAT PART1 LAST1 P=2", [1, 2, 3]),
        ("PART1: X1/REPEAT PART1 P3", [1, 2, 3, 4]),
        ("R2=2/PART1: X1/LAST1: X2/X4/REPEAT PART1 LAST1 P=R2", [1, 3, 7, 8, 10, 11, 13]),
    ],
)
def test_repeat(read, part: str, x: list[float]) -> None:
    program = read("G91 G1 F100\n" + part.replace("/", "\n") + "\nX100\n")
    assert targets(program)[:, 0].tolist() == [*x, x[-1] + 100]


@pytest.mark.parametrize("inner", ["IF R2==1 ; no GOTO", "LABEL1: IF R2==1", "N10 IF R2==1"])
@pytest.mark.parametrize("end", ["ENDIF", "LABEL2: ENDIF"])
def test_a_false_if_skips_what_is_inside(read, inner: str, end: str) -> None:
    program = read(f"G1 F100\nIF R1==1\n{inner}\nX1\n{end}\nX2\n{end}\nX3\n")
    assert targets(program)[:, 0].tolist() == [3]


def test_structured_if(read) -> None:
    text = "R1={}\nIF R1==1\nG1 X1 F100\nELSE\nG1 X2 F100\nENDIF\nX5\n"
    assert targets(read(text.format(1)))[:, 0].tolist() == [1, 5]
    assert targets(read(text.format(0)))[:, 0].tolist() == [2, 5]


def test_traori_turns_vectors_into_angles(read) -> None:
    program = read("TRAORI\nG0 X0 Y0 Z150 A3=0 B3=0 C3=1\nG1 X10 A3=0 B3=-1 C3=1 F1000\nTRAFOOF\nG1 X0 F1000\n")
    assert np.allclose(targets(program)[0, 3:], [-45, 0], atol=1e-6)
    tip = program.kinematics.forward(
        np.concatenate(
            [program.kinematics.linear_axes(program.moves.target[:1, :3], program.moves.target[:1, 3:])[0], program.moves.target[0, 3:]]
        )
    )
    assert np.allclose(tip[0] * 1e3, [10, 0, 150], atol=1e-9)
    assert np.allclose(targets(program)[1, :2], [0, targets(program)[1, 1]])


def test_the_fast_way_reads_as_the_slow_one(read) -> None:
    blocks = ["N5 G1 X1.5 Y-2 Z.5 F100", "X2", "N7 G01 Z-1 A-3 C4", "G0 Y3", "X=1 F50", "G1 X-0.001Y7"]
    fast = read("\n".join(blocks))
    slow = read("\n".join(b + " M8" for b in blocks))
    assert np.array_equal(fast.moves.target, slow.moves.target)
    assert np.array_equal(fast.moves.feed, slow.moves.feed)
    assert np.array_equal(fast.moves.block, slow.moves.block)


def test_iso_comments(read) -> None:
    assert len(read("%\n(start)\nG21 G90\nG1 X1 (here) F100\nG61\nX2\nM2\n%\n", "part.ngc")) == 2


@pytest.mark.parametrize("values", ["REAL A,", "REAL A,,INT B", "[3]", "=3", ""])
def test_a_subprogram_whose_values_have_gaps_is_read_as_a_program(read, values: str) -> None:
    assert targets(read(f"PROC P({values})\nG1 X1 F100\nX5", "part.spf"))[:, 0].tolist() == [1, 5]


BAD = {
    "unknown word": ("G1 X1 F100\nN20 G1 X2 FOO=3", r"line 2, column 11 \(block N20\): word 'FOO' is not known"),
    "misspelt word": ("TRAORY", "did you mean 'TRAORI'"),
    "unknown G": ("G1 X1 F1\nG187", "line 2, column 1: G187 is not known"),
    "radius compensation": ("G41 X1", "radius of tool"),
    "missing feed": ("N10 G1 X10", r"line 1 \(block N10\): no feed"),
    "feed zero": ("G1 X10 F0", "feed is 0"),
    "revolutions without speed": ("G95 G1 X10 F1", "S a speed"),
    "arc that does not close": ("G1 X0 F1000\nN20 G2 X10 Y0 I4 J0", "does not close"),
    "radius too small": ("G1 X0 F1000\nG2 X30 CR=5", "does not close"),
    "arc without centre": ("G1 X1 F1\nG2 X2", "centre"),
    "arc given twice": ("G1 X0 F1000\nG2 X2 CR=1 I1", "twice"),
    "radius of the ISO dialect": ("G1 X0 F1000\nG2 X2 Y0 R1", "line 2, column 10: R is an R-parameter here .* CR="),
    "move beside a dwell": ("G1 X1 F1\nG4 F1 X10", "line 2.* G4 must be alone"),
    "frame beside a dwell": ("G1 X1 F1\nTRANS X1 G4 F1", "line 2.* G4 must be alone"),
    "two times": ("G1 X1 F1\nG4 F1 S3", "line 2.* G4 must be alone"),
    "dwell without time": ("G1 X1 F1\nG4", "line 2.* G4 must be alone in its block with one time"),
    "P beside a move": ("G1 X1 P5 F1", "P has no use"),
    "tool axis out of reach": ("TRAORI\nG0 X0 Y0 Z150\nG1 X5 A3=0 B3=1 C3=-0.9 F100", "line 3: tool axis .* travel"),
    "tool axis without length": ("TRAORI\nG1 X1 Z150 A3=0 B3=0 C3=0 F100", "no length"),
    "tool axis without TRAORI": ("G1 A3=1 B3=0 C3=0 F100", "TRAORI"),
    "outside travel": ("G0 X0\nG1 X1000 F1000", "line 2: axis X would go to 1000 mm, outside its travel -355"),
    "no motion": ("; nothing\nG17\nM30", "moves no axis"),
    "only the start": ("G0 X10\nM30", "moves no axis"),
    "empty": ("", "moves no axis"),
    "endless loop": ("HERE:\nGOTOB HERE", "does not end"),
    "no label": ("GOTOF NOWHERE", "no label"),
    "no ENDIF": ("IF R1==1\nG1 X1 F100", "ENDIF"),
    "open bracket": ("G1 X=(1+2 F100", "bracket"),
    "number missing": ("G1 X1 F100\nG1 X2 Y", "line 2, column 7: 'Y' needs a number"),
    "far too large": ("G1 X" + "9" * 400 + " F100", "line 1: a coordinate is too large"),
    "far too large to be squared": ("TRAORI\nG1 X1 Z150 F100\nN7 G1 X" + "9" * 300, r"line 3 \(block N7\): a coordinate is too large"),
    "frame and axis": ("DEF FRAME FA\n$P_PFRAME=FA:A", r"line 2, column 13: :\(frame, A\) has no value"),
    "sum of frames": ("R1=CTRANS(X,1)+CTRANS(X,2)", "frame, frame"),
    "length of a frame": ("R1=STRLEN(CTRANS(X,1))", "frame"),
    "capitals of a number": ("R1=TOUPPER(5)", r"TOUPPER\(5\) has no value"),
    "a frame in a cycle": ("F100\nCYCLE82(7,,1,CTRANS(X,1))", "line 2, column 14: argument 4 of the cycle is a frame"),
    "a frame as an axis": ("POS[CTRANS(X,1)]=3", r"POS\[frame\]: this machine has X Y Z A C"),
    "a name that is missing": ("R1=ISVAR()", "line 1, column 4: ISVAR needs a name"),
    "no text": ("G1 X1\x00\x01 F100", "no text"),
    "endless line": ("G1 X" + "1" * 100_000, "longer than"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_clear_line(read, name: str) -> None:
    text, message = BAD[name]
    with pytest.raises(InputError, match=message) as error:
        read(text)
    assert "\n" not in str(error.value)


def test_travel_between_block_ends_is_checked(read, mikron) -> None:
    program = read("G1 X350 F5000\nG3 X350 Y100 I0 J50\n")
    with pytest.raises(InputError, match="line 2: on the way axis X"):
        interpolate(program, mikron)


def test_a_gigabyte_without_line_end_is_reported_at_once(mikron, tmp_path) -> None:
    path = tmp_path / "huge.mpf"
    with path.open("wb") as file:
        file.write(b"G1 X1")
        file.truncate(1 << 30)  # a sparse file: a gigabyte of zeros in one line
    with pytest.raises(InputError, match="line 1"):
        read_program(path, mikron)


def test_binary_rubbish(mikron, tmp_path) -> None:
    rng = np.random.default_rng(5)
    for n in range(20):
        path = tmp_path / f"rubbish{n}.mpf"
        path.write_bytes(rng.bytes(5000))
        with pytest.raises(InputError):
            read_program(path, mikron)
