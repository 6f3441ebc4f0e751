"""Sizes above a limit are refused before the work, with the estimate, the limit and how to raise it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
import re
from types import SimpleNamespace

import numpy as np
import pytest

from tests.builders.refused import refused
from tests.builders.small_machine import MJCF, TOML
from tests.builders.study_files import FACTOR, write_spec
from twin.errors import InputError
from twin.limits import refuse_above
from twin.machine.machine import Machine
from twin.program import interpolate, interpolator, read_program
from twin.recordings.channels import pieces_of
from twin.recordings.timing import Stretch, Timing
from twin.recordings.trace import written
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.study.design import variants_of
from twin.study.spec import read_study
from twin.surface.part import part_from_document

EXAMPLES = Path(__file__).resolve().parent.parent / "examples" / "parts"
PROGRAMS = {
    "feed": ("G1 X1 F0.0001\nM30\n", "set points (167 h), the limit is 1e+07: raise the feed"),
    "feed of nothing": ("G1 X1 F=1EX-300\nM30\n", "the limit is 1e+07"),
    "waits": ("G1 X1 F1000\n" + "G4 F3600\n" * 20 + "M30\n", "set points (6 h)"),
}


@pytest.mark.parametrize("case", PROGRAMS)
def test_a_program_that_takes_too_long(case: str, tmp_path: Path, mikron: Machine) -> None:
    text, words = PROGRAMS[case]
    (tmp_path / "p.mpf").write_text(text)
    program = read_program(tmp_path / "p.mpf", mikron)
    with pytest.raises(InputError) as error:
        interpolate(program, mikron)
    assert "p.mpf: line" in str(error.value)
    assert words in str(error.value)


def test_set_points_that_would_fill_the_disk(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "p.mpf").write_text(PROGRAMS["feed"][0])
    line = refused(capsys, "interpolate", str(tmp_path / "p.mpf"), "--out", str(tmp_path / "p.parquet"))
    assert "set points (167 h), the limit is 1e+08" in line
    assert [p.name for p in tmp_path.iterdir()] == ["p.mpf"]


def test_a_fault_after_written_set_points_leaves_no_file(tmp_path: Path, mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpolator, "BLOCK", 100)
    (tmp_path / "p.mpf").write_text("G1 X1 F1000\nG4 F1\nX2\nG4 F10\nM30\n")
    program = read_program(tmp_path / "p.mpf", mikron)
    with pytest.raises(InputError, match=r"p.mpf: line 4: .* the limit is 2e\+03"):
        list(written(interpolator.set_point_blocks(program, mikron, most=2000), tmp_path / "p.parquet"))
    assert [p.name for p in tmp_path.iterdir()] == ["p.mpf"]


OTHER_PROGRAMS = {
    "turn.mpf": ("G17 G0 X10 Y0\nG2 X10 Y0 I-10 J0 TURN=999999999 F1000\nM30\n", "give 0 to 10000"),
    "dwell.mpf": ("G4 F1000000000\nM30\n", "give 0 to 3600 s"),
}


@pytest.mark.parametrize("name", OTHER_PROGRAMS)
def test_a_word_out_of_range(name: str, tmp_path: Path, mikron: Machine) -> None:
    text, words = OTHER_PROGRAMS[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words):
        read_program(tmp_path / name, mikron)


def test_a_step_of_days_in_a_trace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "t.csv").write_text("time [s],X.setpoint [mm]\n0,0\n1000000,0\n2000000,0\n")
    line = refused(capsys, "run", str(tmp_path / "t.csv"), "--out", str(tmp_path / "out"))
    assert "a run of 2e+06 s: about 1e+10 samples to record, the limit is 1.5e+07" in line
    assert "--limits 6" in line


def test_a_record_that_is_longer_than_the_limit(mikron: Machine) -> None:
    with pytest.raises(InputError, match="samples to record"):
        simulate(mikron, Setpoints(np.zeros((4, 5)), 1100.0))


def test_a_period_of_a_picosecond() -> None:
    timing = Timing((Stretch(0, 10_001, 0.0, 1e-3, 0.0, True),), 1e-3, ())
    source = SimpleNamespace(skew_s=0.0, timing=timing)
    with pytest.raises(InputError, match="samples on the grid, the limit is 5e"):
        pieces_of([source], 1e-12, 0.0, 10.0, False)  # type: ignore[list-item]


def test_levels_of_a_study(tmp_path: Path) -> None:
    study = read_study(write_spec(tmp_path, FACTOR + '[design]\nkind = "grid"\nlevels = 10000000000\n'))
    with pytest.raises(InputError, match=r"about 1e\+10 variants, the limit is 1e\+06"):
        variants_of(study)


def test_a_zone_of_a_picometre() -> None:
    document = {
        "tool": {"kind": "ball", "diameter_mm": 2.0, "length_mm": 120},
        "surface": [
            {
                "kind": "plane",
                "origin_mm": [0, 0, 0],
                "u_direction": [1, 0, 0],
                "v_direction": [0, 1, 0],
                "along_mm": [0, 20],
                "across_mm": [0, 20],
            }
        ],
    }
    part = part_from_document(document, Path(), "part.toml")
    with pytest.raises(InputError, match="rays at 1e-06 um"):
        part.surfaces[0].rays(part.placed, part.allowance, spacing=1e-12)


@pytest.mark.parametrize("asked", ["--zone-um 1e-6", "zone_um = 1e-6", "spacing_mm = 1e-9"])
def test_rays_are_estimated_before_a_run_is_simulated(
    asked: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The feed decides the zone of the dome, so that its size is known only after the cut; its margin is the least size."""
    monkeypatch.setattr("twin.cli.cut.levels_of_program", lambda *_, **__: pytest.fail("the program was simulated first"))
    key, _, value = asked.partition(" = ")
    text = (EXAMPLES / "part3_dome.toml").read_text(encoding="utf-8")
    (tmp_path / "part.toml").write_text(re.sub(rf"(?m)^{key} = .*$", asked, text) if value else text, encoding="utf-8")
    options = asked.split() if not value else []
    program = str(EXAMPLES / "part3_dome.mpf")
    line = refused(capsys, "cut", program, "--part", str(tmp_path / "part.toml"), "--out", str(tmp_path / "out"), *options)
    assert "rays at 1e-06 um, the limit is 4e+06: enlarge spacing_mm or zone_um" in line


def thousands(estimate: float) -> Callable[[], None]:
    return lambda: refuse_above(estimate, 1000.0, "things", "a.toml", "take fewer")


def test_the_message_names_the_factor_that_lets_it_through(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError) as error:
        thousands(2500.0)()
    assert str(error.value) == "a.toml: about 2.5e+03 things, the limit is 1e+03: take fewer; or raise all limits with --limits 3"
    monkeypatch.setenv("TWIN_LIMITS", "3")
    thousands(2500.0)()
    for estimate in (float("inf"), float("nan")):
        with pytest.raises(InputError, match=r"take fewer$"):
            thousands(estimate)()
    monkeypatch.setenv("TWIN_LIMITS", "no")
    with pytest.raises(InputError, match="TWIN_LIMITS"):
        thousands(1.0)()


@pytest.mark.parametrize(
    ("period_us", "says"), [("1e-5", "us: about 1.7e+12 set points, the limit is 1e+07"), ("1e17", "use at most 150000")]
)
def test_a_plan_with_an_impossible_sample_period(period_us: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "small.xml").write_text(MJCF)
    (tmp_path / "small.toml").write_text(TOML.replace("sample_period_us = 1000", f"sample_period_us = {period_us}"))
    line = refused(capsys, "plan", "--machine", str(tmp_path / "small.toml"), "--out", str(tmp_path / "out"))
    assert "[measurement]: sample_period_us" in line
    assert says in line
