"""Design studies against closed forms: error over inertia, and the matching lead."""

import math
from pathlib import Path

import numpy as np
import pytest

from tests.builders.study_files import rows_of, write_move, write_spec
from twin.machine.machine import load_machine
from twin.simulation.plant_spec import home_inertia_at_motor

X = load_machine().axis("X")
KP, KV = X.loops.speed_gain_nm_s_per_rad, X.loops.position_gain_per_s
PLAIN = (
    '[fixed]\n"axis.X.coulomb_friction_nm" = 0.0\n"axis.X.viscous_friction_nm_s_per_rad" = 0.0\n"axis.X.loops.torque_feedforward" = 0.0\n'
)
MASSES = (400.0, 700.0, 1000.0, 1400.0)


def masses(tmp_path: Path, fixed: str, response: str) -> tuple[np.ndarray, np.ndarray]:
    """A response over the inertia at the motor [kg m2], both (variant,)."""
    factor = '[[factor]]\nname = "mass"\npath = "axis.X.moving_mass_kg"\n'
    rows = f"[[{'], ['.join(map(str, MASSES))}]]"
    # Y carries X
    text = PLAIN + fixed + '"axis.Y.moving_mass_kg" = 1800.0\n' + factor + f'[design]\nkind = "list"\nrows = {rows}\n'
    found = rows_of(write_spec(tmp_path, text), tmp_path / "out")
    inertia = [
        home_inertia_at_motor(load_machine().with_values({"axis.X.moving_mass_kg": m, "axis.Y.moving_mass_kg": 1800.0}))[0] for m in MASSES
    ]
    return np.array(inertia), np.array([responses[response] for _, _, responses, _ in found])


def test_without_integrator_and_torque_feedforward_the_error_is_proportional_to_inertia(tmp_path: Path) -> None:
    """At constant acceleration the speed controller must produce J a / r: e = J a / (r Kp), and the position lags by r e / Kv = J a / (Kp Kv).

    Two small terms do not depend on J: the growing back EMF acts like an additional inertia of Kt Ke Tni / Kpi, and the speed is sampled
    on average half a tick before the middle of a position cycle.
    """
    acceleration = 1.0
    write_move(tmp_path / "move.csv", distance=0.2, acceleration=acceleration, jerk=50.0, speed=0.3)
    inertia, error = masses(tmp_path, '"axis.X.loops.speed_integral_time_s" = 1e6\n', "control_deviation_max_X_um")
    motor, tick = X.motor, load_machine().base_tick
    electrical = (
        motor.torque_constant_nm_per_a * motor.back_emf_v_s_per_rad * X.loops.current_integral_time_s / X.loops.current_gain_v_per_a
    )
    np.testing.assert_allclose(error, ((inertia + electrical) / KP - tick / 2.0) * acceleration / KV * 1e6, rtol=2e-3)
    proportional = error - (electrical / KP - tick / 2.0) * acceleration / KV * 1e6
    np.testing.assert_allclose(proportional / inertia, 1e6 * acceleration / (KP * KV), rtol=2e-3)


def test_with_integrator_the_error_is_proportional_to_inertia_and_jerk(tmp_path: Path) -> None:
    """At constant jerk the integrator must grow with J j / r = Kp e / Tn: the position lags by J Tn j / (Kp Kv)."""
    jerk, t_n = 5.0, X.loops.speed_integral_time_s
    write_move(tmp_path / "move.csv", distance=0.25, acceleration=5.0, jerk=jerk, speed=0.3)
    inertia, error = masses(tmp_path, "", "control_deviation_max_X_um")
    slope = np.polyfit(inertia, error, 1)[0]
    assert slope == pytest.approx(t_n * jerk / (KP * KV) * 1e6, rel=0.05)
    np.testing.assert_allclose(error, np.polyval(np.polyfit(inertia, error, 1), inertia), rtol=1e-3)


def test_the_lead_of_least_current_matches_the_inertias(tmp_path: Path) -> None:
    """T = (J + m r^2) a / r is least at r = sqrt(J / m), and 2 a sqrt(J m) there."""
    write_move(tmp_path / "move.csv", distance=0.25, acceleration=1.0, jerk=6.0, speed=0.3)
    matched = math.sqrt(X.rotor_inertia_kg_m2 / X.moving_mass_kg)
    leads = 2.0 * math.pi * matched * np.array([0.8, 0.9, 1.0, 1.1, 1.25])
    rows = f"[[{'], ['.join(map(repr, leads.tolist()))}]]"
    factor = '[[factor]]\nname = "lead"\npath = "axis.X.screw_lead_m_per_rev"\n'
    # a position cycle of one tick avoids the steps of 2 ms in the speed set point, so only the acceleration needs current
    fixed = PLAIN.replace('"axis.X.loops.torque_feedforward" = 0.0\n', "")
    fixed += '"control.position_cycle_us" = 125.0\n"axis.X.loops.position_delay_s" = 0.000125\n'
    tied = '[[tied]]\npath = "axis.X.loops.speed_gain_nm_s_per_rad"\nto = "inertia.X"\n'
    text = "recommission = true\n" + fixed + factor + tied
    found = rows_of(write_spec(tmp_path, text + f'[design]\nkind = "list"\nrows = {rows}\n'), tmp_path / "out")
    current = np.array([responses["current_max_X_a"] for _, _, responses, _ in found])
    # T(r) = T0 (r / r0 + r0 / r) / 2: a parabola of ln r about the least
    x = np.log(leads / (2.0 * math.pi))
    a, b, _ = np.polyfit(x, current, 2)
    assert math.exp(-b / (2.0 * a)) == pytest.approx(matched, rel=0.01)
    assert current[2] == pytest.approx(2.0 * 1.0 * math.sqrt(X.rotor_inertia_kg_m2 * X.moving_mass_kg) / 1.4, rel=0.01)
