"""The keys of a machine file: which table may have which key, and the bounds of each number.

Axis keys come from `twin.machine.parameters`. Errors name the table and, for an unknown key, the nearest known one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

from twin.control.number import INFINITE, Key, not_negative, positive
from twin.control.structures import STRUCTURES
from twin.errors import InputError, nearest
from twin.machine.parameters import PARAMETERS

WORDS = {"encoder": ("scale", "motor"), "friction_side": ("load", "motor")}
"""Optional words of an axis; the first one is the default."""
DRIVES = {"linear": ("screw", "direct"), "rotary": ("gear",)}


@dataclass(frozen=True)
class Effort:
    """The command of a speed controller: its unit, and the keys of its `[axis.N.actuator]`."""

    unit: str
    constant: str  # torque per unit of the command; '' if the command is a torque
    peak: str


EFFORTS = {
    "current": Effort("A", "torque_constant_nm_per_a", "peak_current_a"),
    "voltage": Effort("V", "torque_constant_nm_per_v", "peak_voltage_v"),
    "torque": Effort("Nm", "", "peak_torque_nm"),
}

TOP = {"gravity_m_per_s2": not_negative(), "parameter_tolerance": Key(0.0, 1.0, required=False)}

SMALLEST, LARGEST = 1e-18, 1e18
"""Smallest and largest magnitude of any number in a machine file, so that squares and quotients stay finite."""

CONTROL = {
    "current_cycle_us": positive(required=False),  # required if an axis has a current loop
    "speed_cycle_us": positive(),
    "position_cycle_us": positive(),
    "interpolation_cycle_us": positive(required=False),
}

INTERPOLATIONS = ("cubic", "linear")
"""Interpolation of set points between position cycles. The first is the default."""

GEOMETRY = {
    "a_axis_to_c_axis_y_m": Key(required=False),
    "a_axis_to_c_axis_z_m": Key(required=False),
    "table_top_above_a_axis_m": Key(required=False),
    "spindle_nose_at_home_m": Key(count=3, required=False),
    "tool_length_m": not_negative(required=False),
}


def _below(table: str, drive: str = "screw") -> dict[str, Key]:
    """Keys of `[axis.N.table]` ('' for `[axis.N]`) with their bounds."""
    keys = [(p.key(drive), p.bounds) for p in PARAMETERS]
    return {key.rsplit(".", 1)[-1]: bounds for key, bounds in keys if key and key.rpartition(".")[0] == table}


AXIS = {"linear": _below(""), "rotary": _below("", "gear")}
MOTOR, LOOPS, COMMISSIONED = (_below(table) for table in ("motor", "loops", "commissioned"))

SPEED_GAIN = "speed_gain_nm_s_per_rad"

DIRECT = {"torque_constant_nm_per_v": "force_constant_n_per_v", "peak_torque_nm": "peak_force_n"} | {
    p.screw.rsplit(".", 1)[-1]: p.direct.rsplit(".", 1)[-1] for p in PARAMETERS if p.direct and p.direct != p.screw
}
"""Key names of a direct drive, whose numbers refer to the axis, by the names that refer to the motor."""

_CANONICAL = {direct: plain for plain, direct in DIRECT.items()}


def canonical(table: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a direct drive with the key names of a screw axis."""
    return {_CANONICAL.get(k, k): canonical(v) if isinstance(v, dict) else v for k, v in table.items()}


def speed_gains(effort: str) -> tuple[tuple[str, bool, bool], ...]:
    """Keys of a speed gain for a command: key; True for torque, False for the command; True per axis unit, False per motor radian."""
    command = {"current": "a", "voltage": "v"}.get(effort)
    own = (SPEED_GAIN, True, False)
    return (own, (f"speed_gain_{command}_s_per_rad", False, False), (f"speed_gain_{command}_s_per_m", False, True)) if command else (own,)


def tables_of_axis(
    kind: str, direct: bool, structure: str, table: Mapping[str, Any], where: str
) -> tuple[dict[str, Key], dict[str, dict[str, Key]]]:
    """Keys of an axis table, and of each table below it, for its kind, drive and structure."""
    own = dict(AXIS[kind])
    control = STRUCTURES[structure]
    loops = {k: v for k, v in LOOPS.items() if k not in control.without}
    parts = {"motor": dict(MOTOR), "loops": loops, "commissioned": dict(COMMISSIONED)}
    if control.actuator.table == "actuator":
        actuator = table.get("actuator")
        command = actuator.get("command") if isinstance(actuator, dict) else "torque"
        if not isinstance(command, str) or command not in EFFORTS:
            raise InputError(f"{where[:-1]}.actuator]: command = {command!r}; {nearest(str(command), EFFORTS)}")
        effort = EFFORTS[command]
        loops = {k: replace(v, required=v.required and v.above) for k, v in loops.items()}  # weights and delays may be left out
        loops |= {k: positive(required=False) for k, _, per_metre in speed_gains(command) if kind == "linear" or not per_metre}
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


BODY = {"mass_kg": positive(), "centre_of_mass_m": Key(count=3), "inertia_kg_m2": Key(low=0.0, above=True, count=3)}

TOOL = {"length_m": not_negative(), "radius_m": not_negative(required=False)}

_OF_NOISE = ("position", "position_resolution", "motor_resolution", "motor", "speed", "current")
NOISE = {
    kind: dict(
        zip(_OF_NOISE, (f"{scale}_noise_{unit}", f"{scale}_resolution_{unit}", *motor, f"speed_noise_{unit}_per_s", "current_noise_a"))
    )
    for kind, scale, unit, motor in (
        ("linear", "linear_scale", "m", ("motor_encoder_resolution_m", "motor_encoder_noise_m")),
        ("rotary", "rotary_encoder", "deg", ("motor_encoder_resolution_rad", "motor_encoder_noise_rad")),
    )
}
"""Keys of `[measurement]` by kind of axis and field of `machine.Noise`."""
MEASUREMENT = {
    "sample_period_us": positive(),
    **{key: not_negative(required=False) for table in NOISE.values() for key in table.values()},
}


def check_table(table: Mapping[str, Any], keys: Mapping[str, Key], where: str, also: tuple[str, ...] = ()) -> None:
    """Check that each key is known, each required key is present and each value is possible. `also`: keys checked elsewhere."""
    if not isinstance(table, Mapping):
        raise InputError(f"{where}: must be a table; write key = value below it")
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
        if v and not SMALLEST <= abs(v) <= LARGEST:
            raise InputError(f"{where} = {v:g}: no machine has such a number; give one between {SMALLEST:g} and {LARGEST:g}")
