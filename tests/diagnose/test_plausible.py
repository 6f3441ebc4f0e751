"""Which sizes are believed: what is found on machines, and more than their normal spread."""

from types import SimpleNamespace

import numpy as np
import pytest

from twin.diagnose import sizes
from twin.diagnose.fit import Fit, free_parameters
from twin.diagnose.plausible import is_plausible
from twin.diagnose.settings import DEFAULT
from twin.diagnose.state import Found
from twin.diagnose.tuning import tuning_from
from twin.effects import EFFECTS, Setting
from twin.machine.machine import load_machine

MACHINE = load_machine()


@pytest.mark.parametrize(
    ("effect", "axis", "parameters", "believed"),
    [
        # 6.2 kg at 0.1 m, found with another share of mass and radius: the moment is that of a machine
        ("table_unbalance", "A", {"mass_kg": 2.3, "radius_m": 0.27, "angle_rad": 5.5}, True),
        ("table_unbalance", "A", {"mass_kg": 2.3, "radius_m": 0.05, "angle_rad": 5.5}, False),
        ("table_unbalance", "A", {"mass_kg": 400.0, "radius_m": 0.5, "angle_rad": 5.5}, False),
        ("torque_constant", "X", {"factor": 0.97}, True),
        ("torque_constant", "X", {"factor": 0.985}, False),  # within twice the tolerance
        ("constant_force", "Z", {"force": -86.0}, False),  # 2.5 % of its weight
        ("constant_force", "Z", {"force": -150.0}, True),
        ("constant_force", "X", {"force": -86.0}, True),
        ("backlash", "X", {"clearance": 8e-6}, True),
        ("backlash", "X", {"clearance": 1e-8}, False),
    ],
)
def test_sizes_believed(effect, axis, parameters, believed):
    assert is_plausible(Setting(EFFECTS[effect], axis, parameters), MACHINE) == believed


@pytest.mark.parametrize(("slope", "kept"), [(1.0, True), (0.01, False)])
def test_an_effect_that_has_no_size_is_not_there(monkeypatch, slope, kept):
    """A backlash that may be 700 times smaller than was found may as well be none."""
    rows = 1000
    settings = (Setting(EFFECTS["backlash"], "Z", {"clearance": 4e-6}),)
    tuning = tuning_from((), np.zeros((rows, 0)), 0.01)
    fit = Fit(settings, free_parameters(settings, MACHINE), 1.0, np.zeros(0), np.zeros(rows), np.full((rows, 1), slope), tuning)
    group = SimpleNamespace(size=rows, thresholds=DEFAULT)
    found = Found(group, group, tuning, fit, fit, 1.0, accepted=(fit,))
    monkeypatch.setattr(sizes, "fit_effects", lambda group, machine, tuning, rest, *_: SimpleNamespace(settings=tuple(rest)))
    monkeypatch.setattr(Found, "inflated", lambda self: self)
    rest = sizes.without_implausible(found, MACHINE, map)
    assert (rest.fit.settings == settings) == kept
