"""The compiled MuJoCo model against the data sheet and closed forms, over the whole travel."""

import math
import tomllib

import mujoco
import numpy as np
import pytest

from tests.conftest import SHARED
from twin.machine.machine import Machine, default_machine_path
from twin.simulation.plant_spec import build_plant, compile_model, full_inertia, home_inertia_at_motor

EXACT = 1e-12
"""Closed forms and MuJoCo differ by rounding only (relative)."""

MOVED = {"X": 700.0, "Y": 1050.0, "Z": 350.0}
RATIO = {"X": 0.010 / (2 * math.pi), "Y": 0.010 / (2 * math.pi), "Z": 0.010 / (2 * math.pi), "A": 1 / 180, "C": 1 / 120}
ROTOR = {"X": 6.8e-3, "Y": 7.4e-3, "Z": 6.2e-3, "A": 8.0e-4, "C": 7.0e-4}
COULOMB = {"X": 1.8, "Y": 2.1, "Z": 1.5, "A": 0.50, "C": 0.35}
VISCOUS = {"X": 6e-3, "Y": 7.5e-3, "Z": 5e-3, "A": 1.5e-3, "C": 1.2e-3}
# mass, centre of mass, inertia about it; the cradle turns with A, table and workpiece also with C
CRADLE = (210.0, (0.0, 0.015, -0.11), (11.0, 16.0, 20.0))
TABLE = (95.0, (0.0, 0.0, 0.01), (2.6, 2.6, 4.6))
WORKPIECE = (60.0, (0.04, 0.025, 0.13), (0.45, 0.45, 0.55))
G = 9.81
ANGLES = [(a, c) for a in np.deg2rad(np.linspace(-100, 30, 14)) for c in np.deg2rad(np.linspace(0, 345, 24))]


def turned(centre: tuple[float, float, float], c: float) -> tuple[float, float, float]:
    """A point of the table in the cradle's frame."""
    x, y, z = centre
    return x * math.cos(c) - y * math.sin(c), x * math.sin(c) + y * math.cos(c), z


def inertia_at_a(c: float) -> float:
    """Moment of inertia of all that the A axis turns, about the A axis."""
    total = 0.0
    for (mass, centre, inertia), angle in ((CRADLE, 0.0), (TABLE, c), (WORKPIECE, c)):
        _, y, z = turned(centre, angle)
        about_centre = inertia[0] * math.cos(angle) ** 2 + inertia[1] * math.sin(angle) ** 2
        total += about_centre + mass * (y**2 + z**2)
    return total


def inertia_at_c() -> float:
    return sum(inertia[2] + mass * (x**2 + y**2) for mass, (x, y, _), inertia in (TABLE, WORKPIECE))


@pytest.fixture(scope="module")
def pose(mikron: Machine):  # type: ignore[no-untyped-def]
    """Inertia matrix and gravity forces (axis order of the machine) in a pose of A and C."""
    plant = build_plant(mikron)

    def at(a: float, c: float, x: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        plant.data.qpos[plant.load_position] = [x, -x, x / 2, a, c]
        plant.data.qvel[:] = 0.0
        mujoco.mj_forward(plant.model, plant.data)
        dof = plant.load_dof
        return full_inertia(plant.model, plant.data)[np.ix_(dof, dof)], plant.data.qfrc_bias[dof]

    return at


def test_each_screw_moves_its_mass_wherever_it_is(mikron: Machine, pose) -> None:  # type: ignore[no-untyped-def]
    for x in (-0.2, 0.0, 0.25):
        inertia, force = pose(-0.4, 1.0, x)
        for i, name in enumerate("XYZ"):
            assert inertia[i, i] == pytest.approx(MOVED[name] + ROTOR[name] / RATIO[name] ** 2, rel=EXACT)
        off_diagonal = inertia[:3] - np.diag(np.diag(inertia))[:3]
        assert np.abs(off_diagonal).max() < 1e-9
        np.testing.assert_allclose(force[:3], [0, 0, MOVED["Z"] * G], atol=1e-9)


def test_gravity_of_the_table_over_its_whole_travel(pose) -> None:  # type: ignore[no-untyped-def]
    for a, c in ANGLES:
        wanted_a = wanted_c = 0.0
        for (mass, centre, _), angle in ((CRADLE, 0.0), (TABLE, c), (WORKPIECE, c)):
            x, y, z = turned(centre, angle)
            wanted_a += mass * G * (y * math.cos(a) - z * math.sin(a))  # dV/dA, V = m g (y sin A + z cos A)
            if angle is c:
                wanted_c += mass * G * x * math.sin(a)  # dy/dC = x
        force = pose(a, c)[1]
        np.testing.assert_allclose(force[3:], [wanted_a, wanted_c], rtol=0, atol=1e-10)


def test_inertia_of_the_table_and_coupling_over_the_whole_travel(pose) -> None:  # type: ignore[no-untyped-def]
    for a, c in ANGLES:
        inertia = pose(a, c)[0]
        assert inertia[3, 3] == pytest.approx(inertia_at_a(c) + ROTOR["A"] / RATIO["A"] ** 2, rel=EXACT)
        assert inertia[4, 4] == pytest.approx(inertia_at_c() + ROTOR["C"] / RATIO["C"] ** 2, rel=EXACT)
        coupling = -sum(mass * turned(centre, c)[0] * centre[2] for mass, centre, _ in (TABLE, WORKPIECE))
        assert inertia[3, 4] == pytest.approx(coupling, abs=1e-12)
        assert inertia[4, 3] == inertia[3, 4]


def test_holding_at_home_as_the_readme_says(pose) -> None:  # type: ignore[no-untyped-def]
    inertia, force = pose(0.0, 0.0)
    assert inertia[3, 4] == pytest.approx(-0.312, rel=EXACT)
    assert force[2] * RATIO["Z"] == pytest.approx(5.4646, abs=5e-5)
    assert force[3] == pytest.approx(45.6, abs=0.05)
    assert pose(math.radians(-35), 0.0)[1][3] == pytest.approx(-43.4, abs=0.05)


def test_inertia_at_the_motor_equals_the_commissioned_value(mikron: Machine) -> None:
    computed = home_inertia_at_motor(mikron)
    load = {**MOVED, "A": inertia_at_a(0.0), "C": inertia_at_c()}
    for axis, value in zip(mikron.axes, computed):
        assert value == pytest.approx(ROTOR[axis.name] + load[axis.name] * RATIO[axis.name] ** 2, rel=EXACT)
        assert axis.commissioned_inertia == pytest.approx(value, rel=EXACT)


def test_friction_and_motors_of_the_compiled_model(mikron: Machine) -> None:
    model = compile_model(mikron)
    for name, ratio in RATIO.items():
        dof, motor = model.joint(name).dofadr[0], model.actuator(name).id
        assert model.dof_frictionloss[dof] == pytest.approx(COULOMB[name] / ratio, rel=EXACT)
        assert model.dof_damping[dof] == pytest.approx(VISCOUS[name] / ratio**2, rel=EXACT)
        assert model.actuator_gear[motor, 0] == pytest.approx(1 / ratio, rel=EXACT)
    assert model.opt.timestep == 125e-6


def test_values_of_the_file_override_the_model(mikron: Machine) -> None:
    changed = mikron.with_values({"axis.X.moving_mass_kg": 710.0, "body.table.mass_kg": 90.0, "axis.C.coulomb_friction_nm": 0.4})
    before, after = compile_model(mikron), compile_model(changed)
    assert after.body("x_slide").mass[0] == pytest.approx(before.body("x_slide").mass[0] + 10)
    assert after.body("y_slide").mass[0] == pytest.approx(before.body("y_slide").mass[0] - 10)  # Y still moves 1050 kg
    assert after.body("table").mass[0] == pytest.approx(90)
    assert after.dof_frictionloss[after.joint("C").dofadr[0]] == pytest.approx(0.4 * 120)


def test_the_machine_file_has_the_values_of_the_data_sheet(mikron: Machine) -> None:
    given = SHARED / "machine" / "mikron_ucp710.toml"
    if not given.is_file():
        pytest.skip("no data sheet to compare with: ../shared/machine is not beside this repository")
    ours, theirs = (tomllib.loads(path.read_text(encoding="utf-8")) for path in (default_machine_path(), given))
    del ours["model"]
    for axis in ours["axis"].values():
        del axis["commissioned"]
    theirs.pop("model", None)
    assert ours == theirs
