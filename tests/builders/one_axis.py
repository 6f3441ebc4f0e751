"""What the reference tests of the effects share: short moves, the twin on them, and one axis integrated without the twin."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from twin.effects import load_inertia, with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Axis, Machine, load_machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

MACHINE = load_machine()
TICK = 125e-6
NO_COULOMB = {"name": "coulomb_friction", "factor": 0.0}


def axis_of(name: str) -> Axis:
    return MACHINE.axis(name)


def total_inertia(name: str) -> float:
    """Load and rotor [kg, kg m2]."""
    return load_inertia(MACHINE, axis_of(name)) + axis_of(name).reflected_inertia


def follow(
    axis: str, position, effects=(), *, feedforward: str | None = None, sample_period: float = TICK, with_axes="", started_at: float = 0.0
):
    """The twin's trace: `position` (sample,) at 1 ms on `axis` (or (sample, axis)), every effect {name, ...} on that axis."""
    machine: Machine = MACHINE.with_axes([axis, *with_axes])
    machine = with_effects(machine, [{"axis": axis, **e} for e in effects])
    if feedforward:
        machine = machine.with_feedforward(feedforward)
    position = np.asarray(position, float)
    if position.ndim == 1:
        columns = {axis: position}
        position = np.column_stack(
            [columns.get(a, np.full(len(position), np.clip(0.0, *machine.axis(a).travel))) for a in machine.axis_names]
        )
    return simulate(machine, Setpoints(position, 1e-3), sample_period=sample_period, started_at=started_at).trace


def steady(speed: float, seconds: float, ramp: float = 0.1) -> np.ndarray:
    """(sample,) at 1 ms: rest for 20 ms, a smooth start, then constant speed."""
    t = np.arange(round(seconds / 1e-3) + 1) * 1e-3 - 0.02
    x = np.clip(t / ramp, 0.0, 1.0)
    easing = x**3 * (1.0 - x / 2.0)  # integral of 3 x^2 - 2 x^3
    return speed * (easing * ramp + np.maximum(t - ramp, 0.0))


def swing(amplitude: float, frequency: float, seconds: float) -> np.ndarray:
    """(sample,) at 1 ms: rest for 20 ms, then a swing that eases in over one period."""
    t = np.maximum(np.arange(round(seconds / 1e-3) + 1) * 1e-3 - 0.02, 0.0)
    ease = np.clip(t * frequency, 0.0, 1.0)
    return amplitude * ease**3 * (10 - 15 * ease + 6 * ease**2) * np.sin(2 * np.pi * frequency * t)


def there_and_back(distance: float, speed: float, acceleration: float = 2.0, jerk: float = 200.0, dwell: float = 0.05) -> np.ndarray:
    """(sample,) at 1 ms: a jerk-limited move and the same back."""
    return moves_in_turn(0.0, [distance, -distance], speed, acceleration, jerk, dwell, 1e-3)[1]


def missing_force(trace, axis: str, viscous: float | None = None) -> np.ndarray:
    """(sample - 1,) force on the axis that motor, mass and viscous friction leave: M a + b v - T / r, each tick's mean."""
    a = axis_of(axis)
    v, torque = trace.get(axis, "velocity"), trace.get(axis, "torque")
    b = a.viscous_friction if viscous is None else viscous
    return total_inertia(axis) * np.diff(v) / TICK + b * (v[1:] + v[:-1]) / 2 - (torque[1:] + torque[:-1]) / 2 / a.ratio


def integrated_axis(
    name: str, position, seconds: float, *, kv=1.0, av=1.0, at=1.0, delay=0.0, kp=1.0, tn=1.0, setpoint_lag=0.0, current_lag=0.0, kt=1.0,
    limit=math.inf, added=0.0,
):  # fmt: skip
    """One axis without Coulomb friction, written from the law alone: exact steps of [q, v, i], no MuJoCo, no twin.

    `position(t)` is the set point; kv, av, at, kp, tn, kt are factors, the rest SI. Returns positions and currents (tick,).
    """
    a, h, tp = axis_of(name), TICK, 16 * TICK
    m, loops, r = a.motor, a.loops, a.ratio
    mass, b = total_inertia(name) + added, a.viscous_friction
    motor_kt = kt * m.torque_constant_nm_per_a
    system = np.zeros((4, 4))
    system[:3] = [
        [0.0, 1.0, 0.0, 0.0],
        [0.0, -b / mass, motor_kt / r / mass, 0.0],
        [0.0, -m.back_emf_v_s_per_rad / r / m.inductance_h, -m.resistance_ohm / m.inductance_h, 1.0 / m.inductance_h],
    ]
    step = expm(system * h)
    j_ff = a.commissioned_inertia
    y = np.array([position(0.0), 0.0, 0.0])
    integral = current_integral = w_set = t_ff = 0.0
    lagged_s, lagged_i = position(0.0), 0.0
    gain, speed_gain = kv * loops.position_gain_per_s, kp * loops.speed_gain_nm_s_per_rad
    out = []
    for k in range(round(seconds / h) + 1):
        t = k * h
        out.append((y[0], y[2]))
        if k % 16 == 0:
            s = position(t - loops.position_delay_s - delay)
            lagged_s += (s - lagged_s) * (1.0 - math.exp(-tp / setpoint_lag) if setpoint_lag else 1.0)
            now, before, earlier = (position(t - loops.feedforward_delay_s - n * tp) for n in range(3))
            w_set = (gain * (lagged_s - y[0]) + av * (now - before) / tp) / r
            t_ff = at * j_ff * (now - 2 * before + earlier) / tp**2 / r
        error = w_set - y[1] / r
        wanted = (speed_gain * error + integral + t_ff) / m.torque_constant_nm_per_a
        i_set = min(max(wanted, -limit), limit)
        if i_set == wanted:
            integral += speed_gain * h / (tn * loops.speed_integral_time_s) * error
        lagged_i += (i_set - lagged_i) * (1.0 - math.exp(-h / current_lag) if current_lag else 1.0)
        error = lagged_i - y[2]
        u = loops.current_gain_v_per_a * error + current_integral
        current_integral += loops.current_gain_v_per_a * h / loops.current_integral_time_s * error
        y = (step @ [*y, u])[:3]
    return np.array(out).T
