"""A machine: an MJCF model, and a TOML file of drives, loops, friction, limits and measuring systems.

`load_machine` reads and checks the file. `write_machine` writes it with its MJCF beside it. `Machine.document` holds the tables of
the file and is the only source of data; axes, bodies and cycles are derived from it in SI. The `with_...` methods change
the tables, so a variant stays the same machine when it is written and read again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field
import functools
import math
from pathlib import Path
from typing import Any, Literal, get_args

from twin.control.number import si_from_key
from twin.control.structures import NC_WEIGHTS
from twin.documents import named_file, read_toml, value_at
from twin.errors import InputError, nearest
from twin.files import write_whole
from twin.machine import keys
from twin.machine.axis import Axis, axis_of_table
from twin.machine.document import changed, check_cycles, check_document, cycles_of, in_file
from twin.machine.model_file import check_mjcf, copy_model, state_of_model
from twin.machine.parameters import file_from_typed, key_of

DEFAULT_MACHINE = "mikron_ucp710.toml"
Feedforward = Literal["off", "velocity", "velocity+torque"]
FEEDFORWARD: tuple[str, ...] = get_args(Feedforward)


@dataclass(frozen=True)
class Body:
    """A rigid body of the model: mass [kg], centre of mass [m] in its frame, principal inertia about it [kg m2]."""

    name: str
    mass_kg: float
    centre_of_mass_m: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float]


@dataclass(frozen=True)
class Noise:
    """Measuring noise of one axis, SI: standard deviations and resolutions, 0 for none. `motor` is the noise of the motor encoder."""

    position: float
    position_resolution: float
    motor_resolution: float
    speed: float
    current: float
    motor: float = 0.0

    def total(self, sensor: str) -> float:
        """Standard deviation of one sensor ('position', 'motor', 'speed', 'current') with its quantisation; 0 for an unknown one."""
        return math.hypot(getattr(self, sensor, 0.0), getattr(self, f"{sensor}_resolution", 0.0) / math.sqrt(12.0))


@dataclass(frozen=True)
class Machine:
    """The tables of a machine file, and the paths of the file and its MJCF. `dataclasses.replace` accepts only these three fields.

    document    tables of the machine file, in its keys and units; never changed in place
    model_path  the MJCF
    path        the machine file; None for a machine made in memory

    `recorded_noise`: noise of axes in a record, which then replaces that of the file (see `with_noise`).
    `derived`: what other rooms derive from the document and keep with it, by name.

    Derived from the document, in SI: `axes` (driven axes in the order of the file), `axis_names`, `bodies`, `geometry`, `gravity` [m/s2],
    `parameter_tolerance`, the cycles [s] of the current, speed and position controllers and of the interpolator, `sample_period` [s]
    of the record, `setpoint_interpolation`. An impossible value raises InputError, unless `checked` is False. Axes whose table is the
    same object in the machine `like` are reused from it.
    """

    document: Mapping[str, Any] = field(repr=False)
    model_path: Path
    path: Path | None = None
    checked: InitVar[bool] = True
    like: InitVar[Machine | None] = None
    recorded_noise: Mapping[str, Noise] = field(default_factory=dict, compare=False, repr=False)
    name: str = field(init=False, compare=False)
    axes: tuple[Axis, ...] = field(init=False, compare=False, repr=False)
    axis_names: tuple[str, ...] = field(init=False, compare=False, repr=False)
    bodies: tuple[Body, ...] = field(init=False, compare=False, repr=False)
    geometry: Mapping[str, Any] = field(init=False, compare=False, repr=False)
    gravity: float = field(init=False, compare=False, repr=False)
    parameter_tolerance: float = field(init=False, compare=False, repr=False)
    current_cycle: float = field(init=False, compare=False, repr=False)
    speed_cycle: float = field(init=False, compare=False, repr=False)
    position_cycle: float = field(init=False, compare=False, repr=False)
    interpolation_cycle: float = field(init=False, compare=False, repr=False)
    sample_period: float = field(init=False, compare=False, repr=False)
    setpoint_interpolation: str = field(init=False, compare=False, repr=False)
    derived: dict[str, Any] = field(init=False, compare=False, repr=False)
    _axis_of: dict[str, tuple[Any, Axis]] = field(init=False, compare=False, repr=False)

    def __post_init__(self, checked: bool, like: Machine | None) -> None:
        document, where = self.document, self.where
        if checked:
            check_document(document, where)
        known = like._axis_of if like is not None else {}
        parsed: dict[str, tuple[Any, Axis]] = {}
        for name in document.get("axis_order", document["axis"]):
            table = document["axis"][name]
            same = known[name][1] if name in known and known[name][0] is table else None
            parsed[name] = (table, same or axis_of_table(name, table, f"{where}: [axis.{name}]", checked))
        if checked:
            check_cycles(document, tuple(axis for _, axis in parsed.values()), where)
        driven = document.get("driven_axes", list(parsed))
        derived = {
            "name": str(document.get("name", self.path.stem if self.path else "machine")),
            "axes": tuple(axis for name, (_, axis) in parsed.items() if name in driven),
            "axis_names": tuple(axis.name for name, (_, axis) in parsed.items() if name in driven),
            "bodies": tuple(
                Body(name, float(table["mass_kg"]), tuple(table["centre_of_mass_m"]), tuple(table["inertia_kg_m2"]))
                for name, table in document.get("body", {}).items()
            ),
            "geometry": document.get("geometry", {}),
            "gravity": float(document["gravity_m_per_s2"]),
            "parameter_tolerance": float(document.get("parameter_tolerance", 0.0)),
            **cycles_of(document),
            "sample_period": document["measurement"]["sample_period_us"] * si_from_key("sample_period_us"),
            "setpoint_interpolation": document["control"].get("setpoint_interpolation", keys.INTERPOLATIONS[0]),
            "derived": {},
            "_axis_of": parsed,
        }
        for key, value in derived.items():
            object.__setattr__(self, key, value)

    def __getstate__(self) -> dict[str, Any]:
        """For another process: without what can be derived again, such as compiled laws."""
        return {**self.__dict__, "derived": {}}

    @property
    def where(self) -> str:
        """Name of this machine in messages: its file, or its name."""
        return str(self.path or self.document.get("name", "machine"))

    @property
    def text(self) -> str:
        """Text of its file, "" without one."""
        return self.path.read_text(encoding="utf-8-sig") if self.path and self.path.is_file() else ""

    @property
    def kinds(self) -> dict[str, str]:
        """Axis name -> 'linear' or 'rotary'."""
        return {axis.name: axis.kind for axis in self.axes}

    @property
    def forces(self) -> frozenset[str]:
        """Names of the axes whose motor gives a force [N] instead of a torque [Nm]: direct linear drives."""
        return frozenset(axis.name for axis in self.axes if axis.drive == "direct")

    @property
    def base_tick(self) -> float:
        """The shortest cycle [s]. The other cycles are whole multiples of it."""
        return min(self.current_cycle, self.speed_cycle, self.position_cycle)

    @property
    def effects(self) -> tuple[Mapping[str, Any], ...]:
        """The `[[effect]]` tables of the file, unchecked; `twin.effects.settings_of` checks and interprets them."""
        return tuple(self.document.get("effect", ()))

    def axis(self, name: str) -> Axis:
        """The axis with this name. Raises InputError that suggests the nearest name."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise InputError(f"machine {self.name}: no axis {name}; {nearest(name, self.axis_names)}")

    def noise(self, axis: Axis) -> Noise:
        """Measuring noise of an axis: that of its record, if it is known, or that of `[measurement]`."""
        if axis.name in self.recorded_noise:
            return self.recorded_noise[axis.name]
        table = self.document.get("measurement", {})
        given = {field: float(table.get(key, 0.0)) * si_from_key(key) for field, key in keys.NOISE[axis.kind].items()}
        return Noise(**given | ({} if axis.effort_has_noise else {"current": 0.0}))

    def with_noise(self, noise: Mapping[str, Noise]) -> Machine:
        """The machine with the measuring noise that its axes have in a record. It is not written to a file."""
        return Machine(self.document, self.model_path, self.path, checked=False, like=self, recorded_noise=dict(noise))

    def with_axes(self, names: Sequence[str]) -> Machine:
        """The machine with only these axes driven (`driven_axes` in the file). The other axes stand still."""
        for name in names:
            self.axis(name)
        return self._changed({"driven_axes": [name for name in self.axis_names if name in names]}, checked=False)

    def with_axis(self, name: str, **numbers: Any) -> Machine:
        """A variant with other values of typed fields of one axis, its motor or loops, SI: with_axis("X", max_velocity=0.5, peak_current_a=20.0).

        Unlike `with_values` it accepts impossible numbers, because a fit may pass through them. Such a machine can be simulated, not written.
        """
        return self.with_each_axis({name: numbers})

    def with_each_axis(self, numbers: Mapping[str, Mapping[str, Any]]) -> Machine:
        """`with_axis` for several axes at once: axis name -> typed fields with their values, SI."""
        values = {}
        for name, fields in numbers.items():
            kind = self.axis(name).kind
            for typed, value in fields.items():
                key = typed if typed in keys.WORDS else key_of(typed, kind)
                number = isinstance(value, int | float) and not isinstance(value, bool)
                values[f"axis.{name}.{key}"] = file_from_typed(key, value) if number else value
        return self._changed(values, checked=False)

    def with_feedforward(self, feedforward: str | None) -> Machine:
        """The machine with feedforward 'off', 'velocity' or 'velocity+torque' on all axes. None keeps the weights of the file.

        A weight that is switched on keeps its value, or becomes 1 if it was 0.
        """
        if feedforward is None:
            return self
        if feedforward not in FEEDFORWARD:
            raise InputError(f"feedforward '{feedforward}': {nearest(feedforward, FEEDFORWARD)}")
        values = {}
        for _, axis in self._axis_of.values():  # also those that are not driven
            for word, name in NC_WEIGHTS.items():
                now = getattr(axis.loops, name)
                wanted = (now or 1.0) if word in feedforward else 0.0
                if wanted != now:
                    values[f"axis.{axis.name}.loops.{name}"] = wanted
        return self._changed(values, checked=False)

    def with_values(self, values: Mapping[str, Any]) -> Machine:
        """A variant with other values by path, in the units of the file: {'axis.X.moving_mass_kg': 690.0}.

        `effect` replaces the list of effects. A number that the file omits is added. Raises InputError for a path that no machine
        file has, and for an impossible value.
        """
        return self._changed(values)

    def with_loops(self, numbers: Mapping[str, Mapping[str, float]]) -> Machine:
        """A variant with other numbers of the controls: axis name -> key in `[axis.N.loops]` -> value. An axis without a number is left as it is."""
        given = ((self.axis(axis), key, value) for axis, own in numbers.items() for key, value in own.items())
        return self.with_values({f"axis.{axis.name}.loops.{key}": value for axis, key, value in given if axis.loops.has(key)})

    def with_effect_tables(self, tables: Sequence[Mapping[str, Any]]) -> Machine:
        """A variant with exactly these `[[effect]]` tables, unchecked; `twin.effects.with_effects` checks them."""
        return self._changed({"effect": list(tables)}, checked=False)

    def _changed(self, values: Mapping[str, Any], checked: bool = True) -> Machine:
        document = changed(self.document, values, self.name)
        return Machine(document, self.model_path, self.path, checked=checked, like=self, recorded_noise=self.recorded_noise)

    def with_body(self, name: str, factor: float) -> Machine:
        """A variant with the mass and inertia of one body multiplied by a factor."""
        body = next(body for body in self.bodies if body.name == name)
        values = {"mass_kg": factor * body.mass_kg, "inertia_kg_m2": [factor * i for i in body.inertia_kg_m2]}
        return self._changed({f"body.{name}.{key}": value for key, value in values.items()}, checked=False)

    def has(self, path: str) -> bool:
        """True if the file contains the number at this path."""
        return value_at(self.document, self.in_file(path, 1.0)[0]) is not None

    def in_file(self, path: str, value: Any) -> tuple[str, Any]:
        """Path and value of a number in the keys and units of this file: 'axis.X.coulomb_friction_nm' of a direct drive is `coulomb_friction_n`."""
        return in_file(self.document, path, value)


def default_machine_path() -> Path:
    """Path of the Mikron that ships with the package (in a checkout: models/)."""
    inside = Path(__file__).parents[1] / "models" / DEFAULT_MACHINE
    return inside if inside.is_file() else Path(__file__).parents[2] / "models" / DEFAULT_MACHINE


@functools.lru_cache(maxsize=8)
def _check_model(path: Path, _state: bytes) -> None:
    check_mjcf(path)


def load_machine(path: str | Path | None = None) -> Machine:
    """Read a machine file (default: the Mikron UCP 710). Raises InputError that names the table, the key and the remedy."""
    path = default_machine_path() if path is None else Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such machine file; give a .toml with the keys of {DEFAULT_MACHINE}")
    document = read_toml(path)
    model = document.get("model")
    if not isinstance(model, str):
        raise InputError(f"{path}: 'model' is missing; name the MJCF of the machine, e.g. model = \"mikron_ucp710.xml\"")
    model_path = named_file(model, path.parent, f"{path}: model")
    _check_model(model_path, state_of_model(model_path))
    return Machine(document, model_path, path)


CHANGED = "was "
"""Beginning of the comment of a changed number."""


def write_machine(machine: Machine, path: str | Path, comments: Mapping[str, str] | None = None) -> None:
    """Write a machine file and copy its MJCF beside it.

    Comments of the source file are kept; that of a changed number says what the number was. `comments` maps paths ('axis.X.moving_mass_kg') to
    new comments (grade, interval, source).
    Raises InputError for a machine that could not be read again.
    """
    import tomlkit

    Machine(machine.document, machine.model_path, machine.path)  # refuse impossible values now
    path = Path(path)
    written = tomlkit.parse(machine.text)
    _update(written, {**machine.document, "model": machine.model_path.name})
    for where, comment in (comments or {}).items():
        value_at(written, where).comment(comment)
    copy_model(machine.model_path, path.parent)  # first the model, so that a machine file on disk can always be loaded
    write_whole(path, tomlkit.dumps(written))


def _update(target: Any, source: Mapping[str, Any]) -> None:
    """Set a parsed TOML to the values of `source`. A comment stays; that of a changed number states what the number was, because grade and interval
    in it belong to the old one."""
    for key in [k for k in target if k not in source]:
        del target[key]
    for key, value in source.items():
        if isinstance(value, Mapping) and key in target:
            _update(target[key], value)
        elif key not in target or target[key] != value:
            old = target.get(key)
            is_number = isinstance(old, int | float) and not isinstance(old, bool)
            target[key] = value
            comment = old.trivia.comment.lstrip("# ") if hasattr(old, "trivia") else ""
            if is_number and not comment.startswith(CHANGED):
                comment = f"{CHANGED}{old.as_string()}" + (f" ({comment})" if comment else "")
            if comment and hasattr(target[key], "comment"):
                target[key].comment(comment)
                longer = len(target[key].as_string()) - len(old.as_string())
                target[key].trivia.comment_ws = " " * max(1, len(old.trivia.comment_ws) - longer)  # comments stay in their column
