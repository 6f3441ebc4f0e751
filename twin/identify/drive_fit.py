"""Fit of an axis in closed loop: lumped inertia, friction, constant force, gains of the speed loop and the delay of its position loop.

For axes whose speed controller commands an ideal actuator (structures P/PI and P/P): a machine without a data sheet, a laboratory axis.
The values may be lumped: inertia and friction divided by the torque constant. Of a drive with a current loop it fits the position controller
where no speed set point is recorded. The whole loop is simulated on the recorded set points and
compared with every sample of the training rows, including short moves, reversals and the ringing of the speed loop (`estimate.search`). Each
axis is a block, so one simulation perturbs one value of every axis. Intervals come from clusters of a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from twin.errors import SimulationError
from twin.estimate.evidence import LEAST_IMPROVEMENT
from twin.estimate.search import search
from twin.identify.drive_mechanics import machine_found, with_mechanics
from twin.identify.drive_residuals import DriveFit, DriveResiduals
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun

REFERENCE_LAGS_S = (0.3e-3, 3e-3)
REFERENCE_INTEGRAL_S = 0.01
"""Initial values for a reference model: bounds of the lag of the speed loop, and the least integral time [s]."""


@dataclass(frozen=True)
class DriveFits:
    """The fitted machine and the fit of each axis."""

    machine: Machine
    axes: dict[str, DriveFit] = field(default_factory=dict)


def fit_drives(
    machine: Machine,
    runs: Sequence[MeasuredRun],
    rows: Mapping[str, Sequence[np.ndarray]],
    known: Collection[tuple[str, str]] = (),
    say: Callable[[str], None] | None = None,
    skipped: Collection[str] = (),
) -> DriveFits:
    """Fit all axes on their `rows` (run, (sample,) bool); loop values in `known` (axis, field) are kept.

    Axes with nothing free, axes in `skipped` and axes without recorded motion and command are not fitted.
    """
    step = None if say is None else lambda k: say(f"drive fit step {k}")  # type: ignore[misc]
    work = DriveResiduals(machine, runs, rows, known, skipped)
    if not work.names:
        return DriveFits(machine)
    plain = search(work, say=step) or search(work, work.softer(), say=step)
    if plain is None:
        raise SimulationError(
            "the simulated machine does not follow the recorded set points because its loops are unstable; correct its gains"
        )
    ends = dict.fromkeys(work.names, plain)
    controlled = [n for n in work.names if "speed_integral_time_s" in work.fields[n]]
    modelled = with_reference_models(machine, controlled)
    fed_by_nc = any("torque" in (run.feedforward or "torque") for run in runs)
    for richer in (modelled, machine if fed_by_nc else with_drive_feedforward(modelled, controlled)):
        if richer == machine:
            continue
        more = DriveResiduals(richer, runs, rows, known, [a.name for a in machine.axes if richer.axis(a.name) == a])
        other = search(more, say=step) if more.names else None
        if other is not None:
            ends |= {n: other for n in more.names if other.score(n) < ends[n].score(n) - LEAST_IMPROVEMENT}
    ends = with_mechanics(machine, runs, rows, known, ends, step)
    return DriveFits(machine_found(machine, ends), {n: end.problem.result(n, end) for n, end in ends.items()})


def with_reference_models(machine: Machine, axes: Collection[str]) -> Machine:
    """Add a reference model with the lag of the speed loop before the integrators of these axes; unchanged if all have one."""
    values: dict[str, object] = {}
    for name in axes:
        axis = machine.axis(name)
        if axis.loops.speed_reference_time_s == 0.0:
            inertia = axis.rotor_inertia_kg_m2 + (axis.moving_mass_kg or 0.0) * axis.ratio**2
            lag = float(np.clip(inertia / axis.loops.speed_gain_nm_s_per_rad, *REFERENCE_LAGS_S))
            values[f"axis.{name}.loops.speed_reference_time_s"] = lag
            values[f"axis.{name}.loops.speed_gain_nm_s_per_rad"] = inertia / lag
            values[f"axis.{name}.loops.speed_integral_time_s"] = max(axis.loops.speed_integral_time_s, REFERENCE_INTEGRAL_S)
    return machine.with_values(values) if values else machine


def with_drive_feedforward(machine: Machine, axes: Collection[str]) -> Machine:
    """Switch on the torque feedforward of the drives of these axes; unchanged if it is on for all."""
    off = [n for n in axes if machine.axis(n).loops.drive_torque_feedforward == 0.0]
    return machine.with_values({f"axis.{n}.loops.drive_torque_feedforward": 1.0 for n in off}) if off else machine
