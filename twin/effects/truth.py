"""A machine with the parameter factors and effects of a `truth.toml`, to validate the physics of the effects.

Only checks and the examination use it; a diagnosis never reads a `truth.toml`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from twin.documents import read_toml, value_at
from twin.effects.change import with_effects
from twin.machine.machine import Machine
from twin.machine.parameters import SPREAD, key_of


def true_machine(machine: Machine, truth: str | Path | Mapping[str, Any]) -> Machine:
    """The machine with the parameter factors and effects of a `truth.toml` (path or content)."""
    document = truth if isinstance(truth, Mapping) else read_toml(Path(truth))
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
            path = f"axis.{axis}.{key_of(SPREAD[name], machine.axis(axis).kind)}"
            if (old := value_at(machine.document, path)) is not None:
                values[path] = factor * old
    return with_effects(machine.with_values(values), document.get("effect", []))
