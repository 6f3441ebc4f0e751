"""A recorded speed set point counts as the output of a position controller only if it answers the following error."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.identify_campaigns import SHORT_QUICK, campaign, recorded
from twin.diagnose.check_campaign import notes_of
from twin.identify.check_recording import missing_signals
from twin.machine.machine import Machine
from twin.recordings.campaign import read_campaign
from twin.recordings.profile_speed import PROFILE, answers_position, held_samples
from twin.recordings.trace import Trace, write_trace


@pytest.mark.parametrize("feedforward", ["off", "velocity"])
def test_a_controller_answers_its_error_and_a_profile_does_not(mikron: Machine, tmp_path: Path, feedforward: str) -> None:
    machine = mikron.with_axes(["X"])
    run = recorded(machine, "quick", SHORT_QUICK, feedforward, 3)
    assert answers_position([run.trace], "X") is True
    slope = np.gradient(run.trace.get("X", "setpoint"), run.trace.period)
    profile = Trace(run.trace.time, {**run.trace.signals, ("X", "velocity_setpoint"): np.round(slope, 5)}, run.trace.kinds)
    write_trace(profile, tmp_path / "quick.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "quick.parquet"\n', encoding="utf-8")
    read = read_campaign(tmp_path)
    assert not read.runs[0].trace.has("X", "velocity_setpoint")
    # it is said, and nothing is derived from it
    assert any(PROFILE in note for note in notes_of(read, machine))
    assert any(f.text == PROFILE for f in missing_signals(machine, read.runs))
    assert not any(PROFILE in note for note in notes_of(campaign([run]), machine))


@pytest.mark.parametrize(("profiles", "kept"), [("Z", "XYZ"), ("YZ", "X")])
def test_one_axis_of_several_that_does_not_answer_has_another_fault(mikron: Machine, tmp_path: Path, profiles: str, kept: str) -> None:
    """Within a dead band of its position controller an axis follows its feedforward alone."""
    run = recorded(mikron.with_axes(["X"]), "quick", SHORT_QUICK, "velocity", 3).trace
    signals = {(axis, name): values for (_, name), values in run.signals.items() for axis in "XYZ"}
    signals |= {(axis, "velocity_setpoint"): np.gradient(run.get("X", "setpoint"), run.period) for axis in profiles}
    write_trace(Trace(run.time, signals, dict.fromkeys("XYZ", "linear")), tmp_path / "quick.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "quick.parquet"\n', encoding="utf-8")
    trace = read_campaign(tmp_path).runs[0].trace
    assert [axis for axis in "XYZ" if trace.has(axis, "velocity_setpoint")] == list(kept)


def test_a_record_too_short_to_show_a_controller_gives_no_gain(tmp_path: Path) -> None:
    """40 samples of a robot that is turned around: the speed set point is the slope of the set point, and delays of the law could fit anything."""
    t = np.arange(40) * 8e-3
    slope = np.clip(-0.8 + 15.0 * (t - 0.02), -0.8, 1.0) * 1e-3
    setpoint = np.cumsum(slope) * 8e-3
    signals = {("X", "setpoint"): setpoint, ("X", "velocity_setpoint"): slope, ("X", "position"): np.interp(t - 0.01, t, setpoint) + 2e-7}
    write_trace(Trace(t, signals, {"X": "linear"}), tmp_path / "turned.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "turned.parquet"\n', encoding="utf-8")
    read = read_campaign(tmp_path).runs[0]
    assert answers_position([Trace(t, signals, {"X": "linear"})], "X") is None
    assert not read.trace.has("X", "velocity_setpoint")
    assert "X" in read.profiles


@pytest.mark.parametrize("encoder", ["scale", "motor"])
def test_a_controller_slower_than_the_record_answers_its_error(mikron: Machine, encoder: str) -> None:
    """Its output is recorded twice, and the second time it answers nothing."""
    machine = mikron.with_axes(["X"]).with_values(
        {"control.position_cycle_us": 4000, "measurement.sample_period_us": 2000, "axis.X.encoder": encoder}
        | {"axis.X.loops.position_gain_per_s": 30.0, "axis.X.loops.position_delay_s": 0.004}
        | {f"measurement.{key}_m": 5e-7 for key in ("linear_scale_resolution", "motor_encoder_resolution", "linear_scale_noise")}
    )
    assert answers_position([recorded(machine, "quick", SHORT_QUICK, "velocity+torque", 3).trace], "X") is True


@pytest.mark.parametrize(("moves", "fed"), [(1, True), (6, False)])
def test_pulses_of_friction_compensation_are_no_profile(moves: int, fed: bool) -> None:
    """A control adds a pulse where its first move starts, which the slope of the set point does not give. One move tells if its feedforward is recorded."""
    rng, cycle, gain = np.random.default_rng(2), 2e-3, 33.0
    t = np.arange(150 * moves) * cycle
    setpoint = 1.5e-3 * sum((-1.0) ** k * (1.0 - np.cos(np.pi * np.clip((t - 0.04 - 0.3 * k) / 0.2, 0.0, 1.0))) for k in range(moves))
    feedforward = np.gradient(setpoint, cycle) + 2e-3 * np.exp(-(t - 0.04) / 0.015) * (t >= 0.04)
    position = np.interp(t - 8e-3, t, setpoint) + 3e-6 * np.sin(2 * np.pi * 28.0 * t) + 1e-7 * rng.standard_normal(len(t))
    output = feedforward + gain * (np.interp(t - 3e-3, t, setpoint) - position)
    signals = {("X", "setpoint"): setpoint, ("X", "position"): position, ("X", "velocity_setpoint"): output}
    signals |= {("X", "velocity_feedforward"): feedforward} if fed else {}
    assert answers_position([Trace(t, signals, {"X": "linear"})], "X") is True


def test_an_output_that_rests_in_a_dead_band_has_the_cycle_of_the_record() -> None:
    """A controller of 1.25 samples leaves out every fifth one; the output of one with a dead band stands for any number of them."""
    rng = np.random.default_rng(0)
    steps = 1e-3 * rng.random(2500)
    rests = np.concatenate([np.r_[np.ones(6), np.zeros(rng.integers(1, 9))] for _ in range(300)])[: len(steps)]
    assert held_samples([np.cumsum(steps * rests)]) == 1
    assert held_samples([np.cumsum(steps)[np.floor(np.arange(len(steps)) / 1.25).astype(int)]]) == 0
