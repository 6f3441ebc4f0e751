"""A simulated trace at the sample times of a record, which may start at any time and have a period that is no whole number of ticks."""

from dataclasses import replace

import numpy as np

from twin.machine.machine import Machine
from twin.recordings.ballbar import FINEST, Ballbar
from twin.recordings.trace import Trace

SAME_PERIOD = 1e-4
"""Relative tolerance of the sample period, for rounded times in a record."""

SAME_TIME = 0.01
"""Largest time between simultaneous last samples of a record and its simulation, as a fraction of the period."""


def simulated_period(machine: Machine, period: float, ballbar: Ballbar | None = None) -> float:
    """Sample period [s] of the simulation of a record with this `period`: the same, or one tick if the period is not a whole number of ticks;
    for a ballbar, FINEST, or `period` if it is shorter."""
    if ballbar is not None:
        return min(simulated_period(machine, FINEST), period)
    ticks = period / machine.base_tick
    return period if round(ticks) >= 1 and abs(ticks / round(ticks) - 1.0) < SAME_PERIOD else machine.base_tick


def at_times(trace: Trace, times: np.ndarray) -> Trace:
    """A simulated trace, which starts at 0, at the times (sample,) [s] of a record, which may start at any time."""
    count = len(times)
    if len(trace.time) >= count and abs(trace.time[count - 1] - (times[-1] - times[0])) < SAME_TIME * trace.period:
        return replace(trace.samples(slice(count)), time=times)
    return replace(trace, time=times, signals={key: np.interp(times - times[0], trace.time, v) for key, v in trace.signals.items()})


def as_recorded(trace: Trace, times: np.ndarray, ballbar: Ballbar | None, noise_seed: int | None = None) -> Trace:
    """A simulated trace at the times (sample,) [s] of a record, with the positions measured by a ballbar, if there is one; `noise_seed` adds
    the noise of the ballbar."""
    at = at_times(trace, times)
    if ballbar is None:
        return at
    deviation = ballbar.deviation(trace)
    if noise_seed is not None:
        deviation += np.random.default_rng(noise_seed).normal(0.0, ballbar.noise, len(deviation))
    return replace(at, signals={**at.signals, **ballbar.positions(deviation)})
