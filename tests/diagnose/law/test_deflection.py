"""The deflection of a drive train is relative to zero force, although the encoders have no common zero."""

import numpy as np
import pytest

from twin.diagnose.law.measure import MeasuredCurve
from twin.diagnose.law.proposals import STRONG
from twin.diagnose.law.relations import Relation
from twin.diagnose.law.residual import SPRING, Samples, deflection_of, transmitted_force
from twin.diagnose.law.springs import stage_over_force, with_fitted_spring
from twin.diagnose.view import view_of
from twin.effects import check_setting, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.motor_and_scale import motor_minus_scale, shifted
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

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


def two_stages(stiffness: float, soft: float, width: float, noise: float = 0.05e-6) -> Samples:
    """Windup under a swinging force, of a spring that is soft up to a width; the encoders have another zero in each run."""
    rng = np.random.default_rng(2)
    run = np.repeat(np.arange(3), 600)
    force = 1500.0 * np.sin(np.linspace(0.0, 40.0, len(run))) * (0.4 + 0.3 * run)
    first = soft * width
    d = np.where(np.abs(force) < first, force / soft, np.sign(force) * (width + (np.abs(force) - first) / stiffness))
    windup = d + rng.normal(0.0, noise, len(d)) + 2e-6 * run
    return Samples("X", SPRING, force, 1.0, run, run, 600 * run, {"windup": windup, "transmitted_force": force})


WINDUP = MeasuredCurve(Relation("transmission", "force", "windup"), 0.5, 1.0, np.zeros(2), np.zeros(2), np.zeros(2))


def test_a_stiff_stage_is_measured_over_the_force():
    """The stiff stage deflects by less than 1 um, which the noise hides in the force over the deflection."""
    stiffness, soft, width = 1.9e9, 30e6, 20e-6
    found = stage_over_force(two_stages(stiffness, soft, width), WINDUP)
    assert found is not None
    assert found.spring == pytest.approx(stiffness, rel=0.1)
    assert found.numbers["width"] == pytest.approx(width, rel=0.01)
    assert found.numbers["height"] == pytest.approx(-(found.spring - soft) * width, rel=0.02)
    assert found.predicts > 0.9


def test_a_linear_spring_has_no_second_stage():
    found = stage_over_force(two_stages(60e6, 60e6, 20e-6), WINDUP)
    assert found is None or found.predicts < STRONG.predicts


def test_a_law_with_a_measured_spring_changes_the_stiffness(mikron):
    found = stage_over_force(two_stages(1.9e9, 30e6, 20e-6), WINDUP)
    spring = check_setting({"name": "transmission_compliance", "axis": "X", "stiffness": 5e7}, mikron, "here")
    (changed,) = with_fitted_spring((spring,), mikron, "X", found, two_stages(1.9e9, 30e6, 20e-6))
    assert changed.parameters["stiffness"] == found.spring
