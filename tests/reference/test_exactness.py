"""Exact parts of the twin: motion under constant force at the ticks, and the winding between two ticks."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tests.conftest import swings
from twin.control.current_controller import current_controller, winding
from twin.machine.machine import Machine
from twin.simulation import cascade
from twin.simulation.plant_spec import build_plant
from twin.simulation.run import simulate


def test_position_at_the_tick_is_exact_under_constant_force(mikron: Machine) -> None:
    """x = a t^2 / 2 at every tick, read as qpos - h/2 qvel; the engine's own qpos is h v / 2 ahead."""
    machine = mikron.with_axes(["X"]).with_axis("X", coulomb_friction_nm=0.0, viscous_friction_nm_s_per_rad=0.0)
    plant, h = build_plant(machine), machine.base_tick
    axis, torque, ticks = machine.axes[0], 3.0, 4000
    acceleration = torque / axis.ratio / (axis.moving_mass_kg + axis.reflected_inertia)
    plant.data.ctrl[plant.actuator] = torque
    at_tick, ahead = np.zeros(ticks), np.zeros(ticks)
    for k in range(ticks):
        ahead[k] = plant.data.qpos[0]
        at_tick[k] = plant.data.qpos[0] - 0.5 * h * plant.data.qvel[0]
        mujoco.mj_step(plant.model, plant.data)
    t = np.arange(ticks) * h
    np.testing.assert_allclose(at_tick, 0.5 * acceleration * t**2, rtol=1e-11, atol=1e-15)
    assert np.abs(ahead - 0.5 * acceleration * t**2).max() > 1e-5  # effect of the half step: more than 10 um


def test_recorded_position_and_speed_belong_together(mikron: Machine) -> None:
    """x(k+1) - x(k) = h (v(k) + v(k+1)) / 2 at every tick: exact for a force that is constant over a tick."""
    trace = simulate(mikron, swings(mikron, 0.5), sample_period=mikron.base_tick).trace
    for axis in mikron.axes:
        x, v = trace.get(axis.name, "position"), trace.get(axis.name, "velocity")
        np.testing.assert_allclose(np.diff(x), 0.5 * mikron.base_tick * (v[1:] + v[:-1]), rtol=0, atol=1e-15)


def test_winding_is_the_matrix_exponential(mikron: Machine) -> None:
    """L di/dt = u - R i - Ke w under held u and w, and the mean of i over the tick."""
    drives, h = cascade.drives_of(mikron), mikron.base_tick
    random = np.random.default_rng(1)
    for a, axis in enumerate(mikron.axes):
        m = axis.motor
        for _ in range(20):
            i, u, w = random.uniform(-20, 20), random.uniform(-300, 300), random.uniform(-300, 300)
            state = cascade.drives_at_rest(drives, np.zeros(5))
            state.current[a], state.voltage[a] = i, u
            mean = winding(a, drives, state, w)
            # state (i, integral of i, 1): linear, so its exponential over the tick is exact
            drive = (u - m.back_emf_v_s_per_rad * w) / m.inductance_h
            rate = np.array([[-m.resistance_ohm / m.inductance_h, 0, drive], [1, 0, 0], [0, 0, 0]])
            exact = expm(rate * h) @ [i, 0, 1]
            assert state.current[a] == pytest.approx(exact[0], rel=1e-12, abs=1e-12)
            assert mean == pytest.approx(exact[1] / h, rel=1e-11, abs=1e-11)


def test_current_loop_against_an_integrator(mikron: Machine) -> None:
    """A step of the current set point at standstill: sampled PI and winding against solve_ivp over 40 ticks."""
    drives, h, axis = cascade.drives_of(mikron), mikron.base_tick, mikron.axes[0]
    m, p = axis.motor, axis.loops
    state = cascade.drives_at_rest(drives, np.zeros(5))
    current, integral = 0.0, 0.0
    for _ in range(40):
        current_controller(0, drives, state, 10.0, state.current[0])
        winding(0, drives, state, 0.0)
        u = np.clip(p.current_gain_v_per_a * (10.0 - current) + integral, -m.bus_limit_v, m.bus_limit_v)
        integral += p.current_gain_v_per_a * h / p.current_integral_time_s * (10.0 - current)
        solution = solve_ivp(lambda _t, i, u=u: (u - m.resistance_ohm * i) / m.inductance_h, (0, h), [current], rtol=1e-10, atol=1e-12)
        current = solution.y[0, -1]
        assert state.current[0] == pytest.approx(current, abs=1e-8)
    assert current == pytest.approx(10.0, rel=0.02)
