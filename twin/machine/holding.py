"""Forces and efforts that hold the axes against gravity, over the angles of the rotary axes, with the linear axes at home."""

from dataclasses import dataclass
import itertools
import math

import mujoco
import numpy as np

from twin.machine.machine import Axis, Machine
from twin.simulation.plant_spec import build_plant, remembered

ANGLES = 13
"""Angles of each rotary axis over its travel. The circle of an endless axis is divided into one step less."""

UNCHANGED = 1e-6
"""A holding torque that varies less from pose to pose, as a share of its largest value, counts as constant."""


@dataclass(frozen=True)
class Holding:
    """Forces (pose, axis) [N, Nm] that hold the axes, at angles (pose, rotary axis) [rad] of the axes `rotary`."""

    rotary: tuple[str, ...]
    angles: np.ndarray
    forces: np.ndarray


@remembered
def holding_of(machine: Machine) -> Holding:
    """Gravity at every axis, without effects. Cached, because gains and motors do not change it."""
    plant = build_plant(machine)
    rotary = [a for a, axis in enumerate(machine.axes) if axis.kind == "rotary"]
    grids = [_angles(machine.axes[a]) for a in rotary]
    poses = np.array(list(itertools.product(*grids))).reshape(
        math.prod(map(len, grids)), len(rotary)
    )  # without rotary axes one pose of no angle
    forces = np.empty((len(poses), len(machine.axes)))
    for i, pose in enumerate(poses):
        plant.data.qpos[:] = 0.0
        plant.data.qpos[plant.load_position[rotary]] = pose
        mujoco.mj_forward(plant.model, plant.data)
        forces[i] = plant.data.qfrc_bias[plant.load_dof]
    return Holding(tuple(machine.axes[a].name for a in rotary), poses, forces)


def _angles(axis: Axis) -> np.ndarray:
    low, high = axis.travel
    if math.isfinite(low) and high - low < 2.0 * math.pi:
        return np.linspace(low, high, ANGLES)
    return np.arange(ANGLES - 1) * 2.0 * math.pi / (ANGLES - 1)


def holding_effort(machine: Machine, axis: Axis) -> np.ndarray:
    """Effort (pose,) [A, V, Nm] that holds an axis against gravity and its constant load, for each pose of `holding_of`."""
    force = holding_of(machine).forces[:, machine.axis_names.index(axis.name)] + axis.constant_force
    return force * axis.ratio / axis.motor.torque_constant_nm_per_a
