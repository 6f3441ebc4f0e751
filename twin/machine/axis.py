"""One axis of a machine file: its typed view in SI, and how it is read from its table.

An axis has one of the structures of `machine_keys.STRUCTURES`. P/PI/PI is the cascade of a servo drive with `[axis.N.motor]`;
P/PI and P/P end in a speed controller whose command an ideal actuator turns into torque, `[axis.N.actuator]`. A linear
axis with `drive = "direct"` (linear motor, or a screw that nobody knows) has all its numbers at the axis: metre, N and kg
stand in for motor radian, Nm and kg m2, so that `ratio` is 1. Machine data of a Sinumerik may stand for plain keys.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Any

from twin.errors import InputError, nearest
from twin.machine import keys, sinumerik


@dataclass(frozen=True)
class Motor:
    """Synchronous servo motor as its control sees it: torque = torque_constant * current (Nm, A), one phase equivalent.

    Of an axis without current loop only torque constant and peak count, per unit of its command (`Axis.effort`).
    """

    torque_constant_nm_per_a: float
    back_emf_v_s_per_rad: float = 0.0
    resistance_ohm: float = 1.0
    inductance_h: float = 1.0
    peak_current_a: float = math.inf
    bus_limit_v: float = math.inf


@dataclass(frozen=True)
class Loops:
    """Gains of the cascade, feedforward weights (0 switches off) and delays of the set point.

    `dsc_delay_s` > 0: the drive closes the position loop (dynamic servo control); the NC's command reaches it so much later.

    `speed_mean_cycles` n > 0: the speed is not measured but differentiated from the motor encoder, (q(k) - q(k-n)) / (n Ts);
    `speed_filter_time_s`: first-order lag of the speed that the controller sees (0: none).
    """

    position_gain_per_s: float
    speed_gain_nm_s_per_rad: float
    speed_integral_time_s: float = math.inf
    current_gain_v_per_a: float = 0.0
    current_integral_time_s: float = math.inf
    velocity_feedforward: float = 0.0
    torque_feedforward: float = 0.0
    position_delay_s: float = 0.0
    feedforward_delay_s: float = 0.0
    dsc_delay_s: float = 0.0
    speed_mean_cycles: int = 0
    speed_filter_time_s: float = 0.0


@dataclass(frozen=True)
class Axis:
    """One axis in SI: positions in m or rad at the axis, torques and inertias at the motor.

    `ratio` is axis units per motor radian: lead / 2 pi for a screw, 1 / gear ratio for a gear, 1 for a direct drive.
    `commissioned_torque_constant` and `commissioned_inertia` are what the control was told (None: the motor's own,
    and the model's inertia at the motor in the home pose); the control keeps them whatever the load really is.
    `effort` names the signal that the speed controller commands: current, voltage or torque. `encoder` says which measuring
    system closes the position loop: scale (at the load) or motor.
    """

    name: str
    kind: str
    travel: tuple[float, float]
    max_velocity: float
    max_acceleration: float
    max_jerk: float
    ratio: float
    moving_mass_kg: float | None
    rotor_inertia_kg_m2: float
    coulomb_friction_nm: float
    viscous_friction_nm_s_per_rad: float
    motor: Motor
    loops: Loops
    commissioned_torque_constant: float | None = None
    commissioned_inertia: float | None = None
    structure: str = keys.STRUCTURES[0]
    effort: str = "current"
    encoder: str = "scale"

    @property
    def has_current_loop(self) -> bool:
        """Is there a current controller with a winding behind the speed controller?"""
        return self.structure == keys.STRUCTURES[0]

    @property
    def has_speed_integral(self) -> bool:
        """Does the speed controller carry a constant force by itself?"""
        return math.isfinite(self.loops.speed_integral_time_s)

    @property
    def effort_unit(self) -> str:
        """Unit of the effort: A, V or Nm."""
        return keys.EFFORTS[self.effort].unit

    @property
    def coulomb_friction(self) -> float:
        """Coulomb friction at the axis [N or Nm]."""
        return self.coulomb_friction_nm / self.ratio

    @property
    def viscous_friction(self) -> float:
        """Viscous friction at the axis [N s/m or Nm s/rad]."""
        return self.viscous_friction_nm_s_per_rad / self.ratio**2

    @property
    def reflected_inertia(self) -> float:
        """Rotor and screw or gear as seen at the axis [kg or kg m2]."""
        return self.rotor_inertia_kg_m2 / self.ratio**2

    @property
    def told_torque_constant(self) -> float:
        """Torque constant by which the control turns torques into currents [Nm/A]: what it was told, or the motor's own."""
        return self.commissioned_torque_constant or self.motor.torque_constant_nm_per_a


def axis_of_table(name: str, table: Any, where: str) -> Axis:
    """A checked Axis from `[axis.NAME]`; every fault is an InputError that names table and key."""
    if not isinstance(table, dict):
        raise InputError(f"{where}: must be a table")
    kind = table.get("kind")
    if kind not in keys.AXIS:
        raise InputError(f"{where}: kind = {kind!r}; use 'linear' or 'rotary'")
    if "sinumerik" in table:
        table = sinumerik.completed(table, where)
    structure = _word(table, "structure", keys.STRUCTURES, where)
    encoder = _word(table, "encoder", keys.ENCODERS, where)
    direct = _word(table, "drive", keys.DRIVES[kind], where) == "direct"
    own, parts = keys.tables_of_axis(kind, direct, structure, table, where)
    endless = table.get("travel_deg") == "endless"
    if endless:
        del own["travel_deg"]
    keys.check_table(table, own, where, ("kind", "travel_deg", "structure", "encoder", "drive", *parts))
    for part, part_keys in parts.items():
        if part not in table and part != "commissioned":
            raise InputError(f"{where}: table [axis.{name}.{part}] is missing; add it")
        if not isinstance(table.get(part, {}), dict):
            raise InputError(f"{where[:-1]}.{part}]: must be a table")
        also = ("command",) if part == "actuator" else ()
        keys.check_table(table.get(part, {}), part_keys, f"{where[:-1]}.{part}]", also)

    plain = keys.canonical(table) if direct else dict(table)
    si = {k: plain[k] * keys.si_from_key(k) for k, v in plain.items() if isinstance(v, int | float) and not isinstance(v, bool)}
    if kind == "linear":
        motion = {q: si[k] for q, k in zip(_MOTION, ("max_velocity_m_per_min", "max_acceleration_m_per_s2", "max_jerk_m_per_s3"))}
        ratio = 1.0 if direct else si["screw_lead_m_per_rev"] / (2.0 * math.pi)
        rotor = si.get("rotor_and_screw_inertia_kg_m2", 0.0)
    else:
        motion = {q: si[k] for q, k in zip(_MOTION, ("max_velocity_rev_per_min", "max_acceleration_rev_per_s2", "max_jerk_rev_per_s3"))}
        ratio, rotor = 1.0 / si["gear_ratio"], si["rotor_and_gear_inertia_kg_m2"]

    loops = {k: float(v) for k, v in plain["loops"].items()}
    commissioned = plain.get("commissioned", {})
    if structure == keys.STRUCTURES[0]:
        effort, motor = "current", Motor(**{k: float(v) for k, v in plain["motor"].items()})
        told = commissioned.get("torque_constant_nm_per_a")
    else:
        effort, motor = _actuator(plain["actuator"])
        # a gain that stands there per unit of the command stays what it is, whatever the actuator makes of it
        told = float(commissioned.get(keys.EFFORTS[effort].constant, motor.torque_constant_nm_per_a))
        loops = _speed_gain(loops, effort, told, ratio, f"{where[:-1]}.loops]")
    if loops.get("speed_mean_cycles", 0.0) % 1.0:
        raise InputError(f"{where[:-1]}.loops]: speed_mean_cycles = {loops['speed_mean_cycles']:g}: expected a whole number")
    return Axis(
        name=name,
        kind=kind,
        travel=(-math.inf, math.inf) if endless else _travel(table, kind, where),
        **motion,
        ratio=ratio,
        moving_mass_kg=si.get("moving_mass_kg"),
        rotor_inertia_kg_m2=rotor,
        coulomb_friction_nm=si["coulomb_friction_nm"],
        viscous_friction_nm_s_per_rad=si["viscous_friction_nm_s_per_rad"],
        motor=motor,
        loops=replace(Loops(**loops), speed_mean_cycles=int(loops.get("speed_mean_cycles", 0))),  # type: ignore[arg-type]
        commissioned_torque_constant=told,
        commissioned_inertia=commissioned.get("inertia_kg_m2"),
        structure=structure,
        effort=effort,
        encoder=encoder,
    )


_MOTION = ("max_velocity", "max_acceleration", "max_jerk")


def _word(table: Mapping[str, Any], key: str, known: tuple[str, ...], where: str) -> str:
    """A word of the table; the first known one where it is left out."""
    value = table.get(key, known[0])
    if value not in known:
        raise InputError(f"{where}: {key} = {value!r}; {nearest(str(value), known)}")
    return str(value)


def _actuator(table: Mapping[str, Any]) -> tuple[str, Motor]:
    effort = keys.EFFORTS[table["command"]]
    constant = float(table[effort.constant]) if effort.constant else 1.0
    return str(table["command"]), Motor(constant, peak_current_a=float(table[effort.peak]))


def _speed_gain(loops: dict[str, float], effort: str, told: float, ratio: float, where: str) -> dict[str, float]:
    """The speed gain in Nm s/rad, whichever of its units the file has: per motor radian or per axis unit, torque or command."""
    factors = {k: (1.0 if torque else told) * (ratio if at_axis else 1.0) for k, torque, at_axis in keys.speed_gains(effort)}
    given = [k for k in factors if k in loops]
    if len(given) != 1:
        told_twice = (
            f"{' and '.join(given)} both stand there; keep one" if given else f"the speed gain is missing; give {next(iter(factors))}"
        )
        raise InputError(f"{where}: {told_twice}")
    value = loops.pop(given[0])
    return {**loops, keys.SPEED_GAIN: value * factors[given[0]]}


def _travel(table: Mapping[str, Any], kind: str, where: str) -> tuple[float, float]:
    key = "travel_m" if kind == "linear" else "travel_deg"
    low, high = (v * keys.si_from_key(key) for v in table[key])
    if low >= high:
        raise InputError(f"{where}: {key} = {table[key]}: the first limit must lie below the second")
    return low, high
