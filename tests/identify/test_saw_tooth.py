"""The current between samples: the linear loop is that of the compiled cascade, and the mean follows from the samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.errors import InputError
from twin.identify.between_samples import fast_loop_of, fit_fast_loop, missing_mean, ripples, sawtooth_of, step_responses
from twin.machine.machine import Machine
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


def test_mean_current_of_a_cycle_follows_from_its_samples(mikron: Machine) -> None:
    """X accelerates on its own: samples alone are 5 % low, with the missing part 0.05 %."""
    machine = mikron.with_axes(["X"]).with_feedforward("velocity+torque").with_axis("X", coulomb_friction_nm=0.0)
    t = np.arange(800) * 1e-3
    points = Setpoints((0.5 * 1.0 * np.maximum(t - 0.05, 0.0) ** 2)[:, None] * 0.5, 1e-3)
    trace = simulate(machine, points, sample_period=machine.base_tick).trace
    axis = machine.axis("X")
    n = len(trace.time) // 16 - 1
    current = trace.get("X", "current")
    mean = (0.5 * (current[:-1] + current[1:]))[: 16 * n].reshape(n, 16).mean(axis=1)
    samples = current[: 16 * n : 8].reshape(n, 2).mean(axis=1)
    speed = trace.get("X", "velocity_setpoint")[: 16 * n : 16] / axis.ratio
    torque = trace.get("X", "torque_feedforward")[: 16 * n : 16]
    g, f = missing_mean(fast_loop_of(machine, axis, axis.commissioned_inertia or 0.0), 2)
    found = (
        samples + np.convolve(np.diff(speed, prepend=0.0), g)[: len(speed)] + np.convolve(np.diff(torque, prepend=0.0), f)[: len(torque)]
    )
    settled = slice(150, n - 5)
    assert np.abs(samples[settled] / mean[settled] - 1.0).mean() > 0.04
    assert found[settled] == pytest.approx(mean[settled], rel=2e-3)


def test_step_response_ends_at_the_step(mikron: Machine) -> None:
    loop = fast_loop_of(mikron, mikron.axis("Y"), 0.01)
    (current, speed), _ = step_responses(loop, 400)
    assert speed[-1, -1] == pytest.approx(1.0, abs=1e-6)
    assert current[-1, -1] == pytest.approx(0.0, abs=1e-4)
    # what the current did made the speed: torque constant x mean current = inertia x speed
    assert loop.axis.motor.torque_constant_nm_per_a * current.sum() * loop.tick == pytest.approx(loop.inertia, rel=2e-3)


def test_a_soft_drive_train_tends_to_the_rigid_one(mikron: Machine) -> None:
    rigid = fast_loop_of(mikron, mikron.axis("X"), 0.0086)
    stiff = replace(rigid, load=0.002, mode=2 * np.pi * 1490.0)
    assert missing_mean(stiff, 2)[0] == pytest.approx(missing_mean(rigid, 2)[0], abs=0.03)


@pytest.mark.parametrize("factor", [0.75, 1.3])
def test_inductance_and_load_are_read_off_the_saw_tooth(mikron: Machine, factor: float) -> None:
    rng = np.random.default_rng(0)
    true = replace(fast_loop_of(mikron, mikron.axis("X"), 0.0086), load=0.0018, mode=2 * np.pi * 190.0)
    inductance, resistance = true.winding
    true = true.with_winding(factor * inductance, resistance)
    steps = (np.cumsum(rng.standard_normal(5000)) * 0.05, np.zeros(5000))
    kernels = ripples(true, 2)
    noise = (0.04, 0.0126)
    seen = [np.convolve(steps[0], kernels[q][0])[: len(steps[0])] + noise[q] * rng.standard_normal(5000) for q in (0, 1)]
    start = true.with_winding(inductance, resistance)
    fit = fit_fast_loop(start, 2, sawtooth_of([(np.array(steps), np.array(seen), np.ones(5000, bool))], noise), start)
    assert fit.loop.winding[0] == pytest.approx(true.winding[0], rel=0.02)
    assert missing_mean(fit.loop, 2)[0].sum() == pytest.approx(missing_mean(true, 2)[0].sum(), abs=4.0 * fit.mean_deviation)
    assert fit.misfit == pytest.approx(1.0, abs=0.3)


def test_a_loop_that_cannot_settle_is_refused(mikron: Machine) -> None:
    """Its response grew until numbers overflowed."""
    with pytest.raises(InputError, match="is unstable; correct the machine file"):
        step_responses(fast_loop_of(mikron, mikron.axis("X"), 1e-9))
