"""The verdict of a gap: only what was compared is called good."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
import importlib
from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.campaign_gap import CampaignGap, gap
from twin.simulation.gap import SignalGap
from twin.simulation.recorded_noise import ENOUGH
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints


def test_an_axis_without_a_measured_signal_is_not_called_good() -> None:
    as_noise = SignalGap(0.1, 0.3, 0.1, 0.1, "um", 1.0)
    assert (
        CampaignGap("m", "c", {"r": {"X": {"position": as_noise}, "Y": {}}}).verdict
        == "X as it should be; Y not compared (no measured signal)"
    )


def test_an_effort_that_the_axis_is_not_commanded_is_no_measured_signal(mikron: Machine) -> None:
    time = np.arange(200) * 1e-3
    signals = {("X", "setpoint"): 0.01 * np.sin(time), ("X", "torque"): np.ones(len(time))}
    run = MeasuredRun("run", Trace(time, signals, {"X": "linear"}), "off", 0.0)
    with pytest.raises(InputError, match="no run holds a measured signal"):
        gap(Campaign(Path("c"), "", (run,)), mikron.with_axes(["X"]))
    measured = replace(run, trace=replace(run.trace, signals={**signals, ("X", "position"): 0.99 * signals["X", "setpoint"]}))
    assert gap(Campaign(Path("c"), "", (measured,)), mikron.with_axes(["X"])).rows()


def test_many_short_runs_cost_their_samples(mikron: Machine, monkeypatch: pytest.MonkeyPatch) -> None:
    """What does not depend on the length of a run is done once: models are compiled for the machine, and noise is found in ENOUGH runs of each signal."""
    calls: Counter[str] = Counter()

    def counted(place: str, name: str) -> None:
        module = importlib.import_module(place)
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *given: calls.update([name]) or real(*given))

    counted("twin.simulation.plant_spec", "compiled_spec")
    counted("twin.simulation.recorded_noise", "_variances")
    counted("twin.simulation.gap", "MujocoPlant")
    machine = mikron.with_axes(["X", "Y"])
    runs = []
    for i in range(2 * ENOUGH + 10):
        axis = "Y" if i == 7 else "X"
        way = 1e-4 * np.linspace(0.0, 1.0, 50) ** 3
        trace = simulate(machine, Setpoints(np.column_stack([way * (axis == name) for name in "XY"]), 1e-3), noise_seed=i).trace
        kept = {(a, s): v for (a, s), v in trace.signals.items() if a == axis and s in ("setpoint", "position", "current")}
        runs.append(MeasuredRun(f"r{i}", Trace(trace.time, kept, trace.kinds), None, float(i)))
    calls.clear()
    found = gap(Campaign(Path("c"), "", tuple(runs)), machine)
    assert len(found.runs) == calls["MujocoPlant"] == len(runs)
    assert calls["_variances"] == ENOUGH + 1  # the only run of Y, too
    assert calls["compiled_spec"] <= 2
