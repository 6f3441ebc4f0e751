"""Controls that no recorded signal shows exactly, tried: a PD drive with feedforward whose current is noisy, and a part of the speed fed forward."""

import math
from pathlib import Path

import numpy as np
import pytest

from twin.geometry.scurve import moves_in_turn
from twin.identify.from_recording import NewMachine, machine_from_recording
from twin.machine.machine import Machine, load_machine
from twin.recordings.trace import Trace, write_trace
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

TICK, HELD, COULOMB, VISCOUS, INERTIA = 2.5e-4, 4, 0.6, 4e-3, 5.2e-3
"""Cycle of the speed controller [s], cycles of the position controller in it; A, A s/rad, A s2/rad."""


def new_machine(folder: Path, kv: float, fed: float, kp: float, tn: float, mass_fed: float, noise: float) -> NewMachine:
    """The machine of a rotary axis under w* = kv (s - x) + fed ds/dt and u = kp (w* - w) + kp / tn int (w* - w) + mass_fed d2s/dt2, of position and current every 1 ms."""
    strokes = [np.r_[np.full(n, v), np.zeros(300)] for v, n in ((8.0, 350), (-8.0, 350), (30.0, 350), (-30.0, 350))]
    speed = np.convolve(np.convolve(np.concatenate([np.zeros(300), *strokes]), np.ones(160) / 160.0, "same"), np.ones(60) / 60.0, "same")
    path = np.repeat((np.cumsum(speed) * TICK)[::HELD], HELD)
    slope = np.repeat(np.diff(path[::HELD], prepend=0.0) / (HELD * TICK), HELD)
    bend = np.repeat(np.diff(slope[::HELD], prepend=0.0) / (HELD * TICK), HELD)
    place, command = np.zeros((2, len(path)))
    x = v = seen = summed = wanted = 0.0
    for k in range(len(path)):
        seen += 0.3 * (v - seen)
        place[k] = x
        wanted = kv * (path[k] - x) + fed * slope[k] if k % HELD == 0 else wanted
        summed += (wanted - seen) * TICK / tn
        command[k] = kp * (wanted - seen + summed) + mass_fed * bend[k]
        v += (command[k] - VISCOUS * v - COULOMB * np.tanh(v / 0.05)) / INERTIA * TICK
        x += v * TICK
    command += noise * np.random.default_rng(1).standard_normal(len(path))
    signals = {("A", "setpoint"): path, ("A", "position"): place, ("A", "current"): command}
    write_trace(Trace(np.arange(len(path)) * TICK, signals, {"A": "rotary"}).decimated(HELD), folder / "run.parquet")
    (folder / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\n', encoding="utf-8")
    return machine_from_recording(folder, folder / "made.toml", identified=False)


def test_a_pd_drive_with_feedforward_of_speed_and_acceleration_whose_current_is_noisy(tmp_path: Path) -> None:
    """With an integral part or without the feedforward of the acceleration, no gain follows like this drive."""
    made = new_machine(tmp_path, kv=20.0, fed=1.0, kp=0.4, tn=math.inf, mass_fed=4.8e-3, noise=0.1)
    axis, followed = load_machine(tmp_path / "made.toml").axis("A"), made.followed["A"]
    assert followed.gap < 0.05 * followed.following
    assert axis.structure == "P/P"
    assert axis.loops.position_gain_per_s == pytest.approx(20.0, rel=0.1)
    assert axis.loops.velocity_feedforward == pytest.approx(1.0, abs=0.05)
    assert axis.commissioned_inertia == pytest.approx(4.8e-3, rel=0.15)
    assert not made.lumps[0].law.measured


@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_a_part_of_the_speed_fed_forward_is_no_larger_gain(tmp_path: Path, noise: float) -> None:
    """At a steady speed only (1 - feedforward) / gain shows, 20 ms: 50 1/s without feedforward lag as much."""
    made = new_machine(tmp_path, kv=25.0, fed=0.5, kp=1.5, tn=0.03, mass_fed=0.0, noise=noise)
    law = made.lumps[0].law
    assert law["position_gain_per_s"] == pytest.approx(25.0, rel=0.15)
    assert law["velocity_feedforward"] == pytest.approx(0.5, abs=0.05)
    assert not law.measured


def test_a_current_loop_that_no_signal_shows_is_the_lag_of_an_actuator(mikron: Machine, tmp_path: Path) -> None:
    """A drive with a current loop, a speed controller at 125 us and a position controller at 2 ms, recorded every 1 ms without its data.

    The current jumps after each set point; without the lag the fit puts these jumps one sample early, and gives a wrong mass and gain instead.
    """
    x = mikron.with_axes(["X"])
    way = moves_in_turn(0.0, [0.06, -0.06, 0.03, -0.03], 0.1, 2.0, 40.0, 0.1, 1e-3)[1]
    run = simulate(x, Setpoints(way[:, None], 1e-3), noise_seed=1)
    kept = ("setpoint", "velocity_setpoint", "position", "velocity", "current")
    write_trace(Trace(run.trace.time, {("X", s): run.trace.get("X", s) for s in kept}, {"X": "linear"}), tmp_path / "run.parquet")
    (tmp_path / "campaign.toml").write_text('[[run]]\nfile = "run.parquet"\nfeedforward = "velocity+torque"\n', encoding="utf-8")
    followed = machine_from_recording(tmp_path, tmp_path / "made.toml").followed["X"]
    made, true = load_machine(tmp_path / "made.toml").axis("X"), x.axis("X")
    assert followed.effort_gap < 0.01 * followed.effort_range
    per_ampere = true.ratio / true.motor.torque_constant_nm_per_a
    assert made.moving_mass_kg == pytest.approx(home_inertia_at_motor(x)[0] / true.ratio * per_ampere / true.ratio, rel=0.05)
    assert made.loops.speed_integral_time_s == pytest.approx(true.loops.speed_integral_time_s, rel=0.1)
    assert 1e-4 < made.loops.actuator_lag_s < 5e-4
