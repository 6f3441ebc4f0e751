"""Two encoders are recorded: the speed set point shows which of them closes the position loop. Else a spring between them would pass for a dead band."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.builders.identify_campaigns import path
from twin.identify import first_values as first_values_of
from twin.identify.first_values import first_values
from twin.identify.from_recording import machine_from_recording
from twin.identify.position_control import PositionControl
from twin.identify.position_law_search import Found
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace, write_trace

GAIN, PERIOD, LAG_S = 17.0, 1e-3, 4e-3


def strokes(closes: str) -> Trace:
    """Strokes at three speeds. Friction of the load winds the spring by 8 um, acceleration by 20 um per m/s2; a P controller, and a drive with a lag."""
    s = np.concatenate([path([0.4 * v, 0.0], [v, v], acceleration=1.0, jerk=40.0, dwell=0.1) for v in (0.02, 0.06, 0.15)])[::1]
    x, v, speeds, encoders = 0.0, 0.0, np.zeros(len(s)), np.zeros((2, len(s)))
    wound = before = 0.0
    for k, wanted in enumerate(s):
        aim = 8e-6 * np.sign(v) + 20e-6 * (v - before) / PERIOD
        wound += (aim - wound) * 0.2
        before = v
        encoders[:, k] = np.round([x, x - wound], 7)
        speeds[k] = GAIN * (wanted - encoders[0 if closes == "motor" else 1, k])
        v += (speeds[k] - v) * PERIOD / LAG_S
        x += v * PERIOD
    signals = {
        ("X", "setpoint"): s,
        ("X", "motor_position"): encoders[0],
        ("X", "position"): encoders[1],
        ("X", "velocity_setpoint"): np.round(speeds, 7),
    }
    return Trace(np.arange(len(s)) * PERIOD, signals, {"X": "linear"})


@pytest.mark.parametrize("closes", ["motor", "scale"])
def test_the_speed_set_point_shows_which_encoder_closes_the_loop(tmp_path: Path, closes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The plain laws differ clearly, so the laws that take long are fitted to one encoder only."""
    fitted, fit = [], first_values_of.richest_law

    def counted(plain: Found, *of: Any, **more: Any) -> PositionControl | str:
        fitted.append(plain.law.axis.encoder)
        return fit(plain, *of, **more)

    monkeypatch.setattr(first_values_of, "richest_law", counted)
    write_trace(strokes(closes), tmp_path / "strokes.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "strokes.parquet"\n', encoding="utf-8")
    machine_from_recording(tmp_path, tmp_path / "made.toml", identified=False)
    text = (tmp_path / "made.toml").read_text(encoding="utf-8")
    axis = load_machine(tmp_path / "made.toml").axis("X")
    assert axis.encoder == closes
    assert fitted == [closes]
    assert "dead_band" not in text
    assert axis.loops.position_gain_per_s == pytest.approx(GAIN, rel=0.01)


def test_without_a_speed_set_point_the_encoder_is_assumed(tmp_path: Path) -> None:
    run = strokes("motor")
    signals = {key: values for key, values in run.signals.items() if key[1] != "velocity_setpoint"}
    write_trace(Trace(run.time, signals, run.kinds), tmp_path / "strokes.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "strokes.parquet"\n', encoding="utf-8")
    machine_from_recording(tmp_path, tmp_path / "made.toml", identified=False)
    assert "assumed: closes the position loop" in (tmp_path / "made.toml").read_text(encoding="utf-8")


def test_runs_of_two_sample_periods_show_one_control(tmp_path: Path) -> None:
    """Their pieces have other numbers of rows: the comparison of the loops in NC and drive ended in a traceback."""
    write_trace(strokes("scale"), tmp_path / "fine.parquet")
    write_trace(strokes("scale").decimated(2), tmp_path / "coarse.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "fine.parquet"\n[[run]]\nfile = "coarse.parquet"\n', encoding="utf-8")
    machine_from_recording(tmp_path, tmp_path / "made.toml", identified=False)
    assert load_machine(tmp_path / "made.toml").axis("X").loops.position_gain_per_s == pytest.approx(GAIN, rel=0.02)


@pytest.mark.parametrize(("on_load", "play", "found"), [(0.8, 0.0, 0.8), (0.2, 0.0, 0.2), (0.4, 8e-6, 0.5)])
def test_the_deflection_of_the_drive_train_shows_where_friction_acts(on_load: float, play: float, found: float) -> None:
    """Half of the mass is on the load: the deflections under friction and under acceleration are in the ratio of friction to load.

    With a play the deflection at a reversal is more than that of all friction, and nothing is known.
    """
    s = np.concatenate([path([0.2, 0.0], [v, v], acceleration=2.0, jerk=60.0, dwell=0.3) for v in (0.1, 0.3)])
    period, stiffness, mass, coulomb = 1e-3, 4e5, 3.0, 1.5
    v = np.gradient(s, period)
    a, direction = np.gradient(v, period), np.sign(np.round(v, 5))
    twist = (0.5 * mass * a + on_load * coulomb * direction) / stiffness + 0.5 * play * direction
    noise = np.random.default_rng(2).standard_normal((3, len(s)))
    signals = {
        ("X", "setpoint"): s,
        ("X", "position"): s + 1e-7 * noise[0],
        ("X", "motor_position"): s + twist + 1e-7 * noise[1],
        ("X", "current"): mass * a + coulomb * direction + 0.3 * v + 0.02 * noise[2],
    }
    run = MeasuredRun("strokes", Trace(np.arange(len(s)) * period, signals, {"X": "linear"}), None, 0.0)
    (axis,) = first_values([run], ["X"])
    assert axis.friction_on_load == pytest.approx(found, abs=0.05)
