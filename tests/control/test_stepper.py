"""The stepper block against what is known of a stepper motor: angle under load, frequency of its swing, steps lost by whole periods."""

import math

import numpy as np
import pytest

from tests.builders.other_structures import machine_text, write_slides
from twin.machine.loops import loops_of
from twin.machine.machine import Machine, load_machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

PERIOD = 0.8e-3  # four full steps of 200 a revolution on a screw of 40 mm
MASS, HOLDING, DAMPING = 95.0, 200.0, 3000.0  # kg, N, N s/m


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    """X of the slides as a stepper: a force as command, damping and holding force as the two gains."""
    gain = 2.0 * math.pi * HOLDING / (PERIOD * DAMPING)
    text = machine_text("X", (50, 50))
    for old, new in (
        ('command = "voltage"', 'command = "torque"'),
        ("force_constant_n_per_v = 35.0\n", ""),
        ("peak_voltage_v = 10.0", "peak_force_n = 10000.0"),
        ("position_gain_per_s = 160.0", f"position_gain_per_s = {gain}"),
        ("speed_gain_v_s_per_m = 243.0", f"speed_gain_n_s_per_m = {DAMPING}"),
        ("speed_mean_cycles = 2", "speed_mean_cycles = 0"),
        ("coulomb_friction_n = 20.0", "coulomb_friction_n = 0.0"),
        ("viscous_friction_n_s_per_m = 200.0", "viscous_friction_n_s_per_m = 0.0"),
    ):
        assert old in text
        text = text.replace(old, new)
    folder = tmp_path_factory.mktemp("stepper")
    return load_machine(write_slides(folder, text + f"[axis.X.block.stepper]\ntorque_period_m = {PERIOD}\n"))


def rest(machine: Machine, path: np.ndarray, force: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Set point and position at 1 ms; `force` [N] pushes against the motion."""
    own = machine.with_values({"axis.X.constant_force_n": force})
    trace = simulate(own, Setpoints(path[:, None], 1e-3), sample_period=1e-3).trace
    return trace.get("X", "setpoint"), trace.get("X", "position")


@pytest.mark.parametrize("share", [0.2, -0.7, 0.95])
def test_under_load_the_rotor_lags_by_the_static_angle(machine: Machine, share: float) -> None:
    s, x = rest(machine, np.zeros(1500), share * HOLDING)
    assert (s - x)[-1] == pytest.approx(PERIOD / (2.0 * math.pi) * math.asin(share), rel=1e-4)


def test_it_swings_at_its_own_frequency_and_the_margins_know_it(machine: Machine) -> None:
    stiffness = 2.0 * math.pi * HOLDING / PERIOD
    own = math.sqrt(stiffness / MASS) / (2.0 * math.pi)
    # the closed position loop D (Kv e - v) = M a has its resonance there
    loop = loops_of(machine, machine.axis("X"))[-1]
    f = np.linspace(0.5 * own, 1.5 * own, 400)
    ideal = stiffness / (stiffness - MASS * (2.0 * math.pi * f) ** 2 + 2j * math.pi * f * DAMPING)
    assert np.abs(loop.closed_response(f)) == pytest.approx(np.abs(ideal), rel=0.02)
    # a step of the set point by an eighth of a full step
    s, x = rest(machine, np.r_[np.zeros(20), np.full(400, PERIOD / 32.0)])
    swing = (x - s)[20:]
    crossings = np.flatnonzero(np.diff(np.sign(swing)) != 0)
    damped = math.sqrt(stiffness / MASS - (DAMPING / (2.0 * MASS)) ** 2)
    assert np.diff(crossings[:2])[0] * 1e-3 == pytest.approx(math.pi / damped, abs=1.5e-3)


def test_steps_are_lost_by_whole_periods(machine: Machine) -> None:
    fed = machine.with_values({"axis.X.loops.velocity_feedforward": 1.0})  # the damping acts between field and rotor

    def lost(acceleration: float) -> float:
        speed = acceleration * (np.clip(np.arange(900) * 1e-3 - 0.02, 0.0, 0.1) - np.clip(np.arange(900) * 1e-3 - 0.2, 0.0, 0.1))
        s, x = rest(fed, np.cumsum(speed) * 1e-3)
        return float((s - x)[-1] / PERIOD)

    # the holding force alone accelerates the mass by 2.1 m/s2
    assert lost(1.0) == pytest.approx(0.0, abs=1e-3)
    far = lost(8.0)
    assert abs(far) > 0.9
    assert far == pytest.approx(round(far), abs=1e-2)


def test_microsteps_round_the_field(machine: Machine) -> None:
    step = PERIOD / 16.0
    own = machine.with_values({"axis.X.block.stepper.microstep_m": step})
    for target in (0.3 * step, 0.7 * step, 5.4 * step):
        path = np.r_[np.linspace(0.0, target, 200), np.full(800, target)]
        _, x = rest(own, path)
        assert x[-1] == pytest.approx(step * round(target / step), abs=1e-3 * step)
