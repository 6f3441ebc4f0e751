"""Friction sticks below break-away and follows its law above, in the model alone and in a run of the twin."""

import mujoco
import numpy as np
import pytest

from devtools.friction_check import SLIDING, push
from twin.machine.machine import Machine
from twin.simulation.plant_spec import compile_model
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

CREEP = {"linear": 0.1e-6, "rotary": 0.1e-6 / 0.3}
"""Largest creep at 95 % of break-away: 0.1 um/s, for rotary axes at the rim of the table (0.3 m)."""

FROM_THE_LAW = 1e-3


@pytest.fixture(scope="module", params=["machine file", "MJCF by itself"])
def model(request: pytest.FixtureRequest, mikron: Machine) -> mujoco.MjModel:
    return compile_model(mikron) if request.param == "machine file" else mujoco.MjModel.from_xml_path(str(mikron.model_path))


@pytest.mark.parametrize("share", [0.95, -0.95])
def test_sticks_at_95_percent_of_break_away(model: mujoco.MjModel, mikron: Machine, share: float) -> None:
    for axis in mikron.axes:
        speed = push(model, mikron, axis.name, share).speed
        assert abs(speed) < CREEP[axis.kind], f"{axis.name} creeps at {speed:.2e}"


def test_breaks_away_just_above_and_follows_the_friction_law(model: mujoco.MjModel, mikron: Machine) -> None:
    for axis in mikron.axes:
        result = push(model, mikron, axis.name, SLIDING)
        assert result.speed > 20 * CREEP[axis.kind]
        assert result.friction == pytest.approx(axis.coulomb_friction, rel=FROM_THE_LAW)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_motor_torque_at_constant_speed_is_the_law(mikron: Machine, direction: float) -> None:
    """Kt i = Coulomb + viscous w + gravity, through the whole twin at 3 m/min and 30 degrees a second on C."""
    machine = mikron.with_axes(["X", "Y", "Z", "C"])
    t = np.arange(1500) * 1e-3
    speed = direction * np.array([0.05, 0.05, 0.05, 0.5])
    ramp = np.where(t < 0.4, t**2 / 0.8, t - 0.2)
    trace = simulate(machine, Setpoints(ramp[:, None] * speed - 0.5 * ramp.max() * speed, 1e-3)).trace
    steady = trace.time > 1.0
    for axis, v in zip(machine.axes, speed):
        torque = trace.get(axis.name, "torque")[steady].mean()
        gravity = axis.moving_mass_kg * machine.gravity * axis.ratio if axis.name == "Z" else 0.0
        law = axis.coulomb_friction_nm * np.sign(v) + axis.viscous_friction_nm_s_per_rad * v / axis.ratio
        assert torque - gravity == pytest.approx(law, rel=FROM_THE_LAW), axis.name
        recorded = trace.get(axis.name, "torque_friction")[steady].mean()
        assert recorded == pytest.approx(law, rel=FROM_THE_LAW), axis.name


def test_speed_after_half_a_second_is_the_closed_form(model: mujoco.MjModel, mikron: Machine) -> None:
    """v = (F - Fc)/b (1 - exp(-b t/M)) for a linear axis pushed from rest with twice its friction."""
    for axis in mikron.axes[:3]:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        gravity = data.qfrc_bias[model.joint(axis.name).dofadr[0]]
        data.ctrl[model.actuator(axis.name).id] = (gravity + 2 * axis.coulomb_friction) * axis.ratio
        for _ in range(4000):
            mujoco.mj_step(model, data)
        mass, b = axis.moving_mass_kg + axis.reflected_inertia, axis.viscous_friction
        closed = axis.coulomb_friction / b * -np.expm1(-b * 0.5 / mass)
        assert data.qvel[model.joint(axis.name).dofadr[0]] == pytest.approx(closed, rel=5e-5)
