"""The keys of a machine file: what may stand where, within which bounds, and how it becomes SI.

The unit stands in the key (`max_velocity_m_per_min`); `si_from_key` reads it from there, so that a conversion is
typed once. A key that is missing, misspelt or impossible is reported with its table and the nearest match.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any

from twin.errors import InputError, nearest

INFINITE = math.inf


@dataclass(frozen=True)
class Key:
    """One number of a machine file: bounds in the file's own unit, and whether it may be left out."""

    low: float = -INFINITE
    high: float = INFINITE
    required: bool = True
    above: bool = False  # the lower bound itself is impossible (a mass of 0)
    count: int = 1  # how many numbers


def positive(required: bool = True) -> Key:
    return Key(low=0.0, above=True, required=required)


def not_negative(required: bool = True) -> Key:
    return Key(low=0.0, required=required)


TOP = {"gravity_m_per_s2": not_negative(), "parameter_tolerance": Key(0.0, 1.0, required=False)}

CONTROL = {
    "current_cycle_us": positive(),
    "speed_cycle_us": positive(),
    "position_cycle_us": positive(),
    "interpolation_cycle_us": positive(required=False),
}

GEOMETRY = {
    "a_axis_to_c_axis_y_m": Key(required=False),
    "a_axis_to_c_axis_z_m": Key(required=False),
    "table_top_above_a_axis_m": Key(required=False),
    "spindle_nose_at_home_m": Key(count=3, required=False),
    "tool_length_m": not_negative(required=False),
}

AXIS_COMMON = {"coulomb_friction_nm": not_negative(), "viscous_friction_nm_s_per_rad": not_negative()}

AXIS = {
    "linear": {
        "travel_m": Key(count=2),
        "max_velocity_m_per_min": positive(),
        "max_acceleration_m_per_s2": positive(),
        "max_jerk_m_per_s3": positive(),
        "screw_lead_m_per_rev": positive(),
        "moving_mass_kg": positive(),
        "rotor_and_screw_inertia_kg_m2": positive(),
        **AXIS_COMMON,
    },
    "rotary": {
        "travel_deg": Key(count=2),  # or "endless"
        "max_velocity_rev_per_min": positive(),
        "max_acceleration_rev_per_s2": positive(),
        "max_jerk_rev_per_s3": positive(),
        "gear_ratio": positive(),
        "rotor_and_gear_inertia_kg_m2": positive(),
        **AXIS_COMMON,
    },
}

MOTOR = {
    "torque_constant_nm_per_a": positive(),
    "back_emf_v_s_per_rad": not_negative(),
    "resistance_ohm": positive(),
    "inductance_h": positive(),
    "peak_current_a": positive(),
    "bus_limit_v": positive(),
}

LOOPS = {
    "position_gain_per_s": positive(),
    "speed_gain_nm_s_per_rad": positive(),
    "speed_integral_time_s": positive(),
    "current_gain_v_per_a": positive(),
    "current_integral_time_s": positive(),
    "velocity_feedforward": Key(-2.0, 2.0),
    "torque_feedforward": Key(-5.0, 5.0),
    "position_delay_s": Key(0.0, 1.0),
    "feedforward_delay_s": Key(0.0, 1.0),
}

# what the control was told when it was commissioned; it keeps these whatever motor and load really are
COMMISSIONED = {"torque_constant_nm_per_a": positive(required=False), "inertia_kg_m2": positive(required=False)}

BODY = {"mass_kg": positive(), "centre_of_mass_m": Key(count=3), "inertia_kg_m2": Key(low=0.0, above=True, count=3)}

MEASUREMENT = {
    "sample_period_us": positive(),
    "linear_scale_noise_m": not_negative(required=False),
    "linear_scale_resolution_m": not_negative(required=False),
    "rotary_encoder_noise_deg": not_negative(required=False),
    "rotary_encoder_resolution_deg": not_negative(required=False),
    "motor_encoder_resolution_m": not_negative(required=False),
    "motor_encoder_resolution_rad": not_negative(required=False),
    "speed_noise_m_per_s": not_negative(required=False),
    "speed_noise_deg_per_s": not_negative(required=False),
    "current_noise_a": not_negative(required=False),
}

# longest first: '_rev_per_s2' must not be read as '_per_s'
_SUFFIX_TO_SI = {
    "_deg_per_s": math.pi / 180.0,
    "_rev_per_min": 2.0 * math.pi / 60.0,
    "_rev_per_s2": 2.0 * math.pi,
    "_rev_per_s3": 2.0 * math.pi,
    "_m_per_min": 1.0 / 60.0,
    "_deg": math.pi / 180.0,
    "_us": 1e-6,
}


def si_from_key(key: str) -> float:
    """Factor to SI that the unit at the end of a key asks for (1 where the unit is SI already)."""
    for suffix, factor in _SUFFIX_TO_SI.items():
        if key.endswith(suffix):
            return factor
    return 1.0


def check_table(table: Mapping[str, Any], keys: Mapping[str, Key], where: str, also: tuple[str, ...] = ()) -> None:
    """Each key known, each required one there, each value possible; `also` names keys that are checked elsewhere."""
    for given in table:
        if given not in keys and given not in also:
            raise InputError(f"{where}: unknown key '{given}'; {nearest(given, [*keys, *also])}")
    for name, key in keys.items():
        if name in table:
            _check_value(table[name], key, f"{where}: {name}")
        elif key.required:
            raise InputError(f"{where}: '{name}' is missing; add it")


def _check_value(value: Any, key: Key, where: str) -> None:
    values = value if isinstance(value, list) else [value]
    if len(values) != key.count or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
        raise InputError(f"{where} = {value!r}: expected {'a number' if key.count == 1 else f'{key.count} numbers'}")
    for v in values:
        if not math.isfinite(v) or v < key.low or v > key.high or (key.above and v == key.low):
            low = f"above {key.low:g}" if key.above else f"at least {key.low:g}"
            bounds = " and ".join(([low] if key.low > -INFINITE else []) + ([f"at most {key.high:g}"] if key.high < INFINITE else []))
            raise InputError(f"{where} = {v:g}: impossible; give a number {bounds or 'that is finite'}")
