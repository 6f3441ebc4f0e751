"""The recorded SINUMERIK machine, if its recording is available: control law and place of the position loop, from a wrong start."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import SHARED
from twin.cli import main
from twin.identify.axis_run import axis_run
from twin.identify.drive_position_loop import drive_position_loop
from twin.identify.position_control import fit_position_control
from twin.machine.machine import load_machine
from twin.recordings.campaign import read_campaign

RECORDING = SHARED / "data" / "sinumerik" / "recording.json"


@pytest.mark.slow
def test_law_and_place_of_the_position_loop(tmp_path: Path) -> None:
    if not RECORDING.is_file():
        pytest.skip("no recording: ../shared/data/sinumerik is not beside this repository")
    assert main(["import", str(RECORDING), "--out", str(tmp_path / "c"), "--no-picture"]) == 0
    assert main(["machine", "new", "--from-recording", str(tmp_path / "c"), "--out", str(tmp_path / "m.toml")]) == 0
    machine = load_machine(tmp_path / "m.toml")
    campaign = read_campaign(tmp_path / "c", machine)
    for name in ("1", "2"):
        far = machine.with_values({f"axis.{name}.loops.position_gain_per_s": 80.0, f"axis.{name}.loops.position_delay_s": 0.0})
        runs = [r for r in (axis_run(far, far.axis(name), run) for run in campaign.runs) if r is not None]
        law = fit_position_control(far.axis(name), runs, far.setpoint_interpolation)
        assert not isinstance(law, str)
        assert law.values["position_gain_per_s"] == pytest.approx(33.3333, rel=1e-3)
        assert law.values["position_delay_s"] == pytest.approx(3.0e-3, abs=0.05e-3)
        assert law.values["velocity_feedforward"] == pytest.approx(1.0, abs=1e-3)
        assert law.residual_rms < 0.02e-3
        loop = drive_position_loop(far.axis(name), runs, law.values["position_gain_per_s"])
        assert loop is not None
        assert loop.closed_in_drive
        assert loop.delay_s == pytest.approx(5.25e-3, abs=0.3e-3)
