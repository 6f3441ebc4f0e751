"""Fit of a drive in closed loop: lumped inertia, friction, constant force, gains of the speed loop and the delay of its position loop.

For axes whose speed controller commands an ideal actuator (structures P/PI and P/P): a machine without a data sheet, a laboratory axis.
The values may be lumped: inertia and friction divided by the torque constant. The whole loop is simulated on the recorded set points and
compared with every sample of the training rows, including short moves, reversals and the ringing of the speed loop.

    min over the values of an axis:  sum over signals of  N log RMS(measured - simulated)

that is, maximum likelihood with an unknown noise level for each signal. The search is a damped Gauss-Newton (Levenberg-Marquardt). The
axes are independent, so one simulation perturbs one value of every axis. Intervals come from clusters of a tenth of a second.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from twin.errors import SimulationError
from twin.identify.drive_residuals import LEAST_RMS, DriveFit, DriveResiduals, rms_of, whitened, with_constant_forces
from twin.machine.machine import Machine
from twin.recordings.campaign import MeasuredRun

STEPS = 12
CONVERGED = 1e-4
"""The search of an axis ends when a step improves the mean log RMS by less than this."""

LEAST_IMPROVEMENT = 0.02
"""A reference model of the speed controller or a torque feedforward of the drive is added if it lowers the mean log RMS by more than this."""

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
    """Fit all axes without a current loop on their `rows` (run, (sample,) bool); loop values in `known` (axis, field) are kept.

    Axes in `skipped` and axes without recorded motion and command are not fitted.
    """
    plain = _searched(DriveResiduals(machine, runs, rows, known, skipped), say)
    if plain is None:
        return DriveFits(machine)
    searches = dict.fromkeys(plain.x, plain)
    controlled = [n for n in plain.x if "speed_integral_time_s" in plain.work.fields[n]]
    modelled = with_reference_models(machine, controlled)
    fed_by_nc = any("torque" in (run.feedforward or "torque") for run in runs)
    for richer in (modelled, machine if fed_by_nc else with_drive_feedforward(modelled, controlled)):
        if richer == machine:
            continue
        try:
            other = _searched(DriveResiduals(richer, runs, rows, known, [a.name for a in machine.axes if richer.axis(a.name) == a]), say)
        except SimulationError:
            other = None
        if other is not None:
            searches |= {n: other for n in other.x if other.score[n] < searches[n].score[n] - LEAST_IMPROVEMENT}
    fits, values, forces = {}, {}, {}
    for n, search in searches.items():
        fits[n] = search.work.result(n, search.x[n], search.base[n], search.jacobian[n])
        own, force = search.work.values({n: search.x[n]})
        values.update(own)
        forces.update(force)
    return DriveFits(with_constant_forces(machine.with_values(values), forces), fits)


@dataclass(frozen=True)
class _Search:
    """End of a search: values, residuals, score and Jacobian of each axis."""

    work: DriveResiduals
    x: dict[str, np.ndarray]
    base: dict[str, dict[str, np.ndarray]]
    score: dict[str, float]
    jacobian: dict[str, np.ndarray]


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


def _searched(work: DriveResiduals, say: Callable[[str], None] | None) -> _Search | None:
    """Damped search from the machine's values; None if no axis is fitted."""
    if not work.names:
        return None
    x = work.start()
    base = work.residuals(x)
    if base is None:
        x = work.with_softer_gains(x)
        base = work.residuals(x)
        if base is None:
            raise SimulationError(
                "the simulated machine does not follow the recorded set points because its loops are unstable; correct its gains"
            )
    score = {a: _score(base[a]) for a in work.names}
    damping = dict.fromkeys(work.names, 1e-3)
    open_axes = set(work.names)
    jacobian: dict[str, np.ndarray] = {}
    for step in range(STEPS):
        jacobian = work.jacobian(x, base)
        for _ in range(4):
            trial = {a: x[a] + _step(jacobian[a], whitened(base[a]), damping[a]) if a in open_axes else x[a] for a in work.names}
            there = work.residuals(trial)
            better = {a for a in open_axes if there is not None and a in there and _score(there[a]) < score[a]}
            for a in open_axes:
                damping[a] *= 0.2 if a in better else 8.0
            if there is not None and better:
                x = {a: trial[a] if a in better else x[a] for a in work.names}
                gained = {a: score[a] - _score(there[a]) for a in better}
                base = {a: there[a] if a in better else base[a] for a in work.names}
                score.update({a: _score(base[a]) for a in better})
                open_axes -= {a for a in better if gained[a] < CONVERGED}
                break
        else:
            break
        if say:
            say(f"drive fit step {step + 1}")
        if not open_axes:
            break
    return _Search(work, x, base, score, work.jacobian(x, base))


def _score(residual: Mapping[str, np.ndarray]) -> float:
    """Mean log RMS of the signals, weighted by their numbers of samples."""
    count = sum(len(v) for v in residual.values())
    return sum(len(v) * math.log(max(rms_of(v), LEAST_RMS)) for v in residual.values()) / max(count, 1)


def _step(jacobian: np.ndarray, residual: np.ndarray, damping: float) -> np.ndarray:
    """Levenberg-Marquardt step (value,), limited to +-1; values without an effect are not changed."""
    length = np.linalg.norm(jacobian, axis=0)
    seen = length > 1e-9 * max(float(length.max()), 1e-300)
    out = np.zeros(jacobian.shape[1])
    if seen.any():
        j = jacobian[:, seen] / length[seen]
        normal = j.T @ j
        out[seen] = -np.linalg.solve(normal + damping * np.eye(len(normal)), j.T @ residual) / length[seen]
    return np.clip(out, -1.0, 1.0)
