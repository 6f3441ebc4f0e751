"""Axes without a current loop against the law in plain numpy, closed forms, and a second simulator of a single axis."""

from pathlib import Path

import numpy as np
import pytest

from examples.emps.single_axis import Record, resimulate
from tests.builders.other_structures import machine_text, slides, write_slides
from tests.conftest import swings
from tests.reference.cascade_reference import CHANNELS, simulate_reference
from twin.errors import InputError
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.decoupled_plant import DecoupledPlant, Motion
from twin.simulation.gap import gap_of, predict
from twin.simulation.mujoco_plant import MujocoPlant
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, setpoints_of

ROUNDING = {"position": 1e-13, "velocity_setpoint": 1e-10, "current": 1e-9}
"""Another order of summing, amplified by differentiation over half a millisecond and by the gains [m or rad, per s, the command]."""


@pytest.mark.parametrize("cycles_us", [(500, 1000), (1000, 1000), (250, 2000)])
def test_same_law(tmp_path: Path, cycles_us: tuple[int, int]) -> None:
    machine = slides(tmp_path, cycles_us=cycles_us)
    setpoints = swings(machine, 0.4)
    trace = simulate(machine, setpoints, sample_period=machine.base_tick).trace
    reference = simulate_reference(machine, setpoints, len(trace.time))
    for a, axis in enumerate(machine.axes):
        for channel, bound in ROUNDING.items():
            signal = axis.effort if channel == "current" else channel
            difference = np.abs(trace.get(axis.name, signal) - reference[:, a, CHANNELS.index(channel)]).max()
            assert difference <= bound, f"{axis.name}.{signal}: {difference:.2e}"


def test_same_law_of_an_actuator_with_a_lag(tmp_path: Path) -> None:
    machine = slides(tmp_path, "ZB", (500, 1000)).with_values({"axis.Z.loops.actuator_lag_s": 4e-4})
    setpoints = swings(machine, 0.4)
    trace = simulate(machine, setpoints, sample_period=machine.base_tick).trace
    reference = simulate_reference(machine, setpoints, len(trace.time))[:, 0]
    for channel, bound in ROUNDING.items():
        difference = np.abs(trace.get("Z", channel) - reference[:, CHANNELS.index(channel)]).max()
        assert difference <= bound, f"{channel}: {difference:.2e}"
    # what acts is late; the command is not
    assert np.abs(trace.get("Z", "current") - trace.get("Z", "current_setpoint")).max() > 0.01


def test_a_voltage_is_the_command_and_has_no_lag(tmp_path: Path) -> None:
    text = machine_text("X").replace("position_gain_per_s = 160.0", "actuator_lag_s = 4e-4\nposition_gain_per_s = 160.0")
    with pytest.raises(InputError, match="actuator_lag_s"):
        load_machine(write_slides(tmp_path, text))


def test_same_law_at_the_limit(tmp_path: Path) -> None:
    text = machine_text().replace("peak_voltage_v = 10.0", "peak_voltage_v = 1.5").replace("peak_torque_nm = 3.0", "peak_torque_nm = 0.1")
    machine = load_machine(write_slides(tmp_path, text))
    setpoints = swings(machine, 0.3)
    run = simulate(machine, setpoints, sample_period=machine.base_tick)
    reference = simulate_reference(machine, setpoints, len(run.trace.time))
    for name, limit in (("X", 1.5), ("B", 0.1)):
        axis = machine.axis(name)
        effort = run.trace.get(name, axis.effort)
        assert np.abs(effort).max() == pytest.approx(limit)
        assert run.current_limited_s[name] > 0.01
        assert np.abs(effort - reference[:, machine.axis_names.index(name), CHANNELS.index("current")]).max() < 1e-9


def test_single_axis_integrated_exactly(tmp_path: Path) -> None:
    """The axis on a voltage against the simulator of `twin identify`, which solves the motion between samples in closed form."""
    machine = slides(tmp_path, "X", (1000, 1000))
    axis = machine.axes[0]
    _, position = moves_in_turn(0.0, [0.05, -0.07, 0.02, 2e-4, -2e-4], 0.15, 2.0, 40.0, 0.1, 1e-3)
    trace = simulate(machine, Setpoints(position[:, None], 1e-3)).trace
    time = np.arange(len(position)) * 1e-3
    record = Record(time, position, np.zeros_like(position), np.zeros_like(position), 160.0, 243.0, 35.0)
    expected = resimulate(record, np.array([axis.moving_mass_kg, axis.viscous_friction, axis.coulomb_friction, 0.0]), 0.0)
    assert np.ptp(trace.get("X", "voltage")) > 2.0
    assert np.sqrt(np.mean((trace.get("X", "motor_position") - expected.position) ** 2)) < 1e-7
    assert np.sqrt(np.mean((trace.get("X", "voltage") - expected.voltage) ** 2)) < 5e-3


def test_following_error_of_p_p(tmp_path: Path) -> None:
    """At constant speed v:  s - q = v / Kv + n' + F / (K kv Kv), F friction; the differentiated speed is v."""
    machine = slides(tmp_path, "X", (1000, 1000))
    speed, t = 0.1, np.arange(1500) * 1e-3
    position = np.where(t > 0.05, speed * (t - 0.05), 0.0) - 0.1
    trace = simulate(machine, Setpoints(position[:, None], 1e-3)).trace
    error = (position - trace.get("X", "motor_position"))[-100:]
    friction = 20.0 + 200.0 * speed
    np.testing.assert_allclose(error, speed / 160.0 + friction / (35.0 * 243.0 * 160.0), rtol=1e-6)
    np.testing.assert_allclose(trace.get("X", "voltage")[-100:], friction / 35.0, rtol=1e-6)


def test_a_p_loop_holds_a_weight_by_its_following_error(tmp_path: Path) -> None:
    text = machine_text("Z").replace('structure = "P/PI"', 'structure = "P/P"').replace("speed_integral_time_s = 0.02\n", "")
    machine = load_machine(write_slides(tmp_path, text))
    trace = simulate(machine, Setpoints(np.full((300, 1), 0.1), 1e-3)).trace
    ratio = machine.axes[0].ratio
    np.testing.assert_allclose(0.1 - trace.get("Z", "position"), 20.0 * 9.81 * ratio**2 / (0.05 * 40.0), rtol=1e-9)
    np.testing.assert_allclose(trace.get("Z", "current"), 20.0 * 9.81 * ratio / 0.5, rtol=1e-9)


def test_a_pi_loop_holds_a_weight_without_following_error(tmp_path: Path) -> None:
    trace = simulate(slides(tmp_path, "Z"), Setpoints(np.full((300, 1), 0.1), 1e-3)).trace
    assert np.abs(trace.get("Z", "position") - 0.1).max() < 1e-12


def test_direct_drive_equals_a_screw_with_one_metre_per_radian(tmp_path: Path) -> None:
    direct = slides(tmp_path, "X").axes[0]
    text = machine_text("X")
    for old, new in (
        ('drive = "direct"\n', f"screw_lead_m_per_rev = {2.0 * np.pi}\nrotor_and_screw_inertia_kg_m2 = 0.0\n"),
        ("coulomb_friction_n ", "coulomb_friction_nm "),
        ("viscous_friction_n_s_per_m", "viscous_friction_nm_s_per_rad"),
        ("force_constant_n_per_v", "torque_constant_nm_per_v"),
    ):
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(Exception, match="rotor_and_screw_inertia_kg_m2"):
        load_machine(write_slides(tmp_path, text))
    screw = load_machine(write_slides(tmp_path, text.replace("inertia_kg_m2 = 0.0", "inertia_kg_m2 = 1e-18"))).axes[0]
    assert screw.ratio == pytest.approx(direct.ratio)
    assert screw.loops.speed_gain_nm_s_per_rad == pytest.approx(direct.loops.speed_gain_nm_s_per_rad)
    assert (screw.motor.torque_constant_nm_per_a, screw.coulomb_friction) == (35.0, pytest.approx(20.0))


def test_the_decoupled_plant_agrees_with_mujoco(tmp_path: Path) -> None:
    machine: Machine = slides(tmp_path)
    setpoints = swings(machine, 0.6)
    full = simulate(machine, setpoints, plant_of=MujocoPlant).trace
    position = full.matrix("position")
    speed = np.gradient(position, full.period, axis=0)
    motion = Motion(position, speed, np.gradient(speed, full.period, axis=0), full.period)
    decoupled = simulate(machine, setpoints, plant_of=lambda change: DecoupledPlant(change, motion)).trace
    for axis in machine.axes:
        assert np.abs(full.get(axis.name, "position") - decoupled.get(axis.name, "position")).max() < 1e-9
        assert np.abs(full.get(axis.name, axis.effort) - decoupled.get(axis.name, axis.effort)).max() < 1e-4


def test_a_recording_that_begins_in_motion(tmp_path: Path) -> None:
    """A section of a longer run is simulated from its motion; without a lead-in it would start with a jump."""
    machine = slides(tmp_path, "X", (1000, 1000))
    _, position = moves_in_turn(0.0, [0.12, -0.12], 0.15, 2.0, 40.0, 0.0, 1e-3)
    whole = simulate(machine, Setpoints(position[:, None], 1e-3)).trace
    cut = slice(len(position) // 4, None)
    signals = {key: values[cut] for key, values in whole.signals.items()}
    run = MeasuredRun("cut", Trace(whole.time[cut] - whole.time[cut][0], signals, whole.kinds), None, 0.0)
    assert abs(np.diff(run.trace.get("X", "setpoint")[:2])[0]) > 1e-4
    gap = gap_of(machine, run, predict(machine, run, realisations=1))["X"]
    assert gap["position"].max < 0.2  # um
    assert gap["voltage"].max < 0.02  # V
    jump = simulate(machine, setpoints_of(run.trace, machine)).trace
    assert np.abs(jump.get("X", "position") - run.trace.get("X", "position")).max() > 100e-6
