"""Motor encoder and scale whose zeros differ: a constant in each run, which is no gap and no fault.

The difference d of motor encoder and scale has the mean m_k and the standard deviation w_k in run k. Where the encoders clearly have no
common zero, the runs lose it before anything is compared (`with_common_zeros`): it exceeds noise in some run, is constant within each run
(w_k small compared with the largest |m|), and does not follow time or position from run to run, as thermal growth of the screw or a lead
error does: m_k = a + b t_k + c x_k explains little more than the mean.

Whatever constant a prediction then leaves is a difference of zeros too, except its trend over the start times (`aligned`). A lead error
that starts anew at zero in each run differs by a constant from one that keeps its zero, which follows the place where the axis starts: only
a trend that this place does not explain is growth.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from twin.estimate.regression import solved
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import encoders_noise
from twin.simulation.motor_and_scale import has_both, motor_minus_scale, shifted
from twin.units import AXIS_UNITS

LEAST = 20.0
"""Smallest constant, in multiples of the noise of the two encoders, that is clearly a difference of zeros."""

CONSTANT = 0.25
"""Largest standard deviation within a run, over the largest difference, of a constant."""

BY_TREND = 0.9
"""Share of the variance between runs that time and position must explain for an effect (drift, lead error)."""

TREND = 3
"""Numbers of a trend of the zeros: constant, place of the start, time. Of no more runs than these, a trend may be zeros that differ."""

TREND_RUNS = TREND + 2
"""Runs needed to test a trend over time and place."""

Zeros = Mapping[tuple[str, int], float]
"""Difference of the encoders' zeros by axis and run [m or rad]."""


def with_common_zeros(runs: Sequence[MeasuredRun], machine: Machine) -> tuple[tuple[MeasuredRun, ...], dict[str, float]]:
    """The runs without clear differences of zeros, and the largest difference of each axis that has one [m or rad]."""
    largest: dict[str, float] = {}
    for axis in machine.axes:
        runs_of_axis = [k for k, run in enumerate(runs) if has_both(run.trace, axis.name)]
        apart = {k: motor_minus_scale(runs[k].trace, axis.name) for k in runs_of_axis}
        offsets = {k: (float(np.mean(values)), float(np.std(values))) for k, values in apart.items()}
        if offsets and _is_of_zeros([runs[k] for k in runs_of_axis], list(offsets.values()), axis, machine):
            largest[axis.name] = max((mean for mean, _ in offsets.values()), key=abs)
            runs = [
                replace(run, trace=shifted(run.trace, axis, offsets[k][0]), own_zeros=run.own_zeros | {axis.name}) if k in offsets else run
                for k, run in enumerate(runs)
            ]
    return tuple(runs), largest


def aligned(runs: Sequence[MeasuredRun], machine: Machine, predicted: Mapping[str, Trace]) -> tuple[MeasuredRun, ...]:
    """The runs without the differences of zeros that their predictions leave."""
    for (name, k), offset in zeros_left(runs, machine, predicted).items():
        runs = [replace(run, trace=shifted(run.trace, machine.axis(name), offset)) if i == k else run for i, run in enumerate(runs)]
    return tuple(runs)


def zeros_left(runs: Sequence[MeasuredRun], machine: Machine, predicted: Mapping[str, Trace]) -> dict[tuple[str, int], float]:
    """Constants (axis, run) [m or rad] that predictions leave between the two encoders of each axis.

    Where a linear axis moves, a trend over the start times of its runs is growth of its screw, not a zero. In the other runs the whole
    constant counts: it depends on where the axis stuck.
    """
    zeros: dict[tuple[str, int], float] = {}
    for axis in machine.axes:
        apart = {
            k: motor_minus_scale(run.trace, axis.name) - motor_minus_scale(predicted[run.name], axis.name)
            for k, run in enumerate(runs)
            if has_both(run.trace, axis.name)
        }
        means = {k: float(np.median(values)) for k, values in apart.items()}  # an axis may stick elsewhere after a motion
        moving = [k for k in means if runs[k].trace.moves(axis.name)]
        when = growth_times([runs[k] for k in moving], axis)
        slope = float(when @ [means[k] for k in moving]) / max(float(when @ when), 1e-30)
        means |= {k: means[k] - slope * float(t) for k, t in zip(moving, when)}
        zeros |= {(axis.name, k): mean for k, mean in means.items()}
    return zeros


def growth_times(runs: Sequence[MeasuredRun], axis: Axis) -> np.ndarray:
    """Start times (run,) [s] over which a trend of the zeros is growth of the screw, see `beside_place`; zero where no trend is growth, as on a rotary axis."""
    when = np.array([run.started_at for run in runs])
    left = beside_place(runs, axis, when)
    told = axis.kind == "linear" and len(runs) > TREND and np.linalg.norm(left) > 1e-6 * np.linalg.norm(when)
    return left if told else np.zeros(len(runs))


def beside_place(runs: Sequence[MeasuredRun], axis: Axis, values: np.ndarray) -> np.ndarray:
    """The part of values (run,) that neither a constant nor the place where the axis starts, to 1 um or urad, explains."""
    place = np.array([[1.0, round(float(run.trace.get(axis.name, "setpoint")[0]), 6)] for run in runs]).reshape(-1, 2)
    return np.asarray(values - place @ solved(place, values))


def clear_zeros(zeros: Zeros, machine: Machine) -> dict[str, float]:
    """The largest clear difference of zeros of each axis [m or rad]."""
    clear: dict[str, float] = {}
    for (name, _), offset in zeros.items():
        if abs(offset) > max(LEAST * encoders_noise(machine, machine.axis(name)), abs(clear.get(name, 0.0))):
            clear[name] = offset
    return clear


def notes_of_zeros(found: Mapping[str, float], machine: Machine) -> list[str]:
    """One line for each axis whose encoders have no common zero."""
    lines = []
    for name, offset in found.items():
        unit, factor = AXIS_UNITS[machine.axis(name).kind].error
        lines.append(
            f"axis {name}: the zeros of its two encoders differ by up to {abs(offset) * factor:.4g} {unit}; this is fitted in each run and is no"
            " fault"
        )
    return lines


def _is_of_zeros(runs: Sequence[MeasuredRun], offsets: Sequence[tuple[float, float]], axis: Axis, machine: Machine) -> bool:
    means, deviations = np.array(offsets).T
    largest = float(np.abs(means).max())
    if largest < LEAST * encoders_noise(machine, axis) or np.any(deviations > CONSTANT * largest):
        return False
    centred = means - means.mean()
    if len(runs) < TREND_RUNS or float(centred @ centred) < 0.01 * float(means @ means):
        return True
    when = [run.started_at + 0.5 * float(run.trace.time[-1] - run.trace.time[0]) for run in runs]
    place = [float(np.mean(run.trace.get(axis.name, "position"))) for run in runs]
    trend = np.column_stack([np.ones(len(runs)), when, place])
    detrended = means - trend @ np.linalg.lstsq(trend, means, rcond=None)[0]
    return float(detrended @ detrended) > (1.0 - BY_TREND) * float(centred @ centred)
