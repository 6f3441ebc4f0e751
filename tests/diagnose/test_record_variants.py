"""Every sampling period, subset of signals and length is diagnosed or refused with one line."""

import itertools
from pathlib import Path
import warnings

import numpy as np
import pytest

from twin.diagnose import diagnose
from twin.errors import TwinError
from twin.machine.machine import Machine, load_machine
from twin.recordings.campaign import Campaign, MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.run import simulate
from twin.simulation.setpoints import Setpoints

SIGNALS = ("position", "motor_position", "velocity", "velocity_setpoint", "current")
PERIODS_S = (1e-4, 3e-4, 1e-3, 2e-3, 3.3e-3, 4e-3, 0.01, 0.04, 0.1)


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine().with_axes(["X"])


@pytest.fixture(scope="module")
def recorded(machine: Machine) -> Trace:
    """One axis moves back and forth three times, with noise; one sample per tick."""
    time = np.arange(round(1.2 / machine.base_tick)) * machine.base_tick
    position = 0.02 * np.sin(2.0 * np.pi * 2.5 * time) * np.minimum(time / 0.2, 1.0)
    return simulate(machine, Setpoints(position[:, None], machine.base_tick), noise_seed=3).trace


def sampled(trace: Trace, period: float, signals: tuple[str, ...], samples: int) -> Trace:
    """The record at another period with set point and these signals only; a shortened record is taken from the middle."""
    times = np.arange(0.0, trace.time[-1], period)
    first = max(0, min(len(times) // 3, len(times) - samples))
    times = times[first : first + samples]
    kept = {
        (axis, name): np.interp(times, trace.time, values)
        for (axis, name), values in trace.signals.items()
        if name == "setpoint" or name in signals
    }
    return Trace(times, kept, trace.kinds)


def attempt(machine: Machine, trace: Trace) -> str:
    """The verdict, or the error line. numpy must not warn."""
    campaign = Campaign(Path("any"), machine.name, (MeasuredRun("run", trace, "velocity+torque", 0.0),))
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return diagnose(campaign, machine, quick=True).verdict
        except TwinError as error:
            line = str(error)
            assert line.strip()
            assert "\n" not in line
            return line


def cases() -> list[tuple[float, tuple[str, ...], int]]:
    """Each period with all signals, and random combinations of period, signals and length."""
    rng = np.random.default_rng(5)
    subsets = [s for n in range(len(SIGNALS) + 1) for s in itertools.combinations(SIGNALS, n)]
    lengths = (2, 3, 5, 9, 20, 60, 10_000)
    drawn = [(period, SIGNALS, 10_000) for period in PERIODS_S if period > 5e-4]
    for _ in range(16):
        drawn.append((float(rng.choice(PERIODS_S)), subsets[rng.integers(len(subsets))], int(rng.choice(lengths))))
    return drawn


@pytest.mark.parametrize(("period", "signals", "samples"), cases())
def test_a_record_is_diagnosed_or_refused(machine: Machine, recorded: Trace, period: float, signals: tuple[str, ...], samples: int) -> None:
    trace = sampled(recorded, period, signals, samples)
    said = attempt(machine, trace)
    assert said in ("none", "effect", "unknown") or said.startswith("any")
