"""Parameters of an axis that differ from machine to machine within the machine file's `parameter_tolerance`."""

from __future__ import annotations

from twin.machine.axis import Axis

TOLERANCED = {
    "torque_constant": "torque_constant_nm_per_a",
    "resistance": "resistance_ohm",
    "inductance": "inductance_h",
    "rotor_inertia": "rotor_inertia_kg_m2",
    "moving_mass": "moving_mass_kg",
    "coulomb_friction": "coulomb_friction_nm",
    "viscous_friction": "viscous_friction_nm_s_per_rad",
}
"""Name of each toleranced parameter, and the field of the axis or its motor that holds it."""

OF_MOTOR = ("torque_constant_nm_per_a", "resistance_ohm", "inductance_h")
"""Fields of the motor; the others are of the axis."""


def has(axis: Axis, parameter: str) -> bool:
    """True where an axis has this parameter, so that it can deviate."""
    return {
        "torque_constant": axis.effort != "torque",
        "resistance": axis.has_current_loop,
        "inductance": axis.has_current_loop,
        "rotor_inertia": axis.rotor_inertia_kg_m2 > 0.0,
        "moving_mass": axis.moving_mass_kg is not None,
    }.get(parameter, True)


def toleranced(axis: Axis) -> list[str]:
    """Names of the toleranced parameters that an axis has."""
    return [name for name in TOLERANCED if has(axis, name)]


def field_value(axis: Axis, parameter: str) -> float:
    """Value of a toleranced parameter of an axis."""
    field = TOLERANCED[parameter]
    return float(getattr(axis.motor if hasattr(axis.motor, field) else axis, field))


def file_keys(axis_table: dict[str, object], parameter: str) -> list[str]:
    """Keys of a machine file's [axis.NAME] table that hold a toleranced parameter, as far as the table has them."""
    if parameter == "rotor_inertia":
        return [key for key in axis_table if key.startswith("rotor_")]
    field = TOLERANCED[parameter]
    part = axis_table.get("motor", {}) if field in OF_MOTOR else axis_table
    return [f"motor.{field}" if field in OF_MOTOR else field] if isinstance(part, dict) and field in part else []
