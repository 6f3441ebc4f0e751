"""Every bad input has its own line on standard error and exit code 2; nothing is a traceback."""

from collections.abc import Callable
import contextlib
import json
import os
from pathlib import Path
import shutil

import numpy as np
import pytest

from tests.builders.refused import refused
from tests.builders.small_machine import MJCF, TOML
from tests.conftest import ROOT
from twin.cli import main
from twin.errors import InputError
from twin.machine.machine import Machine, default_machine_path, load_machine
from twin.program import read_program
from twin.simulation.plant_spec import build_plant

HEAD = "time [s],X.setpoint [mm]\n"


def rows(values: list[str], period: float = 0.001) -> str:
    return "".join(f"{i * period:.6f},{value}\n" for i, value in enumerate(values))


TRACES: dict[str, tuple[str, tuple[str, ...]]] = {
    "not a trace": ("a,b\n1,2\n2,3\n", ("not a trace", "first column must be 'time [s]'", "'a'")),
    "no heading": ("0,1\n1,2\n2,3\n", ("not a trace",)),
    "heading without unit": ("time [s],X.setpoint\n0,1\n1,2\n", ("column 'X.setpoint'", "X.setpoint [mm]")),
    "no setpoint column": ("time [s],X.position [mm]\n0,1\n1,2\n", ("no setpoint column for axis X", "X.setpoint [mm]")),
    "time only": ("time [s]\n0\n1\n", ("no setpoint column for axis any",)),
    "setpoint missing for one axis": ("time [s],X.setpoint [mm],Y.position [mm]\n0,1,1\n1,1,1\n", ("no setpoint column for axis Y",)),
    "unknown axis": ("time [s],Q.setpoint [mm]\n0,1\n1,2\n", ("unknown axis Q", "A, C, X, Y, Z")),
    "unknown unit": ("time [s],X.setpoint [mmm]\n0,1\n1,2\n", ("column 'X.setpoint [mmm]'", "unknown unit [mmm]", "did you mean 'mm'")),
    "unknown unit of time": ("time [sec],X.setpoint [mm]\n0,1\n1,2\n", ("time [sec]", "unknown unit [sec]")),
    "angle on a linear axis": ("time [s],X.setpoint [deg]\n0,1\n1,2\n", ("axis X is linear", "[deg]", "use [mm]")),
    "speed as a position": ("time [s],X.setpoint [mm/s]\n0,1\n1,2\n", ("[mm/s] is not a unit of a setpoint", "use [mm]")),
    "column twice": ("time [s],X.setpoint [mm],X.setpoint [mm]\n0,1,1\n1,2,2\n", ("occurs twice",)),
    "column twice in two units": ("time [s],X.setpoint [mm],X.setpoint [m]\n0,1,1\n1,2,2\n", ("occurs twice",)),
    "text in a cell": (HEAD + "0,1\n0.001,abc\n", ("X.setpoint [mm]", "row 2 holds 'abc'", "not a number")),
    "time stands still": (HEAD + "0,1\n0.001,1\n0.001,1\n0.002,1\n", ("time does not increase at row 3", "0.001 s")),
    "time goes back": (HEAD + "0,1\n0.001,1\n0.002,1\n0.001,1\n", ("time does not increase at row 4",)),
    "gap in time": (HEAD + "0,1\n0.001,1\n0.002,1\n0.005,1\n0.006,1\n", ("gap in time at row 4", "3 ms after 0.002 s", "period is 1 ms")),
    "missing cell": (HEAD + "0,1\n0.001,\n0.002,1\n", ("column 'X.setpoint [mm]': row 2", "NaN")),
    "NaN": (HEAD + "0,1\n0.001,nan\n0.002,1\n", ("row 2", "NaN")),
    "infinite": (HEAD + "0,1\n0.001,inf\n0.002,1\n", ("row 2 holds inf",)),
    "NaN in time": (HEAD + "0,1\nnan,1\n0.002,1\n", ("time [s]", "row 2")),
    "no rows": (HEAD, ("empty", "two samples")),
    "one sample": (HEAD + "0,1\n", ("only one sample",)),
    "outside travel": (HEAD + rows(["0", "100", "355.1"]), ("axis X", "355.1 mm at 0.002 s", "-355 .. 355 mm", "travel")),
}


@pytest.mark.parametrize("case", TRACES)
def test_bad_trace(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, expected = TRACES[case]
    path = tmp_path / "trace.csv"
    path.write_text(content)
    line = refused(capsys, "run", str(path), "--out", str(tmp_path / "out"))
    assert str(path) in line
    for words in expected:
        assert words in line
    assert not (tmp_path / "out" / "trace.parquet").exists()


def test_each_bad_trace_has_its_own_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    distinct = TRACES.keys() - {"column twice in two units", "missing cell"}  # each the same fault as another one
    lines = set()
    for case in distinct:
        (tmp_path / "trace.csv").write_text(TRACES[case][0])
        lines.add(refused(capsys, "run", str(tmp_path / "trace.csv")))
    assert len(lines) == len(distinct)


def test_missing_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such file" in refused(capsys, "run", str(tmp_path / "nothing.csv"))


@pytest.mark.parametrize("ending", ["parquet", "csv"])
def test_garbage_is_not_readable(ending: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"trace.{ending}"
    path.write_bytes(bytes(range(256)) * 20)
    assert str(path) in refused(capsys, "run", str(path))


def test_empty_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "trace.csv").write_bytes(b"")
    assert "the file is empty; write it again" in refused(capsys, "run", str(tmp_path / "trace.csv"))


NOT_THE_KIND = {
    "a folder for a trace": (("run", "{campaign}"), "a folder, but a file is needed; give a trace"),
    "a folder for a recording": (("import", "{campaign}"), "a folder, but a file is needed; give a recorded trace"),
    "a folder for a study": (("study", "{campaign}", "--out", "{out}"), "a folder, but a file is needed"),
    "a recording of a control": (("run", "{recording}"), "twin import {recording} --out CAMPAIGN"),
    "no time": (("run", "{timeless}"), "twin import {timeless} --out CAMPAIGN"),
    "a program to evaluate": (
        ("iso", "230-4", "{program}"),
        "a part program, not a trace; simulate it first: twin run {program} --out DIR",
    ),
    "two campaigns": (
        ("diagnose", "{campaign}", "{campaign}", "--out", "{out}"),
        "{campaign}: a campaign beside other inputs; diagnose one",
    ),
    "a campaign and a recording": (("diagnose", "{recording}", "{campaign}", "--out", "{out}"), "a campaign beside other inputs"),
    "one campaign to watch": (("watch", "{campaign}", "--out", "{out}"), "one campaign; give the folder that holds it"),
    "no diagnosis": (("remedy", "{campaign}", "--out", "{out}"), "{campaign}: no diagnosis there; give its folder"),
    "nothing to remedy": (("remedy", "{out}", "--out", "{out}"), "{out}: no diagnosis there; give its folder"),
    "another machine": (("gap", "{campaign}", "--machine", "{machine}"), "unknown axis Y; known are: X; rename it, or give its --machine"),
}


@pytest.mark.parametrize("case", NOT_THE_KIND)
def test_another_kind_of_input_is_named_with_what_to_do(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "timeless.csv").write_text("X.setpoint [mm]\n0\n1\n")
    known = {
        "campaign": ROOT / "examples" / "campaign", "recording": ROOT / "examples" / "traces" / "x_feedforward_off.csv",
        "program": ROOT / "examples" / "vertical_corner.mpf", "machine": ROOT / "examples" / "lab_axis" / "axis.toml",
        "timeless": tmp_path / "timeless.csv", "out": tmp_path / "out",
    }  # fmt: skip
    words, said = NOT_THE_KIND[case]
    assert said.format(**known) in refused(capsys, *(word.format(**known) for word in words))
    assert not (tmp_path / "out").exists() or not any((tmp_path / "out").iterdir())


@pytest.mark.parametrize(("given", "near"), [("--feedfoward", "--feedforward"), ("--strickt=1", "--strict")])
def test_a_misspelt_option_names_the_nearest_of_its_command(given: str, near: str, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "run", "a.csv", given, "off")
    assert line.rstrip().endswith(f"did you mean '{near}'?; try 'twin run --help'")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read everything")
def test_unreadable_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "trace.csv"
    path.write_text(HEAD + "0,1\n1,1\n")
    path.chmod(0)
    assert "permission" in refused(capsys, "run", str(path))


def test_permission_denied_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    import pyarrow.csv

    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(pyarrow.csv, "read_csv", denied)
    (tmp_path / "trace.csv").write_text(HEAD + "0,1\n1,1\n")
    assert "cannot be read; check its permissions" in refused(capsys, "run", str(tmp_path / "trace.csv"))


def steps(tmp_path: Path) -> Path:
    """A step of 1 mm: far above acceleration and jerk."""
    path = tmp_path / "steps.csv"
    path.write_text(HEAD + rows(["0"] * 50 + ["1"] * 50))
    return path


def test_limits_warn_with_place_and_amount(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", str(steps(tmp_path)), "--out", str(tmp_path / "out"), "--no-recording"]) == 0
    warnings = capsys.readouterr().err.splitlines()
    assert len(warnings) == 2
    for name, line in zip(("acceleration", "jerk"), warnings):
        assert line.startswith("warning: steps.csv: axis X: set points reach")
        assert name in line
        assert "the limit is" in line
        assert " at 0.0" in line


def test_limits_are_an_error_with_strict(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = refused(capsys, "run", str(steps(tmp_path)), "--strict", "--out", str(tmp_path / "out"))
    assert "the limit is" in line
    assert "--strict" in line


MACHINES: dict[str, tuple[Callable[[str], str], tuple[str, ...]]] = {
    "missing value": (lambda t: t.replace("moving_mass_kg = 700.0", "", 1), ("[axis.X]", "'moving_mass_kg' is missing")),
    "misspelt": (
        lambda t: t.replace("position_gain_per_s", "position_gian_per_s", 1),
        ("[axis.X.loops]", "did you mean 'position_gain_per_s'"),
    ),
    "impossible mass": (lambda t: t.replace("kg = 700.0", "kg = -700.0"), ("moving_mass_kg = -700", "impossible", "above 0")),
    "zero resistance": (lambda t: t.replace("resistance_ohm = 0.5", "resistance_ohm = 0", 1), ("[axis.X.motor]", "resistance_ohm = 0")),
    "a lead of atoms": (
        lambda t: t.replace("screw_lead_m_per_rev = ", "screw_lead_m_per_rev = 1e-30 # ", 1),
        ("1e-30: no machine has such a number",),
    ),
    "a cycle of hours": (
        lambda t: t.replace("position_cycle_us = 2000", "position_cycle_us = 2e12"),
        ("position_cycle_us", "no control has such a cycle"),
    ),
    "infinite gain": (lambda t: t.replace("speed_gain_nm_s_per_rad = 3.4", "speed_gain_nm_s_per_rad = inf"), ("impossible",)),
    "text for a number": (lambda t: t.replace("kg = 700.0", 'kg = "heavy"'), ("moving_mass_kg = 'heavy'", "a number")),
    "travel turned round": (lambda t: t.replace("[-0.355, 0.355]", "[0.355, -0.355]"), ("travel_m", "below the second")),
    "carries more than it weighs": (lambda t: t.replace("kg = 1050.0", "kg = 600.0"), ("[axis.Y]", "700 kg that the slide carries")),
    "no such joint": (lambda t: t.replace("[axis.X", "[axis.W").replace('"X"', '"W"'), ("axis W has no joint",)),
    "no such body": (lambda t: t.replace("[body.table]", "[body.tabel]"), ("[body.tabel]", "did you mean 'table'")),
    "impossible inertia": (lambda t: t.replace("[2.6, 2.6, 4.6]", "[2.6, 2.6, 5.6]"), ("[body.table]", "inertia_kg_m2")),
    "axis order": (lambda t: t.replace('["X", "Y", "Z", "A", "C"]', '["X", "Y"]'), ("axis_order",)),
    "cycles": (lambda t: t.replace("position_cycle_us = 2000", "position_cycle_us = 2010"), ("position_cycle_us", "whole multiple")),
    "kind": (lambda t: t.replace('kind = "linear"', 'kind = "straight"', 1), ("kind = 'straight'", "'linear' or 'rotary'")),
    "no motor": (lambda t: t.replace("[axis.X.motor]", "[axis.X.moter]"), ("[axis.X]", "unknown key 'moter'", "did you mean 'motor'")),
    "linear and endless": (
        lambda t: t.replace('kind = "rotary"', 'kind = "linear"').replace("travel_deg = [", 'travel_deg = "endless" # ['),
        ("travel_deg",),
    ),
    "no model": (lambda t: t.replace('model = "mikron_ucp710.xml"', ""), ("'model' is missing",)),
    "model not there": (lambda t: t.replace("mikron_ucp710.xml", "other.xml"), ("'other.xml'", "no such file beside")),
    "no TOML": (lambda t: t.replace("[control]", "[control"), ("not a valid TOML file",)),
}


@pytest.mark.parametrize("case", MACHINES)
def test_bad_machine_file(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, expected = MACHINES[case]
    source = default_machine_path()
    text = source.read_text(encoding="utf-8")
    assert change(text) != text
    (tmp_path / "machine.toml").write_text(change(text), encoding="utf-8")
    shutil.copy(source.with_suffix(".xml"), tmp_path)
    (tmp_path / "trace.csv").write_text(HEAD + "0,0\n0.001,0\n")
    arguments = ("run", str(tmp_path / "trace.csv"), "--machine", str(tmp_path / "machine.toml"), "--out", str(tmp_path / "out"))
    if case == "no such joint":  # the trace must name the axis that the machine claims to have
        (tmp_path / "trace.csv").write_text("time [s],Y.setpoint [mm]\n0,0\n0.001,0\n")
    line = refused(capsys, *arguments)
    assert "machine.toml" in line
    for words in expected:
        assert words in line


def test_machine_file_missing_or_no_mjcf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "trace.csv").write_text(HEAD + "0,0\n0.001,0\n")
    assert "no such machine file" in refused(capsys, "run", str(tmp_path / "trace.csv"), "--machine", str(tmp_path / "none.toml"))
    shutil.copy(default_machine_path(), tmp_path / "machine.toml")
    (tmp_path / "mikron_ucp710.xml").write_text("<mujoco><worldbody><body></worldbody></mujoco>")
    line = refused(capsys, "run", str(tmp_path / "trace.csv"), "--machine", str(tmp_path / "machine.toml"))
    assert "not readable XML" in line


def test_feedforward_word(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "trace.csv").write_text(HEAD + "0,0\n0.001,0\n")
    line = refused(capsys, "run", str(tmp_path / "trace.csv"), "--feedforward", "velocty", "--out", str(tmp_path / "out"))
    assert "did you mean 'velocity'" in line


def test_out_that_is_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "trace.csv").write_text(HEAD + "0,0\n0.001,0\n")
    assert "--out" in refused(capsys, "run", str(tmp_path / "trace.csv"), "--out", str(tmp_path / "trace.csv"))


EMPTY = {
    "a variable that is not set": (("machine", "show", "--machine", ""), "--machine ''"),
    "behind an equals sign": (("machine", "show", "--machine="), "--machine="),
    "an input": (("check", ""), "check ''"),
    "a picture": (("interpolate", "examples/x_200mm.csv", "--plot", ""), "--plot ''"),
}


@pytest.mark.parametrize("case", EMPTY)
def test_an_empty_argument_is_refused(case: str, capsys: pytest.CaptureFixture[str]) -> None:
    """An empty argument would silently become a default: another machine, no picture."""
    arguments, said = EMPTY[case]
    assert f"twin: {said}: this argument is empty" in refused(capsys, *arguments)


@pytest.mark.parametrize("arguments", [[], ["walk"], ["run"], ["run", "a.csv", "--sped", "3"], ["run", "a.csv", "--noise-seed", "x"]])
def test_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert "--help" in refused(capsys, *arguments)


CAMPAIGNS: dict[str, tuple[str | None, str]] = {
    "no campaign.toml": (None, "campaign.toml: no such file"),
    "no TOML": ("[[run]\n", "not a valid TOML"),
    "unknown key": ("machines = 'a'\n", "did you mean 'machine'"),
    "no runs": ("machine = 'a'\n", "'run' is missing"),
    "unknown key of a run": ("[[run]]\nfile = 'a.csv'\nfeedfoward = 'off'\n", "did you mean 'feedforward'"),
    "no file": ("[[run]]\nfeedforward = 'off'\n", "'file' is missing"),
    "file missing": ("[[run]]\nfile = 'b.csv'\n", "no such file"),
    "file outside": ("[[run]]\nfile = '../a.csv'\n", "leaves the folder"),
    "feedforward": ("[[run]]\nfile = 'a.csv'\nfeedforward = 'on'\n", "off, velocity, velocity+torque"),
    "start time": ("[[run]]\nfile = 'a.csv'\nstarted_at_s = 'noon'\n", "give a number of seconds"),
    "two runs of one name": ("[[run]]\nfile = 'a.csv'\n[[run]]\nfile = 'a.csv'\n", "two runs are named a"),
    "nothing measured": ("[[run]]\nfile = 'a.csv'\n", "no run holds a measured signal"),
}


@pytest.mark.parametrize("case", CAMPAIGNS)
def test_bad_campaign(case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    content, expected = CAMPAIGNS[case]
    (tmp_path / "a.csv").write_text(HEAD + "0,0\n0.001,0\n")
    if content is not None:
        (tmp_path / "campaign.toml").write_text(content)
    assert expected in refused(capsys, "gap", str(tmp_path))


def test_no_campaign_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such folder" in refused(capsys, "gap", str(tmp_path / "none"))


def test_diverging_run_keeps_its_trace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from twin.machine.machine import write_machine
    from twin.recordings.trace import read_trace

    # with its own motor the axis would only swing between its current limits, for ever
    wild = {"loops.position_gain_per_s": 5e3, "motor.peak_current_a": 1e5, "motor.bus_limit_v": 1e6}
    machine = load_machine().with_values({f"axis.X.{key}": value for key, value in wild.items()})
    write_machine(machine, tmp_path / "machine.toml")
    t = np.arange(1000) * 1e-3
    values = [f"{v:.6f}" for v in 5.0 * (1 - np.cos(2 * np.pi * t))]
    (tmp_path / "trace.csv").write_text(HEAD + rows(values))
    line = refused(capsys, "run", str(tmp_path / "trace.csv"), "--machine", str(tmp_path / "machine.toml"), "--out", str(tmp_path / "out"))
    assert "diverges: axis X at " in line
    kept = read_trace(tmp_path / "out" / "trace.parquet")
    assert 1 < len(kept.time) < 1000


STEERING = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202ereversed"
"""Clears a terminal, names its window, colours it, and turns the writing around."""


def test_names_cannot_steer_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of columns, runs and machines, in results, notes and errors."""
    (tmp_path / "small.xml").write_text(MJCF)
    (tmp_path / "small.toml").write_text(TOML.replace('name = "small"', f"name = {json.dumps('small ' + STEERING)}"))
    (tmp_path / f"run{STEERING}.csv").write_text(
        f"time [s],Pos{STEERING} [mm],Soll [mm]\n" + "".join(f"{i / 1000},{i % 7},{i}\n" for i in range(99))
    )
    (tmp_path / f"program{STEERING}.mpf").write_text(f"G1 X1 F1000 ;{STEERING}\nQQ{STEERING}=1\nM30\n")
    recording, program = str(tmp_path / f"run{STEERING}.csv"), str(tmp_path / f"program{STEERING}.mpf")
    commands = (
        ("import", recording), ("machine", "show", str(tmp_path / "small.toml")), ("check", program), ("run", recording), ("gap", f"none{STEERING}"),
        ("effects", f"none{STEERING}"), (f"none{STEERING}",), ("check", f"--json{STEERING}=x", program),
    )  # fmt: skip
    for command in commands:
        with contextlib.suppress(SystemExit):
            main(list(command))
        out, err = capsys.readouterr()
        assert out or err
        assert not set(out + err) & set("\x1b\x9b\x07\u202e"), command


@pytest.mark.parametrize(
    "words",
    [
        ("check", "{}.mpf"),
        ("run", "{}.csv"),
        ("gap", "{}"),
        ("study", "{}.toml"),
        ("machine", "show", "{}.toml"),
        ("import", "{}.csv"),
        ("diagnose", "{}"),
    ],
)
def test_a_path_that_no_system_opens_is_one_short_line(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    for path in ("y" * 300, "y" * 3000, "y/" * 3000, "/".join(["y" * 100] * 60)):
        line = refused(capsys, *(word.format(path) for word in words))
        assert len(line) < 600
        assert "defect" not in line


@pytest.mark.parametrize("word", ["M", "G", "H", "T", "D", "L", "F", "S", "X", "N", "P", "R1=", "X=", "AC=", "G4 F", "G2 X1 Y1 I"])
@pytest.mark.parametrize("ending", [".mpf", ".ngc", ".nc"])
def test_a_number_of_any_length_in_a_program_is_read_or_refused(word: str, ending: str, tmp_path: Path, mikron: Machine) -> None:
    for digits in ("9" * 400, "0" * 400, "9" * 30, "1." + "3" * 400):
        (tmp_path / f"p{ending}").write_text(f"G1 X1 F1000\n{word}{digits}\nM30\n")
        with contextlib.suppress(InputError):
            read_program(tmp_path / f"p{ending}", mikron)


@pytest.mark.parametrize(
    "motor",
    [
        '<motor name="U"/>',
        "<motor/>",
        '<position name="U" kp="1"/>',
        '<motor name="U" joint="B"/>',
        '<motor name="B"/><motor name="U" joint="U"/>',
    ],
)
def test_an_actuator_without_a_joint_is_left_out(motor: str, tmp_path: Path) -> None:
    (tmp_path / "small.xml").write_text(MJCF.replace("</mujoco>", f"<actuator>{motor}</actuator></mujoco>"))
    (tmp_path / "small.toml").write_text(TOML)
    build_plant(load_machine(tmp_path / "small.toml"))
