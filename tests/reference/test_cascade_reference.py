"""The compiled loop against the law in plain numpy and a Python loop over mj_step."""

from pathlib import Path

import numpy as np
import pytest

from tests.builders.small_machine import write_small_machine
from tests.conftest import swings
from tests.reference.cascade_reference import CHANNELS, simulate_reference
from twin.machine.machine import Machine, load_machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

ROUNDING = {"position": 1e-14, "velocity": 2e-12, "velocity_setpoint": 2e-12, "current": 5e-10, "current_setpoint": 5e-10}
"""Largest difference of two orders of summing, amplified by the loops [m or rad, per s, A]."""


def check(machine: Machine, setpoints: Setpoints, also: tuple[str, ...] = ()) -> dict[str, float]:
    trace = simulate(machine, setpoints, sample_period=machine.base_tick).trace
    ticks = len(trace.time)
    reference = simulate_reference(machine, setpoints, ticks)
    worst = {}
    for channel, bound in (ROUNDING | dict.fromkeys(also, ROUNDING["velocity_setpoint"])).items():
        for a, axis in enumerate(machine.axes):
            difference = np.abs(trace.get(axis.name, channel) - reference[:, a, CHANNELS.index(channel)]).max()
            worst[channel] = max(worst.get(channel, 0.0), difference)
            assert difference <= bound, f"{axis.name}.{channel}: {difference:.2e}"
    return worst


@pytest.mark.parametrize("feedforward", ["off", "velocity", "velocity+torque"])
def test_same_law(mikron: Machine, feedforward: str) -> None:
    check(mikron.with_feedforward(feedforward), swings(mikron, 0.4))


def test_same_law_at_the_limits(mikron: Machine) -> None:
    machine = mikron
    for name in mikron.axis_names:
        machine = machine.with_axis(name, peak_current_a=3.95, bus_limit_v=25.0)
    check(machine, swings(mikron, 0.3))


def test_same_law_with_other_cycles_and_delays(tmp_path: Path) -> None:
    machine = load_machine(write_small_machine(tmp_path))
    check(machine, swings(machine, 0.5))


def test_same_law_with_commissioned_values_that_differ_from_the_machine(mikron: Machine) -> None:
    machine = mikron.with_axis("X", torque_constant_nm_per_a=1.3, commissioned_inertia=0.01)
    points = swings(mikron, 0.2)
    check(machine, points)
    nominal, changed = (simulate(m, points).trace for m in (mikron, machine))
    assert np.abs(nominal.get("X", "current") - changed.get("X", "current")).max() > 0.05
    assert np.array_equal(nominal.get("Y", "current"), changed.get("Y", "current"))
