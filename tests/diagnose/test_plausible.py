"""Plausible sizes: found on machines, and larger than their normal spread."""

from dataclasses import replace

import numpy as np
import pytest

from tests.builders.diagnosis_state import columns_of, found_of, group_of, no_tuning
from twin.diagnose.fit import Fit, free_parameters
from twin.diagnose.plausible import is_plausible
from twin.diagnose.sizes import without_implausible
from twin.effects import EFFECTS, Setting
from twin.machine.machine import load_machine

MACHINE = load_machine()


@pytest.mark.parametrize(
    ("effect", "axis", "parameters", "believed"),
    [
        # 6.2 kg at 0.1 m with a different split of mass and radius: the moment is plausible
        ("table_unbalance", "A", {"mass_kg": 2.3, "radius_m": 0.27, "angle_rad": 5.5}, True),
        ("table_unbalance", "A", {"mass_kg": 0.5, "radius_m": 0.05, "angle_rad": 5.5}, False),
        ("table_unbalance", "A", {"mass_kg": 400.0, "radius_m": 0.9, "angle_rad": 5.5}, False),
        ("torque_constant", "X", {"factor": 0.97}, True),
        ("torque_constant", "X", {"factor": 0.985}, False),  # within twice the tolerance
        ("constant_force", "Z", {"force": -86.0}, False),  # 2.5 % of its weight
        ("constant_force", "Z", {"force": -150.0}, True),
        ("constant_force", "X", {"force": -86.0}, True),
        ("backlash", "X", {"clearance": 8e-6}, True),
        ("backlash", "X", {"clearance": 1e-8}, False),
        ("current_filter", "C", {"time_constant_s": 0.11e-3}, False),  # every drive needs about one cycle, 0.125 ms
        ("current_filter", "C", {"time_constant_s": 0.2e-3}, True),
        (
            "torque_ripple",
            "Y",
            {"amplitude_nm": 5e-3, "periods_per_rev": 12.0},
            False,
        ),  # below 0.03 % of the peak torque: cogging of every motor
        ("torque_ripple", "Y", {"amplitude_nm": 8e-3, "periods_per_rev": 12.0}, True),
    ],
)
def test_plausible_sizes(effect, axis, parameters, believed):
    assert is_plausible(Setting(EFFECTS[effect], axis, parameters), MACHINE) == believed


@pytest.mark.parametrize(("slope", "kept"), [(1.0, True), (0.01, False)])
def test_an_effect_with_an_undetermined_size_is_removed(slope: float, kept: bool) -> None:
    """With a weak slope this clearance of 4 um could be 700 times smaller, so it is not accepted as backlash."""
    group = group_of([np.zeros(1000)], "Z")
    settings = (Setting(EFFECTS["backlash"], "Z", {"clearance": 4e-6}),)
    free = free_parameters(settings, MACHINE)
    fit = Fit(settings, free, 1.0, np.zeros(0), np.zeros(group.size), columns_of(np.full((group.size, 1), slope)), no_tuning(group.size))
    rest = without_implausible(found_of(group, fit=fit))
    assert (rest.fit.settings == settings) == kept


@pytest.mark.parametrize(
    ("effect", "size", "known", "kept"),
    [
        # viscous friction is an effect above 4 %
        ("viscous_friction", 1.3, 0.01, True),
        ("viscous_friction", 1.05, 0.01, False),
        ("viscous_friction", 0.95, 0.01, False),
        ("backlash", 4e-6, 1.5e-6, True),
        ("backlash", 4e-6, 2.5e-6, False),  # a logarithmic size, known within a factor of 3.4
        ("position_dependent_friction", 0.09, 0.03, True),
        ("position_dependent_friction", 0.09, 0.13, False),  # from -17 to 35 %
    ],
)
def test_a_size_that_may_be_zero_or_tolerance_is_removed(effect: str, size: float, known: float, kept: bool) -> None:
    """`known` is the standard deviation of the size."""
    parameter = EFFECTS[effect].size
    others = {"wavelength": 0.05} if effect == "position_dependent_friction" else {}
    setting = Setting(EFFECTS[effect], "X", {parameter.name: size, **others})
    group = group_of([np.zeros(1000)], "X")
    free = [f for f in free_parameters((setting,), MACHINE) if f.parameter is parameter]
    scale = free[0].unit * (size if free[0].logarithmic else 1.0)
    fit = Fit((setting,), free, 1.0, np.zeros(0), np.zeros(group.size), columns_of(np.ones((group.size, 1))), no_tuning(group.size))
    steep = next(iter(fit.sizes().deviations().values()))[1] * scale / known
    fit = replace(fit, columns=fit.columns.scaled(np.full(group.size, steep)))
    rest = without_implausible(found_of(group, fit=fit))
    assert (rest.fit.settings == (setting,)) == kept
