"""The keys of a machine file: what may stand where, within which bounds, and how it becomes SI.

The unit stands in the key (`max_velocity_m_per_min`); `si_from_key` reads it from there, so that a conversion is
typed once. A key that is missing, misspelt or impossible is reported with its table and the nearest match.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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


STRUCTURES = ("P/PI/PI", "P/PI", "P/P")
"""Position, speed and current controller of an axis; the first is a servo drive, the others end in an ideal actuator."""

ENCODERS = ("scale", "motor")
DRIVES = {"linear": ("screw", "direct"), "rotary": ("gear",)}


@dataclass(frozen=True)
class Effort:
    """What a speed controller commands: its unit, and the keys of an `[axis.N.actuator]` that takes it."""

    unit: str
    constant: str  # torque per unit of the command ('' where the command is the torque)
    peak: str


EFFORTS = {
    "current": Effort("A", "torque_constant_nm_per_a", "peak_current_a"),
    "voltage": Effort("V", "torque_constant_nm_per_v", "peak_voltage_v"),
    "torque": Effort("Nm", "", "peak_torque_nm"),
}

TOP = {"gravity_m_per_s2": not_negative(), "parameter_tolerance": Key(0.0, 1.0, required=False)}

CONTROL = {
    "current_cycle_us": positive(required=False),  # required where an axis has a current loop
    "speed_cycle_us": positive(),
    "position_cycle_us": positive(),
    "interpolation_cycle_us": positive(required=False),
}

INTERPOLATIONS = ("cubic", "linear")
"""How a set point between two position cycles is made; the first is the default."""

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

MOST_MEAN_CYCLES = 16
"""Speed cycles over which a position may be differentiated."""

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
    "dsc_delay_s": Key(0.0, 1.0, required=False),
    "speed_mean_cycles": Key(0.0, MOST_MEAN_CYCLES, required=False),
    "speed_filter_time_s": Key(0.0, 1.0, required=False),
}

# what the control was told when it was commissioned; it keeps these whatever motor and load really are
COMMISSIONED = {"torque_constant_nm_per_a": positive(required=False), "inertia_kg_m2": positive(required=False)}

SPEED_GAIN = "speed_gain_nm_s_per_rad"

# a linear axis with a direct drive has its numbers at the axis; the same numbers under these names
DIRECT = {
    "coulomb_friction_nm": "coulomb_friction_n",
    "viscous_friction_nm_s_per_rad": "viscous_friction_n_s_per_m",
    "rotor_and_screw_inertia_kg_m2": "rotor_mass_kg",
    "torque_constant_nm_per_a": "force_constant_n_per_a",
    "torque_constant_nm_per_v": "force_constant_n_per_v",
    "peak_torque_nm": "peak_force_n",
    "back_emf_v_s_per_rad": "back_emf_v_s_per_m",
    SPEED_GAIN: "speed_gain_n_s_per_m",
    "inertia_kg_m2": "mass_kg",
}
_CANONICAL = {direct: plain for plain, direct in DIRECT.items()}


def canonical(table: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a directly driven axis under the names of a screw's."""
    return {_CANONICAL.get(k, k): canonical(v) if isinstance(v, dict) else v for k, v in table.items()}


def speed_gains(effort: str) -> tuple[tuple[str, bool, bool], ...]:
    """Units in which a speed gain may stand: key, is it a torque (or the command), is it per axis unit (or per motor radian)."""
    command = {"current": "a", "voltage": "v"}.get(effort)
    own = ((SPEED_GAIN, True, False),)
    return (
        own
        if command is None
        else (*own, (f"speed_gain_{command}_s_per_rad", False, False), (f"speed_gain_{command}_s_per_m", False, True))
    )


def tables_of_axis(
    kind: str, direct: bool, structure: str, table: Mapping[str, Any], where: str
) -> tuple[dict[str, Key], dict[str, dict[str, Key]]]:
    """Keys of an axis table and of the tables below it, for its kind, drive and structure."""
    own = dict(AXIS[kind])
    parts = {"motor": dict(MOTOR), "loops": dict(LOOPS), "commissioned": dict(COMMISSIONED)}
    if structure != STRUCTURES[0]:
        actuator = table.get("actuator")
        command = actuator.get("command") if isinstance(actuator, dict) else "torque"
        if command not in EFFORTS:
            raise InputError(f"{where[:-1]}.actuator]: command = {command!r}; {nearest(str(command), EFFORTS)}")
        effort = EFFORTS[command]
        loops = {k: replace(v, required=k == "position_gain_per_s") for k, v in LOOPS.items() if not k.startswith(("speed_i", "current_"))}
        loops |= {k: positive(required=False) for k, _, per_metre in speed_gains(command) if kind == "linear" or not per_metre}
        if structure == "P/PI":
            loops["speed_integral_time_s"] = positive()
        constant = [effort.constant] if effort.constant else []
        parts = {
            "actuator": {k: positive() for k in (*constant, effort.peak)},
            "loops": loops,
            "commissioned": {k: positive(required=False) for k in (*constant, "inertia_kg_m2")},
        }
    if direct:
        del own["screw_lead_m_per_rev"]
        own["rotor_and_screw_inertia_kg_m2"] = not_negative(required=False)
        own = {DIRECT.get(k, k): v for k, v in own.items()}
        parts = {
            part: {DIRECT.get(k, k): v for k, v in known.items() if not k.endswith(("v_s_per_rad", "a_s_per_rad")) or k in DIRECT}
            for part, known in parts.items()
        }
    return own, parts


def path_in_file(document: Mapping[str, Any], path: str) -> str:
    """Where a number of an axis stands in this file: a direct drive and an actuator have other names for it."""
    parts = path.split(".")
    axis = document.get("axis", {}).get(parts[1]) if parts[0] == "axis" and len(parts) > 2 else None
    if not isinstance(axis, Mapping):
        return path
    if parts[2] == "motor" and "actuator" in axis:
        effort = EFFORTS[axis["actuator"]["command"]]
        parts[2] = "actuator"
        parts[-1] = {"torque_constant_nm_per_a": effort.constant or parts[-1], "peak_current_a": effort.peak}.get(parts[-1], parts[-1])
    if axis.get("drive") == "direct":
        parts[-1] = DIRECT.get(parts[-1], parts[-1])
    return ".".join(parts)


BODY = {"mass_kg": positive(), "centre_of_mass_m": Key(count=3), "inertia_kg_m2": Key(low=0.0, above=True, count=3)}

TOOL = {"length_m": not_negative()}

MEASUREMENT = {
    "sample_period_us": positive(),
    "linear_scale_noise_m": not_negative(required=False),
    "linear_scale_resolution_m": not_negative(required=False),
    "rotary_encoder_noise_deg": not_negative(required=False),
    "rotary_encoder_resolution_deg": not_negative(required=False),
    "motor_encoder_noise_m": not_negative(required=False),
    "motor_encoder_noise_rad": not_negative(required=False),
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
