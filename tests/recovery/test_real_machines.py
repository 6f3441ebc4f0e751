"""The examples on a real machine tool and a robot: complete if their recordings are available, otherwise a one-line error."""

from __future__ import annotations

import contextlib
from dataclasses import replace
import io
from pathlib import Path
import re

import pytest

from tests.builders.script import script
from tests.conftest import SHARED
from twin.identify.axis_run import axis_run
from twin.identify.drive_position_loop import drive_position_loop
from twin.identify.first_values import first_values
from twin.identify.position_control import fit_position_control
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun, read_campaign

RECORDING = SHARED / "data" / "sinumerik" / "recording.json"
ROBOT = [SHARED / "data" / "kr300" / name for name in ("FF_A.mat", "FF_B.mat")]


@pytest.fixture(scope="module")
def sinumerik(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The example on the recorded SINUMERIK machine: its folder and what it prints."""
    if not RECORDING.is_file():
        pytest.skip("no recording: ../shared/data/sinumerik is not beside this repository")
    out = tmp_path_factory.mktemp("sinumerik")
    with contextlib.redirect_stdout(io.StringIO()) as said:
        assert script("examples/real/sinumerik/run.py", "sinumerik_example").main([str(RECORDING), "--out", str(out)]) == 0
    return out, said.getvalue()


@pytest.mark.slow
def test_a_recording_of_a_control_becomes_a_simulated_machine(sinumerik: tuple[Path, str]) -> None:
    out, said = sinumerik
    machine = load_machine(out / "identified" / "machine.toml")
    gains = [axis.loops.position_gain_per_s for axis in machine.axes]
    assert sum(gain == pytest.approx(100.0 / 3.0, rel=1e-3) for gain in gains) >= 2  # as read from the recorded speed set points
    shares = re.findall(r"(\d+\.\d+) %\s+\d+\.\d+ %\s", said.split("on the run left out")[1])
    assert len(shares) == len(machine.axes)
    assert all(float(share) < 2.0 for share in shares)  # of the following error; the residual of a pure delay is up to 7 %


@pytest.mark.slow
def test_law_and_place_of_the_position_loop_from_a_wrong_start(sinumerik: tuple[Path, str]) -> None:
    out, _ = sinumerik
    machine = load_machine(out / "identified" / "machine.toml")
    campaign = read_campaign(out / "campaign", machine)
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


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "amplitude", "decay"), [("1", 7.00e-3, 20.0e-3), ("6", 10.0e-3, 15.0e-3)])
def test_the_pulses_of_a_friction_compensation_without_the_recorded_feedforward(
    sinumerik: tuple[Path, str], axis: str, amplitude: float, decay: float
) -> None:
    """The recorded feedforward holds pulses of 7.00 and 10.0 mm/min that decay in 20.0 and 15.0 ms; the speed set point alone shows the same."""
    runs = []
    for run in read_campaign(sinumerik[0] / "campaign").runs:
        signals = {key: values for key, values in run.trace.signals.items() if key[1] != "velocity_feedforward"}
        runs.append(replace(run, trace=replace(run.trace, signals=signals)))
    law = first_values(runs, [axis])[0].law
    for key, true in (("amplitude_m_per_min", amplitude), ("decay_time_s", decay)):
        value, half = law.blocks[f"friction_pulse.{key}"]
        assert value == pytest.approx(true, rel=2e-3)
        assert half < 2e-3 * true
    assert law["position_gain_per_s"] == pytest.approx(1e3 / 30.0, rel=1e-3)


@pytest.mark.slow
@pytest.mark.skipif(not all(f.is_file() for f in ROBOT), reason="recordings of a robot not beside the repository")
def test_a_robot_is_identified_from_one_recording_and_compared_with_the_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first 4 of 10 s of each recording take every step of the example."""
    example = script("examples/real/kr300/run.py", "kr300_example")
    whole = example.resampled

    def beginning(run: MeasuredRun) -> MeasuredRun:
        trace, samples = whole(run).trace, round(4.0 / example.CYCLE_S)
        return replace(run, trace=trace.samples(slice(samples)))

    monkeypatch.setattr(example, "resampled", beginning)
    assert example.main([*map(str, ROBOT), "--out", str(tmp_path)]) == 0
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
