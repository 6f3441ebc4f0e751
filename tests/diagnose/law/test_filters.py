"""A filter of a control block is identified by its frequency response; noise and a pure gain are not filters."""

from __future__ import annotations

import numpy as np
import pytest

from twin.diagnose.law.filters import filters_of
from twin.diagnose.law.proposals import STRONG
from twin.diagnose.law.residual import ControllerRun, Samples
from twin.effects.law import Law, cycle_of
from twin.effects.law_filters import RING, filter_row, filtered
from twin.effects.law_shapes import SHAPES
from twin.machine.machine import load_machine

MACHINE = load_machine()
PERIOD, COUNT, NOISE = 1e-3, 3000, 0.02
VARIABLE = {"speed controller": ("current", "current_setpoint"), "position controller": ("speed", "speed_setpoint")}


def passed_by(block: str, name: str | None, numbers: dict[str, float], gain: float = 1.0) -> Samples:
    """Three runs of a block with a filter at its output, recorded at 1 kHz with noise."""
    rng = np.random.default_rng(3)
    variable = VARIABLE[block]
    cycle = cycle_of(Law(block, *variable, SHAPES["lag"]), MACHINE)
    period = max(PERIOD, cycle)
    steps, every = round(period / MACHINE.base_tick), round(cycle / MACHINE.base_tick)
    runs = []
    for _ in range(3):
        wanted = rng.normal(size=COUNT * steps)
        for _ in range(2):
            wanted = np.convolve(wanted, np.ones(2 * steps) / np.sqrt(2 * steps), "same")
        given = wanted
        if name is not None:
            shape = SHAPES[name]
            row, state = np.array(filter_row(shape, numbers, cycle)), np.zeros(RING + 1)
            given = np.repeat([filtered(shape.code, u, row, state, i == 0) for i, u in enumerate(wanted[::every])], every)
        runs.append(ControllerRun(variable[0], wanted[::steps], gain * given[::steps] + rng.normal(0.0, NOISE, COUNT), NOISE, period))
    nothing = np.zeros(3)
    return Samples("X", block, nothing, NOISE, nothing, nothing, nothing.astype(int), {}, {}, tuple(runs))


@pytest.mark.parametrize(("block", "name", "numbers"), [
    ("speed controller", "notch", {"width": 0.8, "frequency_hz": 120.0}),
    ("speed controller", "dead time", {"time_s": 0.002}),
    ("position controller", "lag", {"time_constant_s": 0.005}),
])  # fmt: skip
def test_a_filter_is_recognised_beside_a_gain(block: str, name: str, numbers: dict[str, float]):
    best = filters_of(passed_by(block, name, numbers, gain=1.04), MACHINE)[0]
    assert (best.relation.block, best.shape) == (block, name)
    assert best.predicts > 0.8
    for key, value in numbers.items():
        assert best.numbers[key] == pytest.approx(value, rel=0.03), key


def test_a_gain_is_not_recognised_as_a_filter():
    assert all(f.predicts < STRONG.predicts for f in filters_of(passed_by("speed controller", None, {}, gain=1.1), MACHINE))


def test_a_block_that_passes_nothing_on_has_no_filter():
    nothing = np.zeros(3)
    samples = Samples("X", "mechanics", nothing, 1.0, nothing, nothing, nothing.astype(int), {})
    assert filters_of(samples, MACHINE) == []
