"""Laws of one drive: limits, anti-windup, and the influence of each gain."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from twin.control.current_controller import current_controller, winding
from twin.control.position_controller import position_controller
from twin.control.speed_controller import speed_controller
from twin.machine.machine import Machine
from twin.simulation import cascade

speeds = st.floats(-500, 500)


@pytest.fixture(scope="module")
def drives(mikron: Machine) -> cascade.Drives:
    return cascade.drives_of(mikron)


def at_rest(drives: cascade.Drives) -> cascade.DriveState:
    return cascade.drives_at_rest(drives, np.zeros(5))


@settings(max_examples=100, deadline=None)
@given(speeds, st.integers(0, 4))
def test_current_limit_and_anti_windup(drives: cascade.Drives, speed: float, a: int) -> None:
    state = at_rest(drives)
    state.speed_setpoint[a] = speed
    unlimited = drives.speed_gain[a] * speed / drives.control_torque_constant[a]
    limited = speed_controller(a, drives, state, 0.0)
    assert limited == (abs(unlimited) > drives.peak_current[a])
    assert abs(state.current_setpoint[a]) <= drives.peak_current[a]
    # the integrator changes only below the limit
    assert state.speed_integral[a] == (0.0 if limited else drives.speed_integral_gain[a] * speed)


@settings(max_examples=100, deadline=None)
@given(st.floats(-100, 100), st.integers(0, 4))
def test_voltage_limit_and_anti_windup(drives: cascade.Drives, current: float, a: int) -> None:
    state = at_rest(drives)
    limited = current_controller(a, drives, state, current, 0.0)
    assert limited == (abs(drives.current_gain[a] * current) > drives.bus_limit[a])
    assert abs(state.voltage[a]) <= drives.bus_limit[a]
    assert state.current_integral[a] == (0.0 if limited else drives.current_integral_gain[a] * current)


def test_an_integrator_recovers_from_the_limit(drives: cascade.Drives) -> None:
    state = at_rest(drives)
    state.speed_setpoint[0] = 100.0
    for _ in range(1000):
        speed_controller(0, drives, state, 0.0)
    state.speed_setpoint[0] = 0.0
    speed_controller(0, drives, state, 0.0)
    assert abs(state.current_setpoint[0]) <= drives.peak_current[0]
    assert state.speed_integral[0] == 0.0


def test_position_controller_is_the_law(drives: cascade.Drives) -> None:
    state = at_rest(drives)
    position_controller(0, drives, state, 0.010, 0.2, 1.5, 0.009)
    assert state.speed_setpoint[0] == pytest.approx((50.0 * 0.001 + 0.2) / drives.ratio[0])
    assert state.torque_feedforward[0] == 1.5


def test_a_drive_at_rest_stays_at_rest(drives: cascade.Drives) -> None:
    held = np.array([0.0, 0.3, 5.4, -0.2, 0.0])
    state = cascade.drives_at_rest(drives, held)
    for _ in range(100):
        for a in range(5):
            speed_controller(a, drives, state, 0.0)
            current_controller(a, drives, state, state.current_setpoint[a], state.current[a])
            torque = drives.torque_constant[a] * winding(a, drives, state, 0.0)
            assert torque == pytest.approx(held[a], abs=1e-12)


def test_control_keeps_its_own_torque_constant(mikron: Machine) -> None:
    weaker = cascade.drives_of(mikron.with_axis("X", torque_constant_nm_per_a=1.3))
    assert weaker.torque_constant[0] == 1.3
    assert weaker.control_torque_constant[0] == 1.4


FIELDS = {
    "position_gain_per_s": "position_gain",
    "speed_gain_nm_s_per_rad": "speed_gain",
    "speed_integral_time_s": "speed_integral_gain",
    "current_gain_v_per_a": "current_gain",
    "current_integral_time_s": "current_integral_gain",
    "back_emf_v_s_per_rad": "back_emf",
    "resistance_ohm": "resistance",
    "inductance_h": "decay",
    "peak_current_a": "peak_current",
    "bus_limit_v": "bus_limit",
}


@pytest.mark.parametrize("key", FIELDS)
def test_each_parameter_of_the_file_reaches_the_drive(mikron: Machine, key: str) -> None:
    part = "loops" if hasattr(mikron.axes[0].loops, key) else "motor"
    value = getattr(getattr(mikron.axes[1], part), key)
    before = cascade.drives_of(mikron)
    after = cascade.drives_of(mikron.with_values({f"axis.Y.{part}.{key}": 1.1 * value}))
    changed = getattr(after, FIELDS[key]) != getattr(before, FIELDS[key])
    assert changed.tolist() == [False, True, False, False, False]
