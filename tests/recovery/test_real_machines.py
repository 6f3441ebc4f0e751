"""The examples on a real machine tool and a robot: complete if their recordings are available, otherwise a one-line error."""

from __future__ import annotations

from pathlib import Path
import re

import pytest

from tests.builders.script import script
from tests.conftest import SHARED
from twin.machine.machine import load_machine

RECORDING = SHARED / "data" / "sinumerik" / "recording.json"
ROBOT = [SHARED / "data" / "kr300" / name for name in ("FF_A.mat", "FF_B.mat")]


@pytest.mark.slow
@pytest.mark.skipif(not RECORDING.is_file(), reason="recording of a production machine not beside the repository")
def test_a_recording_of_a_control_becomes_a_simulated_machine(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script("examples/real/sinumerik/run.py", "sinumerik_example").main([str(RECORDING), "--out", str(tmp_path)]) == 0
    machine = load_machine(tmp_path / "identified" / "machine.toml")
    gains = [axis.loops.position_gain_per_s for axis in machine.axes]
    assert sum(gain == pytest.approx(100.0 / 3.0, rel=1e-3) for gain in gains) >= 2  # as read from the recorded speed set points
    shares = re.findall(r"(\d+\.\d+) %\s+\d+\.\d+ %\s", capsys.readouterr().out.split("on the held-out motion")[1])
    assert len(shares) == len(machine.axes)
    assert all(float(share) < 2.0 for share in shares)  # of the following error; the residual of a pure delay is up to 7 %


@pytest.mark.slow
@pytest.mark.skipif(not all(f.is_file() for f in ROBOT), reason="recordings of a robot not beside the repository")
def test_a_robot_is_identified_from_one_recording_and_compared_with_the_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert script("examples/real/kr300/run.py", "kr300_example").main([*map(str, ROBOT), "--out", str(tmp_path)]) == 0
    assert "FF_B" in capsys.readouterr().out
    assert len(load_machine(tmp_path / "identified" / "machine.toml").axes) == 3


@pytest.mark.parametrize("example", ["sinumerik", "kr300"])
def test_a_missing_recording_is_one_line(example: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main = script(f"examples/real/{example}/run.py", f"{example}_example").main
    assert main([str(tmp_path / "nowhere"), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "no such file" in said
    assert not (tmp_path / "out").exists()
