"""Closed-loop fits: known slopes are reused while their predictions hold, and recomputed otherwise."""

import pytest

from tests.diagnose.law.test_closed_loop import X, runs_of
from twin.diagnose import fit
from twin.diagnose.fit import fit_effects
from twin.diagnose.observe import observe
from twin.diagnose.tuning import tuning_of
from twin.diagnose.view import view_of
from twin.effects import parse_setting

FRICTION = {"name": "stribeck", "axis": "X", "excess": 150.0, "velocity": 0.004}
START = parse_setting("stribeck:X:excess=100,velocity=0.006", X)


@pytest.fixture(scope="module")
def fitted():
    group = observe([view_of(X, run) for run in runs_of([FRICTION])], ("X",))
    tuning = tuning_of(group)
    found = fit_effects(group, tuning, [START])
    assert found is not None
    return group, tuning, found


def fitted_from(monkeypatch, fitted, start, known):
    """A fit from another start with known slopes, and the number of slopes it computed."""
    group, tuning, _ = fitted
    taken = []
    slopes = fit._slopes
    monkeypatch.setattr(fit, "_slopes", lambda *arguments: taken.extend(arguments[3]) or slopes(*arguments))
    found = fit_effects(group, tuning, [start], known=known)
    assert found is not None
    return found, len(taken)


def test_slopes_without_a_predicted_gain_are_not_recomputed(monkeypatch, fitted):
    """At the optimum no slope predicts a gain, not even one with the wrong sign."""
    wrong = {name: column._replace(values=-column.values) for name, column in fitted[2].slopes.items()}
    again, taken = fitted_from(monkeypatch, fitted, fitted[2].settings[0], wrong)
    assert taken == 0
    assert again.loss <= fitted[2].loss


def test_slopes_that_do_not_reduce_the_loss_are_recomputed(monkeypatch, fitted):
    wrong = {name: column._replace(values=-column.values) for name, column in fitted[2].slopes.items()}
    again, taken = fitted_from(monkeypatch, fitted, START, wrong)
    assert taken >= 2
    assert again.loss < fitted[2].loss + 5.0
