"""A machine with known deviations: the parameter factors and effects of a `truth.toml`, to check the effects' physics.

Only checks and the examination use this; diagnosis never reads a truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
import tomllib
from typing import Any

from twin.effects.change import with_effects
from twin.machine.machine import Machine

_AXIS_KEYS = {
    "torque_constant": ("motor.torque_constant_nm_per_a",),
    "resistance": ("motor.resistance_ohm",),
    "inductance": ("motor.inductance_h",),
    "rotor_inertia": ("rotor_and_screw_inertia_kg_m2", "rotor_and_gear_inertia_kg_m2"),
    "coulomb_friction": ("coulomb_friction_nm",),
    "viscous_friction": ("viscous_friction_nm_s_per_rad",),
    "moving_mass": ("moving_mass_kg",),
}


def true_machine(machine: Machine, truth: str | Path | Mapping[str, Any]) -> Machine:
    """The machine with the factors on its parameters and the effects that a `truth.toml` lists (its path or its content)."""
    document = truth if isinstance(truth, Mapping) else tomllib.loads(Path(truth).read_text(encoding="utf-8"))
    values: dict[str, Any] = {}
    for axis, factors in document.get("parameter", {}).items():
        if axis == "bodies":
            for name, factor in factors.items():
                body, _, quantity = name.rpartition("_")
                assert quantity == "mass", name
                for key in ("mass_kg", "inertia_kg_m2"):
                    old = machine.document["body"][body][key]
                    values[f"body.{body}.{key}"] = [factor * v for v in old] if isinstance(old, list) else factor * old
            continue
        for name, factor in factors.items():
            for key in _AXIS_KEYS[name]:
                table = machine.document["axis"][axis]
                *parents, leaf = key.split(".")
                for parent in parents:
                    table = table[parent]
                if leaf in table:
                    values[f"axis.{axis}.{key}"] = factor * table[leaf]
    return with_effects(machine.with_values(values), document.get("effect", []))
