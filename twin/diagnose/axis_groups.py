"""Groups of axes that move together: they are observed, searched and compared together."""

from collections.abc import Iterable, Sequence

import mujoco
import numpy as np
from scipy.sparse.csgraph import connected_components

from twin.effects import with_effects
from twin.machine.machine import Machine
from twin.simulation.plant_spec import build_plant, full_inertia


def axis_groups(machine: Machine, measured: Sequence[str], seen_together: Iterable[Sequence[str]] = ()) -> list[tuple[str, ...]]:
    """Groups of axes that the mass matrix couples somewhere in their travel, or that one sensor measures together, in the machine's order."""
    plant = build_plant(with_effects(machine, []))
    rng = np.random.default_rng(0)
    n = len(machine.axes)
    coupled = np.eye(n, dtype=bool)
    for _ in range(12):
        plant.data.qpos[plant.load_position] = rng.uniform(-0.2, 0.2, n) + [
            rng.uniform(-1, 1) if axis.kind == "rotary" else 0.0 for axis in machine.axes
        ]
        plant.data.qvel[:] = rng.uniform(-1, 1, plant.model.nv)
        mujoco.mj_forward(plant.model, plant.data)
        inertia = full_inertia(plant.model, plant.data)[np.ix_(plant.load_dof, plant.load_dof)]
        scale = np.sqrt(np.diag(inertia))
        coupled |= np.abs(inertia) / np.outer(scale, scale) > 1e-9
    for first, second in seen_together:
        coupled[machine.axis_names.index(first), machine.axis_names.index(second)] = True
    count, group = connected_components(coupled, directed=False)  # numbered in the order of their first axes
    groups = [tuple(machine.axis_names[a] for a in np.flatnonzero(group == g)) for g in range(count)]
    return [g for g in groups if any(a in measured for a in g)]
