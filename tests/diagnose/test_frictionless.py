"""An axis without Coulomb friction, on air bearings for example, has no break-away and no slip before it."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.builders.identify_campaigns import usual_runs
from twin.diagnose import diagnose
from twin.diagnose.settings import DEFAULT
from twin.diagnose.tolerance import is_normal
from twin.effects import EFFECTS, Setting, with_effects
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign


@pytest.fixture(scope="module")
def frictionless(mikron: Machine) -> Machine:
    return mikron.with_axes(["X"]).with_axis("X", coulomb_friction_nm=0.0)


def test_a_frictionless_axis_is_diagnosed(frictionless: Machine) -> None:
    """A backlash makes all channels exceed noise, so that every normal imperfection is tried."""
    true = with_effects(frictionless, [{"name": "backlash", "axis": "X", "clearance": 8e-6}])
    runs = [replace(run, started_at=20.0 * k) for k, run in enumerate(usual_runs(true, short=True))]
    found = diagnose(Campaign(Path("campaign"), "test", tuple(runs)), frictionless)
    assert (found.verdict, [s.key[:2] for s, _, _ in found.settings]) == ("effect", [("backlash", "X")])


def test_no_slip_is_normal_without_friction(frictionless: Machine) -> None:
    slip = Setting(EFFECTS["presliding"], "X", {"stiffness": 1e12})
    assert not is_normal(frictionless, slip, DEFAULT)
    assert is_normal(frictionless.with_axis("X", coulomb_friction_nm=1.0), slip, DEFAULT)
