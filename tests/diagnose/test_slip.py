"""Normal imperfections of every axis, identified from records with noise and finite encoder resolution: slip before break-away, and the drive
train of an axis with an effect."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest

from tests.diagnose.law.test_closed_loop import X, runs_of
from twin.diagnose.corrected import limited_deviations
from twin.diagnose.fit import fit_effects, no_effect, simulated_response
from twin.diagnose.imperfections import moved_to, on_imperfect_machine, with_imperfections
from twin.diagnose.observe import Variation, observe
from twin.diagnose.settings import T
from twin.diagnose.slip import with_drive_trains, with_refitted_slip
from twin.diagnose.state import GroupState
from twin.diagnose.tolerance import Nuisance, least_share
from twin.diagnose.tuning import linearised, tuning_of
from twin.diagnose.view import view_of
from twin.effects import EFFECTS, Setting, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

AXIS = X.axes[0]
TRAVEL = 0.4e-6
SLIP = {"name": "presliding", "axis": "X", "stiffness": AXIS.coulomb_friction / TRAVEL}


@pytest.fixture(scope="module")
def group():
    return observe([view_of(X, run) for run in runs_of([SLIP])], ("X",))


def test_noise_in_the_loop_does_not_change_the_control_law(group):
    """The inputs of a simulation with noise are rounded differently from the recorded ones. This is no error of the control law."""
    assert X.noise(AXIS).position_resolution > 0.0
    nuisance = Nuisance("X", "slip")
    answer = group.responses([Variation(lambda m: nuisance.apply(m, 1.0 + 0.5 * m.parameter_tolerance), axes=("X",), shaken=True)])[0]
    rows = np.concatenate([np.arange(group.size)[c.rows] for c in group.channels if c.name == "controller"])
    assert rows.size
    assert np.abs(answer[rows]).max() < 1e-3 * np.abs(answer).max()
    assert answer.any()


def test_slip_is_found_with_its_size(group):
    tuning = with_imperfections(tuning_of(group), group, group.residual)
    found = {n.quantity: float(v) for n, v in zip(tuning.nuisances, tuning.solve(group.residual) * tuning.spread)}
    assert found["slip"] / X.parameter_tolerance * T.normal_slip * 1e-6 == pytest.approx(TRAVEL, rel=0.3)


def test_the_slope_of_slip_is_that_at_its_size(group):
    """Regression: it was the response to the whole slip over its size. Along that chord, fits crept towards the best slip in many small steps."""
    chord = with_imperfections(tuning_of(group), group, group.residual)
    at_slip, chord = on_imperfect_machine(group, chord, group.residual)
    slope = linearised(chord, at_slip, (), 0.0, only_imperfections=True)
    i = [n.quantity for n in slope.nuisances].index("slip")
    more = 0.15 * float(slope.base[i])
    answer = at_slip.responses([Variation(lambda m: slope.nuisances[i].apply(m, 1.0 + more), axes=("X",), shaken=True)])[0]
    missed = [float(np.linalg.norm(answer - of.jacobian.whole(i) * more / of.spread)) for of in (slope, chord)]
    assert missed[0] < 0.8 * missed[1]


WOUND = 3e-6
"""Initial windup of the drive train [m]; it makes the resting load creep."""

SHARE = 0.08
"""Slip found by a search without effects, as a share of the largest normal one."""


@pytest.fixture(scope="module")
def wound_up():
    """The state of a machine with higher friction before its slip is fitted again; the slip is far too small."""
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": 3e9}
    friction = {"name": "coulomb_friction", "axis": "X", "factor": 1.3}
    machine = with_effects(X, [spring, SLIP, friction])
    position = moves_in_turn(0.0, [0.02, -0.02], 0.03, 0.3, 5.0, 0.3, 1e-3)[1]
    runs = []
    for seed in range(2):
        setpoints = Setpoints(position[:, None] * (1 + seed), 1e-3, deflection=np.array([WOUND]))
        trace = simulate(machine, setpoints, sample_period=1e-3, noise_seed=seed).trace
        runs.append(MeasuredRun(f"run{seed}", trace, "velocity+torque", 0.0))
    rigid = observe([view_of(X, run) for run in runs], ("X",))
    there = [Setting(EFFECTS["coulomb_friction"], "X", {"factor": 1.3})]
    left = rigid.residual - simulated_response(rigid, there)
    tuning = with_imperfections(tuning_of(rigid), rigid, left)
    theta = tuning.solve(left)[: len(tuning.nuisances)]
    i = [n.quantity for n in tuning.nuisances].index("slip")
    theta[i] = SHARE * X.parameter_tolerance / tuning.spread
    group, tuning = moved_to(rigid, tuning, theta)
    fit = fit_effects(group, tuning, there, 2)
    assert fit is not None
    return GroupState(group, rigid, tuning, fit, 1.0).with_accepted(1)


def slip_of(found):
    i = [n.quantity for n in found.tuning.nuisances].index("slip")
    return limited_deviations(found)[i] / X.parameter_tolerance * T.normal_slip * 1e-6


def test_slip_is_sized_by_the_creep_of_a_resting_axis(wound_up):
    better = with_refitted_slip(wound_up)
    assert slip_of(better) == pytest.approx(TRAVEL, rel=0.25)
    assert better.fit.loss < 0.9 * wound_up.fit.loss


def test_slip_of_the_right_size_is_kept(wound_up):
    better = with_refitted_slip(wound_up)
    again = with_refitted_slip(better)
    assert slip_of(again) == pytest.approx(slip_of(better), rel=0.1)


def test_missed_slip_is_found(group):
    """The residual is near noise but the slip is missing: all sizes tried on a rigid machine may have been far from the true one."""
    plain = tuning_of(group)
    bare = no_effect(group, plain)
    missed = GroupState(group, group, plain, bare, 1.0)
    assert missed.fit.loss < T.small_residual * group.expected_loss
    found = with_refitted_slip(missed)
    assert slip_of(found) == pytest.approx(TRAVEL, rel=0.3)
    assert found.fit.loss < missed.fit.loss


@pytest.mark.parametrize(("share", "kept"), [(1.2, True), (0.8, False)])
def test_the_stiffest_contact_is_that_of_the_simulation_step(wound_up, share: float, kept: bool):
    """Regression: slip below a fixed share of the normal one was left out, also where the step resolves it. A stiff contact made a machine unknown."""
    slip = Nuisance("X", "slip")
    i = wound_up.tuning.nuisances.index(slip)
    least = least_share(X, slip)
    assert 0.0 < least < 0.04
    theta = np.where(np.arange(len(wound_up.tuning.base)) == i, share * least * X.parameter_tolerance, wound_up.tuning.base)
    stiff = replace(
        wound_up, tuning=replace(wound_up.tuning, base=theta), fit=replace(wound_up.fit, coefficients=0.0 * wound_up.fit.coefficients)
    )
    assert slip_of(stiff) == pytest.approx(share * least * T.normal_slip * 1e-6 if kept else 0.0)


def test_slip_is_not_fitted_while_effects_are_missing(wound_up):
    bare = replace(wound_up, fit=no_effect(wound_up.group, wound_up.tuning))
    assert bare.fit.loss > T.small_residual * wound_up.group.expected_loss
    assert with_refitted_slip(bare) is bare


def test_a_cyclic_error_is_sized_with_the_drive_train_that_it_shakes():
    """Scale and current only: nothing isolates the drive train. On a rigid one the rotor follows the wave without inertia of its own."""
    spring = {"name": "transmission_compliance", "axis": "X", "stiffness": (2.0 * math.pi * 300.0) ** 2 * AXIS.moving_mass_kg}
    wave = {"name": "cyclic_error", "axis": "X", "amplitude": 5e-6, "phase_rad": 1.0}
    views = []
    for run in runs_of([wave, spring], ((0.05, 0.1), (0.1, 0.15))):
        signals = {key: values for key, values in run.trace.signals.items() if key[1] in ("setpoint", "position", "current")}
        views.append(view_of(X, replace(run, trace=replace(run.trace, signals=signals))))
    group = observe(views, ("X",))
    tuning = tuning_of(group)
    fit = fit_effects(group, tuning, [Setting(EFFECTS["cyclic_error"], "X", {"amplitude": 4e-6, "phase_rad": 1.0})])
    assert fit is not None
    rigid = GroupState(group, group, tuning, fit, 1.0).with_accepted(1)
    assert rigid.fit.settings[0].size < 4.8e-6
    assert rigid.fit.loss > 2.0 * group.expected_loss
    elastic = with_drive_trains(rigid)
    assert elastic.fit.settings[0].size == pytest.approx(5e-6, rel=0.01)
    assert elastic.fit.loss < group.expected_loss
    mode = T.normal_mode_hz / math.sqrt(limited_deviations(elastic)[-1] / X.parameter_tolerance)
    assert mode == pytest.approx(300.0, rel=0.15)
    assert with_drive_trains(elastic) is elastic
