"""Effects in the control, against closed forms at constant speed and against an axis integrated from the law alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.builders.one_axis import NO_COULOMB, axis_of, follow, integrated_axis, steady, swing, total_inertia

SPEED = 0.1
POSITION_TOLERANCE = 5e-8
"""Tolerance for the twin's constant motor speed in the winding over a tick and its semi-implicit step, which the reference does not have [m]."""
CURRENT_TOLERANCE = 0.02


def rounded_move(t: float) -> float:
    """10 mm in 0.12 s with a smooth acceleration (at most 4.4 m/s2), then rest."""
    x = min(max((t - 0.02) / 0.12, 0.0), 1.0)
    return 0.01 * (x - math.sin(2 * math.pi * x) / (2 * math.pi))


@pytest.mark.parametrize(
    ("effect", "reference"),
    [
        (None, {}),
        ({"name": "position_gain", "factor": 0.8}, {"kv": 0.8}),
        ({"name": "velocity_feedforward", "factor": 0.9}, {"av": 0.9}),
        ({"name": "torque_feedforward", "factor": 0.4}, {"at": 0.4}),
        ({"name": "loop_delay", "delay_s": 0.6e-3}, {"delay": 0.6e-3}),
        ({"name": "loop_delay", "delay_s": -0.6e-3}, {"delay": -0.6e-3}),
        ({"name": "speed_gain", "factor": 0.6}, {"kp": 0.6}),
        ({"name": "speed_integral_time", "factor": 1.8}, {"tn": 1.8}),
        ({"name": "set_point_filter", "time_constant_s": 3e-3}, {"setpoint_lag": 3e-3}),
        ({"name": "current_filter", "time_constant_s": 1e-3}, {"current_lag": 1e-3}),
        ({"name": "current_limit", "limit_a": 12.0}, {"limit": 12.0}),
        ({"name": "torque_constant", "factor": 0.9}, {"kt": 0.9}),
        ({"name": "inertia", "added": 800.0}, {"added": 800.0}),
    ],
    ids=lambda value: (value or {"name": "nominal"}).get("name", ""),
)
def test_an_effect_agrees_with_an_integration_of_its_law(effect, reference):
    """Position and current over a whole fast move; without the effect the same comparison is off by more than ten times as much."""
    times = np.arange(221) * 1e-3
    setpoint = np.array([rounded_move(t) for t in times])
    trace = follow("X", setpoint, [NO_COULOMB, effect] if effect else [NO_COULOMB])
    position, current = integrated_axis("X", rounded_move, 0.22, **reference)
    count = len(position)
    # at the limit rounding decides in which ticks the integrator runs
    loose = 50.0 if "limit" in reference else 1.0
    assert np.abs(trace.get("X", "position")[:count] - position).max() < loose * POSITION_TOLERANCE
    assert np.abs(trace.get("X", "current")[:count] - current).max() < loose * CURRENT_TOLERANCE
    if effect:
        plain, _ = integrated_axis("X", rounded_move, 0.22)
        assert np.abs(trace.get("X", "position")[:count] - plain).max() > 10.0 * loose * POSITION_TOLERANCE


def following_error(effects, feedforward="off", axis="X", speed=SPEED):
    """Mean over the last 16 ms at constant speed."""
    trace = follow(axis, steady(speed, 0.5), effects, feedforward=feedforward)
    return float(np.mean((trace.get(axis, "setpoint") - trace.get(axis, "position"))[-129:-1:16]))


def test_position_gain():
    """v / (factor Kv) + v d_pos at constant speed with feedforward off."""
    loops = axis_of("X").loops
    for factor in (0.85, 1.15):
        expected = SPEED * (1.0 / (factor * loops.position_gain_per_s) + loops.position_delay_s)
        assert following_error([{"name": "position_gain", "factor": factor}]) == pytest.approx(expected, rel=1e-3)


def test_velocity_feedforward():
    """(1 - a_v) v / Kv beyond the set point's own delay."""
    loops = axis_of("X").loops
    expected = SPEED * (0.04 / loops.position_gain_per_s + loops.position_delay_s)
    assert following_error([{"name": "velocity_feedforward", "factor": 0.96}], "velocity+torque") == pytest.approx(expected, rel=1e-3)


def test_torque_feedforward():
    """The torque feedforward is factor J_ff a / r during constant acceleration."""
    a = axis_of("X")
    t = np.arange(301) * 1e-3
    trace = follow("X", 0.5 * 1.5 * np.maximum(t - 0.02, 0.0) ** 2, [{"name": "torque_feedforward", "factor": 0.5}])
    expected = 0.5 * a.commissioned_inertia * 1.5 / a.ratio
    assert trace.get("X", "torque_feedforward")[-1] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("feedforward", ["off", "velocity+torque"])
def test_loop_delay(feedforward):
    """v delay of extra following error, with feedforward off and on."""
    extra = following_error([{"name": "loop_delay", "delay_s": 0.5e-3}], feedforward) - following_error([], feedforward)
    assert extra == pytest.approx(SPEED * 0.5e-3, rel=1e-3)


def test_speed_gain_and_integral_time():
    """The speed controller answers a set point that jumps by one speed error e with Kp e, and its integral grows with Kp e / Tn."""
    jump = np.zeros(60)
    jump[30:] = 1e-5
    plain = first_answer([], jump)
    assert first_answer([{"name": "speed_gain", "factor": 0.7}], jump) == pytest.approx(0.7 * plain, rel=1e-9)
    assert first_answer([{"name": "speed_integral_time", "factor": 0.7}], jump) == pytest.approx(plain, rel=1e-9)


def first_answer(effects, setpoint):
    """The first current set point that is not zero, over the speed set point that made it."""
    trace = follow("X", setpoint, effects, feedforward="off")
    current, speed = trace.get("X", "current_setpoint"), trace.get("X", "velocity_setpoint")
    first = np.flatnonzero(np.abs(speed) > 0)[0]
    return current[first] / speed[first]


def test_speed_integral_time():
    """On a motor that cannot turn (Coulomb friction 10 times) the current grows by Kp e (1 + t / Tn) / Kt."""
    jump = np.zeros(100)
    jump[30:] = 2e-6
    loops = axis_of("X").loops
    for factor in (0.5, 1.0, 2.0):
        trace = follow(
            "X", jump, [{"name": "coulomb_friction", "factor": 10.0}, {"name": "speed_integral_time", "factor": factor}], feedforward="off"
        )
        current, speed = trace.get("X", "current_setpoint"), trace.get("X", "velocity_setpoint")
        held = np.flatnonzero(speed == speed[-1])[0]
        grown = (current[-1] - current[held]) / ((len(current) - 1 - held) * 125e-6)
        expected = loops.speed_gain_nm_s_per_rad * speed[-1] / axis_of("X").ratio / axis_of("X").motor.torque_constant_nm_per_a
        assert grown == pytest.approx(expected / (factor * loops.speed_integral_time_s), rel=0.02)


def test_set_point_filter():
    """A lag sampled with Tp follows a ramp by v (T' - Tp), T' = Tp / (1 - exp(-Tp / T)); feedforward does not pass through it."""
    tp, time_constant = 2e-3, 3e-3
    lag = tp / -math.expm1(-tp / time_constant) - tp
    for feedforward in ("off", "velocity+torque"):
        extra = following_error([{"name": "set_point_filter", "time_constant_s": time_constant}], feedforward) - following_error(
            [], feedforward
        )
        assert extra == pytest.approx(SPEED * lag, rel=1e-3)


def test_current_filter():
    """The filter multiplies the response of the current loop by p / (1 - (1 - p) exp(-j w Ti)), p = 1 - exp(-Ti / T)."""
    ti, time_constant, hz = 125e-6, 1e-3, 40.0
    p = -math.expm1(-ti / time_constant)
    wave = np.exp(-2j * np.pi * hz * ti * np.arange(4000))  # twenty periods
    answers = []
    for effects in ([], [{"name": "current_filter", "time_constant_s": time_constant}]):
        trace = follow("X", swing(5e-5, hz, 0.9), [NO_COULOMB, *effects])
        wanted, current = (trace.get("X", s)[-4000:] @ wave for s in ("current_setpoint", "current"))
        answers.append(current / wanted)
    expected = p / (1.0 - (1.0 - p) * np.exp(-2j * np.pi * hz * ti))
    assert abs(answers[1] / answers[0] / expected - 1.0) < 2e-3


def test_current_limit():
    """At the limit M a = Kt i / r - friction; i is below the limit by the effect of the growing back EMF, Ke a / r Tni / Kpi."""
    a = axis_of("X")
    m, r = a.motor, a.ratio
    t = np.arange(301) * 1e-3
    trace = follow("X", 0.5 * 3.0 * np.maximum(t - 0.02, 0.0) ** 2, [{"name": "current_limit", "limit_a": 8.0}])
    v = trace.get("X", "velocity")
    friction = a.coulomb_friction + a.viscous_friction * v[-401:-1].mean()
    taken = m.torque_constant_nm_per_a * m.back_emf_v_s_per_rad / r**2 * a.loops.current_integral_time_s / a.loops.current_gain_v_per_a
    expected = (8.0 * m.torque_constant_nm_per_a / r - friction) / (total_inertia("X") + taken)
    assert np.diff(v[-401:]).mean() / 125e-6 == pytest.approx(expected, rel=2e-3)
    assert np.abs(trace.get("X", "current_setpoint")).max() == 8.0
