"""What a recording knows of forces that are not the drive's own: outside loads, and what a test rig adds to the command of the drive.

    disturbance [N]        a force on the carriage of a linear axis                       outside load
    disturbance [Nm]       a torque on a rotary axis; on the motor shaft of a linear one  outside load
    injected_command       V, A: added to the command; Nm, N: as the torque at the motor, the force at the axis that the drive makes of it

All push towards +q. An outside load is felt by the mechanics, and the command answers it; an injected command is part of the command that the
drive carries out, and of the command that the simulated record shows. `disturbance` in V or A is an injected command.
"""

from __future__ import annotations

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace

LOAD, MOTOR = 0, 1
"""Last index of outside forces: what they act on."""


def injected(trace: Trace, machine: Machine) -> np.ndarray | None:
    """(sample, axis) torque at the motor [Nm] of injected commands, or None where none is recorded. Raises InputError for a unit the drive does not take."""
    out = np.zeros((len(trace.time), len(machine.axes)))
    for a, axis in enumerate(machine.axes):
        for unit, values in trace.injections(axis.name).items():
            out[:, a] += values * _torque_of(axis, unit)
    return out if any(trace.injections(axis.name) for axis in machine.axes) else None


def _torque_of(axis: Axis, unit: str) -> float:
    """Torque at the motor [Nm] that one unit of an injected command makes."""
    if unit in ("V", "A") and unit != axis.effort_unit:
        raise InputError(
            f"axis {axis.name}: a command in {unit} is injected, but its drive takes {axis.effort_unit}; record or map it in {axis.effort_unit}, Nm or N"
        )
    if unit == "N" and axis.kind == "rotary":
        raise InputError(
            f"axis {axis.name} is rotary: an injected command in N says no torque; record or map it in Nm or {axis.effort_unit}"
        )
    return {"N": axis.ratio, "Nm": 1.0}.get(unit, axis.commissioned_torque_constant or axis.motor.torque_constant_nm_per_a)


def outside(trace: Trace, machine: Machine) -> np.ndarray | None:
    """(sample, axis, 2) forces at the axis [N, Nm] on load and motor from outside, or None where none is recorded."""
    out = np.zeros((len(trace.time), len(machine.axes), 2))
    for a, axis in enumerate(machine.axes):
        out[:, a] = outside_of(trace, axis)
    return out if any(trace.loads(axis.name) for axis in machine.axes) else None


def outside_of(trace: Trace, axis: Axis) -> np.ndarray:
    """(sample, 2) forces at one axis [N, Nm] on load and motor from outside; zeros where none is recorded."""
    out = np.zeros((len(trace.time), 2))
    for unit, values in trace.loads(axis.name).items():
        if unit == "N" and axis.kind == "rotary":
            raise InputError(f"axis {axis.name} is rotary: a disturbance in N says no torque; record or map it in Nm at the axis")
        if unit == "Nm" and axis.kind == "linear":
            out[:, MOTOR] += values / axis.ratio
        else:
            out[:, LOAD] += values
    return out
