"""The twin against runs recorded on a nominal machine (an independent simulation), on every run and axis."""

from pathlib import Path

import pytest

from twin.machine.machine import Machine
from twin.recordings.campaign import read_campaign
from twin.simulation.campaign_gap import gap
from twin.simulation.gap import SignalGap

POSITION_RMS = {"um": 0.2, "arcsec": 0.5}
POSITION_MAX = 2.0  # um or arcsec
CURRENT_RMS = 0.08  # A, where the axis moves; 0.04 A of it is noise
NOISE_FACTOR = 1.2
"""The gap equals that of measuring noise alone, within the scatter of an RMS over a few realisations."""


@pytest.fixture(scope="module")
def gaps(nominal_campaign: Path, mikron: Machine) -> dict[str, dict[str, dict[str, SignalGap]]]:
    return gap(read_campaign(nominal_campaign, mikron), mikron).runs


def test_every_run_and_axis_is_compared(gaps: dict[str, dict[str, dict[str, SignalGap]]]) -> None:
    assert len(gaps) == 10
    for axes in gaps.values():
        assert list(axes) == ["X", "Y", "Z", "A", "C"]
        for signals in axes.values():
            assert list(signals) == ["position", "motor_position", "velocity", "current"]


def test_positions_and_currents_agree(gaps: dict[str, dict[str, dict[str, SignalGap]]]) -> None:
    for run, axes in gaps.items():
        for axis, signals in axes.items():
            where = f"{run} {axis}"
            for signal in ("position", "motor_position"):
                gap = signals[signal]
                assert gap.rms <= POSITION_RMS[gap.unit], where
                assert gap.max <= POSITION_MAX, where
            assert signals["current"].rms <= CURRENT_RMS, where


def test_the_gap_is_noise_only(gaps: dict[str, dict[str, dict[str, SignalGap]]]) -> None:
    for run, axes in gaps.items():
        for axis, signals in axes.items():
            for signal in ("position", "velocity"):
                gap = signals[signal]
                assert gap.rms <= NOISE_FACTOR * gap.noise, f"{run} {axis} {signal}: {gap}"
