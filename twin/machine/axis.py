"""One axis of a machine file as typed values in SI, and how they are read from its table.

`control.structures` lists the control structures. P/PI/PI is the cascade of a servo drive with `[axis.N.motor]`. In P/PI and P/P an
ideal actuator, `[axis.N.actuator]`, turns the command of the speed controller into torque. A linear axis with
`drive = "direct"` (linear motor, or unknown screw) has all its numbers at the axis: metre, N and kg in place of motor radian, Nm
and kg m2, and `ratio` = 1. SINUMERIK machine data may replace plain keys.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import functools
import math
import re
from typing import Any

from twin.control.actuator import EFFORTS, SPEED_GAIN, Actuator, gain_factor
from twin.control.block import Listed, listed, named_blocks
from twin.control.current_controller import Motor
from twin.control.number import si_from_key
from twin.control.structures import STRUCTURES, Loops
from twin.errors import InputError, nearest
from twin.machine import keys, sinumerik
from twin.machine.parameters import SPREAD, key_of, typed_from_file

LONGEST_UNIT = 16
"""Most characters of a `force_unit`."""


@dataclass(frozen=True)
class Axis:
    """One axis in SI: positions in m or rad at the axis, torques and inertias at the motor.

    drive                         screw, gear or direct: what turns the motor into motion of the axis (keys of `twin.machine.parameters`)
    ratio                         axis units per motor radian: lead / 2 pi (screw), 1 / gear ratio (gear), 1 (direct)
    commissioned_torque_constant  [Nm/A] the control divides torques by it; the motor's own if the file omits it
    constant_torque_nm            steady load against +q: counterbalance, hoses, cable drag
    commissioned_inertia          [kg m2 at the motor] of the torque feedforward; None: that of the model in the home pose
    effort                        signal that the speed controller commands: current, voltage or torque
    force_unit                    unit of forces, in place of N and Nm, where the force of a unit of the recorded command is not known
    encoder                       measuring system that closes the position loop: scale (at the load) or motor
    blocks                        blocks of its control that the file lists beside the structure, in the order of their action
    friction_side                 where friction acts if an elastic drive train separates motor and load: load (guideways) or motor (gear of a robot)
    other_side_friction           share of the friction that acts on the other side then; effects of friction act on `friction_side`
    presliding_stiffness          [N/m or Nm/rad at the axis] of friction below break-away, as in the effect of that name, which takes its place; 0: rigid
    mode_frequency_hz             natural frequency of a structural mode in the axis' direction with the axis held (bed on its mounts, carried part)
    mode_mass_share               m / (M + m) of the axis' mass m and the bed's M, or share of a swinging part in the moving mass; 0: no mode
    mode_damping_ratio            damping ratio of this mode
    """

    name: str
    kind: str
    drive: str
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
    commissioned_torque_constant: float
    constant_torque_nm: float = 0.0
    commissioned_inertia: float | None = None
    structure: str = next(iter(STRUCTURES))
    effort: str = "current"
    encoder: str = "scale"
    friction_side: str = "load"
    other_side_friction: float = 0.0
    force_unit: str = ""
    blocks: tuple[Listed, ...] = ()
    presliding_stiffness: float = 0.0
    mode_frequency_hz: float = 0.0
    mode_mass_share: float = 0.0
    mode_damping_ratio: float = 0.0

    def friction_share(self, side: str) -> float:
        """Share of the friction on one side of an elastic drive train, "load" or "motor"."""
        return 1.0 - self.other_side_friction if side == self.friction_side else self.other_side_friction

    @property
    def actuator(self) -> Actuator:
        """What turns the output of the speed controller into torque."""
        return STRUCTURES[self.structure].actuator

    def number(self, field: str) -> float:
        """A field of the axis, its motor or its loops, with or without its table, or 'block.NAME.NUMBER', 0 without the block [SI]."""
        if field.startswith("block."):
            _, block, name = field.split(".")
            return next((one.values.get(name, 0.0) for one in self.blocks if one.block.name == block), 0.0)
        name = field.rsplit(".", 1)[-1]
        return float(next(getattr(part, name) for part in (self, self.motor, self.loops) if hasattr(part, name)))

    @property
    def effort_has_noise(self) -> bool:
        """Whether a record of the effort has noise of its own."""
        return EFFORTS[self.effort].noisy

    def recorded_as(self, signal: str) -> str:
        """Name of a signal in a trace: that of the axis' own effort for 'current', otherwise the same."""
        return self.effort if signal == "current" else signal

    @property
    def command(self) -> str:
        """Signal that the speed controller gives: the set point of a current, or the effort itself."""
        return EFFORTS[self.effort].output

    @property
    def has_constant(self) -> bool:
        """False if the effort is the torque or force itself."""
        return bool(EFFORTS[self.effort].constant)

    @property
    def effort_unit(self) -> str:
        """Unit of the effort: A, V or Nm; N instead of Nm for a direct drive; `force_unit` if it has one."""
        return self.force_unit or (EFFORTS[self.effort].unit if self.has_constant else self.motor_unit)

    @property
    def motor_unit(self) -> str:
        """Unit of the motor's output: Nm; N for a direct drive; `force_unit` if it has one."""
        return self.force_unit or ("N" if self.drive == "direct" else "Nm")

    def unit(self, si: str) -> str:
        """An SI unit at this axis: `force_unit`, if it has one, takes the place of N and Nm, also in those of mass and inertia."""
        if not self.force_unit:
            return si
        masses = {"kg": "N s2/m"} if self.kind == "linear" else {"kg m2": "Nm s2/rad", "kg": "Nm s2/m2"}
        return re.sub(r"\bNm?\b", lambda _: self.force_unit, masses.get(si, si))

    @property
    def coulomb_friction(self) -> float:
        """Coulomb friction at the axis [N or Nm]."""
        return self.coulomb_friction_nm / self.ratio

    @property
    def viscous_friction(self) -> float:
        """Viscous friction at the axis [N s/m or Nm s/rad]."""
        return self.viscous_friction_nm_s_per_rad / self.ratio**2

    @property
    def constant_force(self) -> float:
        """Steady load against +q at the axis [N or Nm]."""
        return self.constant_torque_nm / self.ratio

    @property
    def reflected_inertia(self) -> float:
        """Inertia of rotor and screw or gear, referred to the axis [kg or kg m2]."""
        return self.rotor_inertia_kg_m2 / self.ratio**2


def axis_of_table(name: str, table: Any, where: str, checked: bool = True) -> Axis:
    """The Axis of `[axis.NAME]`. Raises InputError that names the table and the key.

    Without `checked`, numbers may lie outside their bounds, because a fit may pass through such values.
    """
    if not isinstance(table, dict):
        raise InputError(f"{where}: must be a table")
    kind = table.get("kind")
    if not isinstance(kind, str) or kind not in keys.DRIVES:
        raise InputError(f"{where}: kind = {kind!r}; use 'linear' or 'rotary'")
    if "sinumerik" in table:
        table = sinumerik.with_plain_keys(table, where)
    structure = word_in(table, "structure", tuple(STRUCTURES), where)
    words = {key: word_in(table, key, allowed, where) for key, allowed in keys.WORDS.items()}
    drive = word_in(table, "drive", keys.DRIVES[kind], where)
    if checked:
        _check_keys(name, kind, drive, structure, table, where)
    effort = STRUCTURES[structure].actuator.command_in(table, where)
    typed = _typed_numbers(table, drive, structure, effort)
    own = {"ratio": 1.0, "moving_mass_kg": None, "rotor_inertia_kg_m2": 0.0} | words | typed[""]
    motor = Motor(**({"torque_constant_nm_per_a": 1.0} | typed["motor"]))
    constant = own.setdefault("commissioned_torque_constant", motor.torque_constant_nm_per_a)
    loops = typed["loops"]
    loops["speed_gain_nm_s_per_rad"] = _speed_gain(table["loops"], drive, effort, constant, own["ratio"], f"{where[:-1]}.loops]")
    return Axis(
        name=name,
        kind=kind,
        drive=drive,
        travel=_travel(table, kind, where),
        motor=motor,
        loops=Loops(**loops),
        structure=structure,
        effort=effort,
        force_unit=_force_unit(table, where),
        blocks=_blocks(name, table, kind, checked),
        **own,
    )


def _blocks(name: str, table: Mapping[str, Any], kind: str, checked: bool) -> tuple[Listed, ...]:
    """The blocks of `[axis.NAME.block]`."""
    if "block" not in table:
        return ()
    import twin.control.library  # noqa: F401 - its laws are compiled: only for machines that list some

    found = named_blocks(table["block"], f"[axis.{name}.block]")
    for block in found if checked else ():
        own = {n.key(kind): n.bounds for n in block.numbers}
        keys.check_table(table["block"][block.name], own, f"[axis.{name}.block.{block.name}]")
    return tuple(listed(block, table["block"][block.name], kind) for block in found)


def _check_keys(name: str, kind: str, drive: str, structure: str, table: Mapping[str, Any], where: str) -> None:
    """Check that every key of an axis and its tables is known, present and possible."""
    parts = keys.tables_of_axis(drive, keys.numbers_of_axis(structure, STRUCTURES[structure].actuator.command_in(table, where)))
    own = parts.pop("")
    endless = kind == "rotary" and table.get("travel_deg") == "endless"
    if endless:
        del own["travel_deg"]
    keys.check_table(
        table, own, where, ("kind", *(["travel_deg"] if endless else []), "structure", "block", *keys.WORDS, "drive", "force_unit", *parts)
    )
    for part, part_keys in parts.items():
        if part not in table and part != "commissioned":
            raise InputError(f"{where}: table [axis.{name}.{part}] is missing; add it")
        also = ("command",) if part == "actuator" else ()
        keys.check_table(table.get(part, {}), part_keys, f"{where[:-1]}.{part}]", also)


@functools.cache
def _places(drive: str, structure: str, effort: str) -> tuple[tuple[str, str, str, str, bool], ...]:
    """(table, key, part of an Axis, field, whole) of each number of such an axis, but of its travel."""
    numbers = [p for p in keys.numbers_of_axis(structure, effort) if p.key(drive) and p.field != "travel"]
    keyed = [(p, p.key(drive).rpartition(".")) for p in numbers]
    return tuple((table, leaf, p.field.rpartition(".")[0], p.name, p.bounds.whole) for p, (table, _, leaf) in keyed)


def _typed_numbers(table: Mapping[str, Any], drive: str, structure: str, effort: str) -> dict[str, dict[str, Any]]:
    """Numbers of an axis table by typed field, for each part of an Axis ('' for the axis itself), in the units of `Axis`."""
    out: dict[str, dict[str, Any]] = {"": {}, "motor": {}, "loops": {}}
    for below, leaf, part, name, whole in _places(drive, structure, effort):
        value = (table.get(below, {}) if below else table).get(leaf)
        if value is not None:
            out[part][name] = int(value) if whole else typed_from_file(leaf, float(value))
    return out


def word_in(table: Mapping[str, Any], key: str, known: tuple[str, ...], where: str) -> str:
    """A choice from the table; the first of `known` if omitted."""
    value = table.get(key, known[0])
    if value not in known:
        raise InputError(f"{where}: {key} = {value!r}; {nearest(str(value), known)}")
    return str(value)


def _force_unit(table: Mapping[str, Any], where: str) -> str:
    """The unit of the recorded command in place of N and Nm, '' without the key."""
    unit = table.get("force_unit", "")
    if not isinstance(unit, str) or not unit.isprintable() or len(unit) > LONGEST_UNIT:
        raise InputError(f'{where}: force_unit = {unit!r}; give the unit of the recorded command as a text, such as "% torque"')
    return unit


def _speed_gain(loops: Mapping[str, float], drive: str, effort: str, constant: float, ratio: float, where: str) -> float:
    """The speed gain in Nm s/rad from any of its units: per motor radian or per axis unit, as torque or as command.

    `constant` is the torque per unit of the command that the control assumes; a gain per unit of the command does not change with the actuator.
    """
    factors = {SPEED_GAIN.key(drive): 1.0} | {p.key(drive): gain_factor(p, constant, ratio) for p in EFFORTS[effort].gains}
    factors = {key.rpartition(".")[2]: factor for key, factor in factors.items() if key}
    given = [key for key in factors if key in loops]
    if len(given) != 1:
        raise InputError(
            f"{where}: {' and '.join(given)} are both given; keep one"
            if given
            else f"{where}: the speed gain is missing; give {next(iter(factors))}"
        )
    return float(loops[given[0]]) * factors[given[0]]


def _travel(table: Mapping[str, Any], kind: str, where: str) -> tuple[float, float]:
    key = "travel_m" if kind == "linear" else "travel_deg"
    if table[key] == "endless":
        return -math.inf, math.inf
    low, high = (v * si_from_key(key) for v in table[key])
    if low >= high:
        raise InputError(f"{where}: {key} = {table[key]}: the first limit must be below the second; correct it")
    return low, high


def toleranced(axis: Axis) -> list[str]:
    """Names of the parameters of an axis that differ from machine to machine within the machine file's `parameter_tolerance`."""
    own = {p.field for p in keys.numbers_of_axis(axis.structure, axis.effort)}
    given = {"rotor_inertia": axis.rotor_inertia_kg_m2 > 0.0, "moving_mass": axis.moving_mass_kg is not None}
    return [name for name, field in SPREAD.items() if field in own and given.get(name, True)]


def inertia_of(axis: Axis) -> str:
    """Name of the toleranced parameter that scales the whole inertia: the rotor's, or the moving mass of a drive without a rotor."""
    return "rotor_inertia" if axis.rotor_inertia_kg_m2 > 0.0 else "moving_mass"


def path_of(axis: Axis, parameter: str) -> str:
    """Path of a toleranced parameter with the key names of a screw or gear; `Machine.in_file` translates it to the file."""
    return f"axis.{axis.name}.{key_of(SPREAD[parameter], axis.kind)}"
