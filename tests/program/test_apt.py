"""The APT / CL reader."""

import math

import numpy as np
import pytest

from twin.errors import InputError
from twin.program import interpolate, read_program
from twin.program.moves import ARC, LINE, RAPID


@pytest.fixture
def read(mikron, tmp_path):
    """Reads a text as CL data."""

    def reader(text: str):
        path = tmp_path / "part.apt"
        path.write_text(text)
        return read_program(path, mikron)

    return reader


def test_statements(read) -> None:
    program = read(
        "PARTNO/X\n$$ comment\nUNITS/MM\nFROM/0,0,160,0,0,1\nRAPID\nGOTO/0,0,150\n"
        "FEDRAT/600,MMPM\nGOTO/10,0,150,0,$\n -1,1\nGODLTA/0,5,0\nFINI\nGOTO/99,0,0\n"
    )
    assert program.moves.kind.tolist() == [RAPID, LINE, LINE]
    assert np.allclose(program.moves.target[1:, :3] * 1e3, [[10, 0, 150], [10, 5, 150]])
    assert np.allclose(np.degrees(program.moves.target[:, 3]), [0, -45, -45])
    assert program.moves.feed[1] == pytest.approx(0.01)
    assert program.moves.traori.all()
    assert program.moves.line.tolist() == [6, 8, 10]


@pytest.mark.parametrize("end", ["$", " $\n", "$\n\n", "$ $$ comment\n"])
def test_a_last_statement_that_wants_to_go_on_is_read(read, end: str) -> None:
    assert np.allclose(read("FROM/0,0,150\nFEDRAT/600\nGOTO/1,0,150\nGOTO/2,0,150" + end).moves.target[:, 0] * 1e3, [1, 2])


def test_radius_compensation_may_be_switched_off(read) -> None:
    assert len(read("FROM/0,0,150\nFEDRAT/600\nCUTCOM/OFF\nGOTO/1,0,150\n")) == 1


def test_inches(read) -> None:
    program = read("UNITS/INCHES\nFROM/0,0,6\nFEDRAT/10,IPM\nGOTO/1,0,6\n")
    assert program.moves.target[0, 0] == pytest.approx(0.0254)
    assert program.moves.feed[0] == pytest.approx(10 * 0.0254 / 60)


def test_circle(read) -> None:
    program = read("FROM/10,0,150\nFEDRAT/600\nCIRCLE/0,0,150,0,0,1,10\nGOTO/0,10,150\nCIRCLE/0,0,150,0,0,-1,10\nGOTO/10,0,150\n")
    assert program.moves.kind.tolist() == [ARC, ARC]
    assert program.moves.angle.tolist() == pytest.approx([math.pi / 2, math.pi / 2])


def test_the_whole_way(read, mikron) -> None:
    trace = interpolate(read("FROM/0,0,150\nFEDRAT/3000\nGOTO/10,0,150,0.1,-0.1,1\n"), mikron)
    assert trace.get("program", "path_speed").max() <= 0.05 * 1.001


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("GOTO/1,2,150", "line 1: no feed"),
        ("FEDRAT/100\nFOO/3", "line 2: statement 'FOO' is not known"),
        ("FEDRAT/100\nGOTO/1,2,X", "not all values are numbers"),
        ("FEDRAT/100\nGOTO/1,2", "2 values"),
        ("FEDRAT/1,MMPR\nGOTO/1,0,150\n", "needs a spindle speed"),
        ("SPINDL/50-1,RPM\nFEDRAT/1,MMPR\nGOTO/1,0,150\n", "line 1: SPINDL/50-1: not all values are numbers"),
        ("FROM/10,0,150\nFEDRAT/6\nCIRCLE/0,0,150,0,0,1,5\nGOTO/0,10,150", "does not close"),
        ("FEDRAT/100\nGOTO/1,2,150,0,0,0", "no length"),
        ("PARTNO/NOTHING", "moves no axis"),
        ("$$-> CUTCOM_GEOMETRY_TYPE / OUTPUT_ON_PROFILE\nCUTCOM/LEFT\nGOTO/1,2,150", "line 2: CUTCOM/LEFT is not supported, since"),
        ("FEDRAT/100\nGOTO/1,2,$", "line 2: GOTO/1,2,: not all values"),
        ("GOTO/1,$\n" * 3000, "too many lines"),
    ],
)
def test_bad_input(read, text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(text)


def test_an_arc_as_catia_writes_it(read) -> None:
    """INDIRV says the sense, the line through centre and end point the end; beyond half a turn it is the second meeting."""
    head = "UNIT/MM\nTLAXIS/0,0,1\nFROM/10,0,150\nFEDRAT/600,MMPM\nINDIRV/0,1,0\n"
    quarter = read(head + "TLON,GOFWD/ (CIRCLE/ 0,0,150,$\n 10),ON,(LINE/ 0,0,150,$\n 0,10,150)\nGOTO/0,20,150\n")
    assert quarter.moves.kind.tolist() == [ARC, LINE]
    assert quarter.moves.angle[0] == pytest.approx(math.pi / 2)
    assert np.allclose(quarter.moves.target[0, :3] * 1e3, [0, 10, 150])
    wide = read(head + "TLON,GOFWD/(CIRCLE/0,0,150,10),ON,2,INTOF,(LINE/0,0,150,0,-10,150)\nGOTO/0,20,150\n")
    assert wide.moves.angle[0] == pytest.approx(1.5 * math.pi)
    other = read(head.replace("0,1,0", "0,-1,0") + "TLON,GOFWD/(CIRCLE/0,0,150,10),ON,(LINE/0,0,150,0,-10,150)\nGOTO/0,20,150\n")
    assert other.moves.angle[0] == pytest.approx(math.pi / 2)
    assert np.allclose(other.moves.normal[0], [0, 0, -1])
    plane = read(head + "TLON,GOFWD/(CIRCLE/CANON,0,0,150,0,0,1,10),ON,(PLANE/0,1,0,6)\nGOTO/0,20,150\n")
    assert np.allclose(plane.moves.target[0, :3] * 1e3, [8, 6, 150])


def test_a_frame_places_what_follows(read) -> None:
    """MSYS turned by 90 degrees about z and shifted: x of the data is y of the part, and so for the tool axis and arcs."""
    program = read(
        "FROM/0,0,150\nFEDRAT/600\nMSYS/5,0,0,0,1,0,-1,0,0\nGOTO/10,0,150,0,1,10\nCIRCLE/0,0,150,0,0,1,10\nGOTO/0,10,150,0,0,1\n"
    )
    assert np.allclose(program.moves.target[:, :3] * 1e3, [[5, 10, 150], [-5, 0, 150]])
    assert np.allclose(program.moves.centre[1] * 1e3, [5, 0, 150])
    assert any("MSYS" in note for note in program.notes)
    plain = read("FROM/0,0,150\nFEDRAT/600\nMSYS/0,0,0,1,0,0,0,1,0\nGOTO/10,0,150\n")
    assert not any("MSYS" in note for note in plain.notes)


def test_a_drilling_cycle_strokes_along_the_tool_axis(read) -> None:
    for cycle in ("CYCLE/DRILL,20,300,MMPM,5", "CYCLE/DRILL,FEDTO,-20,RTRCTO,5,MMPM,300", "CYCLE/DRILL,DEPTH,20,MMPM,300,CLEAR,5"):
        program = read(f"FROM/0,0,250\nFEDRAT/600\n{cycle}\nGOTO/10,0,150\nGOTO/20,0,150\nCYCLE/OFF\nGOTO/20,0,200\n")
        assert program.moves.kind.tolist() == [RAPID, LINE, RAPID, RAPID, LINE, RAPID, LINE]
        assert np.allclose(program.moves.target[:3, 2] * 1e3, [155, 130, 155])
        assert program.moves.feed[1] == pytest.approx(0.005)


def test_a_feed_per_revolution_takes_the_spindle_speed(read) -> None:
    program = read("FROM/0,0,150\nSPINDL/2000,RPM,CLW\nFEDRAT/0.1,MMPR\nGOTO/10,0,150\n")
    assert program.moves.feed[0] == pytest.approx(0.2 / 60)


def test_operator_text_is_not_a_statement(read) -> None:
    program = read("PPRINT OPERATION NAME : Tool Change.1\nTPRINT/T1 End Mill D 10\nFROM/0,0,150\nFEDRAT/600\nGOTO/10,0,150\nEND\n")
    assert program.moves.kind.tolist() == [LINE]


def test_points_of_rhinocam_stand_in_the_world_and_csys_is_the_tool(read) -> None:
    """TRNTYP/WORLD: CSYS moves no point; its z axis is that of a GOTO with three values, also after a tilted operation."""
    plane = "TRNTYP/WORLD,0,0,0\nCSYS/{}\n"
    level, side = "1,0,0,5,0,1,0,5,0,0,1,5", "0,-0.8,-0.6,0,1,0,0,0,0,-0.6,0.8,0"
    text = plane.format(side) + "CSI_SET_FLUTE_LENGTH/5.\nFEDRAT/600,MMPM\nRAPID/\nGOTO/0,0,150,-0.6,0,0.8\nGOTO/1,2,150,-0.6,0,0.8\n"
    program = read(text + plane.format(level) + "GOTO/10,0,150\n")
    assert np.allclose(program.moves.target[:, :3] * 1e3, [[1, 2, 150], [10, 0, 150]])
    assert np.allclose(np.degrees(program.moves.target[:, 3]), [-math.degrees(math.atan2(0.6, 0.8)), 0.0])
    with pytest.raises(InputError, match="TRNTYP"):
        read("TRNTYP/LOCAL,0,0,0\n")


def test_circle_without_radius_and_arc_with_an_angle(read) -> None:
    program = read("FROM/10,0,150\nFEDRAT/600\nCIRCLE/0,0,150,0,0,1\nGOTO/0,10,150\nMOVARC/0,0,150,0,0,1,10,ANGLE,90\nGOTO/10,0,150\n")
    assert program.moves.angle.tolist() == pytest.approx([math.pi / 2, math.pi / 2])
    assert program.moves.normal[:, 2].tolist() == [1.0, -1.0]  # the angle says that the second turns back
    with pytest.raises(InputError, match="ANGLE says"):
        read("FROM/10,0,150\nFEDRAT/600\nMOVARC/0,0,150,0,0,1,10,ANGLE,45\nGOTO/0,10,150\n")


def test_a_feed_per_revolution_waits_for_its_speed(read) -> None:
    program = read("FROM/0,0,150\nFEDRAT/0.3,MMPR\nSPINDL/200,RPM,CLW\nGOTO/10,0,150\nSPINDL/400,RPM,CLW\nGOTO/20,0,150\n")
    assert program.moves.feed.tolist() == pytest.approx([0.06 / 60, 0.12 / 60])
    with pytest.raises(InputError, match="spindle speed"):
        read("FROM/0,0,150\nFEDRAT/0.3,MMPR\nGOTO/10,0,150\n")


def test_holes_are_left_to_the_retract_height(read) -> None:
    program = read("FROM/0,0,180\nCYCLE/DRILL,RAPTO,3,FEDTO,-10,MMPM,200,RTRCTO,20\nGOTO/10,0,150\nGOTO/30,0,150\nCYCLE/OFF\n")
    heights = (program.moves.target[:, 2] * 1e3).round(6).tolist()
    assert heights == [170, 153, 140, 153, 170, 170, 153, 140, 153, 170]
    assert program.moves.kind.tolist() == [RAPID, RAPID, LINE, RAPID, RAPID] * 2


def test_an_arc_of_turning_stands_on_edge(read) -> None:
    program = read(
        "FROM/0,39.9,151.1\nFEDRAT/600\nINDIRV/0,1,0\nTLON,GOFWD/(CIRCLE/0,39.9,149.9,1.2),ON,(LINE/0,39.9,149.9,0,41.1,149.9)\n"
    )
    assert np.allclose(program.moves.target[-1, :3] * 1e3, [0, 41.1, 149.9])
    assert program.moves.angle[-1] == pytest.approx(math.pi / 2)


def test_a_shift_by_zero_has_no_effect(read) -> None:
    program = read("ORIGIN/0.0,0,0\nFROM/0,0,150\nFEDRAT/600\nTRANS/0,0,0\nGOTO/10,0,150\n")
    assert (program.moves.target[-1, :3] * 1e3).tolist() == pytest.approx([10, 0, 150])
    for shift in ("ORIGIN/0,0,1", "TRANS/5,0,0", "ORIGIN/0,0", "COPY/0,0,0"):
        with pytest.raises(InputError, match="not simulated"):
            read(f"{shift}\nFROM/0,0,150\n")
