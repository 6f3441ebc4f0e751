"""A filter of a control block in place of several effects that imitate it, and effects that are there and stay."""

from __future__ import annotations

import pytest

from tests.builders.diagnosis_state import found_of
from twin.diagnose.cross_validation import folds_of
from twin.diagnose.fit import fit_effects, simulated_response
from twin.diagnose.law.laws import costs_more_than_a_law, in_the_loop, laws_of
from twin.diagnose.observe import observe
from twin.diagnose.tuning import tuning_of
from twin.diagnose.view import view_of
from twin.effects import settings_of, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

X = load_machine().with_axes(["X"])
NOTCH = {
    "name": "law", "axis": "X", "block": "speed controller", "output": "current", "variables": ["current_setpoint"], "formula": "notch",
    "frequency_hz": 150.0, "width": 1.2,
}  # fmt: skip
EFFECTS = [
    {"name": "torque_constant", "axis": "X", "factor": 1.05},
    {"name": "coulomb_friction", "axis": "X", "factor": 1.3},
    {"name": "current_filter", "axis": "X", "time_constant_s": 9e-4},
]


def laws_instead_of(effects: list[dict], there: list[dict]):
    """Laws of X in place of these effects, fitted to fast runs of a machine that has what is `there`."""
    runs = []
    for seed, (distance, speed) in enumerate(((0.05, 0.4), (0.1, 0.6), (0.15, 0.8))):
        position = moves_in_turn(0.0, [distance, -distance, distance / 2, -distance / 2], speed, 5.0, 200.0, 0.1, 1e-3)[1]
        run = simulate(with_effects(X, there), Setpoints(position[:, None], 1e-3), sample_period=1e-3, noise_seed=seed)
        runs.append(MeasuredRun(f"run{seed}", run.trace, "velocity+torque", 0.0))
    group, settings = observe([view_of(X, run) for run in runs], ("X",)), settings_of(with_effects(X, effects))
    tuning = tuning_of(group, settings, simulated_response(group, settings))
    fit = fit_effects(group, tuning, settings)
    assert fit is not None
    assert costs_more_than_a_law(in_the_loop(fit.settings, "X"))
    return laws_of([found_of(group, tuning, fit)], ["X"], folds_of(3), explained=["X"])


def test_a_notch_replaces_the_effects_that_imitate_it():
    laws = laws_instead_of(EFFECTS, [NOTCH])
    assert [s.effect.name for s in settings_of(laws.corrected)] == ["law"]
    assert laws.laws[0].setting.parameters["frequency_hz"] == pytest.approx(150.0, rel=0.01)
    assert laws.instead == {"X"}
    assert sum(law.explained for law in laws.laws) > 0.99


def test_effects_that_are_there_stay():
    laws = laws_instead_of(EFFECTS, EFFECTS)
    assert not laws.laws
    assert not laws.instead
    assert sorted(s.effect.name for s in settings_of(laws.corrected)) == sorted(e["name"] for e in EFFECTS)
