"""A planted law is identified in the residual of a block: variable, formula and parameters; noise has no law."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twin.diagnose.law.known_physics import known_causes
from twin.diagnose.law.measure import excess, measured_laws
from twin.diagnose.law.proposals import STRONG
from twin.diagnose.law.relations import position_in_play, remembered_direction
from twin.diagnose.law.residual import Samples
from twin.diagnose.law.shapes import described
from twin.machine.machine import load_machine

X = load_machine().axis("X")
SIGMA = 10.0
PERIOD = 5e-3
RUNS, COUNT = 5, 400


def motion(seed: int = 1) -> dict[str, np.ndarray]:
    """Runs of strokes of different speed and position, with the variables derived from them."""
    rng = np.random.default_rng(seed)
    columns: dict[str, list[np.ndarray]] = {}
    for run in range(RUNS):
        t = PERIOD * np.arange(COUNT)
        speed, rate = 0.3 * 10 ** (-0.35 * run), rng.uniform(1.0, 6.0)
        v = speed * np.sin(rate * t + rng.uniform(0, 6)) + 0.2 * speed * np.sin(2.7 * rate * t)
        q = np.cumsum(v) * PERIOD + rng.uniform(-0.1, 0.1)
        of = {
            "position": q,
            "velocity": v,
            "acceleration": np.gradient(v, PERIOD),
            "turn": q / X.ratio,
            "time": 30.0 * run + t,
            "travel": np.cumsum(np.abs(v)) * PERIOD,
            "motor_position": q,
            "current": 40.0 * np.gradient(v, PERIOD) + rng.normal(0, 1.0, COUNT),
        }
        for name, values in of.items():
            columns.setdefault(name, []).append(values)
    return {name: np.concatenate(values) for name, values in columns.items()}


def samples_of(y: np.ndarray, m: dict[str, np.ndarray], block: str = "mechanics", sigma: float = SIGMA) -> Samples:
    """The residual with noise and some outliers like break-aways."""
    rng = np.random.default_rng(7)
    run = np.repeat(np.arange(RUNS), COUNT)
    noisy = y + rng.normal(0.0, sigma, len(y))
    noisy[rng.integers(0, len(y), 15)] += 40.0 * sigma
    return Samples("X", block, noisy, sigma, run, run, COUNT * run, m)


M = motion()
V, Q = M["velocity"], M["position"]
FIRST = COUNT * np.repeat(np.arange(RUNS), COUNT)
PLANTED = {
    "friction lower at low speed": (
        "friction", "speed", "gaussian", {"height": -200.0, "width": 0.01},
        200.0 * np.exp(-((V / 0.01) ** 2)) * np.sign(V),
    ),
    "drag by the square of speed": ("friction", "speed", "power", {"n": 2.0}, -3000.0 * V * np.abs(V)),
    "friction that warms away": ("friction", "time", "approach", {"height": -150.0, "scale": 60.0},
        150.0 * (1 - np.exp(-M["time"] / 60.0)) * np.sign(V)),
    "a cable chain": ("force", "direction", "line", {"height": -120.0, "length": 4e-3},
        -120.0 * remembered_direction(samples_of(V, M), 4e-3)),
    "cogging": ("force", "turn", "sine", {"amplitude": 60.0, "period": 2 * math.pi / 4}, 60.0 * np.sin(4 * M["turn"] + 0.4)),
    "a wave over the travel": ("force", "position", "sine", {"amplitude": 60.0, "period": 0.0173}, 60.0 * np.sin(2 * math.pi * Q / 0.0173)),
}  # fmt: skip


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_law_is_found(name: str):
    output, variable, shape, numbers, force = PLANTED[name]
    # in addition to errors of the machine file
    samples = samples_of(force + 12.0 + 25.0 * np.sign(V) + 90.0 * V, M)
    curves = measured_laws(samples, X)
    best = max((described(samples, c, X) for c in curves[:3]), key=lambda d: d.predicts)
    assert (best.relation.output, best.relation.variable, best.shape) == (output, variable, shape)
    for key, value in numbers.items():
        assert best.numbers[key] == pytest.approx(value, rel=0.1), key
    assert excess(samples) > 2.0


def test_noise_has_no_law():
    samples = samples_of(12.0 + 25.0 * np.sign(V) + 90.0 * V, M)
    assert all(c.predicts < STRONG.predicts for c in measured_laws(samples, X))


def test_a_law_in_a_single_run_predicts_nothing():
    force = np.where(FIRST == COUNT, 300.0 * np.exp(-((V / 0.01) ** 2)) * np.sign(V), 0.0)
    flipped = np.where(FIRST == 2 * COUNT, -300.0 * np.exp(-((V / 0.01) ** 2)) * np.sign(V), 0.0)
    curves = measured_laws(samples_of(force + flipped, M), X)
    assert all(c.predicts < STRONG.predicts for c in curves if c.relation.variable == "speed")


def test_a_play_of_the_scale_is_a_slack():
    half = 5e-6
    y = half * position_in_play(samples_of(V, M), half)  # motor minus scale
    samples = samples_of(y, M, "transmission", 5e-8)
    curve = measured_laws(samples, X)[0]
    best = described(samples, curve, X)
    assert (best.relation.block, best.relation.variable) == ("measurement", "slack")
    assert best.numbers["length"] == pytest.approx(half, rel=0.1)
    assert best.numbers["height"] == pytest.approx(-half, rel=0.1)


def test_noise_at_rest_does_not_move_the_load_through_a_play():
    """The load moves by 1 mm, then rests for a long time with 0.2 um of noise; the play is 10 um wide."""
    half, rest = 5e-6, 100 * COUNT
    position = np.concatenate([np.linspace(0.0, 1e-3, COUNT), np.full(rest, 1e-3)])
    position += np.random.default_rng(3).normal(0.0, 0.2e-6, len(position))
    zero = np.zeros(len(position), int)
    z = position_in_play(Samples("X", "transmission", position, SIGMA, zero, zero, zero, {"motor_position": position}), half)
    assert z[0] == 0.0
    assert np.all(z[COUNT:] > 0.6)


def test_a_curve_that_no_formula_describes_stays_a_table():
    force = 80.0 * np.interp((Q - Q.min()) / np.ptp(Q), np.linspace(0, 1, 6), [0.0, 1.0, 1.0, -1.0, 0.0, 0.0])
    samples = samples_of(force, M)
    curve = next(c for c in measured_laws(samples, X) if c.relation.variable == "position" and not c.relation.period)
    found = described(samples, curve, X)
    assert found.shape is None
    x, y = np.array(found.points).T
    low, high = np.quantile(Q, [0.05, 0.95])
    inside = (low < Q) & (high > Q)
    assert np.corrcoef(np.interp(Q[inside], x, y), force[inside])[0, 1] > 0.95


def test_a_sine_over_the_turn_is_a_harmonic_of_it():
    samples = samples_of(80.0 * np.sin(2.0 * M["turn"] + 0.4), {**M, "turn": np.mod(M["turn"], 2.0 * math.pi)})
    curve = next(c for c in measured_laws(samples, X) if c.relation.variable == "turn")
    assert described(samples, curve, X).numbers["period"] == math.pi


def test_known_causes_match_laws():
    assert [k.name for k in known_causes("friction", "speed", "gaussian", -1)] == ["slide way with plastic lining"]
    assert [k.name for k in known_causes("force", "direction", "line", -1)] == ["cable chain"]
    assert known_causes("torque", "current", "bending", 0)[0].name == "magnetic saturation"
