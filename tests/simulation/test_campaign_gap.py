"""The verdict of a gap: only what was compared is called good."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin.errors import InputError
from twin.machine.machine import Machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.campaign_gap import CampaignGap, gap
from twin.simulation.gap import SignalGap


def test_an_axis_without_a_measured_signal_is_not_called_good() -> None:
    as_noise = SignalGap(0.1, 0.3, 0.1, "um", 1.0)
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
    measured = replace(run, trace=replace(run.trace, signals={**signals, ("X", "position"): signals["X", "setpoint"]}))
    assert gap(Campaign(Path("c"), "", (measured,)), mikron.with_axes(["X"])).rows()
