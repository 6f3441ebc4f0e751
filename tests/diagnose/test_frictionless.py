"""An axis without Coulomb friction, on air bearings for example, has no break-away and no slip before it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, group_of
from twin.diagnose import imperfections
from twin.diagnose.starts import starts_of
from twin.diagnose.tolerance import can_be_imperfect, is_normal, nuisances_of
from twin.diagnose.tuning import tuning_from
from twin.effects import EFFECTS, Setting
from twin.machine.machine import Machine


@pytest.fixture(scope="module")
def frictionless(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"]).with_axis("X", coulomb_friction_nm=0.0)


def test_no_slip_is_tried_without_friction(frictionless: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """All channels exceed noise, so that every normal imperfection is tried that the axis can have."""
    rows = np.full(400, 5.0)
    group = group_of([rows, rows], "X")
    tuning = tuning_from(nuisances_of(frictionless, ("X",)), columns_of(np.eye(group.size)[:, :7]), 0.01)
    for machine, can_slip in ((frictionless, False), (frictionless.with_axis("X", coulomb_friction_nm=1.0), True)):
        tried: list[str] = []
        monkeypatch.setattr(imperfections, "_at_shares", lambda current, group, nuisance, *_, to=tried: to.append(nuisance.quantity) or [])
        group = replace(group, views=[replace(view, file=machine) for view in group.views])
        imperfections.with_imperfections(tuning, group, group.residual)
        assert ("slip" in tried) is can_slip


def test_no_drive_train_is_elastic_without_a_rotor(mikron: Machine) -> None:
    """Regression: a machine from a recording with one encoder has one mass; its stiffest spring was none, and the smallest share a division by zero."""
    assert can_be_imperfect(mikron, "X", "elasticity")
    assert not can_be_imperfect(mikron.with_axis("X", rotor_inertia_kg_m2=0.0), "X", "elasticity")


def test_no_slip_is_normal_without_friction(frictionless: Machine) -> None:
    slip = Setting(EFFECTS["presliding"], "X", {"stiffness": 1e12})
    assert not is_normal(frictionless, slip)
    assert is_normal(frictionless.with_axis("X", coulomb_friction_nm=1.0), slip)


def test_forces_without_a_usual_size_are_not_started(frictionless: Machine) -> None:
    """Usual forces are shares of the friction. A start of no force has no response, and its size is a division by zero."""
    group = group_of([np.full(400, 5.0)], "X")
    group = replace(group, views=[replace(view, file=frictionless) for view in group.views])
    starts = starts_of(group, group.residual)
    assert starts
    for start in starts:
        setting = start.settings[0]
        assert setting.effect.size.deviation(setting.parameters[setting.effect.size.name]) > 0.0, setting.effect.name
    assert "periodic_disturbance" not in {start.effect.name for start in starts}
