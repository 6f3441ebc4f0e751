"""The search of a drive fit: damped Gauss-Newton (Levenberg-Marquardt) for all axes at once.

Axes do not feel each other, so one simulation turns one value of every axis; each axis has its own damping and its own end.
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
DONE = 1e-4
"""The search ends where a step improves the mean log RMS by less."""


@dataclass(frozen=True)
class Search:
    """Where a search ended: values, residuals, score and slopes of each axis."""

    work: DriveResiduals
    x: dict[str, np.ndarray]
    base: dict[str, dict[str, np.ndarray]]
    score: dict[str, float]
    jacobian: dict[str, np.ndarray]


def machine_found(machine: Machine, best: Mapping[str, Search]) -> Machine:
    """The machine with the values of each axis where its own search ended."""
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
    """The damped search from the machine's own values, or from `start`; None if no axis is fitted.

    Raises SimulationError if the machine does not follow the set points, not even with half the gains.
    """
    if not work.names:
        return None
    x = dict(start) if start is not None else work.start()
    base = work.residuals(x)
    if base is None:
        x = work.with_softer_gains(x)
        base = work.residuals(x)
        if base is None:
            raise SimulationError("the machine file does not follow the recorded set points: its loops are unstable; correct its gains")
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
                open_axes -= {a for a in better if gained[a] < DONE}
                break
        else:
            break
        if say:
            say(f"drive fit step {step + 1}")
        if not open_axes:
            break
    return Search(work, x, base, score, work.jacobian(x, base))


def score_of(residual: Mapping[str, np.ndarray]) -> float:
    """Mean log RMS of the signals, by their numbers of samples."""
    count = sum(len(v) for v in residual.values())
    return sum(len(v) * math.log(max(rms_of(v), LEAST_RMS)) for v in residual.values()) / max(count, 1)


def _step(jacobian: np.ndarray, residual: np.ndarray, damping: float) -> np.ndarray:
    """Levenberg-Marquardt step; columns that change nothing stay, no step is longer than e-fold."""
    length = np.linalg.norm(jacobian, axis=0)
    seen = length > 1e-9 * max(float(length.max()), 1e-300)
    out = np.zeros(jacobian.shape[1])
    if seen.any():
        j = jacobian[:, seen] / length[seen]
        normal = j.T @ j
        out[seen] = -np.linalg.solve(normal + damping * np.eye(len(normal)), j.T @ residual) / length[seen]
    return np.clip(out, -1.0, 1.0)
