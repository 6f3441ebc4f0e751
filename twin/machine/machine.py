"""A machine is data: an MJCF model and a TOML of drives, loops, friction, limits and measuring systems.

`load_machine` reads and checks the file; `Machine.with_values` makes a variant by paths such as
`axis.X.moving_mass_kg`; `write_machine` writes it back with its MJCF beside it. The tables of the file are kept as
they are (`document`), the typed views below are made from them in SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
import copy
from dataclasses import dataclass, field, fields, replace
import functools
import math
from pathlib import Path
import tomllib
from typing import Any

import numpy as np

from twin.errors import InputError, nearest
from twin.machine import keys, sinumerik
from twin.machine.axis import Axis, Loops, Motor, axis_of_table
from twin.machine.model_file import check_mjcf, copy_model

DEFAULT_MACHINE = "mikron_ucp710.toml"
LONGEST_TICK = 125e-6
"""Tick of a machine without current loops, whose file names none [s]: friction that sticks needs a short one."""

OPTIONAL = ("dsc_delay_s", "setpoint_interpolation")
"""Keys that `with_values` adds where the file lacks them."""

FEEDFORWARD = ("off", "velocity", "velocity+torque")


@dataclass(frozen=True)
class Body:
    """A rigid body of the model: mass [kg], centre of mass [m] in its frame, principal inertia about it [kg m2]."""

    name: str
    mass_kg: float
    centre_of_mass_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float]


@dataclass(frozen=True)
class Noise:
    """Measuring noise of one axis in SI: standard deviations, resolutions (0: none); `motor` is the motor encoder's own."""

    position: float
    position_resolution: float
    motor_resolution: float
    speed: float
    current: float
    motor: float = 0.0


@dataclass(frozen=True)
class Machine:
    """A checked machine: axes in the order of the file, and where its MJCF lies.

    `path` is the machine file (None for one made in memory), `model_path` its MJCF.
    """

    name: str
    axes: tuple[Axis, ...]
    bodies: tuple[Body, ...]
    geometry: Mapping[str, Any]
    gravity: float
    parameter_tolerance: float
    current_cycle: float
    speed_cycle: float
    position_cycle: float
    interpolation_cycle: float
    sample_period: float
    model_path: Path
    document: Mapping[str, Any] = field(repr=False)
    path: Path | None = None
    setpoint_interpolation: str = keys.INTERPOLATIONS[0]

    @property
    def axis_names(self) -> tuple[str, ...]:
        return tuple(axis.name for axis in self.axes)

    @property
    def kinds(self) -> dict[str, str]:
        """Axis name -> 'linear' or 'rotary'."""
        return {axis.name: axis.kind for axis in self.axes}

    @property
    def base_tick(self) -> float:
        """The shortest cycle [s]; the others are whole multiples of it."""
        return min(self.current_cycle, self.speed_cycle, self.position_cycle)

    @property
    def effects(self) -> tuple[Mapping[str, Any], ...]:
        """The `[[effect]]` tables as they stand in the file; `twin.effects` gives them their meaning."""
        return tuple(self.document.get("effect", ()))

    def axis(self, name: str) -> Axis:
        """The axis of that name, or an InputError with the nearest one."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise InputError(f"machine {self.name}: no axis {name}; {nearest(name, self.axis_names)}")

    def noise(self, axis: Axis) -> Noise:
        """Measuring noise of an axis, from the table `[measurement]`."""
        table = self.document.get("measurement", {})

        def value(key: str) -> float:
            return float(table.get(key, 0.0)) * keys.si_from_key(key)

        if axis.kind == "linear":
            scale = ("linear_scale_noise_m", "linear_scale_resolution_m", "motor_encoder_resolution_m", "speed_noise_m_per_s")
        else:
            scale = ("rotary_encoder_noise_deg", "rotary_encoder_resolution_deg", "motor_encoder_resolution_rad", "speed_noise_deg_per_s")
        current = value("current_noise_a") if axis.has_current_loop else 0.0  # a command is no measurement
        motor = "motor_encoder_noise_m" if axis.kind == "linear" else "motor_encoder_noise_rad"
        position, position_resolution, motor_resolution, speed = (value(key) for key in scale)
        return Noise(position, position_resolution, motor_resolution, speed, current, value(motor))

    def with_axes(self, names: Sequence[str]) -> Machine:
        """The same machine with only these axes driven; the others stand still."""
        for name in names:
            self.axis(name)
        return replace(self, axes=tuple(axis for axis in self.axes if axis.name in names))

    def with_axis(self, name: str, **changes: Any) -> Machine:
        """A variant in which the fields of one axis, its `motor` or `loops` are replaced (by field name)."""
        axis = self.axis(name)
        parts = {part: {k: changes.pop(k) for k in list(changes) if k in _names(cls)} for part, cls in (("motor", Motor), ("loops", Loops))}
        for part, values in parts.items():
            if values:
                changes[part] = replace(getattr(axis, part), **values)
        changed = replace(axis, **changes)
        return replace(self, axes=tuple(changed if a.name == name else a for a in self.axes))

    def with_feedforward(self, feedforward: str | None) -> Machine:
        """The machine with feedforward 'off', 'velocity' or 'velocity+torque' on all axes; None leaves the file's weights.

        A weight that the file has is kept where the word switches it on; a weight of 0 there becomes 1.
        """
        if feedforward is None:
            return self
        if feedforward not in FEEDFORWARD:
            raise InputError(f"feedforward '{feedforward}': {nearest(feedforward, FEEDFORWARD)}")
        machine = self
        for axis in self.axes:
            weights = {
                "velocity_feedforward": (axis.loops.velocity_feedforward or 1.0) if "velocity" in feedforward else 0.0,
                "torque_feedforward": (axis.loops.torque_feedforward or 1.0) if "torque" in feedforward else 0.0,
            }
            machine = machine.with_axis(axis.name, **weights)
        return machine

    def with_values(self, values: Mapping[str, Any]) -> Machine:
        """A variant by paths into the file, in the file's units: {'axis.X.moving_mass_kg': 690.0}.

        `effect` replaces the list of effects. Raises InputError for a path that does not exist.
        """
        # tables on the way get copies of their own, the others are shared
        document = dict(self.document)
        for asked, value in values.items():
            path, value = self.in_file(asked, value)
            *tables, key = path.split(".")
            table: Any = document
            for i, name in enumerate(tables):
                if not isinstance(table, dict) or name not in table:
                    known = table if isinstance(table, dict) else {}
                    raise InputError(f"machine {self.name}: no '{'.'.join(tables[: i + 1])}'; {nearest(name, known)}")
                if isinstance(table[name], dict):
                    table[name] = dict(table[name])
                table = table[name]
            if not isinstance(table, dict) or (key not in table and key not in ("effect", "commissioned", *OPTIONAL)):
                raise InputError(f"machine {self.name}: no '{path}'; {nearest(key, table if isinstance(table, dict) else {})}")
            table[key] = value
        driven = self.axis_names
        return machine_from_document(document, self.model_path, self.path, str(self.path or self.name)).with_axes(driven)

    def in_file(self, path: str, value: Any) -> tuple[str, Any]:
        """Path and value of a number as this file has it: 'axis.X.coulomb_friction_nm' of a direct drive is its `coulomb_friction_n`."""
        path = keys.path_in_file(self.document, path)
        *tables, key = path.split(".")
        if tables[:1] == ["axis"] and len(tables) > 1:
            datum = sinumerik.place(self.document["axis"].get(tables[1], {}), path.split(".", 2)[2], value)
            if datum is not None:
                return f"axis.{tables[1]}.{datum[0]}", datum[1]
        if key in (keys.SPEED_GAIN, keys.DIRECT[keys.SPEED_GAIN]) and tables[:1] == ["axis"] and tables[-1] == "loops":
            axis = self.axis(tables[1])
            have = self.document["axis"][axis.name]["loops"]
            for other, torque, at_axis in keys.speed_gains(axis.effort):
                if key not in have and other in have and not torque:
                    told = axis.told_torque_constant
                    return ".".join([*tables, other]), value / told / (axis.ratio if at_axis else 1.0)
        return path, value


def default_machine_path() -> Path:
    """The Mikron that ships with the package (in a checkout: models/ at its top)."""
    inside = Path(__file__).parents[1] / "models" / DEFAULT_MACHINE
    return inside if inside.is_file() else Path(__file__).parents[2] / "models" / DEFAULT_MACHINE


@functools.lru_cache(maxsize=8)
def _read_document(path: Path, _modified_ns: int) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not a valid TOML file: {error}; correct it there") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); check its permissions") from None


@functools.lru_cache(maxsize=8)
def _check_model(path: Path, _modified_ns: int) -> None:
    check_mjcf(path)


def load_machine(path: str | Path | None = None) -> Machine:
    """Read a machine file (default: the Mikron UCP 710); every fault is an InputError with table, key and remedy."""
    path = default_machine_path() if path is None else Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such machine file; give a .toml with the keys of {DEFAULT_MACHINE}")
    document = _read_document(path, path.stat().st_mtime_ns)
    model = document.get("model")
    if not isinstance(model, str):
        raise InputError(f"{path}: 'model' is missing; name the MJCF of the machine, e.g. model = \"mikron_ucp710.xml\"")
    model_path = path.parent / model
    if not model_path.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"{path}: model '{model}' leaves the machine's folder; copy the MJCF beside the machine file")
    if not model_path.is_file():
        raise InputError(f"{path}: model '{model}': no such file beside the machine file; correct 'model' or copy the MJCF there")
    _check_model(model_path, model_path.stat().st_mtime_ns)
    return machine_from_document(copy.deepcopy(document), model_path, path, str(path))


def write_machine(machine: Machine, path: str | Path, comments: Mapping[str, str] | None = None) -> None:
    """Write a machine file and copy its MJCF beside it.

    Comments of the file that the machine came from are kept; `comments` maps paths ('axis.X.moving_mass_kg') to the
    comment behind that value (grade, interval, source).
    """
    import tomlkit

    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    source = machine.path.read_text(encoding="utf-8") if machine.path and machine.path.is_file() else ""
    written = tomlkit.parse(source)
    _update(written, {**machine.document, "model": machine.model_path.name})
    for where, comment in (comments or {}).items():
        *tables, key = where.split(".")
        table: Any = written
        for name in tables:
            table = table[name]
        table[key].comment(comment)
    path.write_text(tomlkit.dumps(written), encoding="utf-8")
    copy_model(machine.model_path, path.parent)


def machine_from_document(document: Mapping[str, Any], model_path: Path, path: Path | None, where: str) -> Machine:
    """A checked Machine from the tables of a machine file."""
    also = (
        "name",
        "structure",
        "model",
        "axis_order",
        "control",
        "geometry",
        "axis",
        "body",
        "measurement",
        "effect",
        "frame",
        "tool",
        "identified",
    )
    keys.check_table(document, keys.TOP, where, also)
    for table, known in (("control", keys.CONTROL), ("geometry", keys.GEOMETRY), ("measurement", keys.MEASUREMENT)):
        if table not in document and table != "geometry":
            raise InputError(f"{where}: table [{table}] is missing; add it")
        keys.check_table(document.get(table, {}), known, f"{where}: [{table}]", ("setpoint_interpolation",) if table == "control" else ())
    interpolation = document["control"].get("setpoint_interpolation", keys.INTERPOLATIONS[0])
    if interpolation not in keys.INTERPOLATIONS:
        raise InputError(
            f"{where}: [control]: setpoint_interpolation = {interpolation!r}; {nearest(str(interpolation), keys.INTERPOLATIONS)}"
        )
    axes = document.get("axis")
    if not isinstance(axes, dict) or not axes:
        raise InputError(f"{where}: no [axis.NAME] table; describe at least one axis")
    order = document.get("axis_order", list(axes))
    if not isinstance(order, list) or sorted(map(str, order)) != sorted(axes):
        raise InputError(f"{where}: axis_order = {order} does not list the axes {', '.join(axes)}; name each of them once")
    if not isinstance(document.get("effect", []), list):
        raise InputError(f"{where}: 'effect' must be a list of tables; write [[effect]]")
    tools = document.get("tool", {})
    if not isinstance(tools, dict) or not all(isinstance(tool, dict) for tool in tools.values()):
        raise InputError(f"{where}: 'tool' must hold one table for each tool; write [tool.T1] and below it length_m")
    for name, tool in tools.items():
        keys.check_table(tool, keys.TOOL, f"{where}: [tool.{name}]")
    parsed = tuple(axis_of_table(name, axes[name], f"{where}: [axis.{name}]") for name in order)
    control = {k: v * keys.si_from_key(k) for k, v in document["control"].items() if k in keys.CONTROL}
    if "current_cycle_us" not in control:
        looped = [axis.name for axis in parsed if axis.has_current_loop]
        if looped:
            raise InputError(f"{where}: [control]: 'current_cycle_us' is missing; add it, axis {looped[0]} has a current loop")
        control["current_cycle_us"] = control["speed_cycle_us"] / math.ceil(control["speed_cycle_us"] / LONGEST_TICK - 1e-9)
    machine = Machine(
        name=str(document.get("name", path.stem if path else "machine")),
        axes=parsed,
        bodies=tuple(_body(name, table, f"{where}: [body.{name}]") for name, table in document.get("body", {}).items()),
        geometry=dict(document.get("geometry", {})),
        gravity=float(document["gravity_m_per_s2"]),
        parameter_tolerance=float(document.get("parameter_tolerance", 0.0)),
        current_cycle=control["current_cycle_us"],
        speed_cycle=control["speed_cycle_us"],
        position_cycle=control["position_cycle_us"],
        interpolation_cycle=control.get("interpolation_cycle_us", control["position_cycle_us"]),
        sample_period=document["measurement"]["sample_period_us"] * 1e-6,
        model_path=model_path,
        document=document,
        path=path,
        setpoint_interpolation=interpolation,
    )
    for key in ("current_cycle", "speed_cycle", "position_cycle"):
        cycles = getattr(machine, key) / machine.base_tick
        if abs(cycles - round(cycles)) > 1e-6:
            raise InputError(
                f"{where}: [control]: {key}_us is no whole multiple of the shortest cycle ({machine.base_tick * 1e6:g} us); change it"
            )
    return machine


def _body(name: str, table: Any, where: str) -> Body:
    if not isinstance(table, dict):
        raise InputError(f"{where}: must be a table")
    keys.check_table(table, keys.BODY, where)
    i = np.array(table["inertia_kg_m2"], float)
    if np.any(i > i.sum() - i + 1e-12):
        raise InputError(
            f"{where}: inertia_kg_m2 = {table['inertia_kg_m2']}: no body has one principal inertia above the sum of the others"
        )
    return Body(name, float(table["mass_kg"]), tuple(table["centre_of_mass_m"]), tuple(table["inertia_kg_m2"]))


def _names(cls: type) -> set[str]:
    return {f.name for f in fields(cls)}


def _update(target: Any, source: Mapping[str, Any]) -> None:
    """Bring a parsed TOML to the values of `source` and keep comments where values stay."""
    for key in [k for k in target if k not in source]:
        del target[key]
    for key, value in source.items():
        if isinstance(value, Mapping) and key in target:
            _update(target[key], value)
        elif key not in target or target[key] != value:
            comment = target[key].trivia.comment if key in target and hasattr(target[key], "trivia") else ""
            target[key] = value
            if comment and hasattr(target[key], "comment"):
                target[key].comment(comment.lstrip("# "))
