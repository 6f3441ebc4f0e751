"""Velocity feedforward and acceleration as columns of a run."""

from __future__ import annotations

import numpy as np
import pytest

from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine
from twin.simulation.position_command import with_command_columns
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


@pytest.mark.parametrize(("word", "weight"), [("off", 0.0), ("velocity", 1.0)])
def test_feedforward_and_acceleration(mikron: Machine, word: str, weight: float) -> None:
    """The velocity feedforward is the speed of the set point over the last position cycle; the acceleration is that of the jerk-limited move."""
    machine = mikron.with_axes(["X"]).with_feedforward(word)
    _, way = moves_in_turn(0.0, [0.05], 0.1, 2.5, 5.0, 0.1, 1e-3)
    setpoints = Setpoints(way[:, None], 1e-3)
    run = simulate(machine, setpoints)
    trace = with_command_columns(run.trace, machine, setpoints)
    cycle = round(machine.position_cycle / trace.period)
    speed = np.zeros(len(way))
    speed[cycle:] = (way[cycle:] - way[:-cycle]) / machine.position_cycle
    at = np.arange(0, len(trace.time), cycle)
    np.testing.assert_allclose(trace.get("X", "velocity_feedforward")[at], weight * speed[at], atol=1e-5)
    commanded = np.gradient(np.gradient(way, 1e-3), 1e-3)
    assert trace.get("X", "acceleration").max() == pytest.approx(commanded.max(), rel=0.15)
