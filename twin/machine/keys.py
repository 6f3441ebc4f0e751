"""The keys of a machine file: which table may have which key, and the bounds of each number.

Axis keys come from `twin.machine.parameters`. Errors name the table and, for an unknown key, the nearest known one.
"""

from collections.abc import Iterable, Mapping
import functools
import math
from typing import Any

from twin.control.actuator import EFFORTS
from twin.control.number import Key, Parameter, not_negative, positive
from twin.control.structures import STRUCTURES
from twin.errors import InputError
from twin.machine.parameters import PARAMETERS
from twin.tables import known_keys

WORDS = {"encoder": ("scale", "motor"), "friction_side": ("load", "motor")}
"""Optional words of an axis; the first one is the default."""
DRIVES = {"linear": ("screw", "direct"), "rotary": ("gear",)}

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


@functools.cache
def numbers_of_axis(structure: str, command: str) -> tuple[Parameter, ...]:
    """The numbers of an axis of this structure."""
    return STRUCTURES[structure].numbers(PARAMETERS, command)


def drive_of(table: Mapping[str, Any]) -> str:
    """The drive of an axis table: 'direct', or the one of its kind."""
    return "direct" if table.get("drive") == "direct" else DRIVES[table["kind"]][0]


def tables_of_axis(drive: str, numbers: Iterable[Parameter]) -> dict[str, dict[str, Key]]:
    """Keys of an axis table ('') and of each table below it, with their bounds."""
    tables: dict[str, dict[str, Key]] = {"": {}}
    for p in numbers:
        part, _, leaf = p.key(drive).rpartition(".")
        if leaf:
            tables.setdefault(part, {})[leaf] = p.bounds
    if drive == "direct":
        tables[""]["rotor_mass_kg"] = not_negative(required=False)
    return tables


_BY_KEY = {key: p for p in (*PARAMETERS, *(p for e in EFFORTS.values() for p in (e.peak, *e.constant))) for key in (p.screw, p.gear) if key}


def key_in_file(table: Mapping[str, Any], key: str) -> str:
    """Key below this axis of a number that is named by its key for a screw or gear with a motor."""
    p = _BY_KEY.get(key)
    if "actuator" not in table:
        return (p and p.key(drive_of(table))) or key
    effort = EFFORTS[table["actuator"]["command"]]
    p = next((own for own in (effort.peak, *effort.constant) if p and own.field == p.field), p)
    return ((p and p.key(drive_of(table))) or key).replace("motor.", "actuator.")


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
    known_keys(table, [*keys, *also], where)
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
            bounds = " and ".join(([low] if key.low > -math.inf else []) + ([f"at most {key.high:g}"] if key.high < math.inf else []))
            raise InputError(f"{where} = {v:g}: impossible; give a number {bounds or 'that is finite'}")
        if key.whole and v % 1.0:
            raise InputError(f"{where} = {v:g}: expected a whole number")
        if v and not SMALLEST <= abs(v) <= LARGEST:
            raise InputError(f"{where} = {v:g}: no machine has such a number; give one between {SMALLEST:g} and {LARGEST:g}")
