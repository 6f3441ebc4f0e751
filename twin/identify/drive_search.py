"""The search of a drive fit: damped Gauss-Newton (Levenberg-Marquardt) for all axes at once.

The axes are independent, so one simulation perturbs one value of every axis. Each axis has its own damping and stops on its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

import numpy as np

from twin.errors import SimulationError
from twin.identify.drive_residuals import LEAST_RMS, DriveResiduals, rms_of, whitened, with_constant_forces
from twin.machine.machine import Machine

STEPS = 12
CONVERGED = 1e-4
"""The search of an axis ends when a step improves the mean log RMS by less than this."""

LEAST_IMPROVEMENT = 0.02
"""A richer model is taken if it lowers the mean log RMS by more than this."""


@dataclass(frozen=True)
class Search:
    """End of a search: values, residuals, score and Jacobian of each axis."""

    work: DriveResiduals
    x: dict[str, np.ndarray]
    base: dict[str, dict[str, np.ndarray]]
    score: dict[str, float]
    jacobian: dict[str, np.ndarray]


def machine_found(machine: Machine, best: Mapping[str, Search]) -> Machine:
    """The machine with the final values of each axis."""
    values: dict[str, object] = {}
    forces: dict[str, float] = {}
    for name, search in best.items():
        own, force = search.work.values({name: search.x[name]})
        values.update(own)
        forces.update(force)
    return with_constant_forces(machine.with_values(values), forces)


def searched(
    work: DriveResiduals,
    say: Callable[[str], None] | None = None,
    start: Mapping[str, np.ndarray] | None = None,
    steps: int = STEPS,
) -> Search | None:
    """Damped search from the machine's values, or from `start`; None if no axis is fitted.

    Raises SimulationError if the machine does not follow the set points, even with half the gains.
    """
    if not work.names:
        return None
    x = dict(start) if start is not None else work.start()
    base = work.residuals(x)
    if base is None:
        x = work.with_softer_gains(x)
        base = work.residuals(x)
        if base is None:
            raise SimulationError(
                "the simulated machine does not follow the recorded set points because its loops are unstable; correct its gains"
            )
    score = {a: score_of(base[a]) for a in work.names}
    damping = dict.fromkeys(work.names, 1e-3)
    open_axes = set(work.names)
    jacobian: dict[str, np.ndarray] = {}
    for step in range(steps):
        jacobian = work.jacobian(x, base)
        for _ in range(4):
            moved = {a: x[a] + _step(jacobian[a], whitened(base[a]), damping[a]) if a in open_axes else x[a] for a in work.names}
            trial = work.within(moved)
            there = work.residuals(trial)
            better = {a for a in open_axes if there is not None and a in there and score_of(there[a]) < score[a]}
            for a in open_axes:
                damping[a] *= 0.2 if a in better else 8.0
            if there is not None and better:
                x = {a: trial[a] if a in better else x[a] for a in work.names}
                gained = {a: score[a] - score_of(there[a]) for a in better}
                base = {a: there[a] if a in better else base[a] for a in work.names}
                score.update({a: score_of(base[a]) for a in better})
                open_axes -= {a for a in better if gained[a] < CONVERGED}
                break
        else:
            break
        if say:
            say(f"drive fit step {step + 1}")
        if not open_axes:
            break
    return Search(work, x, base, score, work.jacobian(x, base))


def score_of(residual: Mapping[str, np.ndarray]) -> float:
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
