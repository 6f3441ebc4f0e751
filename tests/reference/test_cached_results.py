"""Cached results depend on everything that they were computed from: another machine gets its own result."""

from __future__ import annotations

import os
from pathlib import Path
import shutil

import numpy as np
import pytest

from twin.effects import Change, apply_effects
from twin.effects.change import add_effects, held_force, load_inertia
from twin.machine.machine import Machine, default_machine_path, load_machine
from twin.simulation.decoupled_plant import Motion, loads_along
from twin.simulation.plant_spec import home_inertia_at_motor, inertial_key

OFFSET = {"geometry.a_axis_to_c_axis_z_m": -0.1}


def resting(machine: Machine) -> Motion:
    """All axes at zero."""
    zero = np.zeros((50, len(machine.axes)))
    return Motion(zero, zero, zero, 1e-3)


def at_home(machine: Machine) -> tuple[float, float]:
    """Inertia [kg m2] and holding torque [Nm] of A, from its bodies: sums over cradle, table and workpiece, no MuJoCo."""
    oy, oz = (machine.geometry[f"a_axis_to_c_axis_{c}_m"] for c in "yz")
    inertia, moment = 0.0, 0.0
    for body in machine.bodies:
        _, y, z = body.centre_of_mass_m
        if body.name != "cradle":
            y, z = y + oy, z + oz
        inertia += body.inertia_kg_m2[0] + body.mass_kg * (y * y + z * z)
        moment += body.mass_kg * y * machine.gravity
    return inertia, moment


@pytest.mark.parametrize("offset", [{"y": 0.1}, {"z": -0.1}, {"y": 0.1, "z": 0.05}])
def test_another_offset_of_the_table_has_another_inertia(mikron: Machine, offset: dict[str, float]) -> None:
    other = mikron.with_values({f"geometry.a_axis_to_c_axis_{c}_m": v for c, v in offset.items()})
    for machine in (mikron, other, mikron):
        inertia, torque = at_home(machine)
        assert load_inertia(machine, machine.axis("A")) == pytest.approx(inertia, rel=1e-9)
        assert held_force(machine, machine.axis("A")) == pytest.approx(torque, rel=1e-9)
        loads = loads_along(Change(machine), resting(mikron))
        a = machine.axis_names.index("A")
        assert loads.inertia[0, a] == pytest.approx(inertia, rel=1e-9)
        assert loads.bias[0, a] == pytest.approx(torque, rel=1e-9)


def test_results_equal_those_of_a_new_process(mikron: Machine) -> None:
    """With the C axis 0.1 m beside the A axis: 19.55 kg m2 and 197.7 Nm, also after the nominal machine was evaluated."""
    assert load_inertia(mikron, mikron.axis("A")) == pytest.approx(17.70, abs=0.005)
    other = mikron.with_values({"geometry.a_axis_to_c_axis_y_m": 0.1})
    assert load_inertia(other, other.axis("A")) == pytest.approx(19.55, abs=0.005)
    assert held_force(other, other.axis("A")) == pytest.approx(197.7, abs=0.05)


def test_the_same_motion_of_another_machine_is_computed_again(mikron: Machine) -> None:
    motion = resting(mikron)
    first, second = (loads_along(Change(m), motion).inertia[0, 3] for m in (mikron, mikron.with_values(OFFSET)))
    assert second != pytest.approx(first, rel=0.01)


@pytest.mark.parametrize("effect", ["inertia:A:added=", "table_unbalance:A:radius_m=0.2,angle_rad=0.3,mass_kg="])
def test_the_same_motion_under_another_load_is_computed_again(mikron: Machine, effect: str) -> None:
    """Equal loads are computed once."""
    motion = resting(mikron)
    nothing, ten, twenty, again = (
        loads_along(apply_effects(add_effects(mikron, *given)), motion)
        for given in ((), (effect + "10",), (effect + "20",), (effect + "10",))
    )
    assert again is ten
    assert twenty.inertia[0, 3] - nothing.inertia[0, 3] == pytest.approx(2.0 * (ten.inertia[0, 3] - nothing.inertia[0, 3]))
    assert ten.inertia[0, 3] > nothing.inertia[0, 3]


def test_another_content_of_the_model_file_is_another_machine(mikron: Machine, tmp_path: Path) -> None:
    """In one process, at one place, with the same modification time."""
    for source in (default_machine_path(), mikron.model_path):
        shutil.copy(source, tmp_path / source.name)
    model = tmp_path / mikron.model_path.name
    modified = model.stat().st_mtime_ns
    machine = load_machine(tmp_path / default_machine_path().name)
    before = home_inertia_at_motor(machine), load_inertia(machine, machine.axis("A"))
    assert before[1] == pytest.approx(load_inertia(mikron, mikron.axis("A")))
    text = model.read_text(encoding="utf-8")
    assert '<body name="table"' in text
    heavier = '<body name="clamp" pos="0.1 0.2 0"><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/></body></body>'
    at = text.index('<body name="table"')
    end = at + text[at:].index("</body>")
    model.write_text(text[:end] + heavier + text[end + len("</body>") :], encoding="utf-8")
    os.utime(model, ns=(modified, modified))
    assert load_inertia(machine, machine.axis("A")) > before[1] + 1.0
    assert home_inertia_at_motor(machine)[3] > before[0][3]


@pytest.mark.parametrize(
    ("values", "same"),
    [
        ({"axis.X.coulomb_friction_nm": 0.5, "axis.A.motor.torque_constant_nm_per_a": 0.9, "axis.Z.loops.position_gain_per_s": 33.0}, True),
        ({"axis.X.moving_mass_kg": 701.0}, False),
        ({"axis.A.gear_ratio": 181.0}, False),
        ({"body.table.centre_of_mass_m": [0.0, 0.0, 0.011]}, False),
        ({"geometry.table_top_above_a_axis_m": 0.06}, False),
        ({"gravity_m_per_s2": 9.8}, False),
        ({"driven_axes": ["X", "Y"]}, False),
    ],
)
def test_the_cache_key_depends_on_values_that_change_the_result(mikron: Machine, values: dict[str, object], same: bool) -> None:
    assert (inertial_key(mikron) == inertial_key(mikron.with_values(values))) is same
