"""Files of controls: the examples of the manuals byte for byte, the law of their readers, and what is read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
import tomllib

import numpy as np
import pytest

from twin.cli.parser import main
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.remedy.advice import BACKLASH, PULSE, TABLE
from twin.remedy.change import Change
from twin.remedy.control_data import files_for
from twin.remedy.files import heidenhain, isg, linuxcnc, sinumerik
from twin.remedy.files.existing import Existing, existing, lines_of
from twin.remedy.files.table import Entry, ErrorTable

# LinuxCNC: the documentation's table of type 0, one of type 1, and the one in the comment of the source
TYPE_0 = "-1.000 -1.005 -0.995\n0.000 0.002 -0.003\n1.000 1.003 0.998\n"
TYPE_1 = "-1.000 0.005 -0.005\n0.000 0.002 -0.003\n1.000 0.003 -0.004\n"
OF_SOURCE = "0.000000 0.000000 -0.001279\n0.100000 0.098742 0.051632\n0.200000 0.171529 0.194216\n"


def trims(text: str, kind: int, at: tuple[float, ...], way: int) -> list[float]:
    """What LinuxCNC adds to the motor command [mm]: minus the error that the table corrects."""
    return list(-1e3 * linuxcnc.table_of(text, "X", "linear", kind).error(1e-3 * np.array(at), way))


def test_the_trims_that_linuxcnc_applies() -> None:
    at = (-2.0, -0.5, 0.0, 0.25, 0.5, 1.0, 3.0)
    assert trims(TYPE_0, 0, at, 1) == pytest.approx([0.005, 0.0015, -0.002, -0.00225, -0.0025, -0.003, -0.003], abs=1e-9)
    assert trims(TYPE_0, 0, at, -1) == pytest.approx([-0.005, -0.001, 0.003, 0.00275, 0.0025, 0.002, 0.002], abs=1e-9)
    assert trims(TYPE_1, 1, (-0.5, 0.5, 3.0), 1) == pytest.approx([0.0035, 0.0025, 0.003], abs=1e-9)
    assert trims(TYPE_1, 1, (-0.5, 0.5, 3.0), -1) == pytest.approx([-0.004, -0.0035, -0.004], abs=1e-9)
    assert trims(OF_SOURCE, 0, (0.05, 0.15), 1) == pytest.approx([0.000629, 0.014865], abs=1e-6)
    assert trims(OF_SOURCE, 0, (0.05, 0.15), -1) == pytest.approx([0.0248235, 0.027076], abs=1e-6)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# comment\n0 0 0\n", "line 1 is not three numbers: the loader stops there"),
        ("0 0 0\n\n1 0 0\n", "line 2 is not three numbers"),
        ("0 0 0\n1,0,0\n", "line 2 is not three numbers"),
        ("0 0 0\n0 1 1\n1 0 0\n", "line 2: its position does not increase: skipped"),
        ("".join(f"{i} 0 0\n" for i in range(300)), "line 257: more than 256 points"),
        (f"0 0 0{' ' * 260}\n1 0 0\n", "line 1 has more than 254 characters"),
    ],
)
def test_the_traps_of_the_loader(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        linuxcnc.table_of(text, "X", "linear", 1)
    assert len(linuxcnc.table_of("0 0 0 9 9\n1 0 0\n", "X", "linear", 1).positions) == 2  # what follows the three is left


def error_table(by_direction: bool, spacing: float = 0.01) -> ErrorTable:
    random = np.random.default_rng(4)
    positions = -0.2 + spacing * np.arange(41)
    forward = np.round(random.normal(0.0, 5e-6, 41), 8)
    return ErrorTable("X1", positions, forward, np.round(forward + 3e-6, 8) if by_direction else forward)


def test_what_is_written_is_read_back() -> None:
    both, one = error_table(True), error_table(False)
    for written, read in (
        (both, linuxcnc.table_of(linuxcnc.compensation_file(both, "linear"), "X1", "linear", 1)),
        (one, sinumerik.eec_table(sinumerik.eec_file(one, "linear"), "linear")),
        (both, isg.table_of(isg.list_of(both, "linear", 2), "X1", "linear")),
        (one, isg.table_of(isg.list_of(one, "linear", 2), "X1", "linear")),
    ):
        assert read.positions == pytest.approx(written.positions, abs=1e-9)
        # ISG counts in 0.1 um
        assert read.forward == pytest.approx(written.forward, abs=0.51e-7)
        assert read.backward == pytest.approx(written.backward, abs=0.51e-7)


def test_the_sign_of_each_format() -> None:
    """An axis that goes 5 um too far: +0.005 in EEC, -0.005 for LinuxCNC's type 1, 50 in the list of ISG."""
    table = ErrorTable("X", np.array([0.0, 0.1]), np.full(2, 5e-6), np.full(2, 5e-6))
    assert "$AA_ENC_COMP[0,0,X]=0.005\n" in sinumerik.eec_file(table, "linear")
    assert linuxcnc.compensation_file(table, "linear").splitlines()[0] == "0.000000 -0.005000 -0.005000"
    assert "kw.ssfk.table[0].pos         50\n" in isg.list_of(table, "linear", 1)


EEC = """%_N_AX_EEC_INI
CHANDATA(1)
$AA_ENC_COMP[0,0,X1]=0.003
$AA_ENC_COMP[0,1,X1]=0.01
$AA_ENC_COMP[0,2,X1]=0.012
$AA_ENC_COMP[0,800,X1]=-0.0
$AA_ENC_COMP_STEP[0,X1]=1.0
$AA_ENC_COMP_MIN[0,X1]=-200.0
$AA_ENC_COMP_MAX[0,X1]=600.0
$AA_ENC_COMP_IS_MODULO[0,X1]=0
M17
"""


def test_the_example_of_sinumerik() -> None:
    table = sinumerik.eec_table(EEC, "linear")
    at = np.array([-0.2, -0.1995, -0.199, -0.1985, -0.198, -0.25])
    assert table.error(at) == pytest.approx([3e-6, 6.5e-6, 10e-6, 11e-6, 12e-6, 3e-6])
    # a writer writes every point; those of the manual stand unchanged among them
    lines = sinumerik.eec_file(table, "linear").splitlines()
    assert set(EEC.splitlines()) - set(lines) <= {"%_N_AX_EEC_INI", "$AA_ENC_COMP[0,800,X1]=-0.0"}
    assert len(lines) == 801 + 7


CEC = (
    "".join(f"$AN_CEC[0,{n}]={v}\n" for n, v in enumerate(("0", "0.01", "0.012")))
    + """$AN_CEC_INPUT_AXIS[0]=(AX2)
$AN_CEC_OUTPUT_AXIS[0]=(AX1)
$AN_CEC_STEP[0]=6.73
$AN_CEC_MIN[0]=-400.0
$AN_CEC_MAX[0]=400.0
$AN_CEC_DIRECTION[0]=0
$AN_CEC_IS_MODULO[0]=0
"""
)


def test_the_example_of_a_cross_compensation() -> None:
    [(direction, table)] = sinumerik.cec_tables(CEC, "linear")
    assert (direction, table.axis, table.input_axis) == (0, "AX1", "AX2")
    at = np.array([-0.4, -0.395, -0.39327, -0.390, -0.38654])
    assert table.error(at) == pytest.approx([0.0, 7.43e-6, 10e-6, 10.97e-6, 12e-6], abs=1e-8)


LIS = """kopf.achs_nr                 2
kw.ssfk.interval             0
kw.ssfk.kw_startpos          -200000
kw.ssfk.kw_nr_max            3
kw.ssfk.unit                 1
kw.ssfk.bilateral            1
kw.ssfk.table[0].setpoint    -200000
kw.ssfk.table[1].setpoint    -199306
kw.ssfk.table[2].setpoint    -198667
kw.ssfk.table[0].pos         0
kw.ssfk.table[1].pos         24
kw.ssfk.table[2].pos         -102
kw.ssfk.table[0].neg         0
kw.ssfk.table[1].neg         67
kw.ssfk.table[2].neg         80
"""


def test_the_example_of_isg_byte_for_byte() -> None:
    table = isg.table_of(LIS, "Y", "linear")
    assert isg.list_of(table, "linear", 2) == LIS
    at = np.array([-19.9306e-3, -19.9e-3, -19.8667e-3])
    assert table.error(at, 1) == pytest.approx([2.4e-6, -3.63e-6, -10.2e-6], abs=1e-8)
    assert table.error(at, -1) == pytest.approx([6.7e-6, 7.32e-6, 8.0e-6], abs=1e-8)


def test_the_old_table_of_heidenhain() -> None:
    text = "0 Z-990      Y+0\n1 Z-973.616  Y-0.06\n2 Z-957.232  Y-0.09\n3 Z-940.848\n4 Z-924.464\n5 Z-908.08   Y-0.12\n"
    table = heidenhain.old_table(text, "Y", "Z")
    at = np.array([-0.981808, -0.965424, -0.940848, -0.924464])
    assert table.error(at) == pytest.approx([-30e-6, -75e-6, -100e-6, -110e-6], abs=1e-9)


def test_a_file_that_the_control_saved_is_filled() -> None:
    saved = "BEGIN PITCH_X.COM\nNR  AXISPOS   BACKLASH  X\n0   -100.0    +0.0000   +0.0000\n1   +0.0      +0.0000   +0.0000\n[END]\n"
    table = ErrorTable("X", np.array([-0.1, 0.0]), np.array([2e-6, 4e-6]), np.array([-1e-6, -3e-6]))
    lines = heidenhain.filled(saved, table, "linear").splitlines()
    assert lines[2].split() == ["0", "-100.0", "-0.0010", "+0.0020"]
    assert lines[3].split() == ["1", "+0.0", "-0.0030", "+0.0040"]
    assert (lines[0], lines[-1]) == ("BEGIN PITCH_X.COM", "[END]")
    with pytest.raises(InputError, match="save one on the control"):
        heidenhain.filled("AXISPOS Y\n", table, "linear")


def test_a_word_in_an_archive_is_no_number(tmp_path: Path, mikron: Machine) -> None:
    file = tmp_path / "data.arc"
    file.write_text("N30350 $MA_SIMU_AX_VDI_OUTPUT[AX1]=FALSE\nN32450 $MA_BACKLASH[0,AX1]=0.01 ; mm\n")
    [found] = existing(str(file), mikron)
    assert found.blocks[BACKLASH]["width"] == pytest.approx(1e-5)


def test_lists_of_parameters_keep_the_old_values() -> None:
    text = sinumerik.archive([("AX1", Entry("MD32520 FRICT_COMP_CONST_MAX", 101.0, 0.0, "mm/min", "C"))])
    assert "N32520 $MA_FRICT_COMP_CONST_MAX[0,AX1]=101 ; mm/min, was 0, effective: NewConfig; grade C: check before use" in text
    assert "; N32520 $MA_FRICT_COMP_CONST_MAX[0,AX1]=0 ; mm/min" in text
    assert sinumerik.machine_data(text) == {("MD32520", "AX1"): "101"}
    listed = heidenhain.parameter_list([("X", Entry("MP750", 0.03, 0.0, "mm", "C"))])
    assert listed == "MP750 [X] : 0.03 mm ; was 0; grade C: check before use\n"
    assert heidenhain.parameters_of(listed) == {("MP750", "X"): "0.03"}
    assert linuxcnc.ini_values(linuxcnc.ini_lines(0, {"BACKLASH": 0.015, "COMP_FILE": "x.comp"})) == {
        ("BACKLASH", "AX1"): "0.015",
        ("COMP_FILE", "AX1"): "x.comp",
    }


def test_what_a_format_cannot_hold_is_refused() -> None:
    uneven = ErrorTable("X", np.array([0.0, 0.1, 0.3]), np.zeros(3), np.zeros(3))
    for make, words in (
        (lambda: sinumerik.eec_file(error_table(True), "linear"), "serves both directions"),
        (lambda: sinumerik.eec_file(uneven, "linear"), "equidistant"),
        (
            lambda: linuxcnc.compensation_file(ErrorTable("X", np.arange(300.0), np.zeros(300), np.zeros(300)), "linear"),
            "LinuxCNC takes 256",
        ),
        (lambda: ErrorTable("X", np.array([0.0, 0.0]), np.zeros(2), np.zeros(2)), "positions that increase"),
        (lambda: isg.table_of("kw.ssfk.table[0].setpoint x\n", "X", "linear"), "line 1"),
    ):
        with pytest.raises(InputError, match=words):
            make()


LEAD = {"slope": 80.0, "origin": 0.01, "sine": 0.0, "cosine": 0.0, "wavelength": 0.01}
WAVE = {**LEAD, "sine": 4e-6, "cosine": -3e-6}


@pytest.mark.parametrize(
    ("control", "changes"),
    [
        ("sinumerik", {"Y": (TABLE, WAVE), "X": (BACKLASH, {"width": 8e-6, "cycles": 1.0}), "C": (PULSE, {"amplitude": 1e-3, "decay_time": 0.02})}),
        ("linuxcnc", {"Y": (TABLE, LEAD), "C": (BACKLASH, {"width": 4e-5, "cycles": 1.0})}),
        ("heidenhain", {"C": (BACKLASH, {"width": 4e-5, "cycles": 1.0})}),
        ("isg", {"Y": (TABLE, LEAD)}),
    ],
)  # fmt: skip
def test_what_a_remedy_writes_is_shown_as_the_same_blocks(
    control: str, changes: dict[str, tuple[str, dict[str, float]]], mikron: Machine, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`twin machine show --control-file` prints the tables of a machine file that the changes would write into it."""
    own = [Change(axis, function, values=values) for axis, (function, values) in changes.items()]
    files, _ = files_for(own, mikron, control)
    named = []
    for name, text in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        if not name.endswith("_comp.ini"):
            named += ["--control-file", f"{'Y=' * name.endswith('.comp')}{tmp_path / name}"]
    assert main(["machine", "show", *named, "--comp-file-type", "1"]) == 0
    shown = tomllib.loads("\n".join(line for line in capsys.readouterr().out.splitlines() if line.startswith("[") or "=" in line))
    for change in own:
        expected = change.table(mikron)
        found = shown["axis"][change.axis]["block"][change.function]
        scale = 1e-7 if control == "isg" else 2e-8  # a file counts in 0.1 um or less
        assert found.keys() == expected.keys()
        for key, value in expected.items():
            assert found[key] == pytest.approx(
                value, rel=2e-3, abs=0.02 * abs(WAVE["sine"]) if key.startswith(("sine", "cosine")) else scale
            )


def test_existing_files_name_their_axis_or_are_refused(mikron: Machine, tmp_path: Path) -> None:
    def found(text: str, name: str = "") -> list[Existing]:
        path = tmp_path / "given"
        path.write_text(text, encoding="utf-8")
        return existing(f"{name}{path}", mikron)

    [direction] = found(compensation := "0 0 0\n100 -0.002 0.003\n", "X=")
    assert direction.table is not None
    assert any("differ by" in line for line in lines_of(direction))
    [cross] = found(CEC)
    assert "no block of the machine file corrects that" in lines_of(cross)[-1]
    [old] = found("0 Z-990      Y+0\n1 Z-973.616  Y-0.06\n", "Y=")
    assert old.axis.name == "Y"
    for text, words in (
        (compensation, "write AXIS="),
        ("N32450 $MA_BACKLASH[0,AX9]=0.01", "AX9"),
        ("[JOINT_0]\nP = 3\n", "holds no compensation"),
    ):
        with pytest.raises(InputError, match=words):
            found(text)


def test_a_saved_table_is_filled_by_a_remedy(mikron: Machine) -> None:
    saved = "BEGIN PITCH_Y.COM\nNR  AXISPOS   BACKLASH  Y\n0   -100.0    +0.0000   +0.0000\n1   +0.0      +0.0000   +0.0000\n[END]\n"
    change = Change("Y", TABLE, values=LEAD)
    files, notes = files_for([change], mikron, "heidenhain", [saved.replace(" Y\n", " X\n"), saved])
    assert files["Y.COM"].splitlines()[2].split() == ["0", "-100.0", "-0.0088", "-0.0088"]
    assert not notes
    # twelve points a period or more: lines 100 mm apart cannot hold a wave of 10 mm
    _, [note] = files_for([replace(change, values=WAVE)], mikron, "heidenhain", [saved])
    assert "100 apart, the wave needs 0.83" in note
    assert "--saved" in files_for([change], mikron, "heidenhain")[1][0]
