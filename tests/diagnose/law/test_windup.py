"""The windup of a drive train counts from where no force goes through it, although encoders have no common zero."""

import numpy as np
import pytest

from twin.diagnose.law.residual import transmitted_force, windup
from twin.diagnose.view import view_of
from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints
from twin.simulation.two_encoders import shifted

X = load_machine().with_axes(["X"])
STIFFNESS = 1e8
REACH = 8e-6
HARD = [
    {"name": "constant_force", "axis": "X", "force": -700.0},
    {"name": "transmission_compliance", "axis": "X", "stiffness": STIFFNESS},
    {
        "name": "law", "axis": "X", "block": "transmission", "output": "force", "variables": ["windup"],
        "formula": "power", "height": 0.4 * STIFFNESS * REACH, "reach": REACH, "n": 3.0,
    },
]  # fmt: skip


@pytest.mark.parametrize("zero", [0.0, 5e-6])
def test_windup_of_a_run_that_begins_wound_up_counts_from_no_force(zero):
    """The record of a run that begins under a force draws the spring's law through the origin, wherever its encoders have their zero."""
    position = moves_in_turn(0.0, [0.08, -0.08], 0.3, 8.0, 200.0, 0.1, 1e-3)[1]
    trace = simulate(with_effects(X, HARD), Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=1).trace
    view = view_of(X, MeasuredRun("run", shifted(trace, X.axes[0], zero), "velocity+torque", 0.0))
    axis = view.machine.axis("X")
    wound, force = windup(view, axis, view.trace), transmitted_force(view, axis, view.trace)
    law = STIFFNESS * wound * (1.0 + 0.4 * (wound / REACH) ** 2)
    assert force[0] < -700.0
    assert force.max() > 1500.0
    assert abs(np.median(law - force)) < 0.03 * np.ptp(force)
