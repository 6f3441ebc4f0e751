"""A change of the control or of the machine that answers an effect of the diagnosis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twin.control.library import BLOCKS
from twin.control.number import si_from_key
from twin.effects import Setting, settings_of, with_effects
from twin.effects.change import total_inertia
from twin.machine.machine import Machine
from twin.remedy.advice import SET_BACK


@dataclass(frozen=True)
class Change:
    """One change: the axis and effect it answers, the function of the control, its numbers by name [SI at the axis].

    `set_back` gives a number of the control its commissioned value; the deviation that the diagnosis found is then gone. Every other
    function is a block of the axis' control.
    """

    axis: str
    function: str
    setting: Setting | None = None
    """The effect that it answers; None for friction that every machine of this kind has."""
    values: Mapping[str, float] = field(default_factory=dict)

    def applied(self, machine: Machine) -> Machine:
        """The machine with this change."""
        if self.function == SET_BACK and self.setting is not None:
            setting = self.setting
            if setting.effect.name == "inertia":
                return _with_commissioned_inertia(machine, setting)
            return with_effects(machine, [s for s in settings_of(machine) if s.key != setting.key])
        kind = machine.axis(self.axis).kind
        block = {
            number.key(kind): self.values[number.name] / si_from_key(number.key(kind))
            for number in BLOCKS[self.function].numbers
            if number.name in self.values
        }
        others = machine.document["axis"][self.axis].get("block", {})
        return machine.with_values({f"axis.{self.axis}.block": {**others, self.function: block}})

    def table(self, machine: Machine) -> dict[str, Any]:
        """The numbers in the units of the machine file, by key."""
        kind = machine.axis(self.axis).kind
        if self.function == SET_BACK:
            return {}
        return {n.key(kind): self.values[n.name] / si_from_key(n.key(kind)) for n in BLOCKS[self.function].numbers if n.name in self.values}


def _with_commissioned_inertia(machine: Machine, setting: Setting) -> Machine:
    """The machine whose torque feedforward knows the added inertia."""
    axis = machine.axis(setting.axis)
    total = total_inertia(with_effects(machine, []), axis) * axis.ratio**2
    now = axis.commissioned_inertia if axis.commissioned_inertia is not None else total
    return machine.with_values({f"axis.{axis.name}.commissioned.inertia_kg_m2": now + setting.size * axis.ratio**2})
