"""The rotor of an elastic drive train has a joint of its own in the MuJoCo model."""

import mujoco
import numpy as np
import pytest

from twin.machine.machine import Machine
from twin.simulation.plant_spec import build_plant, full_inertia


@pytest.mark.parametrize("side", ["load", "motor"])
@pytest.mark.parametrize("rotor", [1e-6, 0.01])
def test_a_rotor_has_its_own_inertia_and_no_other(mikron: Machine, rotor: float, side: str) -> None:
    """A body of 1 g at the joint would be a thousand times the rotor of a small motor."""
    machine = mikron.with_each_axis({"C": {"rotor_inertia_kg_m2": rotor, "friction_side": side}})
    axis = machine.axis("C")
    plant = build_plant(machine, split_axes=["C"])
    mujoco.mj_forward(plant.model, plant.data)
    at = int(plant.rotor_dof[machine.axis_names.index("C")])
    inertia = full_inertia(plant.model, plant.data)[at]
    assert inertia[at] == pytest.approx(axis.reflected_inertia, rel=1e-9)
    assert np.count_nonzero(inertia) == 1
