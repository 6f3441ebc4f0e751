"""A frozen run: detects any change of the twin's numbers; its package versions are stored with it."""

import json

import numpy as np

from tests.golden.freeze import TRACE, VERSIONS, frozen_run, versions
from twin.machine.machine import Machine
from twin.recordings.trace import read_trace

TOLERANCE = {
    "setpoint": 1e-12,
    "position": 1e-10,  # 0.0001 um: another compiler or BLAS may round otherwise, another law may not
    "motor_position": 1e-10,
    "velocity": 1e-8,
    "velocity_setpoint": 1e-8,
    "current": 1e-5,
    "current_setpoint": 1e-5,
    "torque": 1e-5,
    "torque_feedforward": 1e-8,
    "torque_friction": 1e-5,
    "torque_gravity": 1e-8,
}


def test_same_as_frozen(mikron: Machine) -> None:
    frozen, now = read_trace(TRACE), frozen_run(mikron)
    frozen_with = json.loads(VERSIONS.read_text())
    note = f"frozen with {frozen_with}, this is {versions()}; wanted? then: python -m tests.golden.freeze"
    np.testing.assert_allclose(now.time, frozen.time, rtol=0, atol=1e-12, err_msg=note)
    for (axis, signal), expected in frozen.signals.items():
        difference = np.abs(now.get(axis, signal) - expected)
        assert difference.max() <= TOLERANCE[signal], f"{axis}.{signal} is off by {difference.max():.2e} ({note})"


def test_the_frozen_run_contains_all_features_that_may_change(mikron: Machine) -> None:
    frozen = read_trace(TRACE)
    assert frozen.axes == mikron.axis_names
    for axis in mikron.axis_names:
        assert np.ptp(frozen.get(axis, "position")) > 1e-3
        friction = frozen.get(axis, "torque_friction")
        assert friction.min() < 0 < friction.max()
