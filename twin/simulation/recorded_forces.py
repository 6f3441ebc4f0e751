"""Forces in a recording that do not come from the drive: external loads, and commands injected by a test rig.

    disturbance [N]        force on the carriage of a linear axis                         external load
    disturbance [Nm]       torque on a rotary axis, or on the motor shaft of a linear axis  external load
    injected_command       in V or A added to the command; in Nm as torque at the motor, in N as force at the axis

All are positive towards +q. An external load acts on the mechanics. An injected command is part of the command of the drive and of the
simulated record. A `disturbance` in V or A is an injected command.
"""

import numpy as np

from twin.errors import InputError
from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace

LOAD, MOTOR = 0, 1
"""Last index of external forces."""


def injected(trace: Trace, machine: Machine) -> np.ndarray | None:
    """Torque at the motor (sample, axis) [Nm] of injected commands, or None. Raises InputError for a unit that the drive cannot use."""
    if not any(trace.injections(axis.name) for axis in machine.axes):
        return None
    none = np.zeros(len(trace.time))
    parts = [[values * _torque_of(axis, unit) for unit, values in trace.injections(axis.name).items()] for axis in machine.axes]
    return np.column_stack([sum(own, none) for own in parts])


def _torque_of(axis: Axis, unit: str) -> float:
    """Torque at the motor [Nm] per unit of an injected command."""
    if unit in ("V", "A") and unit != axis.effort_unit:
        raise InputError(
            f"axis {axis.name}: a command in {unit} is injected, but its drive takes {axis.effort_unit}; record or map it in {axis.effort_unit}, Nm or N"
        )
    if unit == "N" and axis.kind == "rotary":
        raise InputError(
            f"axis {axis.name} is rotary: an injected command in N is not a torque; record or map it in Nm or {axis.effort_unit}"
        )
    return {"N": axis.ratio, "Nm": 1.0}.get(unit, axis.commissioned_torque_constant or axis.motor.torque_constant_nm_per_a)


def external(trace: Trace, machine: Machine) -> np.ndarray | None:
    """External forces (sample, axis, 2) at the axis [N, Nm] on load and motor, or None."""
    if not any(trace.loads(axis.name) for axis in machine.axes):
        return None
    return np.stack([external_of(trace, axis) for axis in machine.axes], axis=1)


def external_of(trace: Trace, axis: Axis) -> np.ndarray:
    """External forces (sample, 2) at one axis [N, Nm] on load and motor; zeros if none are recorded."""
    out = np.zeros((len(trace.time), 2))
    for unit, values in trace.loads(axis.name).items():
        if unit == "N" and axis.kind == "rotary":
            raise InputError(f"axis {axis.name} is rotary: a disturbance in N is not a torque; record or map it in Nm at the axis")
        if unit == "Nm" and axis.kind == "linear":
            out[:, MOTOR] += values / axis.ratio
        else:
            out[:, LOAD] += values
    return out
