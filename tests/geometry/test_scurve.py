"""Moves of any distance respect their limits and end at their target."""

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest

from twin.geometry.scurve import jerk_limited_move, moves_in_turn, phases_of_move

positive = st.floats(1e-3, 1e2)


@settings(max_examples=200, deadline=None)
@given(positive, positive, positive, positive)
def test_phases_keep_the_limits_and_cover_the_distance(distance: float, speed: float, acceleration: float, jerk: float) -> None:
    t_j, t_a, t_v = phases_of_move(distance, speed, acceleration, jerk)
    assert min(t_j, t_a, t_v) >= 0
    reached = jerk * t_j * (t_j + t_a)
    assert jerk * t_j <= acceleration * (1 + 1e-12)
    assert reached <= speed * (1 + 1e-9)
    assert reached * (2 * t_j + t_a + t_v) == pytest.approx(distance, rel=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.floats(-1, 1).filter(lambda d: abs(d) > 1e-3))
def test_a_move_ends_at_its_distance_and_is_smooth(distance: float) -> None:
    t_j, t_a, t_v = phases_of_move(abs(distance), 0.25, 2.5, 5.0)
    end = 4 * t_j + 2 * t_a + t_v
    t = np.linspace(-0.1, end + 0.1, 4001)
    x = jerk_limited_move(distance, 0.25, 2.5, 5.0, t)
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(distance, rel=1e-12)
    h = t[1] - t[0]
    rounding = 8 * np.finfo(float).eps / h**3  # four positions of about 1 m
    assert np.abs(np.diff(x, 3)).max() / h**3 <= 5.0 + rounding
    assert np.all(np.diff(x) * np.sign(distance) >= -1e-15)


def test_moves_in_turn_come_back() -> None:
    t, x = moves_in_turn(-0.1, [0.2, -0.2], 0.25, 2.5, 5.0, 0.2, 1e-3)
    assert x[0] == -0.1
    assert x.max() == pytest.approx(0.1, abs=1e-12)
    assert x[-1] == pytest.approx(-0.1, abs=1e-12)
    assert np.ptp(np.diff(t)) < 1e-12
