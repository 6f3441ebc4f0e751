"""Two machine files: the numbers and effects that differ."""

from typing import Any, NamedTuple

from twin.documents import flat
from twin.effects import settings_of
from twin.machine.machine import Machine


class Number(NamedTuple):
    """A number that differs: its path in the machine file, and its value in both files (None if missing)."""

    path: str
    first: Any
    second: Any


def differing_numbers(a: Machine, b: Machine) -> list[Number]:
    """Numbers that differ, in the order of the first file; paths of effects are `effect.NAME.AXIS.PARAMETER`."""
    first, second = flat(_plain(a)), flat(_plain(b))
    return [
        Number(path, first.get(path), second.get(path)) for path in dict.fromkeys([*first, *second]) if first.get(path) != second.get(path)
    ]


def _plain(machine: Machine) -> dict[str, Any]:
    """The document with effects by name and axis, without names of machine and model."""
    document = {key: value for key, value in machine.document.items() if key not in ("effect", "model", "name")}
    effects: dict[str, Any] = {}
    for setting in settings_of(machine):
        own = {k: v for k, v in setting.table().items() if k not in ("name", "axis")}
        path = f"{setting.effect.name}.{setting.axis}"
        same = sum(name.partition("#")[0] == path for name in effects)  # several laws, or couplings to several axes
        effects[f"{path}#{same + 1}" if same else path] = own
    return {**document, "effect": effects}
