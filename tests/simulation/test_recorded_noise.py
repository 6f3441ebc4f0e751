"""Noise of the sensors from a record: what each sensor has, whatever the machine file says and whichever encoder closes the position loop."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
import pytest

from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine, Noise, load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import gap_of, predict
from twin.simulation.recorded_noise import UNIT, measurement_values, with_recorded_noise
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

TRUE = Noise(position=3e-7, position_resolution=1e-7, motor_resolution=1e-8, speed=8e-5, current=0.02, motor=2e-7)
"""Another sensor is loud in each signal: the scale shakes the speed, the speed the current."""

KEYS = {"given": 1.0, "a tenth": 0.1, "tenfold": 10.0, "absent": 0.0}


def machine_on(encoder: str) -> Machine:
    return load_machine().with_axes(["Z"]).with_values({"axis.Z.encoder": encoder})


def recorded(machine: Machine, noise: Noise | None, period: float = 1e-3) -> MeasuredRun:
    """Strokes of Z, recorded with this noise; None without noise."""
    way = moves_in_turn(0.0, [0.03, -0.03], 0.05, 1.0, 20.0, 0.3, period)[1]
    noisy = machine if noise is None else machine.with_noise({"Z": noise})
    trace = simulate(noisy, Setpoints(way[:, None], period), sample_period=period, noise_seed=None if noise is None else 30).trace
    return MeasuredRun("strokes", trace, None, 0.0)


@pytest.mark.parametrize("keys", KEYS)
@pytest.mark.parametrize("encoder", ["scale", "motor"])
def test_the_noise_of_each_sensor_is_found_whatever_the_file_says(encoder: str, keys: str) -> None:
    machine = machine_on(encoder)
    said = machine.with_noise({"Z": Noise(**{name: KEYS[keys] * value for name, value in vars(TRUE).items()})})
    found, notes = with_recorded_noise(said, [recorded(machine, TRUE)])
    for sensor in UNIT:
        assert found.noise(found.axis("Z")).total(sensor) == pytest.approx(TRUE.total(sensor), rel=0.25), sensor
    assert bool(notes) == (keys != "given")


@pytest.mark.parametrize("period", [1e-3, 2e-3])
def test_a_record_of_another_effect_and_period_has_the_same_noise(period: float) -> None:
    machine = machine_on("motor")
    rubbing = with_effects(machine, [{"name": "coulomb_friction", "axis": "Z", "factor": 1.4}])
    values = measurement_values(machine, [recorded(rubbing, TRUE, period)])
    assert values["linear_scale_noise_m"] == pytest.approx(3e-7, rel=0.2)
    assert values["motor_encoder_noise_m"] == pytest.approx(2e-7, rel=0.2)
    assert values["current_noise_a"] == pytest.approx(0.02, rel=0.2)


def test_noise_hidden_in_coarse_steps_is_that_of_the_steps() -> None:
    machine = machine_on("motor")
    coarse = replace(TRUE, position=2e-8, position_resolution=1e-6, motor=2e-8, motor_resolution=1e-6)
    said = machine.with_noise({"Z": Noise(*6 * (0.0,))})
    found = with_recorded_noise(said, [recorded(machine, coarse)])[0].noise(machine.axis("Z"))
    assert found.position_resolution == pytest.approx(1e-6, rel=1e-6)
    assert found.motor_resolution == pytest.approx(1e-6, rel=1e-6)
    assert found.total("position") < 2.0 * coarse.total("position")


def test_noise_that_rounding_hides_is_not_written_as_none() -> None:
    machine = machine_on("motor")
    coarse = replace(TRUE, position=2e-8, position_resolution=1e-6, motor=2e-8, motor_resolution=1e-6)
    run = recorded(machine, coarse)
    unknown = measurement_values(machine.with_noise({"Z": Noise(*6 * (0.0,))}), [run])
    assert all(value > 0.0 for value in unknown.values())
    assert "current_noise_a" in unknown
    assert measurement_values(machine.with_noise({"Z": coarse}), [run]).keys() > unknown.keys()


def test_a_record_without_noise_keeps_the_noise_of_the_file(mikron: Machine) -> None:
    machine = mikron.with_axes(["Z"])
    found, notes = with_recorded_noise(machine, [recorded(machine, None)])
    assert found.noise(found.axis("Z")) == machine.noise(machine.axis("Z"))
    assert not notes


@pytest.mark.parametrize("encoder", ["scale", "motor"])
def test_a_healthy_record_is_at_its_noise(encoder: str) -> None:
    """Both encoders are noisy, whichever of them closes the loop."""
    machine = machine_on(encoder)
    run = recorded(machine, TRUE)
    noisy = with_recorded_noise(machine, [run])[0]
    for signal, gap in gap_of(noisy, run, predict(noisy, run))["Z"].items():
        assert 0.8 < gap.rms / gap.noise < 1.25, signal


def test_an_axis_on_its_motor_encoder_starts_at_rest_although_its_weight_winds_the_spring_up() -> None:
    machine = with_effects(machine_on("motor"), [{"name": "transmission_compliance", "axis": "Z", "stiffness": 1e9}])
    rest = simulate(machine, Setpoints(np.zeros((200, 1)), 1e-3), sample_period=1e-3).trace
    assert np.ptp(rest.get("Z", "motor_position")) < 1e-9
    assert rest.get("Z", "position")[0] == pytest.approx(-350.0 * 9.81 / 1e9, rel=0.02)
    assert math.isclose(rest.get("Z", "motor_position")[0], 0.0, abs_tol=1e-9)
