"""The lag of a position, where the integral part of a speed loop makes up for friction only in time. A loop of its own, integrated without the twin."""

import numpy as np
import pytest

from tests.builders.identify_campaigns import path
from twin.identify.recorded_axis import lags_of, strokes_of
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace

TICK, EVERY = 2.5e-4, 8


def strokes(seconds: float) -> np.ndarray:
    """Set points each ms: strokes at four speeds, each of which is steady for so long."""
    moves = [path([seconds * v, 0.0], [v, v], acceleration=2.0, jerk=100.0, dwell=0.05) for v in (0.03, 0.08, 0.15, 0.25)]
    return np.concatenate(moves)


def sines() -> np.ndarray:
    """Set points each ms from rest to rest, whose speed is never steady, as those that excite a robot."""
    t = np.arange(0.0, 8.0, 1e-3)
    window = np.clip(np.minimum(t, 8.0 - t), 0.0, 1.0)
    return window**2 * (3.0 - 2.0 * window) * sum(0.03 * np.sin(2.0 * np.pi * f * t + f) for f in (0.3, 0.7, 1.1))


def loop(gain: float, feedforward: float, integral_time: float, friction: float, slow: np.ndarray) -> MeasuredRun:
    """P position and PI speed loop on 50 kg with Coulomb and viscous friction, recorded every 2 ms to a micrometre."""
    setpoint = np.interp(np.arange(len(slow) * EVERY) / EVERY, np.arange(len(slow)), slow)
    mass, speed_gain = 50.0, 50.0 * 180.0
    x = v = integral = before = 0.0
    position = np.empty_like(setpoint)
    for k, s in enumerate(setpoint):
        error = gain * (s - x) + feedforward * (s - before) / TICK - v
        before = s
        integral += speed_gain / integral_time * error * TICK
        faster = v + TICK * (speed_gain * error + integral - 100.0 * v) / mass
        v = np.sign(faster) * max(abs(faster) - TICK * friction / mass, 0.0)
        x += TICK * v
        position[k] = x
    rows = slice(0, len(setpoint), EVERY)
    trace = Trace(
        np.arange(len(setpoint[rows])) * EVERY * TICK,
        {("X", "setpoint"): setpoint[rows], ("X", "position"): np.round(position[rows], 6)},
        {"X": "linear"},
    )
    return MeasuredRun("strokes", trace, None, 0.0)


@pytest.mark.parametrize(
    ("gain", "feedforward", "integral_time", "friction", "slow"),
    [
        (40.0, 0.0, 0.03, 60.0, strokes(0.3)),
        (15.0, 0.9, 0.04, 60.0, strokes(0.3)),
        (20.0, 0.0, 0.15, 60.0, strokes(0.5)),
        (20.0, 0.0, 0.05, 200.0, sines()),
        (15.0, 0.7, 0.08, 60.0, sines()),
    ],
)
def test_the_interval_of_a_lag_covers_what_an_integral_part_leaves(
    gain: float, feedforward: float, integral_time: float, friction: float, slow: np.ndarray
) -> None:
    run = loop(gain, feedforward, integral_time, friction, slow)
    rows = strokes_of([run], "X")
    assert rows is not None
    lag = lags_of([run], "X", rows)[0][""]
    true = (1.0 - feedforward) / gain - TICK
    assert lag.low <= true <= lag.high
    assert lag.half < 0.05 * true
