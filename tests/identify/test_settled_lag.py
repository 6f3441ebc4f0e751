"""The lag of a position, where the integral part of a speed loop makes up for friction only in time. A loop of its own, integrated without the twin."""

import numpy as np
import pytest

from tests.builders.identify_campaigns import path
from twin.identify.recorded_axis import lags_of, strokes_of
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace

TICK, EVERY = 2.5e-4, 8


def loop(gain: float, feedforward: float, integral_time: float, friction: float, seconds: float) -> MeasuredRun:
    """P position and PI speed loop on 50 kg with Coulomb and viscous friction, strokes at four speeds, recorded every 2 ms to a micrometre."""
    moves = [path([seconds * v, 0.0], [v, v], acceleration=2.0, jerk=100.0, dwell=0.05) for v in (0.03, 0.08, 0.15, 0.25)]
    slow = np.concatenate(moves)
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
    ("gain", "feedforward", "integral_time", "seconds"), [(40.0, 0.0, 0.03, 0.3), (15.0, 0.9, 0.04, 0.3), (20.0, 0.0, 0.15, 0.5)]
)
def test_the_interval_of_a_lag_covers_what_an_integral_part_leaves(
    gain: float, feedforward: float, integral_time: float, seconds: float
) -> None:
    run = loop(gain, feedforward, integral_time, 60.0, seconds)
    rows = strokes_of([run], "X")
    assert rows is not None
    lag = lags_of([run], "X", rows)[0][""]
    true = (1.0 - feedforward) / gain - TICK
    assert lag.low <= true <= lag.high
    assert lag.half < 0.05 * true
