"""A record with few digits: its step is found, and counts as noise of its channels."""

from __future__ import annotations

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np
import pytest

from tests.diagnose.test_encoder_zeros import YZ, recorded
from twin.diagnose.control_law import law_sigma
from twin.diagnose.observe import observe
from twin.diagnose.view import view_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.roughness import step_of
from twin.recordings.trace import Trace

STEP_M = 20e-6


def rounded(values: np.ndarray, step: float) -> np.ndarray:
    return np.round(values / step) * step


@pytest.mark.parametrize("step", [1e-6, 0.5, 3e-9])
def test_the_step_of_rounded_values_is_found(step: float) -> None:
    rng = np.random.default_rng(0)
    values = rounded(1000.0 * step * rng.standard_normal(500) + 0.3 * step, step)
    assert step_of(values) == pytest.approx(step, rel=1e-6)
    assert step_of(57.3 * values) == pytest.approx(57.3 * step, rel=1e-6)  # another unit


def test_the_step_of_counts_that_are_printed_with_few_digits_is_found() -> None:
    """Regression: 10 000 counts a turn in radians with six decimals. One count is printed as 0.000628 rad, so 50 of them are off its grid; the gain of a
    servo axis was `tried` as 143 1/s, where its law gives 199.998 +- 0.005 (true 200)."""
    count = 2.0 * math.pi / 10_000
    time = np.arange(10_000) * 1e-3
    values = np.round(rounded(60.0 * (1.0 - np.cos(0.2 * np.pi * time)), count), 6)
    assert step_of(values) == pytest.approx(count, rel=1e-6)


def test_the_step_of_counts_of_some_hundred_printed_digits_is_found() -> None:
    """Regression: a count of 143.24e-6 deg, printed to 1e-6 deg, is 143 or 144 of them. Multiplied by 16, the first is off the grid of the count."""
    count = math.degrees(2.5e-6)
    noise = np.random.default_rng(3).standard_normal(10_000)
    time = np.arange(10_000) * 1e-3
    values = np.radians(np.round(rounded(150.0 * (1.0 - np.cos(0.4 * np.pi * time)) + count * noise, count), 6))
    assert step_of(values) == pytest.approx(math.radians(count), rel=1e-6)


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(1).standard_normal(500),
        np.zeros(10),
        np.arange(3.0),
        np.zeros(0),
        np.array([0.0, 1.0, 2.0, 2.0 + 2.0**0.5, 4.0]),
    ],
)
def test_values_off_any_grid_have_no_step(values: np.ndarray) -> None:
    assert step_of(values) == 0.0


@pytest.mark.parametrize(("digits", "rest_s"), [(6, 5.0), (9, 1.0)])
def test_the_step_of_smooth_strokes_with_rests_is_found(digits: int, rest_s: float) -> None:
    """Hardly a sample in ten is within a rounded acceleration, and of nine digits no two values are one step apart."""
    time = np.arange(1000) * 1e-3
    stroke = 0.02 * (time - np.sin(2.0 * np.pi * time) / (2.0 * np.pi))
    values = np.round(np.concatenate([stroke, np.full(int(rest_s * 1e3), 0.02), 0.02 - stroke]), digits)
    assert step_of(values) == pytest.approx(10.0**-digits, rel=1e-6)


def test_a_move_of_constant_jerk_is_no_grid() -> None:
    """Its unrounded positions are multiples of 1e-9 m, a sixth of the jerk times the cube of the cycle."""
    count = np.arange(200.0)
    values = 1e-9 * np.concatenate([np.zeros(100), count**3, 200.0**3 + 3.0 * 200.0**2 * count])
    assert step_of(values) == 0.0


@pytest.mark.parametrize("noise", [0.0, 1e-8])
def test_a_ramp_is_no_grid(noise: float) -> None:
    """At constant speed the values are evenly spaced, here by 30 um, with a rest before it."""
    ramp = 3e-5 * np.concatenate([np.zeros(50), np.arange(500.0)])
    assert step_of(ramp + noise * np.random.default_rng(2).standard_normal(len(ramp))) == 0.0


def with_rounded(run: MeasuredRun, signal: str) -> MeasuredRun:
    key = ("Y", signal)
    return replace(run, trace=replace(run.trace, signals={**run.trace.signals, key: rounded(run.trace.signals[key], STEP_M)}))


@pytest.mark.parametrize(("signal", "channel"), [("motor_position", "motor_minus_scale"), ("position", "position")])
def test_few_digits_of_an_encoder_are_noise(signal: str, channel: str) -> None:
    run = recorded(YZ, "Y", "run")

    def level(of: MeasuredRun) -> float:
        return float(np.median(next(c for c in observe([view_of(YZ, of)], ("Y",)).channels if c.name == channel).sigma))

    assert level(with_rounded(run, signal)) == pytest.approx(STEP_M / np.sqrt(12.0), rel=0.3)
    assert level(run) < 0.1 * STEP_M / np.sqrt(12.0)


def test_the_rounding_of_set_points_is_noise_of_the_control_law(mikron: Machine) -> None:
    """A feedforward differentiates it: 0.1 um at 1 kHz are 20 um/s, which hid all else behind a position controller at fault."""
    t = np.arange(4000) * 1e-3
    path = 0.05 * np.sin(2.0 * t)
    trace = Trace(t, {("X", "setpoint"): rounded(path, 1e-7), ("X", "velocity_setpoint"): 0.1 * np.cos(2.0 * t)}, {"X": "linear"})
    axis, tp = mikron.axis("X"), mikron.position_cycle
    made = axis.loops.velocity_feedforward * np.diff(rounded(path, 1e-7) - path) / tp
    assert np.std(made) > 1e-6
    assert law_sigma(SimpleNamespace(machine=mikron, trace=trace), axis) == pytest.approx(np.std(made), rel=0.2)  # type: ignore[arg-type]
