"""A record that begins with a deflected drive train: detection, and simulation from that state."""

import numpy as np
import pytest

from twin.effects import with_effects
from twin.effects.setting import check_setting
from twin.machine.machine import Machine
from twin.recordings.trace import Trace
from twin.simulation.motor_and_scale import deflection_at_start
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints, recorded_setpoints

DEFLECTION = 6e-6
"""Deflection of A beyond equilibrium at the first sample [rad]."""


@pytest.fixture
def elastic(mikron: Machine) -> Machine:
    return with_effects(mikron, [check_setting({"name": "transmission_compliance", "axis": "A", "stiffness": 3e7}, mikron, "test")])


def at_rest(machine: Machine, deflected: bool, seed: int | None = 1) -> Trace:
    """A record of 0.4 s at standstill."""
    start = np.array([DEFLECTION if deflected and axis.name == "A" else 0.0 for axis in machine.axes])
    points = Setpoints(np.zeros((401, len(machine.axes))), 1e-3, deflection=start if deflected else None)
    return simulate(machine, points, noise_seed=seed).trace


def test_an_initial_deflection_is_detected_and_simulated(elastic: Machine) -> None:
    record = at_rest(elastic, deflected=True)
    seen = deflection_at_start(record, elastic)
    assert seen is not None
    np.testing.assert_allclose(seen[elastic.axis_names.index("A")], DEFLECTION, rtol=0.2)  # friction holds a part
    assert np.count_nonzero(seen) == 1

    quiet = at_rest(elastic, deflected=True, seed=None).get("A", "position")
    twin = simulate(elastic, recorded_setpoints(record, elastic)).without_noise.get("A", "position")
    balanced = at_rest(elastic, deflected=False, seed=None).get("A", "position")
    assert np.std(quiet - twin) < 0.5 * np.std(quiet - balanced)


def test_noise_at_rest_is_not_a_deflection(elastic: Machine) -> None:
    assert deflection_at_start(at_rest(elastic, deflected=False), elastic) is None


def test_a_rigid_drive_train_cannot_deflect(mikron: Machine) -> None:
    assert np.array_equal(
        at_rest(mikron, deflected=True, seed=None).get("A", "motor_position"),
        at_rest(mikron, deflected=False, seed=None).get("A", "motor_position"),
    )


def test_a_record_that_begins_in_motion_has_no_initial_deflection(elastic: Machine) -> None:
    record = at_rest(elastic, deflected=True)
    moving = {**record.signals, ("A", "setpoint"): np.arange(401) * 1e-4}
    assert recorded_setpoints(Trace(record.time, moving, record.kinds), elastic).deflection is None
