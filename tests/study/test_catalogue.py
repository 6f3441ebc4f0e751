"""Catalogues, masses on bodies, and ratings of studies."""

from dataclasses import replace
import json
import math
from pathlib import Path
import runpy

import numpy as np
import pytest

from tests.builders.refused import refused
from tests.builders.study_files import rows_of, write_spec
from tests.conftest import ROOT
from twin.cli import main
from twin.errors import InputError
from twin.machine.holding import holding_effort
from twin.machine.machine import Machine, load_machine
from twin.simulation.plant_spec import home_inertia_at_motor
from twin.study.design import machine_of
from twin.study.duty import held_axes, span_over
from twin.study.output import rated
from twin.study.paths import with_numbers
from twin.study.spec import read_study

MOTORS = """
[[motor]]
name = "M80"
torque_constant_nm_per_a = 1.4
back_emf_v_s_per_rad = 0.81
resistance_ohm = 0.5
inductance_h = 6.0e-3
peak_current_a = 46.0
inertia_kg_m2 = 4.2e-3
rated_torque_nm = 18.0
rated_speed_rev_per_min = 2500
max_speed_rev_per_min = 3600
thermal_time_constant_s = 1800
[[motor]]
name = "M100"
torque_constant_nm_per_a = 1.8
back_emf_v_s_per_rad = 1.04
resistance_ohm = 0.3
inductance_h = 5.0e-3
peak_torque_nm = 108.0
inertia_kg_m2 = 9.2e-3
rated_torque_nm = 30.0
[[screw]]
name = "40x10"
screw_lead_m_per_rev = 0.01
inertia_kg_m2 = 2.0e-3
[[screw]]
name = "40x20"
screw_lead_m_per_rev = 0.02
inertia_kg_m2 = 2.2e-3
"""
CHOICES = """recommission = true
retune = "same margins"
[[factor]]
name = "motor"
catalogue = "motors.toml"
axis = "X"
installed = "M80"
[[factor]]
name = "screw"
catalogue = "motors.toml"
axis = "X"
installed = "40x10"
values = ["40x10", "40x20"]
"""
GRID = '[design]\nkind = "grid"\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "motors.toml").write_text(MOTORS, encoding="utf-8")
    return tmp_path


def test_the_installed_catalogue_entries_give_the_nominal_machine(folder: Path, mikron: Machine) -> None:
    study = read_study(write_spec(folder, CHOICES + GRID))
    same = machine_of(study, np.array([0.0, 0.0]))
    np.testing.assert_allclose(home_inertia_at_motor(same), home_inertia_at_motor(mikron), rtol=1e-12)
    assert same.axis("X").motor.rated_torque_nm == 18.0
    assert same.axis("X").motor.rated_speed == pytest.approx(2500 * math.pi / 30.0)


def test_numbers_of_an_entry_change_together(folder: Path, mikron: Machine) -> None:
    study = read_study(write_spec(folder, CHOICES + GRID))
    other = machine_of(study, np.array([1.0, 1.0])).axis("X")
    assert other.motor.torque_constant_nm_per_a == other.commissioned_torque_constant == 1.8
    assert other.motor.peak_current_a == pytest.approx(60.0)
    assert other.motor.bus_limit_v == 300.0  # the drive's, which stays
    # rotor and screw are one number of the file: both differences add up
    assert other.rotor_inertia_kg_m2 == pytest.approx(6.8e-3 + 9.2e-3 - 4.2e-3 + 2.2e-3 - 2.0e-3)
    assert other.ratio == pytest.approx(0.02 / (2 * math.pi))
    # the loops keep their margins
    grown = (other.rotor_inertia_kg_m2 + 700 * other.ratio**2) / (6.8e-3 + 700 * mikron.axis("X").ratio ** 2)
    assert other.loops.speed_gain_nm_s_per_rad == pytest.approx(3.4 * grown, rel=1e-3)
    x = mikron.axis("X")
    winding, resistance = other.motor.inductance_h / x.motor.inductance_h, other.motor.resistance_ohm / x.motor.resistance_ohm
    assert winding != pytest.approx(1.0, rel=0.05)
    assert other.loops.current_gain_v_per_a == pytest.approx(x.loops.current_gain_v_per_a * winding)
    assert other.loops.current_integral_time_s == pytest.approx(x.loops.current_integral_time_s * winding / resistance)


def test_a_study_of_choices_names_them(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = write_spec(folder, 'answer = ["copper_loss_X_w", "torque_rms_used_X"]\n' + CHOICES + GRID)
    out = folder / "out"
    assert main(["study", str(spec), "--out", str(out), "--compare", "0", "3"]) == 0
    said = capsys.readouterr().out
    assert "motor M" in said
    assert "screw 40x" in said
    assert {"compare_0_3_move.rrd", "best_move.rrd"} <= {p.name for p in out.iterdir()}
    assert (out / "plots" / "compare_0_3.png").stat().st_size > 5000
    assert (out / "plots" / "torque_speed.png").stat().st_size > 5000
    assert (out / "plots" / "holding.png").stat().st_size > 5000
    document = json.loads((out / "study.json").read_text(encoding="utf-8"))
    assert set(document["best"]["choices"]) == {"motor", "screw"}
    page = (out / "report.html").read_text(encoding="utf-8")
    for words in ("40x20", "of the rating", "Constraints: phase margin (all) at least 30 deg"):
        assert words in page
    assert "M100" in (out / "table.csv").read_text(encoding="utf-8")
    # the machine file has no rating, the catalogue has that of the installed motor
    ratings = rated(read_study(spec)).axis("X").motor
    assert (ratings.rated_torque_nm, ratings.thermal_time_constant_s) == (18.0, 1800.0)
    assert rated(read_study(spec)).axis("X").rotor_inertia_kg_m2 == load_machine().axis("X").rotor_inertia_kg_m2
    message = refused(capsys, "study", str(spec), "--out", str(out), "--resume", "--no-replay", "--compare", "0", "9")
    assert "--compare 9: no variant with this number" in message


def test_shares_of_the_ratings(folder: Path) -> None:
    spec = write_spec(folder, CHOICES + '[design]\nkind = "list"\nrows = [["M80", "40x10"], ["M100", "40x10"]]\n')
    (_, _, small, _), (_, _, large, _) = rows_of(spec, folder / "out")
    assert small["torque_rms_used_X"] == pytest.approx(1.4 * small["current_rms_X_a"] / 18.0)
    assert large["torque_rms_used_X"] == pytest.approx(1.8 * large["current_rms_X_a"] / 30.0)
    assert small["motor_speed_used_X"] == pytest.approx(small["speed_limit_used_X"] * 3000 / 3600)
    # for a repeated run much shorter than the time constant the RMS determines the heat
    assert small["winding_heat_used_X"] == pytest.approx(small["torque_rms_used_X"] ** 2, rel=1e-3)
    assert "winding_heat_used_X" not in large
    assert small["torque_curve_used_X"] >= small["current_limit_used_X"] * 0.5


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('installed = "M80"', 'installed = "M90"', "'M90' is not in motors.toml"),
        ('axis = "X"\ninstalled = "40x10"', 'axis = "A"\ninstalled = "40x10"', "axis A has no screw"),
        ('axis = "X"\ninstalled = "40x10"', 'axis = 0\ninstalled = "40x10"', "axis = 0; write it in quotes"),
        ('"40x10", "40x20"', '"40x10", "50x10"', "no screw '50x10'"),
        ('"40x10", "40x20"', '"40x10", ""', "no screw ''"),
        ('"40x10", "40x20"', '"40x10"', "has one screw only"),
        ('axis = "X"\ninstalled = "M80"', 'axis = "X"', "'installed' is missing"),
        ("[[factor]]", '[[factor]]\nname = "k"\npath = "axis.X.motor.resistance_ohm"\nrange = [0.4, 0.6]\n[[factor]]', "both set"),
        ("[design]", '[[tied]]\npath = "axis.X.max_jerk_m_per_s3"\nto = "motor"\n[design]', "is a catalogue choice"),
    ],
)
def test_unsupported_entries_of_a_catalogue_are_refused(folder: Path, old: str, new: str, words: str) -> None:
    spec = write_spec(folder, (CHOICES + GRID).replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        read_study(spec)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("peak_current_a = 46.0\n", "", "give one of peak_current_a and peak_torque_nm"),
        ("inductance_h = 6.0e-3\n", "", "'inductance_h' is missing"),
        ("inertia_kg_m2 = 4.2e-3", "inertia_kg_m2 = 4.2e-2", "more than the 0.0068 kg m2"),
        ('name = "M100"', 'name = "M80"', "two of"),
        ("rated_torque_nm = 18.0", "rated_torque = 18.0", "unknown key 'rated_torque'"),
        ("[[motor]]", "[[motor", "not a valid TOML file"),
    ],
)
def test_faults_of_a_catalogue_are_reported(folder: Path, old: str, new: str, words: str) -> None:
    (folder / "motors.toml").write_text(MOTORS.replace(old, new, 1), encoding="utf-8")
    spec = write_spec(folder, CHOICES + GRID)
    with pytest.raises(InputError, match=words):
        read_study(spec)


def test_a_mass_on_a_body_grows_its_inertia(mikron: Machine) -> None:
    heavier = with_numbers(mikron, {"added_mass.workpiece": 30.0})
    (before,), (after,) = ([b for b in m.bodies if b.name == "workpiece"] for m in (mikron, heavier))
    assert after.mass_kg == before.mass_kg + 30.0
    np.testing.assert_allclose(after.inertia_kg_m2, np.array(before.inertia_kg_m2) * 1.5)
    assert [a.moving_mass_kg for a in heavier.axes] == [a.moving_mass_kg for a in mikron.axes]  # no linear axis carries the table
    with pytest.raises(InputError, match="no linear axis and no body"):
        with_numbers(mikron, {"added_mass.work": 30.0})


def test_holding_current_by_pose(mikron: Machine) -> None:
    """Weight of Z through its screw; the bodies on the cradle by m g (y cos A - z sin A) with y turned by C."""
    z, a = mikron.axis("Z"), mikron.axis("A")
    np.testing.assert_allclose(np.abs(holding_effort(mikron, z)), 350 * 9.81 * z.ratio / 1.4, rtol=1e-9)
    from twin.machine.holding import holding_of

    found = holding_of(mikron)
    tilt, turn = found.angles[:, 0], found.angles[:, 1]
    torque = np.zeros(len(tilt))
    for body in mikron.bodies:
        x, y, height = body.centre_of_mass_m
        angle = 0.0 if body.name == "cradle" else turn
        turned = x * np.sin(angle) + y * np.cos(angle)
        torque += body.mass_kg * mikron.gravity * (turned * np.cos(tilt) - height * np.sin(tilt))
    np.testing.assert_allclose(found.forces[:, 3], torque, atol=1e-6 * np.abs(torque).max())
    np.testing.assert_allclose(holding_effort(mikron, a), torque * a.ratio / a.motor.torque_constant_nm_per_a, atol=1e-9)
    # as in the report: A tilts the whole load, C rotates an eccentric load on the tilted table
    assert held_axes(mikron) == ["A", "C"]
    degrees, least, largest = span_over(mikron, "A", "A")
    at = np.isclose(np.degrees(tilt), degrees[2])
    assert (least[2], largest[2]) == (
        pytest.approx(holding_effort(mikron, a)[at].min()),
        pytest.approx(holding_effort(mikron, a)[at].max()),
    )
    assert load_machine().axis("A").motor.rated_torque_nm is None


def test_a_workpiece_is_carried_by_the_axes_below_its_table() -> None:
    """On a mill with a moving table, saddle and table carry the workpiece, the head does not."""
    examples = runpy.run_path(str(ROOT / "examples" / "kinematics" / "run.py"))
    machine = examples["machine_of"]("three_axis")
    table = {"mass_kg": 200.0, "centre_of_mass_m": [0.0, 0.0, 0.0], "inertia_kg_m2": [20.0, 20.0, 20.0]}
    machine = replace(machine, document={**machine.document, "body": {"table": table}})
    heavier = with_numbers(machine, {"added_mass.table": 50.0})
    more = {a.name: b.moving_mass_kg - a.moving_mass_kg for a, b in zip(machine.axes, heavier.axes)}
    assert more == {"LEFT_RIGHT": 50.0, "LENGTH": 50.0, "LIFT": 0.0}
    assert heavier.bodies[0].mass_kg == 250.0


def test_a_gear_changes_ratio_and_inertia_together(folder: Path, mikron: Machine) -> None:
    (folder / "gears.toml").write_text(
        '[[gear]]\nname = "90"\ngear_ratio = 90.0\ninertia_kg_m2 = 3.0e-4\n'
        '[[gear]]\nname = "120"\ngear_ratio = 120.0\ninertia_kg_m2 = 4.0e-4\ncoulomb_friction_nm = 0.2\n',
        encoding="utf-8",
    )
    factor = '[[factor]]\nname = "gear"\ncatalogue = "gears.toml"\naxis = "A"\ninstalled = "90"\n'
    study = read_study(write_spec(folder, "recommission = true\n" + factor + GRID))
    before, after = mikron.axis("A"), machine_of(study, np.array([1.0])).axis("A")
    assert after.ratio == pytest.approx(1.0 / 120.0)
    assert after.rotor_inertia_kg_m2 == pytest.approx(before.rotor_inertia_kg_m2 + 1.0e-4)
    assert after.coulomb_friction_nm == 0.2
    assert after.motor == before.motor
