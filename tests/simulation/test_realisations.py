"""Noise realisations of a run: one by MuJoCo, the differences of the others by the decoupled plant."""

from __future__ import annotations

import numpy as np
import pytest

from tests.conftest import swings
from twin.diagnose.view import view_of
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import predict
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


@pytest.fixture(scope="module")
def measured(mikron: Machine) -> MeasuredRun:
    return MeasuredRun("swings", simulate(mikron, swings(mikron, 1.0), noise_seed=7).trace, None, 0.0)


def furthest(a: Trace, b: Trace, axis: str, signal: str) -> float:
    return float(np.abs(a.get(axis, signal) - b.get(axis, signal)).max())


@pytest.mark.parametrize("axis", ["X", "A", "C"])
def test_the_decoupled_plant_replaces_further_realisations(mikron: Machine, measured: MeasuredRun, axis: str) -> None:
    """The mean agrees with that of all realisations in MuJoCo, many times better than a single one does, and the noise has the same size."""
    traces = [simulate(mikron, view_of(mikron, measured).setpoints, noise_seed=i).without_noise for i in range(4)]
    one, told = predict(mikron, measured, 1), predict(mikron, measured, 4)
    for signal in ("position", "velocity", "current"):
        by_engine = np.stack([trace.get(axis, signal) for trace in traces])
        away, off = (float(np.abs(p.trace.get(axis, signal) - by_engine.mean(axis=0)).max()) for p in (one, told))
        assert off < 0.02 * away, signal
        expected = np.sqrt(np.mean(by_engine.var(axis=0, ddof=1)) * 4 / 3)
        assert np.sqrt(np.mean(told.scatter[axis, signal] ** 2)) == pytest.approx(expected, rel=0.01), signal


def test_without_the_engine_the_decoupled_plant_simulates_all(mikron: Machine, measured: MeasuredRun) -> None:
    """A mass that only MuJoCo has changes the first prediction and not the second."""
    view = view_of(mikron, measured)
    light = mikron.with_axis("X", moving_mass_kg=0.9 * (mikron.axis("X").moving_mass_kg or 0.0))
    of_light = view_of(light, measured).motion
    alone = predict(mikron, measured, 2, motion=view.motion, engine=False)
    beside = predict(mikron, measured, 2, motion=view.motion)
    assert 0.0 < furthest(alone.trace, beside.trace, "X", "position") < 1e-8
    lighter = predict(light, measured, 2, motion=of_light, engine=False)
    assert furthest(lighter.trace, alone.trace, "X", "position") > 1e-7


def test_the_motion_of_rotary_axes_is_that_of_the_engine(mikron: Machine, measured: MeasuredRun) -> None:
    """The first guess, the delayed set points, is hundreds of times less accurate."""
    view = view_of(mikron, measured)
    engine = simulate(mikron, view.setpoints, sample_period=measured.trace.period).trace
    for axis in ("A", "C"):
        told = view.motion.position[:, mikron.axis_names.index(axis)]
        guess = delayed(view.setpoints, mikron, axis)
        off, guessed = (float(np.abs(q - engine.get(axis, "position")).max()) for q in (told, guess))
        assert off < 5e-3 * guessed


def delayed(setpoints: Setpoints, machine: Machine, axis: str) -> np.ndarray:
    a, loops = machine.axis_names.index(axis), machine.axis(axis).loops
    lag = loops.position_delay_s + (1.0 - min(loops.velocity_feedforward, 1.0)) / loops.position_gain_per_s
    return setpoints.at(np.arange(len(setpoints.position)) * setpoints.period - lag)[:, a]
