"""The table of parameters gives the unit of each number for each drive."""

from __future__ import annotations

import pytest

from twin.control.number import unit_of_key
from twin.machine.axis import inertia_of
from twin.machine.machine import Machine
from twin.machine.parameters import PARAMETERS, parameter


@pytest.mark.parametrize(
    ("field", "units"),
    [
        ("rotor_inertia_kg_m2", ("kg m2", "kg m2", "kg")),
        ("viscous_friction_nm_s_per_rad", ("Nm s/rad", "Nm s/rad", "N s/m")),
        ("speed_gain_nm_s_per_rad", ("Nm s/rad", "Nm s/rad", "N s/m")),
        ("position_gain_per_s", ("1/s", "1/s", "1/s")),
        ("max_velocity", ("m/min", "rev/min", "m/min")),
        ("velocity_feedforward", ("1", "1", "1")),
    ],
)
def test_unit_of_each_drive(field: str, units: tuple[str, str, str]) -> None:
    assert tuple(parameter(field).unit(drive) for drive in ("screw", "gear", "direct")) == units


def test_only_plain_numbers_have_no_unit() -> None:
    plain = {p.field for p in PARAMETERS if p.key("screw") and not unit_of_key(p.key("screw"))}
    loops = {f"loops.{k}" for k in ("velocity_feedforward", "torque_feedforward", "drive_torque_feedforward", "speed_mean_cycles")}
    assert plain == loops | {"mode_mass_share", "mode_damping_ratio", "other_side_friction"}


def test_drive_and_inertia_of_an_axis(mikron: Machine) -> None:
    assert [mikron.axis(name).drive for name in "XC"] == ["screw", "gear"]
    assert inertia_of(mikron.axis("X")) == "rotor_inertia"
    assert inertia_of(mikron.with_axis("X", rotor_inertia_kg_m2=0.0).axis("X")) == "moving_mass"
