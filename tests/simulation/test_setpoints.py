"""Set points: resampling adds no jerk, delays are exact, differences follow the law."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from tests.conftest import swings
from twin.geometry.scurve import jerk_limited_move
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.position_command import command_of
from twin.simulation.setpoint_limits import limit_warnings
from twin.simulation.setpoints import Setpoints, check_travel, setpoints_of

OMEGA = 2 * np.pi * 1.5
INTERPOLATION = 1e-12
"""Error of cubic interpolation of a 1.5 Hz sine of 50 mm at 1 kHz: amplitude (omega h)^4 / 384 = 1e-12 m."""


def sine(seconds: float, period: float) -> Setpoints:
    t = np.arange(round(seconds / period) + 1) * period
    return Setpoints((0.05 * np.sin(OMEGA * t))[:, None], period)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.0103), st.sampled_from([1e-3, 2e-3, 0.5e-3]))
def test_any_delay_of_a_known_function(delay: float, period: float) -> None:
    times = 1.0 + np.arange(50) * 2e-3
    read = sine(3.0, period).at(times - delay)[:, 0]
    # a time within 1e-9 of a sample is moved to the sample: the error is speed times that shift
    bound = INTERPOLATION * (period / 1e-3) ** 4 * 1.5 + 1e-9 * period * 0.05 * OMEGA + 1e-16
    np.testing.assert_allclose(read, 0.05 * np.sin(OMEGA * (times - delay)), rtol=0, atol=bound)


def test_a_long_trace_in_windows_equals_one_spline(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    times = 1.3 + np.arange(500) * 0.7e-3
    whole = swings(mikron, 3.0).at(times)
    monkeypatch.setattr("twin.simulation.setpoints._KEEP_SPLINE", 0)
    np.testing.assert_allclose(swings(mikron, 3.0).at(times), whole, rtol=0, atol=1e-15)


def test_samples_are_kept_and_the_ends_hold() -> None:
    points = sine(1.0, 1e-3)
    np.testing.assert_array_equal(points.at(np.array([0.123, 0.5])), points.position[[123, 500]])
    np.testing.assert_array_equal(points.at(np.array([-5.0, -1e-3])), points.position[[0, 0]])
    np.testing.assert_allclose(points.at(np.array([1.001, 7.0])), points.position[[-1, -1]], rtol=0, atol=1e-18)


@pytest.mark.parametrize("period", [1e-3, 1.7e-3, 4e-3, 8e-3])
def test_resampling_adds_no_jerk(period: float) -> None:
    t = np.arange(round(1.4 / period) + 1) * period
    points = Setpoints(jerk_limited_move(0.2, 0.25, 2.5, 5.0, t - 0.1)[:, None], period)
    tick = 2e-3
    resampled = points.at(np.arange(0.0, 1.4, tick))[:, 0]
    jerk = np.abs(np.diff(resampled, 3)) / tick**3
    # a spline overshoots a jump of the jerk from +5 to -5 by at most 0.27 of it
    assert jerk.max() <= 5.0 + 0.27 * 10.0
    straight = np.interp(np.arange(0.0, 1.4, tick), t, points.position[:, 0])
    if period > 2 * tick:
        assert np.abs(np.diff(straight, 3)).max() / tick**3 > 10 * jerk.max()  # linear interpolation


@pytest.mark.parametrize("kept", [0, 100_000])
def test_a_stretch_equals_that_part_of_the_whole(mikron: Machine, monkeypatch: pytest.MonkeyPatch, kept: int) -> None:
    monkeypatch.setattr("twin.simulation.setpoints._KEEP_SPLINE", kept)
    points = swings(mikron, 3.0)
    inertia = np.ones(5)
    whole = command_of(mikron, inertia, points, 0, 1400)
    part = command_of(mikron, inertia, points, 700, 200)
    np.testing.assert_allclose(part.setpoint, whole.setpoint[700:900], rtol=0, atol=1e-15)
    np.testing.assert_allclose(part.velocity_feedforward, whole.velocity_feedforward[700:900], rtol=0, atol=1e-12)


def test_command_is_the_law(mikron: Machine) -> None:
    machine = mikron.with_axes(["X"]).with_axis(
        "X", position_delay_s=0.00137, feedforward_delay_s=0.00041, velocity_feedforward=0.9, torque_feedforward=0.8
    )
    axis, tp = machine.axes[0], machine.position_cycle
    command = command_of(machine, np.array([0.0123]), sine(3.0, 1e-3), 500, 100)
    t = np.arange(500, 600) * tp

    def s(times: np.ndarray) -> np.ndarray:
        return 0.05 * np.sin(OMEGA * times)

    f = t - 0.00041
    np.testing.assert_allclose(command.setpoint[:, 0], s(t - 0.00137), rtol=0, atol=2 * INTERPOLATION)
    np.testing.assert_allclose(command.velocity_feedforward[:, 0], 0.9 * (s(f) - s(f - tp)) / tp, rtol=0, atol=4 * INTERPOLATION / tp)
    torque = 0.8 * 0.0123 * (s(f) - 2 * s(f - tp) + s(f - 2 * tp)) / tp**2 / axis.ratio
    np.testing.assert_allclose(command.torque_feedforward[:, 0], torque, rtol=0, atol=8 * INTERPOLATION / tp**2 * 0.0123 / axis.ratio)


def test_axes_that_the_trace_lacks_stand_still(mikron: Machine) -> None:
    trace = Trace(np.arange(5) * 1e-3, {("Y", "setpoint"): np.full(5, 0.1)}, {"Y": "linear"})
    points = setpoints_of(trace, mikron)
    np.testing.assert_array_equal(points.position, np.tile([0, 0.1, 0, 0, 0], (5, 1)))


def test_travel_is_closed_and_endless_axes_have_none(mikron: Machine) -> None:
    ends = np.zeros((4, 5))
    ends[:, 0], ends[:, 4] = 0.355, 1e3
    check_travel(Setpoints(ends, 1e-3), mikron, "here")


def test_a_move_at_its_limits_gives_no_warning(mikron: Machine) -> None:
    t = np.arange(1500) * 1e-3
    position = np.zeros((1500, 5))
    position[:, 0] = jerk_limited_move(0.3, 0.5, 2.5, 5.0, t)
    assert limit_warnings(Setpoints(position, 1e-3), mikron) == []
    rounded = np.round(position, 9)  # a recording in um with three decimals
    assert limit_warnings(Setpoints(rounded, 1e-3), mikron) == []


def test_each_limit_warning_has_time_and_value(mikron: Machine) -> None:
    t = np.arange(3000) * 1e-3
    position = np.zeros((3000, 5))
    position[:, 0] = jerk_limited_move(0.3, 0.5, 2.5, 7.0, t - 1.0)
    (line,) = limit_warnings(Setpoints(position, 1e-3), mikron)
    assert "axis X" in line
    assert "jerk of 7 m/s3" in line
    assert "the limit is 5 m/s3" in line
    position[:, 4] = np.cumsum(np.full(3000, 2.2e-3))
    assert any("axis C" in text and "speed of 126.1 deg/s" in text for text in limit_warnings(Setpoints(position, 1e-3), mikron))
