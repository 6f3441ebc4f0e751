"""Residuals of the blocks: the recorded and the simulated run are evaluated from the same signals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from twin.diagnose.law.residual import MECHANICS, residuals_of
from twin.diagnose.simulations import in_turn
from twin.diagnose.view import view_of
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

EMPS = Path(__file__).resolve().parents[3] / "examples/emps/axis.toml"


def test_a_control_that_differentiates_the_position_leaves_no_force():
    """Its speed is a mean over two cycles and therefore late. A record without speed is differentiated as it is; so is the simulation."""
    machine = load_machine(EMPS)
    position = moves_in_turn(0.0, [0.1, -0.1], 0.1, 0.8, 50.0, 0.1, 1e-3)[1]
    run = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=0)
    recorded = {key: values for key, values in run.trace.signals.items() if key[1] in ("setpoint", "motor_position", "voltage")}
    trace = replace(run.trace, signals=recorded)
    view = view_of(machine, MeasuredRun("stroke", trace, "off", 0.0))
    (samples,) = [s for s in residuals_of([view], lambda m: m, ("X",), in_turn) if s.block == MECHANICS]
    assert np.std(samples.y) < 3.0 * samples.sigma
