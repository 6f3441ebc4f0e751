"""`twin check` and the place of a part: what is understood, what fits, and the least shift that makes it fit."""

from __future__ import annotations

from collections.abc import Iterator
import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from tests.builders.refused import refused
from tests.conftest import ROOT
from twin.cli import main
from twin.errors import InputError
from twin.machine.machine import Machine
from twin.program import check_folder, interpolate, interpolator, read_program
from twin.program.part_placement import KEEP, OutsideTravel, axes_of, placed
from twin.recordings.trace import Trace
from twin.simulation.setpoint_limits import LimitWatch, limit_warnings
from twin.simulation.setpoints import setpoints_of

FAR = "G54\nG0 X400 Y0 Z0\nG1 X500 Y0 F1000\nG3 X500 Y20 I0 J10\nG1 X400\nM30\n"
"""A part that lies 145 mm beyond X's travel of 355 mm, with an arc."""


def outside(path: Path, text: str, machine: Machine) -> OutsideTravel:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(OutsideTravel) as found:
        read_program(path, machine)
    return found.value


def test_the_least_shift_is_taken(tmp_path: Path, mikron: Machine) -> None:
    error = outside(tmp_path / "far.mpf", FAR, mikron)
    program = placed(error.program)
    moved = program.moves.target[:, :3] - error.program.moves.target[:, :3]
    assert np.allclose(moved, [-0.155 - KEEP, 0.0, 0.0], atol=1e-4)  # 145 mm, and 10 mm of the arc's bulge
    assert np.allclose(program.moves.centre[1] - error.program.moves.centre[1], moved[0])  # the arc goes with it
    assert np.allclose(program.start[0] - 0.4, moved[0, 0])
    assert "the part is shifted by X -155." in program.notes[-1]


def test_under_traori_the_shift_turns_with_the_table(tmp_path: Path, mikron: Machine) -> None:
    """The part is turned by C = 180 degrees half way: to fit at one end costs at the other."""
    text = "TRAORI\nG0 X0 Y0 Z300 A3=0 B3=0 C3=1\nG1 X420 Y0 Z300 F2000\nG1 X430 Y5 Z300 A3=0.2 B3=0.2 C3=1\nM30\n"
    error = outside(tmp_path / "far.mpf", text, mikron)
    program = placed(error.program)
    low, high = mikron.axis("X").travel
    axes = axes_of(program)
    assert axes[:, 0].max() <= high
    assert axes[:, 0].min() >= low
    assert axes_of(error.program)[:, 0].max() > high


def test_a_program_that_fits_nowhere_names_the_axis(tmp_path: Path, mikron: Machine) -> None:
    error = outside(tmp_path / "long.mpf", "G0 X-400\nG1 X400 F1000\nM30\n", mikron)
    with pytest.raises(InputError, match=r"axis X moves over 800.0 mm, its travel is 710.0 mm"):
        placed(error.program)


def test_check_reads_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, text in (("good.mpf", "G0 X0\nG1 X10 F1000\nM30\n"), ("far.mpf", FAR), ("bad.mpf", "G1 X10 F1000\nFOO(3)\n")):
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "notes.md").write_text("no program", encoding="utf-8")
    out = tmp_path / "check.json"
    assert main(["check", str(tmp_path), "--json", str(out)]) == 2  # a script may stop here
    told = capsys.readouterr()
    assert "3 programs on Mikron UCP 710: 2 understood, 1 fit, 1 within limits" in told.out
    assert told.err.count("\n") == 1
    assert f"2 of 3 programs cannot be run, the first: {tmp_path / 'bad.mpf'}: line 2, column 1: " in told.err
    assert f"{tmp_path / 'far.mpf'}: line 2" in refused(capsys, "check", str(tmp_path / "far.mpf"))
    document = json.loads(out.read_text(encoding="utf-8"))
    jsonschema.validate(document, json.loads((ROOT / "twin" / "report" / "schemas" / "programs.json").read_text(encoding="utf-8")))
    counted = " ".join(one["reason"] for one in document["reasons"])
    assert "outside its travel .. mm; move the program, set a frame (G54)" in counted  # numbers are left out, not those of words
    assert {Path(p["file"]).name: p["verdict"] for p in document["programs"]} == {
        "good.mpf": "ok",
        "far.mpf": "too large",
        "bad.mpf": "refused",
    }
    assert main(["check", str(tmp_path / "far.mpf"), "--place", "auto", "--json", str(out)]) == 0
    far = next(p for p in json.loads(out.read_text(encoding="utf-8"))["programs"] if p["file"].endswith("far.mpf"))
    assert far["verdict"] == "ok"
    assert far["reach"]["X"]["high"] == pytest.approx(355.0, abs=0.3)


def test_check_holds_a_block_of_set_points_and_finds_what_the_whole_shows(
    tmp_path: Path, mikron: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "part.mpf"
    path.write_text("G0 X0 Y0\nG1 X40 Y5 F9000\nG4 F1\nG2 X20 Y5 I-10 J0\nG1 A-5\n", encoding="utf-8")
    weak = mikron.with_axis("X", max_jerk=0.5 * mikron.axis("X").max_jerk)
    trace = interpolate(read_program(path, mikron), mikron)
    whole = setpoints_of(trace, mikron)
    monkeypatch.setattr(interpolator, "BLOCK", 101)
    sizes = []
    plain = interpolator.set_point_blocks

    def blocks(*given: object) -> Iterator[Trace]:
        for block in plain(*given):
            sizes.append(len(block.time))
            yield block

    monkeypatch.setattr(check_folder, "set_point_blocks", blocks)
    found = check_folder.check_program(path, mikron)
    assert max(sizes) <= 2 * 101 < len(whole.position)
    assert found.duration_s == trace.time[-1]
    for axis, (low, high) in found.reach.items():
        column = whole.position[:, mikron.axis_names.index(axis)]
        assert (low, high) == (column.min(), column.max())
    assert found.verdict == "ok"
    # the same set points on a machine with half of X's jerk: told at the same place, in blocks or whole
    watch = LimitWatch(weak, whole.period)
    for begin in range(len(whole.position)):
        watch.add(whole.position[begin : begin + 1])
    assert watch.warnings() == limit_warnings(whole, weak)
    assert len(watch.warnings()) == 1


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "no such program or folder" in refused(capsys, "check", str(tmp_path / "none"))
    assert "holds no part program" in refused(capsys, "check", str(tmp_path))
    (tmp_path / "far.mpf").write_text(FAR, encoding="utf-8")
    assert "add --place auto" in refused(capsys, "run", str(tmp_path / "far.mpf"))


def test_a_part_that_fits_nowhere_is_understood(tmp_path: Path, mikron: Machine) -> None:
    file = tmp_path / "long.mpf"
    file.write_text("G1 X-2000 F1000\nX2000\n", encoding="utf-8")
    found = check_folder.check_program(file, mikron, place=True)
    assert (found.understood, found.fits, found.moves) == (True, False, 2)


def test_words_that_would_open_programs_are_counted(tmp_path, mikron, capsys) -> None:
    """Each refused program with all of its unread words; one that also lacks a subprogram is opened by no word."""
    from twin.cli.check import SHOWN

    bodies = {"a": "POCKET1(1)", "b": "POCKET1(1)\nX3\nG33 Z1 K1", "c": "G33 Z1 K1", "d": "POCKET1(1)\nGONE", "e": "X2", "f": "POCKET1(2)"}
    for name, body in bodies.items():
        (tmp_path / f"{name}.mpf").write_text(f"G1 X1 F100\n{body}\nX5\n")
    (tmp_path / "g.h").write_text("BEGIN PGM A MM\nL X+1 F100\nFL PR+3\nL X+2\nEND PGM A MM\n")
    found = [check_folder.check_program(path, mikron, plan=False) for path in check_folder.programs_in(tmp_path)]
    unread = {one.path.stem: set(one.unread) for one in found}
    assert unread == {"a": {"POCKET1"}, "b": {"POCKET1", "G33"}, "c": {"G33"}, "d": set(), "e": set(), "f": {"POCKET1"}, "g": {"FL"}}
    assert check_folder.opening_words(found) == [("POCKET1", 2, 3), ("G33", 1, 2), ("FL", 1, 1)]
    assert check_folder.document(found, mikron)["words"][0] == {"word": "POCKET1", "opens": 2, "stops": 3}
    assert main(["check", str(tmp_path), "--read-only"]) == 2
    assert "POCKET1 (2 / 3), G33 (1 / 2), FL (1 / 1)" in capsys.readouterr().out
    assert SHOWN >= 3
