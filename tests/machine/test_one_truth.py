"""The document is the only source of a machine: after any chain of changes, writing and reading gives the same machine and simulation."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
import tempfile
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from tests.builders.other_structures import slides
from tests.conftest import swings
from tests.machine.test_sinumerik import with_machine_data
from twin.effects import with_effects
from twin.errors import InputError
from twin.machine.axis import Axis, Loops, Motor
from twin.machine.keys import WORDS
from twin.machine.machine import FEEDFORWARD, Machine, load_machine, write_machine
from twin.machine.parameters import PARAMETERS, SPREAD, file_from_typed, key_of, parameter, typed_from_file
from twin.simulation.run import simulate

NUMBERS = {
    "max_velocity": (0.1, 0.5),
    "max_jerk": (3.0, 50.0),
    "coulomb_friction_nm": (0.1, 2.5),
    "viscous_friction_nm_s_per_rad": (0.001, 0.01),
    "peak_current_a": (20.0, 60.0),
    "constant_torque_nm": (-1.0, 1.0),
    "torque_constant_nm_per_a": (0.8, 1.6),
    "position_gain_per_s": (20.0, 60.0),
    "speed_gain_nm_s_per_rad": (0.3, 3.0),
    "position_delay_s": (0.0, 0.004),
    "dsc_delay_s": (0.0, 0.006),
    "velocity_feedforward": (0.5, 1.2),
    "torque_feedforward": (0.5, 1.2),
    "commissioned_inertia": (0.001, 0.02),
}
"""Fields that a change may set, with the range of their values."""
EFFECTS = [
    {"name": "backlash", "axis": "X", "clearance": 1e-5},
    {"name": "coulomb_friction", "axis": "Y", "factor": 1.2},
    {"name": "law", "axis": "X", "output": "friction", "variables": ["speed"], "formula": "gaussian", "height": 90.0, "width": 0.009},
]


def changes(machine: Machine) -> st.SearchStrategy[tuple[str, Any]]:
    """One change: feedforward, driven axes, effects, a body, a length, a typed field of an axis or the same number by its path."""
    one = st.sampled_from(machine.axis_names).flatmap(
        lambda axis: st.sampled_from(sorted(NUMBERS)).flatmap(
            lambda field: st.floats(*NUMBERS[field]).map(lambda value: (axis, field, round(float(f"{value:.6g}"), 12)))
        )
    )
    return st.one_of(
        st.tuples(st.just("feedforward"), st.sampled_from(FEEDFORWARD)),
        st.tuples(st.just("axes"), st.sets(st.sampled_from(machine.axis_names), min_size=2).map(lambda s: s | {machine.axis_names[0]})),
        st.tuples(st.sampled_from(["axis", "values"]), one),
        st.tuples(st.just("effects"), st.lists(st.sampled_from(EFFECTS), unique_by=lambda e: e["name"])),
        st.tuples(st.just("body"), st.floats(0.9, 1.1)),
        st.tuples(st.just("length"), st.integers(-50, 50).map(lambda mm: 1e-3 * mm)),
        st.tuples(st.just("nothing"), st.none()),
    )


def value_of(axis: Axis, field: str) -> Any:
    return next(getattr(part, field) for part in (axis, axis.motor, axis.loops) if hasattr(part, field))


class Expected:
    """Expected state after a chain of changes, recorded independently: driven axes, numbers by (axis, field), effects, a body, a length."""

    def __init__(self, machine: Machine):
        self.machine = machine
        self.driven = set(machine.axis_names)
        self.numbers: dict[tuple[str, str], float] = {}
        self.effects: list[dict[str, Any]] = []
        self.body_kg = machine.bodies[0].mass_kg
        self.length_m = machine.geometry["a_axis_to_c_axis_z_m"]

    def change(self, what: str, how: Any) -> None:
        if what == "feedforward":
            for axis in self.machine.axes:
                for word in ("velocity", "torque"):
                    now = value_of(axis, f"{word}_feedforward")
                    self.numbers[axis.name, f"{word}_feedforward"] = (now or 1.0) if word in how else 0.0
            self.machine = self.machine.with_feedforward(how)
        elif what == "axes":
            self.driven &= how
            self.machine = self.machine.with_axes([a for a in self.machine.axis_names if a in how])
        elif what == "effects":
            self.effects, self.machine = how, with_effects(self.machine, how)
        elif what == "body":
            self.body_kg *= how
            self.machine = self.machine.with_body(self.machine.bodies[0].name, how)
        elif what == "length":
            self.length_m, self.machine = how, self.machine.with_values({"geometry.a_axis_to_c_axis_z_m": how})
        elif what == "nothing":
            self.machine = self.machine.with_values({})
        elif how[0] in self.driven:
            axis, field, value = how
            self.numbers[axis, field] = value
            if what == "axis":
                self.machine = self.machine.with_axis(axis, **{field: value})
            else:
                key = key_of(field, self.machine.axis(axis).kind)
                self.machine = self.machine.with_values({f"axis.{axis}.{key}": file_from_typed(key, value)})

    def holds(self, machine: Machine) -> None:
        assert set(machine.axis_names) == self.driven
        assert [dict(table) for table in machine.effects] == self.effects
        assert (machine.bodies[0].mass_kg, machine.geometry["a_axis_to_c_axis_z_m"]) == pytest.approx((self.body_kg, self.length_m))
        for (axis, field), value in self.numbers.items():
            if axis in self.driven:
                assert value_of(machine.axis(axis), field) == pytest.approx(value, rel=1e-12), f"{axis}.{field}"


@settings(max_examples=40, deadline=None)
@given(st.data())
def test_any_chain_of_changes_written_and_read_is_the_same_machine(mikron: Machine, data: st.DataObject) -> None:
    check_chain(mikron, data)


@settings(max_examples=15, deadline=None)
@given(st.data())
def test_changes_are_consistent_with_machine_data_as_well(mikron: Machine, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        check_chain(load_machine(with_machine_data(Path(folder), take=data.draw(st.booleans()))), data)


def check_chain(machine: Machine, data: st.DataObject) -> None:
    expected = Expected(machine)
    for what, how in data.draw(st.lists(changes(machine), max_size=8)):
        expected.change(what, how)
        expected.holds(expected.machine)
    now = expected.machine
    with tempfile.TemporaryDirectory() as folder:
        write_machine(now, Path(folder) / "m.toml")
        again = load_machine(Path(folder) / "m.toml")
        expected.holds(again)
        assert again.axes == now.axes
        assert (again.bodies, again.geometry, again.gravity) == (now.bodies, now.geometry, now.gravity)
        a, b = (simulate(m, swings(m, 0.01)).trace for m in (now, again))
        for key, values in a.signals.items():
            np.testing.assert_array_equal(values, b.signals[key])


def test_feedforward_stays_off(mikron: Machine) -> None:
    machine = mikron.with_feedforward("off").with_values({"axis.X.moving_mass_kg": 690.0})
    assert {axis.loops.velocity_feedforward for axis in machine.axes} == {0.0}


def test_feedforward_is_also_switched_on_axes_that_are_not_driven(mikron: Machine) -> None:
    """The order of the changes does not matter."""
    assert mikron.with_axes(["X"]).with_feedforward("off") == mikron.with_feedforward("off").with_axes(["X"])


def test_a_weight_that_the_file_has_is_kept(mikron: Machine) -> None:
    machine = mikron.with_values({"axis.X.loops.velocity_feedforward": 0.8}).with_feedforward("velocity")
    assert machine.axis("X").loops.velocity_feedforward == 0.8
    assert machine.with_feedforward("off").with_feedforward("velocity").axis("X").loops.velocity_feedforward == 1.0


def test_a_typed_change_is_written(mikron: Machine, tmp_path: Path) -> None:
    write_machine(mikron.with_axis("X", position_gain_per_s=99.0), tmp_path / "m.toml")
    assert "position_gain_per_s = 99.0 " in (tmp_path / "m.toml").read_text(encoding="utf-8")


def test_the_undriven_axes_stay_in_the_file(mikron: Machine, tmp_path: Path) -> None:
    write_machine(mikron.with_axes(["Z", "X"]), tmp_path / "m.toml")
    machine = load_machine(tmp_path / "m.toml")
    assert machine.axis_names == ("X", "Z")
    assert machine.with_values({"driven_axes": ["Y"]}).axis_names == ("Y",)
    with pytest.raises(InputError, match=r"driven_axes = .*W.*name axes of this machine: X, Y, Z, A, C"):
        mikron.with_values({"driven_axes": ["W"]})


def test_a_body_is_scaled_in_the_document(mikron: Machine) -> None:
    machine = mikron.with_body("table", 1.1).with_values({})
    assert machine.bodies[1].mass_kg == pytest.approx(1.1 * 95.0)
    assert machine.bodies[1].inertia_kg_m2 == pytest.approx((2.86, 2.86, 5.06))


def test_an_impossible_machine_can_be_simulated_and_is_not_written(mikron: Machine, tmp_path: Path) -> None:
    machine = mikron.with_axis("X", coulomb_friction_nm=-0.1)
    assert machine.axis("X").coulomb_friction_nm == -0.1
    with pytest.raises(InputError, match=r"\[axis.X\]: coulomb_friction_nm = -0.1: impossible"):
        write_machine(machine, tmp_path / "m.toml")
    assert not (tmp_path / "m.toml").exists()
    with pytest.raises(InputError, match="impossible"):
        mikron.with_values({"axis.X.coulomb_friction_nm": -0.1})


def test_typed_values_cannot_be_replaced_without_the_document(mikron: Machine) -> None:
    with pytest.raises((TypeError, ValueError)):
        dataclasses.replace(mikron, gravity=1.0)  # type: ignore[call-arg]


def test_a_change_does_not_modify_the_original_machine(mikron: Machine) -> None:
    before = mikron.document["axis"]["X"]["loops"]["position_gain_per_s"]
    mikron.with_axis("X", position_gain_per_s=99.0).with_values({"geometry.a_axis_to_c_axis_z_m": 0.1})
    assert mikron.document["axis"]["X"]["loops"]["position_gain_per_s"] == before
    assert mikron.geometry["a_axis_to_c_axis_z_m"] == 0.0


def test_every_number_of_an_axis_is_in_the_table(mikron: Machine) -> None:
    """The typed view has exactly the numbers of the table."""
    typed = {f.name for f in dataclasses.fields(Axis)} - {
        "name",
        "kind",
        "drive",
        "motor",
        "loops",
        "structure",
        "effort",
        "force_unit",
        "blocks",
        *WORDS,
    }
    typed |= {f"motor.{f.name}" for f in dataclasses.fields(Motor)} | {f"loops.{f.name}" for f in dataclasses.fields(Loops)}
    assert {p.field for p in PARAMETERS} == typed
    assert all(parameter(field).field == field for field in SPREAD.values())


@pytest.mark.parametrize("key", [k for p in PARAMETERS for k in dict.fromkeys((p.screw, p.gear, p.direct)) if k])
def test_units_there_and_back(key: str) -> None:
    assert file_from_typed(key, typed_from_file(key, 3.7)) == pytest.approx(3.7, rel=1e-15)


def test_other_structures_take_typed_numbers_in_their_own_keys(tmp_path: Path) -> None:
    machine = slides(tmp_path).with_axis("X", coulomb_friction_nm=21.0, peak_current_a=9.0, torque_constant_nm_per_a=36.0)
    table = machine.document["axis"]["X"]
    assert (table["coulomb_friction_n"], table["actuator"]["peak_voltage_v"], table["actuator"]["force_constant_n_per_v"]) == (
        21.0,
        9.0,
        36.0,
    )
    doubled = machine.with_axis("X", speed_gain_nm_s_per_rad=2.0 * machine.axis("X").loops.speed_gain_nm_s_per_rad)
    assert doubled.document["axis"]["X"]["loops"]["speed_gain_v_s_per_m"] == pytest.approx(486.0)
    assert doubled.axis("X").loops.speed_gain_nm_s_per_rad == pytest.approx(2.0 * 243.0 * 36.0)


def test_the_drive_is_what_the_file_says(mikron: Machine) -> None:
    """A screw whose lead makes the ratio 1 turns its motor; it is no direct drive."""
    screw = mikron.with_values({"axis.X.screw_lead_m_per_rev": 2.0 * math.pi})
    axis = screw.axis("X")
    assert (axis.ratio, axis.drive, axis.motor_unit) == (1.0, "screw", "Nm")
    assert screw.forces == frozenset()
