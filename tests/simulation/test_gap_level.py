"""The level of a gap: one number for the same gap, whatever else was recorded."""

from dataclasses import replace

import numpy as np
import pytest

from twin.geometry.scurve import moves_in_turn
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun
from twin.simulation.gap import SignalGap, gap_of, predict
from twin.simulation.gap_level import levels, overall, signal_levels
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


def test_a_signal_that_is_not_compared_does_not_count(mikron: Machine) -> None:
    """The current of a resting axis is not compared; whether it was recorded does not change the level of the axis."""
    machine = mikron.with_axes(["X", "Y"])
    way = moves_in_turn(0.0, [0.03, -0.03], 0.1, 1.0, 20.0, 0.1, 1e-3)[1]
    trace = simulate(machine, Setpoints(np.column_stack([way, 0.0 * way]), 1e-3), sample_period=1e-3, noise_seed=1).trace
    run = MeasuredRun("run", trace, None, 0.0)
    prediction = predict(machine, run, realisations=2)
    few = replace(run, trace=replace(trace, signals={k: v for k, v in trace.signals.items() if k != ("Y", "current")}))
    every, without = ({"run": gap_of(machine, of, prediction)} for of in (run, few))
    assert levels(every) == levels(without)
    assert 0.5 < levels(every)["Y"] < 1.5
    assert ("X", "current") in signal_levels(every)


def test_the_level_is_a_root_mean_square_over_runs_signals_and_axes() -> None:
    def gap(moving: float) -> SignalGap:
        return SignalGap(1.0, 1.0, 0.1, 0.1, "um", moving)

    gaps = {"a": {"X": {"position": gap(3.0), "current": gap(4.0)}}, "b": {"X": {"position": gap(5.0)}, "Y": {"position": gap(1.0)}}}
    assert levels(gaps) == {"X": pytest.approx((50.0 / 3.0) ** 0.5), "Y": 1.0}
    assert overall(levels(gaps)) == pytest.approx(((50.0 / 3.0 + 1.0) / 2.0) ** 0.5)
    assert overall({}) == 1.0
