"""The part of a recorded feedforward beyond the slope of the set points."""

import numpy as np
import pytest

from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import commissioned_inertia
from twin.simulation.position_command import command_of
from twin.simulation.setpoints import recorded_setpoints

TP = 2e-3
AMPLITUDE, DECAY_S = 0.12e-3, 20e-3


def recorded(weight: float = 1.0, delay_cycles: float = 0.0, pulses: bool = True) -> tuple[Trace, np.ndarray]:
    """An oscillating axis whose feedforward is the slope of the set points plus a decaying pulse after each reversal."""
    t = np.arange(1500) * TP
    s = 0.01 * (1.0 - np.cos(2 * np.pi * 0.7 * np.maximum(t - 0.1, 0.0)))
    slope = np.diff(s, prepend=s[0]) / TP
    late = np.interp(t - delay_cycles * TP, t, slope)
    pulse = np.zeros(len(t))
    signs = np.sign(late)
    for i in np.flatnonzero(np.diff(signs) != 0) + 1:
        pulse[i:] = signs[i] * AMPLITUDE * np.exp(-(t[i:] - t[i]) / DECAY_S)
    pulse *= pulses
    trace = Trace(t, {("X", "setpoint"): s, ("X", "velocity_feedforward"): weight * late + pulse}, {"X": "linear"})
    return trace, pulse


@pytest.fixture
def machine(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"]).with_values({"control.position_cycle_us": TP * 1e6, "axis.X.loops.feedforward_delay_s": 0.0})


@pytest.mark.parametrize(("weight", "delay_cycles"), [(1.0, 0.0), (0.9, 0.0), (1.0, 2.0), (1.0, 0.3)])
def test_pulses_are_found_for_any_weight_and_delay(machine: Machine, weight: float, delay_cycles: float) -> None:
    trace, pulse = recorded(weight, delay_cycles)
    fed = recorded_setpoints(trace, machine).added_feedforward
    assert fed is not None
    assert np.sqrt(np.mean((fed[:, 0] - pulse) ** 2)) < 0.03 * np.sqrt(np.mean(pulse**2))


@pytest.mark.parametrize(("weight", "delay_cycles"), [(1.0, 0.0), (0.8, 0.0), (1.0, 3.0)])
def test_a_wrong_weight_or_delay_is_not_hidden(machine: Machine, weight: float, delay_cycles: float) -> None:
    trace, _ = recorded(weight, delay_cycles, pulses=False)
    fed = recorded_setpoints(trace, machine).added_feedforward
    assert fed is None or np.abs(fed).max() < 1e-3 * 0.044


def test_strokes_at_constant_speed_do_not_hide_the_delay(machine: Machine) -> None:
    """Most of the record fits exactly with any delay; the ramps show it."""
    speed = np.repeat([0.0, 0.1, 0.0, -0.1, 0.0], [50, 600, 50, 600, 50])
    speed = np.convolve(speed, np.ones(20) / 20.0, "same")
    s = np.round(np.cumsum(speed) * TP, 9)
    fed = np.round(np.diff(s, prepend=s[0]) / TP, 7)
    trace = Trace(np.arange(len(s)) * TP, {("X", "setpoint"): s, ("X", "velocity_feedforward"): fed}, {"X": "linear"})
    assert recorded_setpoints(trace, machine).added_feedforward is None


def test_another_quantity_is_not_used(machine: Machine) -> None:
    trace, _ = recorded()
    rng = np.random.default_rng(0)
    trace.signals["X", "velocity_feedforward"] = rng.standard_normal(len(trace.time))
    assert recorded_setpoints(trace, machine).added_feedforward is None


def test_pulses_are_part_of_the_command(machine: Machine) -> None:
    trace, pulse = recorded()
    setpoints = recorded_setpoints(trace, machine)
    inertia = commissioned_inertia(machine)
    command = command_of(machine, inertia, setpoints, 0, len(pulse)).velocity_feedforward[:, 0]
    np.testing.assert_allclose(command, trace.get("X", "velocity_feedforward"), atol=1e-6)
    assert not command_of(machine.with_feedforward("off"), inertia, setpoints, 0, len(pulse)).velocity_feedforward.any()
