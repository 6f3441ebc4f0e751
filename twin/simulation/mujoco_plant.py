"""The MuJoCo plant: the compiled model of a machine with its effects, started at rest."""

import mujoco
import numpy as np

from twin.effects import Change
from twin.simulation import loop
from twin.simulation.axis_table import axis_table
from twin.simulation.engine_calls import engine_function_address
from twin.simulation.plant_spec import build_plant


class MujocoPlant:
    """The complete machine in MuJoCo, with model edits and rotor joints of its effects."""

    def __init__(self, change: Change) -> None:
        plant = build_plant(change.machine, change.model_edits, tuple(change.couplings))
        self.plant = plant
        data, model = plant.data, plant.model
        levels = loop.friction_levels(model.dof_frictionloss, plant.load_dof, plant.rotor_dof, plant.friction_dof)
        self.engine = loop.Engine(
            step=engine_function_address("mj_step"),
            model=model._address,
            data=data._address,
            qpos=data.qpos,
            qvel=data.qvel,
            ctrl=data.ctrl,
            applied=data.qfrc_applied,
            bias=data.qfrc_bias,
            passive=data.qfrc_passive,
            constraint=data.qfrc_constraint,
            frictionloss=model.dof_frictionloss,
            places=axis_table(loop.Places(*levels, *(getattr(plant, n) for n in loop.Places._fields[len(levels) :]))),
        )

    def place_at_rest(self, start: np.ndarray, constant_force: np.ndarray, change: Change) -> np.ndarray:
        """Place load and rotor at `start` (axis,); returns the holding force at each axis."""
        plant, data = self.plant, self.plant.data
        data.qpos[:] = 0.0
        data.qvel[:] = 0.0
        data.qpos[plant.load_position] = start
        mujoco.mj_forward(plant.model, data)
        held = data.qfrc_bias[plant.load_dof] - constant_force
        for a in np.flatnonzero(plant.rotor_dof != plant.load_dof):
            data.qpos[plant.rotor_position[a]] = start[a] + change.rotor_offset(int(a), float(held[a]))
        return held
