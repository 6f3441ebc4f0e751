"""The Mikron as URDF, written by the script: the same joint accelerations as its MJCF, with the reader of the twin and that of MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.builders.script import script
from twin.machine.machine import Machine, load_machine
from twin.machine.urdf import spec_of_urdf
from twin.simulation.plant_spec import build_plant

TOLERANCE = 1e-9
"""Joint accelerations [m/s2, rad/s2], which reach some 100."""


@pytest.fixture(scope="module")
def urdf(mikron: Machine, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("urdf") / "mikron_ucp710.urdf"
    script("devtools/export_urdf.py", "export_urdf").export_urdf(mikron, path)
    return path


def bodies_alone(model: mujoco.MjModel) -> mujoco.MjModel:
    """Without motors, friction and travel, which URDF does not have."""
    for values in (model.dof_armature, model.actuator_armature, model.dof_damping, model.dof_frictionloss):
        values[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
    return model


def accelerations(model: mujoco.MjModel, names: tuple[str, ...], seed: int = 0) -> np.ndarray:
    """(state, axis) at random positions, speeds and forces."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(model)
    position, speed = ([model.joint(n).qposadr[0] for n in names], [model.joint(n).dofadr[0] for n in names])
    out = []
    for _ in range(200):
        data.qpos[position], data.qvel[speed] = rng.uniform(-0.3, 0.3, 5) * [1, 1, 1, 5, 10], rng.uniform(-1.0, 1.0, 5)
        data.qfrc_applied[speed] = rng.uniform(-500.0, 500.0, 5)
        mujoco.mj_forward(model, data)
        out.append(data.qacc[speed].copy())
    return np.array(out)


@pytest.mark.parametrize("reader", ["twin", "MuJoCo"])
def test_same_joint_accelerations(mikron: Machine, urdf: Path, reader: str) -> None:
    names = mikron.axis_names
    expected = accelerations(bodies_alone(build_plant(mikron).model), names)
    model = spec_of_urdf(urdf)[0].compile() if reader == "twin" else mujoco.MjModel.from_xml_path(str(urdf))
    found = accelerations(bodies_alone(model), names)
    assert np.abs(expected).max() > 20.0
    assert np.abs(found - expected).max() < TOLERANCE


def test_same_machine_with_its_drives(mikron: Machine, urdf: Path) -> None:
    """The machine file on the model that comes back from the URDF: rotors, gears and friction included."""
    (urdf.parent / "mikron_ucp710.xml").write_text(spec_of_urdf(urdf)[0].to_xml(), encoding="utf-8")
    assert mikron.path is not None
    (urdf.parent / "again.toml").write_text(mikron.path.read_text(encoding="utf-8"), encoding="utf-8")
    again = build_plant(load_machine(urdf.parent / "again.toml"))
    first = build_plant(mikron)
    names = mikron.axis_names
    assert np.abs(accelerations(again.model, names) - accelerations(first.model, names)).max() < TOLERANCE


def test_the_comparison_detects_another_mass(mikron: Machine, urdf: Path) -> None:
    """The comparison can fail: it detects 0.1 % of the table's mass."""
    model = bodies_alone(spec_of_urdf(urdf)[0].compile())
    expected = accelerations(model, mikron.axis_names)
    model.body("table").mass[0] *= 1.001
    assert np.abs(accelerations(model, mikron.axis_names) - expected).max() > 100 * TOLERANCE


def test_joint_limits_are_imported(mikron: Machine, urdf: Path) -> None:
    _, limits = spec_of_urdf(urdf)
    for axis in mikron.axes:
        assert limits[axis.name].speed == pytest.approx(axis.max_velocity)
        assert limits[axis.name].friction == pytest.approx(axis.coulomb_friction)
