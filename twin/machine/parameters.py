"""The table of all numbers of an axis: typed field, key in the machine file, bounds, SINUMERIK machine datum.

The key contains the unit (`max_velocity_m_per_min`). An axis has one of three drives, each with its own keys:

screw    linear axis with a ball screw; numbers at the motor
gear     rotary axis; numbers at the motor
direct   linear motor, or linear axis with an unknown screw; numbers at the axis, in N, kg and m/s

All code that handles a number of an axis by name (file, typed view, variants, tolerance, identification, truth) uses this table.
"""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

from twin.control import current_controller, drive_position_loop, position_controller, speed_controller
from twin.control.block import BLOCKS
from twin.control.number import Datum, Key, OnControl, Parameter, Search, held, not_negative, positive, same_key, si_from_key

MOST_MODE_SHARE = 0.95
"""Largest mass share of a structural mode: the mass that the drive moves without delay must not vanish."""


_SPEED = {"sinumerik": OnControl("MD32000 MAX_AX_VELO", ("mm/min", "rev/min"), (1e-3 / 60.0, 2.0 * math.pi / 60.0))}
_ACCELERATION = {"sinumerik": OnControl("MD32300 MAX_AX_ACCEL", ("m/s2", "rev/s2"), (1.0, 2.0 * math.pi))}
_JERK = {"sinumerik": OnControl("MD32431 MAX_AX_JERK", ("m/s3", "rev/s3"), (1.0, 2.0 * math.pi))}


def _of_kind(name: str, linear: str, rotary: str, bounds: Key, data: Mapping[str, OnControl] | None = None, **more: Any) -> Parameter:
    """A number in other units on a linear and on a rotary axis."""
    return Parameter(name, f"{name}_{linear}", f"{name}_{rotary}", f"{name}_{linear}", bounds, data or {}, **more)


PARAMETERS = (
    _of_kind("travel", "m", "deg", Key(count=2)),
    _of_kind("max_velocity", "m_per_min", "rev_per_min", positive(), _SPEED),
    _of_kind("max_acceleration", "m_per_s2", "rev_per_s2", positive(), _ACCELERATION),
    _of_kind("max_jerk", "m_per_s3", "rev_per_s3", positive(), _JERK),
    Parameter("ratio", "screw_lead_m_per_rev", "gear_ratio", "", positive()),
    Parameter("moving_mass_kg", "moving_mass_kg", "", "moving_mass_kg", positive()),
    Parameter("rotor_inertia_kg_m2", "rotor_and_screw_inertia_kg_m2", "rotor_and_gear_inertia_kg_m2", "rotor_mass_kg", positive()),
    same_key("coulomb_friction_nm", not_negative(), direct="coulomb_friction_n", search=Search()),
    same_key("viscous_friction_nm_s_per_rad", not_negative(), direct="viscous_friction_n_s_per_m", search=Search()),
    same_key("constant_torque_nm", Key(required=False), direct="constant_force_n"),
    same_key("other_side_friction", Key(0.0, 1.0, required=False)),
    _of_kind("presliding_stiffness", "n_per_m", "nm_per_rad", not_negative(required=False), search=Search()),
    # a structural mode in the direction of the axis; without a mass share there is none
    same_key("mode_frequency_hz", Key(0.0, 500.0, required=False), search=Search(low=5.0, high=200.0)),
    same_key("mode_mass_share", Key(0.0, MOST_MODE_SHARE, required=False), search=Search(low=1e-3, high=MOST_MODE_SHARE)),
    same_key("mode_damping_ratio", Key(0.0, 1.0, required=False), search=Search(low=2e-3, high=0.5)),
    *current_controller.MOTOR,
    *position_controller.PARAMETERS,
    *speed_controller.PARAMETERS,
    *current_controller.PARAMETERS,
    *drive_position_loop.PARAMETERS,
    # values of the commissioning; they do not change with motor and load
    same_key(
        "commissioned.torque_constant_nm_per_a",
        positive(required=False),
        field="commissioned_torque_constant",
        direct="force_constant_n_per_a",
    ),
    same_key(
        "commissioned.inertia_kg_m2",
        positive(required=False),
        held(sinumerik=("MD32650 AX_INERTIA", "kgm2", 1.0)),
        field="commissioned_inertia",
        direct="mass_kg",
    ),
)

SPREAD = {
    "torque_constant": "motor.torque_constant_nm_per_a",
    "resistance": "motor.resistance_ohm",
    "inductance": "motor.inductance_h",
    "rotor_inertia": "rotor_inertia_kg_m2",
    "moving_mass": "moving_mass_kg",
    "coulomb_friction": "coulomb_friction_nm",
    "viscous_friction": "viscous_friction_nm_s_per_rad",
}
"""Quantities that vary between machines within `parameter_tolerance`: name in a truth file -> field."""

_BY_FIELD = {p.field: p for p in PARAMETERS} | {p.field.rsplit(".", 1)[-1]: p for p in PARAMETERS}


def parameter(field: str) -> Parameter:
    """The parameter of a typed field, with or without its table (`motor.resistance_ohm`, `resistance_ohm`), or of a listed block
    (`block.pid.integral`). Raises KeyError if unknown."""
    if not field.startswith("block."):
        return _BY_FIELD[field]
    table, _, name = field.rpartition(".")
    number = {n.field: n for n in BLOCKS[table.removeprefix("block.")].numbers}[name]
    return replace(number, field=field, screw=f"{table}.{number.screw}", gear=f"{table}.{number.gear}", direct=f"{table}.{number.direct}")


def field_key(field: str, drive: str) -> str:
    """Key below `[axis.N]` of a typed field for this drive; any other text is a key itself."""
    return _BY_FIELD[field].key(drive) if field in _BY_FIELD else field


def key_of(field: str, kind: str) -> str:
    """Key below `[axis.N]` of a field for a screw (linear) or gear (rotary) axis: 'motor.resistance_ohm'."""
    return parameter(field).key("screw" if kind == "linear" else "gear")


def machine_data_of(kind: str) -> tuple[Datum, ...]:
    """Machine data of a linear or rotary axis, with the keys that they replace."""
    out, rotary = [], kind == "rotary"
    for p in PARAMETERS:
        if datum := p.data.get("sinumerik"):
            key, name = key_of(p.field, kind), datum.name.removeprefix(datum.code).strip()
            out.append(Datum(int(datum.code[2:]), name, datum.units[rotary], key, datum.si[rotary] / si_from_key(key)))
        if p.field == "ratio":
            lead = Datum(31030, "LEADSCREW_PITCH", "mm/rev", "screw_lead_m_per_rev", 1e-3)
            out.append(Datum(31060, "DRIVE_AX_RATIO_NUMERA", "1", "gear_ratio", 1.0) if rotary else lead)
        if p.field == "travel":
            key, unit, factor = ("travel_m", "mm", 1e-3) if kind == "linear" else ("travel_deg", "deg", 1.0)
            out += [Datum(36100, "POS_LIMIT_MINUS", unit, f"{key}.0", factor), Datum(36110, "POS_LIMIT_PLUS", unit, f"{key}.1", factor)]
    return tuple(out)


def typed_from_file(key: str, value: float) -> float:
    """Value of the typed field for a number of the file: SI; a lead or gear ratio becomes axis units per motor radian."""
    if key == "screw_lead_m_per_rev":
        return value / (2.0 * math.pi)
    return 1.0 / value if key == "gear_ratio" else value * si_from_key(key)


def file_from_typed(key: str, value: float) -> float:
    """Number of the file for the value of a typed field."""
    if key == "screw_lead_m_per_rev":
        return value * 2.0 * math.pi
    return 1.0 / value if key == "gear_ratio" else value / si_from_key(key)
