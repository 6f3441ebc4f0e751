"""The numbers of one axis that every method fits, at the axis in SI, and the machine file that has them.

    inertia [kg, kg m2] = load + rotor / ratio^2     Coulomb friction [N, Nm]     viscous friction [N s/m, Nm s]     constant force [N, Nm]

A current tells forces only up to the torque constant, which stays that of the machine file for every method.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from twin.machine.machine import Axis, Machine
from twin.recordings.trace import Trace
from twin.simulation.plant_spec import home_inertia_at_motor

MECHANICS = ("inertia", "coulomb_friction", "viscous_friction", "constant_force")
LOOPS = ("position_gain_per_s", "speed_gain_nm_s_per_rad", "speed_integral_time_s", "position_delay_s", "feedforward_delay_s")


def load_inertia(machine: Machine) -> float:
    """Inertia of the load of the only driven axis, at the axis [kg, kg m2]."""
    (axis,) = machine.axes
    return float(home_inertia_at_motor(machine)[0] - axis.rotor_inertia_kg_m2) / axis.ratio**2


def numbers_of(machine: Machine) -> dict[str, float]:
    """The numbers of the only driven axis: MECHANICS at the axis, and the LOOPS that it has."""
    (axis,) = machine.axes
    found = {
        "inertia": load_inertia(machine) + axis.rotor_inertia_kg_m2 / axis.ratio**2,
        "coulomb_friction": axis.coulomb_friction,
        "viscous_friction": axis.viscous_friction,
        "constant_force": axis.constant_force,
    }
    loops = {name: getattr(axis.loops, name) for name in LOOPS}
    return found | {name: value for name, value in loops.items() if 0.0 < value < float("inf")}


def with_numbers(machine: Machine, numbers: Mapping[str, float]) -> Machine:
    """The machine with these numbers. A change of inertia is given to the rotor, so that the model of the load stays as it is."""
    (axis,) = machine.axes
    r = axis.ratio
    to_file = {
        "inertia": ("rotor_inertia_kg_m2", lambda value: max(value - load_inertia(machine), 1e-3 * value) * r**2),
        "coulomb_friction": ("coulomb_friction_nm", lambda value: max(value, 0.0) * r),
        "viscous_friction": ("viscous_friction_nm_s_per_rad", lambda value: max(value, 0.0) * r**2),
        "constant_force": ("constant_torque_nm", lambda value: value * r),
    }
    values = {}
    for name, value in numbers.items():
        field, convert = to_file.get(name, (f"loops.{name}", float))
        if field == "rotor_inertia_kg_m2":
            field = ROTOR[axis.kind]
        path, in_file = machine.in_file(f"axis.{axis.name}.{field}", float(convert(value)))
        values[path] = in_file
    return machine.with_values(values)


ROTOR = {"linear": "rotor_and_screw_inertia_kg_m2", "rotary": "rotor_and_gear_inertia_kg_m2"}


def sizes_of(numbers: Mapping[str, float]) -> dict[str, float]:
    """The size by which a fit scales each number: its own, for the constant force that of the friction."""
    return {name: numbers["coulomb_friction"] if name == "constant_force" else value for name, value in numbers.items()}


def drive_force(axis: Axis, trace: Trace) -> np.ndarray:
    """Recorded force on the axis (sample,) [N, Nm]: that of the drive at the torque constant of the file, and the known outside load."""
    force = trace.get(axis.name, axis.effort) * force_per_effort(axis)
    for unit, load in trace.loads(axis.name).items():
        force = force + load / (axis.ratio if unit == "Nm" and axis.kind == "linear" else 1.0)
    return force


def force_per_effort(axis: Axis) -> float:
    """Force at the axis for one ampere, volt or newton metre."""
    return (1.0 if axis.effort == "torque" else axis.motor.torque_constant_nm_per_a) / axis.ratio


def motor_motion(axis: Axis, trace: Trace) -> np.ndarray:
    """Recorded position of the motor at the axis (sample,); that of the scale where no motor encoder is recorded."""
    return trace.get(axis.name, "motor_position" if trace.has(axis.name, "motor_position") else "position")
