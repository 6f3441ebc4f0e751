"""The jitter of a scale is sized from the scatter of single samples; other scatter is no jitter."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.diagnose.law.test_closed_loop import laws_beside
from twin.diagnose.corrected import fitted_without
from twin.diagnose.law.jitter import jitter_of
from twin.diagnose.law.residual import Samples
from twin.diagnose.law.wording import sentence
from twin.diagnose.observe import observe
from twin.diagnose.view import view_of
from twin.effects import with_effects
from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import load_machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.decoupled_plant import DecoupledPlant
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

X = load_machine().with_axes(["X"])
TAU = 40e-6
JITTER = {
    "name": "law", "axis": "X", "block": "measurement", "output": "displacement", "variables": ["speed"], "formula": "jitter",
    "deviation_s": TAU,
}  # fmt: skip
RUNS, COUNT = 4, 700
NOISE = 0.06e-6


def samples_of(errors_of, seed: int = 1) -> Samples:
    """Displacements of strokes; `errors_of` gives the errors from speed, position and random numbers."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(RUNS), COUNT)
    t = 4e-3 * np.tile(np.arange(COUNT), RUNS)
    speed = 0.25 / (1 + run) * np.sin(2.0 * t + run)
    position = 4e-3 * np.cumsum(speed)
    y = errors_of(speed, position, rng) + 20e-6 * position / 0.1 + rng.normal(0.0, NOISE, len(run))
    return Samples("X", "transmission", y, NOISE, run, run, COUNT * run, {"velocity": speed, "position": position})


def lasting(rng, count: int) -> np.ndarray:
    """Normally distributed errors of variance 1, each of which lasts about three samples."""
    return np.convolve(rng.standard_normal(count + 2), np.ones(3) / np.sqrt(3.0), "valid")


def test_a_planted_jitter_is_sized():
    found = jitter_of(samples_of(lambda v, q, rng: TAU * v * rng.standard_normal(len(v))))
    assert found.numbers["deviation_s"] == pytest.approx(TAU, rel=0.05)
    assert found.predicts > 0.98


@pytest.mark.parametrize(
    "errors_of",
    [
        lambda v, q, rng: 0.0 * v,
        lambda v, q, rng: 1.2e-6 * np.sin(2.0 * np.pi * q / 20e-6),
        lambda v, q, rng: 3e-6 * rng.standard_normal(len(v)),
        lambda v, q, rng: TAU * v,
        lambda v, q, rng: 40e-6 * np.abs(v) ** 0.5 * rng.standard_normal(len(v)),
        lambda v, q, rng: TAU * v * rng.choice([-1.0, 1.0], len(v)),
        lambda v, q, rng: 5e-6 * np.sign(v),
        lambda v, q, rng: TAU * v * lasting(rng, len(v)),
    ],
    ids=["noise", "fine wave", "constant scatter", "latency", "root of speed", "two values", "backlash", "lasts several samples"],
)
def test_other_errors_are_no_jitter(errors_of):
    assert jitter_of(samples_of(errors_of)) is None


def test_noise_is_no_jitter_whatever_its_random_numbers():
    assert not [seed for seed in range(100) if jitter_of(samples_of(lambda v, q, rng: 0.0 * v, seed))]


@pytest.mark.parametrize("step", [1e-6, 5e-6, 2e-5])
def test_the_jitter_of_a_coarse_encoder_is_sized_or_not_named(step):
    """Where the axis is slow most readings are equal, so that nothing scatters there."""
    fine = samples_of(lambda v, q, rng: TAU * v * rng.standard_normal(len(v)))
    found = jitter_of(replace(fine, y=np.round(fine.y / step) * step))
    assert found is None or found.numbers["deviation_s"] == pytest.approx(TAU, rel=0.2)


def points(distance: float = 0.03, speed: float = 0.06) -> Setpoints:
    return Setpoints(moves_in_turn(0.0, [distance, -distance], speed, 0.3, 5.0, 0.1, 1e-3)[1][:, None], 1e-3)


def test_the_loop_scatters_the_scale_in_proportion_to_the_speed():
    simulated = simulate(with_effects(X, [JITTER]), points(), noise_seed=0)
    apart = simulated.without_noise.get("X", "position") - simulated.without_noise.get("X", "motor_position")
    speed = np.abs(simulated.trace.get("X", "velocity"))
    for low, high in ((0.02, 0.03), (0.05, 0.07)):
        rows = (speed > low) & (speed < high)
        u = apart[rows] / speed[rows]
        assert np.std(u) == pytest.approx(TAU, rel=0.15)
        assert abs(np.mean(u)) < 4.0 * TAU / np.sqrt(rows.sum())
    assert np.std(apart[speed < 1e-4]) < 0.02e-6


@pytest.mark.parametrize("seed", [None, 0])
def test_an_ideal_sensor_jitters_too(seed):
    """Without noise, or with noise of zero size, the jitter is a fixed normal sequence, not a constant."""
    ideal = X.with_values({"measurement.linear_scale_noise_m": 0.0})
    simulated = simulate(with_effects(ideal, [JITTER]), points(), noise_seed=seed)
    apart = simulated.without_noise.get("X", "position") - simulated.without_noise.get("X", "motor_position")
    rows = np.abs(simulated.trace.get("X", "velocity")) > 0.05
    u = apart[rows] / np.abs(simulated.without_noise.get("X", "velocity")[rows])
    assert np.std(u) == pytest.approx(TAU, rel=0.15)
    assert abs(np.mean(u)) < 4.0 * TAU / np.sqrt(rows.sum())


def test_the_jitter_follows_the_seed_of_the_noise_in_both_plants():
    """The diagnosis adds differences of the decoupled plant to a simulation in MuJoCo; both must draw the same jitter."""
    machine = with_effects(X, [JITTER])
    first = simulate(machine, points(), noise_seed=0)
    motion = view_of(X, MeasuredRun("run", first.trace, None, 0.0)).motion
    decoupled = simulate(machine, points(), noise_seed=0, plant_of=lambda change: DecoupledPlant(change, motion))
    other = simulate(machine, points(), noise_seed=1)
    a, b, c = (s.without_noise.get("X", "position") for s in (first, decoupled, other))
    assert np.std(a - b) < 0.05 * np.std(a - c)


def test_a_machine_with_jitter_gets_the_law():
    runs = [
        MeasuredRun(
            f"run{k}", simulate(with_effects(X, [JITTER]), points(d, v), sample_period=1e-3, noise_seed=k).trace, "velocity+torque", 0.0
        )
        for k, (d, v) in enumerate([(0.02, 0.03), (0.03, 0.06), (0.04, 0.08), (0.03, 0.05)])
    ]
    laws = laws_beside([], observe([view_of(X, run) for run in runs], ("X",)))
    (law,) = laws.laws
    assert law.setting.parameters["deviation_s"] == pytest.approx(TAU, rel=0.1)
    assert all(len(m.effects) == 1 for m in (laws.corrected, fitted_without(X, laws.states, [0])))
    assert "too early or too late" in sentence(law, SimpleNamespace(axis=X.axis))


def test_ideal_sensors_of_two_axes_jitter_independently():
    machine = load_machine().with_axes(["X", "Y"]).with_values({"measurement.linear_scale_noise_m": 0.0})
    both = with_effects(machine, [JITTER, {**JITTER, "axis": "Y"}])
    way = points().position
    trace = simulate(both, Setpoints(np.hstack([way, way]), points().period)).without_noise
    apart = [trace.get(axis, "position") - trace.get(axis, "motor_position") for axis in "XY"]
    rows = np.abs(trace.get("X", "velocity")) > 0.05
    x, y = (a[rows] / np.std(a[rows]) for a in apart)
    assert max(abs(float(np.mean(x[k:] * y[: len(y) - k]))) for k in range(3)) < 5.0 / np.sqrt(rows.sum())
