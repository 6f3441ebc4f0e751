"""Catalogues: named motors, screws and gears with their numbers; docs/study.md has their form.

A machine file holds the inertia of rotor and screw (or gear) as one number. A factor therefore names the `installed` entry; choosing
another one adds the difference of their inertias.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec

from twin.control.current_controller import MOTOR
from twin.documents import read_toml
from twin.errors import InputError, nearest
from twin.machine.machine import Axis, Machine
from twin.machine.parameters import key_of
from twin.study.paths import number_at
from twin.tables import NotNegative, Positive, Table, Text, known_keys, typed

INERTIA = "inertia_kg_m2"

RATINGS = tuple(p.screw.removeprefix("motor.") for p in MOTOR if not p.bounds.required)
"""Ratings of a motor; optional in a machine file."""
_FRICTION = ("coulomb_friction_nm", "viscous_friction_nm_s_per_rad")
_KEYS = {
    "motor": (
        ("back_emf_v_s_per_rad", "resistance_ohm", "inductance_h", INERTIA),
        ("peak_current_a", "peak_torque_nm", "bus_limit_v", *RATINGS),
    ),
    "screw": (("screw_lead_m_per_rev", INERTIA), _FRICTION),
    "gear": (("gear_ratio", INERTIA), _FRICTION),
}
"""Required and optional numbers of an entry of each kind."""
_FIELDS: dict[str, list[Any]] = {
    kind: [("name", Text), *((key, NotNegative) for key in required), *((key, NotNegative | None, None) for key in optional)]
    for kind, (required, optional) in _KEYS.items()
}
_FIELDS["motor"].insert(1, ("torque_constant_nm_per_a", Positive))
ENTRIES = {kind: msgspec.defstruct(kind, fields, bases=(Table,), frozen=True) for kind, fields in _FIELDS.items()}


@dataclass(frozen=True)
class Choice:
    """A catalogue entry on the axes of a factor: numbers by path, and its inertia minus that of the installed entry [kg m2]."""

    name: str
    values: tuple[tuple[str, float], ...]
    added_inertia: tuple[tuple[str, float], ...]


def choices_of(path: Path, axes: Sequence[Axis], installed: str, names: Sequence[str], where: str) -> tuple[Choice, ...]:
    """Entries of a catalogue for some axes: those with these names, or all of the installed entry's kind."""
    entries = _entries(path, where)
    kind = next((kind for kind, known in entries.items() if installed in known), None)
    if kind is None:
        known_names = [name for known in entries.values() for name in known]
        raise InputError(f"{where}: installed = {installed!r} is not in {path.name}; {nearest(installed, known_names)}")
    known = entries[kind]
    if (wrong := next((name for name in names if name not in known), None)) is not None:
        raise InputError(f"{where}: no {kind} '{wrong}' in {path.name}; {nearest(wrong, list(known))}")
    chosen = list(names) or list(known)
    if len(set(chosen)) < 2:
        raise InputError(f"{where}: has one {kind} only; name two or more")
    for axis in axes:
        _check_axis(kind, axis, known[installed], where)
    return tuple(_choice(kind, name, known[name], known[installed], axes) for name in chosen)


def _check_axis(kind: str, axis: Axis, installed: Mapping[str, Any], where: str) -> None:
    fits = {"motor": axis.actuator.winding, "screw": axis.drive == "screw", "gear": axis.drive == "gear"}[kind]
    if axis.drive == "direct" or not fits:
        raise InputError(
            f"{where}: axis {axis.name} has no {kind} (its drive is {axis.drive}, its structure {axis.structure}); leave it out"
        )
    if installed[INERTIA] > axis.rotor_inertia_kg_m2:
        raise InputError(
            f"{where}: the installed {kind} has {installed[INERTIA]:g} kg m2, more than the {axis.rotor_inertia_kg_m2:g} kg m2 "
            f"of rotor and screw or gear of {axis.name}; correct the catalogue or the machine file"
        )


def _choice(kind: str, name: str, entry: Mapping[str, Any], installed: Mapping[str, Any], axes: Sequence[Axis]) -> Choice:
    values, inertia = [], []
    for axis in axes:
        table = f"axis.{axis.name}.motor" if kind == "motor" else f"axis.{axis.name}"
        for key, value in entry.items():
            if key == "peak_torque_nm":
                values.append((f"{table}.peak_current_a", value / entry["torque_constant_nm_per_a"]))
            elif key not in ("name", INERTIA):
                values.append((f"{table}.{key}", value))
        turning = f"axis.{axis.name}.{key_of('rotor_inertia_kg_m2', axis.kind)}"
        inertia.append((turning, entry[INERTIA] - installed[INERTIA]))
    return Choice(name, tuple(values), tuple(inertia))


def _entries(path: Path, where: str) -> dict[str, dict[str, Mapping[str, Any]]]:
    """Kind -> name -> numbers of the entries of a catalogue."""
    try:
        document = read_toml(path)
    except InputError as error:
        raise InputError(f"{where}: catalogue: {error}; see docs/study.md for the form") from None
    known_keys(document, ENTRIES, str(path))
    out: dict[str, dict[str, Mapping[str, Any]]] = {}
    for kind, tables in document.items():
        if not isinstance(tables, list):
            raise InputError(f"{path}: [{kind}] must be [[{kind}]]; correct it")
        for i, entry in enumerate(tables):
            typed(entry, ENTRIES[kind], f"{path}: {kind} {i + 1}")
            name = entry["name"]
            if name in out.setdefault(kind, {}):
                raise InputError(f"{path}: two of [[{kind}]] have the name '{name}'; give each its own")
            if kind == "motor" and len({"peak_current_a", "peak_torque_nm"} & entry.keys()) != 1:
                raise InputError(f"{path}: motor {i + 1} '{name}': give one of peak_current_a and peak_torque_nm")
            out[kind][name] = entry
    return out


def with_choices(choices: Sequence[Choice], machine: Machine) -> dict[str, float]:
    """Numbers by path of a machine with these entries, one per factor; their inertia differences add up."""
    values: dict[str, float] = {}
    for choice in choices:
        values |= dict(choice.values)
        for path, more in choice.added_inertia:
            values[path] = values.get(path, number_at(machine, path) or 0.0) + more
    return values
