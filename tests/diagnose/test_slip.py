"""Slip before break-away, which every axis has a little of, is found from records with measuring noise and encoders of finite resolution."""

from __future__ import annotations

import numpy as np
import pytest

from tests.diagnose.law.test_keep import X, runs_of
from twin.diagnose.imperfections import with_imperfections
from twin.diagnose.observe import in_turn, observe
from twin.diagnose.settings import DEFAULT
from twin.diagnose.tolerance import Nuisance
from twin.diagnose.tuning import tuning_of
from twin.diagnose.view import view_of

AXIS = X.axes[0]
TRAVEL = 0.4e-6
SLIP = {"name": "presliding", "axis": "X", "stiffness": AXIS.coulomb_friction / TRAVEL}


@pytest.fixture(scope="module")
def group():
    return observe([view_of(X, run) for run in runs_of([SLIP])], ("X",))


def test_noise_in_the_loop_is_no_error_of_the_control_law(group):
    """What a shaken simulation saw was rounded otherwise than what the machine saw: the law of the controller is not to answer for that."""
    assert X.noise(AXIS).position_resolution > 0.0
    nuisance = Nuisance("X", "slip", DEFAULT)
    answer = group.response(lambda m: nuisance.apply(m, 1.0 + 0.5 * m.parameter_tolerance), axes=("X",), shaken=True)
    rows = np.concatenate([np.arange(group.size)[c.rows] for c in group.channels if c.name == "controller"])
    assert rows.size
    assert np.abs(answer[rows]).max() < 1e-3 * np.abs(answer).max()
    assert answer.any()


def test_slip_is_found_with_its_size(group):
    tuning = with_imperfections(tuning_of(group, X, in_turn), group, X, group.residual, in_turn)
    found = {n.quantity: float(v) for n, v in zip(tuning.nuisances, tuning.solve(group.residual) * tuning.spread)}
    assert found["slip"] / X.parameter_tolerance * DEFAULT.normal_slip_linear_m == pytest.approx(TRAVEL, rel=0.3)
