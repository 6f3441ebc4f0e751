"""The MJCF alone is the nominal machine: without the machine file it has the same values and moves the same."""

import mujoco
import numpy as np
import pytest

from twin.machine.machine import Machine
from twin.simulation.plant_spec import compile_model

ROUNDING = 1e-14
"""The XML holds 16 to 17 digits; the machine file's values are computed from the data sheet (relative)."""

FIELDS = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_pos",
    "body_quat",
    "dof_frictionloss",
    "dof_damping",
    "dof_armature",
    "dof_solref",
    "dof_solimp",
    "jnt_axis",
    "jnt_pos",
    "actuator_gear",
    "actuator_armature",
    "site_pos",
    "qpos0",
)


@pytest.fixture(scope="module")
def models(mikron: Machine) -> tuple[mujoco.MjModel, mujoco.MjModel]:
    return mujoco.MjModel.from_xml_path(str(mikron.model_path)), compile_model(mikron)


@pytest.mark.parametrize("field", FIELDS)
def test_same_numbers(models: tuple[mujoco.MjModel, mujoco.MjModel], field: str) -> None:
    alone, from_file = (getattr(model, field) for model in models)
    np.testing.assert_allclose(alone, from_file, rtol=ROUNDING, atol=1e-15)


def test_same_options(models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    alone, from_file = (model.opt for model in models)
    assert alone.timestep == from_file.timestep
    assert alone.solver == from_file.solver
    assert alone.integrator == from_file.integrator
    assert alone.tolerance == from_file.tolerance
    np.testing.assert_array_equal(alone.gravity, from_file.gravity)


def test_travel_is_the_range_of_the_joints(mikron: Machine, models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    for axis in mikron.axes:
        joint = models[0].joint(axis.name)
        if np.isinf(axis.travel[0]):
            assert not models[0].jnt_limited[joint.id]
        else:
            np.testing.assert_allclose(joint.range, axis.travel, rtol=ROUNDING)


def test_moves_the_same(mikron: Machine, models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    torque = np.array([4.0, -5.0, 8.0, 1.2, -0.8])  # X Y Z A C
    ends = []
    for model in models:
        data = mujoco.MjData(model)
        for k in range(4000):
            data.ctrl[:] = torque * np.cos(2 * np.pi * 3.0 * k * model.opt.timestep)
            mujoco.mj_step(model, data)
        ends.append(data.qpos.copy())
    assert np.abs(ends[0]).min() > 1e-4
    np.testing.assert_allclose(ends[0], ends[1], rtol=1e-9, atol=1e-12)


def test_the_machine_stays_at_its_home_position(models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    model = models[0]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    for _ in range(8000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qpos).max() < 1e-9


def test_scene_has_the_machine_and_frames(mikron: Machine) -> None:
    scene = mujoco.MjModel.from_xml_path(str(mikron.model_path.with_name("scene.xml")))
    assert {scene.joint(i).name for i in range(scene.njnt)} == {"X", "Y", "Z", "A", "C"}
    assert scene.nlight > 0
    data = mujoco.MjData(scene)
    mujoco.mj_forward(scene, data)
    np.testing.assert_allclose(data.site("tool").xpos, [0, 0, 0.35], atol=1e-12)
    np.testing.assert_allclose(data.site("workpiece").xpos, [0, 0, 0.05], atol=1e-12)
    data.joint("A").qpos[0] = -np.pi / 2  # the table faces the back, its normal along +y
    mujoco.mj_forward(scene, data)
    np.testing.assert_allclose(data.site("workpiece").xpos, [0, 0.05, 0], atol=1e-12)


def test_nothing_collides(models: tuple[mujoco.MjModel, mujoco.MjModel]) -> None:
    assert models[0].opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT
