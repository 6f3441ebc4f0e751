"""Motor encoder and scale whose zeros differ: a constant in each run that is fitted and is no fault.

The difference d of motor encoder and scale has the mean m_k and the standard deviation w_k in run k. It is a difference of zeros if it
exceeds noise in some run, is constant within each run (w_k small compared with the largest |m|), and does not follow time or position from
run to run, as thermal growth of the screw or a lead error does: m_k = a + b t_k + c x_k explains little more than the mean.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from twin.diagnose.settings import DEFAULT, Thresholds
from twin.machine.machine import Axis, Machine
from twin.recordings.campaign import MeasuredRun
from twin.recordings.trace import Trace
from twin.simulation.gap import encoders_noise
from twin.simulation.two_encoders import has_both, motor_minus_scale, shifted
from twin.units import AXIS_UNITS


def with_common_zeros(
    runs: Sequence[MeasuredRun], machine: Machine, thresholds: Thresholds = DEFAULT
) -> tuple[tuple[MeasuredRun, ...], dict[str, float]]:
    """The runs without differences of zeros, and the largest difference of each axis that has one [m or rad]."""
    largest: dict[str, float] = {}
    for axis in machine.axes:
        runs_of_axis = [k for k, run in enumerate(runs) if has_both(run.trace, axis.name)]
        offsets = {k: _difference(runs[k].trace, axis.name) for k in runs_of_axis}
        if offsets and _is_of_zeros([runs[k] for k in runs_of_axis], list(offsets.values()), axis, machine, thresholds):
            largest[axis.name] = max((mean for mean, _ in offsets.values()), key=abs)
            runs = [
                replace(_shifted(run, axis, offsets[k][0]), own_zeros=run.own_zeros | {axis.name}) if k in offsets else run
                for k, run in enumerate(runs)
            ]
    return tuple(runs), largest


def without_zeros(
    runs: Sequence[MeasuredRun], machine: Machine, zeros: Mapping[tuple[str, int], float], thresholds: Thresholds = DEFAULT
) -> tuple[tuple[MeasuredRun, ...], dict[str, float]]:
    """The runs without fitted differences of zeros, given by axis and run [m or rad]; and the largest clear one of each axis."""
    clear: dict[str, float] = {}
    for (name, k), offset in zeros.items():
        axis = machine.axis(name)
        runs = [_shifted(run, axis, offset) if i == k else run for i, run in enumerate(runs)]
        noise = encoders_noise(machine, axis)
        if abs(offset) > max(thresholds.zero_least * noise, abs(clear.get(name, 0.0))):
            clear[name] = offset
    return tuple(runs), clear


def zeros_left(
    runs: Sequence[MeasuredRun], machine: Machine, predicted: Mapping[str, Trace], axes: Collection[str]
) -> dict[tuple[str, int], float]:
    """Constants (axis, run) [m or rad] that predictions leave between the two encoders of these axes, without the trend of a growing screw."""
    zeros: dict[tuple[str, int], float] = {}
    for name in sorted(axes):
        runs_of_axis = [k for k, run in enumerate(runs) if has_both(run.trace, name)]
        means = np.array([_offset_left(runs[k].trace, predicted[runs[k].name], name) for k in runs_of_axis])
        started_at = np.array([runs[k].started_at for k in runs_of_axis])
        started_at = started_at - started_at.mean() if runs_of_axis else started_at
        if machine.axis(name).kind == "linear" and started_at.any():
            means = means - started_at * float(started_at @ means) / float(started_at @ started_at)
        zeros |= {(name, k): float(mean) for k, mean in zip(runs_of_axis, means)}
    return zeros


def at_rest_without_zeros(
    runs: Sequence[MeasuredRun], machine: Machine, predicted: Mapping[str, Trace], axes: Collection[str]
) -> tuple[MeasuredRun, ...]:
    """The runs in which one of these axes is at rest, without the constant that the prediction leaves between its two encoders."""

    def aligned(run: MeasuredRun) -> MeasuredRun:
        for name in axes:
            if not run.trace.moves(name) and has_both(run.trace, name):
                run = _shifted(run, machine.axis(name), _offset_left(run.trace, predicted[run.name], name))
        return run

    return tuple(aligned(run) for run in runs)


def notes_of_zeros(found: dict[str, float], machine: Machine) -> list[str]:
    """One line for each axis whose encoders have no common zero."""
    lines = []
    for name, offset in found.items():
        unit, factor = AXIS_UNITS[machine.axis(name).kind].error
        lines.append(
            f"axis {name}: the zeros of its two encoders differ by up to {offset * factor:.4g} {unit}; this is fitted in each run and is no fault"
        )
    return lines


def _offset_left(measured: Trace, predicted: Trace, name: str) -> float:
    """Constant that a prediction leaves between the two encoders [m or rad]: the median, since an axis may stick elsewhere after a motion."""
    return float(np.median(motor_minus_scale(measured, name) - motor_minus_scale(predicted, name)))


def _difference(trace: Trace, name: str) -> tuple[float, float]:
    """Mean and standard deviation of motor encoder minus scale."""
    apart = motor_minus_scale(trace, name)
    return float(np.mean(apart)), float(np.std(apart))


def _is_of_zeros(
    runs: Sequence[MeasuredRun], offsets: Sequence[tuple[float, float]], axis: Axis, machine: Machine, thresholds: Thresholds
) -> bool:
    means, deviations = np.array(offsets).T
    largest = float(np.abs(means).max())
    noise = encoders_noise(machine, axis)
    if largest < thresholds.zero_least * noise or np.any(deviations > thresholds.zero_constant * largest):
        return False
    centred = means - means.mean()
    if len(runs) < thresholds.trend_runs or float(centred @ centred) < 0.01 * float(means @ means):
        return True
    when = [run.started_at + 0.5 * float(run.trace.time[-1] - run.trace.time[0]) for run in runs]
    place = [float(np.mean(run.trace.get(axis.name, "position"))) for run in runs]
    trend = np.column_stack([np.ones(len(runs)), when, place])
    detrended = means - trend @ np.linalg.lstsq(trend, means, rcond=None)[0]
    return float(detrended @ detrended) > (1.0 - thresholds.zero_by_trend) * float(centred @ centred)


def _shifted(run: MeasuredRun, axis: Axis, offset: float) -> MeasuredRun:
    """The run with the encoder that does not close the position loop shifted to the zero of the other one."""
    return replace(run, trace=shifted(run.trace, axis, offset))
