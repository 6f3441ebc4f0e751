"""A machine file that says nothing, or the wrong thing, of the noise of its sensors; position loops on the motor encoder with a scale beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin.diagnose import diagnose
from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, MeasuredRun, read_campaign
from twin.simulation.campaign_gap import AS_EXPECTED, gap
from twin.simulation.motor_and_scale import shifted
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "campaign"
ON_MOTOR = load_machine().with_axes(["X"]).with_values({"axis.X.encoder": "motor", "measurement.motor_encoder_noise_m": 5e-8})


def with_keys(machine: Machine, factor: float) -> Machine:
    """The machine with noise and resolution times a factor."""
    table = machine.document["measurement"]
    return machine.with_values({f"measurement.{k}": factor * v for k, v in table.items() if "noise" in k or "resolution" in k})


@pytest.mark.parametrize("factor", [0.0, 0.1, 10.0])
def test_a_healthy_campaign_is_healthy_whatever_the_file_says_of_the_noise(factor: float) -> None:
    machine = with_keys(load_machine(), factor)
    found = gap(EXAMPLE, machine)
    assert max(row.times_noise for row in found.rows()) < AS_EXPECTED
    assert any("noise of the scale" in note for note in found.notes)


def test_the_example_without_noise_keys_has_no_effect() -> None:
    machine = with_keys(load_machine(), 0.0)
    diagnosis = diagnose(read_campaign(EXAMPLE, machine), machine, quick=True)
    assert (diagnosis.verdict, diagnosis.named) == ("none", [])


def strokes(real: Machine, count: int, offset: float = 0.0) -> Campaign:
    """Runs of X, 40 s apart; the scale has a zero of its own."""
    way = moves_in_turn(0.0, [0.03, -0.03], 0.1, 1.0, 20.0, 0.15, 1e-3)[1][:, None]
    runs = []
    for k in range(count):
        trace = simulate(real, Setpoints(way, 1e-3), sample_period=1e-3, started_at=40.0 * k, noise_seed=40 + k).trace
        runs.append(MeasuredRun(f"run {k}", shifted(trace, real.axis("X"), offset), None, 40.0 * k))
    return Campaign(EXAMPLE, real.name, tuple(runs))


def test_a_healthy_axis_on_its_motor_encoder_is_healthy() -> None:
    diagnosis = diagnose(strokes(ON_MOTOR, 2), ON_MOTOR, quick=True)
    assert (diagnosis.verdict, diagnosis.named) == ("none", [])


def test_the_drift_of_a_scale_beside_the_loop_is_found_although_its_zero_differs() -> None:
    real = with_effects(ON_MOTOR, [{"name": "thermal_drift", "axis": "X", "rate": 3e-7}])
    diagnosis = diagnose(strokes(real, 3, 30e-6), ON_MOTOR, quick=True)
    assert [setting.effect.name for setting, _, _ in diagnosis.named] == ["thermal_drift"]
    assert diagnosis.named[0].setting.size == pytest.approx(3e-7, rel=0.1)
    assert np.isfinite(diagnosis.named[0].probability)
