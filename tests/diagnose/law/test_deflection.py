"""The deflection of a drive train is relative to zero force, although the encoders have no common zero."""

import numpy as np
import pytest

from twin.diagnose.law.residual import deflection_of, transmitted_force
from twin.diagnose.view import view_of
from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.simulation.two_encoders import motor_minus_scale, shifted

X = load_machine().with_axes(["X"])
STIFFNESS = 1e8
REACH = 8e-6
FORCE = {"name": "constant_force", "axis": "X", "force": -700.0}
LAW = {"name": "law", "axis": "X", "block": "transmission", "output": "force", "variables": ["windup"]}
HARDENS = (STIFFNESS, {"formula": "power", "height": 0.4 * STIFFNESS * REACH, "reach": REACH, "n": 3.0})
GIVES_WAY = (5.0 * STIFFNESS, {"formula": "stage", "height": -4.5 * STIFFNESS * REACH, "width": REACH})


@pytest.mark.parametrize("zero", [0.0, 5e-6])
@pytest.mark.parametrize(("stiffness", "numbers"), [HARDENS, GIVES_WAY], ids=["hardens", "gives way"])
def test_deflection_of_a_run_that_begins_under_force_is_relative_to_zero_force(stiffness, numbers, zero):
    """The spring characteristic of a run that begins under a force passes through the origin, for any zero of the encoders."""
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": stiffness}
    position = moves_in_turn(0.0, [0.08, -0.08], 0.3, 8.0, 200.0, 0.1, 1e-3)[1]
    machine = with_effects(X, [FORCE, spring, {**LAW, **numbers}])
    trace = simulate(machine, Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    view = view_of(X, MeasuredRun("run", shifted(trace, X.axes[0], zero), "velocity+torque", 0.0))
    axis = view.machine.axis("X")
    force = transmitted_force(view, axis, view.trace)
    assert force[0] < -300.0
    assert force.max() > 1500.0
    there = motor_minus_scale(trace, "X")  # the simulated encoders are equal without deflection
    beside = np.median(deflection_of(view, axis, view.trace) - there)
    assert abs(beside) < 0.15 * REACH
