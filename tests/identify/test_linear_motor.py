"""A linear motor has no rotor, and its file need not say the mass that its control was commissioned with: that is the mass of the model."""

import numpy as np
import pytest

from tests.builders.identify_campaigns import campaign, on_a_linear_motor, usual_runs
from twin.identify.identify import identify
from twin.machine.machine import Machine


def test_a_linear_motor_without_commissioned_mass_is_identified(mikron: Machine) -> None:
    file = on_a_linear_motor(mikron).with_axes(["X"])
    axis = file.axis("X")
    assert (axis.drive, axis.rotor_inertia_kg_m2, axis.commissioned_inertia) == ("direct", 0.0, None)
    true = file.with_axis("X", coulomb_friction_nm=1.1 * axis.coulomb_friction_nm)
    found = identify(campaign(usual_runs(true, short=True)), file, refine=False, gaps=False)
    x = found.machine.axis("X")
    assert x.coulomb_friction == pytest.approx(1.1 * axis.coulomb_friction, rel=0.03)
    assert x.moving_mass_kg == pytest.approx(axis.moving_mass_kg, rel=0.02)
    # the control keeps its mass when the identified one changes
    assert x.commissioned_inertia == pytest.approx(axis.moving_mass_kg, rel=1e-6)
    assert all(np.isfinite(p.value.value) for p in found.parameters)
