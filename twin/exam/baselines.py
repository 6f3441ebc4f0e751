"""Three simpler methods on the same campaign, as a reference for the diagnosis.

    re-tuning           knows no effects: "none" if re-tuning within the tolerance leaves only noise, otherwise "unknown"
    nearest signature   names the effect whose simulated change of the signals is closest in direction to the residual of the
                        nominal twin; all toleranced parameters keep their nominal values
    sparse regression   regresses the current residual of each axis on each textbook term of mechanics alone and names the
                        term that explains most

Each answers {"verdict": ..., "effect": ..., "axis": ...}.
"""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import Any

import numpy as np

from twin.diagnose.candidates import starts_of
from twin.diagnose.channel import Channel
from twin.diagnose.fit import simulated_response
from twin.diagnose.observe import Group
from twin.diagnose.state import GroupState
from twin.errors import TwinError
from twin.machine.machine import Machine

NOTICED = 0.12
"""Excess of the mean square over noise above which these methods report something."""

NOTHING: dict[str, Any] = {"verdict": "none", "effect": None, "axis": None}


def baselines_of(found: Sequence[GroupState], machine: Machine) -> dict[str, dict[str, Any]]:
    """Answer of each method by its name."""
    return {"re-tuning": _retuning(found), "nearest signature": _nearest(found, machine), "sparse regression": _sparse(found)}


def _above_noise(group: Group, rows: np.ndarray) -> bool:
    """Do weighted rows (row,) hold more than noise? These methods do not know which rows the diagnosis distrusts."""
    rows = group.in_noise(rows)
    return float(rows @ rows) > (1.0 + NOTICED) * sum(len(c.residual) / c.correlation for c in group.channels)


def _retuning(found: Sequence[GroupState]) -> dict[str, Any]:
    left = any(_above_noise(f.group, f.retuned.residual(f.group)) for f in found)
    return {**NOTHING, "verdict": "unknown" if left else "none"}


def _shows(f: GroupState) -> bool:
    return _above_noise(f.rigid, f.rigid.residual)


def _nearest(found: Sequence[GroupState], machine: Machine) -> dict[str, Any]:
    best, said = 0.0, NOTHING
    for f in found:
        if not _shows(f):
            continue
        residual = f.rigid.in_noise(f.rigid.residual)
        for start in starts_of(f.rigid, machine, f.rigid.residual):
            try:
                signature = f.rigid.in_noise(simulated_response(f.rigid, [start.settings[0]]))
            except TwinError:
                continue
            square = float(signature @ signature)
            explained = float(signature @ residual) ** 2 / square if square > 1e-9 else 0.0
            if explained > best:
                best, said = explained, {"verdict": "effect", "effect": start.effect.name, "axis": start.axis}
    return said


def _sparse(found: Sequence[GroupState]) -> dict[str, Any]:
    best, said = 0.0, NOTHING
    for f in found:
        for axis in f.group.axes:
            channels = [c for c in f.rigid.channels if c.axis == axis and c.name == "current"]
            if not channels or not _shows(f):
                continue
            residual = np.concatenate([c.residual / c.sigma for c in channels])
            if float(np.mean(residual**2)) < 1.0 + NOTICED:
                continue
            for effect, terms in _terms(f.rigid, channels).items():
                columns = terms / np.concatenate([c.sigma for c in channels])[:, None]
                closed = float(residual @ columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])
                if closed > best:
                    best, said = closed, {"verdict": "effect", "effect": effect, "axis": axis}
    return said


def _terms(group: Group, channels: Sequence[Channel]) -> dict[str, np.ndarray]:
    """Candidate terms (sample, columns) of the force residual of one axis, by effect."""
    parts: list[dict[str, np.ndarray]] = []
    for c in channels:
        view = group.views[c.run]
        moving = view.reference(c.axis)[2]
        a = view.machine.axis_names.index(c.axis)
        axis = view.machine.axis(c.axis)
        count = len(view.trace.time)
        q, v, acceleration = (m[:count, a][moving] for m in (view.motion.position, view.motion.speed, view.motion.acceleration))
        slow = 4e-3 if axis.kind == "linear" else math.radians(4.0)
        current = view.trace.get(c.axis, "current")[moving]
        turn = q / axis.ratio
        row = {
            "coulomb_friction": np.sign(v)[:, None],
            "viscous_friction": v[:, None],
            "viscous_asymmetry": np.abs(v)[:, None],
            "inertia": acceleration[:, None],
            "constant_force": np.ones((len(v), 1)),
            "stribeck": (np.sign(v) * np.exp(-np.abs(v) / slow))[:, None],
            "torque_constant": current[:, None],
        }
        for n in range(4, 13):
            row[f"torque_ripple {n}"] = np.stack([np.sin(n * turn), np.cos(n * turn)], axis=1)
        for b, other in enumerate(view.machine.axes):
            if other.kind == "linear" and axis.kind == "linear" and b != a:
                row[f"cross_axis_coupling {other.name}"] = view.motion.acceleration[:count, b][moving][:, None]
        parts.append(row)
    stacked = {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}
    best: dict[str, np.ndarray] = {}
    residual = np.concatenate([c.residual for c in channels])
    for name, columns in stacked.items():  # of several orders or source axes the best fit
        effect = name.split()[0]
        if effect not in best or _closed(columns, residual) > _closed(best[effect], residual):
            best[effect] = columns
    return best


def _closed(columns: np.ndarray, residual: np.ndarray) -> float:
    return float(residual @ columns @ np.linalg.lstsq(columns, residual, rcond=None)[0])
