"""Effects in the direct measuring system: scale minus motor, against closed forms and the convolution with the frame's response."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import fftconvolve

from tests.builders.one_axis import TICK, follow, steady, there_and_back


def scale_minus_motor(trace, axis):
    return trace.get(axis, "position") - trace.get(axis, "motor_position")


@pytest.mark.parametrize(("frequency", "damping_ratio"), [(28.0, 0.05), (135.0, 0.02), (8.0, 0.1)])
def test_frame_vibration(frequency, damping_ratio):
    """f(t) = mass_ratio times the convolution of q'' with exp(-d w t) sin(w_d t) / w_d."""
    w = 2 * math.pi * frequency
    w_d = w * math.sqrt(1 - damping_ratio**2)
    effect = {"name": "frame_vibration", "frequency_hz": frequency, "mass_ratio": 0.06, "damping_ratio": damping_ratio}
    trace = follow("X", there_and_back(0.01, 0.1), [effect])
    q = np.diff(trace.get("X", "velocity")) / TICK
    # the answer to an acceleration that is constant over a tick, half a tick later
    t = (np.arange(len(q)) + 0.5) * TICK
    answer = np.exp(-damping_ratio * w * t) * np.sin(w_d * t) / w_d
    expected = 0.06 * fftconvolve(q, answer)[: len(q)] * TICK
    seen = scale_minus_motor(trace, "X")[1:]
    assert np.abs(seen).max() > 1e-7
    assert np.abs(seen - expected).max() < 2e-3 * np.abs(seen).max()


def test_encoder_eccentricity():
    """amplitude (sin(q + phase) - sin(q0 + phase)) with q the table's true angle."""
    start = 0.7
    trace = follow("C", start + steady(2.0, 1.0), [{"name": "encoder_eccentricity", "amplitude": 5e-5, "phase_rad": 0.4}])
    q = trace.get("C", "motor_position")
    expected = 5e-5 * (np.sin(q + 0.4) - math.sin(start + 0.4))
    assert np.abs(scale_minus_motor(trace, "C") - expected).max() < 1e-12
    assert np.ptp(expected) > 4e-5


def test_thermal_drift_continues_in_the_next_run():
    """rate (started_at + t): the second run continues the drift of the first one."""
    for started_at in (0.0, 40.0):
        trace = follow("Y", steady(0.01, 0.3), [{"name": "thermal_drift", "rate": 0.3e-6}], started_at=started_at)
        assert np.abs(scale_minus_motor(trace, "Y") - 0.3e-6 * (started_at + trace.time)).max() < 1e-15
        assert trace.get("Y", "position")[0] == trace.get("Y", "setpoint")[0]
