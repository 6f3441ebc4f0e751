"""Checks for every axis that the model's friction sticks below break-away and follows its law above.

python -m devtools.friction_check [MACHINE.toml]
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import sys

import mujoco
import numpy as np

from twin.errors import TwinError
from twin.machine.machine import Machine, load_machine
from twin.simulation.plant_spec import compile_model

SETTLE_S, WATCH_S = 0.5, 1.0
STUCK, SLIDING = 0.95, 1.02
"""Pushing forces as shares of the Coulomb friction."""

DEFAULT_SOLREF = (0.02, 1.0)
DEFAULT_SOLIMP = (0.9, 0.95, 0.001, 0.5, 2.0)
"""MuJoCo's default constraint parameters, with which a sticking axis creeps."""


@dataclass(frozen=True)
class Push:
    """An axis pushed with a share of its Coulomb friction: mean speed [m/s, rad/s] and mean friction [N, Nm]."""

    speed: float
    friction: float


def push(model: mujoco.MjModel, machine: Machine, axis_name: str, share: float) -> Push:
    """Push one axis from rest with `share` of its Coulomb friction; all motors balance gravity."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for axis in machine.axes:
        carried = data.qfrc_bias[model.joint(axis.name).dofadr[0]] * axis.ratio
        data.ctrl[model.actuator(axis.name).id] = carried + (axis.name == axis_name) * share * axis.coulomb_friction_nm
    joint = model.joint(axis_name)
    ticks = [round(seconds / model.opt.timestep) for seconds in (SETTLE_S, WATCH_S)]
    for _ in range(ticks[0]):
        mujoco.mj_step(model, data)
    start, friction = data.qpos[joint.qposadr[0]], np.zeros(ticks[1])
    for k in range(ticks[1]):
        mujoco.mj_step(model, data)
        friction[k] = -data.qfrc_constraint[joint.dofadr[0]]
    return Push(float(data.qpos[joint.qposadr[0]] - start) / WATCH_S, float(friction.mean()))


def main(arguments: Sequence[str] | None = None) -> int:
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        machine = load_machine(arguments[0] if arguments else None)
    except TwinError as error:
        print(f"friction_check: {error}", file=sys.stderr)
        return 2
    model, default = compile_model(machine), compile_model(machine)
    default.dof_solref[:] = DEFAULT_SOLREF
    default.dof_solimp[:] = DEFAULT_SOLIMP
    print(f"{machine.name}: pushed with {STUCK:.0%}, then {SLIDING:.0%} of the friction; in brackets with the engine's default friction")
    for axis in machine.axes:
        unit = "um/s" if axis.kind == "linear" else "urad/s"
        stuck, sliding = push(model, machine, axis.name, STUCK), push(model, machine, axis.name, SLIDING)
        soft = push(default, machine, axis.name, STUCK).speed * 1e6
        off = sliding.friction / axis.coulomb_friction - 1.0
        print(f"{axis.name}: creeps {stuck.speed * 1e6:.4f} {unit} (default {soft:.0f}); sliding, friction is off by {off:.1e}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
